"""The compiled searches find what dynamic programming on the explicit graph finds."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from planner.check import check_plan
from planner.expanded_graph import ExpandedGraph
from planner.plan import Path, Plan
from planner.problem import Problem
from planner.resources import BLOCKED, SCALE, Resources
from planner.search import INFINITE, NOTHING_FORBIDDEN, Penalties, Search
from planner.validation import MAX_PATH_COST
from tests.oracles import expanded as explicit
from tests.oracles.tiny_problems import random_hall, tiny_problem, tiny_problems
from tests.planner.examples import grid

FEW = settings(derandomize=True, deadline=None, max_examples=80)
SEEDS = st.integers(0, 2**32 - 1)


def search_of(problem: Problem) -> Search:
    """A search of its own."""
    return Search(ExpandedGraph.of(problem))


def penalties_of(problem: Problem, table: explicit.Penalties) -> Penalties:
    """The oracle's penalty tables as the kernel wants them; infinite ones block."""
    penalties = Penalties(Resources.of(problem))
    flat = np.concatenate([table.vertex.ravel(), table.edge.ravel(), table.ap.ravel()])
    value = np.where(np.isinf(flat), float(BLOCKED), flat).astype(np.int64)
    penalties.set(np.arange(len(flat)), value)
    return penalties


def random_penalties(problem: Problem, rng: np.random.Generator) -> explicit.Penalties:
    """Whole numbers of 1/SCALE up to a few cost units, many of them 0, some infinite."""

    def draw(shape: tuple[int, ...]) -> NDArray[np.float64]:
        size = np.floor(rng.uniform(0, 4 * SCALE, shape)) * (rng.random(shape) < share)
        return np.where(rng.random(shape) < blocked, np.inf, size)

    share, blocked = rng.choice([0.1, 0.5, 1.0]), rng.choice([0.0, 0.03, 0.15])
    none = explicit.Penalties.none(problem)
    return explicit.Penalties(*(draw(a.shape) for a in (none.vertex, none.edge, none.ap)))


def least_cost(
    problem: Problem,
    robot: int,
    table: explicit.Penalties,
    *,
    scale: int = SCALE,
    earliest: int = 0,
    latest: int | None = None,
    forbidden: NDArray[np.bool_] = NOTHING_FORBIDDEN,
) -> float:
    """Bellman's recursion over the arcs of the explicit G', one by one [1/SCALE]; inf if none."""
    graph = explicit.ExplicitGraph(problem)
    start, goal = int(problem.start[robot]), int(problem.goal[robot])
    weights = graph.weigh(table)
    penalty = weights.arc - graph.cost
    barred = forbidden.ravel() if forbidden.size else np.zeros(graph.n_nodes, bool)
    dist = np.full(graph.n_nodes, np.inf)
    for node in graph.nodes_of(start, 0):
        dist[node] = np.inf if barred[node] else weights.node[node]
    if start != goal:  # otherwise it is there already (§1.5)
        for arc in range(graph.n_arcs):  # sorted by head, so tails are final
            head = graph.head[arc]
            reach = dist[graph.tail[arc]] + graph.cost[arc] * scale + penalty[arc]
            if reach < dist[head] and not barred[head]:
                dist[head] = reach
    best = np.inf
    n_pairs = len(graph.pairs)
    for node in graph.nodes_of(goal):
        t, a = int(graph.node_slot[node]), int(graph.node_ap[node])
        if not earliest <= t <= (problem.horizon if latest is None else latest):
            continue
        rest = 0.0
        if problem.at_goal == "park":
            for later in range(t + 1, problem.horizon + 1):
                shut = barred[node + (later - t) * n_pairs]
                rest += np.inf if shut else table.vertex[later, goal] + table.ap[later, a]
        best = min(best, dist[node] + rest)
    return best


def alone(problem: Problem, robot: int) -> Problem:
    """The problem of one of its robots, with room for it at every AP."""
    return dataclasses.replace(
        problem,
        robot_ids=(problem.robot_ids[robot],),
        start=problem.start[[robot]],
        goal=problem.goal[[robot]],
        ap_capacity=np.ones(problem.n_aps, np.int32),
    )


def assert_path_costs(
    problem: Problem, robot: int, path: Path, cost: int, penalties: Penalties, scale: int = SCALE
) -> None:
    """The path is legal for the robot alone, and its cost with penalties is what was said."""
    own = problem.c_t * path.arrival + problem.c_h * path.handovers
    plan = Plan("feasible", (path.robot,), (path,), own, 0.0)
    assert check_plan(alone(problem, robot), plan) == []
    used = explicit.usage(problem, path)
    used.vertex[0] = 0  # slot 0 holds by input (§1.2)
    flat = np.concatenate([used.vertex.ravel(), used.edge.ravel(), used.ap.ravel()]) > 0
    assert own * scale + int(penalties.resource[flat].sum()) == cost


