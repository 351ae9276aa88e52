"""The difference of two logs: world, plan, key figures, and where the runs part."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

import logs
from logs.diff import Change, diff, world_values
from logs.records import CONNECTED, LINKS, OUTAGE, Kpi, Sample
from tests.cli_tools import twin
from tests.logs.good_logs import log_of
from tests.logs.tamper import forge

MOVED = (("ap.west.position_m", [5.0, 9.0, 3.5]),)


def compare(a, b):
    """The difference of two files."""
    return diff(logs.read(a), logs.read(b))


def test_a_log_equals_itself():
    """Nothing is found between a log and itself."""
    found = compare(log_of(), log_of())
    assert found.same
    assert found.world == found.plan == found.paths == found.figures == found.robots == ()
    assert found.places is None
    assert found.links is None


def test_another_world_is_told_key_by_key():
    """The key that was set, with both values, and what came of it in plan and figures."""
    found = compare(log_of(), log_of(MOVED_TUPLE))
    assert found.world == (Change("ap.west.position_m", [1.0, 5.0, 3.5], [5.0, 9.0, 3.5]),)
    plan = {change.key: (change.a, change.b) for change in found.plan}
    assert "cost" in plan
    assert {c.key for c in found.figures} >= {"handovers", "planned_handovers"}
    assert found.paths
    assert not found.same


MOVED_TUPLE = tuple((key, tuple(value)) for key, value in MOVED)


def test_every_key_of_a_world_has_its_place():
    """Parts of lists go by their ids, so that an AP put in front does not shift the others."""
    values = world_values(logs.read(log_of()))
    assert values["ap.west.position_m"] == [1.0, 5.0, 3.5]
    assert any(key.startswith("robot.anna.start") for key in values)
    assert values["plan.horizon"]


def test_where_the_runs_part_is_the_first_place_that_differs(tmp_path):
    """One robot is moved in one sample: slot, time, robot and both places are told."""
    samples = logs.read(log_of()).of(Sample)
    at = samples[len(samples) // 2]

    def moved(record):
        if record != at:
            return record
        return replace(record, x_m=(record.x_m[0] + 0.25, *record.x_m[1:]))

    found = compare(log_of(), forge(log_of(), tmp_path / "f.mcap", record=moved))
    assert (found.places.slot, found.places.t_s) == (at.slot, (at.t_s, at.t_s))
    (change,) = found.places.robots
    assert change.key == logs.read(log_of()).problem.robot_ids[at.robot[0]]
    assert change.b["x_m"] - change.a["x_m"] == pytest.approx(0.25)
    assert found.links is None
    assert found.world == found.plan == ()


def test_links_that_part_are_told_apart_from_places(tmp_path):
    """A lost link is no other place."""
    at = logs.read(log_of()).of(Sample)[3]

    def lost(record):
        link = (LINKS.index(OUTAGE), *at.link[1:])
        return replace(record, link=link) if record == at else record

    found = compare(log_of(), forge(log_of(), tmp_path / "f.mcap", record=lost))
    assert found.places is None
    assert found.links.slot == at.slot
    (change,) = found.links.robots
    assert (change.a["link"], change.b["link"]) == (CONNECTED, OUTAGE)


def test_a_run_that_ends_early_parts_at_its_end(tmp_path):
    """Samples that only one of them has are a difference."""
    last = logs.read(log_of()).of(Sample)[6].t_s
    cut = forge(
        log_of(),
        tmp_path / "f.mcap",
        record=lambda r: None if isinstance(r, Sample) and r.t_s > last else r,
    )
    found = compare(log_of(), cut)
    assert found.places.t_s[0] > last
    assert all(change.b is None for change in found.places.robots)


def test_the_command_tells_and_ends_with_0_or_1(tmp_path):
    """Exit code 0 for equal logs, 1 for others, 2 for what is no log; --json has it all."""
    a, b = log_of(), log_of(MOVED_TUPLE)
    assert twin("diff", a, a).code == 0
    told = twin("diff", a, b)
    assert told.code == 1
    assert "ap.west.position_m" in told.out
    found = twin("diff", a, b, "--json").json
    assert found["world"][0]["key"] == "ap.west.position_m"
    bad = twin("diff", a, tmp_path / "none.mcap")
    assert (bad.code, "is not there" in bad.err) == (2, True)


def test_numbers_that_json_does_not_know_become_text(tmp_path):
    """NaN in a forged log does not break --json."""

    def worse(record):
        return replace(record, outage_s=float("nan")) if isinstance(record, Kpi) else record

    found = compare(log_of(), forge(log_of(), tmp_path / "f.mcap", record=worse))
    text = json.dumps(found.to_dict(), allow_nan=False)
    assert '"nan"' in text
