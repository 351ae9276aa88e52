"""The floor of a hall whose positions are a graph: its free nodes and lanes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from worlds.boxes import footprint_hits, swept
from worlds.floor import Boxes, Floor
from worlds.hall import Graph
from worlds.world import World

RASTER_CELLS = 40_000
"""Cells of the raster that stands in for a grid in pictures, at most."""

LEAST_RASTER_M = 0.2

Ints = NDArray[np.intp]


def graph_floor(world: World, graph: Graph, boxes: Boxes, robot_height_m: float) -> Floor:
    """Vertices, edges and traversal times of a hall with a graph, without robots.

    A lane is free if the strip a robot sweeps on it, half its length beyond both ends, touches no
    obstacle. A node is free if a lane at it is, or, for a node without lanes, the square of the
    body's longer side. So unlike on a grid a robot need not have room for all headings, only for
    those it can have. Vertices are the free nodes and edges the free lanes, in the graph's order;
    an edge that two opposite lanes make runs as the first of them.
    """
    xy = graph.xy_m()
    body = world.hall.body
    ends, oneway, slots = lanes(graph, world.hall.grid_slot_s)
    strip = swept(xy[ends[:, 0]], xy[ends[:, 1]], body.length_m, body.width_m)
    free = footprint_hits(boxes, *strip, body_height_m=robot_height_m) < 0
    half = max(body.length_m, body.width_m) / 2
    stands = footprint_hits(boxes, xy, (half, half), body_height_m=robot_height_m) < 0
    stands[ends.ravel()] = False
    stands[ends[free].ravel()] = True
    node = np.flatnonzero(stands).astype(np.int32)
    vertex = np.full(len(xy), -1, dtype=np.int32)
    vertex[node] = np.arange(len(node))
    raster = _raster_m(world.hall.size_m)
    columns, rows = (max(1, math.ceil(size / raster - 1e-9)) for size in world.hall.size_m)
    cell = np.clip(np.floor(xy[node] / raster), 0, (columns - 1, rows - 1)).astype(np.int32)
    none = np.empty(0, dtype=np.int32)
    floor = Floor(
        pitch_m=min(graph.spacing_m, 2.5 * body.length_m),
        slot_s=world.hall.grid_slot_s,
        columns=columns,
        rows=rows,
        boxes=boxes,
        vertex_xy_m=xy[node],
        vertex_cell=cell,
        edge_uv=np.ascontiguousarray(vertex[ends[free]]).reshape(-1, 2),
        edge_slots=slots[free],
        edge_oneway=oneway[free],
        robot_ids=(),
        start=none,
        goal=none,
        raster_m=raster,
        node=node,
        node_id=tuple(graph.node[i].id for i in node.tolist()),
    )
    for array in (cell, node, none, floor.vertex_xy_m, floor.edge_uv, floor.edge_slots):
        array.flags.writeable = False
    floor.edge_oneway.flags.writeable = False
    return floor


def lanes(graph: Graph, slot_s: float) -> tuple[Ints, NDArray[np.bool_], NDArray[np.int32]]:
    """The graph's edges, each with its opposite one as one lane.

    A lane driven both ways takes as long as in its slower direction, since §1.1 has one traversal
    time per edge.

    Args:
        graph: with at most one edge from one node to another.
        slot_s: length of a slot [s].

    Returns:
        (E, 2) nodes, (E,) whether it is one-way, (E,) int32 slots, in the order of the edges.
    """
    speed = np.array([min(e.speed_m_s or math.inf, graph.speed_m_s) for e in graph.edge])
    slots = traversal_slots(graph.length_m(), speed.reshape(-1), slot_s)
    index: dict[tuple[int, int], int] = {}
    ends: list[tuple[int, int]] = []
    oneway: list[bool] = []
    taken: list[int] = []
    for (u, v), k in zip(graph.ends().tolist(), slots.tolist(), strict=True):
        back = index.get((v, u))
        if back is not None:
            oneway[back] = False
            taken[back] = max(taken[back], k)
            continue
        index[u, v] = len(ends)
        ends.append((u, v))
        oneway.append(True)
        taken.append(k)
    return (
        np.array(ends, dtype=np.intp).reshape(-1, 2),
        np.array(oneway, dtype=np.bool_),
        np.array(taken, dtype=np.int32),
    )


def traversal_slots(
    length_m: NDArray[np.float64], speed_m_s: NDArray[np.float64], slot_s: float
) -> NDArray[np.int32]:
    """(E,) slots to cross lanes: ceil(length / (speed · slot)), at least 1 (§1.1).

    What exceeds a whole number by rounding only, a millionth, does not count.
    """
    slots = np.ceil(length_m / (speed_m_s * slot_s) - 1e-6)
    return np.maximum(slots, 1).astype(np.int32)


def _raster_m(size_m: tuple[float, float]) -> float:
    """Side of the raster's cells [m]; of the hall alone, since shadow fading is drawn per cell."""
    return max(LEAST_RASTER_M, math.sqrt(size_m[0] * size_m[1] / RASTER_CELLS))
