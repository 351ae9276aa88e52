"""Validation of disturbed runs: clean logs have no finding, each planted defect is found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from logs.records import (
    BY_CONNECTION,
    BY_DELAY,
    HELD,
    MOVING,
    Blockages,
    Disturbance,
    Handover,
    Incident,
    NewPath,
    Record,
    Replan,
    RobotState,
    Waits,
)
from logs.validate import validate
from tests.logs.good_logs import log_of
from tests.logs.tamper import forge, records, rules

HALL = """
format = "mapp-world/1"
name = "shift"

[hall]
size_m = [24.0, 12.0]
pitch_m = 2.0

[[obstacle]]
name = "machine"
center_m = [12.0, 6.0]
size_m = [3.4, 1.4]
height_m = 3.0

[[ap]]
id = "west"
position_m = [2.0, 6.0, 4.0]

[[ap]]
id = "east"
position_m = [22.0, 6.0, 4.0]

[radio]
tx_power_dbm = 4.0
edge_rule = "samples"

[robots.random]
count = 6
seed = 5

[plan]
horizon = 40

[run]
release_horizon = 2
replan_after_s = 4.0
time_to_trigger_s = 0.5
"""
DELAYS = HALL + '[[event]]\nkind = "delay"\nrobot = "r01"\nslot = 2\nslots = 3\n'
OUTAGE = (
    HALL + '[[event]]\nkind = "ap-outage"\nap = "west"\nfrom_s = 4.0\nto_s = 24.0\n'
    '[[event]]\nkind = "ap-outage"\nap = "east"\nfrom_s = 9.0\nto_s = 21.0\n'
)
PALLET = (
    HALL + '[[event]]\nkind = "blockage"\nname = "pallet"\ncenter_m = [12.0, 9.0]\n'
    "size_m = [3.0, 1.5]\nfrom_s = 3.0\nto_s = 60.0\n"
)
FORK_LIFT = (
    HALL + '[[event]]\nkind = "blockage"\nname = "fork-lift"\n'
    "way_m = [[17.0, -1.0], [17.0, 6.0], [13.0, 11.0]]\n"
    "speed_m_s = 1.0\nsize_m = [2.0, 1.2]\nfrom_s = 2.0\nto_s = 20.0\n"
)
FAILURE = HALL + '[[event]]\nkind = "robot-failure"\nrobot = "r03"\nfrom_s = 5.0\n'
MANY = (
    HALL + "[delays]\np_delay = 0.1\nmax_delay = 4\n"
    + OUTAGE.removeprefix(HALL)
    + PALLET.removeprefix(HALL)
)  # fmt: skip
WORLDS = {
    "delays": DELAYS,
    "outage": OUTAGE,
    "pallet": PALLET,
    "fork-lift": FORK_LIFT,
    "failure": FAILURE,
    "all of it": MANY,
}


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS.keys())
def test_a_disturbed_run_is_valid(world):
    """What the twin makes of each disturbance keeps every invariant of page 5."""
    report = validate(log_of(world=world))
    assert report.findings == ()
    assert report.valid


def first(world: str, kind: type[Record], fits: Callable[..., bool] = lambda _: True) -> Record:
    """The first record of a kind in the log of a world."""
    return next(r for r in records(log_of(world=world)) if isinstance(r, kind) and fits(r))


def found(
    world: str, tmp_path, change: Callable[[Record], Record | list[Record] | None]
) -> set[str]:
    """Rules of steps 3 and 4 that a changed log breaks."""
    report = validate(forge(log_of(world=world), tmp_path / "forged.mcap", record=change))
    assert "reader" not in rules(report), report.findings
    assert not rules(report, 1)
    return rules(report)


def changed(target: Record, **values: object) -> Callable[[Record], Record]:
    """Changes one record."""
    return lambda r: replace(r, **values) if r == target else r


def left_out(target: Record) -> Callable[[Record], Record | None]:
    """Leaves one record out."""
    return lambda r: None if r == target else r


def test_a_robot_that_moves_during_its_delay_is_found(tmp_path):
    """A robot makes no transition while it is late."""
    state = first(DELAYS, RobotState, lambda s: s.cause == BY_DELAY)
    rules_found = found(DELAYS, tmp_path, changed(state, activity=MOVING, cause=""))
    assert "page5:delay" in rules_found


def test_a_wrong_delay_is_found(tmp_path):
    """Delays are those that the world's streams and events give."""
    delay = first(DELAYS, Disturbance)
    assert "page5:disturbance" in found(DELAYS, tmp_path, changed(delay, slots=2))
    assert "page5:disturbance" in found(DELAYS, tmp_path, left_out(delay))
    drawn = first(MANY, Disturbance, lambda d: d.kind == "delay")
    assert "page5:disturbance" in found(MANY, tmp_path, changed(drawn, slots=drawn.slots + 1))


def test_an_invented_delay_is_found(tmp_path):
    """A delay that the world does not have is no excuse for standing."""
    delay = first(DELAYS, Disturbance)
    other = replace(delay, robot="r02", name="")
    rules_found = found(DELAYS, tmp_path, lambda r: [r, other] if r == delay else r)
    assert "page5:disturbance" in rules_found


def test_a_robot_held_for_no_reason_is_found(tmp_path):
    """Group commit: who can advance advances."""
    state = first(DELAYS, RobotState, lambda s: s.activity == MOVING and s.slot == 1)
    standing = {"activity": HELD, "edge": -1, "next_vertex": state.vertex, "cause": BY_DELAY}
    assert "page5:commit" in found(DELAYS, tmp_path, changed(state, **standing))


