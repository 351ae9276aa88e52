"""Planning around others by safe intervals: as cheap as slot by slot, and never in anyone's way."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner import kernels_fleet as kernels
from planner.check import check_plan
from planner.cooperative import Reservations
from planner.expanded_graph import ExpandedGraph
from planner.fleet import FleetPlan
from planner.plan import Plan
from planner.problem import Problem
from planner.resources import SCALE, Resources
from planner.search import Search
from tests.oracles.tiny_problems import random_hall, tiny_problems
from tests.planner.examples import grid, path_of

FEW = settings(derandomize=True, deadline=None, max_examples=150)


def assert_as_cheap_as_slot_by_slot(problem: Problem, salt: int) -> int:
    """Robots one after another: each costs what A* on G' says; returns how many were served."""
    search, resources = Search(ExpandedGraph.of(problem)), Resources.of(problem)
    fleet, taken = FleetPlan(search), Reservations(resources)
    cost = 0
    for i in range(problem.n_robots):
        best, path = search.shortest(i, taken.penalties)
        if path is not None:
            # A limit is exclusive: one unit less than the best and there is nothing.
            assert not fleet.plan(i, limit=best // SCALE, salt=salt)
        assert fleet.plan(i, salt=salt) == (path is not None)
        if path is None:
            continue
        found = fleet.paths()[i]
        assert found is not None
        assert problem.c_t * found.arrival + problem.c_h * found.handovers == best // SCALE
        assert fleet.fleet.cost[i] == best // SCALE
        cost += best // SCALE
        taken.add(resources.used_by(found))
    paths = fleet.paths()
    status = "unknown" if None in paths else "feasible"
    assert check_plan(problem, Plan(status, problem.robot_ids, tuple(paths), cost, 0.0)) == []
    return problem.n_robots - paths.count(None)


@FEW
@given(tiny_problems(), st.integers(0, 3))
def test_as_cheap_as_slot_by_slot(problem: Problem, salt: int) -> None:
    """§1.2–§1.7: slow, one-way and parallel edges, little room, handovers, both endings."""
    assert_as_cheap_as_slot_by_slot(problem, salt)


@pytest.mark.parametrize("at_goal", ["leave", "park"])
@pytest.mark.parametrize("objective", ["hp", "tp", "snr"])
def test_as_cheap_in_a_hall(objective: str, at_goal: str) -> None:
    """The same among forty robots and more than 64 slots, where APs are full at times."""
    problem = random_hall(1, n=40, m=14, T=90, objective=objective, at_goal=at_goal)
    assert assert_as_cheap_as_slot_by_slot(problem, salt=5) > 30


@FEW
@given(st.data())
def test_next_slot(data: st.DataObject) -> None:
    """The next taken or free slot is that of a plain loop over two rows of bits."""
    slots = data.draw(st.integers(1, 200))
    words = (slots - 1) // kernels.WORD + 1
    rows = np.zeros((2, words), np.uint64)
    taken = [set(), set()]
    for row in (0, 1):
        begin = data.draw(st.integers(0, slots))
        for t in range(begin, min(slots, begin + data.draw(st.integers(0, 150)))):
            kernels._put(rows, row, t, True)
            taken[row].add(t)
    both = taken[0] | taken[1]
    t, last = data.draw(st.integers(0, slots - 1)), slots - 1
    for wanted in (True, False):
        expected = next((x for x in range(t, slots) if (x in both) == wanted), slots)
        assert kernels.next_slot(rows, 0, rows, 1, t, last, wanted) == expected
    kernels._put(rows, 0, t, True)
    kernels._put(rows, 0, t, False)
    kernels._put(rows, 1, t, False)
    assert kernels.next_slot(rows, 0, rows, 1, t, t, False) == t


def test_a_goal_passed_late_costs_few_labels() -> None:
    """§1.4 `park`: waiting for a goal does not cost a label for every slot and place nearby."""
    problem = grid(12, 12, [(143, 130), (0, 13)], n_aps=1, horizon=150, at_goal="park")
    fleet = FleetPlan(Search(ExpandedGraph.of(problem)))
    # r0 turns round at r1's goal, vertex 13, in slot 117; r1 could be there in slot 2.
    way = [143] * 98 + [*range(131, 23, -12), *range(34, 24, -1), 13, *range(25, 122, 12)]
    fleet.place(0, path_of(problem, 0, " ".join(f"{v}a" for v in [*way, *range(122, 131)])))
    assert way.index(13) == 117
    assert fleet.plan(1)
    path = fleet.paths()[1]
    assert path is not None
    assert path.arrival == 118
    assert fleet.fleet.labels[0] < 500