@FEW
@given(tiny_problems())
def test_static_distances_are_exact(problem: Problem) -> None:
    """To every goal: least cost and least slots from each (vertex, AP), by Bellman and Ford."""
    search = search_of(problem)
    pairs = [(v, a) for v in range(problem.n_vertices) for a in explicit.aps_at(problem, v)]
    arcs = [(v, a, v, b, 1) for v, a in pairs for w, b in pairs if v == w]
    for e, (u, v) in enumerate(problem.edge_uv.tolist()):
        k = int(problem.edge_slots[e])
        for a in explicit.aps_at(problem, u):
            for b in explicit.aps_at(problem, v):
                if problem.edge_cover[e, a] if a == b else problem.edge_handover[e, a, b]:
                    arcs.append((u, a, v, b, k))
                    if not problem.edge_oneway[e]:
                        arcs.append((v, b, u, a, k))
    for i, goal in enumerate(problem.goal.tolist()):
        cost = {(v, a): 0.0 if v == goal else np.inf for v, a in pairs}
        slots = dict(cost)
        for _ in pairs:
            for v, a, w, b, k in arcs:
                step = problem.c_t * k + problem.c_h * (a != b)
                cost[v, a] = min(cost[v, a], step + cost[w, b])
                slots[v, a] = min(slots[v, a], k + slots[w, b])
        found = search.distances[i]
        T = problem.horizon
        assert [float(c) if c < INFINITE else np.inf for c in found.cost] == list(cost.values())
        assert found.slots.tolist() == [min(s, T + 1) for s in slots.values()]
        start = [pair for pair in pairs if pair[0] == problem.start[i]]
        assert search.can_arrive(i) == (min(slots[pair] for pair in start) <= T)
        assert search.least_cost(i) == min(*(cost[pair] for pair in start), INFINITE)


@FEW
@given(tiny_problems(), SEEDS)
def test_cost_equals_dynamic_programming(problem: Problem, seed: int) -> None:
    """§1.4 to §1.9: least cost with random penalties, both ways of ending, to the last unit."""
    rng = np.random.default_rng(seed)
    search = search_of(problem)
    for robot in range(problem.n_robots):
        table = random_penalties(problem, rng)
        penalties = penalties_of(problem, table)
        cost, path = search.shortest(robot, penalties)
        expected = least_cost(problem, robot, table)
        assert (cost if path is not None else np.inf) == expected
        if path is not None:
            assert_path_costs(problem, robot, path, cost, penalties)


@FEW
@given(tiny_problems(), SEEDS)
def test_windows_and_forbidden_states(problem: Problem, seed: int) -> None:
    """With arrival windows and states shut (parking included, §1.4) the least cost is exact."""
    rng = np.random.default_rng(seed)
    search = search_of(problem)
    T, n = problem.horizon, search.graph.n_nodes
    for robot in range(problem.n_robots):
        table = random_penalties(problem, rng)
        penalties = penalties_of(problem, table)
        earliest, latest = (int(x) for x in rng.integers(0, T + 2, 2))
        forbidden = rng.random((T + 1, n)) < rng.choice([0.02, 0.1, 0.3])
        for limits in (
            {"earliest": earliest},
            {"latest": latest},
            {"earliest": earliest, "latest": latest},
            {"forbidden": forbidden},
            {"earliest": earliest, "forbidden": forbidden},
        ):
            cost, path = search.shortest(robot, penalties, **limits)
            expected = least_cost(problem, robot, table, **limits)
            assert (cost if path is not None else np.inf) == expected, limits
            if path is not None:
                assert_path_costs(problem, robot, path, cost, penalties)
                assert limits.get("earliest", 0) <= path.arrival <= limits.get("latest", T)


@FEW
@given(tiny_problems(), SEEDS)
def test_scale_zero_prices_penalties_alone(problem: Problem, seed: int) -> None:
    """Phase 1 (§1.12): real paths cost 0, so the answer is the least sum of penalties."""
    rng = np.random.default_rng(seed)
    search = search_of(problem)
    table = random_penalties(problem, rng)
    penalties = penalties_of(problem, table)
    for robot in range(problem.n_robots):
        cost, path = search.shortest(robot, penalties, scale=0)
        assert (cost if path is not None else np.inf) == least_cost(problem, robot, table, scale=0)
        if path is not None:
            assert_path_costs(problem, robot, path, cost, penalties, scale=0)


