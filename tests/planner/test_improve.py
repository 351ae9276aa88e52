"""Large neighbourhood search: never worse, never against the rules, always the same."""

from __future__ import annotations

import numpy as np
import pytest

from planner.check import check_plan
from planner.cooperative import cooperative_astar
from planner.expanded_graph import ExpandedGraph
from planner.improve import LargeNeighbourhoodSearch
from planner.plan import Path, Plan
from planner.problem import Problem
from planner.resources import Resources
from planner.search import Search
from tests.oracles.arcflow import solve_arcflow
from tests.oracles.expanded import path_cost
from tests.oracles.tiny_problems import random_hall, tiny_problem
from tests.planner.examples import grid, path_of


def reachable(problem: Problem) -> bool:
    """Every robot alone on the floor reaches its goal, as the search asks for."""
    search = Search(ExpandedGraph.of(problem))
    return all(search.can_arrive(i) for i in range(problem.n_robots))


SEEDS = [seed for seed in range(70) if reachable(tiny_problem(seed))]


def begin(
    problem: Problem, *, seed: int = 0, paths: list[Path | None] | None = None, max_size: int = 10
) -> LargeNeighbourhoodSearch:
    """A search that begins with the given plan, else with that of cooperative A*."""
    search, resources = Search(ExpandedGraph.of(problem)), Resources.of(problem)
    if paths is None:
        paths = cooperative_astar(search, resources, range(problem.n_robots))
    return LargeNeighbourhoodSearch(search, resources, paths, seed=seed, max_size=max_size)


def assert_sound(problem: Problem, neighbourhoods: LargeNeighbourhoodSearch) -> tuple[int, int]:
    """The plan breaks no rule and costs what is said; returns (robots left out, cost)."""
    paths = neighbourhoods.paths()
    cost = sum(path_cost(problem, path) for path in paths if path is not None)
    left_out = paths.count(None)
    status = "unknown" if left_out else "feasible"
    assert check_plan(problem, Plan(status, problem.robot_ids, tuple(paths), cost, 0.0)) == []
    assert neighbourhoods.cost == cost + left_out * neighbourhoods.unserved_cost
    return left_out, cost


@pytest.mark.parametrize("seed", SEEDS)
def test_never_worse_and_always_legal(seed: int) -> None:
    """After every batch: no rule broken, no more robots left out, and of as many, no dearer."""
    problem = tiny_problem(seed)
    neighbourhoods = begin(problem, seed=seed)
    before = assert_sound(problem, neighbourhoods)
    for batch in (1, 1, 2, 3, 5, 10, 30):
        lowered = neighbourhoods.run(batch)
        after = assert_sound(problem, neighbourhoods)
        assert after <= before
        assert (lowered > 0) == (after < before)
        assert 0 <= lowered <= batch
        before = after


@pytest.mark.parametrize("at_goal", ["leave", "park"])
@pytest.mark.parametrize("objective", ["hp", "tp", "snr"])
def test_never_worse_on_a_crowded_hall(objective: str, at_goal: str) -> None:
    """The same where twenty robots are in one another's way, for every objective and ending."""
    problem = random_hall(2, size=8, n=20, T=24, m=9, objective=objective, at_goal=at_goal)
    neighbourhoods = begin(problem, seed=5)
    first = before = assert_sound(problem, neighbourhoods)
    for _ in range(12):
        neighbourhoods.run(25)
        after = assert_sound(problem, neighbourhoods)
        assert after <= before
        before = after
    assert after < first


@pytest.mark.parametrize("seed", SEEDS[::3])
def test_begins_with_the_plan_it_is_given(seed: int) -> None:
    """Entering a plan and reading it back changes nothing, not even which parallel edge it took."""
    problem = tiny_problem(seed)
    search, resources = Search(ExpandedGraph.of(problem)), Resources.of(problem)
    paths = cooperative_astar(search, resources, reversed(range(problem.n_robots)))
    assert begin(problem, paths=paths).paths() == paths


def test_begins_with_slow_and_parallel_edges() -> None:
    """A given path keeps its slow edge, its wait and its handover (§1.1, §1.6)."""
    edges = [(0, 1), (1, 0), (1, 2)]
    problem = grid(3, 1, [(0, 2), (2, 1)], edge_uv=edges, edge_slots=[3, 2, 1], horizon=9)
    paths: list[Path | None] = [path_of(problem, 0, "0a 0b>1 0b>1 1a>2 2a"), None]
    assert begin(problem, paths=paths).paths() == paths


@pytest.mark.parametrize("seed", [*SEEDS[:12], "hall"])
def test_deterministic_by_seed_and_count(seed: int | str) -> None:
    """§1.15: the plan follows from seed and number of neighbourhoods, however they are split."""
    problem = random_hall(4, n=30) if seed == "hall" else tiny_problem(int(seed))
    plans = []
    for batches in ((60,), (20, 20, 20), (1, 59)):
        neighbourhoods = begin(problem, seed=7)
        for batch in batches:
            neighbourhoods.run(batch)
        plans.append(neighbourhoods.paths())
    assert plans[0] == plans[1] == plans[2]


def test_seed_matters() -> None:
    """Other seeds try other neighbourhoods."""
    problem = random_hall(4, n=30)
    costs = set()
    for seed in range(4):
        neighbourhoods = begin(problem, seed=seed)
        neighbourhoods.run(40)
        costs.add(neighbourhoods.cost)
    assert len(costs) > 1


