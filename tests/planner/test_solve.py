"""`solve` answers what §1.12 to §1.15 say, measured against the exact arc-flow program."""

from __future__ import annotations

import functools

import pytest

from planner.check import check_plan
from planner.json_files import dump_plan, parse_plan
from planner.plan import Plan
from planner.problem import Problem
from planner.solve import Method, SolveParams, solve
from planner.validation import MAX_PATH_COST
from tests.oracles.arcflow import arcflow_bound, solve_arcflow
from tests.oracles.tiny_problems import random_hall, tiny_problem
from tests.planner.examples import grid

METHODS: tuple[Method, ...] = ("auto", "pgcp", "cooperative")
SEEDS = range(60)


@functools.cache
def exact(seed: int) -> Plan:
    """The arc-flow program's answer to a tiny problem."""
    return solve_arcflow(tiny_problem(seed))


def params(method: Method, **changes: object) -> SolveParams:
    """Limits that suit tiny problems."""
    return SolveParams(**{"method": method, "iterations": 200, **changes})  # type: ignore[arg-type]


def assert_sound(problem: Problem, plan: Plan, truth: Plan) -> None:
    """No rule broken, nothing claimed that the exact answer contradicts (§1.12, §1.13)."""
    assert check_plan(problem, plan) == []
    if truth.status == "infeasible":
        assert plan.status in {"infeasible", "unknown"}
        if plan.status == "unknown":
            assert plan.unserved
        return
    assert plan.status in {"optimal", "feasible", "unknown"}, "a false proof"
    assert plan.lower_bound is not None
    assert plan.lower_bound <= truth.cost
    if plan.status != "unknown":
        assert plan.unserved == ()
        assert plan.cost >= truth.cost
    if plan.status == "optimal":
        assert plan.cost == truth.cost
        assert plan.gap == 0.0


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", SEEDS)
def test_answer_is_sound(seed: int, method: Method) -> None:
    """§1.12, §1.13: bound ≤ optimum ≤ cost, optimal means optimal, infeasible means infeasible.

    Over hp, tp, snr and own costs, leave and park, slow, one-way and parallel edges.
    """
    problem = tiny_problem(seed)
    plan = solve(problem, params(method))
    assert_sound(problem, plan, exact(seed))
    assert (plan.lower_bound is None) == (plan.status == "infeasible")
    assert bool(plan.message) == (plan.status in {"infeasible", "unknown"})


@functools.cache
def by_tree_search(seed: int) -> Plan:
    """The tree search's answer within few nodes."""
    return solve(tiny_problem(seed), params("exact", nodes=60))


@pytest.mark.parametrize("seed", SEEDS)
def test_tree_search_is_sound(seed: int) -> None:
    """§1.12, §1.13: whatever the tree search proves within its nodes is so."""
    assert_sound(tiny_problem(seed), by_tree_search(seed), exact(seed))


def test_tree_search_decides() -> None:
    """§1.12: nearly every tiny problem is decided within few nodes: an optimum, or that none is."""
    statuses = [by_tree_search(seed).status for seed in SEEDS]
    assert statuses.count("unknown") + statuses.count("feasible") <= 3


def test_every_case_was_among_them() -> None:
    """The tiny problems above make the planner give each of its answers, mostly conclusive ones."""
    problems = [tiny_problem(seed) for seed in SEEDS]
    plans = [solve(problem, params("auto")) for problem in problems]
    statuses = [plan.status for plan in plans]
    assert statuses.count("optimal") >= 25
    assert statuses.count("infeasible") >= 20
    assert statuses.count("unknown") <= 8
    kinds = {
        (p.objective, p.at_goal) for p, s in zip(problems, statuses, strict=True) if s == "optimal"
    }
    assert len(kinds) == 8
    # Where the exact answer is a plan, one is found nearly always.
    missed = [
        seed
        for seed, status in zip(SEEDS, statuses, strict=True)
        if exact(seed).status == "optimal" and status == "unknown"
    ]
    assert len(missed) <= 1


