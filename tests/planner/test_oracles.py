"""The oracles agree with each other, with the checker, and with enumeration by definition."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from itertools import product

import numpy as np
import pytest

from planner.check import check_plan
from planner.plan import Path, Plan
from planner.problem import Problem
from tests.oracles.algorithm1 import algorithm1
from tests.oracles.arcflow import arcflow_bound, solve_arcflow
from tests.oracles.expanded import ExplicitGraph, Penalties, path_cost
from tests.oracles.tiny_problems import random_hall, tiny_problem
from tests.planner.examples import grid

SEEDS = range(25)


def walks(problem: Problem, robot: int) -> Iterator[Path]:
    """Every sequence of states and edges that could be a path, legal or not."""
    start, goal = int(problem.start[robot]), int(problem.goal[robot])

    def onward(vertices: list[int], aps: list[int], edges: list[int]) -> Iterator[Path]:
        if vertices[-1] == goal:
            yield Path(
                problem.robot_ids[robot], *(np.array(x, int) for x in (vertices, aps, edges))
            )
        moves = [(-1, vertices[-1], 1)]
        for e, (u, v) in enumerate(problem.edge_uv.tolist()):
            k = int(problem.edge_slots[e])
            if vertices[-1] in (u, v):
                moves.append((e, v if vertices[-1] == u else u, k))
        for e, to, k in moves:
            if len(vertices) - 1 + k <= problem.horizon:
                for b in range(problem.n_aps):
                    yield from onward(
                        vertices + vertices[-1:] * (k - 1) + [to],
                        aps + aps[-1:] * (k - 1) + [b],
                        edges + [e] * k,
                    )

    for a in range(problem.n_aps):
        yield from onward([start], [a], [])


def legal_paths(problem: Problem, robot: int) -> list[Path]:
    """Every path of one robot that the checker accepts when it is alone, cheapest first."""
    alone = dataclasses.replace(
        problem,
        robot_ids=(problem.robot_ids[robot],),
        start=problem.start[[robot]],
        goal=problem.goal[[robot]],
    )
    good = []
    for path in walks(problem, robot):
        cost = path_cost(problem, path)
        if not check_plan(alone, Plan("feasible", alone.robot_ids, (path,), cost, 0.0)):
            good.append(path)
    return sorted(good, key=lambda path: path_cost(problem, path))


def optimum_by_definition(problem: Problem) -> int | None:
    """The cheapest combination of paths that the checker accepts, None if there is none."""
    choices = [legal_paths(problem, i) for i in range(problem.n_robots)]
    plans = sorted(
        product(*choices), key=lambda paths: sum(path_cost(problem, path) for path in paths)
    )
    for paths in plans:
        cost = sum(path_cost(problem, path) for path in paths)
        if not check_plan(problem, Plan("feasible", problem.robot_ids, paths, cost, 0.0)):
            return cost
    return None


@pytest.mark.parametrize("seed", range(20))
def test_arcflow_finds_the_optimum_by_definition(seed):
    """§1.12: on problems small enough to enumerate, the integer program's answer is the truth."""
    problem = tiny_problem(seed, max_robots=2, max_slots=3)
    plan = solve_arcflow(problem)
    assert (plan.cost if plan.status == "optimal" else None) == optimum_by_definition(problem)


@pytest.mark.parametrize("seed", SEEDS)
def test_oracles_agree(seed):
    """Both oracles' plans pass the checker; the master LP is the arc-flow LP and a lower bound.

    §1.13: LP value ≤ optimum ≤ cost of Algorithm 1; §1.14: the solution ratio is at least 1.
    """
    problem = tiny_problem(seed)
    exact, paper = solve_arcflow(problem), algorithm1(problem)
    for plan in (exact, paper.plan, paper.initial):
        assert check_plan(problem, plan) == []
    bound = arcflow_bound(problem)
    if paper.artificial_use < 1e-9:
        assert bound is not None
        assert paper.lp_value == pytest.approx(bound, abs=1e-6)
    if exact.status == "infeasible":
        assert paper.plan.unserved
        return
    assert bound is not None
    assert bound <= exact.cost + 1e-6
    assert paper.lp_value <= exact.cost + 1e-6
    assert paper.plan.lower_bound <= exact.cost + 1e-6
    if not paper.plan.unserved:
        assert paper.plan.cost >= exact.cost
        assert paper.plan.status != "optimal" or paper.plan.cost == exact.cost


