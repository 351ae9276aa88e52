"""Transforms and links packed by hand, field by field as protobuf does.

/tf and /scene/links are written at every sample, /scene/paths in every slot, and hold hundreds of
small messages each; this is ten times as fast as building objects.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

from logs.colors import HANDOVER_COLOR, OUTAGE_COLOR, ap_color, rgb
from logs.foxglove_parts import HALL_FRAME, WORLD_FRAME, Xyz, timestamp
from logs.records import HANDOVER, LINKS, NO_AP, OUTAGE

SNAP_M = 1 / 1024
"""Positions on /tf and /scene/links are multiples of this [m]; records keep full precision."""

_DASHES = 5
_BAR_M = 1.0  # height of the bar over a robot without service
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
class Places:
    """Where the robots on the floor are [m], on the raster of `SNAP_M`."""

    robot: Sequence[int]
    x_m: Sequence[float]
    y_m: Sequence[float]


class Transforms:
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

    def pack(self, places: Places, headings: Sequence[float], now: int) -> bytes:
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


class Lines:
    """Packs scenes that are one entity with lists of lines, all of them told in each message.

    An entity of the same id replaces the one before it, so a scene without lines clears the topic.
    """

    _POINT = struct.Struct("<3sdsdsd")
    _POINT_X = _tag(LinePrimitive, "points", _LEN) + b"\x1b" + _tag(Point3, "x", _I64)
    _POINT_Y, _POINT_Z = _tag(Point3, "y", _I64), _tag(Point3, "z", _I64)

    def __init__(self, name: str, thickness_m: float) -> None:
        line = LinePrimitive(
            type=LinePrimitive.LINE_LIST,
            pose=Pose(orientation=Quaternion(w=1.0)),
            thickness=thickness_m,
        )
        self._line = line.SerializeToString(deterministic=True)
        entity = SceneEntity(frame_id=WORLD_FRAME, id=name)
        self._entity = entity.SerializeToString(deterministic=True)

    @classmethod
    def point(cls, x: float, y: float, z: float) -> bytes:
        """A point of a line [m]."""
        return cls._POINT.pack(cls._POINT_X, x, cls._POINT_Y, y, cls._POINT_Z, z)

    @staticmethod
    def pair(color: tuple[float, float, float], alpha: float = 0.9) -> bytes:
        """The colours of both ends of a line."""
        red, green, blue = color
        data = Color(r=red, g=green, b=blue, a=alpha).SerializeToString()
        return 2 * _block(_tag(LinePrimitive, "colors", _LEN), data)

    def scene(self, lines: bytes, now: int) -> bytes:
        """The whole `foxglove.SceneUpdate` of packed points and colours."""
        entity = self._entity + _block(
            _tag(SceneEntity, "timestamp", _LEN), timestamp(now).SerializeToString()
        )
        if lines:
            entity += _block(_tag(SceneEntity, "lines", _LEN), self._line + lines)
        return _block(_tag(SceneUpdate, "entities", _LEN), entity)


class Links(Lines):
    """Packs the scene of radio links: one line from each robot's antenna to its AP's.

    Its colour is the AP's; red in an outage, with a red bar over the robot, which is all that is
    left without an AP; light grey dashes while a handover lasts.
    """

    def __init__(self, aps: list[Xyz], antenna_m: float) -> None:
        super().__init__("links", 0.05)
        self._aps = aps
        self._antenna_m = antenna_m
        self._ap_points = [self.point(*place) for place in aps]
        self._colors = [self.pair(ap_color(k)) for k in range(len(aps))]
        self._outage = self.pair(rgb(OUTAGE_COLOR))
        self._dashes = self.pair(rgb(HANDOVER_COLOR)) * _DASHES

    def pack(self, places: Places, aps: Sequence[int], links: Sequence[int]) -> bytes:
        """Points and colours of all lines."""
        points: list[bytes] = []
        colors: list[bytes] = []
        z = self._antenna_m
        point = self.point
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
            self.point(*(snap(a + (b - a) * s) for a, b in zip(here, there, strict=True)))
            for s in steps
        ]


def snap(metres: float) -> float:
    """A position on the raster of `SNAP_M`."""
    return round(metres * 1024) * SNAP_M
