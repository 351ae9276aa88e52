"""Transforms and links packed by hand, field by field as protobuf does, all robots at once.

/tf and /scene/links are written at every sample, /scene/paths in every slot, and hold hundreds of
small messages each. Their bytes are laid out once as long as the same robots are on the floor, and
numpy puts the numbers of a sample in.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
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
from numpy.typing import ArrayLike, NDArray

from logs.colors import HANDOVER_COLOR, OUTAGE_COLOR, ap_color, rgb
from logs.foxglove_parts import HALL_FRAME, WORLD_FRAME, Xyz
from logs.foxglove_stamp import packed, stamp_field, tag
from logs.records import HANDOVER, LINKS, NO_AP, OUTAGE
from logs.wire import I64, LEN, block

SNAP_M = 1 / 1024
"""Positions on /tf and /scene/links are multiples of this [m]; records keep full precision."""

_DASHES = 5
_BAR_M = 1.0  # height of the bar over a robot without service

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]


def _eights(numbers: ArrayLike) -> Bytes:
    """(n, 8 k) the bytes of (n,) or (n, k) doubles as they lie in a message."""
    rows = np.ascontiguousarray(numbers, dtype="<f8")
    return rows.reshape(len(rows), -1).view(np.uint8)


@dataclass(frozen=True, slots=True)
class Places:
    """Where the robots on the floor are [m], on the raster of `SNAP_M`."""

    robot: tuple[int, ...]
    x_m: Floats
    y_m: Floats

    @classmethod
    def of(cls, robot: tuple[int, ...], x_m: ArrayLike, y_m: ArrayLike) -> Places:
        """Snap places (n,) [m] to the raster."""
        return cls(robot, snap(x_m), snap(y_m))


def snap(metres: ArrayLike) -> Floats:
    """Positions on the raster of `SNAP_M`; of two that are equally near, the even one."""
    # Adding 0 makes 0 of −0, which protobuf would write.
    return np.asarray(np.rint(np.asarray(metres, np.float64) / SNAP_M) * SNAP_M + 0.0)


@dataclass(frozen=True, slots=True)
class _Layout:
    """A message with room for numbers.

    Attributes:
        content: (B,) its bytes.
        stamps: (n + 1, S) where the bytes of the timestamps are.
        numbers: (n, 32) where those of x, y, z and w are.
    """

    content: Bytes
    stamps: NDArray[np.intp]
    numbers: NDArray[np.intp]


class Transforms:
    """Packs `foxglove.FrameTransforms`: world → hall, and world → robot for all on the floor."""

    _EACH = tag(FrameTransforms, "transforms", LEN)
    # translation {x, y} and rotation {z, w}; z, and x and y of the rotation, are 0 and left out
    _TWO = struct.Struct("<3sdsd")
    _MOVE = (
        tag(FrameTransform, "translation", LEN) + b"\x12" + tag(Vector3, "x", I64),
        tag(Vector3, "y", I64),
    )
    _TURN = (
        tag(FrameTransform, "rotation", LEN) + b"\x12" + tag(Quaternion, "z", I64),
        tag(Quaternion, "w", I64),
    )

    def __init__(self, robots: tuple[str, ...]) -> None:
        parent = block(tag(FrameTransform, "parent_frame_id", LEN), WORLD_FRAME.encode())
        child = tag(FrameTransform, "child_frame_id", LEN)
        self._heads = [parent + block(child, name.encode()) for name in robots]
        self._hall = parent + block(child, HALL_FRAME.encode())
        tail = self._TWO.pack(self._MOVE[0], 0.0, self._MOVE[1], 0.0)
        self._tail = tail + self._TWO.pack(self._TURN[0], 0.0, self._TURN[1], 1.0)
        # Where x, y, z and w are in it.
        gaps = np.cumsum([len(gap) for gap in (*self._MOVE, *self._TURN)])
        self._number_at = (gaps + 8 * np.arange(4))[:, None] + np.arange(8)
        self._robot: tuple[int, ...] = ()  # what the layouts are for
        self._layouts: dict[int, _Layout] = {}  # by the length of the timestamp
        self._each: dict[int, list[bytes]] = {}  # the hall's and all robots' transforms, likewise
        self._headings: Sequence[float] = ()
        self._turns: Floats = np.empty((0, 2))

    def pack(self, places: Places, headings: Sequence[float], now: int) -> bytes:
        """The transforms of all robots at these places, after that of the hall."""
        stamp = stamp_field(now)
        if places.robot != self._robot:
            self._robot, self._layouts = places.robot, {}
        layout = self._layouts.get(len(stamp))
        if layout is None:
            layout = self._layouts[len(stamp)] = self._lay_out(len(stamp))
        layout.content[layout.stamps] = np.frombuffer(stamp, np.uint8)
        if headings != self._headings or len(self._turns) != len(headings):
            self._headings = headings
            self._turns = np.array(list(map(_turn, headings))).reshape(-1, 2)
        if places.robot:
            numbers = np.empty((len(places.robot), 4), "<f8")
            numbers[:, 0], numbers[:, 1], numbers[:, 2:] = places.x_m, places.y_m, self._turns
            layout.content[layout.numbers] = _eights(numbers)
        return layout.content.tobytes()

    def _lay_out(self, stamp_bytes: int) -> _Layout:
        """The message of the robots on the floor with room for timestamps of this length."""
        heads = [self._hall, *self._heads]
        if stamp_bytes not in self._each:
            room = bytes(stamp_bytes)
            self._each[stamp_bytes] = [block(self._EACH, room + h + self._tail) for h in heads]
        each, there = self._each[stamp_bytes], [0, *(i + 1 for i in self._robot)]
        tail_at = np.cumsum([len(each[k]) for k in there]) - len(self._tail)
        stamp_at = tail_at - stamp_bytes - [len(heads[k]) for k in there]
        # The hall, which is the first, never moves.
        number_at = tail_at[1:, None, None] + self._number_at
        return _Layout(
            np.frombuffer(b"".join([each[k] for k in there]), np.uint8).copy(),
            stamp_at[:, None] + np.arange(stamp_bytes),
            number_at.reshape(len(number_at), 32),
        )


@lru_cache(maxsize=1024)  # robots on a grid have few headings
def _turn(heading: float) -> tuple[float, float]:
    """Z and w of the quaternion."""
    # Adding 0 makes 0 of −0, which is the same turn, and the same key.
    return math.sin(heading / 2) + 0.0, math.cos(heading / 2)


class Lines:
    """Packs scenes that are one entity with lists of lines, all of them told in each message.

    An entity of the same id replaces the one before it, so a scene without lines clears the topic.
    """

    _POINT = struct.Struct("<3sdsdsd")
    _POINT_X = tag(LinePrimitive, "points", LEN) + b"\x1b" + tag(Point3, "x", I64)
    _POINT_Y, _POINT_Z = tag(Point3, "y", I64), tag(Point3, "z", I64)
    _COLORS, _LINES = tag(LinePrimitive, "colors", LEN), tag(SceneEntity, "lines", LEN)
    _ENTITIES = tag(SceneUpdate, "entities", LEN)

    def __init__(self, name: str, thickness_m: float) -> None:
        self._line = packed(
            LinePrimitive(
                type=LinePrimitive.LINE_LIST,
                pose=Pose(orientation=Quaternion(w=1.0)),
                thickness=thickness_m,
            )
        )
        self._entity = packed(SceneEntity(frame_id=WORLD_FRAME, id=name))

    @classmethod
    def point(cls, x: float, y: float, z: float) -> bytes:
        """A point of a line [m]."""
        return cls._POINT.pack(cls._POINT_X, x, cls._POINT_Y, y, cls._POINT_Z, z)

    @classmethod
    def pair(cls, color: tuple[float, float, float], alpha: float = 0.9) -> bytes:
        """The colours of both ends of a line."""
        red, green, blue = color
        return 2 * block(cls._COLORS, packed(Color(r=red, g=green, b=blue, a=alpha)))

    def scene(self, lines: bytes, now: int) -> bytes:
        """The whole `foxglove.SceneUpdate` of packed points and colours."""
        entity = self._entity + stamp_field(now)
        if lines:
            entity += block(self._LINES, self._line + lines)
        return block(self._ENTITIES, entity)


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
        here = self.point(0.0, 0.0, antenna_m)
        self._width = 2 * len(here)
        self._x = slice(len(self._POINT_X), len(self._POINT_X) + 8)
        self._y = slice(self._x.stop + len(self._POINT_Y), self._x.stop + len(self._POINT_Y) + 8)
        # A line to each AP from x = y = 0; the last row is for robots without one.
        rows = [here + there for there in (*self._ap_points, here)]
        self._rows = np.frombuffer(b"".join(rows), np.uint8).reshape(-1, self._width)
        self._colors = [self.pair(ap_color(k)) for k in range(len(aps))]
        self._outage = self.pair(rgb(OUTAGE_COLOR))
        self._dashes = self.pair(rgb(HANDOVER_COLOR)) * _DASHES
        self._handover = LINKS.index(HANDOVER)
        self._connected = np.array([name not in {OUTAGE, NO_AP, HANDOVER} for name in LINKS])

    def pack(self, places: Places, aps: Sequence[int], links: Sequence[int]) -> bytes:
        """Points and colours of all lines."""
        if not places.robot:
            return b""
        serving = np.array(aps)
        rows = self._rows[serving]
        rows[:, self._x], rows[:, self._y] = _eights(places.x_m), _eights(places.y_m)
        lines: bytes = rows.tobytes()
        others = np.flatnonzero((serving < 0) | ~self._connected[np.array(links)]).tolist()
        if not others:
            return lines + b"".join([self._colors[ap] for ap in aps])
        points, done = list[bytes](), 0
        colors = [self._colors[ap] if ap >= 0 else b"" for ap in aps]
        for k in others:
            points.append(lines[done * self._width : k * self._width])
            done = k + 1
            here = (float(places.x_m[k]), float(places.y_m[k]), self._antenna_m)
            special, colors[k] = self._special(here, aps[k], links[k])
            points += special
        return b"".join([*points, lines[done * self._width :], *colors])

    def _special(self, here: Xyz, ap: int, link: int) -> tuple[list[bytes], bytes]:
        """Points and colours of a robot that is not connected."""
        x, y, z = here
        if ap >= 0 and link == self._handover:
            return self._dash_points(here, self._aps[ap]), self._dashes
        bar = [self.point(x, y, z), self.point(x, y, z + _BAR_M)]
        if ap < 0:
            return bar, self._outage
        return [*bar, self.point(x, y, z), self._ap_points[ap]], 2 * self._outage

    def _dash_points(self, here: Xyz, there: Xyz) -> list[bytes]:
        steps = np.arange(2 * _DASHES) / (2 * _DASHES - 1)
        places = snap(np.array(here) + (np.array(there) - here) * steps[:, None])
        return [self.point(*place) for place in places.tolist()]
