"""`Hall`: the floor, the positions on it (a grid, or a graph of lanes), the robots' bodies."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from worlds.errors import Fault, Key
from worlds.part import Part, given, listed, nearest
from worlds.scalars import MAX_POSITIONS, Count, Id, Length, Metres2, Speed


class Body(Part):
    """The box every robot is, standing on the floor [m]."""

    length_m: float = Field(default=0.8, gt=0, le=20, description="along its heading")
    width_m: float = Field(default=0.6, gt=0, le=20, description="across")
    height_m: float = Field(default=0.4, gt=0, le=20, description="from the floor")
    antenna_m: float = Field(
        default=0.5, gt=0, le=20, description="height of the antenna, on the robot's centre"
    )


class GraphNode(Part):
    """A position of the graph."""

    id: Id = Field(description="its name, unique in the graph")
    at_m: Metres2 = Field(description="x and y in the graph's own frame, see `offset_m`")


class GraphEdge(Part):
    """A lane, driven from `start` to `end`; with a second edge back it is driven both ways."""

    id: Id = Field(description="its name, unique in the graph")
    start: Id = Field(description="id of the node it leads from")
    end: Id = Field(description="id of the node it leads to")
    speed_m_s: Speed | None = Field(
        default=None, description="no robot is faster there; no limit when left out"
    )


class Graph(Part):
    """Positions and lanes as a fleet manager has them, instead of a grid.

    Lanes are straight. Crossing one takes length / (speed x `slot_s`) slots, rounded up. Two edges
    in opposite directions are one lane driven both ways, at the lower of their speeds; a single
    edge is one-way.
    """

    exactly_one: ClassVar[tuple[str, ...]] = ("lif", "node")

    lif: str | None = Field(
        default=None,
        min_length=1,
        description="a VDMA LIF 1.0 file (JSON) to take nodes, edges and stations from; relative "
        "to this file",
    )
    layout: Id | None = Field(
        default=None, description="id of the LIF layout; the only one when left out"
    )
    vehicle: Id | None = Field(
        default=None, description="id of the LIF vehicle type; the only one when left out"
    )
    offset_m: Metres2 = Field(
        default=(0.0, 0.0), description="what is added to the graph's x and y to get the hall's"
    )
    speed_m_s: Speed = Field(default=1.0, description="of the robots where a lane allows it")
    node: tuple[GraphNode, ...] = ()
    edge: tuple[GraphEdge, ...] = ()
    remarks: tuple[str, ...] = Field(
        default=(), description="what was noticed on reading the LIF file; `twin check` tells"
    )

    def faults(self) -> list[Fault]:
        """Ids, ends and lengths must fit together."""
        if not self.node and self.lif is None:
            return [Fault(("node",), "the graph has no nodes; give some ([[hall.graph.node]])")]
        return graph_faults(self.node, self.edge)

    def xy_m(self) -> NDArray[np.float64]:
        """(P, 2) float64, the nodes' places in the hall [m]."""
        offset = np.array(self.offset_m)
        places = np.array([node.at_m for node in self.node], dtype=np.float64).reshape(-1, 2)
        return np.asarray(places + offset)

    def index(self) -> dict[str, int]:
        """Place in `node` by id."""
        return {node.id: i for i, node in enumerate(self.node)}

    def ends(self) -> NDArray[np.intp]:
        """(D, 2) intp, the nodes each edge leads from and to."""
        index = self.index()
        ends = [(index[edge.start], index[edge.end]) for edge in self.edge]
        return np.array(ends, dtype=np.intp).reshape(-1, 2)

    def length_m(self) -> NDArray[np.float64]:
        """(D,) float64, how long each edge is [m]."""
        xy, ends = self.xy_m(), self.ends()
        way = xy[ends[:, 1]] - xy[ends[:, 0]]
        return np.asarray(np.hypot(way[:, 0], way[:, 1]))

    @property
    def spacing_m(self) -> float:
        """Typical distance of neighbouring nodes, the median of the edges' lengths [m]."""
        return float(np.median(self.length_m())) if self.edge else 1.0


