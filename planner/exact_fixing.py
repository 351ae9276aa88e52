"""Reduced-cost fixing: which states no plan of interest passes.

With the penalties of an LP every plan costs at least L = Σ_i least_i − Σ p · capacity, and one
whose path for robot i passes a state s at least L − least_i + (least cost through s). If that
rounds up to the cutoff or more, no plan of interest (cheaper than the cutoff) passes s. The same
holds for two states of two robots: their excesses (least cost through s, minus least_i) together
must not exceed the *room* between L and the cutoff.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planner.cuts import arrival_conflict, state_exclusion
from planner.exact_pricing import Pricing
from planner.master import Column
from planner.parallel import each
from planner.search import INFINITE, NOTHING_FORBIDDEN

MAX_STATES = 50_000_000
"""Robots times states of G' above which no states are excluded: it would take too much memory."""


class Fixing:
    """States and arrivals of interest, robot by robot; never more of them than before.

    Args:
        pricing: of the search.
        stop: True leaves things as they are.

    Attributes:
        excluded: per robot, states of no interest as `Restriction.forbidden`, or shape (0, 0).
        room: two paths whose excesses sum up to more are not both part of a plan of interest.
        at: the (cutoff, bound) that it was done for last, None if it was not.
    """

    def __init__(self, pricing: Pricing, stop: Callable[[], bool] = lambda: False) -> None:
        self.pricing, self.stop = pricing, stop
        self.problem, self.graph = pricing.problem, pricing.search.graph
        self.n = self.problem.n_robots
        self.excluded: list[NDArray[np.bool_]] = [NOTHING_FORBIDDEN] * self.n
        self.room = INFINITE // 4
        self.at: tuple[int, int] | None = None
        self._window = [(0, self.problem.horizon)] * self.n
        self._excess: list[NDArray[np.int64]] = [np.empty((0, 0), np.int64)] * self.n
        self._arriving: list[NDArray[np.int64]] = [np.empty(0, np.int64)] * self.n

    @property
    def applies(self) -> bool:
        """Whether the tables fit into memory."""
        states = self.n * (self.problem.horizon + 1) * self.graph.n_nodes
        return states <= MAX_STATES

    def exclude(self, room_above: int, capacity: int) -> None:
        """Excludes states by the penalties loaded into `pricing`.

        Args:
            room_above: what a plan of interest costs at most [1/SCALE cost units].
            capacity: Σ p · capacity of the penalties.
        """
        graph, problem = self.graph, self.problem

        def through_allowed(i: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
            return self.pricing.through(i, forbidden=self.excluded[i])

        through = list(each(through_allowed, range(self.n), self.stop))
        if len(through) < self.n:
            return
        least = [int(t[1].min(initial=INFINITE)) for t in through]
        room = room_above - (sum(least) - capacity)
        self.room = room
        for i, (cost, arriving) in enumerate(through):
            out = cost > least[i] + room
            if self.excluded[i].shape[0]:
                out |= self.excluded[i][:, : graph.n_nodes]
            amid = np.zeros((problem.horizon + 1, problem.n_aps), np.bool_)
            self.excluded[i] = np.concatenate((out, amid), axis=1)
            when = np.flatnonzero(arriving <= least[i] + room)
            if len(when):
                self._window[i] = (int(when[0]), int(when[-1]))
            # The excesses are those of this LP; states excluded before stay excluded.
            self._excess[i] = self._by_vertex(np.where(out, INFINITE, cost - least[i]))
            self._arriving[i] = np.where(arriving < INFINITE, arriving - least[i], INFINITE)

    def n_states(self) -> int:
        """States of interest of all robots; of all there are, if none is excluded."""
        n = self.graph.n_nodes
        return sum(
            int(np.count_nonzero(~out[:, :n])) if out.shape[0] else (self.problem.horizon + 1) * n
            for out in self.excluded
        )

    def exclude_more(self, excluded: dict[int, NDArray[np.bool_]]) -> bool:
        """Excludes further states, (T+1, n) bool by robot; False if they all were."""
        before = self.n_states()
        for i, out in excluded.items():
            self.excluded[i][:, : self.graph.n_nodes] |= out
            gone = self._by_vertex(np.where(self.excluded[i][:, : self.graph.n_nodes], 1, 0)) == 1
            self._excess[i] = np.where(gone, INFINITE, self._excess[i])
        return self.n_states() < before

    @staticmethod
    def keeps(states: NDArray[np.int64], excluded: NDArray[np.bool_]) -> bool:
        """Whether a path of these states passes none of the excluded ones."""
        return not excluded.shape[0] or not excluded.ravel()[states].any()

    def states(self, column: Column) -> NDArray[np.int64]:
        """Where the states that a column's path stands in are in `excluded`, raveled."""
        path = column.path
        if path is None:
            return np.empty(0, np.int64)
        nodes = self.graph.node_of[path.vertices, path.aps]
        stands = np.ones(path.arrival + 1, bool)
        if np.any(self.problem.edge_slots > 1):
            stands[1:] = path.edges < 0  # a state amid an edge is none of G'
            stands[0] = True
        width = self.graph.n_nodes + self.problem.n_aps
        index: NDArray[np.int64] = np.arange(path.arrival + 1) * width + nodes
        return index[stands]

    def pair_states(self) -> state_exclusion.StateExclusions:
        """Which states of two robots exclude each other, of those of interest."""
        return state_exclusion.StateExclusions(
            self.problem, self._excess, self._arriving, self.room
        )

    def pair_conflicts(self) -> arrival_conflict.PairConflicts | None:
        """Where and when robots can be on paths of interest, by windows after the earliest.

        None when stopped.

        Clears the penalties.
        """
        problem, search = self.problem, self.pricing.search
        self.pricing.clear()
        excess, arrives, window, lasts = [], [], [], []
        for i in range(self.n):
            start = self.graph.nodes_at(int(problem.start[i]))
            first = int(search.distances[i].slots[start].min())
            lasts.append(first + arrival_conflict.SLACK)
        through = list(each(lambda i: self.pricing.through(i, lasts[i]), range(self.n), self.stop))
        if len(through) < self.n:
            return None
        for i, (cost, arriving) in enumerate(through):
            last = lasts[i]
            within = self._by_vertex(cost) < INFINITE
            there = arriving < INFINITE
            known = len(self._arriving[i]) > 0
            excess.append(np.where(within, self._excess[i] if known else 0, INFINITE))
            arrives.append(np.where(there, self._arriving[i] if known else 0, INFINITE))
            window.append(problem.horizon if self._window[i][1] <= last else last)
        return arrival_conflict.PairConflicts(problem, excess, arrives, self.room, window)

    def _by_vertex(self, cost: NDArray[np.int64]) -> NDArray[np.int64]:
        """(T+1, V) the least of a (T+1, n) array over each vertex's APs."""
        # Nodes are sorted by vertex; every vertex has one (§1.8).
        first = np.flatnonzero(np.diff(self.graph.node_vertex, prepend=-1))
        by_vertex: NDArray[np.int64] = np.minimum.reduceat(cost, first, axis=1)
        return by_vertex