@FEW
@given(tiny_problems(), SEEDS)
def test_value_is_a_lower_bound_under_any_limit(problem: Problem, seed: int) -> None:
    """§1.13: only a cheaper path than the limit is found, and the first value bounds every path."""
    rng = np.random.default_rng(seed)
    search = search_of(problem)
    for robot in range(problem.n_robots):
        table = random_penalties(problem, rng)
        penalties = penalties_of(problem, table)
        least = least_cost(problem, robot, table)
        around = int(least) if np.isfinite(least) else 5 * SCALE
        for limit in (-7, 0, 1, around - 1, around, around + 1, around + SCALE, INFINITE):
            cost, path = search.shortest(robot, penalties, limit=limit)
            assert cost <= least or cost == INFINITE
            assert (path is not None) == (least < limit)
            assert cost == (least if path is not None else min(limit, INFINITE))


@FEW
@given(tiny_problems(), SEEDS)
def test_use_decides_between_equals_only(problem: Problem, seed: int) -> None:
    """Counting others' use of places never changes the cost, and nothing is left in the memory."""
    rng = np.random.default_rng(seed)
    search, fresh = search_of(problem), search_of(problem)
    penalties = penalties_of(problem, random_penalties(problem, rng))
    use = rng.integers(0, 4, (problem.horizon + 1, problem.n_vertices)).astype(np.int32)
    for robot in range(problem.n_robots):
        plain = search.shortest(robot, penalties)
        cost, path = search.shortest(robot, penalties, use=use)
        assert cost == plain[0]
        if path is not None:
            assert_path_costs(problem, robot, path, cost, penalties)
        # Searches before this one leave no trace (§1.15).
        assert search.shortest(robot, penalties) == plain
        assert fresh.shortest(robot, penalties) == plain


def test_use_leads_around_what_others_use() -> None:
    """Of two ways of equal cost the one less used is taken."""
    problem = grid(2, 2, [(0, 3)], n_aps=1)
    search, penalties = search_of(problem), Penalties(Resources.of(problem))
    for crowded, quiet in ((1, 2), (2, 1)):
        use = np.zeros((problem.horizon + 1, 4), np.int32)
        use[1, crowded] = 1
        _, path = search.shortest(0, penalties, use=use)
        assert path is not None
        assert path.vertices.tolist() == [0, quiet, 3]


@pytest.mark.parametrize("at_goal", ["leave", "park"])
def test_robot_at_its_goal_never_strolls(at_goal: str) -> None:
    """§1.5: with o_i = d_i there is the one-state path or none, whatever staying costs."""
    problem = grid(3, 1, [(1, 1)], at_goal=at_goal)
    search, penalties = search_of(problem), Penalties(Resources.of(problem))
    V, A = problem.n_vertices, problem.n_aps
    first_ap = search.problem.n_vertices * (problem.horizon + 1)
    first_ap += problem.horizon * problem.n_edges
    penalties.set(np.array([3 * V + 1, first_ap]), np.array([SCALE, 2 * SCALE]))
    cost, path = search.shortest(0, penalties)
    assert path is not None
    assert path.arrival == 0
    assert path.aps.tolist() == [1]  # AP 0 costs more in slot 0
    assert cost == (SCALE if at_goal == "park" else 0)
    assert search.shortest(0, penalties, earliest=1) == (INFINITE, None)
    # Someone needs its place in slot 3: only one who has left does not mind.
    penalties.set(np.array([3 * V + 1]), BLOCKED)
    assert (search.shortest(0, penalties)[1] is None) == (at_goal == "park")
    # No AP has a place in slot 0.
    penalties.clear()
    penalties.set(first_ap + np.arange(A), BLOCKED)
    assert search.shortest(0, penalties) == (INFINITE, None)


def test_parking_is_paid_until_the_horizon() -> None:
    """§1.4: under `park` an early arrival pays goal and AP up to T, so a late one can be best."""
    problem = grid(2, 1, [(0, 1)], n_aps=1, horizon=6, at_goal="park")
    search, penalties = search_of(problem), Penalties(Resources.of(problem))
    penalties.set(np.array([4 * 2 + 1]), np.int64(10 * SCALE))  # vertex 1 in slot 4
    cost, path = search.shortest(0, penalties)
    assert path is not None
    assert (path.arrival, cost) == (5, 5 * SCALE)
    left = search_of(dataclasses.replace(problem, at_goal="leave"))
    assert left.shortest(0, penalties)[0] == SCALE


