"""From a `World` to its `Floor`: obstacles drawn, positions laid out, free moves found."""

from __future__ import annotations

import math

import numpy as np

from worlds.boxes import contains, footprint_hits, swept
from worlds.errands import robot_height_m, with_robots
from worlds.errors import Fault, WorldError
from worlds.floor import Boxes, Floor
from worlds.lanes import graph_floor
from worlds.places import NowhereError, millimetres, position_of, positions_m
from worlds.streams import stream
from worlds.world import World

__all__ = ["boxes_of", "resolve", "with_robots"]


def resolve(world: World) -> Floor:
    """The floor of a world: vertices, edges and errands, before any radio.

    A robot's antenna, its centre, stays within the hall by the layout of the grid; its body may
    reach over the edge of the floor. A position is free if a robot standing there touches no
    obstacle in any of its four headings (the square of its longer side). A move is free if the
    strip it sweeps, its width across and half its length beyond both ends, touches none either.
    Turning on the spot is taken to happen within the square. Obstacles whose underside is above
    the robot and its antenna are driven under.

    Vertices are numbered row by row from (0, 0); edges are sorted by (u, v), u < v, and take one
    slot. Of a graph see `worlds.lanes.graph_floor`. Random robots are drawn as if all were covered;
    see `with_robots`.

    Raises:
        WorldError: with all that is wrong, keys as in the world.
    """
    boxes = boxes_of(world)
    graph = world.hall.graph
    if graph is not None:
        faults = _outside(world, boxes)
        floor = graph_floor(world, graph, boxes, robot_height_m(world))
        positions = f"{len(graph.node)} nodes of the graph"
    else:
        faults = _body_faults(world) + _outside(world, boxes)
        floor = _grid_floor(world, boxes)
        positions = f"{floor.columns} x {floor.rows} positions"
    if not len(floor.vertex_xy_m):
        rule = f"none of the {positions} is free of obstacles"
        mend = "remove some or give a smaller pitch or body"
        faults.append(Fault(("hall",), f"{rule}; {mend}", "E113"))
    else:
        try:
            floor = with_robots(world, floor)
        except WorldError as error:
            faults += error.faults
    if faults:
        raise WorldError(faults)
    return floor


def _grid_floor(world: World, boxes: Boxes) -> Floor:
    """Vertices and edges of a hall with a grid, without robots."""
    hall, body = world.hall, world.hall.body
    columns, rows = hall.grid_positions
    xy = positions_m(hall)
    height = robot_height_m(world)

    half = max(body.length_m, body.width_m) / 2
    free = footprint_hits(boxes, xy, (half, half), body_height_m=height) < 0
    vertex = np.where(free, np.cumsum(free) - 1, -1).astype(np.int32).reshape(rows, columns)
    uv = np.concatenate(
        (
            np.column_stack((vertex[:, :-1].ravel(), vertex[:, 1:].ravel())),
            np.column_stack((vertex[:-1].ravel(), vertex[1:].ravel())),
        )
    )
    uv = uv[(uv >= 0).all(axis=1)]
    uv = uv[np.lexsort((uv[:, 1], uv[:, 0]))]
    vertex_xy = xy[free]
    strip = swept(vertex_xy[uv[:, 0]], vertex_xy[uv[:, 1]], body.length_m, body.width_m)
    uv = uv[footprint_hits(boxes, *strip, body_height_m=height) < 0]

    row, column = np.divmod(np.flatnonzero(free), columns)
    none = np.empty(0, dtype=np.int32)
    floor = Floor(
        pitch_m=hall.grid_pitch_m,
        slot_s=hall.grid_slot_s,
        columns=columns,
        rows=rows,
        boxes=boxes,
        vertex_xy_m=vertex_xy,
        vertex_cell=np.column_stack((column, row)).astype(np.int32),
        edge_uv=np.ascontiguousarray(uv),
        edge_slots=np.ones(len(uv), dtype=np.int32),
        edge_oneway=np.zeros(len(uv), dtype=np.bool_),
        robot_ids=(),
        start=none,
        goal=none,
    )
    for array in (
        floor.vertex_xy_m,
        floor.vertex_cell,
        floor.edge_uv,
        floor.edge_slots,
        floor.edge_oneway,
        none,
    ):
        array.flags.writeable = False
    return floor


