"""State-exclusion cuts: of some robots, at most one can be in its set of states in a slot.

A robot's state in slot s is the vertex it stands at, or "arrived" (in s or before). Two states of
two robots exclude each other if no two paths that keep §1.2 and §1.3 towards each other pass
through them in slot s (mutexes, as in Zhang, Li, Surynek, Kumar, Koenig: "Multi-agent path finding
with mutex propagation", Artificial Intelligence 311, 2022, DOI 10.1016/j.artint.2022.103766). If
every state in F_i excludes every state in F_j, then

    Σ (paths of i in F_i in s) + Σ (paths of j in F_j in s) ≤ 1.

Proof: a plan has one path per robot, each in one state in s. If both are in their sets, their two
paths pass two states that exclude each other, although they keep the rules. For more robots with
sets that exclude each other pair by pair, at most one is in its set. ∎

In a passage where two robots meet: in any slot after the meeting either i is through, or j is.

Which states exclude each other is found by a sweep over all pairs of states
(`kernels_exact.pair_states`), of those only through which a path passes that could be part of a
better plan (reduced costs). AP capacities are left out of it: that can only miss some.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner import kernels_exact
from planner.cuts.pairs import (
    interacting_pairs,
    neighbours,
    partners,
    positive_by_robot,
    sweep_ends,
)
from planner.master import Column
from planner.parallel import each
from planner.plan import Path
from planner.problem import Problem
from planner.resources import Resources

MAX_STEPS = 8_000_000
"""A pair is left out when its sweep takes more steps."""

MAX_PATHS = 10
"""Paths of a robot, the likeliest, among which sets are looked for."""


@dataclass(frozen=True)
class StateExclusionCut:
    """The row above; see `Cut` for what its members are."""

    arrivals: tuple[tuple[int, int], ...]
    places: tuple[tuple[int, int, tuple[int, ...]], ...]
    capacity: int = 1
    moves: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class PairStates:
    """The states two robots i < j can be in together.

    Attributes:
        place_i, place_j: (T+1, V) int32, place of a vertex in a slot's matrix, -1 if of no
            interest.
        begin: (T+2,) int64, where each slot's matrix begins.
        both: the matrices [place of i, place of j] end to end; the last places are "arrived".
    """

    place_i: NDArray[np.int32]
    place_j: NDArray[np.int32]
    begin: NDArray[np.int64]
    both: NDArray[np.bool_]

    def matrix(self, slot: int) -> NDArray[np.bool_]:
        """(p, q) bool: the places of i and of j that are possible together."""
        p = int(self.place_i[slot].max(initial=-1)) + 2
        return self.both[self.begin[slot] : self.begin[slot + 1]].reshape(p, -1)


class StateExclusions:
    """Which states of two robots exclude each other; found when asked for, and kept.

    Args:
        problem: all its edges must take one slot.
        excess: (T+1, V) int64 per robot: what a path costs at least above the robot's least cost
            if it stands there, INFINITE where none does.
        arrives: (T+1,) int64 per robot, the same for arriving in a slot.
        room: two paths whose excesses sum up to more are not both part of a better plan.
    """

    def __init__(
        self,
        problem: Problem,
        excess: list[NDArray[np.int64]],
        arrives: list[NDArray[np.int64]],
        room: int,
    ) -> None:
        if np.any(problem.edge_slots > 1):
            raise ValueError("edges of several slots are not looked at")
        self.problem, self.excess, self.arrives, self.room = problem, excess, arrives, room
        self.allowed = [e <= room for e in excess]
        self._neighbours = neighbours(problem)
        self._pairs: dict[tuple[int, int], PairStates | None] = {}

    def pair(self, i: int, j: int) -> PairStates | None:
        """The states of i < j; None if not found out."""
        if (i, j) not in self._pairs:
            self._pairs[i, j] = self._sweep((i, j))
        return self._pairs[i, j]

    def find_out(self, pairs: list[tuple[int, int]], stop: Callable[[], bool]) -> None:
        """Looks at pairs on all cores; some are left out if stopped."""
        new = [pair for pair in pairs if pair not in self._pairs]
        for pair, found in zip(new, each(self._sweep, new, stop), strict=False):
            self._pairs[pair] = found

    def _sweep(self, pair: tuple[int, int]) -> PairStates | None:
        problem, (i, j) = self.problem, pair
        place_i, place_j, begin, both = kernels_exact.pair_states(
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
        return PairStates(place_i, place_j, begin, both) if len(both) else None

    def matrix(self, i: int, j: int, slot: int) -> NDArray[np.bool_] | None:
        """[place of i, place of j] possible together in a slot; None if not found out."""
        pair = self.pair(min(i, j), max(i, j))
        if pair is None:
            return None
        return pair.matrix(slot) if i < j else pair.matrix(slot).T

    def places(self, i: int) -> NDArray[np.int32]:
        """(T+1, V) place of each vertex; of every slot the last place is "arrived"."""
        place = np.cumsum(self.allowed[i], axis=1, dtype=np.int32) - 1
        place[~self.allowed[i]] = -1
        return place


def separate(
    exclusions: StateExclusions,
    columns: list[Column],
    x: NDArray[np.float64],
    resources: Resources,
    *,
    least: float = 0.05,
    stop: Callable[[], bool] = lambda: False,
) -> list[StateExclusionCut]:
    """Cuts a solution violates: for each pair the most violated one, grown to more robots.

    When stopped, those found so far.
    """
    problem = exclusions.problem
    T = problem.horizon
    likely: dict[int, tuple[NDArray[np.int64], NDArray[np.float64]]] = {}
    for i in range(problem.n_robots):
        likely[i] = np.empty((0, T + 1), np.int64), np.empty(0)
    for i, of_i in positive_by_robot(columns, x).items():
        top = sorted(of_i, key=lambda k: (-x[k], k))[:MAX_PATHS]
        place = exclusions.places(i)
        states = np.array([_states(columns[k].path, place) for k in top])
        likely[i] = states, x[top]
    pairs = interacting_pairs(columns, x, resources)
    near = partners(pairs)
    found: list[tuple[float, StateExclusionCut]] = []
    exclusions.find_out(pairs, stop)
    for i, j in pairs:
        if stop():
            break
        pair = exclusions.pair(i, j)
        if pair is None:
            continue
        (states_i, weight_i), (states_j, weight_j) = likely[i], likely[j]
        value, slot, bits = kernels_exact.best_exclusion_slot(
            pair.begin, pair.both, states_i, states_j, weight_i, weight_j, _n_places(pair.place_j)
        )
        if value < 1.0 + least:
            continue
        matrix = pair.matrix(slot)
        chosen = [int(states_i[k, slot]) for k in range(len(states_i)) if bits >> k & 1]
        other = [s for s in states_j[:, slot].tolist() if s >= 0 and not matrix[chosen, s].any()]
        members = {i: sorted(set(chosen)), j: sorted(set(other))}
        weight = float(value)
        while True:
            grown = _extend(exclusions, members, near, likely, slot)
            if grown is None:
                break
            weight += grown[0]
            members[grown[1]] = grown[2]
        _relax(exclusions, members, slot)
        found.append((weight, _cut(exclusions, members, slot)))
    found.sort(key=lambda item: (-item[0], item[1].arrivals, item[1].places))
    return [cut for _, cut in found]


def _n_places(place: NDArray[np.int32]) -> NDArray[np.int64]:
    """(T+1,) places per slot, "arrived" included."""
    places: NDArray[np.int64] = place.max(axis=1).astype(np.int64) + 2
    return places


def _states(path: Path | None, place: NDArray[np.int32]) -> NDArray[np.int64]:
    """(T+1,) the place of a path's state in each slot, -1 if it is of no interest."""
    assert path is not None
    states: NDArray[np.int64] = place.max(axis=1).astype(np.int64) + 1  # arrived
    on_way = np.arange(path.arrival)
    states[: path.arrival] = place[on_way, path.vertices[:-1]]
    return states


