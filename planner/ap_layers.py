"""The layered graph of APs along a motion that is fixed (§1.6, §1.7).

In slot t a robot may be served by the APs that cover where it is; between slots by what the rules
allow: an AP that covers the edge it crosses, a handover that the edge allows, the same AP amid an
edge of several slots, any change while waiting. An association is a path through these layers.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planner.plan import Path
from planner.problem import Problem

Bools = NDArray[np.bool_]
APs = NDArray[np.int32]
"""(τ+1,) serving AP of a robot in slots 0 … τ."""

UNREACHED = 1 << 40
"""More than any cost; small enough that sums over all slots stay far from overflow."""


class Layers:
    """The layered graph of one robot: which APs may serve it in each slot, and what may follow.

    Attributes:
        alive: (τ+1, A) bool, APs on some way from slot 0 to slot τ; all False if there is none.
        allowed: per slot t < τ (A, A) bool, AP in slot t to AP in slot t + 1, among those alive.
        stuck_at: the last slot that any way from slot 0 reaches, None if one reaches slot τ.
    """

    def __init__(self, problem: Problem, motion: Path) -> None:
        covered = problem.cover[motion.vertices]
        allowed = [transition(problem, motion, t) for t in range(motion.arrival)]
        reached = covered.copy()
        for t, step in enumerate(allowed):
            reached[t + 1] &= (reached[t][:, None] & step).any(axis=0)
        self.stuck_at: int | None = None
        if not reached[-1].any():
            self.stuck_at = int(np.flatnonzero(reached.any(axis=1)).max(initial=0))
        alive = reached
        for t in range(motion.arrival - 1, -1, -1):
            alive[t] &= (allowed[t] & alive[t + 1][None, :]).any(axis=1)
        self.alive: Bools = alive
        self.allowed = [a & alive[t][:, None] & alive[t + 1] for t, a in enumerate(allowed)]

    @property
    def arrival(self) -> int:
        """τ."""
        return len(self.allowed)

    @cached_property
    def from_start(self) -> NDArray[np.int64]:
        """(τ+1, A) fewest handovers from slot 0 to each state, `UNREACHED` where there is none."""
        return self._from_start(np.zeros(self.alive.shape, np.int64), 1)

    @cached_property
    def to_goal(self) -> NDArray[np.int64]:
        """(τ+1, A) fewest handovers from each state to slot τ, `UNREACHED` where there is none."""
        cost = np.full(self.alive.shape, UNREACHED)
        cost[-1][self.alive[-1]] = 0
        for t in range(self.arrival - 1, -1, -1):
            ways = np.where(self.allowed[t], cost[t + 1] + self._change, UNREACHED)
            cost[t] = np.minimum(ways.min(axis=1), UNREACHED)
        return cost

    @cached_property
    def _change(self) -> NDArray[np.int64]:
        return 1 - np.eye(self.alive.shape[1], dtype=np.int64)

    def _from_start(self, price: NDArray[np.int64], handover: int) -> NDArray[np.int64]:
        """(τ+1, A) least sum of prices of states and of handovers from slot 0 to each state."""
        price = np.where(self.alive, price, UNREACHED)
        cost = price.copy()
        for t, step in enumerate(self.allowed):
            ways = np.where(step, cost[t][:, None] + handover * self._change, UNREACHED)
            cost[t + 1] = np.minimum(ways.min(axis=0) + price[t + 1], UNREACHED)
        return cost

    def fewest_handovers(self) -> tuple[int, APs] | None:
        """The best association of this robot alone, and its handovers; None if it has none."""
        if not self.alive[0].any():
            return None
        aps = self._along(self.from_start, 1)
        return int(np.count_nonzero(np.diff(aps))), aps

    def cheapest(self, price: NDArray[np.int64], handover: int) -> APs | None:
        """The association of least cost where states have prices.

        Args:
            price: (τ+1, A) of each state, `UNREACHED` where the AP may not serve it.
            handover: price of one.
        """
        cost = self._from_start(price, handover)
        return None if cost[-1].min() >= UNREACHED else self._along(cost, handover)

    def _along(self, cost: NDArray[np.int64], handover: int) -> APs:
        """The way to the cheapest last state (of equals the lowest AP)."""
        aps = np.empty(self.arrival + 1, np.int32)
        aps[-1] = cost[-1].argmin()
        self._back(aps, self.arrival, cost, handover)
        return aps

    def complete(self, aps: APs, first: int, last: int) -> None:
        """Fills in what lies before slot `first` and after slot `last`, with fewest handovers."""
        self._back(aps, first, self.from_start, 1)
        for t in range(last, self.arrival):
            ways = self.to_goal[t + 1] + self._change[aps[t]]
            aps[t + 1] = np.where(self.allowed[t][aps[t]], ways, UNREACHED).argmin()

    def _back(self, aps: APs, t: int, cost: NDArray[np.int64], handover: int) -> None:
        """Fills in the cheapest way to the state of slot `t`."""
        for k in range(t - 1, -1, -1):
            ways = cost[k] + handover * self._change[:, aps[k + 1]]
            aps[k] = np.where(self.allowed[k][:, aps[k + 1]], ways, UNREACHED).argmin()


def transition(problem: Problem, motion: Path, t: int) -> Bools:
    """(A, A) bool: AP in slot t to AP in slot t + 1 of a motion, as §1.6 and §1.7 allow."""
    edge, v = int(motion.edges[t]), int(motion.vertices[t])
    covered = problem.cover[v]
    allowed: Bools
    if edge < 0:
        allowed = covered[:, None] & covered
        return allowed
    if motion.vertices[t + 1] == v:  # amid the edge: the AP of the vertex left serves until arrival
        allowed = np.diag(covered)
        return allowed
    allowed = problem.edge_handover[edge] | np.diag(problem.edge_cover[edge])
    return allowed if problem.edge_uv[edge, 0] == v else allowed.T
