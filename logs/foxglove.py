"""Pictures of a run for Foxglove: scenes, coverage grid and log lines as `foxglove.*` messages.

All positions are in metres in the frame `world`: x and y along the hall's walls, z up, the floor at
z = 0. Messages hold all there is to see on their topic (a seek delivers the last one only), their
timestamps are put in by `Stamped`. When and in which order they are written is for
`logs.foxglove_view` to say.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector2_pb2 import Vector2
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from numpy.typing import NDArray

from logs.colors import ap_color, rgb
from logs.foxglove_parts import (
    WORLD_FRAME,
    Xyz,
    ball,
    cube,
    entity,
    label,
    polyline,
    pose,
    rgba,
    text_size,
    timestamp,
)
from logs.foxglove_stamp import Stamped, packed, tag
from logs.records import (
    Arrival,
    Disturbance,
    Handover,
    Incident,
    Record,
    Replan,
    RunEnd,
    RunStart,
)
from logs.wire import LEN, block
from planner.plan import Path, Plan
from planner.prices import Prices
from planner.problem import Problem
from worlds.floor import Floor
from worlds.places import position_m, position_of
from worlds.radio_map import RadioMap, kept_vertices
from worlds.world import World

NO_POSITION_DB = -1000.0
"""Value of cells without a free position: below any colour range (shaders differ on NaN)."""
COVERAGE_HEIGHT_M = 0.02
NO_POSITION_PRICE = -1.0
"""Price of cells without a position of the problem: below that of free ones, which is 0."""
CONGESTION_HEIGHT_M = 0.025
SERVER_HEIGHT_M = 0.022
_NO_SERVER, _SERVER_ALPHA = 255, 130
PATH_HEIGHT_M = 0.05


def ap_positions(world: World, ap_ids: Iterable[str]) -> list[Xyz]:
    """Where the antennas of these APs are [m]."""
    places = {ap.id: ap.position_m for ap in world.ap}
    return [places[name] for name in ap_ids]


# --- scenes -------------------------------------------------------------------------------------


def static_scene(world: World, floor: Floor, problem: Problem) -> SceneUpdate:
    """The hall: floor, obstacles, APs with their names, stations, and the graph of moves."""
    width, depth = world.hall.size_m
    text_m = text_size(world)
    entities = [
        entity(
            "floor", cubes=[cube((width / 2, depth / 2, -0.01), (width, depth, 0.02), "#2b2f36")]
        )
    ]
    named = {obstacle.name for obstacle in world.obstacle if obstacle.name}
    boxes = floor.boxes
    for k, name in enumerate(boxes.name):
        center, half = boxes.center_m[k], boxes.half_m[k]
        top = (float(center[0]), float(center[1]), float(center[2] + half[2]) + text_m)
        entities.append(
            entity(
                f"obstacle/{k}",
                cubes=[cube(center, 2 * half, "#8a7f72", 0.9, float(boxes.yaw_rad[k]))],
                texts=[label(top, name, text_m)] if name in named else [],
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
        name = f"{ap.id} (m = {problem.ap_capacity[k]})" if k is not None else f"{ap.id} (off)"
        entities.append(
            entity(
                f"ap/{ap.id}",
                cubes=[cube((x, y, z), (0.3, 0.3, 0.15), color)],
                lines=[polyline([(x, y, 0.0), (x, y, z)], 0.04, color, 0.5)],
                texts=[label((x, y, z + text_m), name, text_m)],
            )
        )
    return entities


def _station_entities(world: World, floor: Floor, text_m: float) -> list[SceneEntity]:
    entities = []
    for station in world.station:
        if station.at_m is not None:
            x, y = station.at_m
        else:
            x, y = position_m(world.hall, position_of(world.hall, station))
        side = 0.8 * floor.pitch_m
        disc = CylinderPrimitive(
            pose=pose((x, y, 0.03)),
            size=Vector3(x=side, y=side, z=0.02),
            bottom_scale=1.0,
            top_scale=1.0,
            color=rgba("#ffffff", 0.35),
        )
        name = label((x, y, text_m), station.name, 0.7 * text_m)
        entities.append(entity(f"station/{station.name}", cylinders=[disc], texts=[name]))
    return entities


def _graph_entity(problem: Problem) -> SceneEntity:
    """Edges of G, faint; each vertex is written once and the edges refer to it by index."""
    line = polyline(
        [(float(x), float(y), 0.03) for x, y in problem.xy_m], 0.02, rgb("#9aa4b2"), alpha=0.3
    )
    line.type = LinePrimitive.LINE_LIST
    line.indices.extend(problem.edge_uv.ravel().tolist())
    lines = [line] if len(problem.edge_uv) else []
    if problem.edge_oneway.any():
        lines.append(_chevrons(problem))
    return entity("graph", lines=lines)


def _chevrons(problem: Problem) -> LinePrimitive:
    """An open arrow head in the middle of each one-way edge."""
    u, v = (problem.xy_m[end] for end in problem.edge_uv[problem.edge_oneway].T)
    way = v - u
    length = np.hypot(way[:, 0], way[:, 1])[:, None]
    head = way / length * np.minimum(0.6, 0.3 * length)
    tip = (u + v + head) / 2
    left = np.column_stack((-head[:, 1], head[:, 0])) / 2
    corners = np.stack((tip - head + left, tip, tip, tip - head - left), axis=1)
    points = [(float(x), float(y), 0.03) for x, y in corners.reshape(-1, 2)]
    arrows = polyline(points, 0.04, rgb("#9aa4b2"), alpha=0.6)
    arrows.type = LinePrimitive.LINE_LIST
    return arrows


def robot_body(world: World, name: str) -> SceneEntity:
    """A robot's body in its own frame, moving with it: box, white nose, antenna and name."""
    body = world.hall.body
    length, width, height = body.length_m, body.width_m, body.height_m
    nose = cube((0.4 * length, 0, height), (0.2 * length, 0.6 * width, 0.1), "#ffffff")
    mast = polyline([(0, 0, height), (0, 0, body.antenna_m)], 0.04, rgb("#dddddd"))
    return entity(
        f"robot/{name}",
        frame=name,
        frame_locked=True,
        cubes=[cube((0, 0, height / 2), (length, width, height), "#5d6b7d"), nose],
        lines=[mast] if body.antenna_m > height else [],
        texts=[label((0, 0, max(height, body.antenna_m) + 0.3), name, 0.5 * length)],
    )


