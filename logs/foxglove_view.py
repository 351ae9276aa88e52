"""What Foxglove is shown and when: follows the records and says which messages go beside them.

Rules (docs of the log, "what Foxglove needs"): every message tells its topic's whole picture, since
a seek delivers the last one of each topic only; statics come again every `REPEAT_S`; transforms
come before scenes of the same instant; a robot that has left the floor is in no transform and no
scene any more.

/tf and /scene/links are written at every sample and hold hundreds of small messages each. They are
packed by hand, field by field as protobuf does, which is ten times as fast as building objects.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

from logs.errors import LogError
from logs.foxglove import (
    HALL_FRAME,
    HANDOVER_COLOR,
    OUTAGE_COLOR,
    WORLD_FRAME,
    Xyz,
    ap_color,
    ap_positions,
    congestion_grid,
    coverage_grid,
    log_line,
    plan_scene,
    rgb,
    robot_body,
    robots_scene,
    stamp,
    static_scene,
    timestamp,
)
from logs.mcap_format import time_ns
from logs.records import HANDOVER, LINKS, NO_AP, OUTAGE, Record, RunStart, Sample
from planner.plan import Plan
from planner.problem import Problem
from worlds.floor import Floor
from worlds.radio_map import RadioMap
from worlds.world import World

REPEAT_S = 60.0
"""Statics are written again this often [s]."""
SNAP_M = 1 / 1024
"""Positions on /tf and /scene/links are multiples of this [m]; records keep full precision."""

TOPICS: dict[str, Any] = {
    "/tf": FrameTransforms,
    "/scene/static": SceneUpdate,
    "/scene/plan": SceneUpdate,
    "/radio/coverage": Grid,
    "/radio/congestion": Grid,
    "/scene/robots": SceneUpdate,
    "/scene/links": SceneUpdate,
    "/log": Log,
}
"""Topic → message class, in the order in which messages of one instant are written.

