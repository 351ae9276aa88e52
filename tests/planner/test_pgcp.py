"""PGCP against the literal Algorithm 1 and the exact arc-flow program."""

from __future__ import annotations

import functools

import pytest

from planner.check import check_plan
from planner.cooperative import cooperative_astar
from planner.expanded_graph import ExpandedGraph
from planner.master import Master
from planner.pgcp import PgcpState, artificial_cost, generate_paths, pgcp
from planner.plan import Path, Plan
from planner.problem import Problem
from planner.resources import SCALE, Resources
from planner.search import Search
from tests.oracles.algorithm1 import algorithm1
from tests.oracles.arcflow import arcflow_bound, solve_arcflow
from tests.oracles.expanded import path_cost
from tests.oracles.tiny_problems import random_hall, tiny_problem
from tests.planner.examples import grid, path_of


def reachable(problem: Problem) -> bool:
    """Every robot alone on the floor reaches its goal, as PGCP asks for."""
    search = Search(ExpandedGraph.of(problem))
    return all(search.can_arrive(i) for i in range(problem.n_robots))


SEEDS = [seed for seed in range(70) if reachable(tiny_problem(seed))]


@functools.cache
def optimum(seed: int) -> int | None:
    """Cost of the cheapest plan, None if there is none."""
    plan = solve_arcflow(tiny_problem(seed))
    return plan.cost if plan.status == "optimal" else None


def as_plan(problem: Problem, paths: list[Path | None], bound: float) -> Plan:
    """The paths with what PGCP claims about them."""
    cost = sum(path_cost(problem, path) for path in paths if path is not None)
    status = "unknown" if None in paths else "feasible"
    return Plan(status, problem.robot_ids, tuple(paths), cost, bound)


def new_state(problem: Problem) -> PgcpState:
    """PGCP before its first path."""
    graph, resources = ExpandedGraph.of(problem), Resources.of(problem)
    master = Master(resources, artificial_cost(problem))
    return PgcpState(graph, resources, Search(graph), master)


def artificial_use(state: PgcpState) -> float:
    """Σ of the artificial paths' variables in the master LP as it is."""
    x = state.master.solve().x
    return sum(float(x[k]) for k, column in enumerate(state.master.columns) if column.path is None)


@pytest.mark.parametrize("seed", SEEDS)
def test_lp_value_and_lagrangian_bound(seed: int) -> None:
    """§1.13: the LP value at the end is that of the full LP to 1e-6, and every bound is below it.

    The full LP is the arc-flow relaxation, equal to the master over all paths. The artificial
    paths may be chosen where serving a robot costs the others more than they do; then the value
    is lower. At convergence the Lagrangian bound is within 1e-4 of the LP value, and no bound of
    any round is above the optimum of the integer program.
    """
    problem = tiny_problem(seed)
    state = new_state(problem)
    bounds: list[int] = []

    def watch(state: PgcpState) -> bool:
        bounds.append(state.bound)
        return False

    value = generate_paths(state, range(problem.n_robots), stop=watch)
    bounds.append(state.bound)
    assert value is not None
    assert bounds == sorted(bounds)
    assert state.iterations == len(bounds)
    full = arcflow_bound(problem)
    if artificial_use(state) < 1e-9:
        assert full is not None
        assert value == pytest.approx(full, abs=1e-6)
    elif full is not None:
        assert value <= full + 1e-6
    assert bounds[-1] / SCALE <= value + 1e-6
    assert bounds[-1] / SCALE == pytest.approx(value, abs=1e-4)
    cost = optimum(seed)
    if cost is not None:
        assert bounds[-1] <= cost * SCALE


@pytest.mark.parametrize("seed", SEEDS)
def test_lp_value_equals_that_of_algorithm_1(seed: int) -> None:
    """§1.14: PGCP's master LP and the literal Algorithm 1's end at one value, to 1e-6."""
    problem = tiny_problem(seed)
    paper = algorithm1(problem, prune=False)
    state = new_state(problem)
    value = generate_paths(state, range(problem.n_robots))
    assert value is not None
    if paper.artificial_use < 1e-9 and artificial_use(state) < 1e-9:
        assert value == pytest.approx(paper.lp_value, abs=1e-6)
    else:
        # Both artificial costs exceed any path's, the oracle's any plan's too.
        assert value <= paper.lp_value + 1e-6


def test_the_comparison_is_not_empty() -> None:
    """Most of these problems end without artificial paths, so the two tests above do compare."""
    served = 0
    for seed in SEEDS:
        problem = tiny_problem(seed)
        state = new_state(problem)
        generate_paths(state, range(problem.n_robots))
        served += artificial_use(state) < 1e-9
    assert served >= 0.6 * len(SEEDS)


@pytest.mark.parametrize("seed", SEEDS)
def test_plan_breaks_no_rule(seed: int) -> None:
    """§1.12: PGCP's plan passes the checker; its bound and LP value never exceed the optimum."""
    problem = tiny_problem(seed)
    paths, state = pgcp(problem)
    assert check_plan(problem, as_plan(problem, paths, state.bound / SCALE)) == []
    assert check_plan(problem, as_plan(problem, state.initial, state.bound / SCALE)) == []
    cost = optimum(seed)
    assert state.lp_value is not None
    if cost is not None:
        assert state.lp_value <= cost + 1e-6
        assert state.bound <= cost * SCALE
    if None not in paths:
        assert cost is not None
        assert sum(path_cost(problem, path) for path in paths if path is not None) >= cost


