"""Step 3 of validation: the run against plan and world, record by record.

Every record goes through here in the order of the file. Those that make sense are handed to the
checks of states, poses, radio and incidents, which all learn of a new slot at the same time.
"""

from __future__ import annotations

import math
from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np

from logs.findings import Checks
from logs.mcap_format import time_ns
from logs.records import (
    ARRIVED,
    GONE,
    HELD,
    LINKS,
    MOVING,
    RECORD_TYPES,
    WAITING,
    ApLoad,
    Arrival,
    Blockages,
    Disturbance,
    Handover,
    Incident,
    NewPath,
    Record,
    Replan,
    RobotState,
    RunEnd,
    RunStart,
    Sample,
    Separation,
)
from logs.validate_commit import CommitCheck
from logs.validate_context import STEP, Context, SlotView
from logs.validate_disturbances import DisturbanceCheck, Truth
from logs.validate_incidents import IncidentCheck
from logs.validate_poses import PoseCheck
from logs.validate_radio import RadioCheck
from logs.validate_replans import ReplanCheck
from logs.validate_serving import PlannedServing
from logs.validate_states import StateCheck
from worlds.events import longest_run_slots

if TYPE_CHECKING:
    from worlds.radio_map import RadioMap
    from worlds.scene import Scene

_RECORD, _ORDER = "page6:record", "page6:order"
KEPT_PLACES = 5
"""Entries of an array that are listed one by one."""


def _fields_of(kind: type[Record]) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
    """Fields of a record type that are numbers, columns of numbers, and names."""
    types = {field.name: str(field.type) for field in fields(kind)}
    return (
        tuple(name for name, form in types.items() if form == "float"),
        tuple(name for name, form in types.items() if form.startswith("tuple[float")),
        tuple(name for name, form in types.items() if name in {"robot", "ap"} and form == "str"),
    )


_FIELDS = {kind: _fields_of(kind) for kind in RECORD_TYPES}
_COLUMNS = tuple(f.name for f in fields(Sample) if str(f.type).startswith("tuple"))
_ACTIVITIES = frozenset({MOVING, WAITING, HELD, ARRIVED, GONE})


