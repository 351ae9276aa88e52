"""Branching splits the plans in two: none is lost, none is in both, and pricing keeps to it."""

from __future__ import annotations

import numpy as np
import pytest

from planner.branching import Arrive, Decision, Occupy, choose, complement, restrict
from planner.expanded_graph import ExpandedGraph
from planner.master import Column, Master
from planner.plan import Path
from planner.problem import Problem
from planner.resources import BLOCKED, SCALE, Resources
from planner.search import INFINITE, NOTHING_FORBIDDEN, Penalties, Search
from tests.oracles.tiny_problems import tiny_problem
from tests.planner.examples import grid, path_of

SEEDS = range(25)


def parts(problem: Problem) -> tuple[ExpandedGraph, Resources, Search]:
    """What branching works on."""
    graph = ExpandedGraph.of(problem)
    return graph, Resources.of(problem), Search(graph)


def noise(resources: Resources, rng: np.random.Generator) -> Penalties:
    """Random penalties on a third of the resources."""
    penalties = Penalties(resources)
    amount = rng.integers(0, 3 * SCALE, resources.n) * (rng.random(resources.n) < 0.3)
    penalties.set(np.arange(resources.n), amount)
    return penalties


def shortest(
    search: Search,
    resources: Resources,
    penalties: Penalties,
    robot: int,
    decisions: list[Decision],
) -> tuple[int, Path | None]:
    """Least-cost path that keeps the decisions, as the tree search prices it."""
    kept = restrict(robot, decisions, search.graph, resources, NOTHING_FORBIDDEN)
    slots, moves = kept.moves[:, 0], kept.moves[:, 1]
    before = penalties.move[slots, moves].copy()
    penalties.move[slots, moves] = BLOCKED
    answer = search.shortest(
        robot,
        penalties,
        limit=INFINITE,
        forbidden=kept.forbidden,
        earliest=kept.earliest,
        latest=kept.latest,
    )
    penalties.move[slots, moves] = before
    return answer


def a_decision(
    problem: Problem, resources: Resources, robot: int, path: Path, rng: np.random.Generator
) -> Decision:
    """A decision about a robot: half of them about what its path uses, half about anything."""
    kind = int(rng.integers(3))
    if kind == 0:
        return Arrive(robot, int(rng.integers(problem.horizon + 1)), bool(rng.integers(2)))
    used = resources.used_by(path)
    if kind == 1 and len(used):
        resource = int(rng.choice(used))
    else:
        resource = int(rng.integers(problem.n_vertices, resources.n))  # vertices in slot 0 are none
    return Occupy(robot, resource, bool(rng.integers(2)))


@pytest.mark.parametrize("seed", SEEDS)
def test_the_best_path_is_the_better_of_the_two_sides(seed: int) -> None:
    """No path is lost by branching, however often, and pricing finds none that breaks a decision.

    With edges of several slots, one-way edges, parallel edges, leave and park.
    """
    problem = tiny_problem(seed)
    graph, resources, search = parts(problem)
    rng = np.random.default_rng(seed)
    master = Master(resources, 1.0)
    for robot in range(problem.n_robots):
        decisions: list[Decision] = []
        for _ in range(6):
            penalties = noise(resources, rng)
            cost, path = shortest(search, resources, penalties, robot, decisions)
            if path is None:
                break
            column = master.column(robot, path)
            assert all(d.keeps(column) for d in decisions)
            decision = a_decision(problem, resources, robot, path, rng)
            assert decision.keeps(column) != complement(decision).keeps(column)
            sides = [
                shortest(search, resources, penalties, robot, [*decisions, side])[0]
                for side in (decision, complement(decision))
            ]
            assert min(sides) == cost
            decisions.append(decision if rng.integers(2) else complement(decision))
    assert graph.n_nodes


def test_other_robots_are_not_concerned() -> None:
    """A decision about one robot leaves all paths of the others."""
    problem = grid(3, 1, [(0, 2), (2, 0)])
    resources = Resources.of(problem)
    column = Master(resources, 1.0).column(1, path_of(problem, 1, "2a 1a 0a"))
    for decision in (Arrive(0, 1, True), Occupy(0, int(column.used[0]), False)):
        assert decision.keeps(column)
        assert complement(decision).keeps(column)


def test_amid_an_edge_a_robot_stands_nowhere() -> None:
    """§1.1: a robot that must stand at a vertex in a slot cannot be on an edge of k slots then."""
    problem = grid(3, 1, [(0, 2)], n_aps=1, edge_slots=np.array([2, 1]))
    graph, resources, search = parts(problem)
    free = Penalties(resources)
    stand_in_1 = Occupy(0, 1 * problem.n_vertices + 0, True)  # at vertex 0 in slot 1
    _, path = shortest(search, resources, free, 0, [stand_in_1])
    assert path is not None
    assert path.edges.tolist() == [-1, 0, 0, 1]
    serve_in_1 = Occupy(0, resources.first_ap + 1, False)  # not by the only AP in slot 1
    assert shortest(search, resources, free, 0, [serve_in_1])[1] is None
    assert graph.n_nodes == 3


def columns_of(problem: Problem, *paths: tuple[int, str]) -> list[Column]:
    """Columns of paths written as states."""
    master = Master(Resources.of(problem), 1.0)
    return [master.column(i, path_of(problem, i, states)) for i, states in paths]


def test_arrival_slots_are_split_before_resources() -> None:
    """A robot half in time and half late is asked when it arrives; both sides lose a path."""
    problem = grid(3, 2, [(0, 2)], n_aps=1)
    columns = columns_of(problem, (0, "0a 1a 2a"), (0, "0a 0a 1a 2a"))
    sides = choose(columns, np.array([0.5, 0.5]), Resources.of(problem))
    assert sides is not None
    assert isinstance(sides[0], Arrive)
    for side in sides:
        assert [side.keeps(c) for c in columns].count(True) == 1


def test_paths_of_one_arrival_are_told_apart_by_a_resource() -> None:
    """Paths that arrive together differ in a vertex, an edge or an AP in some slot."""
    problem = grid(2, 2, [(0, 3)], n_aps=2)
    for other in ("0a 2a 3a", "0a 1b 3b", "0b 1b 3b"):
        columns = columns_of(problem, (0, "0a 1a 3a"), (0, other))
        sides = choose(columns, np.array([0.4, 0.6]), Resources.of(problem))
        assert sides is not None
        for side in sides:
            assert [side.keeps(c) for c in columns].count(True) == 1


def test_parallel_edges_are_told_apart() -> None:
    """Two paths of the same states by two edges between the same vertices differ in the edge."""
    problem = grid(2, 1, [(0, 1)], n_aps=1, edge_uv=np.array([(0, 1), (0, 1)]))
    columns = columns_of(problem, (0, "0a>0 1a"), (0, "0a>1 1a"))
    sides = choose(columns, np.array([0.5, 0.5]), Resources.of(problem))
    assert sides is not None
    assert [sides[0].keeps(c) for c in columns] != [sides[1].keeps(c) for c in columns]


def test_nothing_to_branch_on_at_an_integer_solution() -> None:
    """One path per robot: there is nothing left to decide."""
    problem = grid(3, 2, [(0, 2), (3, 5)], n_aps=1)
    columns = columns_of(problem, (0, "0a 1a 2a"), (1, "3a 4a 5a"))
    assert choose(columns, np.ones(2), Resources.of(problem)) is None
