"""A run in words that a plant manager reads: what happened, and what it means."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from logs.kpi import NO_CLEARANCE_M
from logs.report_data import RunStory

if TYPE_CHECKING:
    from logs.mcap_reader import RunFile

EVENT_WORDS = {
    "collision": "collision",
    "contact": "bodies touched",
    "obstacle": "hit an obstacle",
    "outage": "connection lost",
    "overload": "access point overloaded",
    "unserved": "robot without a path",
    "caught": "robot touched by a blockage",
    "deadlock": "nobody can move",
    "delay": "robot delayed",
    "ap-outage": "access point fails",
    "ap-outage is over": "access point is back",
    "blockage": "way blocked",
    "blockage is over": "way free again",
    "robot-failure": "robot fails",
    "robot-failure is over": "robot works again",
    "replan": "new plan",
    "replan, not adopted": "new plan asked for, old one kept",
}
"""Incident kinds as headings; a kind that is not here is shown as it is."""


CAUSE_WORDS = {
    "failure": "it had failed",
    "delay": "it was late",
    "no-path": "it had no way on",
    "blockage": "its way was blocked",
    "connection": "no connection",
    "robot": "for",
}
"""`logs.records.CAUSES` in words."""


@dataclass(frozen=True, slots=True)
class Sentence:
    """One fact about the run.

    Attributes:
        text: in words.
        good: whether it is as one wishes; None if it is neither.
    """

    text: str
    good: bool | None = None


@dataclass(frozen=True, slots=True)
class Comparison:
    """A figure as planned and as it came."""

    name: str
    planned: str
    actual: str
    difference: str
    worse: bool


def duration(seconds: float | None) -> str:
    """`3.2 s`, `4 min 10 s`, `1 h 05 min`; `–` for none."""
    if seconds is None or not math.isfinite(seconds):
        return "–"
    if abs(seconds) < 100:
        text = f"{seconds:.1f}"
        return f"{text.removesuffix('.0')} s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def per_cent(share: float) -> str:
    """0.971 → `97.1 %`; never rounded up to 100 or down to 0."""
    if not math.isfinite(share):
        return "–"
    tenths = round(1000 * share)
    if share < 1:
        tenths = min(tenths, 999)
    if share > 0:
        tenths = max(tenths, 1)
    return f"{tenths / 10:.1f} %"


def headline(story: RunStory) -> str:
    """The outcome in one sentence."""
    kpi, slot_s = story.kpi, story.start.slot_s
    took = duration(kpi.makespan_slots * slot_s)
    if story.end.verdict == "completed":
        return f"All {kpi.robots} robots reached their goals; the last one after {took}."
    arrived = f"{kpi.arrived} of {kpi.robots} robots reached their goals"
    return f"The run failed: {arrived}. {story.end.message}"


def sentences(run: RunFile, story: RunStory) -> list[Sentence]:
    """What a reader wants to know first."""
    kpi, counts = story.kpi, story.incidents
    clashes = sum(counts[kind] for kind in ("collision", "contact", "obstacle", "caught"))
    said = []
    if clashes:
        said.append(Sentence(f"{_count(clashes, 'time')} robots or obstacles were hit.", False))
    elif kpi.min_clearance_m > NO_CLEARANCE_M:
        near = f"the least clearance between two robots was {kpi.min_clearance_m:.2f} m"
        said.append(Sentence(f"No robot hit anything; {near}.", True))
    else:
        said.append(Sentence("No robot hit anything.", True))
    seconds = kpi.connected_s + kpi.handover_s + kpi.outage_s
    share = kpi.connected_s / seconds if seconds > 0 else 0.0
    if kpi.outage_s > 0:
        worst = _worst_outage(story)
        text = (
            f"Robots were connected {per_cent(share)} of the time; the longest loss lasted {worst}."
        )
        said.append(Sentence(text, False))
    else:
        said.append(Sentence("No robot lost its radio connection.", True))
    changes = f"{_count(kpi.handovers, 'handover')} between access points"
    each = (
        f", each {1000 * story.start.interruption_s:.0f} ms without data" if kpi.handovers else ""
    )
    said.append(Sentence(f"There were {changes}{each} ({kpi.planned_handovers} planned)."))
    if kpi.overload_robot_slots:
        over = f"{_count(kpi.overload_robot_slots, 'robot-slot')} over capacity"
        said.append(Sentence(f"Access points served more robots than they can: {over}.", False))
    else:
        full = per_cent(kpi.peak_load_share).replace(".0 %", " %")
        text = f"No access point served more robots than it can; the fullest reached {full}."
        said.append(Sentence(text, True))
    if kpi.held_slots:
        held = duration(kpi.held_slots * story.start.slot_s)
        said.append(Sentence(f"Robots had to wait {held} in all against their plan.", False))
    gap = run.plan.gap
    if run.plan.status == "optimal":
        said.append(Sentence("The plan is proven to be the best possible one.", True))
    elif gap is not None:
        # Rounded up: the words never promise more than is proven.
        more = f"{math.ceil(1000 * gap - 1e-9) / 10:.1f} %"
        said.append(Sentence(f"The plan is proven to cost at most {more} more than the best one."))
    return said


def _worst_outage(story: RunStory) -> str:
    worst = max((r.kpi.worst_outage_s for r in story.robots if r.kpi), default=0.0)
    robot = next((r.name for r in story.robots if r.kpi and r.kpi.worst_outage_s == worst), "")
    return f"{duration(worst)} (robot {robot})"


def comparisons(run: RunFile, story: RunStory) -> list[Comparison]:
    """Key figures as planned and as they came."""
    kpi, slot_s, plan = story.kpi, story.start.slot_s, run.plan
    rows = [
        _compared(
            "last arrival",
            story.planned_makespan_slots * slot_s,
            kpi.makespan_slots * slot_s,
            duration,
        ),
        _compared(
            "travel time, all robots together",
            kpi.planned_travel_slots * slot_s,
            kpi.travel_slots * slot_s,
            duration,
        ),
        _compared("handovers", kpi.planned_handovers, kpi.handovers, lambda n: f"{n:g}"),
    ]
    problem = run.problem
    actual = problem.c_t * kpi.travel_slots + problem.c_h * kpi.handovers
    rows.append(_compared("cost", plan.cost, actual, lambda n: f"{n:g}"))
    return rows


def changes(story: RunStory) -> list[tuple[float, str]]:
    """(time [s], words) of what concerns more than one robot: what goes wrong, and new plans."""
    found = [
        (d.t_s, f"{d.t_s:.1f} s: {d.message}")
        for d in story.disturbances
        if d.kind != "delay" and d.begins
    ]
    found += [(r.t_s, f"{r.t_s:.1f} s: new plan, {r.message}") for r in story.replans if r.adopted]
    return sorted(found)


def _compared(name: str, planned: float, actual: float, say: Callable[[float], str]) -> Comparison:
    more = actual - planned
    sign = "+" if more > 0 else "−"
    difference = f"{sign} {say(abs(more))}" if more else "as planned"
    return Comparison(name, say(planned), say(actual), difference, more > 0)


def _count(number: int, noun: str) -> str:
    return f"{number or 'no'} {noun}{'' if number == 1 else 's'}"