class RunCheck:
    """Takes the records of a run, and says in the end what is not as it should be."""

    def __init__(self, context: Context, scene: Scene) -> None:
        self._context = context
        truth = Truth(context)
        self._incidents = IncidentCheck(context)
        self._disturbances = DisturbanceCheck(context, truth)
        self._commits = CommitCheck(context, truth, self._disturbances)
        self._serving = serving = PlannedServing(context)
        self._states = StateCheck(context, self._incidents, truth, self._commits, serving)
        self._replans = ReplanCheck(context, self._incidents, truth, self._states, self._commits)
        self._poses = PoseCheck(context, self._incidents, self._disturbances)
        self._radio = RadioCheck(
            context, self._incidents, scene, truth, self._disturbances, serving
        )
        self._view: SlotView | None = None
        self._next = (0, 0)  # slot and step of the next sample
        self._started = False
        self._records = 0
        self._end: RunEnd | None = None
        self._last_s = 0.0
        check_radio_map(context, scene)

    def add(self, record: Record) -> bool:
        """The next record; False if it makes no sense (and is found) and must not be used."""
        self._records += 1
        fault = self._fault(record)
        if fault:
            name = type(record).__name__
            self._find(_RECORD, f"{name} with {fault}", "a record that makes sense")
            return False
        self._check_order(record)
        match record:
            case RunStart():
                self._check_start(record)
            case Disturbance():
                self._commit_to_beginning(record)
                self._disturbances.add(record)
            case Blockages():
                self._commit_until(record.slot)
                self._disturbances.add_blockages(record)
            case Replan():
                self._commit_to_beginning(record)
                self._replans.add(record)
            case NewPath():
                self._commit_to_beginning(record)
                self._replans.add_path(record)
                i = self._context.robot[record.robot]
                self._serving.begin(i, self._radio.serving(i))
            case RobotState():
                self._go_on(record)
                self._radio.add_state(record)
                self._states.add_state(record)
            case Sample():
                self._add_sample(record)
            case Handover():
                self._radio.add_handover(record, self._view)
            case ApLoad():
                self._go_on(record)
                self._states.add_load(record)
            case Arrival():
                self._go_on(record)
                self._states.add_arrival(record)
            case Separation():
                self._poses.add_separation(record)
            case Incident():
                self._incidents.add(record)
            case RunEnd():
                self._end = record
            case _:
                pass
        self._last_s = record.t_s
        return True

    def finish(self) -> None:
        """No more records."""
        context, last = self._context, self._context.last
        self._commit_until(last + 1)
        for slot, step in [self._next] if self._next != (last + 1, 1) else []:
            self._find("page5:sample", f"no sample of slot {slot}, instant {step}", "one", slot)
        self._disturbances.finish(last)
        self._replans.finish()
        self._poses.finish()
        self._radio.finish(self._last_s)
        self._incidents.finish(self._end)
        for rule in (_RECORD, _ORDER):
            context.checks.count(STEP, rule, self._records)
        if self._end is None:
            self._find(_ORDER, "no RunEnd", "RunEnd as the last record")
        else:
            self._check_end(self._end)

    def _check_end(self, end: RunEnd) -> None:
        """The run ends when everybody is home, or when no further arrival is to be expected."""
        context, last = self._context, self._context.last
        if not context.disturbed:
            context.checks.same(
                STEP, "page5:plan", "last slot", end.slot, context.planned_last, slot=end.slot
            )
        if time_ns(end.t_s) != context.t_ns(last + 1):
            expected = f"the end of slot {last}"
            self._find("page5:plan", f"the run ends at {end.t_s} s", expected, end.slot)
        limit = longest_run_slots(context.inputs.world)
        context.checks.count(STEP, "page5:end")
        if last >= limit:
            found = f"the run lasts {last + 1} slots"
            self._find("page5:end", found, f"at most {limit}", end.slot)
        view = self._states.last_view
        if view is None or last + 1 >= limit:
            return
        if not view.arrived.all() and view.advances.any():
            away = [context.name(int(i)) for i in view.robot[~view.arrived]]
            found = f"the run ends while {', '.join(away[:5])} are under way"
            self._find("page5:end", found, "an end when nobody is, or can move", end.slot)

    def _find(self, rule: str, found: object, expected: object, slot: int | None = None) -> None:
        self._context.checks.find(STEP, rule, found, expected, slot=slot)

    # --- sense and order ----------------------------------------------------------------------

    def _fault(self, record: Record) -> str:
        """What in a record makes no sense, "" if nothing."""
        context, kind = self._context, type(record)
        numbers, columns, names = _FIELDS[kind]
        for field in numbers:
            if not math.isfinite(getattr(record, field)):
                return f"{field} that is not a finite number"
        for field in columns:
            if not all(map(math.isfinite, getattr(record, field))):
                return f"{field} that is not a finite number"
        for field in names:
            value = getattr(record, field)
            if value not in (context.robot if field == "robot" else context.ap):
                optional = kind in {Incident, Disturbance}
                optional |= kind is RobotState and field == "ap"
                if value or not optional:
                    return f"{field} {value!r}, which does not take part"
        last = context.last
        if not 0 <= getattr(record, "slot", 0) <= last + 1:
            slot = getattr(record, "slot", 0)
            return f"slot {slot} at {record.t_s} s, where the run ends in slot {last}"
        if isinstance(record, RobotState):
            if record.link not in LINKS or record.activity not in _ACTIVITIES:
                return f"link {record.link!r}, activity {record.activity!r}"
            return ""
        return self._sample_fault(record) if isinstance(record, Sample) else ""

    def _sample_fault(self, sample: Sample) -> str:
        lengths = {len(getattr(sample, name)) for name in _COLUMNS}
        if len(lengths) > 1:
            return "columns of different lengths"
        for name, low, high in (
            ("robot", 0, len(self._context.start.robots)),
            ("ap", -1, len(self._context.start.aps)),
            ("link", 0, len(LINKS)),
        ):
            column = np.array(getattr(sample, name), np.int64)
            if ((column < low) | (column >= high)).any():
                return f"{name} outside of {low} … {high - 1}"
            if name == "robot" and (np.diff(column) <= 0).any():
                return "robots that are doubled or not in ascending order"
        return ""

    def _check_order(self, record: Record) -> None:
        """RunStart is the first record, RunEnd the last, each once."""
        name = type(record).__name__
        if isinstance(record, RunStart) == self._started:
            self._find(_ORDER, f"{name} at {record.t_s} s", "RunStart once, as the first record")
        if self._end is not None:
            self._find(_ORDER, f"{name} behind RunEnd", "RunEnd once, as the last record")
        self._started = True

    def _check_start(self, start: RunStart) -> None:
        expected = self._context.start
        for field in fields(start):
            self._context.checks.same(
                STEP,
                "page5:start",
                field.name,
                getattr(start, field.name),
                getattr(expected, field.name),
            )

    # --- time -----------------------------------------------------------------------------------

    def _go_on(self, record: RobotState | ApLoad | Arrival) -> None:
        """A record of a slot's beginning: all slots before have been told of."""
        if time_ns(record.t_s) == self._context.t_ns(record.slot):
            self._commit_until(record.slot - 1)

    def _commit_to_beginning(self, record: Disturbance | Replan | NewPath) -> None:
        """A record of a slot's beginning, or of an instant within one."""
        at_begin = time_ns(record.t_s) == self._context.t_ns(record.slot)
        self._commit_until(record.slot - 1 if at_begin else record.slot)

    def _commit_until(self, slot: int) -> None:
        while self._states.slot <= slot:
            if self._view is not None:  # by the paths that were in force in its slot
                self._poses.close(self._view)
                self._radio.close(self._view, self._states.deviates)
            self._begin(self._states.slot)
            self._view = self._states.commit()

    def _begin(self, slot: int) -> None:
        """All that comes before the states of a slot has been told."""
        self._commits.begin_slot()
        if slot <= self._context.last:
            self._disturbances.begin_slot(slot, self._states.busy())
            self._replans.begin_slot(slot)

    def _add_sample(self, sample: Sample) -> None:
        context, slot = self._context, sample.slot
        part = context.start.slot_s / context.steps
        step = round((sample.t_s - slot * context.start.slot_s) / part)
        context.checks.count(STEP, "page5:sample")
        on_time = 0 <= step < context.steps and time_ns(sample.t_s) == context.t_ns(slot, step)
        if (slot, step) != self._next or not on_time:
            self._find(
                "page5:sample",
                f"a sample of slot {slot} at {sample.t_s} s",
                f"slot {self._next[0]}, instant {self._next[1]} of {context.steps}",
                slot,
            )
        if not on_time:
            return
        self._next = (slot, step + 1) if step + 1 < context.steps else (slot + 1, 0)
        if slot == context.last + 1:
            self._next = (slot, step + 1)
        self._commit_until(slot)
        self._disturbances.at_sample(slot, sample.t_s)
        self._commits.add_sample(sample)
        if self._view is not None and self._view.slot == slot:
            self._poses.add_sample(sample, self._view, step)
            self._radio.add_sample(sample, self._view, step)


