"""Neighbourhood search beside the tree search, work on all cores, telling the planner to stop."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from planner import companion as companion_module
from planner import parallel
from planner.check import check_plan
from planner.companion import Companion
from planner.cooperative import cooperative_with_restarts
from planner.expanded_graph import ExpandedGraph
from planner.plan import Path, Plan
from planner.problem import Problem
from planner.resources import Resources
from planner.search import Search
from planner.solve import Progress, SolveParams, solve
from tests.oracles.tiny_problems import random_hall


def start(problem: Problem) -> tuple[Search, Resources, list[Path | None]]:
    """A search, its resources and a first plan."""
    search, resources = Search(ExpandedGraph.of(problem)), Resources.of(problem)
    rng = np.random.default_rng(0)
    return search, resources, cooperative_with_restarts(search, resources, restarts=5, rng=rng)


def cost_of(problem: Problem, paths: list[Path | None]) -> int:
    """§1.9."""
    return sum(problem.c_t * p.arrival + problem.c_h * p.handovers for p in paths if p)


@pytest.mark.parametrize("threads", ["1", "2"])
def test_the_companion_finds_better_plans(threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside or by turns, it tells only plans that keep the rules, each cheaper than the last."""
    monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
    problem = random_hall(4, n=30)
    search, resources, paths = start(problem)
    assert None not in paths
    costs = [cost_of(problem, paths)]
    with Companion(search, resources, paths, seed=1) as companion:
        until = time.perf_counter() + 20
        while len(costs) < 3 and time.perf_counter() < until:
            time.sleep(0.01)
            found = companion.better()
            if found is not None:
                costs.append(cost_of(problem, found))
                plan = Plan("feasible", problem.robot_ids, tuple(found), costs[-1], 0.0)
                assert check_plan(problem, plan) == []
    assert len(costs) >= 3
    assert costs == sorted(costs, reverse=True)
    assert len(set(costs)) == len(costs)
    assert companion.neighbourhoods > 0


def test_the_companion_goes_on_from_a_better_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plan offered from outside is what it improves from then on, and none is told twice."""
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    problem = random_hall(4, n=30)
    search, resources, paths = start(problem)
    best = list(solve(problem, SolveParams(iterations=2000)).paths)
    with Companion(search, resources, paths, seed=1) as companion:
        companion.offer(best)
        companion.better()
        assert companion._walk.cost <= cost_of(problem, best)
        assert not companion._thread.is_alive()


def test_the_thread_ends_with_the_companion(monkeypatch: pytest.MonkeyPatch) -> None:
    """No thread is left behind, even when what it accompanies fails."""
    monkeypatch.setattr(companion_module, "n_threads", lambda: 2)
    search, resources, paths = start(random_hall(4, n=30))
    with pytest.raises(RuntimeError), Companion(search, resources, paths, seed=1):
        raise RuntimeError
    assert not [t for t in threading.enumerate() if t.name == "neighbourhoods"]


@pytest.mark.parametrize("threads", ["1", "2", "not a number"])
def test_results_come_in_order(threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """§1.15: whatever the number of threads, results are those of a plain loop, in its order."""
    monkeypatch.setenv("NUMBA_NUM_THREADS", threads)

    def slow_first(k: int) -> int:
        time.sleep(0.002 * (k % 3 == 0))
        return k * k

    assert list(parallel.each(slow_first, range(30))) == [k * k for k in range(30)]


def test_stopping_leaves_results_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Told to stop, `each` gives what it has so far: a beginning of the results."""
    monkeypatch.setattr(parallel, "n_threads", lambda: 2)
    done: list[int] = []
    for result in parallel.each(lambda k: k, range(100), stop=lambda: len(done) >= 10):
        done.append(result)  # noqa: PERF402 - `stop` looks at how many there are by now
    assert done == list(range(len(done)))
    assert 10 <= len(done) < 100


@pytest.mark.parametrize("method", ["auto", "exact", "pgcp"])
def test_told_to_stop_the_best_so_far_is_the_answer(method: str) -> None:
    """Whoever presses Ctrl-C gets the best plan so far, with a bound that holds."""
    problem = random_hall(4, n=30)
    told = 0

    def stop() -> bool:
        nonlocal told
        told += 1
        return told > 12

    params = SolveParams(method=method, iterations=100_000_000)  # type: ignore[arg-type]
    plan = solve(problem, params, stop=stop)
    assert check_plan(problem, plan) == []
    best = solve(problem, SolveParams(iterations=2000))
    assert best.cost is not None
    assert plan.lower_bound is not None
    assert plan.lower_bound <= best.cost


def test_a_time_limit_is_kept_and_improves_both_sides() -> None:
    """With a time limit bounds rise, costs fall, and the answer is the last of both."""
    problem = random_hall(4, n=30)
    seen: list[Progress] = []
    plan = solve(problem, SolveParams(time_limit=1.5), seen.append)
    assert check_plan(problem, plan) == []
    complete = [p for p in seen if p.served == problem.n_robots]
    assert [p.bound for p in seen] == sorted(p.bound for p in seen)
    costs = [p.cost for p in complete]
    assert costs == sorted(costs, reverse=True)
    assert plan.cost <= costs[-1]
    assert plan.lower_bound is not None
    assert plan.lower_bound <= plan.cost
