"""A run as VDA 5050 orders: what a fleet control would send to each robot, and when.

Version 3.0.0 of VDA 5050 (github.com/VDA5050/VDA5050). One order per robot: nodes have even and
edges odd sequence ids, counted along the way. The *base*, released, is what the robot may drive at
once; the *horizon* is the rest of its way. Orders carry no times, so when what is released goes
into a log of its own, one JSON object per line.

**Release.** A visit is released when all visits to that node which the run had before it are being
left, when earlier crossings by others of a lane that takes several slots are over, when the visit
before it is released, and when it is at most `release_horizon` visits ahead. So a node is in the
base of one robot at a time, from its release until that robot leaves it (in the very slot in which
one leaves, the next may come: robots follow each other, as in the run). Robots that keep to their
base keep the order of the run, whatever their speed.
"""

from __future__ import annotations

import json
import math
import re
from collections import defaultdict
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

from logs.mcap_format import EPOCH
from logs.mcap_reader import RunFile
from logs.records import ARRIVED, GONE, NewPath, RobotState
from planner.problem import Problem
from twin.errors import TwinError
from twin.track_names import TrackNames

VDA5050_VERSION = "3.0.0"

Json = dict[str, Any]


@dataclass
class Visit:
    """A robot's stay at a vertex, with the crossing that led there.

    Attributes:
        vertex: of the problem.
        edge: crossed to get there, −1 for the first visit.
        begun: slot in which that crossing began, −1 if it never did.
        arrived: slot at whose beginning the robot is there, −1 if it never is.
        left: slot in which it leaves, None if it does not.
        released: slot in which it may go there, None if never.
    """

    vertex: int
    edge: int = -1
    begun: int = -1
    arrived: int = -1
    left: int | None = None
    released: int | None = None


@dataclass(frozen=True)
class Orders:
    """What goes to the robots.

    Attributes:
        order: order message by robot id.
        releases: lines of the release log, by time.
    """

    order: dict[str, Json]
    releases: tuple[Json, ...]

    def files(self) -> dict[str, str]:
        """Name → text of each file: an order per robot, and `releases.jsonl`."""
        texts: dict[str, str] = {}
        for number, (robot, order) in enumerate(self.order.items()):
            name = re.sub(r"[^A-Za-z0-9_-]", "_", robot)[:48]
            if f"{name}.order.json" in texts:
                name = f"{name}-{number}"
            texts[f"{name}.order.json"] = json.dumps(order, indent=1, ensure_ascii=False) + "\n"
        lines = [json.dumps(line, ensure_ascii=False) for line in self.releases]
        texts["releases.jsonl"] = "".join(f"{line}\n" for line in lines)
        return texts


def orders_of(
    run: RunFile, *, manufacturer: str = "mapp-twin", release_horizon: int | None = None
) -> Orders:
    """The orders a run amounts to.

    Args:
        run: its log.
        manufacturer: of the robots, as VDA 5050 asks for it.
        release_horizon: visits released ahead of a robot, at most; the world's when left out.

    Raises:
        TwinError: the log has no robot states.
    """
    from worlds.radio_map import kept_vertices

    world, floor, problem = run.world, run.floor, run.problem
    ahead = world.run.release_horizon if release_horizon is None else release_horizon
    visits = _visits(run, problem)
    names = TrackNames.of(world, floor).kept(kept_vertices(run.radio_map))
    _release(visits, problem, ahead)
    order = {robot: _order(run, robot, mine, names, manufacturer) for robot, mine in visits.items()}
    lines: list[tuple[int, int, Json]] = []
    for index, (robot, mine) in enumerate(visits.items()):
        lines += [
            (line["slot"], index, line) for line in _release_lines(robot, mine, names, floor.slot_s)
        ]
    lines.sort(key=lambda entry: entry[:2])
    for _, _, line in lines:
        line["orderId"] = order[line["robot"]]["orderId"]
    return Orders(order, tuple(line for *_, line in lines))


def _visits(run: RunFile, problem: Problem) -> dict[str, list[Visit]]:
    """What each robot visited in the run, then what was left of its path."""
    visits: dict[str, list[Visit]] = {robot: [] for robot in problem.robot_ids}
    last: dict[str, RobotState] = {}
    routes: dict[str, list[tuple[int, int]]] = {
        path.robot: _way(path.vertices.tolist(), path.edges.tolist())
        for path in run.plan.paths
        if path is not None
    }
    for record in run.iter_records((RobotState, NewPath)):
        if isinstance(record, NewPath):
            routes[record.robot] = _way(list(record.vertices), list(record.edges))
            continue
        if not isinstance(record, RobotState) or record.robot not in visits:
            continue
        mine, before = visits[record.robot], last.get(record.robot)
        if record.activity == GONE:
            continue
        last[record.robot] = record
        if before is not None and before.slot == record.slot:
            continue  # its link changed within the slot
        if not mine:
            mine.append(Visit(record.vertex, arrived=record.slot, released=0))
        elif record.vertex != mine[-1].vertex or mine[-1].arrived < 0:
            if mine[-1].arrived < 0 and record.vertex == mine[-1].vertex:
                mine[-1].arrived = record.slot
            elif mine[-1].arrived >= 0:
                raise TwinError(f"{run.path}: robot {record.robot} jumps in slot {record.slot}")
        if record.edge >= 0 and mine[-1].arrived >= 0:
            mine[-1].left = record.slot
            mine.append(Visit(record.next_vertex, record.edge, begun=record.slot))
    if not any(visits.values()):
        raise TwinError(f"{run.path}: says nothing about any robot; there is nothing to export")
    for robot, mine in visits.items():
        state = last.get(robot)
        if state is None:
            continue
        if state.activity == ARRIVED and problem.at_goal == "leave" and mine[-1].arrived >= 0:
            mine[-1].left = state.slot  # drives off in that slot (§1.4)
        elif state.activity != ARRIVED:
            mine.extend(_rest(routes.get(robot, []), mine))
    return {robot: mine for robot, mine in visits.items() if mine}


