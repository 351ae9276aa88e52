"""Bounds group by group: below every plan, at the LP's when one group holds all."""

from __future__ import annotations

import pytest

from planner import bounding
from planner.bounding import Bounding
from planner.check import check_plan
from planner.expanded_graph import ExpandedGraph
from planner.group_bounds import GroupBounds, group_bounds
from planner.improve import LargeNeighbourhoodSearch
from planner.incumbent import Incumbent
from planner.plan import Path
from planner.problem import Problem
from planner.resources import SCALE, Resources
from planner.search import Search
from planner.solve import SolveParams, solve
from tests.oracles.arcflow import solve_arcflow
from tests.oracles.tiny_problems import random_hall, tiny_problem
from tests.planner.test_improve import SEEDS


def bounds_of(problem: Problem, sizes: tuple[int, ...]) -> list[GroupBounds]:
    """All bounds on the way, with a plan from a short search."""
    search, resources = Search(ExpandedGraph.of(problem)), Resources.of(problem)
    nobody: list[Path | None] = [None] * problem.n_robots
    neighbourhoods = LargeNeighbourhoodSearch(search, resources, nobody, seed=1)
    neighbourhoods.run(100)
    return list(group_bounds(search, resources, neighbourhoods.paths, sizes=sizes))


@pytest.mark.parametrize("seed", SEEDS[:25])
def test_below_the_optimum(seed: int) -> None:
    """§1.13: no bound of groups is above what the best plan costs."""
    problem = tiny_problem(seed)
    exact = solve_arcflow(problem)
    found = bounds_of(problem, (2, 3, 4))
    if exact.status == "optimal":
        assert all(bounds.bound <= exact.cost * SCALE for bounds in found)


def test_rises_to_the_lp() -> None:
    """From level to level the bound never falls; one group of all robots gives the LP's bound."""
    problem = random_hall(4, n=30)
    found = bounds_of(problem, (5, 10, 20, 30))
    bounds = [b.bound for b in found]
    assert bounds == sorted(bounds)
    search = Search(ExpandedGraph.of(problem))
    assert bounds[-1] > sum(search.least_cost(i) for i in range(30)) * SCALE
    for b in found:
        assert sorted(i for group in b.groups for i in group) == list(range(30))
        assert (b.penalty > 0).all()
    whole = solve(problem, SolveParams(iterations=400))
    assert whole.lp_value is not None
    assert bounds[-1] <= whole.lp_value * SCALE + 1
    if len(found[-1].groups) == 1:
        assert bounds[-1] == pytest.approx(whole.lp_value * SCALE, rel=1e-6)


@pytest.mark.parametrize("time_limit", [None, 3.0])
def test_fleets_that_do_not_fit(time_limit: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the master does not fit, the answer has a plan, and a bound of groups all the same."""
    monkeypatch.setattr(bounding, "WHOLE_FLEET", 10)
    problem = random_hall(4, n=30)
    params = SolveParams(iterations=400, time_limit=time_limit)
    plan = solve(problem, params)
    assert check_plan(problem, plan) == []
    assert plan.unserved == ()
    assert plan.solver["groups"] < 30
    assert plan.lp_value is None
    assert plan.prices is not None
    search = Search(ExpandedGraph.of(problem))
    assert plan.lower_bound is not None
    assert sum(search.least_cost(i) for i in range(30)) < plan.lower_bound <= plan.cost
    if time_limit is None:
        again = solve(problem, params)
        assert (again.paths, again.lower_bound) == (plan.paths, plan.lower_bound)  # §1.15


def test_an_lp_that_takes_too_long_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing more is done with the master then, not even for prices: groups prove the bound."""
    monkeypatch.setattr(bounding, "LONG_LP_S", -1.0)
    monkeypatch.setattr(bounding, "NEXT_LP", 1e12)
    monkeypatch.setattr(bounding, "least_penalties", lambda *_args, **_more: pytest.fail("an LP"))
    problem = random_hall(4, size=8, n=14, T=24)
    search, resources = Search(ExpandedGraph.of(problem)), Resources.of(problem)
    incumbent = Incumbent(problem, SolveParams(time_limit=1000.0), None, lambda: False)
    work = Bounding(incumbent, search, resources, lambda: None)
    work.robots_alone()
    assert work.fits
    assert work.run() is None
    assert not work.fits
    assert incumbent.prices is not None
    assert incumbent.counts["groups"] < 14
