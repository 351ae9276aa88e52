"""Prices: they prove their bound, and say what more room could save (Lagrange, §1.13)."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from planner.cooperative import cooperative_astar
from planner.errors import PlannerError
from planner.expanded_graph import ExpandedGraph
from planner.grid_lines import grid_lines
from planner.json_files import dump_plan, parse_plan
from planner.least_prices import LOSS, least_penalties
from planner.master import Master
from planner.pgcp import PgcpState, artificial_cost, generate_paths
from planner.prices import Prices, advice_of, prices_of, shortages
from planner.problem import Problem
from planner.resources import SCALE, Resources
from planner.search import Search
from planner.solve import SolveParams, solve
from tests.oracles.arcflow import arcflow_bound
from tests.oracles.expanded import ExplicitGraph, Penalties
from tests.oracles.tiny_problems import random_hall, tiny_problem
from tests.planner.examples import grid


def tight(seed: int) -> Problem:
    """A tiny problem whose APs serve one robot or two."""
    problem = tiny_problem(seed, max_slots=6)
    capacity = 1 + (np.arange(problem.n_aps) + seed) % 2
    return dataclasses.replace(problem, ap_capacity=capacity.astype(np.int32))


TINY = [
    problem
    for seed in range(160)
    for problem in [tight(seed)]
    if problem.n_robots > 2 and arcflow_bound(problem) is not None
][:15]
HALL = random_hall(3, size=9, n=16, m=5, T=30)
"""Small, but with robots in each other's way and short of AP places."""
NOTHING = np.empty(0, np.int64)


def generated(problem: Problem) -> PgcpState:
    """The state at the end of path generation."""
    graph, resources = ExpandedGraph.of(problem), Resources.of(problem)
    search = Search(graph)
    state = PgcpState(graph, resources, search, Master(resources, artificial_cost(problem)))
    paths = cooperative_astar(search, resources, range(problem.n_robots))
    state.master.add([state.master.column(i, p) for i, p in enumerate(paths) if p is not None])
    generate_paths(state, range(problem.n_robots))
    return state


def lagrange(problem: Problem, rows: np.ndarray, penalty: np.ndarray) -> float:
    """The bound that penalties prove, by the oracle's own graph and search [cost units]."""
    resources = Resources.of(problem)
    dense = np.zeros(resources.n)
    dense[rows] = penalty / SCALE
    graph = ExplicitGraph(problem)
    weights = graph.weigh(Penalties(*(table.copy() for table in resources.shaped(dense))))
    least = sum(graph.shortest_path(i, weights)[0] for i in range(problem.n_robots))
    return least - float(dense @ resources.capacity)


def more_room(problem: Problem, ap: int) -> Problem:
    """One more place on an AP."""
    capacity = problem.ap_capacity + (np.arange(problem.n_aps) == ap)
    return dataclasses.replace(problem, ap_capacity=capacity)


@pytest.mark.parametrize("problem", TINY, ids=range(len(TINY)))
def test_penalties_kept_prove_the_bound(problem):
    """The resources and penalties in the state prove `bound`: recomputed on an explicit G'."""
    state = generated(problem)
    assert (state.bound_penalty > 0).all()
    proven = lagrange(problem, state.bound_rows, state.bound_penalty)
    assert proven >= state.bound / SCALE - 1e-9
    assert state.bound / SCALE == pytest.approx(arcflow_bound(problem), abs=1e-4)


@pytest.mark.parametrize("problem", TINY, ids=range(len(TINY)))
def test_price_of_an_ap_is_the_most_that_one_more_place_saves(problem):
    """LP(m + 1) ≥ LP(m) − price; with price 0 nothing changes (LP duality)."""
    state = generated(problem)
    prices = prices_of(state.resources, *least_penalties(state))
    lp = arcflow_bound(problem)
    for a, price in enumerate(prices.ap):
        with_more = arcflow_bound(more_room(problem, a))
        assert lp + 1e-6 >= with_more >= prices.bound - price - 1e-6
        assert with_more >= lp - price - 2 * LOSS
        if price == 0:
            assert with_more == pytest.approx(lp, abs=2 * LOSS)


def test_some_prices_of_the_examples_are_positive():
    """The test above says something: there are APs that cost, and room on them that saves."""
    saved, priced = 0, 0
    for problem in TINY:
        state = generated(problem)
        prices = prices_of(state.resources, state.bound_rows, state.bound_penalty, state.bound)
        for a in np.flatnonzero(prices.ap > 0.01):
            priced += 1
            saved += arcflow_bound(more_room(problem, int(a))) < arcflow_bound(problem) - 0.01
    assert saved >= 3
    assert priced >= saved