def graph_faults(node: tuple[GraphNode, ...], edge: tuple[GraphEdge, ...]) -> list[Fault]:
    """What does not fit together in a graph; keys are ("node", 3, "id") or ("edge", 5, "end")."""
    faults: list[Fault] = []
    at: dict[str, Metres2] = {}
    for i, n in enumerate(node):
        if n.id in at:
            faults.append(
                Fault(("node", i, "id"), f"'{n.id}' is the id of an earlier node already")
            )
        at.setdefault(n.id, n.at_m)
    ids: set[str] = set()
    ways: dict[tuple[str, str], str] = {}
    known = list(at)
    for i, e in enumerate(edge):
        if e.id in ids:
            faults.append(
                Fault(("edge", i, "id"), f"'{e.id}' is the id of an earlier edge already")
            )
        ids.add(e.id)
        dangling = [key for key in ("start", "end") if getattr(e, key) not in at]
        for key in dangling:
            name = getattr(e, key)
            mend = nearest(name, known) or " add it, or take the edge out"
            rule = f"'{name}' is not the id of a node;{mend}"
            faults.append(Fault(("edge", i, key), rule))
        if dangling:
            continue
        if e.start == e.end:
            rule = f"'{e.id}' leads from '{e.start}' to itself; take it out"
            faults.append(Fault(("edge", i, "end"), rule))
        elif math.dist(at[e.start], at[e.end]) < 1e-6:
            rule = f"'{e.id}' has no length: '{e.start}' and '{e.end}' are at the same place"
            faults.append(Fault(("edge", i), f"{rule}; make them one node, or mend one's x and y"))
        elif (e.start, e.end) in ways:
            rule = f"'{e.id}' leads from '{e.start}' to '{e.end}' as '{ways[e.start, e.end]}' does"
            faults.append(Fault(("edge", i), f"{rule}; keep one of them"))
        ways.setdefault((e.start, e.end), e.id)
    return faults


