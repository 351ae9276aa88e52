"""Findings about what is written and about the floor: W101, W103–W107, W301–W304, N101–N103."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from worlds.boxes import footprint_hits
from worlds.check import Finding, Site, places
from worlds.errands import components, robot_height_m
from worlds.errors import Key
from worlds.floor import Floor
from worlds.places import NowhereError, position_m, position_name, position_of
from worlds.world import Obstacle, World

UNREACHABLE_SHARE = 0.02
PASSAGE_SHARE = 0.05
CROWDED_SHARE = 0.4
SPEEDS_M_S = (0.02, 5.0)
NAMED = 3
"""Examples that a message gives."""


def written_findings(world: World) -> list[Finding]:
    """What is odd about the values themselves."""
    found = [*_units(world), *_notes(world), *_buried(world)]
    hall, body = world.hall, world.hall.body
    speed = hall.grid_pitch_m / hall.grid_slot_s
    on_grid = hall.graph is None
    if on_grid and not SPEEDS_M_S[0] <= speed <= SPEEDS_M_S[1]:
        key: Key = ("hall", "slot_s" if hall.slot_s is not None else "speed_m_s")
        rule = f"a slot of {hall.grid_slot_s:g} s for {hall.grid_pitch_m:g} m is {speed:g} m/s"
        mend = "give slot_s in seconds or speed_m_s in metres per second"
        found.append(Finding("W302", f"{rule}; {mend}", key))
    if on_grid and body.length_m + body.width_m > hall.grid_pitch_m + 1e-9:
        rule = (
            f"length {body.length_m:g} m + width {body.width_m:g} m is more than the pitch, "
            f"{hall.grid_pitch_m:g} m"
        )
        mend = "robots may touch at corners; raise the pitch or make them smaller"
        found.append(Finding("W106", f"{rule}: {mend}", ("hall", "body", "length_m")))
    highest = max((ap.position_m[2] for ap in world.ap if ap.enabled), default=np.inf)
    above = max(float(highest), robot_height_m(world))
    for i, o in enumerate(world.obstacle):
        if o.base_m > above:
            rule = f"{o.base_m:g} m puts {_name(o, i)} above all access points and robots"
            mend = "it has no effect; base_m is the height of its underside"
            found.append(Finding("W304", f"{rule}; {mend}", ("obstacle", i, "base_m")))
    return found


def floor_findings(site: Site) -> list[Finding]:
    """Whether one gets everywhere."""
    floor = site.floor
    component = components(
        floor, np.ones(len(floor.vertex_xy_m), np.bool_), np.ones(len(floor.edge_uv), np.bool_)
    )
    found = [*_blocked_stations(site), *_pockets(site, component), *_passages(floor, component)]
    free = len(component)
    apart = np.flatnonzero(component > 0)
    if len(apart) > UNREACHABLE_SHARE * free:
        rule = f"{len(apart)} of {free} free positions ({len(apart) / free:.1%})"
        parts = int(component.max())
        message = (
            f"{rule} are not connected with the largest part, in {parts} pieces; open ways to "
            "them, or try a smaller pitch or body"
        )
        found.append(Finding("W104", message, ("hall",), places(floor.vertex_xy_m[apart])))
    room = free - len(apart)
    if site.robots > CROWDED_SHARE * room:
        key: Key = ("robots", "random", "count") if site.world.robots else ("robot",)
        rule = f"{site.robots} robots on {room} connected positions"
        found.append(Finding("W107", f"{rule} have hardly room to pass; take fewer", key))
    return found


def _units(world: World) -> list[Finding]:
    """W301: lengths that make sense as millimetres only."""
    hall, body = world.hall, world.hall.body
    # (value, largest plausible one [m], key, what it is)
    asked: list[tuple[float, float, Key, str]] = [
        (max(hall.size_m), 1000.0, ("hall", "size_m"), "side of the hall"),
        (hall.grid_pitch_m, 20.0 if hall.graph is None else 100.0, ("hall", "pitch_m"), "pitch"),
        (body.length_m, 6.0, ("hall", "body", "length_m"), "length of a robot"),
        (body.width_m, 6.0, ("hall", "body", "width_m"), "width of a robot"),
        (body.height_m, 6.0, ("hall", "body", "height_m"), "height of a robot"),
        (body.antenna_m, 6.0, ("hall", "body", "antenna_m"), "height of an antenna"),
        (world.radio.clearance_m, 1.0, ("radio", "clearance_m"), "clearance"),
    ]
    for i, ap in enumerate(world.ap):
        key: Key = ("ap", i, "position_m", 2)
        asked.append((ap.position_m[2], 40.0, key, f"height of '{ap.id}'"))
    for i, o in enumerate(world.obstacle):
        key = ("obstacle", i, "height_m")
        asked.append((o.height_m, 40.0, key, f"height of {_name(o, i)}"))
        largest = 2 * max(hall.size_m)
        asked.append((max(o.size_m), largest, ("obstacle", i, "size_m"), f"side of {_name(o, i)}"))
    if world.obstacles is not None:
        drawn = world.obstacles.random
        base: Key = ("obstacles", "random")
        asked.append((drawn.side_m, 30.0, (*base, "side_m"), "side of the drawn obstacles"))
        asked.append((drawn.height_m, 40.0, (*base, "height_m"), "height of the drawn obstacles"))
    return [
        Finding(
            "W301",
            f"{value:g} m is a large {what}; millimetres? then write {value / 1000:g}",
            key,
        )
        for value, limit, key, what in asked
        if value > limit
    ]


def _notes(world: World) -> list[Finding]:
    """Unused stations, APs that are off, shared goals."""
    found = []
    ends = [place for robot in world.robot for place in (robot.start, robot.goal)]
    used = {place.station for place in ends}
    unused = [i for i, station in enumerate(world.station) if station.name not in used]
    if world.hall.graph is not None and len(unused) > NAMED:  # a layout has them all
        names = ", ".join(f"'{world.station[i].name}'" for i in unused[:NAMED])
        message = f"no robot starts or ends at {len(unused)} of {len(world.station)} stations, "
        found.append(Finding("N101", f"{message}{names} among them", ("station",)))
        unused = []
    for i in unused:
        message = f"no robot starts or ends at '{world.station[i].name}'"
        found.append(Finding("N101", message, ("station", i, "name")))
    for i, ap in enumerate(world.ap):
        if not ap.enabled:
            message = f"'{ap.id}' is off"
            found.append(Finding("N102", message, ("ap", i, "enabled"), (ap.position_m[:2],)))
    if world.plan.at_goal == "leave":
        first: dict[int, int] = {}
        for i, robot in enumerate(world.robot):
            at = _position(world, i, "goal")
            if at is not None and (other := first.setdefault(at, i)) != i:
                rule = f"'{robot.id}' and '{world.robot[other].id}' have the same goal"
                where = position_name(world.hall, at)
                message = f"{rule}, {where}; they arrive one after the other"
                place = (position_m(world.hall, at),)
                found.append(Finding("N103", message, ("robot", i, "goal"), place))
    return found


def _position(world: World, robot: int, end: str) -> int | None:
    place = getattr(world.robot[robot], end)
    stations = {station.name: station for station in world.station}
    try:
        return position_of(world.hall, stations[place.station] if place.station else place)
    except NowhereError:
        return None


def _buried(world: World) -> list[Finding]:
    """W303: upright boxes wholly within another (turned ones are not looked at)."""
    upright = [i for i, o in enumerate(world.obstacle) if o.yaw_deg % 180 == 0]
    if len(upright) < 2:
        return []
    boxes = [world.obstacle[i] for i in upright]
    low = np.array([(o.center_m[0] - o.size_m[0] / 2, o.center_m[1] - o.size_m[1] / 2, o.base_m)
                    for o in boxes])  # fmt: skip
    high = low + np.array([(*o.size_m, o.height_m) for o in boxes])
    found = []
    for k, i in enumerate(upright):
        around = ((low <= low[k] + 1e-9) & (high >= high[k] - 1e-9)).all(axis=1)
        around[k] = False
        same = around & ((low >= low[k] - 1e-9) & (high <= high[k] + 1e-9)).all(axis=1)
        around &= ~same | (np.arange(len(boxes)) < k)  # of two equal ones the later is the copy
        if around.any():
            outer = upright[int(np.argmax(around))]
            rule = f"{_name(world.obstacle[i], i)} lies wholly inside"
            message = f"{rule} {_name(world.obstacle[outer], outer)}; take it out or move it"
            place = (world.obstacle[i].center_m,)
            found.append(Finding("W303", message, ("obstacle", i, "center_m"), place))
    return found


def _name(obstacle: Obstacle, index: int) -> str:
    return f"'{obstacle.name}'" if obstacle.name else f"obstacle[{index}]"


def _blocked_stations(site: Site) -> list[Finding]:
    """W101: stations at positions where a robot cannot stand; used ones are errors already."""
    world, found = site.world, []
    used = {place.station for robot in world.robot for place in (robot.start, robot.goal)}
    for i, station in enumerate(world.station):
        try:
            position = position_of(world.hall, station)
        except NowhereError:
            continue
        if site.floor.vertex_at(position) < 0 and station.name not in used:
            place = (position_m(world.hall, position),)
            box = _blocker(site, np.array(place))[0]
            rule = f"'{station.name}' is at a position blocked by '{box}'"
            message = f"{rule}; move one of them"
            found.append(Finding("W101", message, ("station", i), place))
    return found


def _blocker(site: Site, xy_m: NDArray[np.float64]) -> list[str]:
    """Names of the obstacles that block positions."""
    body = site.sound.hall.body
    half = max(body.length_m, body.width_m) / 2
    height = robot_height_m(site.sound)
    hit = footprint_hits(site.floor.boxes, xy_m, (half, half), body_height_m=height)
    return [site.floor.boxes.name[box] if box >= 0 else "an obstacle" for box in hit.tolist()]


def _pockets(site: Site, component: NDArray[np.int32]) -> list[Finding]:
    """W103: pieces of floor that freeing a single cell would join to the largest one."""
    floor, hall = site.floor, site.world.hall
    if floor.node is not None:
        return []  # a graph has no blocked cells between its pieces
    grid = floor.vertex_grid()
    piece = np.where(grid >= 0, component[grid], -1)
    padded = np.pad(piece, 1, constant_values=-1)
    around = np.stack((padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]))
    doors = (grid < 0) & (around == 0).any(axis=0) & (around > 0).any(axis=0)
    if not doors.any():
        return []
    behind = sorted(set(around[:, doors].ravel().tolist()) - {-1, 0})
    size = int(np.isin(component, behind).sum())
    row, column = np.nonzero(doors)
    xy = np.array([position_m(hall, p) for p in (row * floor.columns + column).tolist()])
    said = [
        f"[{c}, {r}] ({name!r})"
        for c, r, name in zip(column[:NAMED], row[:NAMED], _blocker(site, xy[:NAMED]), strict=True)
    ]
    more = f" and {len(xy) - NAMED} more" if len(xy) > NAMED else ""
    message = (
        f"{size} positions in {len(behind)} pockets are cut off by one blocked cell: "
        f"{', '.join(said)}{more}; free them, if the floor behind is wanted"
    )
    return [Finding("W103", message, ("hall",), places(xy))]


def _passages(floor: Floor, component: NDArray[np.int32]) -> list[Finding]:
    """W105: positions of the largest part whose loss cuts off a good deal of it."""
    main = np.flatnonzero(component == 0)
    lost = cut_off_sizes(floor, main)
    room = len(main)
    cut = np.flatnonzero(lost >= max(2, PASSAGE_SHARE * room))
    if not len(cut):
        return []
    worst = int(cut[np.argmax(lost[cut])])
    many = f"{len(cut)} positions are each" if len(cut) > 1 else "one position is"
    message = (
        f"{many} the only way to {PASSAGE_SHARE:.0%} of the floor or more; worst is "
        f"{floor.vertex_name(worst)}, "
        f"which holds {int(lost[worst])} of {room} positions apart; widen it or open a second way"
    )
    return [Finding("W105", message, ("hall",), places(floor.vertex_xy_m[cut]))]


def cut_off_sizes(floor: Floor, vertices: NDArray[np.intp]) -> NDArray[np.int64]:
    """(V,) how many of connected vertices are cut off from most of them if one is taken away.

    Low points of a depth-first search (R. Tarjan, 1972, doi:10.1137/0201010), without recursion.
    One-way edges count both ways. 0 for vertices that are not asked for.
    """
    n = len(floor.vertex_xy_m)
    near: list[list[int]] = [[] for _ in range(n)]
    for u, v in floor.edge_uv.tolist():
        near[u].append(v)
        near[v].append(u)
    lost = np.zeros(n, dtype=np.int64)
    if not len(vertices):
        return lost
    total = len(vertices)
    order, low, size, parent = [-1] * n, [0] * n, [1] * n, [-1] * n
    pieces: list[list[int]] = [[] for _ in range(n)]  # sizes of subtrees that hang on a vertex
    root = int(vertices[0])
    stack = [(root, 0)]
    order[root], clock = 0, 1
    while stack:
        v, at = stack.pop()
        if at < len(near[v]):
            stack.append((v, at + 1))
            w = near[v][at]
            if order[w] < 0:
                order[w] = low[w] = clock
                parent[w] = v
                clock += 1
                stack.append((w, 0))
            elif w != parent[v]:
                low[v] = min(low[v], order[w])
            continue
        p = parent[v]
        if p >= 0:
            low[p] = min(low[p], low[v])
            size[p] += size[v]
            if low[v] >= order[p]:
                pieces[p].append(size[v])
    for v in vertices.tolist():
        parts = [*pieces[v]]
        rest = total - 1 - sum(parts)
        if rest > 0:
            parts.append(rest)
        if len(parts) > 1:
            lost[v] = sum(parts) - max(parts)
    return lost
