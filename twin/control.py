"""Who may make a transition in a slot, and why not: delays, failures, blockages, release.

A *release* is what a robot may do by itself (the base of an order in VDA 5050). In every slot that
finds it connected it is released to begin the next `release_horizon` crossings of its path; without
connection it finishes those, then stops. So a robot that has lost its connection can be held
(`BY_CONNECTION`) at a position, never on an edge.

A robot that fails stops at the next position it reaches. A robot holds before an edge on which it
could touch a blockage while it crosses it, or whose end is blocked then or in the slot after.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from logs.records import (
    BY_BLOCKAGE,
    BY_CONNECTION,
    BY_DELAY,
    BY_FAILURE,
    BY_NO_PATH,
    BY_ROBOT,
    CAUSES,
)

if TYPE_CHECKING:
    from planner.problem import Problem
    from twin.disturbances import Disturbances
    from twin.order import Commit, Policy, VisitOrder
    from worlds.world import World

Bools = NDArray[np.bool_]
Ints = NDArray[np.int32]

_NO_CAUSE = -1


class Control:
    """Decides slot by slot who advances.

    Attributes:
        policy: among those that are ready.
        late_until: (N,) int64, first slot after each robot's delay.
        released: (N,) int32, crossings of its path each robot may begin.
        failed: (N,) bool.
    """

    def __init__(
        self, world: World, problem: Problem, disturbances: Disturbances, policy: Policy
    ) -> None:
        n = problem.n_robots
        self._problem, self._disturbances = problem, disturbances
        self._horizon = world.run.release_horizon
        self._slots = np.append(problem.edge_slots, 1)
        self._longest = int(problem.edge_slots.max(initial=1))
        self.policy = policy
        self.late_until = np.zeros(n, np.int64)
        self.released: Ints = np.zeros(n, np.int32)
        self.failed: Bools = np.zeros(n, np.bool_)

    def begin_delays(self, slot: int, order: VisitOrder, at: Ints) -> list[tuple[int, int, str]]:
        """(robot, slots, event) of the delays that begin now and hold somebody up."""
        idle = order.done(at) | order.gone(at) | ((at == order.arrival) & order.to_goal)
        begun = []
        for i, slots, name in self._disturbances.delays(slot):
            if not idle[i] and self.late_until[i] <= slot:
                self.late_until[i] = slot + slots
                begun.append((i, slots, name))
        return begun

    def note_failures(self, slot: int) -> None:
        """Robots that have failed by now."""
        self.failed[self._disturbances.failed(slot)] = True

    def release(self, order: VisitOrder, at: Ints, connected: Bools) -> None:
        """Release further crossings to robots that are connected."""
        if not len(order.robot):
            return
        begun = order.begun[order.row(at)]
        self.released = np.where(connected, begun + self._horizon, self.released).astype(np.int32)

    def adopt(self, order: VisitOrder) -> None:
        """Another plan: what a route has is released, as far as it goes without connection.

        Routes of robots without connection end where their release ends (`twin.replan`).
        """
        if not len(order.robot):
            return
        last = np.maximum(order.arrival, 0)
        self.released = np.where(order.to_goal, self._horizon, order.begun[order.row(last)]).astype(
            np.int32
        )

    def decide(self, slot: int, order: VisitOrder, at: Ints) -> tuple[Commit, Ints, Bools]:
        """Who advances, why others do not, and who has something left to do.

        Returns:
            The commit; (N,) int32 index into `CAUSES`, −1 for none; (N,) bool unfinished.
        """
        n = len(at)
        unfinished = ~order.done(at) & ~order.gone(at)
        if not unfinished.any():
            commit = self.policy.decide(order, at, unfinished)
            return commit, np.full(n, _NO_CAUSE, np.int32), unfinished
        row = order.row(at)
        on_vertex, moves = order.piece[row] == 0, order.edge[row] >= 0
        enters = on_vertex & moves
        stuck = order.stuck(at)
        moves &= ~stuck
        because = {
            BY_FAILURE: self.failed & on_vertex,
            BY_DELAY: self.late_until > slot,
            BY_NO_PATH: stuck,
            BY_BLOCKAGE: moves & self._blocked(slot, order, row, moves & unfinished),
            BY_CONNECTION: enters & ~stuck & (order.begun[row] >= self.released),
        }
        cause = np.full(n, _NO_CAUSE, np.int32)
        for name in reversed(list(because)):
            cause[because[name]] = CAUSES.index(name)
        cause[~unfinished] = _NO_CAUSE
        # Who leaves the floor from its goal, or stays there, is not held up by anything.
        home = (at == order.arrival) & order.to_goal
        cause[home] = _NO_CAUSE
        ready = unfinished & (cause == _NO_CAUSE)
        commit = self.policy.decide(order, at, ready)
        waits = ready & ~commit.advance & (commit.waits_for >= 0)
        cause[waits] = CAUSES.index(BY_ROBOT)
        return commit, cause, unfinished

    def _blocked(self, slot: int, order: VisitOrder, row: Ints, moves: Bools) -> Bools:
        """(N,) bool, the transition of each robot of `moves` leads where a blockage is."""
        found = np.zeros(len(row), np.bool_)
        if not self._disturbances.blockages or not moves.any():
            return found
        i = np.flatnonzero(moves)
        edge, to = order.edge[row[i]], order.next_vertex[row[i]]
        left = self._slots[edge] - order.piece[row[i]]
        enters = order.piece[row[i]] == 0
        shut = np.zeros(len(i), np.bool_)
        for ahead in range(self._longest + 1):
            vertex, on_edge = self._disturbances.blocked(slot + ahead)
            # On the edge a robot goes on, slot by slot, as long as nothing is in its way.
            crossing = (ahead == 0) | (enters & (ahead < left))
            arrives = (ahead == left) | (ahead == left - 1)
            shut |= (crossing & on_edge[edge]) | (arrives & (enters | (left == 1)) & vertex[to])
        found[i] = shut
        return found