@pytest.mark.parametrize("seed", SEEDS)
def test_infeasible_whenever_the_relaxation_is(seed: int) -> None:
    """§1.12: `auto` and `pgcp` prove what the relaxation proves, and name robots of the problem."""
    problem = tiny_problem(seed)
    if arcflow_bound(problem) is not None:
        return
    for method in ("auto", "pgcp"):
        plan = solve(problem, params(method, iterations=20))
        assert plan.status == "infeasible"
        assert plan.infeasible_robots
        assert set(plan.infeasible_robots) <= set(problem.robot_ids)
    # Cooperative A* alone proves nothing but that a robot is cut off.
    plan = solve(problem, params("cooperative"))
    assert plan.status in {"infeasible", "unknown"}


@pytest.mark.parametrize("at_goal", ["leave", "park"])
@pytest.mark.parametrize("objective", ["hp", "tp", "snr"])
@pytest.mark.parametrize("method", [*METHODS, "decoupled"])
def test_a_small_hall(method: Method, objective: str, at_goal: str) -> None:
    """Every method, objective and ending on a hall with fourteen robots: no rule is broken."""
    problem = random_hall(2, size=8, n=14, T=24, m=9, objective=objective, at_goal=at_goal)
    plan = solve(problem, params(method, iterations=300))
    assert check_plan(problem, plan) == []
    assert plan.status != "infeasible"
    text = dump_plan(plan, problem)
    assert check_plan(problem, parse_plan(text, problem, "plan.json")) == []


def test_methods_agree_on_a_hall() -> None:
    """§1.13: no method's bound exceeds any method's cost, and `auto` is the best of them."""
    problem = random_hall(0, n=30)
    plans = {method: solve(problem, params(method, iterations=600)) for method in METHODS}
    complete = [plan.cost for plan in plans.values() if not plan.unserved]
    for plan in plans.values():
        assert check_plan(problem, plan) == []
        assert plan.lower_bound is not None
        assert plan.lower_bound <= min(complete)
    assert plans["auto"].cost == min(complete)
    assert plans["auto"].lp_value == pytest.approx(plans["pgcp"].lp_value, abs=1e-5)
    assert plans["auto"].gap is not None
    assert plans["auto"].gap < 0.03


KNOWN: dict[str, tuple[Problem, str, int | None]] = {
    "a single robot goes straight": (grid(4, 1, [(0, 3)]), "optimal", 3),
    "start is goal (§1.5)": (grid(2, 1, [(0, 0)]), "optimal", 0),
    "start is goal, parked (§1.5)": (grid(2, 1, [(0, 0)], at_goal="park"), "optimal", 0),
    "all at their goals": (grid(2, 2, [(0, 0), (1, 1), (2, 2), (3, 3)]), "optimal", 0),
    "equal goals under leave (§1.5)": (grid(3, 1, [(0, 1), (2, 1)]), "optimal", 3),
    "a robot parked in the way from the start": (
        grid(3, 1, [(1, 1), (0, 2)], at_goal="park"),
        "infeasible",
        None,
    ),
    "the same robot gone (§1.4)": (grid(3, 1, [(1, 1), (0, 2)]), "optimal", 2),
    "an AP of capacity 0 is avoided (§1.6)": (
        grid(3, 1, [(0, 2)], cover=[[0, 1], [0, 1], [0, 1]], ap_capacity=[0, 1]),
        "optimal",
        2,
    ),
    "an AP of capacity 0 cannot be avoided (§1.6)": (
        grid(3, 1, [(0, 2)], cover=[[0], [1], [1]], ap_capacity=[0, 1]),
        "infeasible",
        None,
    ),
    "too few places in slot 0 (§1.6)": (
        grid(4, 1, [(0, 1), (3, 2)], n_aps=1, ap_capacity=[1]),
        "infeasible",
        None,
    ),
    "the horizon is too short (§1.12)": (grid(5, 1, [(0, 4)], horizon=3), "infeasible", None),
    "the horizon is just long enough": (grid(5, 1, [(0, 4)], horizon=4), "optimal", 4),
    "no way at all (§1.12)": (
        grid(4, 1, [(0, 3)], edge_uv=[(0, 1), (2, 3)]),
        "infeasible",
        None,
    ),
    "a slow edge is longer than the horizon (§1.1)": (
        grid(2, 1, [(0, 1)], horizon=3, edge_slots=[4]),
        "infeasible",
        None,
    ),
    "against the one way (§1.1)": (grid(2, 1, [(1, 0)], edge_oneway=[True]), "infeasible", None),
    "a swap over one edge in one slot (§1.3)": (
        grid(2, 1, [(0, 1), (1, 0)], horizon=1),
        "infeasible",
        None,
    ),
    "a swap in a dead-end corridor in no more time than it takes (§1.2)": (
        grid(5, 1, [(0, 4), (4, 0)], horizon=4),
        "infeasible",
        None,
    ),
    "two pass each other by the second row (§1.3)": (
        grid(3, 2, [(0, 2), (2, 0)], horizon=4),
        "feasible",
        6,
    ),
    "free of charge": (
        grid(3, 1, [(0, 2), (2, 1)], objective="costs", c_t=0, c_h=0),
        "optimal",
        0,
    ),
}


