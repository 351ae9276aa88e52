"""A log can be run again: the same messages, or the first one that is not."""

from __future__ import annotations

import json
from dataclasses import replace
from xml.etree import ElementTree

import pytest

import logs
from logs.records import ApLoad, RobotState, RunEnd, RunStart, Sample
from logs.validate import validate
from tests.cli_tools import twin
from tests.logs.good_logs import log_of
from tests.logs.tamper import cut, edited, forge
from twin.errors import TwinError
from twin.rerun import rerun, rerun_elsewhere, with_rerun


def messages(path) -> int:
    """How many messages a log holds."""
    return sum(1 for _ in logs.read(path).iter_messages())


def test_a_log_runs_again_message_by_message():
    """Equal inputs give equal records and equal pictures, all of them compared (page 6)."""
    answer = rerun(log_of())
    assert answer.difference is None
    assert answer.messages == messages(log_of())


@pytest.mark.parametrize("hash_seed", [1, 4294967295])
def test_it_does_so_whatever_strings_hash_to(hash_seed):
    """In a process of its own, with that hash seed, nothing is different."""
    shares = []
    answer = rerun_elsewhere(log_of(), hash_seed=hash_seed, on_progress=shares.append)
    assert answer.difference is None
    assert answer.messages == messages(log_of())
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def planted(tmp_path, **edits):
    """The first difference of a forged log."""
    return rerun(forge(log_of(), tmp_path / "f.mcap", **edits)).difference


def test_an_altered_field_is_named(tmp_path):
    """Slot, record, robot and field, with what was and what should be."""
    state = next(r for r in logs.read(log_of()).of(RobotState) if r.slot == 3)

    def later(record):
        return replace(record, visit=record.visit + 1) if record == state else record

    found = planted(tmp_path, record=later)
    assert (found.slot, found.record, found.robot) == (3, "RobotState", state.robot)
    assert (found.field, found.found, found.expected) == (
        "visit",
        str(state.visit + 1),
        str(state.visit),
    )
    assert str(found).startswith(f"slot 3, RobotState of {state.robot}, visit:")


def test_an_altered_entry_of_a_sample_names_its_robot(tmp_path):
    """One entry of one column of one sample; the smallest change of a number counts."""
    sample = logs.read(log_of()).of(Sample)[5]
    assert len(sample.robot) > 1

    def nudged(record):
        if record != sample:
            return record
        return replace(
            record, snr_db=(sample.snr_db[0], sample.snr_db[1] + 1e-13, *sample.snr_db[2:])
        )

    found = planted(tmp_path, record=nudged)
    assert (found.record, found.field, found.slot) == ("Sample", "snr_db[1]", sample.slot)
    assert found.robot == logs.read(log_of()).problem.robot_ids[sample.robot[1]]


def test_missing_and_superfluous_records_are_named(tmp_path):
    """A record left out, one told twice, a log that ends too early, one that goes on."""
    load = logs.read(log_of()).of(ApLoad)[2]
    gone = planted(tmp_path, record=lambda r: None if r == load else r)
    assert (gone.record, gone.slot) == ("ApLoad", load.slot)
    twice = planted(tmp_path, record=lambda r: (r, r) if r == load else r)
    assert twice is not None
    early = planted(tmp_path, record=lambda r: None if isinstance(r, RunEnd) else r)
    assert early.record == "RunEnd"
    longer = planted(tmp_path, record=lambda r: (r, r) if isinstance(r, RunEnd) else r)
    assert (longer.found, longer.record) == ("one message more", "RunEnd") or longer.found


def test_an_altered_picture_is_named(tmp_path):
    """What Foxglove is shown is compared as well, byte by byte."""
    count = 0

    def change(topic, data):
        nonlocal count
        count += topic == "/scene/links"
        return data + b"" if topic != "/scene/links" or count != 2 else data[:-1] + b"\0"

    found = planted(tmp_path, message=change)
    assert found.record == "/scene/links"


def test_another_plan_gives_another_run(tmp_path):
    """The plan is embedded: one that is replaced shows in the first record that follows from it."""
    other = logs.read(log_of((("plan.objective", "tp"), ("plan.seed", 5)))).attachments
    found = planted(tmp_path, attachment=edited("world.toml", lambda _: other["world.toml"]))
    assert found is None or found.slot is not None
    seeded = edited("world.toml", lambda data: data.replace(b"slot_s", b"slot_s"))
    assert planted(tmp_path, attachment=seeded) is None


def test_it_becomes_step_5_of_the_report(tmp_path):
    """Findings, counts and JUnit have the step only if it was asked for."""
    start = logs.read(log_of()).of(RunStart)[0]
    forged = forge(
        log_of(),
        tmp_path / "f.mcap",
        record=lambda r: replace(r, policy="other") if r == start else r,
    )
    plain = validate(forged)
    assert set(plain.steps) == {1, 2, 3, 4}
    report = with_rerun(plain, rerun(forged))
    assert report.checked[5] >= 1
    (finding,) = (f for f in report.findings if f.step == 5)
    assert (finding.rule, finding.slot) == ("page6:replay", 0)
    assert "policy" in finding.found
    suites = ElementTree.fromstring(report.to_junit_xml())
    assert suites[-1].get("name") == "5 the run made again"
    assert suites[-1].get("failures") == "1"


def test_the_command_has_exit_codes(tmp_path):
    """0 for a run that repeats, 1 for one that does not or cannot, 2 for what is no log."""
    good = twin("validate", log_of(), "--replay", "--hash-seed", "7", "--json")
    assert good.code == 0
    assert [s["step"] for s in good.json["steps"]] == [1, 2, 3, 4, 5]
    assert good.json["steps"][4]["checked"] == messages(log_of())
    load = logs.read(log_of()).of(ApLoad)[1]
    forged = forge(
        log_of(), tmp_path / "f.mcap", record=lambda r: replace(r, load=9) if r == load else r
    )
    bad = twin("validate", forged, "--replay", "--json", tmp_path / "f.json")
    assert bad.code == 1
    found = json.loads((tmp_path / "f.json").read_text())["findings"]
    assert [f["found"] for f in found if f["step"] == 5] == ["ApLoad at 0 s, load: 9"]
    half = cut(log_of(), tmp_path / "half.mcap", log_of().stat().st_size // 2)
    assert twin("validate", half, "--replay").code == 2
    refused = twin("validate", log_of(), "--hash-seed", "7")
    assert (refused.code, "--replay" in refused.err) == (2, True)


def test_inputs_that_cannot_be_run_are_told_in_a_sentence(tmp_path):
    """A log without its plan, and one whose world is text, end in an error, never a traceback."""
    without = forge(
        log_of(), tmp_path / "f.mcap", attachment=lambda n, d: None if n == "plan.json" else d
    )
    with pytest.raises(TwinError, match=r"carries no plan\.json"):
        rerun_elsewhere(without, hash_seed=1)
    told = twin("validate", without, "--replay", "--json")
    assert told.code == 1
    assert any("step 5" in text for text in told.json["skipped"])