def boxes_of(world: World) -> Boxes:
    """The obstacles of a world: the listed ones in their order, then the drawn ones by position.

    Exactly round(share * positions) positions carry a drawn box. A larger share keeps the boxes
    of a smaller one.
    """
    names = [o.name or f"obstacle[{i}]" for i, o in enumerate(world.obstacle)]
    center = [(*o.center_m, o.base_m + o.height_m / 2) for o in world.obstacle]
    half = [(o.size_m[0] / 2, o.size_m[1] / 2, o.height_m / 2) for o in world.obstacle]
    yaw = [math.radians(o.yaw_deg) for o in world.obstacle]
    if world.obstacles is not None:
        random = world.obstacles.random
        xy = positions_m(world.hall)
        columns = world.hall.grid_positions[0]
        order = stream(random.seed, "obstacles").random(len(xy)).argsort(kind="stable")
        for p in np.sort(order[: round(random.share * len(xy))]):
            names.append(f"box at [{p % columns}, {p // columns}]")
            center.append((float(xy[p, 0]), float(xy[p, 1]), random.height_m / 2))
            half.append((random.side_m / 2, random.side_m / 2, random.height_m / 2))
            yaw.append(0.0)
    arrays = (
        np.array(center, dtype=np.float64).reshape(-1, 3),
        np.array(half, dtype=np.float64).reshape(-1, 3),
        np.array(yaw, dtype=np.float64),
    )
    for array in arrays:
        array.flags.writeable = False
    return Boxes(tuple(names), *arrays)


def _body_faults(world: World) -> list[Fault]:
    """Robots that the grid lets come too close to each other."""
    body, pitch = world.hall.body, world.hall.grid_pitch_m
    faults = []
    if body.width_m > pitch / math.sqrt(2) + 1e-9:
        rule = f"{body.width_m} m is too wide: at a corner two robots come within pitch/√2"
        mend = f"{pitch / math.sqrt(2):.3f} m; make the body narrower or the pitch larger"
        faults.append(Fault(("hall", "body", "width_m"), f"{rule} = {mend}", "E112"))
    if body.length_m >= pitch:
        rule = f"{body.length_m} m is too long: robots at neighbouring positions, {pitch:.6g} m"
        mend = "apart, touch; make the body shorter or the pitch larger"
        faults.append(Fault(("hall", "body", "length_m"), f"{rule} {mend}", "E112"))
    return faults


def _outside(world: World, boxes: Boxes) -> list[Fault]:
    """Obstacles, stations and APs that are not in the hall, APs that are inside an obstacle."""
    from worlds.scene import ray_growth_m

    hall = world.hall
    size = f"the hall of {hall.size_m[0]:g} m x {hall.size_m[1]:g} m"
    faults = []

    half = np.array([[*hall.size_m, 1.0]]) / 2
    floor = Boxes(("hall",), half, half, np.zeros(1))
    listed = slice(len(world.obstacle))
    inside = footprint_hits(
        floor, boxes.center_m[listed, :2], boxes.half_m[listed, :2], boxes.yaw_rad[listed]
    )
    for i in np.flatnonzero(inside < 0).tolist():
        obstacle = world.obstacle[i]
        rule = f"{list(obstacle.center_m)} puts '{boxes.name[i]}' outside {size}"
        hint = millimetres(obstacle.center_m, hall) or "; check its centre and size"
        faults.append(Fault(("obstacle", i, "center_m"), rule + hint, "E103"))

    for i, station in enumerate(world.station):
        try:
            position_of(hall, station)
        except NowhereError as error:
            key = next(k for k in type(station).exactly_one if getattr(station, k) is not None)
            faults.append(Fault(("station", i, key), f"'{station.name}': {error}", "E104"))

    if not any(ap.enabled for ap in world.ap):
        what = "every access point is switched off" if world.ap else "there is no access point"
        faults.append(Fault(("ap",), f"{what}; robots need at least one", "E115"))
    # Grown as for rays: a ray that starts within a box does not see it (design page 3).
    holder = contains(boxes, [ap.position_m for ap in world.ap], grow_m=ray_growth_m(world))
    for i, ap in enumerate(world.ap):
        key_m = ("ap", i, "position_m")
        x, y, _ = ap.position_m
        if not (0 <= x <= hall.size_m[0] and 0 <= y <= hall.size_m[1]):
            hint = millimetres((x, y), hall) or "; move it inside"
            message = f"{[x, y]} puts '{ap.id}' outside {size}{hint}"
            faults.append(Fault(key_m, message, "E101"))
        if holder[i] >= 0:
            rule = f"{list(ap.position_m)} puts '{ap.id}' inside '{boxes.name[holder[i]]}'"
            mend = "move it or hang it higher"
            faults.append(Fault(key_m, f"{rule}, or at its very face; {mend}", "E102"))
    return faults
