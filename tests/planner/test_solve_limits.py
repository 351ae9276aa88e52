"""What `solve` spends, reports and repeats: §1.15, limits, progress, counters."""

from __future__ import annotations

import dataclasses
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
from planner.expanded_graph import ExpandedGraph
from planner.json_files import dump_plan
from planner.master import Master
from planner.pgcp import PRICED_AT_ONCE, PgcpState, artificial_cost, generate_paths
from planner.plan import Plan
from planner.resources import SCALE, Resources
from planner.search import Search
from planner.solve import Method, Progress, SolveParams, solve
from tests.oracles.tiny_problems import random_hall, tiny_problem
from tests.planner.examples import grid, path_of
from tests.planner.test_solve import METHODS, SEEDS, params


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


CHILD = "from tests.planner.test_solve_limits import digest; print(digest())"


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


def test_path_generation_ends_between_robots() -> None:
    """Whoever is in a hurry waits for a few robots at most, not for a round; the bound holds."""
    problem = random_hall(4, n=30)
    graph = ExpandedGraph.of(problem)
    resources, search = Resources.of(problem), Search(graph)
    full = solve(problem, SolveParams(iterations=400))
    for patience in (0, 3, 30):
        state = PgcpState(graph, resources, search, Master(resources, artificial_cost(problem)))
        asked = 0

        def hurry(patience: int = patience) -> bool:
            nonlocal asked
            asked += 1
            return asked > patience

        assert generate_paths(state, range(30), hurry=hurry, complete=False) is None
        assert asked == patience + 1
        assert state.iterations == patience // -(-30 // PRICED_AT_ONCE)
        assert state.bound <= full.cost * SCALE


def test_pgcp_gives_its_best_partial_plan() -> None:
    """§1.12: where pruning leaves out more robots than cooperative A* did, its plan is given."""
    for seed in SEEDS:
        problem = tiny_problem(seed)
        pgcp = solve(problem, params("pgcp"))
        once = solve(problem, params("cooperative", restarts=0))
        assert len(pgcp.unserved) <= len(once.unserved)


def test_cost_is_that_of_the_tidied_paths(monkeypatch: pytest.MonkeyPatch) -> None:
    """§1.9: tidying to and fro into waiting may save handovers; the cost given is the new one."""
    problem = grid(3, 1, [(0, 2)])
    clumsy = path_of(problem, 0, "0a 1b 0a 1a 2a")
    monkeypatch.setattr("planner.solve.cooperative_with_restarts", lambda *_args, **_more: [clumsy])
    plan = solve(problem, params("auto", iterations=0))
    assert check_plan(problem, plan) == []
    assert plan.cost < 4 + 2 * problem.c_h


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


def test_nodes_ask_for_a_tree_search() -> None:
    """§1.13: `nodes` without a time limit buys a better bound by tree search, up to that count."""
    problem = random_hall(5, size=8, n=14, T=24, m=6)
    without = solve(problem, SolveParams(iterations=300))
    found = solve(problem, SolveParams(iterations=300, nodes=3))
    assert without.lower_bound is not None
    assert without.lower_bound < without.cost
    assert "nodes" not in without.solver
    assert 1 <= found.solver["nodes"] <= 3
    assert found.lower_bound is not None
    assert without.lower_bound <= found.lower_bound <= found.cost <= without.cost
