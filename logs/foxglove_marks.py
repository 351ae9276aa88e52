"""Marks in Foxglove: what has just happened and where, and what is wrong for the time being.

`/scene/events` shows handovers, incidents and new plans for `SHOWN_S` after they happen;
`/scene/disturbances` shows blockages, APs that are out, and robots that have failed or are late, as
long as they are. Each is one entity that is told as a whole, so that a seek finds all of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive

from logs.colors import HANDOVER_COLOR, OUTAGE_COLOR
from logs.foxglove_parts import Xyz, ball, cube, entity, label, text_size
from logs.foxglove_stamp import Stamped, packed, tag
from logs.records import Blockages, Disturbance, Handover, Incident, Record, Replan, Sample
from logs.wire import LEN, block
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


_SPHERES, _TEXTS = tag(SceneEntity, "spheres", LEN), tag(SceneEntity, "texts", LEN)


@dataclass(frozen=True, slots=True)
class _Mark:
    """An event: a ball where it happened, its text above."""

    until_s: float
    at: Xyz
    color: str
    text: str
    size_m: float
    _texts: dict[int, bytes] = field(default_factory=dict, compare=False)

    def sphere(self) -> bytes:
        """The ball, packed as a field of the entity."""
        return block(_SPHERES, packed(ball(self.at, 0.5 * self.size_m, self.color)))

    def words(self, level: int) -> bytes:
        """The text, above as many others at the same place."""
        if level not in self._texts:
            x, y, z = self.at
            above = (x, y, z + self.size_m * (1 + level))
            text = packed(label(above, self.text, self.size_m, self.color))
            self._texts[level] = block(_TEXTS, text)
        return self._texts[level]


class Marks:
    """Follows what happens, and packs the two scenes; each is packed anew when it changes."""

    def __init__(self, world: World, aps: Mapping[str, Xyz], robots: tuple[str, ...]) -> None:
        self._aps = aps
        self._index = {name: i for i, name in enumerate(robots)}
        self._size_m = 0.7 * text_size(world)
        self._body = world.hall.body
        self._above = (0.0, world.hall.size_m[1] + 3 * text_size(world), 0.5)
        self._sample: Sample | None = None
        self._marks: list[tuple[_Mark, bytes]] = []  # with their balls, in the order of their times
        self._head = packed(entity("events"))
        self._events: Stamped | None = None
        self._disturbances = Stamped(())
        self._told: tuple[object, ...] | None = None  # what these are of
        self._boxes: Blockages | None = None
        self._wrong: dict[tuple[str, str], Disturbance] = {}

    def add(self, record: Record) -> None:
        """The next record."""
        match record:
            case Sample():
                self._sample = record
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
                    self._marks.append((mark, mark.sphere()))
                    self._events = None

    def _place(self, robot: str) -> tuple[float, float] | None:
        """Where a robot was seen last, None if it is not on the floor."""
        i, sample = self._index.get(robot), self._sample
        if i is None or sample is None or i not in sample.robot:
            return None
        k = sample.robot.index(i)
        return sample.x_m[k], sample.y_m[k]

    def events(self, t_s: float) -> Stamped:
        """What has happened in the last `SHOWN_S` before t_s; the same object until it changes."""
        if self._events is not None and not (self._marks and self._marks[0][0].until_s <= t_s):
            return self._events
        self._marks = [mark for mark in self._marks if mark[0].until_s > t_s][-MAX_MARKS:]
        spheres: list[bytes] = []
        texts: list[bytes] = []
        lines_at: dict[Xyz, int] = {}  # several texts at a place stand above each other
        for mark, sphere in self._marks:
            level = lines_at[mark.at] = lines_at.get(mark.at, -1) + 1
            spheres.append(sphere)
            texts.append(mark.words(level))
        self._events = Stamped.scene([b"".join([self._head, *spheres, *texts])])
        return self._events

    def disturbances(self, t_s: float) -> Stamped:
        """What is wrong at t_s; the same object until it changes."""
        places = tuple(self._place(wrong.robot) for wrong in self._wrong.values() if wrong.robot)
        late = tuple(
            wrong.kind == "delay" and 0 <= wrong.until_s <= t_s for wrong in self._wrong.values()
        )
        now = (self._boxes, *self._wrong.values(), places, late)
        if now != self._told:
            self._disturbances, self._told = self._wrong_scene(t_s), now
        return self._disturbances

    def _wrong_scene(self, t_s: float) -> Stamped:
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
            place = self._place(wrong.robot)
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
        return Stamped.scene([packed(entity("disturbances", cubes=cubes, texts=texts))])

    def _mark(self, record: Record) -> _Mark | None:
        """How a record is marked, None if it is not."""
        until_s = record.t_s + SHOWN_S
        high = self._body.height_m + 0.2
        match record:
            case Handover():
                words = f"{record.from_ap or 'none'} → {record.to_ap or 'none'}"
                at = (record.x_m, record.y_m, high)
                return _Mark(until_s, at, HANDOVER_COLOR, words, self._size_m)
            case Incident():
                place = self._place(record.robot)
                at = (*place, high) if place else self._aps.get(record.ap, self._above)
                subject = record.robot or record.ap
                words = f"{subject} {record.kind}".strip()
                return _Mark(until_s, at, OUTAGE_COLOR, words, self._size_m)
            case Replan():
                done = "new plan" if record.adopted else "old plan kept"
                words = f"{done} ({record.cause} {record.name})".replace(" )", ")")
                return _Mark(until_s, self._above, _PLAN_COLOR, words, self._size_m)
            case _:
                return None