`/radio/congestion` is there only if the plan has prices (`View.topics`).
"""

Out = tuple[str, int, bytes]
"""(topic, log time [ns], bytes of the message)."""

_DASHES = 5
_BAR_M = 1.0  # height of the bar over a robot without service


class View:
    """Follows a run record by record."""

    def __init__(
        self, world: World, floor: Floor, radio_map: RadioMap, problem: Problem, plan: Plan
    ) -> None:
        """Prepare what never changes.

        Raises:
            LogError: a robot bears the name of a fixed frame.
        """
        for name in problem.robot_ids:
            if name in {WORLD_FRAME, HALL_FRAME}:
                raise LogError(
                    f"robot {name!r}: that is the name of a fixed frame of the log; call the robot"
                    " something else"
                )
        self._world = world
        self._statics = [
            ("/scene/static", static_scene(world, floor, problem)),
            ("/scene/plan", plan_scene(problem, plan)),
            ("/radio/coverage", coverage_grid(floor, radio_map)),
        ]
        self.topics = dict(TOPICS)
        if plan.prices is not None:
            congestion = congestion_grid(floor, radio_map, problem, plan.prices)
            self._statics.append(("/radio/congestion", congestion))
        else:
            del self.topics["/radio/congestion"]
        self._bodies = [robot_body(world, name) for name in problem.robot_ids]
        self._fleet = SceneUpdate()
        self._transforms = _Transforms(problem.robot_ids)
        self._links = _Links(ap_positions(world, problem.ap_ids), world.hall.body.antenna_m)
        self._on_floor: tuple[int, ...] | None = None
        self._link_lines: bytes | None = None
        self._next_ns: int | None = None  # of the statics

    def before(self, record: Record) -> Iterator[Out]:
        """Messages due between the last record and this one."""
        now = time_ns(record.t_s)
        while self._next_ns is not None and self._next_ns < now:
            yield from self._repeat(self._next_ns)

    def after(self, record: Record) -> Iterator[Out]:
        """Messages that show this record."""
        now = time_ns(record.t_s)
        line = log_line(record, now)
        if line is not None:
            yield "/log", now, line.SerializeToString(deterministic=True)
        if isinstance(record, RunStart):
            yield "/tf", now, self._transforms.pack(_Places((), (), ()), (), now)
            self._next_ns = now
            yield from self._repeat(now)
        elif isinstance(record, Sample):
            yield from self._sample(record, now)

    def _repeat(self, now: int) -> Iterator[Out]:
        """Everything that stands still, and the scenes as they were last."""
        for topic, message in self._statics:
            yield topic, now, stamp(message, now)
        if self._on_floor is not None:
            yield "/scene/robots", now, stamp(self._fleet, now)
        if self._link_lines is not None:
            yield "/scene/links", now, self._links.scene(self._link_lines, now)
        self._next_ns = now + round(REPEAT_S * 1e9)

    def _sample(self, sample: Sample, now: int) -> Iterator[Out]:
        places = _Places(
            sample.robot, [_snap(x) for x in sample.x_m], [_snap(y) for y in sample.y_m]
        )
        yield "/tf", now, self._transforms.pack(places, sample.heading_rad, now)
        lines = self._links.pack(places, sample.ap, sample.link)
        moved, self._link_lines = lines != self._link_lines, lines
        changed = sample.robot != self._on_floor
        if changed:
            self._fleet = robots_scene(self._world, self._bodies, sample.robot)
            self._on_floor = sample.robot
        if self._next_ns is not None and self._next_ns <= now:
            yield from self._repeat(now)
            return
        if changed:
            yield "/scene/robots", now, stamp(self._fleet, now)
        if moved:
            yield "/scene/links", now, self._links.scene(lines, now)


# --- packing by hand ------------------------------------------------------------------------------

_VARINT, _I64, _LEN = 0, 1, 2


def _tag(message: Any, field: str, wire_type: int) -> bytes:
    number: int = message.DESCRIPTOR.fields_by_name[field].number
    return bytes([number << 3 | wire_type])  # one byte: no field of these has a number above 15


_ONE_BYTE = [bytes([value]) for value in range(0x80)]


def _varint(value: int) -> bytes:
    out = b""
    while value >= len(_ONE_BYTE):
        out += bytes([value & 0x7F | 0x80])
        value >>= 7
    return out + _ONE_BYTE[value]


def _block(tag: bytes, content: bytes) -> bytes:
    """A length-delimited field."""
    return tag + _varint(len(content)) + content


@dataclass(frozen=True, slots=True)
class _Places:
    """Where the robots on the floor are [m], on the raster of `SNAP_M`."""

    robot: Sequence[int]
    x_m: Sequence[float]
    y_m: Sequence[float]


class _Transforms:
    """Packs `foxglove.FrameTransforms`: world → hall, and world → robot for all on the floor."""

    _EACH = _tag(FrameTransforms, "transforms", _LEN)
    _STAMP = _tag(FrameTransform, "timestamp", _LEN)
    # translation {x, y} and rotation {z, w}; z, and x and y of the rotation, are 0 and left out
    _TWO = struct.Struct("<3sdsd")
    _MOVE_X = _tag(FrameTransform, "translation", _LEN) + b"\x12" + _tag(Vector3, "x", _I64)
    _MOVE_Y = _tag(Vector3, "y", _I64)
    _TURN_Z = _tag(FrameTransform, "rotation", _LEN) + b"\x12" + _tag(Quaternion, "z", _I64)
    _TURN_W = _tag(Quaternion, "w", _I64)

    def __init__(self, robots: tuple[str, ...]) -> None:
        parent = _block(_tag(FrameTransform, "parent_frame_id", _LEN), WORLD_FRAME.encode())
        child = _tag(FrameTransform, "child_frame_id", _LEN)
        self._heads = [parent + _block(child, name.encode()) for name in robots]
        self._hall = parent + _block(child, HALL_FRAME.encode())

    def pack(self, places: _Places, headings: Sequence[float], now: int) -> bytes:
        """The transforms of all robots at these places, after that of the hall."""
        head = _block(self._STAMP, timestamp(now).SerializeToString())
        out = [_block(self._EACH, head + self._hall + self._move(0.0, 0.0) + self._turn(0.0))]
        for i, x, y, heading in zip(places.robot, places.x_m, places.y_m, headings, strict=True):
            frame = head + self._heads[i] + self._move(x, y) + self._turn(heading)
            out.append(_block(self._EACH, frame))
        return b"".join(out)

    def _move(self, x: float, y: float) -> bytes:
        return self._TWO.pack(self._MOVE_X, x, self._MOVE_Y, y)

    @classmethod
    @lru_cache(maxsize=1024)  # robots on a grid have few headings
    def _turn(cls, heading: float) -> bytes:
        z, w = math.sin(heading / 2), math.cos(heading / 2)
        return cls._TWO.pack(cls._TURN_Z, z, cls._TURN_W, w)


class _Links:
    """Packs the scene of radio links: one line from each robot's antenna to its AP's.

    Its colour is the AP's; red in an outage, with a red bar over the robot, which is all that is
    left without an AP; light grey dashes while a handover lasts.
    """

    _POINT = struct.Struct("<3sdsdsd")
    _POINT_X = _tag(LinePrimitive, "points", _LEN) + b"\x1b" + _tag(Point3, "x", _I64)
    _POINT_Y, _POINT_Z = _tag(Point3, "y", _I64), _tag(Point3, "z", _I64)

    def __init__(self, aps: list[Xyz], antenna_m: float) -> None:
        self._aps = aps
        self._antenna_m = antenna_m
        self._ap_points = [self._point(*place) for place in aps]
        self._colors = [self._pair(ap_color(k)) for k in range(len(aps))]
        self._outage = self._pair(rgb(OUTAGE_COLOR))
        self._dashes = self._pair(rgb(HANDOVER_COLOR)) * _DASHES
        line = LinePrimitive(
            type=LinePrimitive.LINE_LIST, pose=Pose(orientation=Quaternion(w=1.0)), thickness=0.05
        )
        self._line = line.SerializeToString(deterministic=True)
        entity = SceneEntity(frame_id=WORLD_FRAME, id="links")
        self._entity = entity.SerializeToString(deterministic=True)

    def _point(self, x: float, y: float, z: float) -> bytes:
        return self._POINT.pack(self._POINT_X, x, self._POINT_Y, y, self._POINT_Z, z)

    @staticmethod
    def _pair(color: tuple[float, float, float]) -> bytes:
        """The colours of both ends of a line."""
        red, green, blue = color
        data = Color(r=red, g=green, b=blue, a=0.9).SerializeToString()
        return 2 * _block(_tag(LinePrimitive, "colors", _LEN), data)

    def pack(self, places: _Places, aps: Sequence[int], links: Sequence[int]) -> bytes:
        """Points and colours of all lines."""
        points: list[bytes] = []
        colors: list[bytes] = []
        z = self._antenna_m
        point = self._point
        no_ap, outage, handover = (LINKS.index(name) for name in (NO_AP, OUTAGE, HANDOVER))
        for x, y, ap, link in zip(places.x_m, places.y_m, aps, links, strict=True):
            here = point(x, y, z)
            if ap < 0 or link in {outage, no_ap}:
                points += here, point(x, y, z + _BAR_M)
                colors.append(self._outage)
                if ap >= 0:
                    points += here, self._ap_points[ap]
                    colors.append(self._outage)
            elif link == handover:
                points += self._dash_points((x, y, z), self._aps[ap])
                colors.append(self._dashes)
            else:
                points += here, self._ap_points[ap]
                colors.append(self._colors[ap])
        return b"".join(points + colors)

    def _dash_points(self, here: Xyz, there: Xyz) -> list[bytes]:
        steps = [k / (2 * _DASHES - 1) for k in range(2 * _DASHES)]
        return [
            self._point(*(_snap(a + (b - a) * s) for a, b in zip(here, there, strict=True)))
            for s in steps
        ]

    def scene(self, lines: bytes, now: int) -> bytes:
        """The whole `foxglove.SceneUpdate` of packed lines."""
        entity = self._entity + _block(
            _tag(SceneEntity, "timestamp", _LEN), timestamp(now).SerializeToString()
        )
        if lines:
            entity += _block(_tag(SceneEntity, "lines", _LEN), self._line + lines)
        return _block(_tag(SceneUpdate, "entities", _LEN), entity)


def _snap(metres: float) -> float:
    return round(metres * 1024) * SNAP_M