def _extend(
    exclusions: StateExclusions,
    members: dict[int, list[int]],
    near: dict[int, set[int]],
    likely: dict[int, tuple[NDArray[np.int64], NDArray[np.float64]]],
    slot: int,
) -> tuple[float, int, list[int]] | None:
    best: tuple[float, int, list[int]] | None = None
    for k in sorted(set.intersection(*(near[i] for i in members)) - members.keys()):
        free = _excluded_by(exclusions, members, k, slot)
        if free is None:
            continue
        states, weight = likely[k]
        inside = np.array([s >= 0 and bool(free[s]) for s in states[:, slot]], np.bool_)
        total = float(weight[inside].sum())
        if total > (best[0] if best else 0.0) + 1e-6:
            best = total, k, sorted(set(states[inside, slot].tolist()))
    return best


def _excluded_by(
    exclusions: StateExclusions, members: dict[int, list[int]], k: int, slot: int
) -> NDArray[np.bool_] | None:
    """(places of k,) bool: states that exclude all states of all members but k."""
    free: NDArray[np.bool_] | None = None
    for i, chosen in members.items():
        if i == k:
            continue
        matrix = exclusions.matrix(i, k, slot)
        if matrix is None:
            return None
        mine = np.asarray(~matrix[chosen].any(axis=0), np.bool_)
        free = mine if free is None else np.asarray(free & mine)
    return free


def _relax(exclusions: StateExclusions, members: dict[int, list[int]], slot: int) -> None:
    """Grows every set by all states that exclude those of the others."""
    for i in sorted(members, reverse=True):
        free = _excluded_by(exclusions, members, i, slot)
        if free is not None:
            members[i] = np.flatnonzero(free).tolist()


def _cut(
    exclusions: StateExclusions, members: dict[int, list[int]], slot: int
) -> StateExclusionCut:
    """The cut whose members are told by vertices and arrivals, every path in one way.

    A path that arrives in just this slot stands at its goal, but its state is "arrived".
    """
    problem = exclusions.problem
    parks = problem.at_goal == "park"
    arrivals, places = [], []
    for i, chosen in sorted(members.items()):
        at = np.flatnonzero(exclusions.allowed[i][slot])
        arrived = len(at) in chosen
        vertices: Iterable[int] = at[[s for s in chosen if s < len(at)]].tolist()
        goal = int(problem.goal[i])
        at_goal = goal in vertices
        if not (arrived and at_goal):
            vertices = [v for v in vertices if v != goal]
        if arrived and not at_goal:
            arrivals.append((i, slot))
        elif arrived and not parks:
            arrivals.append((i, slot - 1))
        places.append((i, slot, tuple(vertices)))
    return StateExclusionCut(tuple(arrivals), tuple(places))
