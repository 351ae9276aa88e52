"""What nodes and edges are called outside: by a LIF file's own ids, or by column and row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worlds.floor import Floor
from worlds.world import World


@dataclass(frozen=True)
class TrackNames:
    """Names and places of the vertices of a floor.

    Attributes:
        node: (V,) ids.
        at_m: (V, 2) places in the frame of the graph, or of the hall if it has a grid [m].
        edge: id of the edge from one vertex to another, for those the graph itself names.
        map_id: what the frame is called.
    """

    node: tuple[str, ...]
    at_m: NDArray[np.float64]
    edge: dict[tuple[int, int], str]
    map_id: str

    @classmethod
    def of(cls, world: World, floor: Floor) -> TrackNames:
        """Those of a world's floor."""
        graph = world.hall.graph
        if graph is None or floor.node is None:
            node = tuple(f"c{column}r{row}" for column, row in floor.vertex_cell.tolist())
            return cls(node, floor.vertex_xy_m, {}, world.name)
        vertex = {name: v for v, name in enumerate(floor.node_id)}
        edge = {
            (vertex[e.start], vertex[e.end]): e.id
            for e in graph.edge
            if e.start in vertex and e.end in vertex
        }
        at_m = np.array([graph.node[i].at_m for i in floor.node.tolist()]).reshape(-1, 2)
        return cls(floor.node_id, at_m, edge, graph.layout or world.name)

    def kept(self, vertices: Sequence[int] | NDArray[np.integer]) -> TrackNames:
        """The same for some of the vertices, numbered anew."""
        chosen = np.asarray(vertices, dtype=np.intp)
        index = {int(v): k for k, v in enumerate(chosen)}
        edge = {
            (index[u], index[v]): name
            for (u, v), name in self.edge.items()
            if u in index and v in index
        }
        node = tuple(self.node[v] for v in chosen.tolist())
        return TrackNames(node, self.at_m[chosen], edge, self.map_id)

    def edge_id(self, start: int, end: int) -> str:
        """Id of the edge from one vertex to another."""
        return self.edge.get((start, end), f"{self.node[start]}-{self.node[end]}")