def test_least_penalties_prove_the_same_bound_with_a_lesser_sum():
    """Of the penalties that prove a bound those of the least sum are kept."""
    state = generated(HALL)
    rows, penalty, bound = least_penalties(state)
    assert penalty.sum() <= state.bound_penalty.sum()
    assert bound >= state.bound - LOSS * SCALE
    assert -(-bound // SCALE) == -(-state.bound // SCALE)
    assert lagrange(HALL, rows, penalty) >= bound / SCALE - 1e-6


def test_full_house_has_no_price():
    """As many robots as AP places: every place is taken, but one more would save nothing."""
    problem = grid(6, 2, [(0, 1), (2, 3), (6, 7), (8, 9)], n_aps=2, horizon=4)
    problem = dataclasses.replace(problem, ap_capacity=np.array([2, 2]))
    resources = Resources.of(problem)
    # Valid penalties that prove nothing: all APs in slot 0, whose places all are taken anyway.
    dear = resources.first_ap + np.arange(2)
    state = generated(problem)
    assert lagrange(problem, dear, np.full(2, 5 * SCALE)) == pytest.approx(state.bound / SCALE)
    state.bound_rows, state.bound_penalty = dear, np.full(2, 5 * SCALE)
    _, penalty, bound = least_penalties(state)
    assert penalty.sum() <= 1
    assert bound >= state.bound - LOSS * SCALE


@pytest.mark.parametrize("method", ["auto", "pgcp"])
def test_plan_has_the_prices_that_prove_its_bound(method):
    """§1.13: a plan's prices prove the bound of path generation, and no more than is told."""
    plan = solve(HALL, SolveParams(method=method, iterations=100))
    assert plan.prices is not None
    assert np.ceil(plan.prices.bound) <= plan.lower_bound
    assert plan.prices.bound == pytest.approx(plan.lp_value, abs=2 * LOSS)
    assert plan.prices.total > 0
    for a, price in enumerate(plan.prices.ap):
        with_more = generated(more_room(HALL, a)).bound / SCALE
        assert with_more >= plan.prices.bound - price - 1e-4


def test_plan_without_a_bound_from_prices_has_none():
    """Cooperative A* proves only what each robot needs alone; zeros would say too much."""
    assert solve(HALL, SolveParams(method="cooperative")).prices is None
    crowd = dataclasses.replace(HALL, ap_capacity=np.full(HALL.n_aps, 1))
    answer = solve(crowd, SolveParams(iterations=10))
    assert answer.status == "infeasible"
    assert answer.prices is None


def test_free_floor_has_no_shortage():
    """Robots that do not meet: all prices are 0, and the advice says that nothing is short."""
    problem = grid(4, 2, [(0, 3), (4, 7)], n_aps=1)
    plan = solve(problem)
    assert plan.prices.total == 0
    assert plan.prices.bound == plan.cost == 6
    assert plan.prices.advice.startswith("no shortage")


def test_prices_survive_plan_json():
    """1-semantics, plan.json: "prices" round-trips, sums and slots alike."""
    plan = solve(HALL, SolveParams(iterations=50))
    values = json.loads(dump_plan(plan, HALL))["prices"]
    assert len(values["vertices"]) == HALL.n_vertices
    assert len(values["edges"]) == HALL.n_edges
    assert values["aps"] == plan.prices.ap.tolist()
    again = parse_plan(dump_plan(plan, HALL), HALL)
    assert again == plan
    assert again.prices == plan.prices
    assert dataclasses.replace(plan, prices=None) != plan


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"vertices": [0, 1]}, r"\$\.prices\.vertices: 2: must have 4 entries"),
        ({"edges": [0, "x", 0]}, r'\$\.prices\.edges\[1\]: "x": must be a finite number'),
        ({"aps": [-1, 0]}, r"\$\.prices\.aps\[0\]: -1: a price is never negative"),
        ({"aps": [9, 0]}, r"\$\.prices\.aps\[0\]: 9\.0: aps_by_slot sums up to 1; correct one"),
        ({"aps_by_slot": [[0, 0]]}, r"\$\.prices\.aps_by_slot: 1: must have 9 rows"),
        ({"price": 1}, r"\$\.prices\.price: 1: unknown key"),
        ({"bound": None}, r"\$\.prices\.bound: null: must be a finite number"),
        ({"advice": 3}, r"\$\.prices\.advice: 3: must be text"),
    ],
)
def test_fault_of_prices_is_told_with_its_place(changes, message):
    """A price that is none is named with its key in the file."""
    problem = grid(4, 1, [(0, 3), (1, 2)])
    by_slot = np.zeros((9, 2))
    by_slot[1, 0] = 1.0
    prices = Prices(np.zeros(4), np.zeros(3), by_slot, 4.0, 1, "advice")
    plan = dataclasses.replace(solve(problem), prices=prices)
    values = json.loads(dump_plan(plan, problem))
    assert parse_plan(json.dumps(values), problem) == plan
    values["prices"].update(changes)
    with pytest.raises(PlannerError, match=message):
        parse_plan(json.dumps(values), problem)


