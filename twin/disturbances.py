"""What goes wrong in a run and when: the world's `[delays]` and `[[event]]` in the twin's time.

All of it follows from the world and its seed alone, never from what the robots do (`worlds.events`
has the rules), so a log that carries its world carries its disturbances. Times are compared in
whole nanoseconds at the instants of the run: an AP is out, and a blockage is there, at those
instants t with from ≤ t < to. The *floor* is more careful: a vertex or an edge is blocked in a slot
in which a body on it could touch a blockage at any time of the slot.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twin.association import Instants, nanoseconds
from worlds.boxes import TOUCH_M, footprint_hits, swept
from worlds.errands import robot_height_m
from worlds.events import (
    DELAYS_STREAM,
    LENGTHS_STREAM,
    Delays,
    Event,
    event_name,
)
from worlds.floor import Boxes
from worlds.streams import stream

if TYPE_CHECKING:
    from planner.problem import Problem
    from worlds.world import World

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

_CHUNK = 256  # random numbers drawn at once
_NEVER_NS = 2**62


def declare(world: World, events: Iterable[Event] = (), delays: Delays | None = None) -> World:
    """The world with these disturbances besides its own: what a run of them is given and logs.

    Raises:
        WorldError: they do not suit the world.
    """
    from pydantic import ValidationError

    from worlds.errors import WorldError
    from worlds.toml_faults import faults_of

    update = {"event": (*world.event, *events), "delays": delays or world.delays}
    data = {name: getattr(world, name) for name in type(world).model_fields} | update
    try:
        return type(world).model_validate(data)
    except ValidationError as error:
        raise WorldError(faults_of(error, data)) from None


@dataclass(frozen=True)
class Blockage:
    """A box in the way.

    Attributes:
        name: in messages.
        size_m: along its heading and across [m].
        z_m, height_m: of its centre, and of the box [m].
        from_ns, to_ns: when it is there.
        times_s: (k,) when it is at each way-point, ascending.
        way_m: (k, 2) the way-points; one for a blockage that stands.
        yaw_rad: (k,) heading from each way-point on.
    """

    name: str
    size_m: tuple[float, float]
    z_m: float
    height_m: float
    from_ns: int
    to_ns: int
    times_s: Floats
    way_m: Floats
    yaw_rad: Floats

    @classmethod
    def of(cls, event: Event, name: str) -> Blockage:
        """What an event of kind "blockage" declares."""
        assert event.size_m is not None  # the model asks for it
        way = np.array(event.way_m or [event.center_m], np.float64)
        legs = np.diff(way, axis=0)
        lengths = np.hypot(legs[:, 0], legs[:, 1])
        times = event.from_s + np.concatenate([[0.0], np.cumsum(lengths)]) / event.speed_m_s
        yaw = np.arctan2(legs[:, 1], legs[:, 0])
        yaw = np.append(yaw, yaw[-1]) if len(yaw) else np.array([math.radians(event.yaw_deg)])
        to_ns = _NEVER_NS if event.to_s is None else nanoseconds(event.to_s)
        z = event.base_m + event.height_m / 2.0
        return cls(
            name,
            event.size_m,
            z,
            event.height_m,
            nanoseconds(event.from_s),
            to_ns,
            times,
            way,
            yaw,
        )

    def there(self, t_ns: int) -> bool:
        """Whether it is there at an instant."""
        return self.from_ns <= t_ns < self.to_ns

    def moves(self, begin_s: float, end_s: float) -> bool:
        """Whether it moves within a span of time."""
        return bool(begin_s < self.times_s[-1] and end_s > self.times_s[0])

    def pose(self, t_s: float) -> tuple[float, float, float]:
        """x, y [m] and yaw [rad] at a time, by linear motion between way-points."""
        k = int(np.clip(np.searchsorted(self.times_s, t_s, "right") - 1, 0, len(self.way_m) - 1))
        x, y = self.way_m[k]
        if k + 1 < len(self.way_m):
            span = self.times_s[k + 1] - self.times_s[k]
            share = min(max((t_s - self.times_s[k]) / span, 0.0), 1.0)
            x, y = (1.0 - share) * self.way_m[k] + share * self.way_m[k + 1]
        return float(x), float(y), float(self.yaw_rad[k])

    def sweeps(self, begin_s: float, end_s: float) -> tuple[Floats, Floats, Floats]:
        """Centres (s, 2), half extents (s, 2), yaws (s,) of the strips covered in a span."""
        inner = self.times_s[(self.times_s > begin_s) & (self.times_s < end_s)]
        stops = [begin_s, *inner.tolist(), end_s]
        strips = [(*self.pose(a)[:2], *self.pose(b)[:2]) for a, b in pairwise(stops)]
        legs = np.array(strips).reshape(-1, 4)
        center, half, yaw = swept(legs[:, :2], legs[:, 2:], *self.size_m)
        still = np.hypot(*(legs[:, 2:] - legs[:, :2]).T) <= TOUCH_M
        yaw[still] = [self.pose(t)[2] for t, flag in zip(stops, still, strict=False) if flag]
        return center, half, yaw


@dataclass(frozen=True)
class Happening:
    """An event begins or is over.

    Attributes:
        event: its index in the world.
        begins: or is over.
    """

    event: int
    begins: bool


class Disturbances:
    """All that goes wrong in a run.

    Attributes:
        blockages: in the order of the world's events.
        affects_radio: links can differ from what the map says.
    """

    def __init__(self, world: World, problem: Problem, instants: Instants) -> None:
        self.world, self._problem, self._instants = world, problem, instants
        self._robot = {name: i for i, name in enumerate(problem.robot_ids)}
        ap = {name: a for a, name in enumerate(problem.ap_ids)}
        events = world.event
        self._outages = [
            (ap[e.ap], nanoseconds(e.from_s), _end_ns(e))
            for e in events
            if e.kind == "ap-outage" and e.ap in ap
        ]
        self.blockages = tuple(
            Blockage.of(e, event_name(world, i))
            for i, e in enumerate(events)
            if e.kind == "blockage"
        )
        self._failures = [
            (self._robot[e.robot], nanoseconds(e.from_s))
            for e in events
            if e.kind == "robot-failure" and e.robot in self._robot
        ]
        self._listed: dict[int, list[tuple[int, int, int]]] = {}  # slot -> robot, slots, event
        for i, e in enumerate(events):
            if e.kind == "delay" and e.robot in self._robot:
                assert e.slot is not None
                assert e.slots is not None
                self._listed.setdefault(e.slot, []).append((self._robot[e.robot], e.slots, i))
        self.affects_radio = bool(self._outages or self.blockages) or (
            world.run.robots_block and world.hall.body.height_m > world.hall.body.antenna_m
        )
        self._timeline = self._times()
        self._draws = _Draws(world, problem.robot_ids) if world.delays.p_delay > 0 else None
        body = world.hall.body
        self._body_m = (body.length_m, body.width_m)
        self._height_m = robot_height_m(world)
        self._closed: dict[object, tuple[Bools, Bools]] = {}

    def _times(self) -> dict[int, list[Happening]]:
        """By the number of the instant (slot · steps + step): what begins or ends there."""
        found: dict[int, list[Happening]] = {}
        for i, event in enumerate(self.world.event):
            if event.kind == "delay":
                continue
            begin, end = self._first_instant(nanoseconds(event.from_s)), -1
            if event.kind == "robot-failure":  # it fails at the beginning of a slot
                steps = self._instants.steps
                begin = -(-begin // steps) * steps
            elif event.to_s is not None:
                end = self._first_instant(nanoseconds(event.to_s))
                if end == begin:
                    continue  # so short that it holds at no instant
            found.setdefault(begin, []).append(Happening(i, True))
            if end >= 0:
                found.setdefault(end, []).append(Happening(i, False))
        return found

    def _first_instant(self, t_ns: int) -> int:
        """The first instant at or after a time, by number."""
        steps = self._instants.steps
        number = max(0, math.floor(t_ns * 1e-9 / self._instants.slot_s * steps) - 1)
        while nanoseconds(self._instants.t_s(*divmod(number, steps))) < t_ns:
            number += 1
        return number

    def happenings(self, slot: int, step: int) -> list[Happening]:
        """What begins or ends at an instant, in the order of the events."""
        return self._timeline.get(slot * self._instants.steps + step, [])

    def is_changing(self, slot: int) -> bool:
        """Whether something that is there will be over, or a blockage still moves.

        What is over since less than two slots and the time to trigger counts, too: robots that
        were without connection need as long to find it again.
        """
        now_s = self._instants.t_s(slot)
        now_ns = nanoseconds(now_s)
        grace_ns = nanoseconds(2 * self._instants.slot_s + self.world.run.time_to_trigger_s)
        spans = [(begin, end) for _, begin, end in self._outages]
        spans += [(b.from_ns, b.to_ns) for b in self.blockages]
        if any(begin <= now_ns < end + grace_ns for begin, end in spans if end < _NEVER_NS):
            return True
        return any(b.there(now_ns) and b.times_s[-1] > now_s for b in self.blockages)

    # --- robots -----------------------------------------------------------------------------

    def delays(self, slot: int) -> list[tuple[int, int, str]]:
        """(robot, slots, event's name) of the delays that begin in a slot, robots ascending.

        Of several that begin for one robot, the longest.
        """
        found: dict[int, tuple[int, str]] = {}
        if self._draws is not None:
            found = {i: (length, "") for i, length in self._draws.begin(slot)}
        for i, length, event in self._listed.get(slot, ()):
            if i not in found or length > found[i][0]:
                found[i] = (length, event_name(self.world, event))
        return [(i, *found[i]) for i in sorted(found)]

    def failed(self, slot: int) -> list[int]:
        """Robots that have failed by the beginning of a slot."""
        now_ns = nanoseconds(self._instants.t_s(slot))
        return sorted({i for i, from_ns in self._failures if from_ns <= now_ns})

    # --- access points ----------------------------------------------------------------------

    def ap_up(self, slot: int, step: int = 0) -> Bools:
        """(A,) bool, APs that work at an instant."""
        up = np.ones(len(self._problem.ap_ids), np.bool_)
        if self._outages:
            now_ns = nanoseconds(self._instants.t_s(slot, step))
            for a, from_ns, to_ns in self._outages:
                up[a] &= not from_ns <= now_ns < to_ns
        return up

    def out_since(self, slot: int) -> dict[int, int]:
        """APs that are out at the beginning of a slot, and since when [ns]."""
        now_ns = nanoseconds(self._instants.t_s(slot))
        found: dict[int, int] = {}
        for a, from_ns, to_ns in self._outages:
            if from_ns <= now_ns < to_ns:
                found[a] = min(found.get(a, from_ns), from_ns)
        return found

    # --- blockages --------------------------------------------------------------------------

    def present(self, slot: int, step: int = 0) -> list[int]:
        """Blockages that are there at an instant."""
        now_ns = nanoseconds(self._instants.t_s(slot, step))
        return [k for k, b in enumerate(self.blockages) if b.there(now_ns)]

    def standing(self, slot: int) -> list[int]:
        """Blockages that are there at the beginning of a slot and do not move any more."""
        now_s = self._instants.t_s(slot)
        return [k for k in self.present(slot) if self.blockages[k].times_s[-1] <= now_s]

    def boxes(self, slot: int, step: int) -> Boxes:
        """The boxes of the blockages that are there at an instant."""
        now_s = self._instants.t_s(slot, step)
        there = [self.blockages[k] for k in self.present(slot, step)]
        poses = np.array([b.pose(now_s) for b in there]).reshape(-1, 3)
        return Boxes(
            tuple(b.name for b in there),
            np.column_stack([poses[:, :2], [b.z_m for b in there]]),
            np.array([(*b.size_m, b.height_m) for b in there]).reshape(-1, 3) / 2.0,
            poses[:, 2],
        )

    def blocked(self, slot: int) -> tuple[Bools, Bools]:
        """(V,) vertices and (E,) edges on which a body could touch a blockage in a slot."""
        begin, end = self._instants.t_s(slot), self._instants.t_s(slot + 1)
        begin_ns, end_ns = nanoseconds(begin), nanoseconds(end)
        there = [b for b in self.blockages if b.from_ns < end_ns and b.to_ns > begin_ns]
        boxes = _strips((b, b.sweeps(begin, end)) for b in there)
        # The same boxes block the same places for as long as they all stand.
        moving = any(b.moves(begin, end) for b in there)
        return self._blocked(slot if moving else boxes.name, boxes)

    def blocked_for_good(self, slot: int) -> tuple[Bools, Bools]:
        """The same by those blockages only that stand, as far as one can see at a slot's begin."""
        now_s = self._instants.t_s(slot)
        stand = [self.blockages[k] for k in self.standing(slot)]
        key = ("stand", *(b.name for b in stand))
        return self._blocked(key, _strips((b, b.sweeps(now_s, now_s)) for b in stand))

    def _blocked(self, key: object, boxes: Boxes) -> tuple[Bools, Bools]:
        if not len(boxes):
            return self._nowhere
        if key not in self._closed:
            if len(self._closed) > 16:
                self._closed.clear()
            problem, (length, width) = self._problem, self._body_m
            square = (max(length, width) / 2.0,) * 2
            at_vertex = footprint_hits(boxes, problem.xy_m, square, body_height_m=self._height_m)
            u, v = problem.xy_m[problem.edge_uv[:, 0]], problem.xy_m[problem.edge_uv[:, 1]]
            strip = swept(u, v, length, width)
            on_edge = footprint_hits(boxes, *strip, body_height_m=self._height_m)
            self._closed[key] = (at_vertex >= 0, on_edge >= 0)
        return self._closed[key]

    @cached_property
    def _nowhere(self) -> tuple[Bools, Bools]:
        return np.zeros(self._problem.n_vertices, np.bool_), np.zeros(
            self._problem.n_edges, np.bool_
        )

    def touched(self, boxes: Boxes, xy_m: Floats, heading_rad: Floats) -> Ints:
        """(n,) int32, the box of `boxes` each body touches, −1 if none.

        Args:
            boxes: of the blockages at an instant.
            xy_m: (n, 2) where the bodies are [m].
            heading_rad: (n,).
        """
        length, width = self._body_m
        return footprint_hits(
            boxes, xy_m, (length / 2.0, width / 2.0), heading_rad, body_height_m=self._height_m
        )


def _strips(of: Iterable[tuple[Blockage, tuple[Floats, Floats, Floats]]]) -> Boxes:
    """The strips as boxes."""
    names, centers, halves, yaws = list[str](), list[Floats](), list[Floats](), list[float]()
    for b, (center, half, yaw) in of:
        for c, h, phi in zip(center, half, yaw, strict=True):
            names.append(b.name)
            centers.append(np.array([*c, b.z_m]))
            halves.append(np.array([*h, b.height_m / 2.0]))
            yaws.append(float(phi))
    return Boxes(
        tuple(names),
        np.array(centers).reshape(-1, 3),
        np.array(halves).reshape(-1, 3),
        np.array(yaws),
    )


def _end_ns(event: Event) -> int:
    return _NEVER_NS if event.to_s is None else nanoseconds(event.to_s)


class _Draws:
    """The delays of all robots by chance, slot after slot (see `worlds.events`)."""

    def __init__(self, world: World, robot_ids: tuple[str, ...]) -> None:
        self._delays = world.delays
        seed = world.run.seed
        self._luck = [stream(seed, DELAYS_STREAM, name) for name in robot_ids]
        self._length = [stream(seed, LENGTHS_STREAM, name) for name in robot_ids]
        p = self._delays.p_delay
        self._chance = p if self._delays.delay_event == "bernoulli" else -math.expm1(-p)
        self._first = -_CHUNK  # slot of the chunk's first column
        self._numbers: Floats = np.empty((2, len(robot_ids), 0))

    def begin(self, slot: int) -> list[tuple[int, int]]:
        """(robot, slots) of the delays that begin in a slot; slots are asked for in order."""
        while slot >= self._first + _CHUNK:
            self._numbers = np.array(
                [[rng.random(_CHUNK) for rng in rngs] for rngs in (self._luck, self._length)]
            )
            self._first += _CHUNK
        luck, length = self._numbers[:, :, slot - self._first]
        return [
            (int(i), self._slots(float(length[i])))
            for i in np.flatnonzero(luck < self._chance).tolist()
        ]

    def _slots(self, w: float) -> int:
        low, high = self._delays.min_delay, self._delays.max_delay
        if self._delays.delay_time == "uniform":
            return low + math.floor(w * (high - low + 1))
        if low == high or not 0.0 < w < 1.0:
            return low
        length = NormalDist((low + high) / 2.0, (high - low) / 6.0).inv_cdf(w)
        return min(max(round(length), low), high)
