"""Validation: good logs have no finding, what is no log is refused, the report is data."""

from __future__ import annotations

import json
from dataclasses import replace
from xml.etree import ElementTree

import pytest
from mcap.writer import Writer

from logs.errors import LogError
from logs.findings import KEPT
from logs.records import (
    Incident,
    Record,
    RunEnd,
    Sample,
)
from logs.validate import validate
from tests.logs.good_logs import POST_WORLD, empty_plan, heedless_plan, log_of, partial_plan
from tests.logs.tamper import forge, records, rules

GOOD = {
    "as it ships": (),
    "park": (("plan.at_goal", "park"), ("plan.objective", "tp")),
    "interruptions longer than a slot": (("run.interruption", 2300.0), ("plan.at_goal", "park")),
    "interruptions as long as a sample holds": (("run.interruption", 500.0),),
    "no interruption, one sample per slot": (
        ("run.interruption", 0.0),
        ("run.samples_per_slot", 1),
    ),
    "crooked times, endpoints, fading": (
        ("hall.speed_m_s", 0.7),
        ("run.samples_per_slot", 8),
        ("radio.edge_rule", "endpoints"),
        ("radio.shadow_fading", True),
        ("radio.fading_seed", 3),
        ("radio.threshold_db", 16.0),
    ),
}


@pytest.mark.parametrize("options", GOOD.values(), ids=GOOD.keys())
def test_good_log_has_no_finding(options):
    """What the twin writes of a plan that keeps the rules is valid, whatever the options."""
    report = validate(log_of(options))
    assert report.findings == ()
    assert report.valid
    assert report.skipped == ()
    assert all(report.checked[step] > 0 for step in (1, 2, 3, 4))


def test_outages_are_told_truly():
    """Outages that `endpoints` allows are incidents, not findings: both sides measure the same."""
    log = log_of(world=POST_WORLD)
    outages = [r for r in records(log) if isinstance(r, Incident) and r.kind == "outage"]
    assert outages
    assert validate(log).findings == ()


def test_outage_left_out_is_found(tmp_path):
    """An outage of which the log does not tell is found."""
    forged = forge(
        log_of(world=POST_WORLD),
        tmp_path / "f.mcap",
        record=lambda r: None if isinstance(r, Incident) else r,
    )
    assert "page5:incident" in rules(validate(forged), 3)


def test_a_forged_log_without_a_change_is_good(tmp_path):
    """The forger itself plants nothing."""
    assert validate(forge(log_of(), tmp_path / "same.mcap")).findings == ()


def test_plan_that_breaks_rules_is_found_but_told_truly():
    """A plan with collisions breaks §1.2 or §1.3 in steps 2 and 3; twin and validator agree on it.

    Collisions, contacts, clearances, overloads, verdict and key figures are computed by both on
    their own; the log tells them all, so none of them is a finding.
    """
    options = (("radio.ap_capacity", 1), ("run.interruption", 900.0))
    log = log_of(options, heedless_plan)
    told = {r.kind for r in records(log) if isinstance(r, Incident)}
    assert {"collision", "contact", "overload"} <= told
    report = validate(log)
    assert rules(report, 2) <= {"§1.2", "§1.3", "§1.6"}
    assert rules(report, 3) <= {"§1.2", "§1.3", "§1.6", "page5:bodies"}
    assert {"§1.2", "§1.6"} & rules(report, 2)
    assert {"§1.6", "page5:bodies"} <= rules(report, 3)
    assert rules(report, 1) == rules(report, 4) == set()


@pytest.mark.parametrize("make_plan", [partial_plan, empty_plan])
def test_partial_plan_is_valid_but_the_run_failed(make_plan):
    """A robot without a path stays off the floor, and the run's verdict is "failed" (§1.12)."""
    log = log_of((), make_plan)
    (end,) = (r for r in records(log) if isinstance(r, RunEnd))
    assert end.verdict == "failed"
    assert validate(log).findings == ()


def test_unreadable_files_are_refused(tmp_path):
    """No file, a folder, an empty file and a text are refused with one sentence each."""
    empty, text = tmp_path / "empty.mcap", tmp_path / "text.mcap"
    empty.touch()
    text.write_text("not a log\n" * 100)
    for path in (tmp_path / "none.mcap", tmp_path, empty, text):
        with pytest.raises(LogError, match=str(path)):
            validate(path)


def test_foreign_mcap_file_is_found(tmp_path):
    """An MCAP file of something else is readable, but lacks all that makes a log of a run."""
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="other")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/chatter", "cdr", schema)
        writer.add_message(channel, 1, b"\x00\x01\x00\x00", 2)
        writer.finish()
    report = validate(path)
    assert {"container:attachment", "container:metadata", "container:schema"} <= rules(report)
    assert "reader" not in rules(report)


def test_report_is_data(tmp_path):
    """Findings come as JSON and as JUnit XML; of a rule with many, the first ones and a number."""

    def all_worse(record: Record) -> Record:
        if not isinstance(record, Sample):
            return record
        return replace(record, snr_db=tuple(s - 0.5 for s in record.snr_db))

    report = validate(forge(log_of(), tmp_path / "f.mcap", record=all_worse))
    snr = [f for f in report.findings if f.rule == "page5:snr"]
    assert len(snr) == KEPT + 1
    assert "more findings" in snr[-1].found

    plain = json.loads(json.dumps(report.to_dict()))
    assert plain["valid"] is False
    assert len(plain["findings"]) == len(report.findings)
    assert {s["step"]: s["checked"] for s in plain["steps"]} == report.checked

    root = ElementTree.fromstring(report.to_junit_xml())
    suites = {suite.get("name"): suite for suite in root}
    assert len(suites) == 4
    assert suites["1 container"].get("failures") == "0"
    failed = {case.get("name") for case in root.iter("testcase") if len(case)}
    assert failed == rules(report)


def test_good_report_has_no_failures():
    """The JUnit report of a good log has test cases and no failure."""
    root = ElementTree.fromstring(validate(log_of()).to_junit_xml())
    assert sum(int(suite.get("tests")) for suite in root) > 20
    assert sum(int(suite.get("failures")) for suite in root) == 0
