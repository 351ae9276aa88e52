"""Values set by dotted path before a world is checked."""

from __future__ import annotations

from pathlib import Path

import pytest

import worlds
from tests.worlds.good_world import GOOD, edited, lines_of
from worlds.toml_file import dump_world, parse_world

SHIPPED = sorted(Path(worlds.__file__).parent.glob("*.toml"))
TINY = Path(worlds.__file__).parent / "tiny.toml"


def test_overrides_reach_everything() -> None:
    """Tables, implied tables, elements by id, by name with a dot or by index, whole lists."""
    text = edited(
        ('name = "dock 1"', 'name = "dock.1"'), ('"dock 1"\ngoal', '"dock.1"\ngoal')
    ).replace('goal = "dock 1"', 'goal = "dock.1"')
    world = parse_world(
        text,
        overrides={
            "plan.horizon": 7,
            "radio.ap_capacity": 9,
            "hall.body.width_m": 0.5,
            "ap.east.enabled": False,
            "ap.0.capacity": 1,
            "ap[1].gain_db": 3,
            'station."dock.1".cell': (2, 0),
            "robot.anna.goal": {"cell": [4, 4]},
            "robot.bert.start.cell": [5, 5],
            "obstacles.random.share": 0.1,
            "plan.objective": {"c_t": 1, "c_h": 5},
        },
    )
    assert world.plan.horizon == 7
    assert world.radio.ap_capacity == 9
    assert world.hall.body.width_m == 0.5
    assert [(ap.enabled, ap.capacity, ap.gain_db) for ap in world.ap] == [
        (True, 1, None),
        (False, 3, 3.0),
    ]
    assert world.station[0].cell == (2, 0)
    assert world.robot[0].goal.cell == (4, 4)
    assert world.robot[1].start.cell == (5, 5)
    assert world.obstacles is not None
    assert world.obstacles.random.share == 0.1
    assert world == parse_world(dump_world(world))
    drawn = parse_world(GOOD, overrides={"robots.random.count": 3, "robot": None})
    assert drawn.robots is not None
    assert drawn.robot == ()


@pytest.mark.parametrize(
    ("path", "value", "wanted"),
    [
        ("plan.horizn", 5, "plan.horizn: is not a known key; did you mean 'horizon'?"),
        ("plan.horizon", 0, "plan.horizon: 0 is too small"),
        ("plan.horizon", "9", 'plan.horizon: "9" is text'),
        ("plan.horizon.x", 1, "plan.horizon.x: plan.horizon is a single value"),
        ("plann.horizon", 1, "plann: is not a known key; did you mean 'plan'?"),
        (
            "ap.eastt.enabled",
            False,
            "ap.eastt.enabled: no ap has the id 'eastt'; did you mean 'east'?",
        ),
        ("ap.7.enabled", False, "ap.7.enabled: no ap has the id '7'; known are west, east"),
        ("robot.carl.start", "dock 1", "robot.carl.start: no robot has the id 'carl'"),
        ("obstacle.rack.height_m", 1, "obstacle.rack.height_m: no obstacle has the name 'rack'"),
        ("ap.west", None, "ap.west: an element of a list cannot be taken out; set its enabled"),
        ("hall.pitch_m", None, ""),
        ("", 1, "'' is not a dotted path"),
        ("plan..horizon", 1, "plan..horizon: 'plan..horizon' is not a dotted path"),
        ("plan.", 1, "plan.: 'plan.' is not a dotted path"),
        ("plan.horizon[", 1, "plan.horizon[: 'plan.horizon[' is not a dotted path"),
        ("robots.random.count", 3, "robots: is given beside the listed robots"),
    ],
)
def test_a_bad_override_names_its_path_or_value(path: str, value: object, wanted: str) -> None:
    """What an override breaks is told as the override's fault, not as a line of the file."""
    told = lines_of(GOOD, **{path: value})
    if wanted:
        assert len(told) == 1
        assert told[0].startswith(f"hall.toml (override): {wanted}")
    else:  # what is missing in a table is told at the table
        rule = "has none of pitch_m, positions, graph; give one of them"
        assert told == [f"hall.toml:4: hall: {rule}"]
