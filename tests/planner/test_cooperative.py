"""Reservations count what paths use; cooperative A* plans around them (paper, line 2)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.check import check_plan
from planner.cooperative import Reservations, cooperative_astar, cooperative_with_restarts
from planner.expanded_graph import ExpandedGraph
from planner.plan import Path, Plan
from planner.problem import Problem
from planner.resources import BLOCKED, SCALE, Resources
from planner.search import Penalties, Search
from tests.oracles import expanded as explicit
from tests.oracles.tiny_problems import random_hall, tiny_problem, tiny_problems
from tests.planner.examples import grid, path_of

FEW = settings(derandomize=True, deadline=None, max_examples=60)
SEEDS = st.integers(0, 2**32 - 1)


def parts(problem: Problem) -> tuple[Search, Resources]:
    """What the planner searches with."""
    return Search(ExpandedGraph.of(problem)), Resources.of(problem)


def plan_of(problem: Problem, paths: list[Path | None]) -> Plan:
    """The paths as a plan that claims as little as it may."""
    cost = sum(explicit.path_cost(problem, p) for p in paths if p is not None)
    status = "unknown" if None in paths else "feasible"
    return Plan(status, problem.robot_ids, tuple(paths), cost, 0.0)


def random_paths(problem: Problem, rng: np.random.Generator, count: int) -> list[Path]:
    """Paths of any robots, pushed about by random penalties; they may collide."""
    search, resources = parts(problem)
    penalties = Penalties(resources)
    found = []
    for _ in range(count):
        noise = rng.integers(0, 3 * SCALE, resources.n) * (rng.random(resources.n) < 0.3)
        penalties.set(np.arange(resources.n), noise)
        _, path = search.shortest(int(rng.integers(problem.n_robots)), penalties)
        if path is not None:
            found.append(path)
    return found


def used_by_definition(problem: Problem, path: Path) -> list[int]:
    """Resource indices by the oracle's tables: vertices, edges, APs; slot 0 needs no vertex."""
    used = explicit.usage(problem, path)
    used.vertex[0] = 0
    flat = np.concatenate([used.vertex.ravel(), used.edge.ravel(), used.ap.ravel()])
    return np.flatnonzero(flat).tolist()


@FEW
@given(tiny_problems(), SEEDS)
def test_used_resources_are_those_of_the_definition(problem: Problem, seed: int) -> None:
    """§1.2, §1.3, §1.4, §1.6: vertices stood at, edges in each slot, APs, parking; each once."""
    resources = Resources.of(problem)
    for path in random_paths(problem, np.random.default_rng(seed), 6):
        assert sorted(resources.used_by(path).tolist()) == used_by_definition(problem, path)


def test_resources_of_a_slow_edge_and_parking() -> None:
    """§1.6: amid an edge no vertex is used but its AP is; parked, goal and AP are used up to T."""
    problem = grid(2, 1, [(0, 1)], horizon=5, edge_slots=[3], at_goal="park", ap_capacity=[1, 2])
    resources = Resources.of(problem)
    vertex, edge, ap = resources.shaped(np.arange(resources.n))
    path = path_of(problem, 0, "0b>0 0b>0 0b>0 1a")
    expected = [vertex[3, 1], vertex[4, 1], vertex[5, 1], edge[0, 0], edge[1, 0], edge[2, 0]]
    expected += [ap[0, 1], ap[1, 1], ap[2, 1], ap[3, 0], ap[4, 0], ap[5, 0]]
    assert sorted(resources.used_by(path)) == sorted(expected)
    capacity = [part.tolist() for part in resources.shaped(resources.capacity)]
    assert capacity == [[[1, 1]] * 6, [[1]] * 5, [[1, 2]] * 6]


@FEW
@given(tiny_problems(), SEEDS)
def test_reservations_return_to_zero(problem: Problem, seed: int) -> None:
    """At any time the count is the sum over paths and full means blocked; all removed, nothing."""
    rng = np.random.default_rng(seed)
    resources = Resources.of(problem)
    paths = [resources.used_by(path) for path in random_paths(problem, rng, 8)]
    reservations = Reservations(resources)
    at_first = reservations.penalties.resource.copy()
    inside: list[int] = []
    steps = [*range(len(paths)), *rng.permutation(len(paths)).tolist()]
    for k in steps:
        if k in inside:
            reservations.remove(paths[k])
            inside.remove(k)
        else:
            reservations.add(paths[k])
            inside.append(k)
        count = np.zeros(resources.n, np.int32)
        for j in inside:
            np.add.at(count, paths[j], 1)
        assert (reservations.count == count).all()
        full = count >= resources.capacity
        assert (reservations.penalties.resource == np.where(full, BLOCKED, 0)).all()
    assert inside == []
    assert not reservations.count.any()
    assert (reservations.penalties.resource == at_first).all()
    assert not reservations.penalties.move.any()


