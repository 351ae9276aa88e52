"""Validation of handovers: which ones are due, and when, follows from the world (design page 5).

The defects are those of a twin, not of single records: it executes a policy other than the one the
world declares, so each log is in itself as consistent as any.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import twin.association
from logs.records import Handover
from logs.validate import validate
from tests.logs.good_logs import log_of, write_log
from tests.logs.tamper import records
from tests.logs.test_validate_disturbed import FORK_LIFT, HALL, MANY, OUTAGE
from tests.twin.halls import of_type
from twin.network import Network

LANES = """
name = "lanes"
[hall]
size_m = [40.0, 6.0]
slot_s = 1.0
[hall.graph]
speed_m_s = 1.0
[[hall.graph.node]]
id = "a"
at_m = [2.0, 3.0]
[[hall.graph.node]]
id = "b"
at_m = [37.0, 3.0]
[[hall.graph.edge]]
id = "there"
start = "a"
end = "b"
[[ap]]
id = "west"
position_m = [2.0, 3.0, 3.0]
[[ap]]
id = "east"
position_m = [37.0, 3.0, 3.0]
[radio]
tx_power_dbm = 4.0
[[robot]]
id = "r0"
start = {node = "a"}
goal = {node = "b"}
[plan]
horizon = 60
"""
"""One lane of 35 slots, whose middle both APs reach and whose ends only one of them."""


def handovers_found(path: Path) -> list[str]:
    """What is found of handovers, as "found; expected"."""
    report = validate(path)
    assert not [f for f in report.findings if f.rule == "reader"]
    return [f"{f.found}; {f.expected}" for f in report.findings if f.rule == "page5:handover"]


def test_shadow_fading_is_that_of_the_ap_that_is_heard():
    """A robot hears each AP with the fading between it and that AP."""
    world = OUTAGE.replace("[radio]", "[radio]\nshadow_fading = true\nfading_seed = 2")
    path = log_of(world=world)
    assert [h for h in of_type(records(path), Handover) if not h.planned]
    assert handovers_found(path) == []


def test_a_handover_before_the_time_to_trigger_is_found(tmp_path, monkeypatch):
    """The reason must have lasted for `time_to_trigger_s` at every instant."""
    world = OUTAGE.replace("time_to_trigger_s = 0.5", "time_to_trigger_s = 1.0")
    assert handovers_found(write_log(tmp_path / "good.mcap", world)) == []
    made = Network.__init__

    def hasty(self, *args):
        made(self, *args)
        self._wait_ns //= 2

    monkeypatch.setattr(Network, "__init__", hasty)
    found = handovers_found(write_log(tmp_path / "bad.mcap", world))
    assert any("an unplanned handover from none to east; no handover" in text for text in found)


def test_a_handover_after_the_time_to_trigger_is_found(tmp_path, monkeypatch):
    """Nor is it put off once the reason has lasted long enough."""
    made = Network.__init__

    def slow(self, *args):
        made(self, *args)
        self._wait_ns *= 2

    monkeypatch.setattr(Network, "__init__", slow)
    found = handovers_found(write_log(tmp_path / "bad.mcap", OUTAGE))
    assert any("no handover; an unplanned handover from none to east" in text for text in found)


def test_a_handover_to_an_ap_that_is_not_the_loudest_is_found(tmp_path, monkeypatch):
    """Of those that are good enough the AP of the highest SNR is taken."""
    third = '[[ap]]\nid = "far"\nposition_m = [12.0, 11.5, 4.0]\n\n[radio]'
    world = OUTAGE.replace("[radio]", third)
    assert handovers_found(write_log(tmp_path / "good.mcap", world)) == []
    choose = Network._choice

    def quietest(self, planned, serving, snr, heard):
        best = choose(self, planned, serving, snr, heard)
        if best < 0 or best == planned:
            return best
        enough = np.flatnonzero(heard >= max(self._prediction.threshold_db, snr + 3.0))
        return int(enough[heard[enough].argmin()])

    monkeypatch.setattr(Network, "_choice", quietest)
    assert handovers_found(write_log(tmp_path / "bad.mcap", world))


@pytest.mark.parametrize("world", [OUTAGE, MANY], ids=["outages", "all of it"])
def test_a_handover_within_the_hysteresis_is_found(world, tmp_path, monkeypatch):
    """From an AP that is good, back to the path's only if that is better by the hysteresis."""
    world = world.replace("[run]", "[run]\nhysteresis_db = 25.0")
    assert handovers_found(write_log(tmp_path / "good.mcap", world)) == []
    choose = Network._choice

    def fickle(self, planned, serving, snr, heard):
        self._run = self._run.model_copy(update={"hysteresis_db": 0.0})
        return choose(self, planned, serving, snr, heard)

    monkeypatch.setattr(Network, "_choice", fickle)
    found = handovers_found(write_log(tmp_path / "bad.mcap", world))
    assert any("an unplanned handover" in text and text.endswith("no handover") for text in found)


def test_a_handover_the_hysteresis_does_not_forbid_is_missed(tmp_path, monkeypatch):
    """Who is shaded changes to an AP that is better by the hysteresis."""
    world = FORK_LIFT.replace("position_m = [22.0, 6.0, 4.0]", "position_m = [22.0, 6.0, 1.2]")
    world = world.replace("position_m = [2.0, 6.0, 4.0]", "position_m = [2.0, 6.0, 1.2]")
    world = world.replace("[run]", "[run]\nhysteresis_db = 0.5")
    good = write_log(tmp_path / "good.mcap", world)
    assert [h for h in of_type(records(good), Handover) if not h.planned]
    assert handovers_found(good) == []
    monkeypatch.setattr(Network, "_choice", lambda *_: -1)
    found = handovers_found(write_log(tmp_path / "bad.mcap", world))
    assert any(text.startswith("at instant") and "; an unplanned" in text for text in found)


@pytest.mark.parametrize("world", [HALL, LANES], ids=["grid", "lane of 35 slots"])
def test_a_planned_handover_at_another_instant_is_found(world, tmp_path, monkeypatch):
    """It is made at the instant that the radio map gives for it, not at an earlier or later one."""
    good = write_log(tmp_path / "good.mcap", world)
    assert of_type(records(good), Handover)
    assert validate(good).findings == ()
    rightly = twin.association.handover_instants

    def later(below_a, below_b, steps):
        instants = rightly(below_a, below_b, steps)
        return np.where(instants < below_a.shape[1] - 1, instants + 1, instants - 1)

    monkeypatch.setattr(twin.association, "handover_instants", later)
    found = handovers_found(write_log(tmp_path / "bad.mcap", world))
    assert any("a planned handover" in text and text.endswith("; no handover") for text in found)
    assert any("no handover; a planned handover" in text for text in found)
