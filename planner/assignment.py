"""The best AP assignment for motions that are fixed: fewest handovers within every capacity.

With its motion fixed, a robot's association is a path through the layers of `planner.ap_layers`.
One robot alone is a shortest path there, and the sum of these lengths bounds what all of them
need. Together robots compete for the places of the APs only. First they negotiate: those at a full
AP take their shortest paths anew, where places cost more the longer they are overfull (L. McMurchie
and C. Ebeling, "PathFinder", FPGA 1995, DOI 10.1145/201310.201328). Where capacity is not scarce
that ends at the bound, and so is proven best.

Else all of it is one multi-commodity flow with a row per AP and slot (§1.6), solved as an integer
program by the branch and bound of HiGHS through `scipy.optimize.milp`.

Column generation as in `planner.pgcp` would solve the same relaxation, but the whole program is
small here (some ten columns per robot and slot), and branch and bound then ends with a proof where
column generation would still need branching. Three things keep it small. A row enters when a
solution violates it: each program is a relaxation, so the first whose solution violates none is
solved for all rows. A robot is in the program from the first to the last slot in which it could
meet such a row; what comes before and after is its own shortest path, and its length a price. And
where all pairs of APs are allowed the |A|² handovers of a slot go through one node in between,
2·|A| arcs.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, milp

from planner.ap_layers import UNREACHED, APs, Bools, Layers
from planner.assignment_flow import FlowModel
from planner.errors import PlannerError
from planner.plan import Path
from planner.problem import Problem

DEAR = 1 << 20
"""Price of a handover that no congestion outweighs."""


@dataclass(frozen=True)
class Overload:
    """An AP that has to serve too many in some slots.

    Attributes:
        ap: its index.
        first, last: slots, both included.
        load: robots it would have to serve in one of them, at most.
    """

    ap: int
    first: int
    last: int
    load: int


@dataclass(frozen=True)
class Assignment:
    """APs for motions.

    Attributes:
        aps: per robot; None where it has no motion, or is left without an AP.
        handovers: of all of them together.
        bound: no assignment for the same robots has fewer; equal to `handovers` when proven best.
        stuck: (robot, slot) of those no AP can follow beyond that slot, even alone.
        overloads: where capacity is missing when as few places as possible are (robots times slots,
            or the fewest found within the limit); empty when no row of capacity is in the way.
        within_limit: whether the search ended by itself, and not at a limit of nodes or seconds.
    """

    aps: tuple[APs | None, ...]
    handovers: int
    bound: int
    stuck: tuple[tuple[int, int], ...] = ()
    overloads: tuple[Overload, ...] = ()
    within_limit: bool = True


def assign(
    problem: Problem,
    motions: Sequence[Path | None],
    *,
    max_nodes: int = 100_000,
    time_limit: float | None = None,
) -> Assignment:
    """The assignment with the fewest handovers for motions that keep the rules of motion.

    Where there is none for all of them, `stuck` and `overloads` say why, and those are served that
    are left when robots that take part in most overloads have gone.

    Args:
        problem: the instance.
        motions: one path per robot, whose APs are disregarded; None for robots left out.
        max_nodes: of branch and bound; decides the result the same way on every machine.
        time_limit: seconds, None for no limit.
    """
    begin = time.perf_counter()

    def limits() -> dict[str, float]:
        if time_limit is None:
            return {"node_limit": max_nodes}
        left = max(begin + time_limit - time.perf_counter(), 0.01)
        return {"node_limit": max_nodes, "time_limit": left}

    layers = {i: Layers(problem, m) for i, m in enumerate(motions) if m is not None}
    stuck = tuple((i, x.stuck_at) for i, x in layers.items() if x.stuck_at is not None)
    for i, _ in stuck:
        del layers[i]
    program = _Program(problem, layers)
    negotiated = program.negotiate()
    solution = program.solve(limits, negotiated)
    overloads: tuple[Overload, ...] = ()
    if solution.infeasible:
        elastic = program.solve(limits, None, elastic=True)
        overloads = program.overloads(elastic.aps)
        if elastic.aps:
            program = _Program(problem, program.without_overload(elastic.aps))
            negotiated = program.negotiate()
            solution = program.solve(limits, negotiated)
    aps, bound = solution.aps, solution.bound
    if len(aps) < len(program.layers):
        # Nothing was found within the limit: robot by robot around those before it.
        aps = negotiated or program.one_by_one()
        bound = bound if len(aps) == len(program.layers) else 0
    elif negotiated is not None and _handovers(negotiated) < _handovers(aps):
        aps = negotiated  # the limit came before the search had caught up
    handovers = _handovers(aps)
    return Assignment(
        aps=tuple(aps.get(i) for i in range(len(motions))),
        handovers=handovers,
        bound=bound,
        stuck=stuck,
        overloads=overloads,
        within_limit=not solution.at_limit,
    )


@dataclass
class _Solution:
    """What branch and bound found: APs per robot, empty if nothing."""

    aps: dict[int, APs] = field(default_factory=dict)
    bound: int = 0
    infeasible: bool = False
    at_limit: bool = False


class _Program:
    """The flow as an integer program.

    Args:
        problem: the instance.
        layers: of every robot that has a motion and is not stuck.
    """

    def __init__(self, problem: Problem, layers: dict[int, Layers]) -> None:
        self.problem, self.layers = problem, layers
        self.park = problem.at_goal == "park"
        # From the last arrival on the loads do not change, so one row stands for all later slots.
        self.last = max((x.arrival for x in layers.values()), default=0)
        self.possible = {i: self._over_time(x.alive) for i, x in layers.items()}
        self.alone = {
            i: best
            for i, x in layers.items()
            for best in [x.fewest_handovers()]
            if best is not None
        }

    def _over_time(self, states: Bools) -> Bools:
        """(last+1, A) of (τ+1, A): what parks stays, what leaves is gone."""
        rest = self.last + 1 - len(states)
        return np.vstack((states, np.repeat(states[-1:] & self.park, rest, axis=0)))

    def loads(self, aps: dict[int, APs]) -> NDArray[np.int64]:
        """(last+1, A) robots served."""
        total = np.zeros((self.last + 1, self.problem.n_aps), np.int64)
        for served in aps.values():
            total += self._over_time(served[:, None] == np.arange(self.problem.n_aps))
        return total

    def solve(
        self,
        limits: Callable[[], dict[str, float]],
        known: dict[int, APs] | None,
        *,
        elastic: bool = False,
    ) -> _Solution:
        """Solves it.

        Args:
            limits: options for HiGHS, asked before each of its runs.
            known: an assignment within capacity, if there is one.
            elastic: let capacities be exceeded, and make that all that costs.
        """
        aps = {i: served for i, (_, served) in self.alone.items()}
        bound = sum(handovers for handovers, _ in self.alone.values())
        if known is not None and _handovers(known) <= bound:
            return _Solution(known, bound)
        solution = _Solution(aps, bound)
        rows = np.zeros((self.last + 1, self.problem.n_aps), np.bool_)
        while True:
            violated = (self.loads(solution.aps) > self.problem.ap_capacity) & ~rows
            if not violated.any():
                return solution
            if solution.at_limit:
                return _Solution(bound=solution.bound, at_limit=True)
            rows |= violated
            found = self._solve_over(rows, limits(), elastic)
            found = replace(found, bound=max(found.bound, solution.bound))
            if found.infeasible or not found.aps:
                return found
            solution = found

    def _solve_over(self, rows: Bools, limits: dict[str, float], elastic: bool) -> _Solution:
        """Solves the relaxation that knows only some rows of capacity."""
        windows = {}
        for i, possible in self.possible.items():
            slots = np.flatnonzero((possible & rows).any(axis=1))
            if len(slots):
                tau = self.layers[i].arrival
                windows[i] = (min(int(slots[0]), tau), min(int(slots[-1]), tau))
        fixed = sum(handovers for i, (handovers, _) in self.alone.items() if i not in windows)
        model = FlowModel(
            {i: self.layers[i] for i in windows},
            windows,
            np.argwhere(rows),
            self.problem.ap_capacity,
            parked_until=self.last if self.park else None,
            elastic=elastic,
        )
        found = milp(
            model.cost,
            integrality=model.integral,
            bounds=Bounds(0, np.where(model.integral > 0, 1.0, np.inf)),
            constraints=model.constraints,
            options={"mip_rel_gap": 0.0, **limits},
        )
        if found.status == 2:
            return _Solution(infeasible=True)
        if found.status not in (0, 1):
            raise PlannerError(f"HiGHS ended the AP assignment with {found.message}; report this")
        bound = found.get("mip_dual_bound")
        finite = bound is not None and np.isfinite(bound)
        # Handovers are integers, so the bound may be rounded up (§1.13).
        proven = fixed + (max(0, int(np.ceil(bound - 1e-6))) if finite else 0)
        if found.x is None:
            return _Solution(bound=proven, at_limit=True)
        aps = {i: served for i, (_, served) in self.alone.items()}
        aps |= model.read(found.x > 0.5)
        return _Solution(aps, proven, at_limit=found.status == 1)

    def overloads(self, aps: dict[int, APs]) -> tuple[Overload, ...]:
        """Where an assignment exceeds a capacity, slots in a row together."""
        loads, capacity = self.loads(aps), self.problem.ap_capacity
        found = []
        for a in range(self.problem.n_aps):
            over = np.flatnonzero(loads[:, a] > capacity[a]).tolist()
            for _, run in groupby(enumerate(over), lambda pair: pair[1] - pair[0]):
                slots = [slot for _, slot in run]
                last = self.problem.horizon if self.park and slots[-1] == self.last else slots[-1]
                found.append(Overload(a, slots[0], last, int(loads[slots, a].max())))
        return tuple(sorted(found, key=lambda o: (o.first, o.ap)))

    def without_overload(self, aps: dict[int, APs]) -> dict[int, Layers]:
        """The robots that stay when those leave, one by one, that take part in most overloads."""
        every_ap = np.arange(self.problem.n_aps)
        use = {i: self._over_time(a[:, None] == every_ap) for i, a in aps.items()}
        loads = self.loads(aps)
        while True:
            over = loads > self.problem.ap_capacity
            if not over.any():
                return {i: self.layers[i] for i in use}
            worst = max(use, key=lambda i: (int((use[i] & over).sum()), -i))
            loads -= use.pop(worst)

    def negotiate(self, rounds: int = 60) -> dict[int, APs] | None:
        """An assignment within capacity, or None if the rounds do not lead to one.

        First among the robots' own fewest handovers only; what that finds is best. Then at the
        price of 16 rounds of congestion per handover.
        """
        return self._negotiate(rounds // 3, DEAR) or self._negotiate(rounds, 16)

    def _negotiate(self, rounds: int, handover: int) -> dict[int, APs] | None:
        """Robots at a full AP are planned anew one by one, until no AP is overfull.

        An overfull place costs them 1 more in every round it stays overfull.
        """
        capacity = self.problem.ap_capacity
        aps = {i: served for i, (_, served) in self.alone.items()}
        loads = self.loads(aps)
        history = np.zeros(loads.shape, np.int64)
        for _ in range(rounds):
            over = loads > capacity
            if not over.any():
                return aps
            history += over
            for i, x in self.layers.items():
                use = self._over_time(aps[i][:, None] == np.arange(len(capacity)))
                if not (use & (loads > capacity)).any():
                    continue
                loads -= use
                # One more robot than there is room for is what a place costs now.
                price = np.where(loads >= capacity, 1 + history, 0)
                better = x.cheapest(self._per_state(x, price), handover)
                aps[i] = aps[i] if better is None else better
                loads += self._over_time(aps[i][:, None] == np.arange(len(capacity)))
        return None

    def _per_state(self, x: Layers, price: NDArray[np.int64]) -> NDArray[np.int64]:
        """(τ+1, A) prices of a robot's states, its parking included in the last."""
        mine = price[: x.arrival + 1].copy()
        if self.park:
            mine[-1] = price[x.arrival :].sum(axis=0)
        return mine

    def one_by_one(self) -> dict[int, APs]:
        """Each robot's fewest handovers around those before it; robots without a place left out."""
        aps: dict[int, APs] = {}
        loads = np.zeros((self.last + 1, self.problem.n_aps), np.int64)
        for i, x in self.layers.items():
            full = loads >= self.problem.ap_capacity
            price = np.minimum(self._per_state(x, np.where(full, UNREACHED, 0)), UNREACHED)
            served = x.cheapest(price, 1)
            if served is not None:
                aps[i] = served
                loads += self.loads({i: served})
        return aps


def _handovers(aps: dict[int, APs]) -> int:
    return sum(int(np.count_nonzero(np.diff(served))) for served in aps.values())
