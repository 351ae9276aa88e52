"""The tree search ends with a proven optimum, or a proof that there is no plan (§1.12)."""

from __future__ import annotations

import numpy as np
import pytest

from planner import kernels_exact
from planner.check import check_plan
from planner.exact import ExactParams, ExactResult, ExactSearch, solve_exact
from planner.expanded_graph import ExpandedGraph
from planner.phase_one import prove_infeasible
from planner.plan import Path, Plan
from planner.problem import Problem
from planner.resources import BLOCKED, SCALE, Resources
from planner.search import NOTHING_FORBIDDEN, Penalties, Search
from planner.solve import SolveParams, solve
from tests.oracles.arcflow import solve_arcflow
from tests.oracles.tiny_problems import random_hall, tiny_problem
from tests.planner.examples import grid

ALL_CUTS = ("arrival_conflict", "state_exclusion", "wait_edge")


def exact(problem: Problem, **params: object) -> ExactResult | None:
    """The tree search without a plan to start with; None if a robot cannot arrive even alone."""
    resources, search = Resources.of(problem), Search(ExpandedGraph.of(problem))
    if not all(search.can_arrive(i) for i in range(problem.n_robots)):
        return None
    params = {"neighbourhoods": 0, **params}
    nothing: list[Path | None] = [None] * problem.n_robots
    return solve_exact(search, resources, nothing, params=ExactParams(**params))  # type: ignore[arg-type]


def agrees(problem: Problem, **params: object) -> ExactResult | None:
    """The tree search's answer, checked against the arc-flow program and the checker."""
    expected = solve_arcflow(problem)
    found = exact(problem, **params)
    if found is None or found.infeasible:
        assert expected.status == "infeasible"
        return found
    assert found.upper == expected.cost
    assert found.optimal
    assert found.bound == expected.cost * SCALE
    plan = Plan("optimal", problem.robot_ids, found.paths, expected.cost, float(expected.cost))
    assert check_plan(problem, plan) == []
    return found


@pytest.mark.parametrize("seed", range(60))
def test_optimum_of_any_problem(seed: int) -> None:
    """Equal to the arc-flow program's: all objectives, leave and park, edges of several slots,
    one-way and parallel edges, scarce APs; and infeasible exactly when that is.
    """
    agrees(tiny_problem(seed))


@pytest.mark.parametrize("at_goal", ["leave", "park"])
@pytest.mark.parametrize("seed", range(100, 112))
def test_optimum_with_all_cuts(seed: int, at_goal: str) -> None:
    """Equal to the arc-flow program's with every family of cuts where all of them apply."""
    agrees(
        tiny_problem(seed, features=False, max_robots=5, max_slots=8, at_goal=at_goal),
        cuts=ALL_CUTS,
    )


@pytest.mark.parametrize("at_goal", ["leave", "park"])
@pytest.mark.parametrize("seed", range(3))
def test_optimum_of_a_crowded_hall_with_and_without_cuts(seed: int, at_goal: str) -> None:
    """Cuts, excluded states and targets change the way, not the optimum."""
    problem = random_hall(seed, size=6, n=5, T=15, at_goal=at_goal)
    with_cuts, without = exact(problem, cuts=ALL_CUTS), exact(problem, cuts=(), nodes=150)
    assert with_cuts is not None
    assert without is not None
    assert with_cuts.optimal or with_cuts.infeasible
    if without.optimal:
        assert without.upper == with_cuts.upper
    if with_cuts.upper is not None:
        assert without.bound <= with_cuts.upper * SCALE


@pytest.mark.parametrize("nodes", [1, 2, 3, 5])
def test_a_bound_met_on_the_way_is_a_bound(nodes: int) -> None:
    """Stopped after any number of nodes the bound is at most the optimum, the plan at least."""
    for seed in range(200, 212):
        problem = tiny_problem(seed, features=False, max_robots=5, max_slots=8)
        optimum = solve_arcflow(problem)
        found = exact(problem, nodes=nodes, neighbourhoods=5)
        if found is None or optimum.status == "infeasible":
            assert found is None or found.upper is None
            continue
        assert optimum.cost is not None
        assert found.bound <= optimum.cost * SCALE
        assert found.upper is None or found.upper >= optimum.cost


