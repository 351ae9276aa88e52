"""Pricing of the exact search: an LP's duals as penalties, and what paths cost under them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner import kernels_exact
from planner.branching import Restriction
from planner.cuts import CutPool
from planner.master import LpSolution
from planner.plan import Path
from planner.resources import BLOCKED, SCALE, Resources
from planner.search import NO_ARRIVAL_PENALTY, NOTHING_FORBIDDEN, Penalties, Search


class Pricing:
    """Penalties on resources, moves, places and arrivals, and shortest paths under them.

    Args:
        search, resources: of the problem.
        pool: cuts, whose duals are penalties too.

    Attributes:
        penalties: on resources and moves, the same for all robots.
        at_arrival: per robot, (T+1,) penalty of arriving in a slot, or shape (0,).
    """

    def __init__(self, search: Search, resources: Resources, pool: CutPool) -> None:
        self.search, self.resources, self.pool = search, resources, pool
        self.problem = search.problem
        self.n = self.problem.n_robots
        self.penalties = Penalties(resources)
        self.at_arrival = [NO_ARRIVAL_PENALTY] * self.n
        self._places: list[list[tuple[int, NDArray[np.int64], int]]] = [[] for _ in range(self.n)]

    def clear(self) -> None:
        """No penalties at all."""
        self.penalties.clear()
        self.at_arrival = [NO_ARRIVAL_PENALTY] * self.n
        self._places = [[] for _ in range(self.n)]

    def load(self, lp: LpSolution) -> None:
        """Takes an LP's duals as penalties."""
        penalty = lp.penalty()
        self.clear()
        is_cut = lp.rows >= self.resources.n
        self.penalties.set(lp.rows[~is_cut], penalty[~is_cut])
        for number, amount in zip(lp.rows[is_cut].tolist(), penalty[is_cut].tolist(), strict=True):
            if amount == 0:
                continue
            cut = self.pool.cuts[number - self.resources.n]
            for robot, slot in cut.arrivals:
                if not len(self.at_arrival[robot]):
                    self.at_arrival[robot] = np.zeros(self.problem.horizon + 1, np.int64)
                self.at_arrival[robot][: slot + 1] += amount
            for slot, move in cut.moves:
                self.penalties.move[slot, move] += amount
            for robot, slot, vertices in cut.places:
                self._places[robot].append((slot, np.array(vertices, np.int64), amount))

    def shortest(
        self,
        i: int,
        kept: Restriction,
        *,
        scale: int,
        limit: int,
        use: NDArray[np.int32] | None,
    ) -> tuple[int, Path | None]:
        """Least-cost path of robot i that keeps its restriction; see `Search.shortest`."""
        slots, moves = kept.moves[:, 0], kept.moves[:, 1]
        before = self.penalties.move[slots, moves]
        self.penalties.move[slots, moves] = BLOCKED
        for slot, vertices, amount in self._places[i]:
            self.penalties.vertex[slot, vertices] += amount
        try:
            return self.search.shortest(
                i,
                self.penalties,
                scale=scale,
                limit=limit,
                use=use,
                forbidden=kept.forbidden,
                earliest=kept.earliest,
                latest=kept.latest,
                at_arrival=self.at_arrival[i],
            )
        finally:
            self.penalties.move[slots, moves] = before
            for slot, vertices, amount in self._places[i]:
                self.penalties.vertex[slot, vertices] -= amount

    def through(
        self,
        i: int,
        latest: int | None = None,
        forbidden: NDArray[np.bool_] = NOTHING_FORBIDDEN,
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """What robot i's paths cost at least through each state of G', and by arrival slot.

        Safe to call for several robots at a time.

        Args:
            i: the robot.
            latest: arrival slot of the paths that are looked at, None for T.
            forbidden: states not to be used, as `Search.shortest` takes them.

        Returns:
            (T+1, n) and (T+1,) int64, as `kernels_exact.costs_through`.
        """
        graph, problem, p = self.search.graph, self.problem, self.penalties
        last = int(self.search.latest[i])
        vertex = p.vertex.copy() if self._places[i] else p.vertex  # others read it at this time
        for slot, vertices, amount in self._places[i]:
            vertex[slot, vertices] += amount
        cost, arriving = kernels_exact.costs_through(
            problem.horizon,
            graph.arc_ptr,
            graph.arc_to,
            graph.arc_move,
            graph.arc_slots,
            graph.arc_cost,
            graph.node_vertex,
            graph.node_ap,
            graph.nodes_at(int(problem.start[i])),
            graph.nodes_at(int(problem.goal[i])),
            SCALE,
            vertex,
            p.move,
            p.ap,
            forbidden,
            problem.at_goal == "park",
            last if latest is None else min(last, latest),
            self.at_arrival[i],
        )
        return cost, arriving

    def own_penalties(
        self, i: int, kept: Restriction
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
        """Penalties of vertices and moves that hold for robot i, and its latest arrival."""
        vertex, move = self.penalties.vertex, self.penalties.move
        if self._places[i]:
            vertex = vertex.copy()  # others read it at this time
            for slot, vertices, amount in self._places[i]:
                vertex[slot, vertices] += amount
        if len(kept.moves):
            move = move.copy()
            move[kept.moves[:, 0], kept.moves[:, 1]] = BLOCKED
        return vertex, move, min(kept.latest, int(self.search.latest[i]))

    def behind(self, i: int, kept: Restriction) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """What robot i pays at least from each state on; see `kernels_exact.costs_behind`."""
        graph, problem = self.search.graph, self.problem
        vertex, move, last = self.own_penalties(i, kept)
        behind, ending = kernels_exact.costs_behind(
            problem.horizon,
            graph.arc_ptr,
            graph.arc_to,
            graph.arc_move,
            graph.arc_slots,
            graph.arc_cost,
            graph.node_vertex,
            graph.node_ap,
            graph.nodes_at(int(problem.goal[i])),
            SCALE,
            vertex,
            move,
            self.penalties.ap,
            kept.forbidden,
            problem.at_goal == "park",
            kept.earliest,
            last,
            self.at_arrival[i],
        )
        return behind, ending
