"""Step 3 of validation, what goes wrong: derived anew from the world, compared with what is told.

Delays are drawn again from the world's streams, robot by robot; outages, failures and blockages are
taken from its events (the rules stand in `worlds.events`). Nothing of the twin's is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from logs.mcap_format import time_ns
from logs.records import Blockages, Disturbance
from logs.validate_context import METRES, STEP, Context
from worlds.boxes import footprint_hits
from worlds.errands import robot_height_m
from worlds.events import DELAYS_STREAM, LENGTHS_STREAM, Event, event_name
from worlds.floor import Boxes
from worlds.streams import stream

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]

RULE, _BLOCKAGE = "page5:disturbance", "page5:blockage"
_CHUNK = 512
_SAME_M = 1e-9
_COLUMNS = ("x_m", "y_m", "z_m", "yaw_rad", "length_m", "width_m", "height_m")


@dataclass(frozen=True)
class Box:
    """A blockage at an instant: centre, turn, length along it, width across, height [m, rad]."""

    name: str
    values: tuple[float, float, float, float, float, float, float]


class Truth:
    """What goes wrong in a run by the word of its world."""

    def __init__(self, context: Context) -> None:
        self._context = context
        world = context.inputs.world
        self.world = world
        self._lucky: dict[int, tuple[list[Floats], list[Floats]]] = {}
        self._streams = [
            (stream(world.run.seed, DELAYS_STREAM, n), stream(world.run.seed, LENGTHS_STREAM, n))
            for n in context.start.robots
        ]
        self._drawn: Floats = np.empty((len(context.start.robots), 2, 0))
        body = world.hall.body
        self._body = (body.length_m, body.width_m)
        self._height = robot_height_m(world)
        self.has_blockages = any(e.kind == "blockage" for e in world.event)
        self.robots_block = world.run.robots_block and body.height_m > body.antenna_m
        outages = any(e.kind == "ap-outage" for e in world.event)
        self.affects_radio = self.has_blockages or self.robots_block or outages
        self._shut: dict[int, tuple[Bools, Bools]] = {}

    # --- delays and failures ------------------------------------------------------------------

    def delays(self, slot: int) -> dict[int, tuple[int, str]]:
        """Length and event's name of the longest delay that begins for each robot in a slot."""
        found: dict[int, tuple[int, str]] = {}
        rules = self.world.delays
        if rules.p_delay > 0:
            while self._drawn.shape[2] <= slot:
                fresh = [[rng.random(_CHUNK) for rng in pair] for pair in self._streams]
                self._drawn = np.concatenate([self._drawn, np.array(fresh)], axis=2)
            poisson = rules.delay_event == "poisson"
            chance = 1.0 - math.exp(-rules.p_delay) if poisson else rules.p_delay
            for i in np.flatnonzero(self._drawn[:, 0, slot] < chance).tolist():
                found[i] = (self._length(float(self._drawn[i, 1, slot])), "")
        for k, event in enumerate(self.world.event):
            if event.kind == "delay" and event.slot == slot and event.robot in self._context.robot:
                i = self._context.robot[event.robot]
                if event.slots is not None and event.slots > found.get(i, (0, ""))[0]:
                    found[i] = (event.slots, event_name(self.world, k))
        return found

    def _length(self, w: float) -> int:
        rules = self.world.delays
        span = rules.max_delay - rules.min_delay
        if rules.delay_time == "uniform":
            return rules.min_delay + int(w * (span + 1))
        if not span or not 0.0 < w < 1.0:
            return rules.min_delay
        mean = (rules.min_delay + rules.max_delay) / 2.0
        drawn = round(NormalDist(mean, span / 6.0).inv_cdf(w))
        return int(np.clip(drawn, rules.min_delay, rules.max_delay))

    def has_failed(self, i: int, slot: int) -> bool:
        """Whether robot i has failed by the beginning of a slot."""
        name = self._context.start.robots[i]
        now = time_ns(self._context.start.slot_s * slot)
        return any(
            e.kind == "robot-failure" and e.robot == name and time_ns(e.from_s) <= now
            for e in self.world.event
        )

    # --- access points ------------------------------------------------------------------------

    def is_up(self, ap: int, t_ns: int) -> bool:
        """Whether an AP works at a time (of the log, [ns])."""
        name = self._context.start.aps[ap] if ap >= 0 else ""
        return not any(
            e.kind == "ap-outage" and e.ap == name and time_ns(e.from_s) <= t_ns < _end_ns(e)
            for e in self.world.event
        )

    # --- blockages ----------------------------------------------------------------------------

    def boxes(self, t_s: float) -> list[Box]:
        """The blockages that are there at an instant [s]."""
        now = time_ns(t_s)
        found = []
        for k, event in enumerate(self.world.event):
            if event.kind == "blockage" and time_ns(event.from_s) <= now < _end_ns(event):
                assert event.size_m is not None
                x, y, yaw = _pose(event, t_s)
                z = event.base_m + event.height_m / 2.0
                found.append(
                    Box(event_name(self.world, k), (x, y, z, yaw, *event.size_m, event.height_m))
                )
        return found

    def turns(self, t_s: float) -> bool:
        """Whether a blockage is at one of its way-points."""
        return any(
            abs(t_s - stop) < METRES for e in self.world.event if e.way_m for stop in _stop_times(e)
        )

    def standing(self, slot: int) -> list[str]:
        """Names of blockages that are there at a slot's beginning and do not move any more."""
        now_s = slot * self._context.start.slot_s
        names = {box.name for box in self.boxes(now_s)}
        return [
            event_name(self.world, k)
            for k, e in enumerate(self.world.event)
            if e.kind == "blockage"
            and event_name(self.world, k) in names
            and e.from_s + _way_m(e) / e.speed_m_s <= now_s
        ]

    def shut(self, slot: int) -> tuple[Bools, Bools]:
        """(V,) vertices and (E,) edges a body on which could touch a blockage in a slot."""
        if slot not in self._shut:
            if len(self._shut) > 8:
                self._shut.pop(next(iter(self._shut)))
            self._shut[slot] = self._find_shut(slot)
        return self._shut[slot]

    def _find_shut(self, slot: int) -> tuple[Bools, Bools]:
        problem = self._context.inputs.problem
        begin = slot * self._context.start.slot_s
        end = (slot + 1) * self._context.start.slot_s
        strips: list[tuple[float, ...]] = []
        for event in self.world.event:
            over = _end_ns(event) <= time_ns(begin) or time_ns(event.from_s) >= time_ns(end)
            if event.kind != "blockage" or over:
                continue
            assert event.size_m is not None
            stops = [begin, *(t for t in _stop_times(event) if begin < t < end), end]
            for a, b in pairwise(stops):
                (x, y, yaw), (to_x, to_y, _) = _pose(event, a), _pose(event, b)
                far = math.hypot(to_x - x, to_y - y)
                yaw = math.atan2(to_y - y, to_x - x) if far > _SAME_M else yaw
                z = event.base_m + event.height_m / 2.0
                length = event.size_m[0] + far
                middle = ((x + to_x) / 2.0, (y + to_y) / 2.0)
                strips.append((*middle, z, length, event.size_m[1], event.height_m, yaw))
        if not strips:
            return np.zeros(problem.n_vertices, np.bool_), np.zeros(problem.n_edges, np.bool_)
        table = np.array(strips)
        boxes = Boxes(("",) * len(table), table[:, :3], table[:, 3:6] / 2.0, table[:, 6])
        half = max(self._body) / 2.0
        vertex = footprint_hits(boxes, problem.xy_m, (half, half), body_height_m=self._height)
        u, v = problem.xy_m[problem.edge_uv[:, 0]], problem.xy_m[problem.edge_uv[:, 1]]
        way = v - u
        halves = np.column_stack(
            [
                (np.hypot(*way.T) + self._body[0]) / 2.0,
                np.full(len(way), self._body[1] / 2.0),
            ]
        )
        turn = np.arctan2(way[:, 1], way[:, 0])
        edge = footprint_hits(boxes, (u + v) / 2.0, halves, turn, body_height_m=self._height)
        return vertex >= 0, edge >= 0