class Hall(Part):
    """The floor: a rectangle from (0, 0) to `size_m`, with a square grid of positions, or a graph.

    For a grid give `pitch_m` or `positions` (columns, rows). The first position lies `margin_m`
    from the walls (half a pitch when left out). A slot lasts `slot_s`, or pitch / `speed_m_s`; with
    a graph, whose lanes have their own speeds, `slot_s` or one second.
    """

    exactly_one: ClassVar[tuple[str, ...]] = ("pitch_m", "positions", "graph")
    at_most_one: ClassVar[tuple[str, ...]] = ("slot_s", "speed_m_s")

    size_m: tuple[Length, Length] = Field(description="width and depth of the floor")
    pitch_m: float | None = Field(
        default=None, ge=0.01, le=100, description="distance of neighbouring positions"
    )
    positions: tuple[Count, Count] | None = Field(
        default=None, description="columns and rows, instead of `pitch_m`"
    )
    margin_m: float | None = Field(
        default=None,
        ge=0,
        le=2500,
        description="from the walls to the first position; half a pitch when left out",
    )
    slot_s: float | None = Field(
        default=None, ge=0.001, le=3600, description="length of a slot; pitch / speed when left out"
    )
    speed_m_s: Speed | None = Field(default=None, description="1 m/s when left out")
    graph: Graph | None = None
    body: Body = Body()

    def spacing_m(self) -> tuple[float | None, float | None]:
        """Distance of the columns and of the rows [m]; None where there is only one."""
        if self.positions is None:
            return self.pitch_m, self.pitch_m
        if self.margin_m is None:  # half a pitch at both ends
            return self.size_m[0] / self.positions[0], self.size_m[1] / self.positions[1]
        between = [
            (size - 2 * self.margin_m) / (count - 1) if count > 1 else None
            for size, count in zip(self.size_m, self.positions, strict=True)
        ]
        return between[0], between[1]

    @property
    def grid_pitch_m(self) -> float:
        """The pitch of the grid of positions [m], given or from `positions`.

        On a graph the typical length of a lane.
        """
        if self.graph is not None:
            return self.graph.spacing_m
        x, y = self.spacing_m()
        return x or y or math.nan  # `faults` refuses a hall without either

    @property
    def grid_margin_m(self) -> float:
        """Distance of the first position from the walls [m]."""
        return self.grid_pitch_m / 2 if self.margin_m is None else self.margin_m

    @property
    def grid_positions(self) -> tuple[int, int]:
        """Columns and rows of the grid; (0, 0) on a graph."""
        if self.graph is not None:
            return 0, 0
        if self.positions is not None:
            return self.positions
        pitch, margin = self.grid_pitch_m, self.grid_margin_m
        # 1e-9: a hall of 60 m with a pitch of 0.1 m has all its 600 columns despite rounding.
        columns, rows = (math.floor((s - 2 * margin) / pitch + 1e-9) + 1 for s in self.size_m)
        return columns, rows

    @property
    def grid_slot_s(self) -> float:
        """Length of a slot [s]: given, or pitch / speed (1 m/s when left out); 1 s on a graph."""
        if self.graph is not None and self.slot_s is None:
            return 1.0
        return self.slot_s if self.slot_s is not None else self.grid_pitch_m / (self.speed_m_s or 1)

    def faults(self) -> list[Fault]:
        """The grid must be square, not empty, and fit memory."""
        if self.graph is not None:
            return self._graph_faults(self.graph)
        if self.positions is not None:
            spacing = self.spacing_m()
            if spacing == (None, None):
                rule = "is a single position, which says nothing about the pitch; give pitch_m"
                return [Fault(("positions",), f"{list(self.positions)} {rule}")]
            known = [d for d in spacing if d is not None]
            if min(known) <= 0:
                return [self._margin_too_wide()]
            if not math.isclose(known[0], known[-1], rel_tol=1e-6):
                rule = f"puts columns {known[0]:.6g} m and rows {known[-1]:.6g} m apart"
                mend = "the grid is square: match the ratio of size_m, or give pitch_m instead"
                return [Fault(("positions",), f"{list(self.positions)} {rule}; {mend}")]
        columns, rows = self.grid_positions
        if min(columns, rows) < 1:
            if self.margin_m is not None:
                return [self._margin_too_wide()]
            rule = f"is larger than the hall ({self.size_m[0]:g} m x {self.size_m[1]:g} m)"
            return [Fault(("pitch_m",), f"{self.pitch_m} {rule}; give a smaller pitch")]
        if columns * rows > MAX_POSITIONS:
            rule = f"makes {columns} x {rows} positions, more than {MAX_POSITIONS}"
            mend = "give a larger pitch, and check that all lengths are metres"
            at = "positions" if self.positions is not None else "pitch_m"
            return [Fault((at,), f"{given(self, at)} {rule}; {mend}")]
        return []

    def _graph_faults(self, graph: Graph) -> list[Fault]:
        """Keys of a grid make no sense beside a graph; its nodes must lie in the hall."""
        faults = []
        for key, mend in (
            ("speed_m_s", "give hall.graph.speed_m_s"),
            ("margin_m", "nodes have places of their own"),
        ):
            if getattr(self, key) is not None:
                faults.append(Fault((key,), f"is for a grid, here is a graph; {mend}"))
        xy = graph.xy_m()
        out = np.flatnonzero(((xy < 0) | (xy > np.array(self.size_m))).any(axis=1))
        for i in out[:3].tolist():
            x, y = xy[i].tolist()
            rule = f"[{x:g}, {y:g}] puts '{graph.node[i].id}' outside the hall of "
            rule += f"{self.size_m[0]:g} m x {self.size_m[1]:g} m"
            mend = "correct hall.size_m or hall.graph.offset_m, and check that lengths are metres"
            faults.append(Fault(("graph", "node", i, "at_m"), f"{rule}; {mend}"))
        if len(out) > 3:
            rule = f"{len(out) - 3} more nodes are outside the hall"
            faults.append(Fault(("graph", "node"), rule))
        return faults

    def _margin_too_wide(self) -> Fault:
        rule = f"leaves no floor in a hall of {self.size_m[0]:g} m x {self.size_m[1]:g} m"
        return Fault(("margin_m",), f"{self.margin_m} {rule}; give a smaller margin")


def graph_misfits(data: Mapping[str, object]) -> list[Fault]:
    """Nodes that there are none of, cells where there is no grid."""
    faults: list[Fault] = []
    graph = given(given(data, "hall"), "graph")
    names = [given(node, "id") for node in listed(graph, "node")]
    known = [name for name in names if isinstance(name, str)]
    exists = set(known)
    asked: list[tuple[Key, object]] = []
    for i, station in enumerate(listed(data, "station")):
        asked += [(("station", i, "nodes", k), n) for k, n in enumerate(listed(station, "nodes"))]
    for i, robot in enumerate(listed(data, "robot")):
        for end in ("start", "goal"):
            asked.append((("robot", i, end), given(given(robot, end), "node")))
    for key, name in asked:
        if not isinstance(name, str) or name in exists:
            continue
        if graph is None:
            mend = "; a grid has cells, give cell or at_m"
            faults.append(Fault(key, f"'{name}' is a node, but the hall has no graph{mend}"))
        elif known:
            mend = nearest(name, known) or f" known are {', '.join(known[:8])}"
            faults.append(Fault(key, f"'{name}' is not a node of the graph;{mend}"))
    if graph is not None and given(data, "obstacles") is not None:
        rule = "are drawn on the positions of a grid, here is a graph; list [[obstacle]]s"
        faults.append(Fault(("obstacles",), rule))
    return faults
