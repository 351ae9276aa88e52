"""What must hold for any problem: names do not matter, more room never costs more, and the like."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from planner.check import check_plan
from planner.expanded_graph import ExpandedGraph
from planner.pgcp import pgcp
from planner.plan import Plan
from planner.problem import Problem, edge_cover_of_ends
from planner.search import Search
from planner.solve import Method, SolveParams, solve
from tests.oracles import expanded as explicit
from tests.oracles.arcflow import solve_arcflow
from tests.oracles.tiny_problems import tiny_problems
from tests.planner.examples import grid

FEW = settings(derandomize=True, deadline=None, max_examples=35)
SEEDS = st.integers(0, 2**32 - 1)


def answer(problem: Problem, method: Method = "auto") -> Plan:
    """The planner's answer, which breaks no rule (§1.12)."""
    plan = solve(problem, SolveParams(method=method, iterations=100, restarts=5))
    assert check_plan(problem, plan) == []
    return plan


def lp_value(problem: Problem) -> float | None:
    """Value of the master LP at the end of path generation; None if a robot is cut off."""
    search = Search(ExpandedGraph.of(problem))
    if not all(search.can_arrive(i) for i in range(problem.n_robots)):
        return None
    return pgcp(problem)[1].lp_value


def assert_same_optimum(one: Plan, two: Plan) -> None:
    """Nothing proven in one answer contradicts the other; proven optima are equal."""
    assert_no_dearer(one, two)
    assert_no_dearer(two, one)


def assert_no_dearer(more: Plan, less: Plan) -> None:
    """Whatever serves the fleet with less room serves it with more, and for no more."""
    if less.unserved:
        return
    assert more.status != "infeasible"
    assert more.lower_bound is not None
    assert more.lower_bound <= less.cost
    if more.status == "optimal":
        assert more.cost <= less.cost


def relabelled(problem: Problem, rng: np.random.Generator) -> Problem:
    """The same problem with vertices, edges, APs and robots in another order."""
    v, e, a, i = (
        rng.permutation(n)
        for n in (problem.n_vertices, problem.n_edges, problem.n_aps, problem.n_robots)
    )
    new_index = np.argsort(v).astype(np.int32)
    return dataclasses.replace(
        problem,
        objective="costs",
        ap_ids=tuple(problem.ap_ids[k] for k in a),
        ap_capacity=problem.ap_capacity[a],
        xy_m=problem.xy_m[v],
        cover=problem.cover[v][:, a],
        snr_db=problem.snr_db[v][:, a],
        edge_uv=new_index[problem.edge_uv[e]].reshape(-1, 2),
        edge_slots=problem.edge_slots[e],
        edge_oneway=problem.edge_oneway[e],
        edge_cover=problem.edge_cover[e][:, a],
        edge_handover=problem.edge_handover[e][:, a][:, :, a],
        robot_ids=tuple(problem.robot_ids[k] for k in i),
        start=new_index[problem.start[i]],
        goal=new_index[problem.goal[i]],
    )


def turned(problem: Problem) -> Problem:
    """The same problem with every two-way edge written the other way."""
    back = ~problem.edge_oneway
    handover = problem.edge_handover
    return dataclasses.replace(
        problem,
        edge_uv=np.where(back[:, None], problem.edge_uv[:, ::-1], problem.edge_uv),
        edge_handover=np.where(back[:, None, None], handover.transpose(0, 2, 1), handover),
    )


@FEW
@given(tiny_problems(), SEEDS)
def test_labels_do_not_matter(problem: Problem, seed: int) -> None:
    """Relabelling vertices, edges, APs and robots changes neither LP value nor optimum."""
    other = relabelled(problem, np.random.default_rng(seed))
    assert_same_optimum(answer(problem), answer(other))
    one, two = lp_value(problem), lp_value(other)
    assert (one is None) == (two is None)
    if one is not None:
        assert one == pytest.approx(two, abs=1e-6)


@FEW
@given(tiny_problems())
def test_direction_an_edge_is_written_in_does_not_matter(problem: Problem) -> None:
    """§1.1: an edge that is not one-way may be written from either end."""
    other = turned(problem)
    assert_same_optimum(answer(problem), answer(other))
    one, two = lp_value(problem), lp_value(other)
    assert one == (None if two is None else pytest.approx(two, abs=1e-6))


