"""The APs of new paths: they begin with the one that serves, amid a crossing, too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from logs.records import Handover, Replan, RobotState
from tests.twin.halls import make_hall, of_type
from tests.twin.plans import make_plan, make_problem
from twin.association import Prediction, associate
from twin.disturbances import declare
from twin.order import Route, order_of
from twin.serving import has_begun, keep_serving
from twin.twin import run
from worlds.events import Event

EVERYWHERE = [[0, 1]] * 4
WORK = np.array([False, False])


def line(*, slots=1, capacity=9):
    """Four vertices in a row, all covered by both APs."""
    return make_problem(
        [(2.0 * v, 0.0) for v in range(4)],
        [(0, 1), (1, 2), (2, 3)],
        [(0, 3), (1, 3)],
        cover=EVERYWHERE,
        slots=[slots] * 3,
        capacity=capacity,
    )


def route(vertices, aps, edges, piece=0):
    """A route from lists."""
    return Route(*(np.array(c, np.int32) for c in (vertices, aps, edges)), piece)


def test_a_new_path_begins_with_the_ap_that_serves():
    """A planner chooses the first AP freely (§1.9); in the middle of a run that is a handover."""
    way = route([0, 1, 2], [1, 1, 1], [0, 1])
    kept = keep_serving(line(), {0: way}, np.array([0, 0]), np.array([9, 9]), WORK)
    assert kept[0].aps.tolist() == [0, 0, 0]


def test_without_a_place_left_it_does_so_all_the_same():
    """Late robots may overload an AP; none changes its AP without a handover."""
    ways = {0: route([0, 1, 2], [1, 1, 1], [0, 1]), 1: route([1, 2, 3], [0, 0, 0], [1, 2])}
    kept = keep_serving(line(), ways, np.array([0, 0]), np.array([1, 1]), WORK)
    assert kept[0].aps.tolist()[0] == 0
    assert kept[1].aps.tolist() == [0, 0, 0]


def test_an_ap_that_is_out_is_not_kept():
    """It serves nobody from the next slot on."""
    way = route([0, 1, 2], [1, 1, 1], [0, 1])
    kept = keep_serving(
        line(), {0: way}, np.array([0, 0]), np.array([0, 9]), np.array([True, False])
    )
    assert kept[0].aps.tolist() == [0, 1, 1]


def test_a_handover_made_amid_a_crossing_stays_made():
    """The AP of the vertex left is loaded until arrival (§1.6); the next one serves already."""
    problem = line(slots=4)
    rest = route([0, 0, 1, 1, 1, 1, 2], [0, 0, 1, 1, 1, 1, 1], [0, 0, 1, 1, 1, 1], piece=2)
    assert has_begun(rest, 1)
    assert not has_begun(rest, 0)
    assert not has_begun(route([0, 1], [0, 1], [0]), 1)
    kept = keep_serving(problem, {0: rest}, np.array([1, 0]), np.array([9, 9]), WORK)
    assert kept[0].aps.tolist() == rest.aps.tolist()


@pytest.mark.parametrize(("serving", "expected"), [(1, [1, 1, 1]), (0, [0, 0, 1])])
def test_the_twin_goes_on_with_the_ap_that_serves_amid_a_crossing(serving, expected):
    """A plan adopted amid a crossing makes its handover once: now, unless it has been made."""
    hall = make_hall(
        size=(8.0, 2.0),
        aps=(("a0", (1.0, 1.0, 3.0)), ("a1", (7.0, 1.0, 3.0))),
        errands=(((0, 0), (1, 0)),),
    )
    problem = hall.problem
    slow = replace(problem, edge_slots=np.full_like(problem.edge_slots, 4))
    edge = int(np.flatnonzero((slow.edge_uv == [0, 1]).all(axis=1))[0])
    order = order_of(slow, [route([0, 0, 1], [0, 0, 1], [edge, edge], piece=2)])
    prediction = Prediction(hall.floor, hall.radio_map, problem)
    found = associate(slow, order, prediction, 4, np.array([serving], np.int32))
    assert found.serves.tolist() == expected
    assert (found.step > 0).tolist() == [False, serving == 0, False]


def test_a_robot_whose_plan_changes_keeps_its_ap():
    """After a replan in a run with delays only, each change of an AP has its record."""
    hall = make_hall(
        size=(16.0, 6.0),
        aps=(("west", (1.0, 3.0, 3.0)), ("east", (15.0, 3.0, 3.0))),
        errands=(((0, 0), (7, 0)), ((0, 2), (7, 2)), ((7, 1), (0, 1))),
        radio={"ap_capacity": 2},
        run={"replan_slip": 2, "replan_cooldown": 1},
    )
    late = {"kind": "delay", "robot": "r0", "slot": 1, "slots": 6}
    hall = hall._replace(world=declare(hall.world, [Event.model_validate(late)]))
    east = ["west"] * 4 + ["east"] * 4
    records: list = []
    plan = make_plan(
        hall.problem,
        hall.walk("r0", *[(c, 0) for c in range(8)], aps=east),
        hall.walk("r1", *[(c, 2) for c in range(8)], aps=east),
        hall.walk("r2", *[(c, 1) for c in range(7, -1, -1)], aps=east[::-1]),
    )
    run(*hall, plan, emit=records.append)
    assert any(r.adopted for r in of_type(records, Replan))
    serves = {}
    for r in records:
        if isinstance(r, Handover):
            assert serves[r.robot] == r.from_ap
            serves[r.robot] = r.to_ap
        elif isinstance(r, RobotState) and r.activity != "gone":
            assert serves.setdefault(r.robot, r.ap) == r.ap
