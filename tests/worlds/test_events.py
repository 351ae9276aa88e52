"""`[delays]` and `[[event]]`: what a world may declare, and what is said of mistakes."""

from __future__ import annotations

from pathlib import Path

import pytest

from worlds.errors import WorldError
from worlds.events import longest_run_slots
from worlds.toml_file import dump_world, parse_world

TINY = (Path(__file__).resolve().parents[2] / "worlds/tiny.toml").read_text(encoding="utf-8")
LINES = len(TINY.splitlines())
GOOD = """
[delays]
p_delay = 0.05
delay_event = "poisson"

[[event]]
kind = "ap-outage"
ap = "east"
from_s = 10.0
to_s = 50.0

[[event]]
kind = "blockage"
name = "lift"
way_m = [[0.0, 5.0], [16.0, 5.0]]
size_m = [1.5, 1.0]

[[event]]
kind = "robot-failure"
robot = "bert"
from_s = 4.0

[[event]]
kind = "delay"
robot = "anna"
slot = 3
slots = 4
"""


def test_a_world_with_events_is_what_it_was_after_a_round_trip():
    """parse_world(dump_world(w)) == w."""
    world = parse_world(TINY + GOOD)
    assert parse_world(dump_world(world)) == world
    assert [e.kind for e in world.event] == ["ap-outage", "blockage", "robot-failure", "delay"]
    assert longest_run_slots(world) == 10 * world.plan.horizon + 4


FAULTS = {
    "unknown AP": ('ap = "east"', 'ap = "eats"', "event[0].ap: 'eats'", "did you mean 'east'"),
    "unknown robot": ('robot = "anna"', 'robot = "ana"', "event[3].robot", "did you mean 'anna'"),
    "ends before it begins": ("to_s = 50.0", "to_s = 5.0", "event[0].to_s", "later time"),
    "after the end": ("from_s = 4.0", "from_s = 5000.0", "event[2].from_s", "longest run"),
    "outside the hall": ("[16.0, 5.0]", "[160.0, 5.0]", "event[1].way_m[1]", "outside the hall"),
    "a key of another kind": ('name = "lift"', "slots = 3", "event[1].slots", "means nothing"),
    "a key that is missing": ("slots = 4", "", "event[3]", "has no `slots`"),
    "no place": ("way_m = [[0.0, 5.0], [16.0, 5.0]]", "", "event[1]", "center_m"),
    "one way-point": ("[[0.0, 5.0], [16.0, 5.0]]", "[[0.0, 5.0]]", "event[1].way_m", "two or more"),
    "unknown kind": ('"robot-failure"', '"robot-falure"', "event[2].kind", "robot-failure"),
    "more than certain": ("p_delay = 0.05", "p_delay = 1.5", "delays.p_delay", "1"),
    "shortest is longest": ('"poisson"', '"poisson"\nmin_delay = 11', "min_delay", "max_delay"),
}


@pytest.mark.parametrize(("old", "new", "key", "said"), FAULTS.values(), ids=FAULTS.keys())
def test_a_mistake_is_told_with_its_place(old, new, key, said):
    """Each fault names file, line, key, and what to do."""
    assert old in GOOD
    with pytest.raises(WorldError) as error:
        parse_world(TINY + GOOD.replace(old, new, 1), "day.toml")
    (line,) = (text for text in error.value.lines if key in text)
    assert said in line
    assert line.startswith("day.toml:")
    assert int(line.split(":")[1]) > LINES