def test_stopped_at_any_moment_it_has_an_answer() -> None:
    """Whenever it is told to stop, the bound holds and the plan keeps the rules."""
    problem = random_hall(1, size=7, n=9, T=22)
    optimum = solve(problem, SolveParams(method="exact", iterations=200)).cost
    resources, search = Resources.of(problem), Search(ExpandedGraph.of(problem))
    for rounds in range(0, 40, 7):
        asked = 0

        def stop(after: int = rounds) -> bool:
            nonlocal asked
            asked += 1
            return asked > after

        found = solve_exact(search, resources, [None] * problem.n_robots, stop=stop)
        assert found.bound <= optimum * SCALE
        if found.upper is not None:
            plan = Plan("feasible", problem.robot_ids, found.paths, found.upper, 0.0)
            assert check_plan(problem, plan) == []


def test_same_input_same_tree() -> None:
    """§1.15: two runs take the same nodes to the same plan."""
    problem = random_hall(1, size=7, n=9, T=22)
    one, two = exact(problem, neighbourhoods=20), exact(problem, neighbourhoods=20)
    assert one is not None
    assert one == two


def test_progress_only_ever_improves() -> None:
    """Bounds reported rise, costs fall, and they never cross."""
    problem = random_hall(2, size=7, n=9, T=22)
    resources, search = Resources.of(problem), Search(ExpandedGraph.of(problem))
    seen: list[ExactResult] = []
    solve_exact(search, resources, [None] * problem.n_robots, on_progress=seen.append)
    assert [r.bound for r in seen] == sorted(r.bound for r in seen)
    costs = [r.upper for r in seen if r.upper is not None]
    assert costs == sorted(costs, reverse=True)
    assert all(r.upper is None or r.bound <= r.upper * SCALE for r in seen)


@pytest.mark.parametrize("seed", range(20))
def test_costs_through_states(seed: int) -> None:
    """The least cost through a state is that of the shortest path made to use it, parked or not."""
    problem = tiny_problem(seed, max_robots=2)
    graph = ExpandedGraph.of(problem)
    resources, search = Resources.of(problem), Search(graph)
    rng = np.random.default_rng(seed)
    penalties = Penalties(resources)
    noise = rng.integers(0, 3 * SCALE, resources.n) * (rng.random(resources.n) < 0.3)
    penalties.set(np.arange(resources.n), noise)
    tree = ExactSearch(search, resources, [None] * problem.n_robots)
    tree.pricing.penalties = penalties
    for robot in range(problem.n_robots):
        through, arriving = tree.pricing.through(robot)
        for tau in range(problem.horizon + 1):
            cost, _ = search.shortest(robot, penalties, earliest=tau, latest=tau)
            assert min(int(arriving[tau]), int(kernels_exact.INFINITE)) == cost
        for t in range(problem.horizon + 1):
            for n in range(graph.n_nodes):
                only = np.zeros((problem.horizon + 1, graph.n_nodes + problem.n_aps), bool)
                only[t] = True
                only[t, n] = False
                parks = problem.at_goal == "park"
                earliest = 0 if parks and graph.node_vertex[n] == problem.goal[robot] else t
                cost, _ = search.shortest(robot, penalties, forbidden=only, earliest=earliest)
                assert min(int(through[t, n]), int(kernels_exact.INFINITE)) == cost
    assert NOTHING_FORBIDDEN.shape == (0, 0)


def test_solve_proves_optima_with_the_tree_search() -> None:
    """`method="exact"` closes the gap that path generation leaves."""
    problem = random_hall(0, size=8, n=10, T=26)
    loose = solve(problem, SolveParams(iterations=400))
    tight = solve(problem, SolveParams(method="exact", iterations=400))
    assert tight.status == "optimal"
    assert tight.lower_bound is not None
    assert loose.lower_bound is not None
    assert loose.lower_bound <= tight.lower_bound == tight.cost
    assert check_plan(problem, tight) == []


def test_two_robots_in_a_dead_end_cannot_swap() -> None:
    """§1.12: on a line nobody can pass; the relaxation has a solution, only branching proves it."""
    problem = grid(4, 1, [(0, 3), (3, 0)], horizon=12)
    search = Search(ExpandedGraph.of(problem))
    assert prove_infeasible(search, Resources.of(problem), []) is None
    found = exact(problem)
    assert found is not None
    assert found.infeasible
    assert found.upper is None


def test_artificial_paths_cost_less_than_blocked() -> None:
    """§1.13: a limit of pricing never reaches `BLOCKED`, above which paths are not looked at."""
    problem = grid(3, 1, [(0, 2)])
    search, resources = Search(ExpandedGraph.of(problem)), Resources.of(problem)
    tree = ExactSearch(search, resources, [None])
    raised = 0
    while tree._raise_artificial_cost():
        raised += 1
    assert raised > 3
    # There is no column but the artificial one, so the robot's dual is its cost.
    limit = tree.master.solve().robot_dual[0] * SCALE
    assert BLOCKED / 8 <= limit < BLOCKED