@FEW
@given(tiny_problems(), st.integers(1, 3))
def test_more_time_never_costs_more(problem: Problem, slots: int) -> None:
    """A larger T never raises the optimum of fixed c_t and c_h (§1.10), nor makes it impossible."""
    problem = dataclasses.replace(problem, objective="costs")
    longer = dataclasses.replace(problem, horizon=problem.horizon + slots)
    assert_no_dearer(answer(longer), answer(problem))


@FEW
@given(tiny_problems(), SEEDS)
def test_larger_aps_never_cost_more(problem: Problem, seed: int) -> None:
    """A larger m never raises the optimum (§1.6)."""
    more = np.random.default_rng(seed).integers(0, 3, problem.n_aps)
    larger = dataclasses.replace(problem, ap_capacity=problem.ap_capacity + more)
    assert_no_dearer(answer(larger), answer(problem))


@FEW
@given(tiny_problems(), SEEDS)
def test_more_coverage_never_costs_more(problem: Problem, seed: int) -> None:
    """More coverage of vertices and edges, and more handovers allowed, never raise the optimum."""
    rng = np.random.default_rng(seed)
    problem = dataclasses.replace(problem, objective="costs")
    cover = problem.cover | (rng.random(problem.cover.shape) < 0.4)
    edge_cover, handover = edge_cover_of_ends(cover, problem.edge_uv)
    edge_cover &= problem.edge_cover | (rng.random(edge_cover.shape) < 0.5)
    handover &= problem.edge_handover | (rng.random(handover.shape) < 0.5)
    covered = dataclasses.replace(
        problem,
        cover=cover,
        edge_cover=edge_cover,
        edge_handover=handover,
        snr_db=np.full(cover.shape, 10.0),
    )
    assert_no_dearer(answer(covered), answer(problem))


@FEW
@given(tiny_problems(), SEEDS)
def test_fewer_robots_never_cost_more(problem: Problem, seed: int) -> None:
    """Without one of its robots the fleet costs no more, and stays possible."""
    assume(problem.n_robots > 1)
    keep = np.delete(
        np.arange(problem.n_robots), np.random.default_rng(seed).integers(problem.n_robots)
    )
    fewer = dataclasses.replace(
        problem,
        robot_ids=tuple(problem.robot_ids[k] for k in keep),
        start=problem.start[keep],
        goal=problem.goal[keep],
    )
    assert_no_dearer(answer(fewer), answer(problem))


@settings(FEW, max_examples=60)
@given(tiny_problems(max_slots=5), st.integers(0, 4), st.integers(1, 5))
def test_no_false_proof(problem: Problem, places: int, horizon: int) -> None:
    """§1.12: with few places and little time, "infeasible" is said only where there is no plan."""
    problem = dataclasses.replace(
        problem,
        objective="costs",
        horizon=horizon,
        ap_capacity=np.minimum(problem.ap_capacity, places),
    )
    plans = [answer(problem, method) for method in ("auto", "pgcp", "cooperative")]
    if all(plan.status == "unknown" for plan in plans):
        return
    truth = solve_arcflow(problem)
    for plan in plans:
        if plan.status == "infeasible":
            assert truth.status == "infeasible"
        elif plan.status != "unknown":
            assert truth.status == "optimal"
            assert plan.lower_bound is not None
            assert plan.lower_bound <= truth.cost <= plan.cost
            assert plan.status != "optimal" or plan.cost == truth.cost


@FEW
@given(st.data())
def test_swaps_in_corridors(data: st.DataObject) -> None:
    """§1.2, §1.3: robots that must pass each other in a one-lane corridor have no plan, ever.

    Under `leave` they go from end to end: elsewhere one could let the other arrive and vanish.
    """
    length = data.draw(st.integers(2, 7))
    inner = data.draw(st.integers(0, length - 2))
    outer = data.draw(st.integers(inner + 1, length - 1))
    T = data.draw(st.integers(1, 12))
    at_goal = data.draw(st.sampled_from(["leave", "park"]))
    if at_goal == "leave":
        inner, outer = 0, length - 1
    problem = grid(length, 1, [(inner, outer), (outer, inner)], horizon=T, at_goal=at_goal, n_aps=1)
    for method in ("auto", "pgcp", "cooperative"):
        plan = answer(problem, method)
        assert plan.unserved
        assert plan.status in {"infeasible", "unknown"}
        # With no slot to spare not even halves can pass.
        if method != "cooperative" and outer - inner >= T:
            assert plan.status == "infeasible"