def check_radio_map(context: Context, scene: Scene) -> None:
    """The radio map is what rays cast anew in a fresh scene give."""
    from worlds.radio_map import build_radio_map

    told = context.inputs.radio_map
    anew = build_radio_map(context.inputs.world, context.inputs.floor, scene=scene)
    _compare_maps(context.checks, told, anew)


def _compare_maps(checks: Checks, told: RadioMap, anew: RadioMap) -> None:
    for name, tolerance in (
        ("snr_db", 1e-6),
        ("edge_snr_db", 1e-6),
        ("fading_db", 1e-6),
        ("los", 0.0),
    ):
        found = np.asarray(getattr(told, name), np.float64)
        expected = np.asarray(getattr(anew, name), np.float64)
        checks.count(STEP, "page5:coverage", expected.size)
        if found.shape != expected.shape:
            checks.find(STEP, "page5:coverage", f"{name} of shape {found.shape}", expected.shape)
            continue
        places = np.argwhere(~(np.abs(found - expected) <= tolerance))
        for place in places[:KEPT_PLACES]:
            at = tuple(place.tolist())
            checks.find(
                STEP,
                "page5:coverage",
                f"radio map: {name}{list(at)} = {found[at]}",
                f"{expected[at]} by rays cast anew",
            )
        if len(places) > KEPT_PLACES:
            more = f"{len(places) - KEPT_PLACES} more entries of {name} that differ"
            checks.find(STEP, "page5:coverage", more, "none")
