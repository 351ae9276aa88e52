"""What a report tells of a run, gathered in one pass over its records.

Only changes are kept: which AP served a robot from when to when, loads slot by slot, waits, lost
links and incidents. Memory does not grow with the number of samples.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from logs.errors import LogError
from logs.records import (
    GONE,
    HANDOVER,
    HELD,
    NO_AP,
    OUTAGE,
    ApKpi,
    ApLoad,
    Arrival,
    Disturbance,
    Handover,
    Incident,
    Kpi,
    Record,
    Replan,
    RobotKpi,
    RobotState,
    RunEnd,
    RunStart,
)

if TYPE_CHECKING:
    from logs.mcap_reader import RunFile

MAX_EVENTS = 200
"""Events that are listed one by one."""


@dataclass(frozen=True, slots=True)
class Span:
    """A time in which nothing changes about a robot's link.

    Attributes:
        begin_s, end_s: from when to when [s].
        ap: that serves it, "" for none.
        lost: whether it is without connection.
    """

    begin_s: float
    end_s: float
    ap: str
    lost: bool


@dataclass(frozen=True, slots=True)
class Wait:
    """A time in which a robot stands although its plan has it move.

    Attributes:
        begin_s, end_s: from when to when [s].
        waits_for: the robot that must go first, "" if none.
        cause: one of `logs.records.CAUSES`, "" if the log does not tell.
    """

    begin_s: float
    end_s: float
    waits_for: str
    cause: str


@dataclass(frozen=True, slots=True)
class Event:
    """A line in the list of events; `kind` is that of the record, e.g. "outage" or "replan"."""

    t_s: float
    kind: str
    robot: str
    ap: str
    message: str


@dataclass
class RobotStory:
    """One robot from beginning to end.

    Attributes:
        name: its id.
        spans: its links in the order of time; none while it is not on the floor.
        handovers: in the order of time.
        waits: times it was held against the plan.
        arrival_s: when it stood at its goal for good, None if it did not arrive.
        kpi: its key figures, None if the log has none.
        planned_arrival_s, planned_handovers: of its path, None if it has none.
    """

    name: str
    spans: list[Span] = field(default_factory=list)
    handovers: list[Handover] = field(default_factory=list)
    waits: list[Wait] = field(default_factory=list)
    arrival_s: float | None = None
    kpi: RobotKpi | None = None
    planned_arrival_s: float | None = None
    planned_handovers: int | None = None

    @property
    def lost(self) -> list[Span]:
        """Times without connection; neighbours are one."""
        joined: list[Span] = []
        for span in self.spans:
            if span.lost and joined and joined[-1].end_s == span.begin_s:
                joined[-1] = Span(joined[-1].begin_s, span.end_s, span.ap, lost=True)
            elif span.lost:
                joined.append(span)
        return joined

    @property
    def reasons(self) -> list[tuple[str, str, float]]:
        """(cause, for whom, how long [s]) of its waits; the longest first."""
        seconds: dict[tuple[str, str], float] = {}
        for wait in self.waits:
            key = wait.cause, wait.waits_for
            seconds[key] = seconds.get(key, 0.0) + wait.end_s - wait.begin_s
        return sorted(((*key, s) for key, s in seconds.items()), key=lambda r: (-r[2], r[:2]))


@dataclass
class ApStory:
    """One AP from beginning to end.

    Attributes:
        name: its id.
        loads: (t [s], robots served, capacity) at the beginning of each slot.
        kpi: its key figures, None if the log has none.
    """

    name: str
    loads: list[tuple[float, int, int]] = field(default_factory=list)
    kpi: ApKpi | None = None


@dataclass
class RunStory:
    """The whole run.

    Attributes:
        start, end: its first and last record.
        kpi: its key figures.
        robots, aps: in the order of the log.
        events: the first `MAX_EVENTS` incidents, disturbances and replans, in the order of time.
        incidents: how many events of each kind there are in all.
        disturbances, replans: the first `MAX_EVENTS` of them, for marks in charts.
        planned_makespan_slots: slot of the last arrival of the plan.
    """

    start: RunStart
    end: RunEnd
    kpi: Kpi
    robots: list[RobotStory]
    aps: list[ApStory]
    events: list[Event]
    incidents: Counter[str]
    disturbances: list[Disturbance]
    replans: list[Replan]
    planned_makespan_slots: int


class _Link:
    """The state of a robot's link that lasts until the next one."""

    __slots__ = ("ap", "lost", "since_s")

    def __init__(self, since_s: float, ap: str, lost: bool) -> None:
        self.since_s, self.ap, self.lost = since_s, ap, lost


def tell(run: RunFile) -> RunStory:
    """Gather what a report tells.

    Raises:
        LogError: the log does not tell how its run began or ended.
    """
    teller = _Teller()
    for record in run.iter_records():
        teller.add(record)
    return teller.story(run)