def test_another_reason_told_is_found(tmp_path):
    """The first reason that holds is told, and no other."""
    state = first(DELAYS, RobotState, lambda s: s.cause == BY_DELAY)
    assert "page5:delay" in found(DELAYS, tmp_path, changed(state, cause=BY_CONNECTION))


def test_a_move_into_a_blockage_is_found(tmp_path):
    """Robots hold before edges on which they could touch a blockage."""
    state = first(FORK_LIFT, RobotState, lambda s: s.cause == "blockage")
    rules_found = found(FORK_LIFT, tmp_path, changed(state, activity=MOVING, cause=""))
    assert "page5:blockage" in rules_found


def test_a_wrong_pose_of_a_blockage_is_found(tmp_path):
    """Blockages are where their way-points and speed have them, at each sample."""
    boxes = first(FORK_LIFT, Blockages, lambda b: b.slot == 3)
    moved = changed(boxes, x_m=(boxes.x_m[0] + 0.05,))
    assert "page5:blockage" in found(FORK_LIFT, tmp_path, moved)
    assert "page5:blockage" in found(FORK_LIFT, tmp_path, left_out(boxes))
    turned = changed(boxes, yaw_rad=(boxes.yaw_rad[0] + 0.01,))
    assert "page5:blockage" in found(FORK_LIFT, tmp_path, turned)


def test_an_event_that_is_not_told_is_found(tmp_path):
    """Each event of the world that comes to pass is in the log, at its instant."""
    for world in (OUTAGE, FAILURE, PALLET):
        event = first(world, Disturbance)
        assert "page5:disturbance" in found(world, tmp_path, left_out(event))
    event = first(OUTAGE, Disturbance)
    assert "page5:disturbance" in found(OUTAGE, tmp_path, changed(event, ap="east"))


def test_service_by_an_ap_that_is_out_is_found(tmp_path):
    """An AP that is out serves nobody."""
    state = first(OUTAGE, RobotState, lambda s: s.link == "none" and s.activity != "gone")
    served = changed(state, ap="west", link="connected")
    assert "page5:handover" in found(OUTAGE, tmp_path, served)


def test_an_unplanned_handover_without_a_reason_is_found(tmp_path):
    """Handovers besides the plan lead from an AP that is lost to one that can be heard."""
    handover = first(OUTAGE, Handover, lambda h: not h.planned)
    assert "page5:handover" in found(OUTAGE, tmp_path, changed(handover, planned=True))
    assert "page5:handover" in found(OUTAGE, tmp_path, left_out(handover))
    out = first(OUTAGE, Handover, lambda h: not h.planned and h.to_ap == "east")
    assert "page5:handover" in found(OUTAGE, tmp_path, changed(out, to_ap="west"))


def test_a_move_beyond_the_release_is_found(tmp_path):
    """Without connection a robot drives as far as it is released, and no further."""
    state = first(OUTAGE, RobotState, lambda s: s.cause == BY_CONNECTION)
    rules_found = found(OUTAGE, tmp_path, changed(state, activity=MOVING, cause=""))
    assert "page5:release" in rules_found


def test_a_missing_replan_is_found(tmp_path):
    """New paths have a Replan that says why, and its figures are right."""
    replan = first(PALLET, Replan, lambda r: r.adopted)
    assert "page5:replan" in found(PALLET, tmp_path, left_out(replan))
    cheaper = changed(replan, cost_after=replan.cost_after - 1)
    assert "page5:replan" in found(PALLET, tmp_path, cheaper)
    assert "page5:replan" in found(PALLET, tmp_path, changed(replan, robot=()))
    assert "page5:replan" in found(PALLET, tmp_path, changed(replan, name="nothing"))
    assert "page5:replan" in found(PALLET, tmp_path, changed(replan, number=7))


def test_a_new_path_that_is_not_one_is_found(tmp_path):
    """New paths begin where the robots are and go along edges of G to their goals."""
    path = first(PALLET, NewPath, lambda p: len(p.vertices) > 3)
    jump = (path.vertices[0], *path.vertices[2:], path.vertices[-1])
    assert "§1.1" in found(PALLET, tmp_path, changed(path, vertices=jump))
    late = changed(path, vertices=path.vertices[:-1], aps=path.aps[:-1], edges=path.edges[:-1])
    assert "page5:replan" in found(PALLET, tmp_path, late)
    assert "page5:replan" in found(PALLET, tmp_path, left_out(path))


def test_a_deadlock_that_is_not_one_is_found(tmp_path):
    """Incidents are recomputed: a run in which robots move has no deadlock."""
    state = first(DELAYS, RobotState, lambda s: s.slot == 2)
    text = "nobody can move"
    invented = Incident(state.t_s, 2, "deadlock", "r00", "r01", "", 2.0, text)
    rules_found = found(DELAYS, tmp_path, lambda r: [invented, r] if r == state else r)
    assert "page5:incident" in rules_found


def test_waits_that_were_not_are_found(tmp_path):
    """Who waited for whom is counted anew."""
    waits = first(DELAYS, Waits)
    invented = changed(waits, robot=(0,), other=(1,), slots=(9,))
    assert "page5:kpi" in found(DELAYS, tmp_path, invented)
