"""Two robots looked at together: exact joint costs, and only states that no plan needs excluded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planner.branching import Restriction
from planner.check import check_plan
from planner.cuts import CutPool
from planner.cuts.pairs import clashing_pairs, interacting_pairs
from planner.exact import ExactParams, ExactSearch
from planner.exact_fixing import Fixing
from planner.exact_pricing import Pricing
from planner.expanded_graph import ExpandedGraph
from planner.joint import JointBound, Propagation, single_edges
from planner.master import Master
from planner.problem import Problem
from planner.resources import SCALE, Resources
from planner.search import NOTHING_FORBIDDEN, Search
from tests.oracles.arcflow import solve_arcflow
from tests.oracles.tiny_problems import tiny_problem
from tests.planner.examples import grid, path_of

FREE = 1 << 40
"""More room than any plan needs."""


def pricing_of(problem: Problem) -> Pricing | None:
    """Pricing without penalties; None if a robot cannot arrive."""
    resources, search = Resources.of(problem), Search(ExpandedGraph.of(problem))
    if not all(search.can_arrive(i) for i in range(problem.n_robots)):
        return None
    return Pricing(search, resources, CutPool(problem, resources.n))


def propagate(pricing: Pricing, most: int) -> Propagation | None:
    """What pairs show without decisions and penalties."""
    n, T = pricing.n, pricing.problem.horizon
    return JointBound(pricing).propagate([Restriction(0, T, NOTHING_FORBIDDEN)] * n, most, 0)


@pytest.mark.parametrize("at_goal", ["leave", "park"])
@pytest.mark.parametrize("seed", range(25))
def test_two_robots_cost_what_the_two_cost_at_least(seed: int, at_goal: str) -> None:
    """Of two robots the bound is their optimum where APs limit nothing (§1.2–1.4), at any room."""
    problem = tiny_problem(seed, features=False, max_robots=2, max_slots=7, at_goal=at_goal)
    problem = replace(problem, ap_capacity=np.full_like(problem.ap_capacity, problem.n_robots))
    pricing = pricing_of(problem)
    if pricing is None or problem.n_robots < 2:
        return
    optimum = solve_arcflow(problem).cost
    found = propagate(pricing, FREE)
    if optimum is None or solve_arcflow(problem).status == "infeasible":
        assert found is None
        return
    assert found is not None
    assert found.bound == optimum * SCALE
    at_optimum = propagate(pricing, optimum * SCALE)
    assert at_optimum is not None
    assert at_optimum.bound == optimum * SCALE
    assert propagate(pricing, optimum * SCALE - 1) is None


@pytest.mark.parametrize("at_goal", ["leave", "park"])
@pytest.mark.parametrize("seed", range(300, 325))
def test_an_optimal_plan_keeps_its_states(seed: int, at_goal: str) -> None:
    """With room for the optimum the bound is at most that, and no state of its is excluded."""
    problem = tiny_problem(seed, features=False, max_robots=4, max_slots=7, at_goal=at_goal)
    pricing, optimum = pricing_of(problem), solve_arcflow(problem)
    if pricing is None or optimum.status == "infeasible":
        return
    rng = np.random.default_rng(seed)
    noise = rng.integers(0, SCALE, pricing.resources.n) * (rng.random(pricing.resources.n) < 0.1)
    pricing.penalties.set(np.arange(pricing.resources.n), noise)
    capacity = int(noise @ pricing.resources.capacity.astype(np.int64))
    kept = [Restriction(0, problem.horizon, NOTHING_FORBIDDEN)] * pricing.n
    found = JointBound(pricing).propagate(kept, optimum.cost * SCALE, capacity)
    assert found is not None
    assert found.bound <= optimum.cost * SCALE
    fixing, master = Fixing(pricing), Master(pricing.resources, 1.0)
    for i, path in enumerate(optimum.paths):
        assert path is not None
        amid = np.zeros((problem.horizon + 1, problem.n_aps), np.bool_)
        excluded = np.concatenate((found.excluded[i], amid), axis=1)
        assert fixing.keeps(fixing.states(master.column(i, path)), excluded)
        if at_goal == "park":  # parking passes the goal's state by the AP it arrived with
            node = pricing.search.graph.node_of[path.vertices[-1], path.aps[-1]]
            assert not found.excluded[i][path.arrival :, node].any()


def test_looking_at_pairs_closes_what_cuts_would() -> None:
    """Two robots that change ends of a passage with a bay: the root is closed without any cut."""
    edges = np.array([(0, 1), (1, 2), (2, 3), (3, 4), (2, 5)])
    problem = grid(
        3, 2, [(0, 4), (4, 0)], n_aps=1, horizon=12, c_h=0, objective="costs", edge_uv=edges
    )
    optimum = solve_arcflow(problem)
    assert check_plan(problem, optimum) == []
    bounds = []
    for propagations in (0, 1):
        tree = ExactSearch(
            Search(ExpandedGraph.of(problem)),
            Resources.of(problem),
            [None, None],
            target=optimum.cost + 1,
            params=ExactParams(nodes=1, cuts=(), neighbourhoods=0, propagations=propagations),
        )
        tree.run()
        bounds.append(tree.bound / SCALE)
    assert bounds[0] <= optimum.cost - 1.5
    assert bounds[1] == pytest.approx(optimum.cost, abs=1e-4)


def test_a_second_edge_lets_two_robots_swap() -> None:
    """§1.3: swaps are impossible on one edge, possible where two join the vertices."""
    for edges, possible in (([(0, 1)], False), ([(0, 1), (0, 1)], True)):
        problem = grid(2, 1, [(0, 1), (1, 0)], n_aps=1, horizon=4, edge_uv=np.array(edges))
        pricing = pricing_of(problem)
        assert pricing is not None
        assert single_edges(problem)[0, 1] != possible
        assert (propagate(pricing, FREE) is not None) == possible


def test_pairs_that_clash_most_come_in() -> None:
    """Robots whose likely paths exclude each other are found, those that never meet are not."""
    problem = grid(3, 2, [(0, 2), (2, 0), (3, 5)], n_aps=1)
    master = Master(Resources.of(problem), 100.0)
    paths = [
        (0, "0a 1a 2a"), (0, "0a 3a 4a 5a 2a"), (1, "2a 1a 0a"), (1, "2a 2a 1a 0a"),
        (2, "3a 4a 5a"), (2, "3a 3a 3a 3a 4a 5a"),
    ]  # fmt: skip
    master.add([master.column(i, path_of(problem, i, text)) for i, text in paths])
    x = np.array([0.0] * 3 + [0.9, 0.1, 0.5, 0.5, 0.5, 0.5])
    assert interacting_pairs(master.columns, x, master.resources) == [(0, 1), (0, 2)]
    assert clashing_pairs(master.columns, x, master.resources, 5) == [(0, 1), (0, 2)]
    assert clashing_pairs(master.columns, x, master.resources, 1) == [(0, 1)]
