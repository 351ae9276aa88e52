"""Parts of Foxglove messages: frames, times and the primitives of scenes.

Positions are in metres in the frame `world`, quaternions have w = 1 unless turned, labels face the
camera.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp

from logs.colors import rgb
from worlds.world import World

WORLD_FRAME = "world"
HALL_FRAME = "hall"
"""A child of `world` that never moves: it keeps `world` known when no robot is on the floor."""

Xyz = tuple[float, float, float]
Paint = str | tuple[float, float, float]
"""A colour as "#rrggbb" or as red, green and blue, each 0 … 1."""


def timestamp(log_time_ns: int) -> Timestamp:
    """A log time as protobuf writes it."""
    return Timestamp(seconds=log_time_ns // 10**9, nanos=log_time_ns % 10**9)


def text_size(world: World) -> float:
    """Height of labels [m]: to be read with the whole hall in view."""
    return min(2.0, max(0.3, max(world.hall.size_m) / 40))


def rgba(paint: Paint, alpha: float = 1.0) -> Color:
    """A colour, given as "#rrggbb" or as three parts 0 … 1."""
    red, green, blue = rgb(paint) if isinstance(paint, str) else paint
    return Color(r=red, g=green, b=blue, a=alpha)


def pose(position: Sequence[float], yaw: float = 0.0) -> Pose:
    """A place [m] and a turn about the vertical [rad]."""
    x, y, z = (float(c) for c in position)
    turn = Quaternion(z=math.sin(yaw / 2), w=math.cos(yaw / 2))
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=turn)


def cube(
    center: Sequence[float],
    size: Sequence[float],
    paint: Paint,
    alpha: float = 1.0,
    yaw: float = 0.0,
) -> CubePrimitive:
    """A box of that size [m]."""
    x, y, z = (float(s) for s in size)
    return CubePrimitive(
        pose=pose(center, yaw), size=Vector3(x=x, y=y, z=z), color=rgba(paint, alpha)
    )


def ball(center: Sequence[float], size: float, paint: Paint, alpha: float = 0.9) -> SpherePrimitive:
    """A sphere of that diameter [m]."""
    return SpherePrimitive(
        pose=pose(center), size=Vector3(x=size, y=size, z=size), color=rgba(paint, alpha)
    )


def label(
    position: Sequence[float], text: str, size: float, paint: Paint = "#ffffff"
) -> TextPrimitive:
    """A text of that height [m] that faces the camera."""
    return TextPrimitive(
        pose=pose(position), billboard=True, font_size=size, color=rgba(paint), text=text
    )


def polyline(
    points: Iterable[Xyz], thickness: float, paint: Paint, alpha: float = 1.0
) -> LinePrimitive:
    """A line from point to point, that thick [m]."""
    return LinePrimitive(
        type=LinePrimitive.LINE_STRIP,
        pose=pose((0, 0, 0)),
        thickness=thickness,
        points=[Point3(x=x, y=y, z=z) for x, y, z in points],
        color=rgba(paint, alpha),
    )


def entity(
    name: str, *, frame: str = WORLD_FRAME, frame_locked: bool = False, **parts: Any
) -> SceneEntity:
    """An entity without an end; its id is unique on its topic."""
    return SceneEntity(id=name, frame_id=frame, frame_locked=frame_locked, **parts)
