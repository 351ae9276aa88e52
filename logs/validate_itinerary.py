"""Step 3 of validation: the paths in force, slot by slot, and who goes before whom in them.

At first they are the plan's; a `NewPath` puts another in a robot's place. The order of visits is
found anew here, by walking every path and sorting who comes to each vertex and edge by time.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from logs.records import NewPath
from planner.plan import Plan
from planner.problem import Problem

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

FOR_GOOD = 2**40


@dataclass(frozen=True)
class Gate:
    """Who must have left a place before a transition into it.

    Attributes:
        robot: it.
        until: the state whose transition leaves the place.
        at_once: it may leave in the same slot.
    """

    robot: int
    until: int
    at_once: bool


@dataclass(frozen=True)
class Walk:
    """A robot's path; state k is due in slot base + k.

    Attributes:
        vertex, ap, edge: (τ+1,), edge −1 in the last state.
        piece: (τ+1,) slots of the crossing done in each state.
        to_goal: it ends at the goal.
    """

    vertex: Ints
    ap: Ints
    edge: Ints
    piece: Ints
    to_goal: bool

    @property
    def last(self) -> int:
        """Its last state."""
        return len(self.vertex) - 1


def walk_of(
    vertices: object, aps: object, edges: object, first_piece: int, to_goal: bool
) -> Walk | None:
    """A path as a walk; None if its columns do not fit each other."""
    vertex, ap, edge = (np.array(c, np.int64).reshape(-1) for c in (vertices, aps, edges))
    if not len(vertex) or len(ap) != len(vertex) or len(edge) != len(vertex) - 1:
        return None
    edge = np.append(edge, -1)
    piece = np.zeros(len(edge), np.int64)
    piece[0] = first_piece
    for k in range(1, len(edge)):
        same = edge[k] >= 0 and edge[k] == edge[k - 1] and vertex[k] == vertex[k - 1]
        piece[k] = piece[k - 1] + 1 if same else 0
    return Walk(vertex, ap, edge, piece, to_goal)


class Itinerary:
    """The paths in force.

    Attributes:
        base: slot in which they begin.
        walks: by robot, None for robots that are not on the floor.
    """

    def __init__(self, plan: Plan, problem: Problem, park: bool) -> None:
        self._problem, self._park = problem, park
        self.base = 0
        self.walks: list[Walk | None] = [
            None if p is None else walk_of(p.vertices, p.aps, p.edges, 0, True) for p in plan.paths
        ]
        self._gates: dict[tuple[int, int], Gate] | None = None

    def adopt(self, slot: int, paths: dict[int, NewPath]) -> list[int]:
        """New paths from a slot on; robots whose path makes no sense, which have none then."""
        self.base, self._gates = slot, None
        wrong = []
        for i in range(len(self.walks)):
            new = paths.get(i)
            walk = None
            if new is not None:
                walk = walk_of(new.vertices, new.aps, new.edges, new.piece, new.to_goal)
                if walk is None or not self.is_legal(walk):
                    wrong.append(i)
                    walk = None
            self.walks[i] = walk
        return wrong

    def is_legal(self, walk: Walk) -> bool:
        """Whether a walk goes along edges of G (§1.1)."""
        p = self._problem
        for column, size, low in (
            (walk.vertex, p.n_vertices, 0),
            (walk.ap, p.n_aps, 0),
            (walk.edge, p.n_edges, -1),
        ):
            if column.min() < low or column.max() >= size:
                return False
        for k in range(walk.last):
            here, after, edge = int(walk.vertex[k]), int(walk.vertex[k + 1]), int(walk.edge[k])
            expected = here
            if edge >= 0:
                u, v = p.edge_uv[edge].tolist()
                ahead = here == u or (here == v and not p.edge_oneway[edge])
                slots, piece = int(p.edge_slots[edge]), int(walk.piece[k])
                if not ahead or piece >= slots:
                    return False
                expected = u + v - here if piece == slots - 1 else here
                if piece < slots - 1 and walk.piece[k + 1] != piece + 1:
                    return False
            if after != expected:
                return False
        return True

    def next_vertex(self, i: int, visit: int) -> int:
        """Where the crossing of a state leads; its vertex if there is none."""
        walk = self.walks[i]
        assert walk is not None
        edge, vertex = int(walk.edge[visit]), int(walk.vertex[visit])
        return vertex if edge < 0 else int(self._problem.edge_uv[edge].sum()) - vertex

    def catch_up(self, i: int, visit: int, slot: int) -> int:
        """The state a late robot is at once it has left out waits that change nothing."""
        walk = self.walks[i]
        assert walk is not None
        while (
            visit < min(walk.last, slot - self.base)
            and walk.edge[visit] < 0
            and walk.ap[visit] == walk.ap[visit + 1]
        ):
            visit += 1
        return visit

    def begun(self, i: int, visit: int) -> int:
        """Crossings begun before a state."""
        walk = self.walks[i]
        assert walk is not None
        entered = (walk.edge[:visit] >= 0) & (walk.piece[:visit] == 0)
        return int(entered.sum()) + int(walk.piece[0] > 0)

    def gate(self, i: int, visit: int) -> Gate | None:
        """Who must go first before the transition of a state; None if nobody must."""
        if self._gates is None:
            self._gates = self._find_gates()
        return self._gates.get((i, visit))

    def _find_gates(self) -> dict[tuple[int, int], Gate]:
        stays: dict[int, list[tuple[int, int, int]]] = defaultdict(list)  # begin, robot, until
        crossings: dict[int, list[tuple[int, int, int]]] = defaultdict(list)
        slots = self._problem.edge_slots
        for i, walk in enumerate(self.walks):
            if walk is None:
                continue
            begin = 0 if walk.piece[0] == 0 else -1
            for k in range(walk.last + 1):
                edge = int(walk.edge[k])
                if edge < 0:
                    continue
                if walk.piece[k] == 0:
                    stays[int(walk.vertex[k])].append((begin, i, k))
                    if slots[edge] > 1:
                        crossings[edge].append((k, i, k + int(slots[edge]) - 1))
                elif k == 0:
                    crossings[edge].append((-1, i, int(slots[edge] - 1 - walk.piece[0])))
                if walk.piece[k] == slots[edge] - 1:
                    begin = k + 1
            until = FOR_GOOD if self._park or not walk.to_goal else walk.last
            stays[int(walk.vertex[-1])].append((begin, i, until))
        gates: dict[tuple[int, int], Gate] = {}
        for places, at_once in ((crossings, False), (stays, True)):
            for visits in places.values():
                visits.sort()
                for (_, j, until), (begin, i, _) in pairwise(visits):
                    transition = begin - 1 if at_once else begin
                    # A plan in which two are there at once has no order to keep to.
                    if i != j and transition >= 0 and until < max(begin, 0):
                        gates[i, transition] = Gate(j, until, at_once)
        return gates

    def shared(self) -> list[tuple[int, str, int, list[int]]]:
        """(slot, "vertex" or "edge", which, robots) wherever two paths are at one place at once."""
        found = []
        at_vertex: dict[tuple[int, int], list[int]] = defaultdict(list)
        on_edge: dict[tuple[int, int], list[int]] = defaultdict(list)
        walks = [(i, w) for i, w in enumerate(self.walks) if w is not None]
        longest = max((w.last for _, w in walks), default=0)
        for i, walk in walks:
            stays = self._park or not walk.to_goal
            for t in range(longest + 1 if stays else walk.last + 1):
                k = min(t, walk.last)
                if walk.piece[k] == 0:
                    at_vertex[t, int(walk.vertex[k])].append(i)
                if walk.edge[k] >= 0:
                    on_edge[t, int(walk.edge[k])].append(i)
        for kind, places in (("vertex", at_vertex), ("edge", on_edge)):
            for (t, place), robots in places.items():
                if len(robots) > 1:
                    found.append((self.base + t, kind, place, robots))
        return found
