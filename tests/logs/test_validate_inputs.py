"""Validation of what a run is made from: inputs that do not belong together are found."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from logs.findings import Checks
from logs.mcap_format import PLAN_NAME, RADIO_MAP_NAME, RUN_METADATA, WORLD_NAME
from logs.validate import _check_run, validate
from logs.validate_inputs import Inputs, read_inputs
from tests.logs.good_logs import log_of
from tests.logs.tamper import contents, edited, forge, rules
from worlds.floor import Boxes
from worlds.radio_map import RadioMap


def change_plan(data: bytes, **values: object) -> bytes:
    """plan.json with other values."""
    return json.dumps(json.loads(data) | values).encode()


def test_wrong_bound_is_found(tmp_path):
    """A lower bound above the plan's own cost is no bound (§1.13)."""
    cost = json.loads({a.name: a.data for a in contents(log_of()).attachments}[PLAN_NAME])["cost"]
    change = edited(
        PLAN_NAME,
        lambda d: change_plan(d, status="feasible", lower_bound=cost + 5.0, gap=-5 / (cost + 5)),
    )
    report = validate(forge(log_of(), tmp_path / "f.mcap", attachment=change))
    assert rules(report) == {"§1.13"}


def test_wrong_cost_is_found(tmp_path):
    """The cost is that of the paths (§1.9)."""

    def dearer(data: bytes) -> bytes:
        plan = json.loads(change_plan(data, cost=10_000, status="feasible"))
        del plan["gap"]
        return json.dumps(plan).encode()

    report = validate(forge(log_of(), tmp_path / "f.mcap", attachment=edited(PLAN_NAME, dearer)))
    assert rules(report) == {"§1.9"}


def test_another_plan_is_found(tmp_path):
    """A run of another plan than the one it carries does not follow it."""
    other = {a.name: a.data for a in contents(log_of((("plan.objective", "tp"),))).attachments}
    mine = {a.name: a.data for a in contents(log_of()).attachments}
    plan = json.loads(other[PLAN_NAME])
    paths = plan["paths"][:]
    paths[0] = {
        "robot": "anna",
        "vertices": [paths[0]["vertices"][0], *paths[0]["vertices"]],
        "aps": [paths[0]["aps"][0], *paths[0]["aps"]],
    }
    assert json.loads(mine[PLAN_NAME])["paths"] != paths
    cost = json.loads(mine[PLAN_NAME])["cost"] + 1
    change = edited(
        PLAN_NAME,
        lambda d: change_plan(
            d,
            paths=paths,
            cost=cost,
            status="unknown",
            lower_bound=None,
            gap=None,
            slots=sum(len(p["vertices"]) - 1 for p in paths),
        ),
    )
    report = validate(forge(log_of(), tmp_path / "f.mcap", attachment=change))
    assert "page5:plan" in rules(report, 3)
    assert {f.robot for f in report.findings if f.rule == "page5:plan"} >= {"anna"}


@pytest.mark.parametrize(
    ("before", "after", "rule"),
    [
        ("position_m = [1.0, 5.0, 3.5]", "position_m = [2.0, 5.0, 3.5]", "page5:coverage"),
        ("[radio]", "[radio]\nthreshold_db = 9.0", "page6:radio-map"),
        ("horizon = 20", "horizon = 21", "page6:problem"),
        ('name = "tiny"', 'name = "huge"', "page6:inputs"),
    ],
)
def test_edited_world_is_found(tmp_path, before, after, rule):
    """World, radio map and problem must belong together."""
    attached = {a.name: a.data for a in contents(log_of()).attachments}[WORLD_NAME].decode()
    assert before in attached
    change = edited(WORLD_NAME, lambda data: data.decode().replace(before, after).encode())
    report = validate(forge(log_of(), tmp_path / "f.mcap", attachment=change))
    assert rule in rules(report)
    assert "reader" not in rules(report)


