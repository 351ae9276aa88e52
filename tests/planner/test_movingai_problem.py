"""MAPF instances as problems: the grid, the horizon, and what a plan of theirs costs."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planner.check import check_plan
from planner.errors import PlannerError
from planner.expanded_graph import ExpandedGraph
from planner.mapf import cheapest_beyond, mapf_problem
from planner.problem import Problem
from planner.search import Search
from planner.solve import SolveParams, solve
from tests.oracles.arcflow import solve_arcflow
from worlds.formats.movingai import errands, parse_map, parse_scenario, read_map, read_scenario

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data" / "movingai"
BENCHMARK = pytest.mark.skipif(not SHARED.is_dir(), reason="../shared/data/movingai is not here")

SWAP = np.array([[1, 1, 1], [0, 1, 0]], bool)
"""A corridor with a bay: two agents that meet must use it."""


def breadth_first(free: np.ndarray, start: tuple[int, int], goal: tuple[int, int]) -> int | None:
    """Least steps from cell to cell, along four directions; None if there is no way."""
    distance, queue = {start: 0}, deque([start])
    while queue:
        x, y = here = queue.popleft()
        if here == goal:
            return distance[here]
        for cell in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
            inside = 0 <= cell[0] < free.shape[1] and 0 <= cell[1] < free.shape[0]
            if inside and free[cell[1], cell[0]] and cell not in distance:
                distance[cell] = distance[here] + 1
                queue.append(cell)
    return None


def swap(horizon: int | None = None) -> Problem:
    """Two agents change places in the corridor."""
    ends = np.array([(0, 0), (2, 0)])
    return mapf_problem("swap", SWAP, ends, ends[::-1], horizon)


def benchmark(name: str, agents: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Passable cells, starts and goals of a scenario."""
    grid = read_map(SHARED / f"{name}.map")
    scenario = read_scenario(SHARED / f"{name}-random-1.scen")
    return grid.passable, *errands(grid, scenario, agents)


def test_grid_becomes_vertices_and_edges():
    """One vertex per passable cell row by row, one edge per pair of neighbours, one AP for all."""
    p = swap()
    assert p.xy_m.tolist() == [[0, 1], [1, 1], [2, 1], [1, 0]]
    assert {frozenset(e) for e in p.edge_uv.tolist()} == {
        frozenset(e) for e in ((0, 1), (1, 2), (1, 3))
    }
    assert (p.n_aps, p.ap_capacity.tolist(), p.at_goal) == (1, [2], "park")
    assert (p.c_t, p.c_h) == (1, 0)
    assert p.cover.all()
    assert p.edge_cover.all()
    assert not p.edge_handover.any()
    assert p.start.tolist() == [0, 2]
    assert p.goal.tolist() == [2, 0]


def test_random_grids_have_every_edge_and_no_other():
    """Against a plain loop over all pairs of cells."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        free = rng.random((4, 5)) < 0.7
        free[0, 0] = free[3, 4] = True
        p = mapf_problem("g", free, np.array([[0, 0]]), np.array([[4, 3]]), 9)
        cells = [(x, 3 - y) for y in range(4) for x in range(5) if free[y, x]]
        assert p.xy_m.tolist() == [list(map(float, c)) for c in cells]
        expected = {
            frozenset((i, j))
            for i, a in enumerate(cells)
            for j, b in enumerate(cells)
            if abs(a[0] - b[0]) + abs(a[1] - b[1]) == 1
        }
        edges = [frozenset(e) for e in p.edge_uv.tolist()]
        assert set(edges) == expected
        assert len(edges) == len(expected)


def test_cost_is_the_sum_of_arrival_slots():
    """In the corridor one agent waits a slot, the other loses two: 3 + 4 (§1.9)."""
    plan = solve_arcflow(swap(8))
    assert check_plan(swap(8), plan) == []
    assert plan.status == "optimal"
    assert plan.cost == plan.slots == 7


def test_a_plan_for_the_corridor_is_never_a_false_one():
    """The planner may fail to find the swap, which takes planning for both at once (§1.12)."""
    plan = solve(swap(), SolveParams(iterations=200))
    assert check_plan(swap(), plan) == []
    assert plan.status != "infeasible"
    assert plan.lower_bound <= 7


def test_faulty_agents_are_all_named():
    """Off the map or on a blocked cell; equal starts are `Problem`'s to refuse (§1.2)."""
    with pytest.raises(PlannerError) as error:
        mapf_problem("m", SWAP, np.array([(0, 1), (-1, 0)]), np.array([(0, 0), (0, 7)]))
    assert len(error.value.lines) == 3
    assert "agent 0: its start, (x 0, y 1), is not a passable cell" in error.value.lines[0]
    assert "agent 1: its goal, (x 0, y 7)" in error.value.lines[2]
    with pytest.raises(PlannerError, match="same start"):
        mapf_problem("m", SWAP, np.array([(0, 0), (0, 0)]), np.array([(0, 0), (1, 0)]))


def test_horizon_can_be_given_and_must_be_one():
    """The number asked for, or a refusal."""
    assert swap(5).horizon == 5
    with pytest.raises(PlannerError, match="horizon"):
        swap(0)


def test_default_horizon_leaves_room_for_delays():
    """Longest shortest path 2, 2 agents, 4 vertices: 2 + 32 + 24 · 4 / 4."""
    assert swap().horizon == 2 + 32 + 24


