"""`solve` answers what §1.12 to §1.15 say, measured against the exact arc-flow program."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import os
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path as FilePath

import numpy as np
import pytest

from planner.check import check_plan
from planner.json_files import dump_plan, parse_plan
from planner.plan import Plan
from planner.problem import Problem
from planner.solve import Method, Progress, SolveParams, solve
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


def stripped(plan: Plan) -> str:
    """plan.json without what the wall clock says."""
    counts = {key: value for key, value in plan.solver.items() if not key.startswith("seconds")}
    return dump_plan(dataclasses.replace(plan, seconds=0.0, solver=counts))


@pytest.mark.parametrize("method", [*METHODS, "decoupled"])
def test_same_plan_twice(method: Method) -> None:
    """§1.15: same input, same seed: the same plan.json byte for byte, seconds apart."""
    problem = random_hall(5, size=8, n=14, T=24, m=6)
    one, two = (stripped(solve(problem, params(method, seed=3))) for _ in range(2))
    assert one == two
    assert '"seconds": 0' in one
    assert "seconds_" not in one


CHILD = "from tests.planner.test_solve import digest; print(digest())"


def digest() -> str:
    """A hash over the plans of some problems by every method."""
    problems = [random_hall(5, size=8, n=14, T=24, m=6), *(tiny_problem(s) for s in range(12))]
    plans = [stripped(solve(p, params(m, seed=1))) for p in problems for m in METHODS]
    return hashlib.sha256("".join(plans).encode()).hexdigest()


def test_same_plan_in_another_process() -> None:
    """§1.15: another process with another hash seed gives the same bytes."""
    root = FilePath(__file__).parents[2]
    hash_seed = "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"
    done = subprocess.run(
        [sys.executable, "-c", CHILD],
        env={**os.environ, "PYTHONHASHSEED": hash_seed, "PYTHONPATH": str(root)},
        cwd=root,
        capture_output=True,
        text=True,
        check=True,
        timeout=100,
    )
    assert re.fullmatch(r"[0-9a-f]{64}", done.stdout.strip())
    assert done.stdout.strip() == digest()


def test_seed_matters() -> None:
    """Other seeds search elsewhere; their plans are sound all the same."""
    problem = random_hall(4, n=30)
    plans = [solve(problem, params("auto", iterations=100, seed=seed)) for seed in range(3)]
    assert all(check_plan(problem, plan) == [] for plan in plans)
    assert len({stripped(plan) for plan in plans}) > 1


def test_more_iterations_are_never_worse() -> None:
    """With one seed, a longer search ends at least as cheap."""
    problem = random_hall(1, size=8, n=14, T=24, m=5)
    costs = [solve(problem, params("auto", iterations=k)).cost for k in (0, 100, 400, 1600)]
    assert costs == sorted(costs, reverse=True)


def test_gap_stops_early() -> None:
    """A gap that is good enough ends the search before its iterations are spent."""
    problem = random_hall(0, n=20)
    wide = solve(problem, params("auto", iterations=800, gap=0.2))
    narrow = solve(problem, params("auto", iterations=800))
    assert wide.gap is not None
    assert wide.gap <= 0.2
    assert wide.solver["neighbourhoods"] < narrow.solver["neighbourhoods"]


@pytest.mark.parametrize("method", ["auto", "pgcp", "cooperative"])
def test_time_limit(method: Method) -> None:
    """With hardly any time the answer is sound, comes soon, and claims no LP value not reached."""
    problem = random_hall(3, n=60)
    plan = solve(problem, params(method, time_limit=1e-6, iterations=10**9))
    assert check_plan(problem, plan) == []
    assert plan.status in {"feasible", "unknown"}
    assert plan.lower_bound is not None
    assert plan.lower_bound > 0
    assert plan.lp_value is None
    assert plan.seconds < 20


def test_pgcp_gives_its_best_partial_plan() -> None:
    """§1.12: where pruning leaves out more robots than cooperative A* did, its plan is given."""
    for seed in SEEDS:
        problem = tiny_problem(seed)
        pgcp = solve(problem, params("pgcp"))
        once = solve(problem, params("cooperative", restarts=0))
        assert len(pgcp.unserved) <= len(once.unserved)


def test_progress() -> None:
    """Reports come in the order of time; the bound never falls, nor does the number served."""
    problem = random_hall(1, size=8, n=14, T=24, m=5)
    for method in METHODS:
        seen: list[Progress] = []
        plan = solve(problem, params(method), seen.append)
        assert seen
        for before, after in pairwise(seen):
            assert after.seconds >= before.seconds
            assert after.bound >= before.bound
            assert after.served >= before.served
            assert after.served > before.served or after.cost <= before.cost or not before.served
        last = seen[-1]
        assert (last.served, last.cost) == (14 - len(plan.unserved), plan.cost)
        assert plan.lower_bound is not None
        assert last.bound <= plan.lower_bound
        phases = [p.phase for p in seen]
        assert all(phases)


def test_counts_say_what_was_done() -> None:
    """The solver's counters: sizes of G' (§1.11), columns, rows, rounds."""
    problem = random_hall(1, size=8, n=14, T=24, m=5)
    plan = solve(problem, params("pgcp"))
    pairs = int(problem.cover.sum())
    assert plan.solver["expanded_vertices"] == 25 * pairs
    assert plan.solver["columns"] > 2 * 14
    assert plan.solver["rows"] > 14
    assert plan.solver["lp_solves"] >= plan.solver["iterations"] > 1


@pytest.mark.parametrize(
    "changes",
    [
        {"restarts": -1},
        {"iterations": -5},
        {"time_limit": 0.0},
        {"time_limit": float("nan")},
        {"gap": -0.1},
        {"gap": float("nan")},
        {"seed": -1},
        {"method": "magic"},
    ],
)
def test_impossible_limits_are_refused(changes: dict[str, object]) -> None:
    """Limits that make no sense are named, with their value."""
    (name,) = changes
    with pytest.raises(ValueError, match=name):
        SolveParams(**changes)  # type: ignore[arg-type]


def test_defaults() -> None:
    """Without parameters the method is `auto` and the answer the same as with the defaults."""
    problem = tiny_problem(1)
    assert stripped(solve(problem)) == stripped(solve(problem, SolveParams()))
    assert SolveParams().method == "auto"
    assert np.isfinite(solve(problem).seconds)