KNOWN = {
    "waiting costs like moving": (grid(3, 1, [(0, 2), (1, 2)]), 3),
    "two pass in a pocket": (
        grid(3, 2, [(0, 2), (2, 0)], horizon=4),
        6,
    ),
    "no pocket, no plan": (grid(4, 1, [(0, 3), (3, 0)]), None),
    "a handover is dearer than a detour": (
        grid(3, 2, [(0, 2)], cover=[[0], [1], [0], [0], [0], [0]]),
        4,
    ),
    "time first takes two handovers": (
        grid(
            3,
            2,
            [(0, 2)],
            cover=[[0], [1], [0], [0], [0], [0]],
            objective="tp",
            c_t=8,
            c_h=1,
        ),
        18,
    ),
    "a parked robot is in the way": (
        grid(3, 1, [(0, 2), (1, 1)], at_goal="park"),
        None,
    ),
    "one that left is not": (grid(3, 1, [(0, 2), (1, 1)], at_goal="leave"), 2),
    "it waits for a place at the only AP": (
        grid(4, 1, [(1, 0), (2, 3)], cover=[[0, 1], [1], [0], [0]], ap_capacity=[1, 1]),
        2,
    ),
    "no place at the AP in slot 0": (grid(4, 1, [(0, 1), (3, 2)], n_aps=1, ap_capacity=[1]), None),
    "a slow edge takes its slots": (grid(2, 1, [(0, 1)], edge_slots=[5]), 5),
    "two lanes let two meet": (
        grid(2, 1, [(0, 1), (1, 0)], edge_uv=[(0, 1), (1, 0)], edge_oneway=[True, True]),
        2,
    ),
    "one edge does not": (grid(2, 1, [(0, 1), (1, 0)]), None),
    "one lane is the long way round": (
        grid(2, 2, [(1, 0)], edge_oneway=[True, False, False, False]),
        3,
    ),
}


@pytest.mark.parametrize("name", KNOWN)
def test_known_optimum(name):
    """§1.1 to §1.9 on cases whose optimum can be seen; None means that there is no plan."""
    problem, cost = KNOWN[name]
    plan = solve_arcflow(problem)
    assert check_plan(problem, plan) == []
    assert (plan.cost if plan.status == "optimal" else None) == cost
    paper = algorithm1(problem)
    assert check_plan(problem, paper.plan) == []
    if cost is not None:
        assert paper.lp_value <= cost + 1e-6


def test_robot_without_any_path_is_named():
    """§1.12: when a robot is cut off, both oracles call the problem infeasible and name it."""
    problem = grid(4, 1, [(0, 1), (2, 3)], edge_uv=[(0, 1), (1, 2)])
    assert solve_arcflow(problem).infeasible_robots == ("r1",)
    plan = algorithm1(problem).plan
    assert (plan.status, plan.infeasible_robots) == ("infeasible", ("r1",))
    assert check_plan(problem, plan) == []


@pytest.mark.parametrize("seed", range(12))
def test_size_of_the_expanded_graph(seed):
    """§1.11: |V'| = (T+1) Σ|A_v|; under `endpoints` |E'| = T (Σ|A_v|² + Σ_(v,u) |A_v||A_u|)."""
    problem = tiny_problem(seed, features=False)
    graph = ExplicitGraph(problem)
    size = problem.cover.sum(axis=1).astype(int)
    pairs = (size**2).sum() + 2 * sum(size[u] * size[v] for u, v in problem.edge_uv)
    assert graph.n_nodes == (problem.horizon + 1) * size.sum()
    assert graph.n_arcs == problem.horizon * pairs


def test_size_of_the_paper_hall():
    """§1.11: about 50 000 vertices and 600 000 edges at T = 60, averaged over halls."""
    graphs = [ExplicitGraph(random_hall(seed)) for seed in range(3)]
    assert np.mean([graph.n_nodes for graph in graphs]) == pytest.approx(50_000, rel=0.1)
    assert np.mean([graph.n_arcs for graph in graphs]) == pytest.approx(600_000, rel=0.2)