class Fleet:
    """The bodies of all robots, packed once."""

    _FRAME, _ID = tag(SceneEntity, "frame_id", LEN), tag(SceneEntity, "id", LEN)
    _TEXTS, _TEXT = tag(SceneEntity, "texts", LEN), tag(TextPrimitive, "text", LEN)

    def __init__(self, world: World, names: Sequence[str]) -> None:
        self._size_m = text_size(world)
        self._beside = (0.0, world.hall.size_m[1] + self._size_m, 0.5)
        # All bodies are alike but for their name, which is the last field of the last field.
        model = robot_body(world, "")
        text = packed(model.texts[0])
        del model.texts[:]
        model.ClearField("id")
        common = packed(model)
        self._bodies: list[bytes] = []
        self._gone: list[bytes] = []
        for name in names:
            body = f"robot/{name}"
            head = block(self._FRAME, name.encode()) if name else b""
            words = text + (block(self._TEXT, name.encode()) if name else b"")
            self._bodies.append(
                head + block(self._ID, body.encode()) + common + block(self._TEXTS, words)
            )
            self._gone.append(packed(SceneEntityDeletion(id=body)))

    def scene(self, on_floor: Sequence[int]) -> Stamped:
        """The bodies of the robots on the floor.

        The others are deleted by name, so that they vanish; a line beside the hall counts those on
        the floor, so that no message only deletes.
        """
        present = set(on_floor)
        count = f"{len(present)} of {len(self._bodies)} robots on the floor"
        fleet = entity("fleet", texts=[label(self._beside, count, self._size_m)])
        return Stamped.scene(
            [packed(fleet), *(self._bodies[i] for i in sorted(present))],
            [gone for i, gone in enumerate(self._gone) if i not in present],
        )


def plan_scene(problem: Problem, plan: Plan) -> SceneUpdate:
    """Every robot's path as planned, coloured by the AP that serves it; a ball at each handover."""
    return SceneUpdate(
        entities=[_path_entity(problem, path) for path in plan.paths if path is not None]
    )


def _path_entity(problem: Problem, path: Path) -> SceneEntity:
    xy = problem.xy_m[path.vertices]
    points = [(x, y, PATH_HEIGHT_M) for x, y in xy.tolist()]
    cuts = (np.flatnonzero(np.diff(path.aps)) + 1).tolist()
    lines, balls = [], []
    for begin, end in zip([0, *cuts], [*cuts, len(points)], strict=True):
        color = ap_color(int(path.aps[begin]))
        # A crossing is served by the AP of the vertex it leaves (§1.6), so the line goes on to the
        # first vertex of the next AP. Waits are one point.
        run = _corners(points[begin : end + 1])
        if len(run) > 1:
            lines.append(polyline(run, 0.06, color, 0.8))
        if begin:
            balls.append(ball(points[begin], 0.25, color))
    return entity(f"path/{path.robot}", lines=lines, spheres=balls)