def _way(vertices: list[int], edges: list[int]) -> list[tuple[int, int]]:
    """(vertex, edge that led there) of each visit of a path, its start first."""
    steps = zip(vertices, vertices[1:], edges, strict=False)
    return [(v, -1) for v in vertices[:1]] + [(v, e) for u, v, e in steps if u != v]


def _rest(route: list[tuple[int, int]], done: list[Visit]) -> list[Visit]:
    """The visits of a route after the last one begun."""
    at = done[-1].vertex
    where = [k for k, (vertex, _) in enumerate(route) if vertex == at]
    return [Visit(vertex, edge) for vertex, edge in route[where[-1] + 1 :]] if where else []


def _release(visits: dict[str, list[Visit]], problem: Problem, ahead: int) -> None:
    """Set the slot from which each visit is released; see the module."""
    at_vertex: dict[int, list[tuple[int, str, Visit]]] = defaultdict(list)
    on_edge: dict[int, list[tuple[int, int, str]]] = defaultdict(list)
    for robot, mine in visits.items():
        for visit in mine:
            if visit.begun >= 0 and problem.edge_slots[visit.edge] > 1:
                over = visit.arrived if visit.arrived >= 0 else -1
                on_edge[visit.edge].append((visit.begun, over, robot))
            if visit.arrived >= 0:
                at_vertex[visit.vertex].append((visit.arrived, robot, visit))
    earliest: dict[int, int] = {}  # by id of the visit
    for stays in at_vertex.values():
        stays.sort(key=lambda stay: stay[:2])
        free = 0
        for _, _, visit in stays:
            earliest[id(visit)] = free
            free = max(free, visit.left) if visit.left is not None else free
    for crossings in on_edge.values():
        crossings.sort()
    for robot, mine in visits.items():
        released = 0
        for k, visit in enumerate(mine[1:], start=1):
            if visit.arrived < 0:
                break  # not reached in the run: horizon
            released = max(released, earliest[id(visit)])
            for begun, over, other in on_edge.get(visit.edge, ()):
                if begun < visit.begun and other != robot and over >= 0:
                    released = max(released, over)
            if k - ahead > 0:
                released = max(released, mine[k - ahead].arrived)
            visit.released = released


def _order(
    run: RunFile, robot: str, visits: list[Visit], names: TrackNames, manufacturer: str
) -> Json:
    """The order message of a robot at the beginning of the run (update 0)."""
    problem, slot_s = run.problem, run.floor.slot_s
    nodes: list[Json] = []
    edges: list[Json] = []
    for k, visit in enumerate(visits):
        x, y = names.at_m[visit.vertex].tolist()
        base = visit.released == 0
        if k:
            before = visits[k - 1].vertex
            length = math.dist(problem.xy_m[before], problem.xy_m[visit.vertex])
            edges.append(
                {
                    "edgeId": names.edge_id(before, visit.vertex),
                    "sequenceId": 2 * k - 1,
                    "released": base,
                    "maximumSpeed": length / (int(problem.edge_slots[visit.edge]) * slot_s),
                    "length": length,
                    "actions": [],
                }
            )
        nodes.append(
            {
                "nodeId": names.node[visit.vertex],
                "sequenceId": 2 * k,
                "released": base,
                "nodePosition": {"x": x, "y": y, "mapId": names.map_id},
                "actions": [],
            }
        )
    return {
        "headerId": 0,
        "timestamp": timestamp(0.0),
        "version": VDA5050_VERSION,
        "manufacturer": manufacturer,
        "serialNumber": robot,
        "orderId": f"{run.world.name}/{robot}",
        "orderUpdateId": 0,
        "nodes": nodes,
        "edges": edges,
    }


def _release_lines(robot: str, visits: list[Visit], names: TrackNames, slot_s: float) -> list[Json]:
    """One line for each slot in which a part of the way is released."""
    by_slot: dict[int, list[int]] = defaultdict(list)
    for k, visit in enumerate(visits):
        if visit.released is not None:
            by_slot[visit.released].append(k)
    return [
        {
            "timestamp": timestamp(slot * slot_s),
            "t_s": round(slot * slot_s, 9),
            "slot": slot,
            "robot": robot,
            "orderId": "",
            "orderUpdateId": update,
            "nodes": [{"nodeId": names.node[visits[k].vertex], "sequenceId": 2 * k} for k in ks],
            "edges": [
                {
                    "edgeId": names.edge_id(visits[k - 1].vertex, visits[k].vertex),
                    "sequenceId": 2 * k - 1,
                }
                for k in ks
                if k
            ],
        }
        for update, (slot, ks) in enumerate(sorted(by_slot.items()))
    ]


def timestamp(t_s: float) -> str:
    """Simulated time as the log has it: ISO 8601 in UTC with milliseconds."""
    start = datetime.fromisoformat(EPOCH.replace("Z", "+00:00")).astimezone(UTC)
    moment = start + timedelta(milliseconds=round(t_s * 1000))
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{moment.microsecond // 1000:03d}Z"