def test_slow_arcs_end_within_the_horizon():
    """§1.1: an edge of k slots can be entered in slots 0 … T − k."""
    problem = grid(2, 1, [(0, 1)], n_aps=1, horizon=5, edge_slots=[3])
    graph = ExplicitGraph(problem)
    assert np.count_nonzero(graph.edge == 0) == 2 * (5 - 3 + 1)
    assert graph.n_arcs == 2 * 5 + 6


def test_penalties_are_paid_once_per_use():
    """§1.4, §1.6: a path pays the edge in each slot of a crossing, its AP amid it and parked."""
    problem = grid(2, 1, [(0, 1)], n_aps=1, horizon=5, edge_slots=[3], at_goal="park")
    graph = ExplicitGraph(problem)
    penalties = Penalties.none(problem)
    penalties.edge[:, 0] = 100.0
    penalties.ap[:, 0] = 10.0
    penalties.vertex[:] = 1.0
    weight, path = graph.shortest_path(0, graph.weigh(penalties))
    # At once: 3 slots, 3 edge slots, the AP in all 6 slots, the goal in slots 3, 4 and 5.
    assert path.edges.tolist() == [0, 0, 0]
    assert weight == 3 + 300 + 60 + 3
    # Later: two waits cost two slots more and stand at a vertex in the same number of slots.
    penalties.edge[:2, 0] = 1000.0
    weight, path = graph.shortest_path(0, graph.weigh(penalties))
    assert path.edges.tolist() == [-1, -1, 0, 0, 0]
    assert weight == 5 + 300 + 60 + 3


def test_algorithm1_on_a_hall():
    """The paper's case in small: PGCP's plan is legal, within a few per cent of the LP bound."""
    problem = random_hall(3, size=8, n=8, T=24, m=4)
    result = algorithm1(problem)
    assert check_plan(problem, result.plan) == []
    assert result.artificial_use < 1e-9
    assert 1.0 <= result.plan.cost / result.lp_value < 1.1
    assert set(result.seconds) >= {"expanded graph", "initial solution", "master", "pricing"}
    assert result.rows == 24 * (problem.n_vertices + problem.n_edges) + 25 * problem.n_aps


def test_tiny_problems_show_every_feature():
    """The family used in the tests has each rule's special cases, feasible and not."""
    problems = [tiny_problem(seed) for seed in range(200)]
    assert {p.objective for p in problems} == {"hp", "tp", "snr", "costs"}
    assert {p.at_goal for p in problems} == {"leave", "park"}
    assert any((p.edge_slots > 1).any() for p in problems)
    assert any(p.edge_oneway.any() for p in problems)
    assert any((p.start == p.goal).any() for p in problems)
    assert any(len(set(p.goal.tolist())) < p.n_robots for p in problems)
    assert any((p.ap_capacity == 0).any() for p in problems)
    assert any(not p.cover.all() for p in problems)
    assert any(len({frozenset(uv) for uv in p.edge_uv.tolist()}) < p.n_edges for p in problems)
    ends = [p.cover[p.edge_uv[:, 0]] & p.cover[p.edge_uv[:, 1]] for p in problems]
    assert any((p.edge_cover != both).any() for p, both in zip(problems, ends, strict=True))
    assert tiny_problem(7) == tiny_problem(7)


@pytest.mark.parametrize("edge_rule", ["endpoints", "samples"])
def test_random_hall_is_one_component_and_repeatable(edge_rule):
    """Same seed, same hall; every robot has distinct ends and a way between them."""
    problem = random_hall(4, size=20, n=50, at_goal="park", edge_rule=edge_rule)
    assert problem == random_hall(4, size=20, n=50, at_goal="park", edge_rule=edge_rule)
    assert problem != random_hall(5, size=20, n=50, at_goal="park", edge_rule=edge_rule)
    assert 250 < problem.n_vertices <= 280
    reach = {int(problem.start[0])}
    edges = problem.edge_uv.tolist()
    for _ in range(problem.n_vertices):
        reach |= {v for uv in edges if reach & set(uv) for v in uv}
    assert set(problem.start.tolist()) | set(problem.goal.tolist()) <= reach
