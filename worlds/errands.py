"""From where to where: listed robots put on the floor, random ones drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from worlds.boxes import footprint_hits
from worlds.errors import Fault, Key, WorldError
from worlds.floor import Floor
from worlds.places import NowhereError, position_m, position_name, position_of
from worlds.streams import stream
from worlds.world import Place, RandomRobots, World

if TYPE_CHECKING:
    from worlds.radio_map import RadioMap

Mask = NDArray[np.bool_]


def with_robots(
    world: World, floor: Floor, vertex_ok: Mask | None = None, edge_ok: Mask | None = None
) -> Floor:
    """The floor with the world's robots on it.

    Random robots get errands within the largest connected component of the usable floor, origins
    and goals pairwise distinct, no goal its own origin. Robot `r07` draws from its own stream and
    draws again where an earlier robot has taken a place, so more robots leave the first ones as
    they are. Once the radio map is known, its coverage decides what is usable (§1.8).

    Args:
        world: whose robots.
        floor: resolved from `world`; its robots, if it has any, are replaced.
        vertex_ok: (V,), vertices that an AP covers; all when left out.
        edge_ok: (E,), edges that are covered; all when left out.

    Raises:
        WorldError: with every robot that cannot start, end or get there.
    """
    if vertex_ok is None:
        vertex_ok = np.ones(len(floor.vertex_xy_m), dtype=np.bool_)
    if edge_ok is None:
        edge_ok = np.ones(len(floor.edge_uv), dtype=np.bool_)
    if world.robots is not None:
        ids, start, goal = _drawn(world.robots.random, floor, vertex_ok, edge_ok)
    else:
        ids, start, goal = _listed(world, floor, vertex_ok)
    ends = (np.array(start, dtype=np.int32), np.array(goal, dtype=np.int32))
    for end in ends:
        end.flags.writeable = False
    return replace(floor, robot_ids=tuple(ids), start=ends[0], goal=ends[1])


def with_covered_robots(world: World, floor: Floor, radio_map: RadioMap) -> Floor:
    """`with_robots` on what the radio map covers: the errands of a run (§1.8).

    Raises:
        WorldError: as `with_robots`.
    """
    from worlds.radio_map import kept_edges, kept_vertices

    vertex_ok = np.zeros(len(floor.vertex_xy_m), dtype=np.bool_)
    vertex_ok[kept_vertices(radio_map)] = True
    edge_ok = np.zeros(len(floor.edge_uv), dtype=np.bool_)
    edge_ok[kept_edges(floor, radio_map)] = True
    return with_robots(world, floor, vertex_ok, edge_ok)


def components(floor: Floor, vertex_ok: Mask, edge_ok: Mask) -> NDArray[np.int32]:
    """(V,) int32, the component of each vertex within the usable floor; -1 for unusable ones.

    Two vertices are in one component if a robot can drive from either to the other. Components
    are numbered by size, largest first; equal ones by their lowest vertex.
    """
    from scipy.sparse.csgraph import connected_components

    labels: NDArray[np.int32]
    _, labels = connected_components(_graph(floor, vertex_ok, edge_ok), connection="strong")
    used, first, label, size = np.unique(
        labels[vertex_ok], return_index=True, return_inverse=True, return_counts=True
    )
    rank = np.empty(len(used), dtype=np.int32)
    rank[np.lexsort((first, -size))] = np.arange(len(used), dtype=np.int32)
    ranked = np.full(len(vertex_ok), -1, dtype=np.int32)
    ranked[vertex_ok] = rank[label]
    return ranked


def _graph(floor: Floor, vertex_ok: Mask, edge_ok: Mask):  # type: ignore[no-untyped-def]
    """Directed adjacency of the usable floor as a scipy sparse array."""
    from scipy.sparse import csr_array

    both_ways = edge_ok & vertex_ok[floor.edge_uv].all(axis=1)
    u, v = floor.edge_uv[both_ways].T
    back = ~floor.edge_oneway[both_ways]
    tail, head = np.concatenate((u, v[back])), np.concatenate((v, u[back]))
    n = len(vertex_ok)
    return csr_array((np.ones(len(tail), dtype=np.int8), (tail, head)), shape=(n, n))


def _drawn(
    random: RandomRobots, floor: Floor, vertex_ok: Mask, edge_ok: Mask
) -> tuple[list[str], list[int], list[int]]:
    """Ids, origins and goals of random robots."""
    places = np.flatnonzero(components(floor, vertex_ok, edge_ok) == 0)
    # One more than robots: else the last one's only free goal can be where it stands.
    if len(places) <= random.count:
        rule = f"{random.count} robots need {random.count + 1} connected positions, but there are"
        mend = "take fewer robots, or more floor, fewer obstacles or more coverage"
        at = ("robots", "random", "count")
        raise WorldError([Fault(at, f"{rule} {len(places)}; {mend}", "E114")])
    ids = [f"r{i:02d}" for i in range(random.count)]
    start: list[int] = []
    goal: list[int] = []
    starts: set[int] = set()
    goals: set[int] = set()
    for name in ids:
        rng = stream(random.seed, "robots", name)
        start.append(_draw(rng, places, starts.__contains__))
        starts.add(start[-1])
        goal.append(_draw(rng, places, lambda v: v in goals or v == start[-1]))
        goals.add(goal[-1])
    return ids, start, goal


def _draw(rng: np.random.Generator, places: NDArray[np.intp], taken: Callable[[int], bool]) -> int:
    while taken(vertex := int(places[rng.integers(len(places))])):
        pass  # ends: there are more places than robots
    return vertex


def _listed(world: World, floor: Floor, vertex_ok: Mask) -> tuple[list[str], list[int], list[int]]:
    """Ids, origins and goals of listed robots."""
    faults: list[Fault] = []
    if not world.robot:
        mend = "list some ([[robot]] with id, start and goal) or draw some ([robots.random])"
        faults.append(Fault((), f"there is no robot; {mend}", "E114"))
    stations = {station.name: station for station in world.station}
    ends: dict[str, list[int]] = {"start": [], "goal": []}
    for i, robot in enumerate(world.robot):
        for end, place in (("start", robot.start), ("goal", robot.goal)):
            key: Key = ("robot", i, end)
            ends[end].append(-1)
            try:
                at = position_of(world.hall, stations[place.station] if place.station else place)
            except NowhereError as error:
                if place.station is None:  # a station outside is told of at the station
                    faults.append(Fault(key, str(error), "E105"))
                continue
            vertex = floor.vertex_at(at)
            if vertex < 0:
                faults.append(Fault(key, _blocked(world, floor, place, at), "E106"))
            elif not vertex_ok[vertex]:
                mend = "move it, or add an access point or power"
                message = f"{_name(world, place, at)} is in no AP's coverage; {mend}"
                faults.append(Fault(key, message, "E107"))
            else:
                ends[end][-1] = vertex
    faults += _doubled(world, "start", ends["start"], "robots start from different places")
    if world.plan.at_goal == "park":
        rule = 'robots that stay (at_goal = "park") need different goals'
        faults += _doubled(world, "goal", ends["goal"], rule)
    faults += _cut_off(world, floor, ends["start"], ends["goal"])
    if faults:
        raise WorldError(faults)
    return [robot.id for robot in world.robot], ends["start"], ends["goal"]


def _name(world: World, place: Place, position: int) -> str:
    at = position_name(world.hall, position)
    return f"'{place.station}' ({at})" if place.station else at


def _blocked(world: World, floor: Floor, place: Place, position: int) -> str:
    hall = world.hall
    half = max(hall.body.length_m, hall.body.width_m) / 2
    xy = position_m(hall, position)
    hit = footprint_hits(floor.boxes, xy, (half, half), body_height_m=robot_height_m(world))
    box = int(hit[0])
    mend = "take a free place or move the obstacle"
    name = _name(world, place, position)
    if box < 0:  # a node whose every lane is blocked, though not it itself
        return f"{name} is blocked: obstacles stand in all its lanes; {mend}"
    if box >= len(world.obstacle):
        mend = "take a free place or another obstacles.random.seed"
    return f"{name} is blocked: a robot there touches '{floor.boxes.name[box]}'; {mend}"


def robot_height_m(world: World) -> float:
    """Height of a robot's highest point, body or antenna [m]."""
    return max(world.hall.body.height_m, world.hall.body.antenna_m)