def _end_ns(event: Event) -> int:
    return 2**62 if event.to_s is None else time_ns(event.to_s)


def _way_m(event: Event) -> float:
    points = event.way_m
    return sum(math.dist(a, b) for a, b in pairwise(points))


def _stop_times(event: Event) -> list[float]:
    """When a blockage is at each of its way-points [s]."""
    times, t = [event.from_s], event.from_s
    so_far = 0.0
    for a, b in zip(event.way_m, event.way_m[1:], strict=False):
        so_far += math.dist(a, b)
        t = event.from_s + so_far / event.speed_m_s
        times.append(t)
    return times


def _pose(event: Event, t_s: float) -> tuple[float, float, float]:
    """x, y and yaw of a blockage at a time."""
    if event.center_m is not None:
        return (*event.center_m, math.radians(event.yaw_deg))
    left = max(t_s - event.from_s, 0.0) * event.speed_m_s
    legs = list(zip(event.way_m, event.way_m[1:], strict=False))
    for k, (a, b) in enumerate(legs):
        length = math.dist(a, b)
        yaw = math.atan2(b[1] - a[1], b[0] - a[0])
        if left < length:
            share = left / length
            return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), yaw
        if k == len(legs) - 1:
            return *b, yaw
        left -= length
    raise ValueError("a blockage without way-points")


