"""What the twin notices by itself: defects planted into plans and halls are found (page 5)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from logs.records import ApLoad, Arrival, Incident, Kpi, RobotState, RunEnd, Sample, Separation
from planner.check import check_plan
from tests.twin.halls import SQUARE, incidents, make_hall, of_type
from tests.twin.plans import make_plan
from worlds.floor import Boxes


def test_two_robots_at_one_vertex_are_a_collision_and_a_contact():
    """§1.2: a planted defect is executed as planned, and found."""
    hall = make_hall(**SQUARE, errands=(((0, 0), (2, 0)), ((2, 0), (0, 0))))
    records = hall.run(
        hall.walk("r0", (0, 0), (1, 0), (2, 0)),
        hall.walk("r1", (2, 0), (1, 0), (1, 1), (0, 1), (0, 0)),
    )
    found = [i for i in incidents(records) if i[1] == "collision"]
    assert found == [(1, "collision", "r0", "r1", "")]
    assert "vertex" in of_type(records, Incident)[1].message
    contacts = [r for r in of_type(records, Incident) if r.kind == "contact"]
    assert [c.slot for c in contacts] == [0, 1]
    # Two bodies of 0.8 m x 0.6 m on top of each other in slot 1, one across the other in slot 2.
    assert [c.value for c in contacts] == pytest.approx([-0.6, -0.7])
    assert of_type(records, RunEnd)[0].verdict == "failed"
    assert "1 x collision; 2 x contact" in of_type(records, RunEnd)[0].message


def test_robots_that_meet_head_on_at_a_vertex_are_a_collision():
    """§1.2: whichever way the edges they come and go by are driven."""
    hall = make_hall(**SQUARE, errands=(((0, 0), (2, 0)), ((2, 0), (0, 0))))
    records = hall.run(
        hall.walk("r0", (0, 0), (1, 0), (2, 0)), hall.walk("r1", (2, 0), (1, 0), (0, 0))
    )
    assert [i for i in incidents(records) if i[1] == "collision"] == [
        (1, "collision", "r0", "r1", "")
    ]


def test_a_swap_is_a_collision_on_the_edge():
    """§1.3: two robots on one edge in the same slot."""
    hall = make_hall(**SQUARE, errands=(((0, 0), (1, 0)), ((1, 0), (0, 0))))
    records = hall.run(hall.walk("r0", (0, 0), (1, 0)), hall.walk("r1", (1, 0), (0, 0)))
    assert (0, "collision", "r0", "r1", "") in incidents(records)
    message = next(r.message for r in of_type(records, Incident) if r.kind == "collision")
    assert "edge 0" in message
    assert of_type(records, Separation)[0].clearance_m == pytest.approx(-0.6)


def test_bodies_too_wide_for_a_corner_are_a_contact_though_the_plan_is_legal():
    """Page 5: at a corner two followers come within pitch/√2, here 1.41 m, whatever the grid."""
    body = {"length_m": 1.6, "width_m": 1.2, "height_m": 0.4, "antenna_m": 0.5}
    hall = make_hall(**SQUARE, errands=(((1, 0), (1, 2)), ((0, 0), (1, 1))), hall={"body": body})
    paths = (
        hall.walk("r0", (1, 0), (1, 1), (1, 2)),
        hall.walk("r1", (0, 0), (1, 0), (1, 1)),
    )
    plan = make_plan(hall.problem, *paths)
    assert check_plan(hall.problem, replace(plan, lower_bound=0.0)) == []
    records = hall.run(*paths)
    assert [i[:4] for i in incidents(records)] == [(0, "contact", "r0", "r1")]
    separations = of_type(records, Separation)
    assert separations[0].clearance_m < 0
    assert (separations[0].robot_a, separations[0].robot_b) == ("r0", "r1")
    assert separations[1].clearance_m == pytest.approx(2.0 - 1.6)


def test_rotations_and_followers_of_normal_size_have_no_contact():
    """§1.3 allows them; with bodies smaller than pitch/√2 the clearance stays positive."""
    ring = [(0, 0), (1, 0), (1, 1), (0, 1)]
    hall = make_hall(**SQUARE, errands=[(ring[k], ring[(k + 2) % 4]) for k in range(4)])
    records = hall.run(
        *(hall.walk(f"r{k}", *(ring[(k + s) % 4] for s in range(3))) for k in range(4))
    )
    assert incidents(records) == []
    assert 0 < min(s.clearance_m for s in of_type(records, Separation)) < 2 / np.sqrt(2)
    assert of_type(records, RunEnd)[0].verdict == "completed"


def test_more_robots_than_an_ap_has_places_are_an_overload():
    """§1.6: in every slot in which it is so, slot 0 and parked robots included."""
    hall = make_hall(
        **SQUARE, errands=(((0, 0), (1, 0)), ((3, 3), (3, 1))), radio={"ap_capacity": 1},
        plan={"at_goal": "park"},
    )  # fmt: skip
    records = hall.run(hall.walk("r0", (0, 0), (1, 0)), hall.walk("r1", (3, 3), (3, 2), (3, 1)))
    assert incidents(records) == [(t, "overload", "", "", "ap") for t in range(3)]
    assert {r.value for r in of_type(records, Incident)} == {2.0}
    assert of_type(records, RunEnd)[0].verdict == "completed"
    assert of_type(records, Kpi)[-1].overload_robot_slots == 3


def test_a_box_that_was_not_there_when_the_plan_was_made_is_an_obstacle():
    """Every move is checked against the boxes as they are."""
    hall = make_hall(**SQUARE, errands=(((0, 0), (2, 0)),))
    crate = Boxes(("crate",), np.array([[4.0, 1.0, 0.1]]), np.array([[0.2, 0.2, 0.1]]), np.zeros(1))
    records = hall._replace(floor=replace(hall.floor, boxes=crate)).run(
        hall.walk("r0", (0, 0), (1, 0), (2, 0))
    )
    assert incidents(records) == [(1, "obstacle", "r0", "", "")]
    assert "crate" in of_type(records, Incident)[0].message
    assert "1 x obstacle" in of_type(records, RunEnd)[0].message


def test_robots_without_a_path_are_told_at_the_start_and_never_seen():
    """They are not on the floor; the run has failed, the others arrive all the same."""
    hall = make_hall(**SQUARE, errands=(((0, 0), (1, 0)), ((3, 3), (3, 1))))
    records = hall.run(None, hall.walk("r1", (3, 3), (3, 2), (3, 1)))
    assert incidents(records) == [(0, "unserved", "r0", "", "")]
    assert {r.robot for r in of_type(records, RobotState)} == {"r1"}
    assert {i for s in of_type(records, Sample) for i in s.robot} == {1}
    end = records[-1]
    assert (end.verdict, end.message) == ("failed", "1 of 2 robots have not arrived: r0")
    nobody = hall.run(None, None)
    assert nobody[-1].message == "2 of 2 robots have not arrived: r0, r1"
    assert nobody[-1].slot == 0


def test_one_robot_has_no_separation():
    """Fewer than two bodies: −1000 and no names."""
    hall = make_hall(**SQUARE, errands=(((0, 0), (1, 0)),))
    records = hall.run(hall.walk("r0", (0, 0), (1, 0)))
    assert {(s.clearance_m, s.robot_a, s.robot_b) for s in of_type(records, Separation)} == {
        (-1000.0, "", "")
    }


@pytest.mark.parametrize("at_goal", ["leave", "park"])
def test_start_at_the_goal_arrives_in_slot_0(at_goal):
    """§1.5: one state, one arrival; under `park` it stays to the end of the run."""
    hall = make_hall(
        **SQUARE, errands=(((0, 0), (0, 0)), ((3, 3), (3, 1))), plan={"at_goal": at_goal}
    )
    records = hall.run(hall.walk("r0", (0, 0)), hall.walk("r1", (3, 3), (3, 2), (3, 1)))
    assert [(r.slot, r.robot) for r in of_type(records, Arrival)] == [(0, "r0"), (2, "r1")]
    states = [(r.slot, r.activity) for r in of_type(records, RobotState) if r.robot == "r0"]
    if at_goal == "leave":
        assert states == [(0, "arrived"), (1, "gone")]
        assert of_type(records, Sample)[-1].robot == ()
    else:
        assert states == [(0, "arrived"), (1, "arrived"), (2, "arrived")]
        assert of_type(records, Sample)[-1].robot == (0, 1)
        assert [r.load for r in of_type(records, ApLoad)] == [2, 2, 2]
    assert records[-1].verdict == "completed"
    assert (records[-1].slot, records[-1].t_s) == (2, 6.0)