def plain_mapf(problem: Problem) -> int | None:
    """Least sum of arrival slots of a MAPF problem, None if there is no plan.

    Slot by slot over the joint positions of all robots; knows nothing of APs and costs. A robot is
    at a vertex, `gone` after it left, or stands `parked` for good.
    """
    gone = -1
    N, T = problem.n_robots, problem.horizon
    goal = problem.goal.tolist()
    exits: dict[int, list[tuple[int, int]]] = {v: [(v, -1 - v)] for v in range(problem.n_vertices)}
    for e, (u, v) in enumerate(problem.edge_uv.tolist()):
        exits[u].append((v, e))
        if not problem.edge_oneway[e]:
            exits[v].append((u, e))
    park = problem.at_goal == "park"

    def endings(places: tuple[int, ...], done: tuple[bool, ...]) -> Iterator[tuple[bool, ...]]:
        """Who of those at their goals calls it a day."""
        choices = [
            (True,) if done[i] else (True, False) if places[i] == goal[i] else (False,)
            for i in range(N)
        ]
        return product(*choices)

    start = tuple(problem.start.tolist())
    first = tuple(start[i] == goal[i] for i in range(N))  # §1.5
    layer: dict[tuple[tuple[int, ...], tuple[bool, ...]], int] = {(start, first): 0}
    best: int | None = None
    for t in range(T + 1):
        for (_, done), cost in layer.items():
            if all(done) and (best is None or cost < best):
                best = cost
        if t == T:
            break
        following: dict[tuple[tuple[int, ...], tuple[bool, ...]], int] = {}
        for (places, done), cost in layer.items():
            options = [
                ([(places[i], gone)] if park else [(gone, gone)]) if done[i] else exits[places[i]]
                for i in range(N)
            ]
            for moves in product(*options):
                to = tuple(v for v, _ in moves)
                here = [v for v in to if v != gone]
                edges = [e for _, e in moves if e >= 0]
                if len(set(here)) < len(here) or len(set(edges)) < len(edges):
                    continue
                after = cost + N - sum(done)
                for ended in endings(to, done):
                    key = (to, ended)
                    if after < following.get(key, 1 << 30):
                        following[key] = after
        layer = following
    return best


def with_one_ap(problem: Problem, c_h: int) -> Problem:
    """The problem with one AP that covers all and serves all; edges take one slot."""
    cover = np.ones((problem.n_vertices, 1), np.bool_)
    edge_cover, handover = edge_cover_of_ends(cover, problem.edge_uv)
    return dataclasses.replace(
        problem,
        objective="costs",
        c_t=1,
        c_h=c_h,
        ap_ids=("ap0",),
        ap_capacity=np.array([problem.n_robots], np.int32),
        cover=cover,
        snr_db=np.full(cover.shape, 10.0),
        edge_slots=np.ones(problem.n_edges, np.int32),
        edge_cover=edge_cover,
        edge_handover=handover,
    )


@settings(FEW, max_examples=60)
@given(tiny_problems(max_robots=3, max_slots=5), st.integers(0, 9))
def test_one_ap_is_plain_mapf(problem: Problem, c_h: int) -> None:
    """One AP with m = N is plain MAPF: the optimum is that of a search over joint positions."""
    problem = with_one_ap(problem, c_h)
    optimum = plain_mapf(problem)
    for method in ("auto", "pgcp", "cooperative"):
        plan = answer(problem, method)
        if optimum is None:
            assert plan.status in {"infeasible", "unknown"}
            continue
        assert plan.status != "infeasible"
        assert plan.lower_bound is not None
        assert plan.lower_bound <= optimum
        if not plan.unserved:
            assert plan.cost >= optimum
            assert plan.handovers == 0
        if plan.status == "optimal":
            assert plan.cost == optimum


