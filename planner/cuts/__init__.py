"""Cuts: rows valid for every plan (or every plan that could still improve) that cut LP optima off.

One file per family, with its proof. A cut here is Σ x over its member paths ≤ its capacity, and is
*robust*: membership can be told by adding up penalties along a path, so pricing stays a shortest
path. There are three kinds of members: paths with a certain move in a certain slot, paths of a
certain robot that arrive by a certain slot, and those that stand at certain vertices in a slot.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planner.plan import Path
from planner.problem import Problem


class Cut(Protocol):
    """What a family's cuts have in common. No path may be a member in two ways."""

    @property
    def capacity(self) -> int:
        """Right-hand side."""

    @property
    def arrivals(self) -> tuple[tuple[int, int], ...]:
        """(robot, slot): its paths that arrive by then are members."""

    @property
    def moves(self) -> tuple[tuple[int, int], ...]:
        """(slot, move): paths with any of them are members."""

    @property
    def places(self) -> tuple[tuple[int, int, tuple[int, ...]], ...]:
        """(robot, slot, vertices): its paths that stand, or are parked, there are members."""


class CutPool:
    """All cuts found, to be numbered as the master numbers them: on from `first`."""

    def __init__(self, problem: Problem, first: int) -> None:
        self.problem = problem
        self.first = first
        self.cuts: list[Cut] = []
        self._known: set[object] = set()
        self._by_move: dict[tuple[int, int], list[int]] = {}
        self._by_robot: dict[int, list[tuple[int, int]]] = {}
        self._by_place: dict[int, list[tuple[int, frozenset[int], int]]] = {}

    def add(self, cuts: list[Cut]) -> list[Cut]:
        """Adds those not there yet, and returns them."""
        fresh = [cut for cut in dict.fromkeys(cuts) if cut not in self._known]
        for cut in fresh:
            number = self.first + len(self.cuts)
            self.cuts.append(cut)
            self._known.add(cut)
            for place in cut.moves:
                self._by_move.setdefault(place, []).append(number)
            for robot, slot in cut.arrivals:
                self._by_robot.setdefault(robot, []).append((slot, number))
            for robot, slot, vertices in cut.places:
                entry = slot, frozenset(vertices), number
                self._by_place.setdefault(robot, []).append(entry)
        return fresh

    def of(self, robot: int, path: Path, *, since: int = 0) -> NDArray[np.int64]:
        """Numbers of the cuts a path is a member of, of those numbered `since` and later."""
        numbers = [k for slot, k in self._by_robot.get(robot, ()) if path.arrival <= slot]
        tau, parks = path.arrival, self.problem.at_goal == "park"
        vertices = path.vertices.tolist()
        for slot, there, number in self._by_place.get(robot, ()):
            if (slot <= tau or parks) and vertices[min(slot, tau)] in there:
                numbers.append(number)
        if self._by_move:
            for place in enumerate(moves_of(self.problem, path).tolist()):
                numbers += self._by_move.get(place, ())
        return np.array([k for k in numbers if k >= since], np.int64)


def moves_of(problem: Problem, path: Path) -> NDArray[np.int64]:
    """What a path's body does in each slot, as `ExpandedGraph.arc_move` says; parking is waiting.

    Returns:
        (τ,) int64, or (T,) under `park`.
    """
    edges = path.edges.astype(np.int64)
    left = path.vertices[:-1].astype(np.int64)  # on an edge of k slots it stands k times
    E = problem.n_edges
    moves = 2 * E + left
    crossing = edges >= 0
    back = left[crossing] != problem.edge_uv[edges[crossing], 0]
    moves[crossing] = 2 * edges[crossing] + back
    if problem.at_goal == "park":
        rest = np.full(problem.horizon - path.arrival, 2 * E + int(path.vertices[-1]))
        moves = np.concatenate((moves, rest))
    return moves


__all__ = ["Cut", "CutPool", "moves_of"]