def test_prices_of_another_writer_may_be_sums_only():
    """The keys the semantics name are enough."""
    problem = grid(4, 1, [(0, 3), (1, 2)])
    values = json.loads(dump_plan(solve(problem), problem))
    values["prices"] = {"vertices": [0, 1, 2, 0], "edges": [0, 0, 3], "aps": [7, 0]}
    prices = parse_plan(json.dumps(values), problem).prices
    assert prices.ap.tolist() == [7, 0]
    assert prices.in_units(prices.vertex).tolist() == [0, 1, 2, 0]


def test_aisles_are_gapless_stretches_of_grid_lines():
    """A missing edge cuts a line; each edge is in one aisle."""
    problem = grid(4, 2, [(0, 1)])
    keep = [e for e, uv in enumerate(problem.edge_uv.tolist()) if uv != [1, 2]]
    lines = grid_lines(problem.xy_m, problem.edge_uv[keep])
    rows = [vertices for axis, vertices, _ in lines if axis == 1]
    assert rows == [(0, 1), (2, 3), (4, 5, 6, 7)]
    assert sorted(e for _, _, edges in lines for e in edges) == list(range(len(keep)))
    slanted = problem.xy_m @ np.array([[1.0, 0.3], [-0.3, 1.0]])
    assert grid_lines(slanted, problem.edge_uv) == []


def priced(problem: Problem, **by_index: dict[int, float]) -> Prices:
    """Prices that are 0 but for some."""
    tables = {
        "vertex": np.zeros(problem.n_vertices),
        "edge": np.zeros(problem.n_edges),
        "ap_by_slot": np.zeros((problem.horizon + 1, problem.n_aps)),
    }
    for name, values in by_index.items():
        for k, value in values.items():
            tables[name][k] = value
    return Prices(**tables, bound=10.0, c_t=problem.c_t)


def test_shortages_add_up_to_all_prices():
    """No price is counted twice, none is left out, the dearest comes first."""
    prices = solve(HALL, SolveParams(iterations=0)).prices
    found = shortages(HALL, prices)
    assert sum(s.price for s in found) == pytest.approx(prices.total)
    assert [s.price for s in found] == sorted((s.price for s in found), reverse=True)
    around = prices.around(HALL.edge_uv)
    assert around.sum() == pytest.approx(prices.vertex.sum() + prices.edge.sum())


def test_advice_names_ap_and_aisle_with_their_price_in_slots():
    """The sentence of the issue: which AP, which aisle, how many slots."""
    problem = grid(4, 4, [(0, 3), (4, 7)])
    cut = {(t, 1): 4.1 for t in range(10)}
    prices = priced(
        dataclasses.replace(problem, horizon=10, c_h=10),
        vertex={6: 15.0, 10: 5.0},
        edge={problem.edge_uv.tolist().index([6, 10]): 2.0},
        ap_by_slot=cut,
    )
    advice = advice_of(problem, prices)
    assert "AP ap1's capacity costs 41 slots" in advice
    assert "aisle x = 2 m, y 1 to 2 m costs 22 slots" in advice
    assert "ap0" not in advice
    assert "a handover counts as 8 slots" in advice


def test_advice_without_aisles_names_places():
    """Vertices that are no grid: single positions and ways are named by their metres."""
    problem = grid(4, 4, [(0, 3), (4, 7)], c_t=2, c_h=0, objective="costs")
    turned = problem.xy_m @ np.array([[0.8, 0.6], [-0.6, 0.8]])
    problem = dataclasses.replace(problem, xy_m=turned)
    advice = advice_of(problem, priced(problem, vertex={5: 3.0}, edge={0: 1.0}))
    assert "position (0.2, 1.4) m costs 1.5 slots" in advice
    assert "way (0, 0) m–(0.8, 0.6) m costs 0.5 slots" in advice
    single = advice_of(problem, priced(problem, vertex={5: 2.0}))
    assert "costs 1 slot (" in single
    free = dataclasses.replace(problem, c_t=0)
    assert "costs 3 cost units" in advice_of(free, priced(free, vertex={5: 3.0}))


def test_prices_are_read_only():
    """Results are frozen."""
    prices = solve(HALL, SolveParams(iterations=0)).prices
    for array in (prices.vertex, prices.edge, prices.ap_by_slot):
        assert not array.flags.writeable
