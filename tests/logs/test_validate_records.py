"""Validation of runs: each defect planted in a record is found and named by its rule."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

from logs.mcap_format import WORLD_NAME
from logs.records import (
    ARRIVED,
    LINKS,
    ApKpi,
    ApLoad,
    Arrival,
    Handover,
    Incident,
    Kpi,
    Record,
    RobotKpi,
    RobotState,
    RunEnd,
    RunStart,
    Sample,
    Separation,
)
from logs.validate import validate
from tests.logs.good_logs import log_of
from tests.logs.tamper import forge, records, rules

Edit = Callable[[Record], object]


def edit(kind: type[Record], change: Callable[..., object], **where: object) -> Edit:
    """Changes the records of a kind whose fields have these values."""

    def apply(record: Record) -> object:
        fits = isinstance(record, kind) and all(getattr(record, k) == v for k, v in where.items())
        return change(record) if fits else record

    return apply


def column(name: str, k: int, value: object) -> Callable[[Sample], Sample]:
    """Changes entry k of a sample's column; a function is given the old value."""

    def change(sample: Sample) -> Sample:
        values = list(getattr(sample, name))
        values[k] = value(values[k]) if callable(value) else value
        return replace(sample, **{name: tuple(values)})

    return change


def without(_record: Record) -> None:
    """Leaves the record out."""


def twice(record: Record) -> list[Record]:
    """Puts the record there two times."""
    return [record, record]


def handed_over(sample: Sample) -> list[Record]:
    """Puts a handover of robot 0 from east to west before a sample."""
    t_s, x, y = sample.t_s, sample.x_m[0], sample.y_m[0]
    return [Handover(t_s, 3, "anna", "east", "west", 3, 4, x, y, t_s + 0.07, True), sample]


def next_to(sample: Sample) -> Sample:
    """Puts robot 1 in the place of robot 0."""
    x, y = list(sample.x_m), list(sample.y_m)
    x[1], y[1] = x[0], y[0]
    return replace(sample, x_m=tuple(x), y_m=tuple(y))


AT = 6.5  # slot 3, second sample: everybody is on the floor and under way
ANNA = {"robot": "anna"}

DEFECTS: dict[str, tuple[Edit, str, int]] = {
    "teleport": (edit(Sample, column("x_m", 0, lambda x: x + 1.5), t_s=AT), "page5:pose", 3),
    "a millimetre off": (
        edit(Sample, column("y_m", 2, lambda y: y + 1e-3), t_s=AT),
        "page5:pose",
        3,
    ),
    "one robot in another": (edit(Sample, next_to, t_s=AT), "page5:pose", 3),
    "drives sideways": (
        edit(Sample, column("heading_rad", 0, lambda h: h + 1.6), t_s=AT),
        "page5:pose",
        3,
    ),
    "a sample left out": (edit(Sample, without, t_s=AT), "page5:sample", 3),
    "a robot left out of a sample": (
        edit(
            Sample,
            lambda s: replace(s, **{n: getattr(s, n)[1:] for n in s.__slots__ if n != "slot"}),
            t_s=AT,
        ),
        "page5:sample",
        3,
    ),
    "a robot twice in a sample": (edit(Sample, column("robot", 1, 0), t_s=AT), "page6:record", 3),
    "columns of unequal length": (
        edit(Sample, lambda s: replace(s, snr_db=s.snr_db[:-1]), t_s=AT),
        "page6:record",
        3,
    ),
    "an index that is none": (edit(Sample, column("ap", 0, 99), t_s=AT), "page6:record", 3),
    "not a number": (edit(Sample, column("snr_db", 0, float("nan")), t_s=AT), "page6:record", 3),
    "a state left out": (edit(RobotState, without, slot=3, **ANNA), "page5:state", 3),
    "a state twice": (edit(RobotState, twice, slot=3, **ANNA), "page5:state", 3),
    "at another vertex": (
        edit(RobotState, lambda s: replace(s, vertex=s.vertex + 1), slot=3, **ANNA),
        "§1.1",
        3,
    ),
    "at no vertex": (
        edit(RobotState, lambda s: replace(s, vertex=10_000), slot=3, **ANNA),
        "§1.1",
        3,
    ),
    "another activity": (
        edit(RobotState, lambda s: replace(s, activity=ARRIVED), slot=3, **ANNA),
        "page5:plan",
        3,
    ),
    "waits for somebody": (
        edit(RobotState, lambda s: replace(s, waits_for="bert"), slot=3, **ANNA),
        "page5:plan",
        3,
    ),
    "still there after leaving": (
        edit(RobotState, lambda s: replace(s, activity="waiting"), activity="gone", robot="cleo"),
        "§1.4",
        3,
    ),
    "a handover left out": (edit(Handover, without, robot="dora"), "page5:handover", 3),
    "a handover invented": (edit(Sample, handed_over, t_s=AT), "page5:handover", 3),
    "a handover to nowhere": (
        edit(Handover, lambda h: replace(h, to_ap=h.from_ap), robot="dora"),
        "page5:handover",
        3,
    ),
    "a handover elsewhere": (
        edit(Handover, lambda h: replace(h, x_m=h.x_m + 0.1), robot="dora"),
        "page5:handover",
        3,
    ),
    "an unplanned handover": (
        edit(Handover, lambda h: replace(h, planned=False), robot="dora"),
        "page5:handover",
        3,
    ),
    "a longer interruption": (
        edit(Handover, lambda h: replace(h, end_s=h.end_s + 0.1), robot="dora"),
        "page5:handover",
        3,
    ),
    "another AP in a sample": (
        edit(Sample, column("ap", 0, lambda a: 1 - a), t_s=AT),
        "page5:handover",
        3,
    ),
    "no AP in a sample": (edit(Sample, column("ap", 0, -1), t_s=AT), "§1.6", 3),
    "3 dB better": (edit(Sample, column("snr_db", 0, lambda s: s + 3.0), t_s=AT), "page5:snr", 3),
    "2 µdB better": (edit(Sample, column("snr_db", 3, lambda s: s + 2e-6), t_s=AT), "page5:snr", 3),
    "another prediction": (
        edit(Sample, column("map_snr_db", 0, lambda s: s - 1.0), t_s=AT),
        "page5:snr",
        3,
    ),
    "another link": (
        edit(Sample, column("link", 0, LINKS.index("outage")), t_s=AT),
        "page5:link",
        3,
    ),
    "another rate": (
        edit(Sample, column("rate_mbps", 0, lambda r: r + 1.0), t_s=AT),
        "page5:rate",
        3,
    ),
    "another load": (
        edit(ApLoad, lambda r: replace(r, load=r.load + 1), slot=3, ap="east"),
        "page5:load",
        3,
    ),
    "another capacity": (
        edit(ApLoad, lambda r: replace(r, capacity=9), slot=3, ap="east"),
        "page5:load",
        3,
    ),
    "a load left out": (edit(ApLoad, without, slot=3, ap="east"), "page5:load", 3),
    "a later arrival": (edit(Arrival, without, **ANNA), "page5:arrival", 3),
    "arrived elsewhere": (
        edit(Arrival, lambda r: replace(r, vertex=0), **ANNA),
        "page5:arrival",
        3,
    ),
    "another clearance": (
        edit(Separation, lambda s: replace(s, clearance_m=s.clearance_m + 0.01), slot=3),
        "page5:separation",
        3,
    ),
    "clearance of others": (
        edit(
            Separation,
            lambda s: replace(s, robot_a="anna", robot_b="bert"),
            slot=0,
        ),
        "page5:separation",
        3,
    ),
    "a clearance left out": (edit(Separation, without, slot=3), "page5:separation", 3),
    "an incident invented": (
        edit(
            RunEnd,
            lambda e: [Incident(e.t_s, e.slot, "contact", "anna", "bert", "", -0.1, "ouch"), e],
        ),
        "page5:incident",
        3,
    ),
    "another verdict": (
        edit(RunEnd, lambda e: replace(e, verdict="failed", message="no")),
        "page5:verdict",
        3,
    ),
    "no end": (edit(RunEnd, without), "page6:order", 3),
    "two beginnings": (edit(RunStart, twice), "page6:order", 3),
    "another threshold told": (
        edit(RunStart, lambda s: replace(s, threshold_db=3.0)),
        "page5:start",
        3,
    ),
    "another KPI": (
        edit(Kpi, lambda k: replace(k, delivered_mbit=k.delivered_mbit + 1.0), slot=7),
        "page5:kpi",
        4,
    ),
    "one handover less": (
        edit(RobotKpi, lambda k: replace(k, handovers=0), robot="dora"),
        "page5:kpi",
        4,
    ),
    "an AP's KPI": (edit(ApKpi, lambda k: replace(k, peak_load=9), ap="west"), "page5:kpi", 4),
    "a KPI left out": (edit(Kpi, without, slot=7), "page5:kpi", 4),
    "a robot's KPI left out": (edit(RobotKpi, without, **ANNA), "page5:kpi", 4),
}


