"""Marks in Foxglove: what has just happened and where, and what is wrong for the time being.

`/scene/events` shows handovers, incidents and new plans for `SHOWN_S` after they happen;
`/scene/disturbances` shows blockages, APs that are out, and robots that have failed or are late, as
long as they are. Each is one entity that is told as a whole, so that a seek finds all of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive

from logs.colors import HANDOVER_COLOR, OUTAGE_COLOR
from logs.foxglove_parts import Xyz, ball, cube, entity, label, text_size
from logs.records import Blockages, Disturbance, Handover, Incident, Record, Replan, Sample
from worlds.world import World

SHOWN_S = 6.0
"""An event is shown for so long after it happened [s]."""
MAX_MARKS = 60
"""Events shown at a time; of more, those that happened last."""

BLOCKAGE_COLOR = "#d95f02"
_LATE_COLOR = "#ffd24d"
_PLAN_COLOR = "#56b4e9"
_FAILED_M = 1.6  # height of the post over a robot that has failed
_KINDS = {"ap-outage", "robot-failure", "delay"}  # blockages have boxes of their own


@dataclass(frozen=True, slots=True)
class _Mark:
    until_s: float
    at: Xyz
    color: str
    text: str


class Marks:
    """Follows what happens, and packs the two scenes."""

    def __init__(self, world: World, aps: Mapping[str, Xyz], robots: tuple[str, ...]) -> None:
        self._aps = aps
        self._index = {name: i for i, name in enumerate(robots)}
        self._size_m = 0.7 * text_size(world)
        self._body = world.hall.body
        self._above = (0.0, world.hall.size_m[1] + 3 * text_size(world), 0.5)
        self._places: dict[int, tuple[float, float]] = {}
        self._marks: list[_Mark] = []
        self._boxes: Blockages | None = None
        self._wrong: dict[tuple[str, str], Disturbance] = {}

    def add(self, record: Record) -> None:
        """The next record."""
        match record:
            case Sample():
                columns = zip(record.robot, record.x_m, record.y_m, strict=True)
                self._places = {i: (x, y) for i, x, y in columns}
            case Blockages():
                self._boxes = record
            case Disturbance() if record.kind in _KINDS:
                key = (record.kind, record.ap or record.robot)
                if record.begins:
                    self._wrong[key] = record
                else:
                    self._wrong.pop(key, None)
            case _:
                mark = self._mark(record)
                if mark is not None:
                    self._marks.append(mark)

    def events(self, t_s: float) -> SceneUpdate:
        """What has happened in the last `SHOWN_S` before t_s."""
        self._marks = [mark for mark in self._marks if mark.until_s > t_s][-MAX_MARKS:]
        spheres: list[SpherePrimitive] = []
        texts: list[TextPrimitive] = []
        lines_at: dict[Xyz, int] = {}  # several texts at a place stand above each other
        for mark in self._marks:
            x, y, z = mark.at
            level = lines_at[mark.at] = lines_at.get(mark.at, -1) + 1
            spheres.append(ball(mark.at, 0.5 * self._size_m, mark.color))
            above = (x, y, z + self._size_m * (1 + level))
            texts.append(label(above, mark.text, self._size_m, mark.color))
        return SceneUpdate(entities=[entity("events", spheres=spheres, texts=texts)])

    def disturbances(self, t_s: float) -> SceneUpdate:
        """What is wrong at t_s."""
        cubes: list[CubePrimitive] = []
        texts: list[TextPrimitive] = []
        size = self._size_m
        if self._boxes is not None:
            b = self._boxes
            columns = (b.name, b.x_m, b.y_m, b.z_m, b.yaw_rad, b.length_m, b.width_m, b.height_m)
            for name, x, y, z, yaw, length, width, height in zip(*columns, strict=False):
                box = cube((x, y, z), (length, width, height), BLOCKAGE_COLOR, 0.95, yaw)
                cubes.append(box)
                texts.append(label((x, y, z + height / 2 + size), name, size, BLOCKAGE_COLOR))
        for wrong in self._wrong.values():
            if wrong.kind == "ap-outage" and wrong.ap in self._aps:
                at = self._aps[wrong.ap]
                cubes.append(cube(at, (0.6, 0.6, 0.6), OUTAGE_COLOR, 0.8))
                below = (at[0], at[1], at[2] - 1.5 * size)
                texts.append(label(below, f"{wrong.ap}: out", size, OUTAGE_COLOR))
            place = self._places.get(self._index.get(wrong.robot, -1))
            over = wrong.kind == "delay" and 0 <= wrong.until_s <= t_s
            if place is None or over:
                continue
            failed = wrong.kind == "robot-failure"
            color, word = (OUTAGE_COLOR, "failed") if failed else (_LATE_COLOR, "late")
            high = self._body.height_m + _FAILED_M
            if failed:
                post = (*place, self._body.height_m + _FAILED_M / 2)
                cubes.append(cube(post, (0.15, 0.15, _FAILED_M), color))
            texts.append(label((*place, high), f"{wrong.robot}: {word}", size, color))
        return SceneUpdate(entities=[entity("disturbances", cubes=cubes, texts=texts)])

    def _mark(self, record: Record) -> _Mark | None:
        """How a record is marked, None if it is not."""
        until_s = record.t_s + SHOWN_S
        high = self._body.height_m + 0.2
        match record:
            case Handover():
                words = f"{record.from_ap or 'none'} → {record.to_ap or 'none'}"
                return _Mark(until_s, (record.x_m, record.y_m, high), HANDOVER_COLOR, words)
            case Incident():
                place = self._places.get(self._index.get(record.robot, -1))
                at = (*place, high) if place else self._aps.get(record.ap, self._above)
                subject = record.robot or record.ap
                return _Mark(until_s, at, OUTAGE_COLOR, f"{subject} {record.kind}".strip())
            case Replan():
                done = "new plan" if record.adopted else "old plan kept"
                words = f"{done} ({record.cause} {record.name})".replace(" )", ")")
                return _Mark(until_s, self._above, _PLAN_COLOR, words)
            case _:
                return None