class _Teller:
    """Follows a run record by record."""

    def __init__(self) -> None:
        self._start: RunStart | None = None
        self._end: RunEnd | None = None
        self._kpi: Kpi | None = None
        self._robots: dict[str, RobotStory] = {}
        self._aps: dict[str, ApStory] = {}
        self._links: dict[str, _Link] = {}
        self._slots: dict[str, int] = {}  # last slot whose activity is counted
        self._events: list[Event] = []
        self._disturbances: list[Disturbance] = []
        self._replans: list[Replan] = []
        self._incidents: Counter[str] = Counter()

    def add(self, record: Record) -> None:
        """The next record."""
        match record:
            case RunStart():
                self._start = record
                self._robots = {name: RobotStory(name) for name in record.robots}
                self._aps = {name: ApStory(name) for name in record.aps}
            case RobotState() if record.robot in self._robots:
                self._state(record, self._robots[record.robot])
            case Handover() if record.robot in self._robots:
                self._robots[record.robot].handovers.append(record)
            case Arrival() if record.robot in self._robots:
                self._robots[record.robot].arrival_s = record.t_s
            case ApLoad() if record.ap in self._aps:
                load = (record.t_s, record.load, record.capacity)
                self._aps[record.ap].loads.append(load)
            case Incident():
                names = ", ".join(filter(None, (record.robot, record.other)))
                self._event(Event(record.t_s, record.kind, names, record.ap, record.message))
            case Disturbance():
                over = "" if record.begins else " is over"
                kind = record.kind + over
                self._event(Event(record.t_s, kind, record.robot, record.ap, record.message))
                if len(self._disturbances) < MAX_EVENTS:
                    self._disturbances.append(record)
            case Replan():
                kind = "replan" if record.adopted else "replan, not adopted"
                why = f"{record.cause} {record.name}".strip()
                self._event(Event(record.t_s, kind, "", "", f"{why}: {record.message}"))
                if len(self._replans) < MAX_EVENTS:
                    self._replans.append(record)
            case Kpi():
                self._kpi = record
            case RobotKpi() if record.robot in self._robots:
                self._robots[record.robot].kpi = record
            case ApKpi() if record.ap in self._aps:
                self._aps[record.ap].kpi = record
            case RunEnd():
                self._end = record
            case _:
                pass

    def _event(self, event: Event) -> None:
        self._incidents[event.kind] += 1
        if len(self._events) < MAX_EVENTS:
            self._events.append(event)

    def _state(self, state: RobotState, robot: RobotStory) -> None:
        lost = state.link in {OUTAGE, NO_AP}
        link = self._links.get(state.robot)
        if state.link == HANDOVER and link is not None:
            lost = link.lost and link.ap == state.ap  # an interruption is no outage of its own
        if link is not None and (
            state.activity == GONE or (link.ap, link.lost) != (state.ap, lost)
        ):
            self._close(robot, state.t_s)
        if state.activity != GONE and state.robot not in self._links:
            self._links[state.robot] = _Link(state.t_s, state.ap, lost)
        if state.activity == HELD and self._slots.get(state.robot) != state.slot and self._start:
            self._wait(robot, state, self._start.slot_s)
        self._slots[state.robot] = state.slot

    def _close(self, robot: RobotStory, t_s: float) -> None:
        link = self._links.pop(robot.name)
        if t_s > link.since_s:
            robot.spans.append(Span(link.since_s, t_s, link.ap, link.lost))

    def _wait(self, robot: RobotStory, state: RobotState, slot_s: float) -> None:
        last = robot.waits[-1] if robot.waits else None
        wait = Wait(state.t_s, state.t_s + slot_s, state.waits_for, state.cause)
        reason = (wait.waits_for, wait.cause)
        if (
            last
            and (last.waits_for, last.cause) == reason
            and abs(last.end_s - wait.begin_s) < 1e-6
        ):
            robot.waits[-1] = Wait(last.begin_s, wait.end_s, *reason)
        else:
            robot.waits.append(wait)

    def story(self, run: RunFile) -> RunStory:
        """All of it."""
        start, end, kpi = self._start, self._end, self._kpi
        if start is None or end is None or kpi is None:
            raise LogError(f"{run.path}: does not tell how its run ended; run the world again")
        for name in list(self._links):
            self._close(self._robots[name], end.t_s)
        plan = run.plan
        for path in plan.paths:
            robot = self._robots.get(path.robot) if path is not None else None
            if path is not None and robot is not None:
                robot.planned_arrival_s = path.arrival * start.slot_s
                robot.planned_handovers = path.handovers
        return RunStory(
            start=start,
            end=end,
            kpi=kpi,
            robots=list(self._robots.values()),
            aps=list(self._aps.values()),
            events=self._events,
            incidents=self._incidents,
            disturbances=self._disturbances,
            replans=self._replans,
            planned_makespan_slots=max((p.arrival for p in plan.paths if p is not None), default=0),
        )