def test_plain_mapf_oracle_on_cases_one_can_see() -> None:
    """The oracle above: a pocket costs a detour, a corridor none at all, parking blocks."""
    pocket = grid(3, 2, [(0, 2), (2, 0)], edge_uv=[(0, 1), (1, 2), (1, 4)], n_aps=1)
    assert plain_mapf(pocket) == 7
    assert plain_mapf(grid(3, 1, [(0, 2), (2, 0)], n_aps=1)) is None
    assert plain_mapf(grid(3, 1, [(1, 1), (0, 2)], n_aps=1)) == 2
    assert plain_mapf(grid(3, 1, [(1, 1), (0, 2)], n_aps=1, at_goal="park")) is None
    assert plain_mapf(grid(2, 2, [(0, 1), (1, 3), (3, 2), (2, 0)], n_aps=1)) == 4


@FEW
@given(tiny_problems(max_robots=1))
def test_single_robot(problem: Problem) -> None:
    """One robot alone is always decided: its cost is its shortest path's on the explicit G'."""
    graph = explicit.ExplicitGraph(problem)
    full = explicit.Penalties.none(problem)
    full.ap[:] = np.where(problem.ap_capacity > 0, 0.0, np.inf)
    least, _ = graph.shortest_path(0, graph.weigh(full))
    for method in ("auto", "pgcp"):
        plan = answer(problem, method)
        assert plan.status == ("optimal" if np.isfinite(least) else "infeasible")
        if np.isfinite(least):
            assert plan.cost == least


@FEW
@given(tiny_problems(objective="snr"))
def test_snr_serves_by_the_best_ap_only(problem: Problem) -> None:
    """§1.10: under `snr` the answer is that of own costs (1, 0) on coverage cut to the best AP.

    Handovers are counted all the same.
    """
    cover = np.zeros_like(problem.cover)
    for v in range(problem.n_vertices):
        snr = [
            -np.inf if np.isnan(x) or not problem.cover[v, a] else x
            for a, x in enumerate(problem.snr_db[v])
        ]
        cover[v, snr.index(max(snr))] = True
    assert (problem.cover == cover).all()
    at_u, at_v = cover[problem.edge_uv[:, 0]], cover[problem.edge_uv[:, 1]]
    cut = dataclasses.replace(
        problem,
        objective="costs",
        edge_cover=problem.edge_cover & at_u & at_v,
        edge_handover=problem.edge_handover & at_u[:, :, None] & at_v[:, None, :],
    )
    one, two = answer(problem), answer(cut)
    assert (one.status, one.cost, one.paths) == (two.status, two.cost, two.paths)
    best = cover.argmax(axis=1)
    for path in one.paths:
        if path is not None:
            assert path.aps.tolist() == best[path.vertices].tolist()
            assert path.handovers == int((np.diff(best[path.vertices]) != 0).sum())
    assert one.cost == one.slots


@FEW
@given(tiny_problems())
def test_robots_at_their_goals_stay(problem: Problem) -> None:
    """§1.5: whoever starts at its goal has the one-state path in every plan."""
    plans = [answer(problem, method) for method in ("auto", "pgcp", "cooperative")]
    for i in np.flatnonzero(problem.start == problem.goal):
        for plan in plans:
            path = plan.paths[i]
            assert path is None or (path.arrival == 0 and path.handovers == 0)


@FEW
@given(tiny_problems(), st.integers(2, 5))
def test_costs_scale(problem: Problem, factor: int) -> None:
    """§1.9: with both costs multiplied, optima are multiplied."""
    base = dataclasses.replace(problem, objective="costs")
    dearer = dataclasses.replace(base, c_t=factor * base.c_t, c_h=factor * base.c_h)
    one, two = answer(base), answer(dearer)
    if not one.unserved:
        assert two.status != "infeasible"
        assert two.lower_bound is not None
        assert two.lower_bound <= factor * one.cost
    if not two.unserved:
        assert one.status != "infeasible"
        assert one.lower_bound is not None
        assert factor * one.lower_bound <= two.cost
    if one.status == two.status == "optimal":
        assert two.cost == factor * one.cost