@pytest.mark.parametrize("method", ["auto", "pgcp"])
@pytest.mark.parametrize("name", KNOWN)
def test_known_answer(name: str, method: Method) -> None:
    """Cases whose answer can be seen: status, cost, and nothing against the rules."""
    problem, status, cost = KNOWN[name]
    plan = solve(problem, params(method))
    assert check_plan(problem, plan) == []
    if status == "feasible":  # the cost is the optimum, its proof is more than can be asked for
        assert plan.status in {"feasible", "optimal"}
    else:
        assert plan.status == status
    if cost is not None:
        assert plan.cost == cost


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("length", "horizon"), [(2, 8), (3, 6), (4, 9), (5, 12), (8, 40)])
def test_swap_in_a_dead_end_corridor(length: int, horizon: int, method: Method) -> None:
    """§1.2, §1.3: two robots that must swap in a corridor never get a plan, however much time.

    The relaxation lets them through by halves, so "unknown" is an honest answer where there is
    more time than the way takes; the tree search proves it.
    """
    problem = grid(length, 1, [(0, length - 1), (length - 1, 0)], horizon=horizon)
    plan = solve(problem, params(method))
    assert plan.status in {"infeasible", "unknown"}
    assert plan.unserved
    assert check_plan(problem, plan) == []
    if horizon <= 12:
        assert solve(problem, params("exact", nodes=100)).status == "infeasible"


@pytest.mark.parametrize("method", METHODS)
def test_swap_past_a_pocket(method: Method) -> None:
    """§1.2: both must leave their shortest ways; whatever is answered, no rule and no bound breaks.

    No order of the robots solves this by planning one after the other, so the answer may be
    "unknown"; it may not be "infeasible". The tree search finds the plan.
    """
    pocket = [(0, 1), (1, 2), (1, 4)]
    problem = grid(3, 2, [(0, 2), (2, 0)], edge_uv=pocket, n_aps=1)
    truth = solve_arcflow(problem)
    assert truth.cost == 7
    assert_sound(problem, solve(problem, params(method)), truth)
    plan = solve(problem, params("exact", nodes=500))
    assert (plan.status, plan.cost) == ("optimal", 7)


def test_lost_robots_are_named() -> None:
    """§1.12: robots that cannot arrive even alone are the ones named."""
    problem = grid(5, 1, [(0, 1), (2, 4), (4, 3)], edge_uv=[(0, 1), (3, 4)])
    for method in (*METHODS, "decoupled"):
        plan = solve(problem, params(method))
        assert (plan.status, plan.infeasible_robots) == ("infeasible", ("r1",))
        assert plan.lower_bound is None
        assert plan.message


def test_optimum_of_a_slow_and_a_fast_way() -> None:
    """§1.1: two parallel edges, one slow: the second robot waits for the fast one if that pays."""
    edges = [(0, 1), (0, 1)]
    slow = grid(3, 1, [(0, 1), (1, 0)], edge_uv=edges, edge_slots=[1, 4], n_aps=1)
    plan = solve(slow)
    assert check_plan(slow, plan) == []
    assert plan.cost == solve_arcflow(slow).cost


@pytest.mark.parametrize("method", METHODS)
def test_largest_costs(method: Method) -> None:
    """At the largest costs a problem may have, costs and bounds are still exact integers."""
    c_h = MAX_PATH_COST // 8 - 3
    cover = [[0], [1], [0], [1], *[[0, 1]] * 4]
    problem = grid(
        4, 2, [(0, 3), (4, 7)], cover=cover, horizon=8, objective="costs", c_t=3, c_h=c_h
    )
    plan = solve(problem, params(method))
    truth = solve_arcflow(problem)
    assert check_plan(problem, plan) == []
    assert plan.status == "optimal"
    assert plan.cost == plan.lower_bound == truth.cost