class DisturbanceCheck:
    """Compares what the log tells of disturbances with what its world declares."""

    def __init__(self, context: Context, truth: Truth) -> None:
        self._context, self._truth = context, truth
        self._told: set[tuple[object, ...]] = set()
        self._delays: dict[int, dict[int, Disturbance]] = {}
        self._boxes: list[Box] = []
        self.late_until: dict[int, int] = {}

    def _find(self, rule: str, found: object, expected: object, slot: int, robot: str = "") -> None:
        self._context.checks.find(STEP, rule, found, expected, slot=slot, robot=robot)

    def add(self, record: Disturbance) -> None:
        """Something begins or is over."""
        context = self._context
        context.checks.count(STEP, RULE)
        if record.kind == "delay":
            own = self._delays.setdefault(record.slot, {})
            i = context.robot.get(record.robot, -1)
            on_time = time_ns(record.t_s) == context.t_ns(record.slot)
            if i < 0 or i in own or not on_time or not record.begins:
                self._find(RULE, f"a delay at {record.t_s} s", "one, as its slot begins",
                           record.slot, record.robot)  # fmt: skip
            own[i] = record
            return
        key = (record.kind, record.name, record.robot, record.ap, record.begins, record.until_s,
               record.slot, time_ns(record.t_s))  # fmt: skip
        if key in self._told:
            self._find(RULE, f"{record.kind} {record.name!r} told twice", "once", record.slot)
        self._told.add(key)

    def begin_slot(self, slot: int, busy: list[int]) -> None:
        """Delays of a slot: those of the world that hold somebody up, and no other.

        Args:
            slot: which.
            busy: robots on the floor that have not arrived.
        """
        told = self._delays.pop(slot, {})
        real: dict[int, tuple[int, str]] = {}
        for i, (slots, name) in self._truth.delays(slot).items():
            if i in busy and self.late_until.get(i, 0) <= slot:
                real[i] = (slots, name)
                self.late_until[i] = slot + slots
        self._context.checks.count(STEP, RULE, len(busy))
        for i in sorted(told.keys() | real.keys()):
            record = told.get(i)
            found = (record.slots, record.name) if record else None
            if found != real.get(i):
                name = self._context.start.robots[i] if i >= 0 else ""
                self._find(
                    RULE,
                    f"delay (slots, event) {found}",
                    f"{real.get(i)} by the world's streams and events",
                    slot,
                    name,
                )

    def add_blockages(self, record: Blockages) -> None:
        """All blockages there are from now on."""
        columns = [getattr(record, name) for name in ("name", *_COLUMNS)]
        if len({len(column) for column in columns}) > 1:
            self._find(_BLOCKAGE, "columns of different lengths", "one entry each", record.slot)
            return
        rows = zip(*columns, strict=True)
        self._boxes = [Box(str(row[0]), tuple(row[1:])) for row in rows]

    def at_sample(self, slot: int, t_s: float) -> None:
        """The boxes told are those that are there."""
        real = self._truth.boxes(t_s)
        self._context.checks.count(STEP, _BLOCKAGE, len(real))
        found, expected = self._boxes, real
        if [b.name for b in found] != [b.name for b in expected]:
            self._find(_BLOCKAGE, f"at {t_s} s blockages {[b.name for b in found]}",
                       f"{[b.name for b in expected]} by the world's events", slot)  # fmt: skip
            return
        for told, box in zip(found, expected, strict=True):
            off = np.abs(np.array(told.values) - np.array(box.values))
            off[3] = abs(math.sin((told.values[3] - box.values[3]) / 2.0))
            if self._truth.turns(t_s):  # at the very instant of a turn either heading is right
                off[3] = 0.0
            if not (off <= METRES).all():
                self._find(_BLOCKAGE, f"{told.name} at {t_s} s: {told.values}",
                           f"{box.values} by the world's events", slot)  # fmt: skip

    def boxes(self) -> Boxes:
        """The blockages told last, as geometry."""
        table = np.array([box.values for box in self._boxes]).reshape(-1, 7)
        names = tuple(box.name for box in self._boxes)
        return Boxes(names, table[:, :3], table[:, 4:] / 2.0, table[:, 3])

    def finish(self, last: int) -> None:
        """Every event that comes to pass before the end of slot `last` is told, and no other."""
        context = self._context
        steps = context.steps
        real: set[tuple[object, ...]] = set()
        for k, event in enumerate(self._truth.world.event):
            if event.kind == "delay":
                continue
            until = -1.0 if event.to_s is None else event.to_s
            name = event_name(self._truth.world, k)
            own = (event.kind, name, event.robot or "", event.ap or "")
            times = [(True, event.from_s)]
            if event.to_s is not None and event.kind != "robot-failure":
                times.append((False, event.to_s))
            instants = [(begins, self._instant(t)) for begins, t in times]
            if len({number for _, number in instants}) < len(instants):
                continue  # so short that it holds at no instant
            for begins, n in instants:
                number = -(-n // steps) * steps if event.kind == "robot-failure" else n
                slot, step = divmod(number, steps)
                if slot <= last:
                    real.add((*own, begins, until, slot, context.t_ns(slot, step)))
        context.checks.count(STEP, RULE, len(real))
        for key in sorted(self._told - real, key=str):
            self._find(RULE, f"told: {key}", "no such event in the world", int(str(key[6])))
        for key in sorted(real - self._told, key=str):
            self._find(RULE, "not told", f"{key} by the world's events", int(str(key[6])))
        for slot, own_delays in self._delays.items():
            names = [r.robot for r in own_delays.values()]
            self._find(RULE, f"delays of {names}", "none in this slot", slot)

    def _instant(self, t_s: float) -> int:
        """Number of the first sample instant at or after a time."""
        steps, t_ns = self._context.steps, time_ns(t_s)
        part = self._context.start.slot_s / steps
        number = max(0, round(t_s / part) - 2)
        while self._context.t_ns(*divmod(number, steps)) < t_ns:
            number += 1
        return number
