"""Arrival-conflict cuts: of some robots, at most one can be early.

For robots i, j and slots a, b such that no two paths of i and j that keep §1.2 and §1.3 towards
each other have τ_i ≤ a and τ_j ≤ b, every plan satisfies

    Σ (paths of i with τ ≤ a) + Σ (paths of j with τ ≤ b) ≤ 1.

Proof: a plan has one path per robot, so the left side is 2 only if both are early, which those two
paths contradict. For a set K of robots with slots a_i in conflict pair by pair, at most one robot
of a plan can be early by the same argument, hence Σ_{i∈K} Σ (paths with τ ≤ a_i) ≤ 1. ∎

Where two robots meet in a one-lane passage, one of them waits for the other; the LP lets them pass
through each other half a path at a time, shifted by a slot. Here whoever passes later pays in full,
whatever the shape of the passage: corridors, rectangles and goals in the way are all pairs of
arrivals that exclude each other (compare Li, Harabor, Stuckey, Ma, Gange, Koenig, "Pairwise
symmetry reasoning for multi-agent path finding search", Artificial Intelligence 301, 2021, DOI
10.1016/j.artint.2021.103574, where each shape has a rule of its own).

Which pairs exclude each other is found by a sweep over all positions of the two
(`kernels_exact.pair_frontier`), within states through which a path that could still be part of a
better plan passes (reduced costs), by windows of `SLACK` slots after each one's earliest arrival.
AP capacities are left out of it: that can only miss conflicts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner import kernels_exact
from planner.cuts.pairs import interacting_pairs, neighbours, partners, sweep_ends
from planner.master import Column
from planner.parallel import each
from planner.problem import Problem
from planner.resources import Resources

SLACK = 10
"""Arrivals later than this many slots after the earliest are not looked at."""

MAX_STEPS = 8_000_000
"""A pair is left out when its sweep takes more steps."""


@dataclass(frozen=True)
class ArrivalConflictCut:
    """The row above; `arrivals` are (robot, slot) sorted by robot."""

    arrivals: tuple[tuple[int, int], ...]
    capacity: int = 1
    moves: tuple[tuple[int, int], ...] = ()
    places: tuple[tuple[int, int, tuple[int, ...]], ...] = ()


class PairConflicts:
    """Which arrivals of two robots exclude each other.

    Args:
        problem: all its edges must take one slot.
        excess: (T+1, V) int64 per robot: what a path costs at least above the robot's least cost
            if it stands there and arrives within its window; INFINITE where none does.
        arrives: (T+1,) int64 per robot, the same for arriving in a slot.
        room: two paths whose excesses sum up to more are not both part of a better plan.
        window: per robot, the last slot of its window; T if no path that matters arrives later.
    """

    def __init__(
        self,
        problem: Problem,
        excess: list[NDArray[np.int64]],
        arrives: list[NDArray[np.int64]],
        room: int,
        window: list[int],
    ) -> None:
        if np.any(problem.edge_slots > 1):
            raise ValueError("edges of several slots are not looked at")
        self.problem, self.excess, self.arrives, self.room = problem, excess, arrives, room
        self.window = window
        self._neighbours = neighbours(problem)
        self._frontiers: dict[tuple[int, int], NDArray[np.int32] | None] = {}

    def frontier(self, i: int, j: int) -> NDArray[np.int32] | None:
        """(T+1,) int32: the least arrival slot of j when i arrives by each slot, T+1 if never.

        None if it was not found out.
        """
        if (i, j) not in self._frontiers:
            self._keep((i, j), self._sweep((i, j)))
        return self._frontiers[i, j]

    def find_out(self, pairs: list[tuple[int, int]], stop: Callable[[], bool]) -> None:
        """Looks at pairs on all cores; some are left out if stopped."""
        new = [pair for pair in pairs if pair not in self._frontiers]
        for pair, found in zip(new, each(self._sweep, new, stop), strict=False):
            self._keep(pair, found)

    def _sweep(self, pair: tuple[int, int]) -> NDArray[np.int32]:
        problem, (i, j) = self.problem, pair
        found: NDArray[np.int32] = kernels_exact.pair_frontier(
            problem.horizon,
            *self._neighbours,
            self.excess[i],
            self.excess[j],
            self.arrives[i],
            self.arrives[j],
            self.room,
            sweep_ends(problem, pair),
            problem.at_goal == "park",
            MAX_STEPS,
        )
        return found

    def _keep(self, pair: tuple[int, int], found: NDArray[np.int32]) -> None:
        (i, j), T = pair, self.problem.horizon
        if found[0] < 0:
            self._frontiers[i, j] = self._frontiers[j, i] = None
            return
        one = np.minimum.accumulate(found).astype(np.int32)
        # The same staircase seen from j: the first slot of i whose entry is ≤ each slot.
        other = np.searchsorted(-one, -np.arange(T + 1), side="left").astype(np.int32)
        self._frontiers[i, j], self._frontiers[j, i] = one, other

    def latest_conflict(self, i: int, a: int, j: int) -> int:
        """The latest b such that τ_i ≤ a and τ_j ≤ b exclude each other; -1 if none is known."""
        frontier = self.frontier(i, j)
        if frontier is None or a > self.window[i]:
            return -1
        return min(int(frontier[a]) - 1, self.window[j])


def separate(
    conflicts: PairConflicts,
    columns: list[Column],
    x: NDArray[np.float64],
    resources: Resources,
    *,
    least: float = 0.02,
    stop: Callable[[], bool] = lambda: False,
) -> list[ArrivalConflictCut]:
    """Cuts a solution violates: for each pair the most violated one, grown to more robots.

    A pair's cut is extended by whichever robot adds most weight, as late as conflicts with all
    members allow, until none adds any. When stopped, those found so far.
    """
    T = conflicts.problem.horizon
    by = np.zeros((conflicts.problem.n_robots, T + 1))  # weight of paths that arrive by a slot
    for k in np.flatnonzero(x > 1e-9).tolist():
        path = columns[k].path
        if path is not None:
            by[columns[k].robot, path.arrival :] += x[k]
    pairs = interacting_pairs(columns, x, resources)
    near = partners(pairs)
    found: list[tuple[float, ArrivalConflictCut]] = []
    conflicts.find_out(pairs, stop)
    for i, j in pairs:
        if stop():
            break
        frontier = conflicts.frontier(i, j)
        if frontier is None:
            continue
        b = np.minimum(np.maximum(frontier, 1) - 1, conflicts.window[j])
        known = (frontier > 0) & (np.arange(T + 1) <= conflicts.window[i])
        total = np.where(known, by[i] + by[j][b], 0.0)
        a = int(np.argmax(total))
        if total[a] < 1.0 + least:
            continue
        # As late as the weight is reached: of equal a the first, then b as late as it goes.
        members = {i: a, j: int(b[a])}
        weight = float(total[a])
        while True:
            grown = _extend(conflicts, members, near, by)
            if grown is None:
                break
            members[grown[0]] = grown[1]
            weight += float(by[grown[0], grown[1]])
        _relax(conflicts, members)
        found.append((weight, ArrivalConflictCut(tuple(sorted(members.items())))))
    found.sort(key=lambda item: (-item[0], item[1].arrivals))
    return [cut for _, cut in found]


def _extend(
    conflicts: PairConflicts,
    members: dict[int, int],
    near: dict[int, set[int]],
    by: NDArray[np.float64],
) -> tuple[int, int] | None:
    best: tuple[float, int, int] | None = None
    common = set.intersection(*(near[i] for i in members)) - members.keys()
    for k in sorted(common):
        latest = min(conflicts.latest_conflict(i, a, k) for i, a in members.items())
        if (
            latest >= 0
            and by[k, latest] > 1e-6
            and (best is None or by[k, latest] > best[0] + 1e-9)
        ):
            best = float(by[k, latest]), k, latest
    return None if best is None else best[1:]


def _relax(conflicts: PairConflicts, members: dict[int, int]) -> None:
    """Moves every member's slot as late as the conflicts with the others allow."""
    for i in sorted(members):
        latest = min(conflicts.latest_conflict(j, b, i) for j, b in members.items() if j != i)
        members[i] = max(members[i], latest)
