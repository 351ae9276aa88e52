"""More robots than AP places where they start or stay: proven in moments, with names."""

from __future__ import annotations

import time
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings

from planner.ap_room import prove_no_room
from planner.expanded_graph import ExpandedGraph
from planner.explain import explain
from planner.problem import Problem
from planner.resources import SCALE, Resources
from planner.search import INFINITE, Penalties, Search
from planner.solve import SolveParams, solve
from tests.oracles.tiny_problems import random_hall, tiny_problems
from tests.planner.examples import grid

FEW = settings(derandomize=True, deadline=None, max_examples=300)


def is_too_full(problem: Problem, vertex: np.ndarray) -> bool:
    """Hall's condition by trying every set of APs."""
    cover, every = problem.cover[vertex], range(problem.n_aps)
    for k in range(problem.n_aps + 1):
        for chosen in combinations(every, k):
            outside = [a for a in every if a not in chosen]
            only = int((~cover[:, outside].any(axis=1)).sum())
            if only > int(problem.ap_capacity[list(chosen)].sum()):
                return True
    return False


@FEW
@given(tiny_problems())
def test_room_by_every_set_of_aps(problem: Problem) -> None:
    """§1.6: a proof is found if and only if APs have too few places; it proves what it says."""
    resources = Resources.of(problem)
    proof = prove_no_room(resources)
    parked = problem.at_goal == "park" and is_too_full(problem, problem.goal)
    assert (proof is not None) == (is_too_full(problem, problem.start) or parked)
    if proof is None:
        return
    assert proof.need > proof.room
    assert proof.room == int(proof.penalty @ resources.capacity[proof.resources])
    penalties = Penalties(resources)
    penalties.set(proof.resources, proof.penalty)
    search = Search(ExpandedGraph.of(problem))
    for i in proof.robots:
        if search.can_arrive(i):
            assert search.shortest(i, penalties, scale=0, limit=INFINITE)[0] >= SCALE


@pytest.mark.parametrize("method", ["auto", "exact", "pgcp", "cooperative"])
def test_seventy_robots_and_sixty_places(method: str) -> None:
    """§1.6, §1.12: no search is needed to see that; the answer names robots and APs."""
    problem = random_hall(1, n=70, m=15)
    began = time.process_time()
    plan = solve(problem, SolveParams(method=method))  # type: ignore[arg-type]
    assert time.process_time() - began < 5
    assert plan.status == "infeasible"
    assert len(plan.infeasible_robots) > 60
    assert "60 places" in plan.message
    assert "ap0, ap1, ap2, ap3" in plan.message


def test_only_those_who_compete_are_named() -> None:
    """§1.12: robots and APs that have nothing to do with the shortage are not named."""
    cover = [[0], [0], [0], [1], [1], [1]]
    problem = grid(6, 1, [(0, 1), (1, 2), (5, 4)], cover=cover, ap_capacity=[1, 3])
    plan = solve(problem, SolveParams())
    assert plan.infeasible_robots == ("r0", "r1")
    assert "only ap0 reaches them, with 1 place for these 2 robots" in plan.message
    told = explain(problem, plan)
    assert told.bottleneck is not None
    assert told.bottleneck.robots == ("r0", "r1")


def test_room_to_stay() -> None:
    """§1.4 `park`: at the end every robot needs a place where it stays; under `leave` none does."""
    cover = [[0, 1], [0, 1], [0], [0]]
    errands = [(0, 2), (1, 3)]
    for at_goal, infeasible in (("park", True), ("leave", False)):
        problem = grid(4, 1, errands, cover=cover, ap_capacity=[1, 2], at_goal=at_goal)
        proof = prove_no_room(Resources.of(problem))
        assert (proof is not None) == infeasible
        if infeasible:
            plan = solve(problem, SolveParams())
            assert plan.status == "infeasible"
            assert "where they stay, in slot 8" in plan.message