def _doubled(world: World, end: str, vertices: list[int], rule: str) -> list[Fault]:
    """Places that more than one robot has; -1 is no place."""
    faults = []
    first: dict[int, int] = {-1: -1}
    for i, vertex in enumerate(vertices):
        j = first.setdefault(vertex, i)
        if j not in {i, -1}:
            message = f"is the {end} of robot '{world.robot[j].id}' already; {rule}"
            faults.append(Fault(("robot", i, end), message, "E108"))
    return faults


def _cut_off(world: World, floor: Floor, start: list[int], goal: list[int]) -> list[Fault]:
    """Robots whose goal cannot be reached even on an empty floor."""
    from scipy.sparse.csgraph import breadth_first_order

    all_v = np.ones(len(floor.vertex_xy_m), dtype=np.bool_)
    all_e = np.ones(len(floor.edge_uv), dtype=np.bool_)
    component = components(floor, all_v, all_e)
    either_way = component
    if floor.edge_oneway.any():
        two_way = replace(floor, edge_oneway=np.zeros_like(floor.edge_oneway))
        either_way = components(two_way, all_v, all_e)
    faults = []
    for i, (u, v) in enumerate(zip(start, goal, strict=True)):
        if min(u, v) < 0 or component[u] == component[v]:
            continue
        if floor.edge_oneway.any():  # another component may still lie ahead
            ahead = breadth_first_order(_graph(floor, all_v, all_e), u, return_predecessors=False)
            if v in ahead:
                continue
        start_name, goal_name = (
            floor.vertex_name(w) if floor.node is not None else floor.vertex_cell[w].tolist()
            for w in (u, v)
        )
        rule = f"no free way leads from start {start_name} to goal {goal_name}"
        key: Key = ("robot", i, "goal")
        if either_way[u] == either_way[v]:
            mend = "along the one-way lanes; add a lane or choose another goal"
            faults.append(Fault(key, f"{rule} {mend}", "E119"))
        else:
            faults.append(Fault(key, f"{rule}; open a gap or choose another goal", "E109"))
    return faults
