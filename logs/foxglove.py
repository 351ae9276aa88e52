"""Pictures of a run for Foxglove: scenes, coverage grid and log lines as `foxglove.*` messages.

All positions are in metres in the frame `world`: x and y along the hall's walls, z up, the floor at
z = 0. Messages hold all there is to see on their topic (a seek delivers the last one only), their
timestamps are set by `stamp`. When and in which order they are written is `logs.foxglove_view`'s.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector2_pb2 import Vector2
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from logs.records import Arrival, Handover, Incident, Record, RunEnd, RunStart
from planner.plan import Path, Plan
from planner.prices import Prices
from planner.problem import Problem
from worlds.floor import Floor
from worlds.radio_map import RadioMap, kept_vertices
from worlds.world import World

WORLD_FRAME = "world"
HALL_FRAME = "hall"
"""A child of `world` that never moves: it keeps `world` known when no robot is on the floor."""

AP_COLORS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#f0e442")
"""Okabe and Ito's palette for colour-blind readers without its black and its vermillion, which is
too close to the red of an outage (https://jfly.uni-koeln.de/color/)."""
OUTAGE_COLOR = "#d7191c"
HANDOVER_COLOR = "#e6e6e6"

NO_POSITION_DB = -1000.0
"""Value of cells without a free position: below any colour range (shaders differ on NaN)."""
COVERAGE_HEIGHT_M = 0.02
NO_POSITION_PRICE = -1.0
"""Price of cells without a position of the problem: below that of free ones, which is 0."""
CONGESTION_HEIGHT_M = 0.025
PATH_HEIGHT_M = 0.05

Xyz = tuple[float, float, float]


def ap_color(index: int) -> tuple[float, float, float]:
    """Colour of the AP of that index, each part 0 … 1; from the seventh on a darker round."""
    shade = 0.65 ** (index // len(AP_COLORS))
    red, green, blue = rgb(AP_COLORS[index % len(AP_COLORS)])
    return red * shade, green * shade, blue * shade


def rgb(hexadecimal: str) -> tuple[float, float, float]:
    """(red, green, blue), each 0 … 1, of "#rrggbb"."""
    red, green, blue = (int(hexadecimal[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return red, green, blue


def timestamp(log_time_ns: int) -> Timestamp:
    """A log time as protobuf writes it."""
    return Timestamp(seconds=log_time_ns // 10**9, nanos=log_time_ns % 10**9)


def stamp(message: Any, log_time_ns: int) -> bytes:
    """The bytes of a scene or grid, all its timestamps set to `log_time_ns`."""
    now = timestamp(log_time_ns)
    scene = isinstance(message, SceneUpdate)
    for part in (*message.entities, *message.deletions) if scene else (message,):
        part.timestamp.CopyFrom(now)
    data: bytes = message.SerializeToString(deterministic=True)
    return data


def grid_origin(floor: Floor) -> tuple[float, float]:
    """Where column 0, row 0 of the grid of positions stands [m], blocked or not."""
    x, y = floor.vertex_xy_m[0] - floor.vertex_cell[0] * floor.pitch_m
    return float(x), float(y)


def ap_positions(world: World, ap_ids: Iterable[str]) -> list[Xyz]:
    """Where the antennas of these APs are [m]."""
    places = {ap.id: ap.position_m for ap in world.ap}
    return [places[name] for name in ap_ids]


# --- scenes -------------------------------------------------------------------------------------


def static_scene(world: World, floor: Floor, problem: Problem) -> SceneUpdate:
    """The hall: floor, obstacles, APs with their names, stations, and the graph of moves."""
    width, depth = world.hall.size_m
    text_m = _text_size(world)
    entities = [
        _entity(
            "floor", cubes=[_cube((width / 2, depth / 2, -0.01), (width, depth, 0.02), "#2b2f36")]
        )
    ]
    named = {obstacle.name for obstacle in world.obstacle if obstacle.name}
    boxes = floor.boxes
    for k, name in enumerate(boxes.name):
        center, half = boxes.center_m[k], boxes.half_m[k]
        top = (float(center[0]), float(center[1]), float(center[2] + half[2]) + text_m)
        entities.append(
            _entity(
                f"obstacle/{k}",
                cubes=[_cube(center, 2 * half, "#8a7f72", 0.9, float(boxes.yaw_rad[k]))],
                texts=[_text(top, name, text_m)] if name in named else [],
                metadata=[KeyValuePair(key="name", value=name)],
            )
        )
    entities += _ap_entities(world, problem, text_m)
    entities += _station_entities(world, floor, text_m)
    entities.append(_graph_entity(problem))
    return SceneUpdate(entities=entities)


def _ap_entities(world: World, problem: Problem, text_m: float) -> list[SceneEntity]:
    index = {name: k for k, name in enumerate(problem.ap_ids)}
    entities = []
    for ap in world.ap:
        x, y, z = ap.position_m
        k = index.get(ap.id)
        color = ap_color(k) if k is not None else rgb("#777777")
        label = f"{ap.id} (m = {problem.ap_capacity[k]})" if k is not None else f"{ap.id} (off)"
        entities.append(
            _entity(
                f"ap/{ap.id}",
                cubes=[_cube((x, y, z), (0.3, 0.3, 0.15), color)],
                lines=[_lines([(x, y, 0.0), (x, y, z)], 0.04, color, 0.5)],
                texts=[_text((x, y, z + text_m), label, text_m)],
            )
        )
    return entities


def _station_entities(world: World, floor: Floor, text_m: float) -> list[SceneEntity]:
    x0, y0 = grid_origin(floor)
    entities = []
    for station in world.station:
        if station.at_m is not None:
            x, y = station.at_m
        elif station.cell is not None:
            column, row = station.cell
            x, y = x0 + column * floor.pitch_m, y0 + row * floor.pitch_m
        else:
            continue
        side = 0.8 * floor.pitch_m
        disc = CylinderPrimitive(
            pose=_pose((x, y, 0.03)),
            size=Vector3(x=side, y=side, z=0.02),
            bottom_scale=1.0,
            top_scale=1.0,
            color=_color("#ffffff", 0.35),
        )
        name = _text((x, y, text_m), station.name, 0.7 * text_m)
        entities.append(_entity(f"station/{station.name}", cylinders=[disc], texts=[name]))
    return entities


def _graph_entity(problem: Problem) -> SceneEntity:
    """Edges of G, faint; each vertex is written once and the edges refer to it by index."""
    line = _lines(
        [(float(x), float(y), 0.03) for x, y in problem.xy_m], 0.02, rgb("#9aa4b2"), alpha=0.3
    )
    line.type = LinePrimitive.LINE_LIST
    line.indices.extend(problem.edge_uv.ravel().tolist())
    return _entity("graph", lines=[line] if len(problem.edge_uv) else [])


def robot_body(world: World, name: str) -> SceneEntity:
    """A robot's body in its own frame, moving with it: box, white nose, antenna and name."""
    body = world.hall.body
    length, width, height = body.length_m, body.width_m, body.height_m
    nose = _cube((0.4 * length, 0, height), (0.2 * length, 0.6 * width, 0.1), "#ffffff")
    mast = _lines([(0, 0, height), (0, 0, body.antenna_m)], 0.04, rgb("#dddddd"))
    return _entity(
        f"robot/{name}",
        frame=name,
        frame_locked=True,
        cubes=[_cube((0, 0, height / 2), (length, width, height), "#5d6b7d"), nose],
        lines=[mast] if body.antenna_m > height else [],
        texts=[_text((0, 0, max(height, body.antenna_m) + 0.3), name, 0.5 * length)],
    )


def robots_scene(
    world: World, bodies: Sequence[SceneEntity], on_floor: Sequence[int]
) -> SceneUpdate:
    """The bodies of the robots on the floor (indices into `bodies`, one per robot).

    The others are deleted by name, so that they vanish; a line beside the hall counts those on the
    floor, so that no message only deletes.
    """
    present = set(on_floor)
    size = _text_size(world)
    count = f"{len(present)} of {len(bodies)} robots on the floor"
    fleet = _entity("fleet", texts=[_text((0.0, world.hall.size_m[1] + size, 0.5), count, size)])
    return SceneUpdate(
        entities=[fleet, *(bodies[i] for i in sorted(present))],
        deletions=[
            SceneEntityDeletion(id=body.id) for i, body in enumerate(bodies) if i not in present
        ],
    )


def plan_scene(problem: Problem, plan: Plan) -> SceneUpdate:
    """Every robot's path as planned, coloured by the AP that serves it; a ball at each handover."""
    return SceneUpdate(
        entities=[_path_entity(problem, path) for path in plan.paths if path is not None]
    )


def _path_entity(problem: Problem, path: Path) -> SceneEntity:
    xy = problem.xy_m[path.vertices]
    points = [(float(x), float(y), PATH_HEIGHT_M) for x, y in xy]
    cuts = (np.flatnonzero(np.diff(path.aps)) + 1).tolist()
    lines, balls = [], []
    for begin, end in zip([0, *cuts], [*cuts, len(points)], strict=True):
        color = ap_color(int(path.aps[begin]))
        # A crossing is served by the AP of the vertex it leaves (§1.6), so the line goes on to the
        # first vertex of the next AP. Waits are one point.
        run = points[begin : end + 1]
        run = [p for k, p in enumerate(run) if k == 0 or p != run[k - 1]]
        if len(run) > 1:
            lines.append(_lines(run, 0.06, color, 0.8))
        if begin:
            balls.append(
                SpherePrimitive(
                    pose=_pose(points[begin]),
                    size=Vector3(x=0.25, y=0.25, z=0.25),
                    color=_color(color, 0.9),
                )
            )
    return _entity(f"path/{path.robot}", lines=lines, spheres=balls)


def coverage_grid(floor: Floor, radio_map: RadioMap) -> Grid:
    """SNR of the best AP at every position of the grid; `NO_POSITION_DB` where none is free."""
    cells = np.full((floor.rows, floor.columns), NO_POSITION_DB, dtype="<f4")
    columns, rows = floor.vertex_cell.T
    cells[rows, columns] = radio_map.snr_db.max(axis=1, initial=NO_POSITION_DB)
    return _grid(floor, cells, "snr_db", COVERAGE_HEIGHT_M)


def congestion_grid(floor: Floor, radio_map: RadioMap, problem: Problem, prices: Prices) -> Grid:
    """Price of every position, half of those of its ways included [slots, or cost units].

    `NO_POSITION_PRICE` where the problem has no position.
    """
    cells = np.full((floor.rows, floor.columns), NO_POSITION_PRICE, dtype="<f4")
    columns, rows = floor.vertex_cell[kept_vertices(radio_map)].T
    cells[rows, columns] = prices.in_units(prices.around(problem.edge_uv))
    return _grid(floor, cells, "price", CONGESTION_HEIGHT_M)


def _grid(floor: Floor, cells: NDArray[np.float32], field: str, height_m: float) -> Grid:
    """One little-endian float32 per position of the grid; row 0 is that of the least y."""
    x, y = (c - floor.pitch_m / 2 for c in grid_origin(floor))
    return Grid(
        frame_id=WORLD_FRAME,
        pose=_pose((x, y, height_m)),
        column_count=floor.columns,
        cell_size=Vector2(x=floor.pitch_m, y=floor.pitch_m),
        row_stride=4 * floor.columns,
        cell_stride=4,
        fields=[PackedElementField(name=field, offset=0, type=PackedElementField.FLOAT32)],
        data=cells.tobytes(),
    )


# --- log lines ----------------------------------------------------------------------------------

_ERRORS = {"collision", "contact", "obstacle"}


def log_line(record: Record, log_time_ns: int) -> Log | None:
    """The line that tells a record in words, None for records that come all the time."""
    level, name = Log.INFO, "run"
    match record:
        case RunStart():
            text = f"{record.world}: {len(record.robots)} robots, {len(record.aps)} APs"
        case RunEnd():
            level = Log.INFO if record.verdict == "completed" else Log.ERROR
            text = f"{record.verdict} in slot {record.slot}"
            text += f": {record.message}" if record.message else ""
        case Handover():
            name = record.robot
            where = f"vertex {record.vertex}"
            if record.next_vertex != record.vertex:
                where += f" → {record.next_vertex}"
            lasts = f"{1000 * (record.end_s - record.t_s):.0f} ms"
            text = f"handover {record.from_ap} → {record.to_ap} at {where}, {lasts}"
            if not record.planned:
                level, text = Log.WARNING, text + ", not in the plan"
        case Arrival():
            name, text = record.robot, f"arrived at vertex {record.vertex} in slot {record.slot}"
        case Incident():
            name = record.robot or record.ap or name
            level = Log.ERROR if record.kind in _ERRORS else Log.WARNING
            text = f"{record.kind}: {record.message}"
        case _:
            return None
    return Log(timestamp=timestamp(log_time_ns), level=level, message=text, name=name)


# --- primitives ---------------------------------------------------------------------------------


def _text_size(world: World) -> float:
    """Height of labels [m]: to be read with the whole hall in view."""
    return min(2.0, max(0.3, max(world.hall.size_m) / 40))


def _color(color: str | tuple[float, float, float], alpha: float = 1.0) -> Color:
    red, green, blue = rgb(color) if isinstance(color, str) else color
    return Color(r=red, g=green, b=blue, a=alpha)


def _pose(position: Sequence[float], yaw: float = 0.0) -> Pose:
    x, y, z = (float(c) for c in position)
    turn = Quaternion(z=math.sin(yaw / 2), w=math.cos(yaw / 2))
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=turn)


def _cube(
    center: Sequence[float],
    size: Sequence[float],
    color: str | tuple[float, float, float],
    alpha: float = 1.0,
    yaw: float = 0.0,
) -> CubePrimitive:
    x, y, z = (float(s) for s in size)
    return CubePrimitive(
        pose=_pose(center, yaw), size=Vector3(x=x, y=y, z=z), color=_color(color, alpha)
    )


def _text(position: Sequence[float], text: str, size: float) -> TextPrimitive:
    return TextPrimitive(
        pose=_pose(position), billboard=True, font_size=size, color=_color("#ffffff"), text=text
    )


def _lines(
    points: Iterable[Xyz], thickness: float, color: tuple[float, float, float], alpha: float = 1.0
) -> LinePrimitive:
    return LinePrimitive(
        type=LinePrimitive.LINE_STRIP,
        pose=_pose((0, 0, 0)),
        thickness=thickness,
        points=[Point3(x=x, y=y, z=z) for x, y, z in points],
        color=_color(color, alpha),
    )


def _entity(
    name: str, *, frame: str = WORLD_FRAME, frame_locked: bool = False, **parts: Any
) -> SceneEntity:
    return SceneEntity(id=name, frame_id=frame, frame_locked=frame_locked, **parts)