def test_serves_robots_left_out() -> None:
    """§1.4 `park`: a robot that cooperative A* shut out gets its way once others make room."""
    # r0 parks at vertex 2, the only way to vertex 3, before r1 has come through.
    edges = [(0, 1), (1, 2), (2, 3), (1, 5)]
    problem = grid(4, 2, [(5, 2), (0, 3)], at_goal="park", edge_uv=edges)
    neighbourhoods = begin(problem)
    assert assert_sound(problem, neighbourhoods)[0] == 1
    neighbourhoods.run(50)
    assert assert_sound(problem, neighbourhoods) == (0, solve_arcflow(problem).cost)


def test_begins_with_nothing() -> None:
    """Without any path it plans the whole fleet."""
    problem = grid(3, 2, [(0, 2), (2, 0), (3, 5)])
    neighbourhoods = begin(problem, paths=[None, None, None])
    assert assert_sound(problem, neighbourhoods)[0] == 3
    neighbourhoods.run(100)
    assert assert_sound(problem, neighbourhoods) == (0, solve_arcflow(problem).cost)


@pytest.mark.parametrize("seed", range(4))
def test_never_drops_a_robot_to_save_the_others_time(seed: int) -> None:
    """§1.12: a plan is worth more than a cheaper part of one.

    r0 is parked in the middle and all others go round it; without it they would save more slots
    than a single path can cost.
    """
    errands = [(7, 7), (5, 8), (6, 9), (2, 12), (11, 13)]
    problem = grid(
        5, 3, errands, n_aps=1, horizon=6, at_goal="park", objective="costs", c_t=1, c_h=0
    )
    neighbourhoods = begin(problem, seed=seed)
    for _ in range(10):
        neighbourhoods.run(30)
        assert assert_sound(problem, neighbourhoods)[0] == 0


def test_serving_one_more_is_worth_any_delay() -> None:
    """§1.12: a robot left out is served even where that costs the others more than its path.

    r0 must go straight along the upper row, through every other goal in just the slot in which
    its robot would get there: their delays and its own five slots are more than a path can cost.
    """
    errands = [(0, 5), (14, 2), (16, 3), (7, 4)]
    problem = grid(6, 3, errands, n_aps=1, horizon=5, objective="costs", c_t=1, c_h=0)
    exact = solve_arcflow(problem)
    search, resources = Search(ExpandedGraph.of(problem)), Resources.of(problem)
    paths = cooperative_astar(search, resources, [1, 2, 3])
    path_sum = sum(path_cost(problem, path) for path in paths if path is not None)
    neighbourhoods = begin(problem, paths=paths)
    neighbourhoods.run(200)
    assert exact.cost - path_sum > problem.horizon * problem.c_t + 1
    assert assert_sound(problem, neighbourhoods) == (0, exact.cost)


def test_nothing_is_possible() -> None:
    """§1.6: where no AP has a place nobody is served, and nothing breaks."""
    problem = grid(2, 1, [(0, 1), (1, 0)], ap_capacity=[0, 0])
    neighbourhoods = begin(problem)
    assert neighbourhoods.run(50) == 0
    assert assert_sound(problem, neighbourhoods) == (2, 0)


@pytest.mark.parametrize("at_goal", ["leave", "park"])
def test_single_robot_and_robot_at_its_goal(at_goal: str) -> None:
    """§1.5: one robot is left as it is; one at its goal keeps its one-state path."""
    problem = grid(3, 1, [(1, 1)], at_goal=at_goal)
    neighbourhoods = begin(problem)
    neighbourhoods.run(20)
    (path,) = neighbourhoods.paths()
    assert path is not None
    assert path.vertices.tolist() == [1]
    problem = grid(3, 2, [(1, 1), (0, 2)], at_goal=at_goal)
    neighbourhoods = begin(problem)
    neighbourhoods.run(20)
    path = neighbourhoods.paths()[0]
    assert path is not None
    assert path.vertices.tolist() == [1]
    assert assert_sound(problem, neighbourhoods)[0] == 0


def test_size_of_neighbourhoods_is_bounded_by_the_fleet() -> None:
    """Neighbourhoods of two, and larger ones than there are robots, both work."""
    problem = random_hall(0, size=6, n=6, T=16, m=4)
    for max_size in (1, 2, 50):
        neighbourhoods = begin(problem, max_size=max_size)
        neighbourhoods.run(60)
        assert assert_sound(problem, neighbourhoods)[0] == 0


def test_quality() -> None:
    """On nine in ten of the tiny problems that cooperative A* serves, it ends at the optimum."""
    optimal = served = 0
    for seed in SEEDS:
        problem = tiny_problem(seed)
        neighbourhoods = begin(problem)
        neighbourhoods.run(200)
        left_out, cost = assert_sound(problem, neighbourhoods)
        if not left_out:
            served += 1
            optimal += cost == solve_arcflow(problem).cost
    assert served >= 30
    assert optimal >= 0.9 * served


def test_improves_a_hall() -> None:
    """On the paper's hall with 50 robots some hundred neighbourhoods lower the cost, and more lower
    it further.
    """
    problem = random_hall(0, n=50)
    neighbourhoods = begin(problem)
    costs = [neighbourhoods.cost]
    for _ in range(2):
        neighbourhoods.run(150)
        assert assert_sound(problem, neighbourhoods)[0] == 0
        costs.append(neighbourhoods.cost)
    assert costs[0] > costs[1] > costs[2]
    assert costs[2] < 0.98 * costs[0]


def test_paths_are_copies() -> None:
    """A plan read off is not changed by what is tried after it."""
    problem = random_hall(0, n=30)
    neighbourhoods = begin(problem)
    first = neighbourhoods.paths()
    kept = [None if p is None else (p.vertices.copy(), p.aps.copy()) for p in first]
    neighbourhoods.run(200)
    for path, copy in zip(first, kept, strict=True):
        if path is not None and copy is not None:
            assert np.array_equal(path.vertices, copy[0])
            assert np.array_equal(path.aps, copy[1])