def _corners(line: Sequence[Xyz]) -> list[Xyz]:
    """A line without repeated points and without points on a straight piece of it."""
    kept: list[Xyz] = []
    for point in line:
        if kept and point == kept[-1]:
            continue
        if len(kept) > 1:
            (ax, ay, _), (bx, by, _) = kept[-2:]
            step, following = (bx - ax, by - ay), (point[0] - bx, point[1] - by)
            turn = step[0] * following[1] - step[1] * following[0]
            ahead = step[0] * following[0] + step[1] * following[1]
            if abs(turn) < 1e-9 and ahead > 0:
                kept.pop()
        kept.append(point)
    return kept


def coverage_grid(floor: Floor, radio_map: RadioMap, ap: int | None = None) -> Grid:
    """SNR at every position of the grid, `NO_POSITION_DB` where none is free.

    Args:
        floor: the one the map was made for.
        radio_map: the map.
        ap: index of an AP; the best one of each position when left out.
    """
    snr_db = radio_map.snr_db
    snr = snr_db.max(axis=1, initial=NO_POSITION_DB) if ap is None else snr_db[:, ap]
    cells = np.append(snr, NO_POSITION_DB)[floor.vertex_grid()].astype("<f4")
    return _grid(floor, cells, "snr_db", COVERAGE_HEIGHT_M)


def best_server_grid(floor: Floor, radio_map: RadioMap) -> Grid:
    """The AP of highest SNR at every position, in its colour; clear where nothing covers it.

    One byte each of red, green, blue and alpha, which viewers show as they are, and of the index of
    the AP in the problem (255: none covers the position, or there is none).
    """
    fields = ("red", "green", "blue", "alpha", "ap")
    cell = np.zeros((len(floor.vertex_xy_m) + 1, len(fields)), np.uint8)
    cell[:, 4] = _NO_SERVER
    if radio_map.snr_db.size:
        best = radio_map.snr_db.argmax(axis=1)  # ties: lowest index, as the objective `snr` has it
        colors = np.array([ap_color(k) for k in range(len(radio_map.ap_ids))])
        covered = np.flatnonzero(radio_map.covered.any(axis=1))
        cell[covered, :3] = np.round(255 * colors[best[covered]])
        cell[covered, 3] = _SERVER_ALPHA
        cell[covered, 4] = np.minimum(best[covered], _NO_SERVER)
    cells = cell[floor.vertex_grid()]
    grid = _grid(floor, cells, "", SERVER_HEIGHT_M, len(fields))
    del grid.fields[:]
    for offset, name in enumerate(fields):
        grid.fields.add(name=name, offset=offset, type=PackedElementField.UINT8)
    return grid


def congestion_grid(floor: Floor, radio_map: RadioMap, problem: Problem, prices: Prices) -> Grid:
    """Price of every position, half of those of its ways included [slots, or cost units].

    `NO_POSITION_PRICE` where the problem has no position.
    """
    price = np.full(len(floor.vertex_xy_m) + 1, NO_POSITION_PRICE)
    price[kept_vertices(radio_map)] = prices.in_units(prices.around(problem.edge_uv))
    cells = price[floor.vertex_grid()].astype("<f4")
    return _grid(floor, cells, "price", CONGESTION_HEIGHT_M)


def _grid(
    floor: Floor, cells: NDArray[np.generic], field: str, height_m: float, stride: int = 4
) -> Grid:
    """One little-endian float32, or `stride` bytes, per position; row 0 is that of the least y."""
    x, y = (c - floor.cell_m / 2 for c in floor.origin_m)
    return Grid(
        frame_id=WORLD_FRAME,
        pose=pose((x, y, height_m)),
        column_count=floor.columns,
        cell_size=Vector2(x=floor.cell_m, y=floor.cell_m),
        row_stride=stride * floor.columns,
        cell_stride=stride,
        fields=[PackedElementField(name=field, offset=0, type=PackedElementField.FLOAT32)],
        data=cells.tobytes(),
    )


# --- log lines ----------------------------------------------------------------------------------

_ERRORS = {"collision", "contact", "obstacle", "caught", "deadlock"}


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
            text = f"handover {record.from_ap or 'none'} → {record.to_ap} at {where}, {lasts}"
            if not record.planned:
                level, text = Log.WARNING, text + ", not in the plan"
        case Arrival():
            name, text = record.robot, f"arrived at vertex {record.vertex} in slot {record.slot}"
        case Incident():
            name = record.robot or record.ap or name
            level = Log.ERROR if record.kind in _ERRORS else Log.WARNING
            text = f"{record.kind}: {record.message}"
        case Disturbance():
            name = record.robot or record.ap or record.name or name
            level = Log.WARNING if record.begins else Log.INFO
            text = f"{record.kind}: {record.message}"
        case Replan():
            level = Log.WARNING
            text = f"replan {record.number} ({record.cause}): {record.message}"
        case _:
            return None
    return Log(timestamp=timestamp(log_time_ns), level=level, message=text, name=name)
