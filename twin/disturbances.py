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
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twin.association import Instants, nanoseconds
from twin.blockages import NEVER_NS, Blockage, end_ns, strips
from twin.delays import DelayDraws
from worlds.boxes import footprint_hits, swept
from worlds.errands import robot_height_m
from worlds.events import (
    Delays,
    Event,
    event_name,
)
from worlds.floor import Boxes

if TYPE_CHECKING:
    from planner.problem import Problem
    from worlds.world import World

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


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
            (ap[e.ap], nanoseconds(e.from_s), end_ns(e))
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
        self._draws = DelayDraws(world, problem.robot_ids) if world.delays.p_delay > 0 else None
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
        if any(begin <= now_ns < end + grace_ns for begin, end in spans if end < NEVER_NS):
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
        boxes = strips((b, b.sweeps(begin, end)) for b in there)
        # The same boxes block the same places for as long as they all stand.
        moving = any(b.moves(begin, end) for b in there)
        return self._blocked(slot if moving else boxes.name, boxes)

    def blocked_for_good(self, slot: int) -> tuple[Bools, Bools]:
        """The same by those blockages only that stand, as far as one can see at a slot's begin."""
        now_s = self._instants.t_s(slot)
        stand = [self.blockages[k] for k in self.standing(slot)]
        key = ("stand", *(b.name for b in stand))
        return self._blocked(key, strips((b, b.sweeps(now_s, now_s)) for b in stand))

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