@pytest.mark.parametrize("seed", SEEDS)
def test_columns_are_priced_right(seed: int) -> None:
    """§1.9: every column of the master costs what its path costs, and each path is legal alone."""
    problem = tiny_problem(seed)
    _, state = pgcp(problem)
    for column in state.master.columns:
        if column.path is not None:
            others: list[Path | None] = [None] * problem.n_robots
            others[column.robot] = column.path
            assert column.cost == path_cost(problem, column.path)
            found = check_plan(problem, as_plan(problem, others, 0.0))
            assert {violation.rule for violation in found} <= {"§1.6"}  # an AP without places
            assert not found or (problem.ap_capacity == 0).any()


@pytest.mark.parametrize("at_goal", ["leave", "park"])
@pytest.mark.parametrize("objective", ["hp", "tp", "snr"])
def test_a_small_hall(objective: str, at_goal: str) -> None:
    """The paper in small, all objectives: legal, near the LP, and the LP is Algorithm 1's."""
    problem = random_hall(3, size=8, n=8, T=24, m=5, objective=objective, at_goal=at_goal)
    paper = algorithm1(problem, prune=False)
    paths, state = pgcp(problem)
    assert state.lp_value == pytest.approx(paper.lp_value, abs=1e-6)
    assert state.bound / SCALE == pytest.approx(state.lp_value, abs=1e-4)
    plan = as_plan(problem, paths, state.bound / SCALE)
    assert check_plan(problem, plan) == []
    assert plan.status == "feasible"
    assert 1.0 <= plan.cost / state.lp_value + 1e-9 < 1.1


def test_a_hall_of_the_papers_size() -> None:
    """The paper's hall with 20 robots: served, legal, and within 6 % of the proven bound."""
    problem = random_hall(0, n=20)
    paths, state = pgcp(problem)
    plan = as_plan(problem, paths, state.bound / SCALE)
    assert check_plan(problem, plan) == []
    assert plan.gap is not None
    assert plan.gap < 0.06
    assert state.lp_value == pytest.approx(state.bound / SCALE, abs=1e-4)
    assert set(state.seconds) == {"graph", "cooperative", "path_generation", "cooperative_pruning"}


def test_starts_from_cooperative_astar() -> None:
    """Line 2: the initial paths are cooperative A*'s in the robots' order, all in the master."""
    problem = tiny_problem(4)
    _, state = pgcp(problem)
    search = Search(ExpandedGraph.of(problem))
    expected = cooperative_astar(search, Resources.of(problem), range(problem.n_robots))
    assert state.initial == expected
    columns = [(column.robot, column.path) for column in state.master.columns]
    n = problem.n_robots
    assert columns[:n] == [(i, None) for i in range(n)]
    real = [(i, path) for i, path in enumerate(expected) if path is not None]
    assert columns[n : n + len(real)] == real


def test_stopping_early_keeps_the_bound_but_claims_no_lp_value() -> None:
    """§1.13, §1.14: stopped after one round the bound holds; an LP value not reached is None."""
    problem = random_hall(1, size=8, n=14, T=24, m=5)
    asked = []

    def stop(state: PgcpState) -> bool:
        asked.append(state.iterations)
        return True

    _, done = pgcp(problem)
    assert done.iterations > 1
    paths, state = pgcp(problem, stop=stop)
    assert asked[0] == 1
    assert state.lp_value is None
    assert done.lp_value is not None
    assert 0 < state.bound / SCALE <= done.lp_value + 1e-6
    assert check_plan(problem, as_plan(problem, paths, state.bound / SCALE)) == []


def test_paths_by_parallel_edges_are_generated() -> None:
    """§1.3: where only a parallel edge lets two pass, path generation finds the path along it.

    The master begins with both robots on edge 0; a path of the same states along edge 1 is new.
    """
    edges = [(0, 1), (0, 1)]
    problem = grid(2, 1, [(0, 1), (1, 0)], n_aps=1, horizon=1, edge_uv=edges)
    state = new_state(problem)
    columns = [(0, "0a>0 1a"), (1, "1a>0 0a")]
    state.master.add([state.master.column(i, path_of(problem, i, text)) for i, text in columns])
    assert generate_paths(state, range(2)) == pytest.approx(2.0)
    assert artificial_use(state) < 1e-9


def test_pruning_prices_again_for_a_robot_left_with_its_artificial_path() -> None:
    """Line 21: over many problems PGCP serves as many fleets as the literal Algorithm 1, nearly."""
    served = {"planner": 0, "paper": 0}
    for seed in SEEDS[:30]:
        problem = tiny_problem(seed)
        paths, _ = pgcp(problem)
        served["planner"] += None not in paths
        served["paper"] += not algorithm1(problem).plan.unserved
    assert served["planner"] >= served["paper"] - 1
    assert served["planner"] >= 15