@pytest.mark.parametrize(("change", "rule", "step"), DEFECTS.values(), ids=DEFECTS.keys())
def test_defect_in_a_record_is_found(tmp_path, change, rule, step):
    """A record changed, left out or doubled is found in the step that looks for it, by its rule."""
    report = validate(forge(log_of(), tmp_path / "forged.mcap", record=change))
    assert rule in rules(report, step), report.findings
    assert not rules(report, 1)
    assert "reader" not in rules(report)


def test_swap_is_found(tmp_path):
    """Two robots that pass through each other on an edge break §1.3."""
    log = log_of()
    states = [s for s in records(log) if isinstance(s, RobotState) and s.slot == 3]
    anna, bert = states[0], states[1]
    as_anna = replace(
        bert,
        vertex=anna.next_vertex,
        next_vertex=anna.vertex,
        edge=anna.edge,
        activity=anna.activity,
    )
    forged = forge(log, tmp_path / "f.mcap", record=lambda r: as_anna if r == bert else r)
    report = validate(forged)
    (finding,) = (f for f in report.findings if f.rule == "§1.3")
    assert finding.robot == "anna, bert"
    assert finding.slot == 3


def test_overload_is_found(tmp_path):
    """More robots on an AP than it has places break §1.6, whatever the log says of it."""

    def smaller(name: str, data: bytes) -> bytes:
        if name == WORLD_NAME:
            assert b"capacity = 3" in data
            return data.replace(b"capacity = 3", b"capacity = 1")
        if name == "problem.json":
            return json.dumps(json.loads(data) | {"ap_capacity": [1, 4]}).encode()
        return data

    report = validate(forge(log_of(), tmp_path / "f.mcap", attachment=smaller))
    assert "§1.6" in rules(report, 2)
    assert "§1.6" in rules(report, 3)


def test_picture_that_is_not_the_run_is_found(tmp_path):
    """Where /tf shows a robot is where the sample of that instant has it."""
    log = log_of()
    moved: list[int] = []

    def shifted(topic: str, data: bytes) -> bytes:
        if topic != "/tf":
            return data
        moved.append(0)
        if len(moved) != 20:
            return data
        transforms = FrameTransforms.FromString(data)
        transforms.transforms[-1].translation.x += 0.5
        return transforms.SerializeToString()

    report = validate(forge(log, tmp_path / "f.mcap", message=shifted))
    (finding,) = report.findings
    assert finding.rule == "page6:tf"
    assert finding.robot == "dora"