def test_agent_without_any_way_is_proven_infeasible():
    """The default horizon counts those who have one; the planner then names the others (§1.12)."""
    free = np.array([[1, 1, 0, 1]], bool)
    p = mapf_problem("split", free, np.array([(0, 0), (3, 0)]), np.array([(1, 0), (0, 0)]))
    plan = solve(p)
    assert plan.status == "infeasible"
    assert plan.infeasible_robots == ("r01",)


def test_what_a_horizon_excludes_costs_at_least_so_much():
    """Whenever a longer horizon has a cheaper plan, `cheapest_beyond` is no more than its cost."""
    rng = np.random.default_rng(11)
    excluded = 0
    for _ in range(25):
        free = rng.random((3, 4)) < 0.7
        cells = np.argwhere(free)[:, ::-1]
        if len(cells) < 5:
            continue
        ends = cells[rng.permutation(len(cells))[:2]]
        long = mapf_problem("g", free, ends, ends[::-1], 14)
        truth = solve_arcflow(long)
        if truth.status != "optimal":
            continue
        for horizon in range(1, 8):
            short = replace(long, horizon=horizon)
            found = solve_arcflow(short)
            if found.status == "infeasible" or found.cost > truth.cost:
                excluded += 1
                assert cheapest_beyond(short) <= truth.cost
    assert excluded > 10


def test_cheapest_beyond_is_its_formula():
    """T + 1 + Σ d − max d: here d = 2 for both agents."""
    assert [cheapest_beyond(swap(horizon)) for horizon in (4, 5, 60)] == [7, 8, 63]


def test_from_text_to_plan(tmp_path):
    """A map and a scenario of this project's own, read, planned and checked."""
    rows = ["..@..", ".....", "..@.."]
    text = "type octile\nheight 3\nwidth 5\nmap\n" + "\n".join(rows) + "\n"
    (tmp_path / "gate.map").write_text(text)
    lines = ["0\tgate.map\t5\t3\t0\t1\t4\t1\t4", "0\tgate.map\t5\t3\t4\t0\t0\t0\t4.8"]
    (tmp_path / "gate.scen").write_text("version 1\n" + "\n".join(lines) + "\n")
    grid = read_map(tmp_path / "gate.map")
    starts, goals = errands(grid, read_scenario(tmp_path / "gate.scen"), 2)
    p = mapf_problem(grid.name, grid.passable, starts, goals)
    plan = solve(p, SolveParams(iterations=200))
    assert check_plan(p, plan) == []
    assert plan.cost == solve_arcflow(mapf_problem("g", grid.passable, starts, goals, 10)).cost


def test_static_distances_are_those_of_breadth_first_search():
    """On random grids, and None is more than T."""
    rng = np.random.default_rng(2)
    for _ in range(15):
        free = rng.random((6, 7)) < 0.65
        cells = np.argwhere(free)[:, ::-1]
        pick = rng.permutation(len(cells))
        starts, goals = cells[pick[:4]], cells[pick[4:8]]
        p = mapf_problem("g", free, starts, goals)
        search = Search(ExpandedGraph.of(p))
        for i in range(4):
            steps = breadth_first(free, tuple(starts[i].tolist()), tuple(goals[i].tolist()))
            assert search.can_arrive(i) == (steps is not None)
            if steps is not None:
                assert search.least_cost(i) == steps


@BENCHMARK
@pytest.mark.parametrize("name", ["empty-16-16", "random-32-32-20", "room-32-32-4"])
def test_static_distances_on_benchmark_maps(name):
    """Agents move along four directions: never shorter than the scenario's diagonal optimum."""
    free, starts, goals = benchmark(name, 60)
    p = mapf_problem(name, free, starts, goals)
    search = Search(ExpandedGraph.of(p))
    rows = read_scenario(SHARED / f"{name}-random-1.scen").rows
    for i in range(60):
        steps = breadth_first(free, rows[i].start, rows[i].goal)
        assert search.least_cost(i) == steps
        assert steps >= rows[i].optimal_length - 1e-6


@BENCHMARK
def test_benchmark_scenario_is_planned():
    """Twenty agents of the random map: a plan that the checker accepts, above the static bound."""
    free, starts, goals = benchmark("random-32-32-20", 20)
    p = mapf_problem("random", free, starts, goals)
    plan = solve(p, SolveParams(iterations=300))
    assert check_plan(p, plan) == []
    assert plan.status in {"optimal", "feasible"}
    assert plan.lower_bound >= 405  # the sum of the 20 shortest paths
    assert plan.cost <= 1.05 * plan.lower_bound


def test_scenario_of_a_parsed_map_keeps_its_rows():
    """Upper left is (0, 0): the agent's vertex is the cell of its row and column."""
    grid = parse_map("type octile\nheight 2\nwidth 2\nmap\n..\n@.\n", "m.map")
    scenario = parse_scenario("version 1\n0\tm.map\t2\t2\t1\t1\t0\t0\t2\n", "m.scen")
    starts, goals = errands(grid, scenario, 1)
    p = mapf_problem("m", grid.passable, starts, goals)
    assert p.xy_m[p.start[0]].tolist() == [1, 0]
    assert p.xy_m[p.goal[0]].tolist() == [0, 1]
