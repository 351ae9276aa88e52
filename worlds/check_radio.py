"""Findings about coverage, capacity and reach: E110, E111, E117, E118, W102, W108, W201–W209."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from worlds.channel import channel_model
from worlds.check import Finding, Site, places
from worlds.errands import components
from worlds.errors import Key
from worlds.floor import Floor
from worlds.places import NowhereError, position_m, position_of
from worlds.radio_map import RadioMap, kept_edges, kept_vertices
from worlds.world import World

ALONE_SHARE = 0.1
SPLIT_SHARE = 0.01
TIGHT_SHARE = 0.8
NAMED = 3
_AT_ONCE = 128  # robots whose distances are computed together

Bools = NDArray[np.bool_]
Ints = NDArray[np.int32]


def radio_findings(site: Site, radio_map: RadioMap) -> list[Finding]:
    """All of them."""
    passable = passable_edges(site.floor, radio_map)
    vertex_ok = np.zeros(len(site.floor.vertex_xy_m), dtype=np.bool_)
    vertex_ok[kept_vertices(radio_map)] = True
    part = components(site.floor, vertex_ok, passable)
    return [
        *_errands(site, vertex_ok, passable, part),
        *_capacity(site, radio_map),
        *_stations(site, vertex_ok),
        *_aps(site, radio_map),
        *_coverage(site, radio_map),
        *_edges(site, radio_map, vertex_ok, passable),
        *_split(site, vertex_ok, part),
        *_model_range(site, radio_map),
    ]


def passable_edges(floor: Floor, radio_map: RadioMap) -> Bools:
    """(E,) edges of G that can be crossed, with one AP all along or with a handover (§1.7)."""
    whole: Bools = np.array(radio_map.edge_covered.any(axis=1))
    rest = np.setdiff1d(kept_edges(floor, radio_map), np.flatnonzero(whole))
    # Pairs of APs are looked at only where no single AP does.
    some = replace(radio_map, edge_snr_db=radio_map.edge_snr_db[rest])
    pairs = some.edge_handover(replace(floor, edge_uv=floor.edge_uv[rest]))
    whole[rest] = pairs.any(axis=(1, 2))
    return whole


def _errands(site: Site, vertex_ok: Bools, passable: Bools, part: Ints) -> list[Finding]:
    """E110, E111 and W108: can each robot, alone, get there in time?"""
    floor, horizon = site.floor, site.world.plan.horizon
    found: list[Finding] = []
    slots = _slots(floor, vertex_ok, passable)
    index = {robot.id: i for i, robot in enumerate(site.world.robot)}
    tight: list[tuple[int, str]] = []
    for k, name in enumerate(floor.robot_ids):
        start, goal = int(floor.start[k]), int(floor.goal[k])
        key: Key = ("robot", index[name], "goal") if name in index else ("plan", "horizon")
        ends = places(floor.vertex_xy_m[[start, goal]])
        cells = [floor.vertex_name(v).removeprefix("cell ") for v in (start, goal)]
        if not np.isfinite(slots[k]):
            rule = f"'{name}': every way from {cells[0]} to {cells[1]} leads through a hole"
            message = f"{rule} in the coverage; add an access point or choose another goal"
            found.append(Finding("E110", message, key, ends))
        elif slots[k] > horizon:
            rule = f"'{name}' needs {int(slots[k])} slots even if it is alone"
            message = f"{rule}, the horizon is {horizon}; raise plan.horizon"
            found.append(Finding("E111", message, ("plan", "horizon"), ends))
        elif slots[k] > TIGHT_SHARE * horizon:
            tight.append((int(slots[k]), name))
    if tight:
        most, name = max(tight)
        message = (
            f"{len(tight)} robots need more than {TIGHT_SHARE:.0%} of the {horizon} slots even if "
            f"they are alone, '{name}' {most}; raise plan.horizon to leave room for waiting"
        )
        found.append(Finding("W108", message, ("plan", "horizon")))
    return found


def _slots(floor: Floor, vertex_ok: Bools, passable: Bools) -> NDArray[np.float64]:
    """(N,) slots of each robot's shortest way, inf without one.

    A lower bound: that a handover may take a slot of waiting is left out.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    use = passable & vertex_ok[floor.edge_uv].all(axis=1)
    u, v = floor.edge_uv[use].T
    weight = floor.edge_slots[use].astype(np.float64)
    back = ~floor.edge_oneway[use]
    tail, head = np.concatenate((u, v[back])), np.concatenate((v, u[back]))
    n = len(vertex_ok)
    graph = csr_array((np.concatenate((weight, weight[back])), (tail, head)), shape=(n, n))
    slots = np.full(len(floor.start), np.inf)
    for first in range(0, len(slots), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        goal = floor.goal[part]
        distance = dijkstra(graph, indices=floor.start[part])
        slots[part] = distance[np.arange(len(goal)), goal]
    return slots


def _capacity(site: Site, radio_map: RadioMap) -> list[Finding]:
    """E117, E118 and W207: can the APs serve the whole fleet at once?"""
    capacity = capacities(site.sound, radio_map)
    robots, default = site.robots, site.world.radio.ap_capacity
    # A misplaced AP is told of as such; it counts here, since it is meant to serve.
    on = [ap for ap in site.world.ap if ap.enabled]
    total = sum(default if ap.capacity is None else ap.capacity for ap in on)
    if total < robots:
        rule = f"the access points serve {total} robots at once, the fleet has {robots}"
        message = f"{rule}; raise ap_capacity or add an access point"
        return [Finding("E117", message, ("radio", "ap_capacity"))]
    if len(on) > len(capacity):
        return []
    found = []
    ends = [("start", site.floor.start)]
    if site.world.plan.at_goal == "park":
        ends.append(("goal", site.floor.goal))
    for end, vertex in ends:
        unserved = _unserved(radio_map.covered[vertex], capacity)
        if len(unserved):
            names = ", ".join(f"'{site.floor.robot_ids[k]}'" for k in unserved[:NAMED].tolist())
            moment = "in slot 0" if end == "start" else "once all have arrived"
            message = (
                f"{moment} {len(unserved)} of {len(vertex)} robots find no place at any access "
                f"point that reaches them, {names} among them; spread the {end}s or add capacity"
            )
            crowd = places(site.floor.vertex_xy_m[vertex[unserved]])
            found.append(Finding("E118", message, ("radio", "ap_capacity"), crowd))
    if len(capacity) > 1 and total - int(capacity.max()) < robots:
        largest = int(capacity.argmax())
        rule = f"without '{radio_map.ap_ids[largest]}' the others serve {total - capacity.max()}"
        message = f"{rule} robots at once, the fleet has {robots}; leave spare capacity"
        found.append(Finding("W207", message, ("radio", "ap_capacity")))
    return found


def capacities(world: World, radio_map: RadioMap) -> NDArray[np.int64]:
    """(A,) robots that each AP of the map serves at once."""
    of = {ap.id: ap.capacity for ap in world.ap}
    default = world.radio.ap_capacity
    return np.array(
        [default if (own := of[name]) is None else own for name in radio_map.ap_ids], dtype=np.int64
    )


def _unserved(covered: Bools, capacity: NDArray[np.int64]) -> NDArray[np.intp]:
    """Robots (of covered (N, A)) left over when as many as possible are served."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import maximum_bipartite_matching

    places_of = np.repeat(covered, np.minimum(capacity, len(covered)), axis=1)
    if not len(covered) or not places_of.shape[1]:
        return np.arange(len(covered))
    match = maximum_bipartite_matching(csr_array(places_of.astype(np.int8)), perm_type="column")
    return np.flatnonzero(match < 0)


def _stations(site: Site, vertex_ok: Bools) -> list[Finding]:
    """W102: stations without coverage that no robot uses."""
    world, found = site.world, []
    used = {place.station for robot in world.robot for place in (robot.start, robot.goal)}
    for i, station in enumerate(world.station):
        try:
            position = position_of(world.hall, station)
        except NowhereError:
            continue
        vertex = site.floor.vertex_at(position)
        if vertex >= 0 and not vertex_ok[vertex] and station.name not in used:
            message = f"no access point reaches '{station.name}'; move it or add coverage"
            place = (position_m(world.hall, position),)
            found.append(Finding("W102", message, ("station", i), place))
    return found


def _aps(site: Site, radio_map: RadioMap) -> list[Finding]:
    """W201, W202, W208: access points that are of little use."""
    covered, count = radio_map.covered, radio_map.coverage_count
    capacity = capacities(site.sound, radio_map)
    index = {ap.id: i for i, ap in enumerate(site.world.ap)}
    antenna = site.world.hall.body.antenna_m
    found = []
    for a, name in enumerate(radio_map.ap_ids):
        ap = site.world.ap[index[name]]
        key: Key = ("ap", index[name])
        place = (ap.position_m[:2],)
        if ap.position_m[2] <= antenna:
            rule = f"'{name}' hangs {ap.position_m[2]:g} m high, robots' antennas are at"
            message = f"{rule} {antenna:g} m; give its height above the floor"
            found.append(Finding("W208", message, (*key, "position_m"), place))
        if not covered[:, a].any():
            best = float(radio_map.snr_db[:, a].max())
            rule = f"'{name}' reaches no position with {radio_map.threshold_db:g} dB"
            message = f"{rule}, at best with {best:.1f} dB; check its place and power"
            found.append(Finding("W201", message, key, place))
        elif (count[covered[:, a]] > 1).all() and capacity.sum() - capacity[a] >= site.robots:
            positions = int(covered[:, a].sum())
            message = (
                f"each of the {positions} positions that '{name}' covers is covered by another "
                "access point, too; it gives redundancy, not coverage"
            )
            found.append(Finding("W202", message, key, place))
    return found


def _coverage(site: Site, radio_map: RadioMap) -> list[Finding]:
    """W203 and W204: positions with one AP, and with none."""
    floor, count = site.floor, radio_map.coverage_count
    found = []
    alone, some = np.flatnonzero(count == 1), int((count > 0).sum())
    if len(alone) > ALONE_SHARE * some:
        covers = radio_map.covered[alone].sum(axis=0)
        worst = radio_map.ap_ids[int(covers.argmax())]
        message = (
            f"{len(alone)} of {some} covered positions ({len(alone) / some:.1%}) have one access "
            f"point only; the loss of '{worst}' alone leaves {int(covers.max())} without; add or "
            "move access points"
        )
        found.append(Finding("W203", message, ("ap",), places(floor.vertex_xy_m[alone])))
    holes = radio_map.holes(floor)
    if holes:
        blockers = Counter(hole.blocker or "no obstacle, but distance" for hole in holes)
        said = ", ".join(f"{name} ({n})" for name, n in blockers.most_common(NAMED))
        share = len(holes) / len(count)
        message = (
            f"{len(holes)} of {len(count)} free positions ({share:.1%}) have no coverage; in the "
            f"way of their nearest access point: {said}"
        )
        xy = np.array([(hole.x_m, hole.y_m) for hole in holes])
        found.append(Finding("W204", message, ("ap",), places(xy)))
    return found


def _edges(site: Site, radio_map: RadioMap, vertex_ok: Bools, passable: Bools) -> list[Finding]:
    """W205: edges with covered ends and a hole between them."""
    floor = site.floor
    if radio_map.edge_rule == "endpoints":
        broken = radio_map.edge_holes.any(axis=1)
        effect = 'robots cross them unawares; edge_rule = "samples" avoids them'
    else:
        broken = vertex_ok[floor.edge_uv].all(axis=1) & ~passable
        effect = "they are not used"
    edges = np.flatnonzero(broken)
    if not len(edges):
        return []
    share = len(edges) / len(floor.edge_uv)
    rule = f"{len(edges)} of {len(floor.edge_uv)} edges ({share:.1%}) hide a hole between covered"
    middle = floor.vertex_xy_m[floor.edge_uv[edges]].mean(axis=1)
    return [Finding("W205", f"{rule} ends: {effect}", ("radio", "edge_rule"), places(middle))]


def _split(site: Site, vertex_ok: Bools, part: Ints) -> list[Finding]:
    """W206: floor that hangs together, but not within coverage."""
    floor = site.floor
    whole = components(
        floor, np.ones(len(part), dtype=np.bool_), np.ones(len(floor.edge_uv), dtype=np.bool_)
    )
    home = np.flatnonzero(part == 0)
    if not len(home):
        return []
    apart = np.flatnonzero(vertex_ok & (part != 0) & (whole == whole[home[0]]))
    if len(apart) <= SPLIT_SHARE * int(vertex_ok.sum()):
        return []
    pieces = len(set(part[apart].tolist()))
    message = (
        f"{len(apart)} covered positions in {pieces} pieces are cut off from the largest part by "
        "holes in the coverage, though the floor is connected; close the holes between them"
    )
    return [Finding("W206", message, ("ap",), places(floor.vertex_xy_m[apart]))]


def _model_range(site: Site, radio_map: RadioMap) -> list[Finding]:
    """W209: positions whose best AP is farther away than the channel model is made for."""
    world, floor = site.sound, site.floor
    aps = {ap.id: ap for ap in world.ap}
    limit = np.array([
        channel_model(aps[name].model or world.radio.model).range_m[1] for name in radio_map.ap_ids
    ])  # fmt: skip
    at = np.array([aps[name].position_m for name in radio_map.ap_ids])
    antenna = np.column_stack(
        (floor.vertex_xy_m, np.full(len(floor.vertex_xy_m), world.hall.body.antenna_m))
    )
    best = radio_map.best_ap
    distance = np.linalg.norm(antenna - at[best], axis=1)
    far = np.flatnonzero((distance > limit[best]) & (radio_map.coverage_count > 0))
    if not len(far):
        return []
    message = (
        f"{len(far)} covered positions are up to {distance[far].max():.0f} m from their best "
        f"access point; the channel model is made for at most {limit[best[far]].max():g} m"
    )
    return [Finding("W209", message, ("radio", "model"), places(floor.vertex_xy_m[far]))]