@FEW
@given(tiny_problems(), SEEDS)
def test_each_robot_takes_its_best_way_around_those_before(problem: Problem, seed: int) -> None:
    """The plan breaks no rule, and each path costs what the explicit G' says it must."""
    search, resources = parts(problem)
    order = np.random.default_rng(seed).permutation(problem.n_robots).tolist()
    paths = cooperative_astar(search, resources, order)
    assert check_plan(problem, plan_of(problem, paths)) == []
    graph = explicit.ExplicitGraph(problem)
    room = explicit.penalties_of(problem, explicit.row_capacities(problem))
    room.vertex[0] = np.inf
    for robot in order:
        full = explicit.Penalties(
            *(np.where(a <= 0, np.inf, 0.0) for a in (room.vertex, room.edge, room.ap))
        )
        least, _ = graph.shortest_path(robot, graph.weigh(full))
        path = paths[robot]
        assert (np.inf if path is None else explicit.path_cost(problem, path)) == least
        if path is not None:
            used = explicit.usage(problem, path)
            room.vertex -= used.vertex
            room.edge -= used.edge
            room.ap -= used.ap


def test_robots_not_asked_for_get_no_path() -> None:
    """Only the robots of the order are planned."""
    problem = grid(3, 2, [(0, 2), (3, 5), (2, 0)])
    paths = cooperative_astar(*parts(problem), [2, 0])
    assert [path is not None for path in paths] == [True, False, True]


def test_an_ap_without_places_serves_nobody() -> None:
    """§1.6: an AP of capacity 0 is never used, even though it covers all."""
    problem = grid(3, 1, [(0, 2)], ap_capacity=[0, 1])
    (path,) = cooperative_astar(*parts(problem), [0])
    assert path is not None
    assert path.aps.tolist() == [1, 1, 1]


def test_restarts_put_failures_first() -> None:
    """§1.4 `park`: the robot that is parked in the way must be planned last; restarts find that."""
    # r0 would park at vertex 2, the only way to vertex 3, before r1 has come through.
    edges = [(0, 1), (1, 2), (2, 3), (1, 5)]
    problem = grid(4, 2, [(5, 2), (0, 3)], at_goal="park", edge_uv=edges)
    search, resources = parts(problem)
    assert None in cooperative_astar(search, resources, [0, 1])
    rng = np.random.default_rng(0)
    paths = cooperative_with_restarts(search, resources, restarts=3, rng=rng)
    assert None not in paths
    assert check_plan(problem, plan_of(problem, paths)) == []


@pytest.mark.parametrize("seed", range(40))
def test_restarts_never_serve_fewer(seed: int) -> None:
    """The best order is kept: restarts serve at least as many robots as the given order."""
    problem = tiny_problem(seed)
    search, resources = parts(problem)
    once = cooperative_astar(search, resources, range(problem.n_robots))
    rng = np.random.default_rng(seed)
    best = cooperative_with_restarts(search, resources, restarts=5, rng=rng)
    assert sum(p is not None for p in best) >= sum(p is not None for p in once)
    assert check_plan(problem, plan_of(problem, best)) == []
    # §1.15: the same draws, the same plan.
    rng = np.random.default_rng(seed)
    assert cooperative_with_restarts(search, resources, restarts=5, rng=rng) == best
    rng = np.random.default_rng(seed)
    assert cooperative_with_restarts(search, resources, restarts=0, rng=rng) == once


def test_restarts_stop_when_told() -> None:
    """`stop` is asked after an order that left a robot out, and before every robot of the next."""
    problem = grid(2, 1, [(0, 1), (1, 0)])
    for times in range(1, 8):
        asked = []

        def stop(asked: list[int] = asked, times: int = times) -> bool:
            asked.append(len(asked))
            return len(asked) >= times

        rng = np.random.default_rng(0)
        paths = cooperative_with_restarts(*parts(problem), restarts=99, rng=rng, stop=stop)
        # Told in the midst of an order, it asks once more when that order is over.
        assert times <= len(asked) <= times + 1
        assert paths.count(None) == 1


@pytest.mark.parametrize("at_goal", ["leave", "park"])
@pytest.mark.parametrize("objective", ["hp", "tp", "snr"])
def test_a_hall(objective: str, at_goal: str) -> None:
    """A hall like the paper's with 40 robots: what is served breaks no rule."""
    problem = random_hall(1, n=40, m=20, objective=objective, at_goal=at_goal)
    search, resources = parts(problem)
    rng = np.random.default_rng(0)
    paths = cooperative_with_restarts(search, resources, restarts=10, rng=rng)
    assert check_plan(problem, plan_of(problem, paths)) == []
    assert sum(path is not None for path in paths) >= 38
