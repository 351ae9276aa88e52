"""The least horizon, and the least AP capacity, at which a problem has a plan.

More slots or more room never hurt, so both are searched by bisection. Each candidate is solved, or
proven to have no plan, or neither: then the answer is a range, not a number.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.cooperative import cooperative_with_restarts
from planner.expanded_graph import ExpandedGraph
from planner.improve import LargeNeighbourhoodSearch
from planner.phase_one import prove_infeasible
from planner.plan import Path
from planner.problem import Problem
from planner.resources import Resources
from planner.search import Search
from planner.solve import SolveParams, solve
from planner.validation import MAX_HORIZON, MAX_PATH_COST

Decide = Callable[[Problem], bool | None]
"""Whether a problem has a plan; None if undecided."""

RESTARTS = 10
BATCH = 100
FEW = 10
"""Up to so many robots the tree search is asked where nothing else decides."""
NODES = 300
"""Of its tree, at most."""
ANY_GAP = 1e12
"""With a gap of this size `solve` ends with the first plan for all robots."""


@dataclass(frozen=True)
class Least:
    """The least value of something at which there is a plan.

    Attributes:
        lower: no plan exists below it: proven.
        upper: there is a plan at it; None if none was found up to `tried`.
        tried: the largest value looked at.
        never: proven: no value is enough.
    """

    lower: int
    upper: int | None
    tried: int
    never: bool = False

    @property
    def exact(self) -> bool:
        """It is known to the unit."""
        return self.upper == self.lower


class Decider:
    """Says whether problems of one family (horizon and capacities vary) have a plan.

    Cheap ways first: robots alone, cooperative A* over several orders, a short neighbourhood
    search, the phase-1 proof (§1.12), a longer search; for few robots, the exact tree search.
    Where the relaxation has a solution it has one with more slots or room too, so no proof is
    looked for there again. Deterministic by seed and iterations unless stopped.

    Args:
        seed: of the random choices.
        iterations: neighbourhoods tried.
        stop: asked now and then; True gives up.
    """

    def __init__(
        self, *, seed: int = 0, iterations: int = 2000, stop: Callable[[], bool] = lambda: False
    ) -> None:
        self.seed, self.iterations, self.stop = seed, iterations, stop
        self._relaxed: list[Problem] = []

    def __call__(self, problem: Problem) -> bool | None:
        """True with a plan, False with a proof that there is none, None for neither."""
        if self.stop():
            return None
        search, resources = Search(ExpandedGraph.of(problem)), Resources.of(problem)
        if not all(search.can_arrive(i) for i in range(problem.n_robots)):
            return False
        rng = np.random.default_rng([self.seed, 3])
        paths = cooperative_with_restarts(
            search, resources, restarts=RESTARTS, rng=rng, stop=self.stop
        )
        neighbourhoods = LargeNeighbourhoodSearch(search, resources, paths, seed=self.seed)
        for iterations in (self.iterations // 4, self.iterations - self.iterations // 4):
            for _ in range(0, iterations, BATCH):
                if None not in paths or self.stop():
                    break
                neighbourhoods.run(BATCH)
                paths = neighbourhoods.paths()
            if None not in paths:
                return True
            if self.is_refuted(problem, search, resources, paths):
                return False
        if problem.n_robots > FEW or self.stop():
            return None
        params = SolveParams(
            method="exact", seed=self.seed, iterations=self.iterations, nodes=NODES, gap=ANY_GAP
        )
        status = solve(problem, params).status
        return {"optimal": True, "feasible": True, "infeasible": False}.get(status)

    def is_refuted(
        self, problem: Problem, search: Search, resources: Resources, paths: list[Path | None]
    ) -> bool:
        """Whether the relaxation has no solution."""
        if any(_is_within(known, problem) for known in self._relaxed):
            return False
        known = [(i, path) for i, path in enumerate(paths) if path is not None]
        if prove_infeasible(search, resources, known, stop=self.stop) is not None:
            return True
        if not self.stop():
            self.note_relaxed(problem)
        return False

    def note_relaxed(self, problem: Problem) -> None:
        """The relaxation of a problem is known to have a solution."""
        self._relaxed.append(problem)


def _is_within(small: Problem, large: Problem) -> bool:
    """Whether `large` has as many slots and as much AP room at least."""
    return small.horizon <= large.horizon and bool((small.ap_capacity <= large.ap_capacity).all())


def with_horizon(problem: Problem, horizon: int) -> Problem:
    """The problem with another horizon and the same costs, as far as costs stay exact."""
    c_t, c_h = problem.c_t, problem.c_h
    if horizon * (c_t + c_h) > MAX_PATH_COST:
        c_t, c_h = 1, 0  # whether there is a plan does not depend on them
    return replace(problem, horizon=horizon, objective="costs", c_t=c_t, c_h=c_h)


def least_horizon(
    problem: Problem, above: int, decide: Decide, *, undecided: Sequence[int] = ()
) -> Least:
    """The least T, everything else the same, the costs of a slot and a handover among it.

    Args:
        problem: its own horizon only says how far to look: four times as far, and at least 64
            slots beyond what is known to be too short.
        above: no plan exists at this T.
        decide: whether a problem has a plan.
        undecided: values of T known to be undecided.
    """
    most = min(MAX_HORIZON, max(4 * problem.horizon, above + 64))

    def at(T: int) -> bool | None:
        return decide(with_horizon(problem, T))

    return _least(at, above, most, undecided)


def least_capacity(
    problem: Problem, above: int, decide: Decide, *, undecided: Sequence[int] = ()
) -> Least:
    """The least m, the same for all APs. With m = N the APs limit nothing.

    Args:
        problem: its own capacities do not matter.
        above: no plan exists at this m.
        decide: whether a problem has a plan.
        undecided: values of m known to be undecided.
    """
    n = problem.n_robots

    def at(m: int) -> bool | None:
        return decide(replace(problem, ap_capacity=np.full(problem.n_aps, m, np.int32)))

    found = _least(at, above, n, undecided) if above < n else Least(n + 1, None, n)
    return replace(found, never=found.lower > n)


def _least(
    at: Callable[[int], bool | None], low: int, most: int, undecided: Sequence[int] = ()
) -> Least:
    """Search above `low`, where there is no plan, up to `most`.

    `most` is looked at first: a proof there ends the search. Then upwards from `low` in growing
    steps, then between. Values that stay undecided split the search: above the highest of them for
    a plan, below the lowest for a proof.
    """
    open_values = sorted(x for x in undecided if low < x < most)
    foot, high = max(open_values, default=low), None
    answer = None if most in undecided else at(most)
    if answer is False:
        return Least(most + 1, None, most)
    if answer:
        high = most
    # Where even `most` is undecided, there is little hope for less: only proofs are looked for.
    step, ceiling = 1, foot if high is None else high
    while ceiling - foot > 1:
        # Growing steps as long as they are shorter than half of what is left.
        middle = min(foot + step, (foot + ceiling) // 2)
        step *= 2
        answer = at(middle)
        if answer:
            high = ceiling = middle
            continue
        foot = middle
        if answer is False:
            low, open_values = middle, []
        else:
            open_values.append(middle)
    ceiling = min(open_values, default=most if high is None else high)
    while ceiling - low > 1:
        middle = (low + ceiling) // 2
        answer = at(middle)
        if answer is False:
            low = middle
            continue
        ceiling = middle
        if answer:
            high = middle
    return Least(low + 1, high, most)
