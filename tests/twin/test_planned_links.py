"""Links that are measured ahead are those that robots meet when they come there."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from logs.records import HELD, RobotState, Sample
from tests.twin.halls import make_hall, of_type, random_hall
from twin import planned_links
from twin.disturbances import declare
from twin.twin import run
from worlds.events import Delays
from worlds.link import LinkModel
from worlds.scene import Scene


def late(hall, plan, p_delay=0.15):
    """The records of a run in which robots are often late, and plans are made anew for it."""
    world = declare(hall.world, delays=Delays(p_delay=p_delay, max_delay=4))
    records = []
    run(world, *hall[1:], plan, emit=records.append)
    return records


@settings(max_examples=6, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.booleans(), st.sampled_from(["leave", "park"]))
def test_how_far_ahead_is_measured_changes_nothing(seed, slow, at_goal):
    """One transition at a time or many: the same records to the last bit, late robots or not."""
    hall, plan = random_hall(seed, rule="endpoints", slow=slow, at_goal=at_goal)
    for p_delay in (0.0, 0.15):
        expected = late(hall, plan, p_delay)
        for ahead in (1, 3):
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(planned_links, "AHEAD", ahead)
                assert late(hall, plan, p_delay) == expected


@pytest.mark.parametrize("seed", [1, 5, 9])
@pytest.mark.parametrize("slow", [False, True])
def test_each_sample_is_measured_at_its_own_place(seed, slow):
    """A ray cast anew from the AP to where the sample says the robot is gives the sample's SNR."""
    hall, plan = random_hall(seed, rule="endpoints", slow=slow)  # odd seeds: no fading
    records = late(hall, plan)
    model = LinkModel(hall.world)
    assert any(state.activity == HELD for state in of_type(records, RobotState))
    with Scene.of(hall.world, hall.floor) as scene:
        for sample in of_type(records, Sample):
            antenna = model.antenna_m(np.column_stack([sample.x_m, sample.y_m]))
            snr, _ = model.measure(scene, np.array(sample.ap, np.int32), antenna)
            assert snr.tolist() == pytest.approx(sample.snr_db, abs=1e-9)


def test_a_robot_that_stands_for_long_is_measured_once(monkeypatch):
    """One that is parked costs no ray any more, however long the others take."""
    asked = []
    look = LinkModel.look

    def counted(self, scene, ap, antenna_m, own=-1):
        asked.append(len(antenna_m))
        return look(self, scene, ap, antenna_m, own)

    monkeypatch.setattr(LinkModel, "look", counted)
    hall = make_hall(
        size=(16.0, 4.0), errands=(((0, 0), (7, 0)), ((3, 1), (3, 1))), plan={"at_goal": "park"}
    )
    asked.clear()
    hall.run(hall.walk("r0", *[(c, 0) for c in range(8)]), hall.walk("r1", (3, 1)))
    ahead = 7 * 4 + 1  # samples of seven crossings, and of the state they end in
    assert asked == [ahead, 1, 1]  # and each robot once where it stands