def test_passing_through_the_goal() -> None:
    """§1.4: a path may pass its own goal and come back when it must arrive later."""
    problem = grid(3, 1, [(0, 1)], n_aps=1, horizon=4)
    search, penalties = search_of(problem), Penalties(Resources.of(problem))
    # In slots 1 and 2 the origin is taken: the robot must move on through its goal.
    penalties.set(np.array([1 * 3 + 0, 2 * 3 + 0, 2 * 3 + 1]), BLOCKED)
    cost, path = search.shortest(0, penalties, earliest=2)
    assert path is not None
    assert path.vertices.tolist() == [0, 1, 2, 1]
    assert cost == 3 * SCALE


def test_forbidden_parking() -> None:
    """§1.4: a state shut after arrival is no place to park at, but one to leave from."""
    problem = grid(2, 1, [(0, 1)], n_aps=1, horizon=4, at_goal="park")
    search, penalties = search_of(problem), Penalties(Resources.of(problem))
    forbidden = np.zeros((5, 2), bool)
    forbidden[2, 1] = True
    _, path = search.shortest(0, penalties, forbidden=forbidden)
    assert path is not None
    assert path.arrival == 3


def test_largest_costs_stay_exact() -> None:
    """At the largest costs a problem may have, nothing overflows and the answer is exact."""
    T = 8
    c_h = MAX_PATH_COST // T - 3
    problem = grid(
        4,
        2,
        [(0, 3)],
        cover=[[0], [1], [0], [1], *[[0, 1]] * 4],
        horizon=T,
        c_t=3,
        c_h=c_h,
        objective="costs",
    )
    search, penalties = search_of(problem), Penalties(Resources.of(problem))
    cost, path = search.shortest(0, penalties)
    assert path is not None
    assert path.handovers == 1
    assert cost == (3 * 5 + c_h) * SCALE
    penalties.set(np.arange(len(penalties.resource)), np.int64(MAX_PATH_COST) * SCALE // 4)
    cost, path = search.shortest(0, penalties)
    assert path is not None
    # Now time is dearer: three vertices, three edges, an AP in four slots. A step's penalties are
    # less than `BLOCKED`, so it is allowed.
    assert path.arrival == 3
    assert cost == (3 * 3 + 3 * c_h) * SCALE + 10 * MAX_PATH_COST * SCALE // 4


def test_setting_and_clearing_penalties() -> None:
    """An edge's penalty stands at both its directions; setting 0 or clearing takes all back."""
    problem = tiny_problem(3)
    resources = Resources.of(problem)
    penalties = Penalties(resources)
    index = np.arange(resources.n)
    penalties.set(index, index + 1)
    E = problem.n_edges
    assert (penalties.move[:, 0 : 2 * E : 2] == penalties.edge).all()
    assert (penalties.move[:, 1 : 2 * E : 2] == penalties.edge).all()
    assert (penalties.move[:, 2 * E :] == 0).all()
    assert penalties.vertex[0, 0] == 1
    assert penalties.ap[-1, -1] == resources.n
    penalties.set(index, np.int64(0))
    assert not penalties.resource.any()
    assert not penalties.move.any()
    penalties.set(index, np.int64(5))
    penalties.clear()
    assert not penalties.resource.any()
    assert not penalties.move.any()


def test_hall_agrees_with_the_explicit_graph() -> None:
    """On a hall of some thousand states: penalties like duals, every robot, exact."""
    rng = np.random.default_rng(5)
    problem = random_hall(2, size=9, n=10, T=30, objective="hp", at_goal="park")
    search = search_of(problem)
    graph = explicit.ExplicitGraph(problem)
    none = explicit.Penalties.none(problem)
    table = explicit.Penalties(
        *(
            np.floor(rng.uniform(0, 9 * SCALE, a.shape)) * (rng.random(a.shape) < 0.2)
            for a in (none.vertex, none.edge, none.ap)
        )
    )
    units = explicit.Penalties(table.vertex / SCALE, table.edge / SCALE, table.ap / SCALE)
    weights = graph.weigh(units)  # exact: SCALE is a power of two
    penalties = penalties_of(problem, table)
    for robot in range(problem.n_robots):
        expected, _ = graph.shortest_path(robot, weights)
        cost, path = search.shortest(robot, penalties)
        assert path is not None
        assert cost == expected * SCALE
        assert_path_costs(problem, robot, path, cost, penalties)