def test_edited_radio_map_is_found(tmp_path):
    """A map that is better than what rays cast anew give is found in the place where it is."""

    def better(data: bytes) -> bytes:
        radio_map = RadioMap.from_bytes(data)
        snr = radio_map.snr_db.copy()
        snr[4, 0] += 1.0
        return replace(radio_map, snr_db=snr).to_bytes()

    report = validate(
        forge(log_of(), tmp_path / "f.mcap", attachment=edited(RADIO_MAP_NAME, better))
    )
    (finding,) = (f for f in report.findings if f.rule == "page5:coverage")
    assert "[4, 0]" in finding.found


@pytest.mark.parametrize("name", [WORLD_NAME, RADIO_MAP_NAME, PLAN_NAME, "layout.json"])
def test_missing_attachment_is_found(tmp_path, name):
    """A log is complete on its own."""
    change = edited(name, lambda data: None)
    report = validate(forge(log_of(), tmp_path / "f.mcap", attachment=change))
    assert "container:attachment" in rules(report, 1)
    assert "reader" not in rules(report)


@pytest.mark.parametrize("name", [WORLD_NAME, RADIO_MAP_NAME, "problem.json", PLAN_NAME])
@pytest.mark.parametrize("data", [b"", b"\xff\x00nonsense", b"[" * 5000])
def test_nonsense_attachment_is_found(tmp_path, name, data):
    """What cannot be parsed is a finding."""
    change = edited(name, lambda old: data)
    report = validate(forge(log_of(), tmp_path / "f.mcap", attachment=change))
    assert rules(report, 1) & {"container:attachment", "reader"}


def test_missing_metadata_is_found(tmp_path):
    """The run's metadata are there."""
    report = validate(
        forge(
            log_of(),
            tmp_path / "f.mcap",
            metadata=lambda name, values: None if name == RUN_METADATA else values,
        )
    )
    assert "container:metadata" in rules(report)


def changed_run(change: Callable[[Inputs], Inputs]) -> set[str]:
    """The rules that steps 3 and 4 find broken once the good log's inputs are others."""
    checks = Checks()
    log = contents(log_of())
    inputs = read_inputs(log, checks)
    assert inputs is not None
    _check_run(log, change(inputs), checks, lambda share: None)
    return {finding.rule for finding in checks.findings()}


def test_body_in_an_obstacle_is_found():
    """No body touches an obstacle (page 5): here one is put where anna passes."""

    def blocked(inputs: Inputs) -> Inputs:
        place = inputs.problem.xy_m[inputs.plan.paths[0].vertices[2]]
        boxes = Boxes(
            ("new rack",), np.array([[*place, 0.1]]), np.array([[0.2, 0.2, 0.1]]), np.zeros(1)
        )
        return replace(inputs, floor=replace(inputs.floor, boxes=boxes))

    assert {"page5:obstacle", "page5:incident", "page5:verdict"} <= changed_run(blocked)


def test_crossing_without_coverage_is_found():
    """An edge is crossed with an AP that covers it, or with an allowed handover (§1.7)."""

    def uncovered(inputs: Inputs) -> Inputs:
        problem = inputs.problem
        none = np.zeros_like(problem.edge_cover)
        return replace(inputs, problem=replace(problem, edge_cover=none))

    def forbidden(inputs: Inputs) -> Inputs:
        problem = inputs.problem
        none = np.zeros_like(problem.edge_handover)
        return replace(inputs, problem=replace(problem, edge_handover=none))

    assert changed_run(uncovered) == {"§1.7"}
    assert changed_run(forbidden) == {"§1.7"}


def test_vertex_without_coverage_is_found():
    """At a vertex the serving AP covers it (§1.6)."""

    def uncovered(inputs: Inputs) -> Inputs:
        problem, path = inputs.problem, inputs.plan.paths[0]
        cover = problem.cover.copy()
        cover[path.vertices[1]] = np.arange(problem.n_aps) != path.aps[1]
        none = {name: np.zeros_like(getattr(problem, name)) for name in EDGES}
        return replace(inputs, problem=replace(problem, cover=cover, **none))

    assert changed_run(uncovered) == {"§1.6", "§1.7"}


EDGES = ("edge_cover", "edge_handover")
