"""A small run put together by hand, without planner, scene or twin, for the tests of logs.

A hall of 6 × 4 positions with one rack, two APs and three robots: `r0` crosses at once and leaves,
`r1` waits and arrives in the last slot, `lift 2` has no path. Both change their AP once; while it
waits, `r1` loses its AP's signal for one slot. SNR falls linearly with the distance, no physics.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np

from logs.kpi import KpiFold, planned_figures
from logs.records import (
    ARRIVED,
    CONNECTED,
    GONE,
    HANDOVER,
    LINKS,
    MOVING,
    OUTAGE,
    WAITING,
    ApLoad,
    Arrival,
    Blockages,
    Disturbance,
    Handover,
    Incident,
    NewPath,
    Record,
    Replan,
    RobotState,
    RunEnd,
    RunStart,
    Sample,
    Separation,
)
from planner.plan import Path, Plan
from planner.problem import Problem
from worlds.floor import Boxes, Floor
from worlds.radio_map import RadioMap
from worlds.world import AccessPoint, Hall, Obstacle, Place, PlanOptions, Robot, Station, World

COLUMNS, ROWS, PITCH_M, SLOT_S = 6, 4, 2.0, 2.0
SAMPLES = 5
INTERRUPTION_S = 0.07
THRESHOLD_DB = 10.0
ROBOTS = ("r0", "r1", "lift 2")
APS = ("ap0", "ap1")
AP_M = ((1.0, 7.5, 3.0), (11.0, 0.5, 3.0))
RACK = (2, 1)
OUTAGE_SLOT = 2


@dataclass(frozen=True)
class SampleRun:
    """All that a log is made of."""

    world: World
    floor: Floor
    radio_map: RadioMap
    problem: Problem
    plan: Plan
    records: tuple[Record, ...]

    @property
    def inputs(self) -> dict[str, object]:
        """What `RunLog` asks for."""
        names = ("world", "floor", "radio_map", "problem", "plan")
        return {name: getattr(self, name) for name in names}


def snr_db(xy_m: np.ndarray) -> np.ndarray:
    """(n, A) SNR at (n, 2) places: 34 dB at an AP's foot, 2.5 dB less per metre."""
    distance = np.linalg.norm(xy_m[:, None] - np.array(AP_M)[None, :, :2], axis=2)
    return 34.0 - 2.5 * distance


@cache
def sample_run(slots: int = 10) -> SampleRun:
    """The run with its last arrival in slot `slots` (8 at least); two seconds per slot."""
    world = _world(slots)
    floor = _floor()
    best = snr_db(floor.vertex_xy_m)
    share = np.linspace(0.0, 1.0, world.radio.samples_per_edge)[None, :, None]
    u, v = (floor.vertex_xy_m[floor.edge_uv[:, k]][:, None] for k in (0, 1))
    places = u + share * (v - u)
    radio_map = RadioMap(
        ap_ids=APS,
        threshold_db=THRESHOLD_DB,
        edge_rule="endpoints",
        snr_db=best,
        los=np.ones(best.shape, np.bool_),
        blocker=np.full(best.shape, -1, np.int32),
        edge_snr_db=snr_db(places.reshape(-1, 2)).reshape(*places.shape[:2], len(APS)),
        fading_db=np.zeros(best.shape),
    )
    problem = _problem(floor, best >= THRESHOLD_DB, best, slots)
    plan = _plan(problem, slots)
    return SampleRun(world, floor, radio_map, problem, plan, tuple(_records(problem, plan, slots)))


def _world(slots: int) -> World:
    def at(column: int, row: int) -> Place:
        return Place(cell=(column, row))

    return World(
        name="sample hall",
        hall=Hall(size_m=(12.0, 8.0), pitch_m=PITCH_M, slot_s=SLOT_S),
        obstacle=(Obstacle(name="rack", center_m=(5.0, 3.0), size_m=(1.2, 1.2), yaw_deg=90.0),),
        ap=tuple(
            AccessPoint(id=name, position_m=place) for name, place in zip(APS, AP_M, strict=True)
        ),
        radio={"ap_capacity": 3, "edge_rule": "endpoints"},
        station=(Station(name="dock", cell=(5, 3)), Station(name="gate", at_m=(1.0, 1.0))),
        robot=(
            Robot(id="r0", start=at(0, 0), goal=at(5, 3)),
            Robot(id="r1", start=at(5, 0), goal=at(0, 3)),
            Robot(id="lift 2", start=at(3, 3), goal=at(3, 0)),
        ),
        plan=PlanOptions(horizon=slots),
    )


def _floor() -> Floor:
    cells = [(c, r) for r in range(ROWS) for c in range(COLUMNS) if (c, r) != RACK]
    index = {cell: k for k, cell in enumerate(cells)}
    uv = sorted(
        (index[c, r], index[other])
        for c, r in cells
        for other in ((c + 1, r), (c, r + 1))
        if other in index
    )
    return Floor(
        pitch_m=PITCH_M,
        slot_s=SLOT_S,
        columns=COLUMNS,
        rows=ROWS,
        boxes=Boxes(
            ("rack",),
            np.array([[5.0, 3.0, 1.0]]),
            np.array([[0.6, 0.6, 1.0]]),
            np.array([math.pi / 2]),
        ),
        vertex_xy_m=1.0 + PITCH_M * np.array(cells, np.float64),
        vertex_cell=np.array(cells, np.int32),
        edge_uv=np.array(uv, np.int32),
        edge_slots=np.ones(len(uv), np.int32),
        edge_oneway=np.zeros(len(uv), np.bool_),
        robot_ids=ROBOTS,
        start=np.array([index[0, 0], index[5, 0], index[3, 3]], np.int32),
        goal=np.array([index[5, 3], index[0, 3], index[3, 0]], np.int32),
    )


def _problem(floor: Floor, cover: np.ndarray, best: np.ndarray, slots: int) -> Problem:
    """Every position is covered, so the problem's vertices and edges are the floor's."""
    u, v = floor.edge_uv.T
    pairs = cover[u][:, :, None] & cover[v][:, None, :] & ~np.eye(len(APS), dtype=np.bool_)
    return Problem(
        name="sample hall",
        horizon=slots,
        objective="hp",
        c_t=1,
        c_h=slots,
        at_goal="leave",
        ap_ids=APS,
        ap_capacity=np.array([3, 3], np.int32),
        xy_m=floor.vertex_xy_m,
        cover=cover,
        snr_db=best,
        edge_uv=floor.edge_uv,
        edge_slots=floor.edge_slots,
        edge_oneway=floor.edge_oneway,
        edge_cover=cover[u] & cover[v],
        edge_handover=pairs,
        robot_ids=floor.robot_ids,
        start=floor.start,
        goal=floor.goal,
    )


def _plan(problem: Problem, slots: int) -> Plan:
    row0 = [problem.start[0] + c for c in range(COLUMNS)]  # r0: along row 0, then up column 5
    up = [int(k) for k in np.flatnonzero(problem.xy_m[:, 0] == 11.0)][1:]
    there = [*row0, *up]
    down = [int(k) for k in np.flatnonzero(problem.xy_m[:, 0] == 11.0)]
    row3 = [int(k) for k in np.flatnonzero(problem.xy_m[:, 1] == 7.0)][::-1][1:]
    back = [*down, *row3]  # r1: up column 5, then along row 3
    wait = slots + 1 - len(back)
    paths = (
        _path(problem, "r0", there, change=4),
        _path(problem, "r1", [back[0]] * wait + back, change=wait + 4, aps=(1, 0)),
        None,
    )
    cost = sum(p.arrival + slots * p.handovers for p in paths if p is not None)
    return Plan(
        status="unknown",
        robot_ids=ROBOTS,
        paths=paths,
        cost=cost,
        lower_bound=None,
        message="no path for lift 2",
        seconds=1.25,
        solver={"columns": 12, "iterations": 3, "seconds_pricing": 0.5},
    )


def _path(
    problem: Problem, robot: str, vertices: list[int], change: int, aps: tuple[int, int] = (0, 1)
) -> Path:
    edge = {tuple(sorted(uv)): e for e, uv in enumerate(problem.edge_uv.tolist())}
    edges = [edge[min(a, b), max(a, b)] if a != b else -1 for a, b in pairwise(vertices)]
    served = [aps[0] if k < change else aps[1] for k in range(len(vertices))]
    assert all(problem.cover[v, a] for v, a in zip(vertices, served, strict=True))
    return Path(robot, *(np.array(column, np.int32) for column in (vertices, served, edges)))


def _records(problem: Problem, plan: Plan, slots: int) -> Iterator[Record]:
    start = RunStart(
        t_s=0.0,
        world=problem.name,
        slot_s=SLOT_S,
        horizon=slots,
        samples_per_slot=SAMPLES,
        interruption_s=INTERRUPTION_S,
        threshold_db=THRESHOLD_DB,
        policy="group-commit",
        at_goal="leave",
        seed=0,
        robots=ROBOTS,
        aps=APS,
        ap_capacity=(3, 3),
    )
    yield start
    fold = KpiFold(start, planned_figures(plan))
    for slot in range(slots + 1):
        found = sorted(_slot(problem, plan, slot, slots), key=lambda record: record.t_s)
        for record in found:
            fold.add(record)
            yield record
        yield fold.current(min(slot + 1, slots) * SLOT_S, slot)
    yield from fold.final(slots * SLOT_S, slots)
    yield fold.waits(slots * SLOT_S)
    yield RunEnd(t_s=slots * SLOT_S, slot=slots, verdict="failed", message="lift 2 has no path")


def _slot(problem: Problem, plan: Plan, slot: int, slots: int) -> Iterator[Record]:
    """Records of one slot; the last one has its first instant only."""
    t_s = slot * SLOT_S
    if slot == 0:
        text = "the plan has no path for it"
        yield Incident(t_s, 0, "unserved", "lift 2", "", "", 0.0, text)
        message = "a pallet is in the way"
        yield Disturbance(t_s, 0, "blockage", "pallet", "", "", True, 0, -1.0, message)
        yield Replan(t_s, 0, 1, "blockage", "pallet", True, (0,), (), 9, 10, "a way around it")
        path = next(p for p in plan.paths if p is not None)
        columns = (path.vertices, path.aps, path.edges)
        yield NewPath(t_s, 0, 1, path.robot, *(tuple(c.tolist()) for c in columns), 0, True)
        box = ((7.5,), (0.5,), (1.0,), (0.25,), (1.2,), (0.8,), (2.0,))
        yield Blockages(t_s, 0, ("pallet",), *box)
    paths = [p for p in plan.paths if p is not None]
    load = [0] * len(APS)
    for path in paths:
        yield from _robot(path, problem, slot)
        if slot <= path.arrival:
            load[int(path.aps[slot])] += 1
    for name, served in zip(APS, load, strict=True):
        yield ApLoad(t_s=t_s, slot=slot, ap=name, load=served, capacity=3)
    for k in range(SAMPLES if slot < slots else 1):
        yield _sample(problem, paths, slot, k)
    if slot < slots:
        yield Separation(t_s + SLOT_S, slot, 3.25, "r0", "r1")
    if slot == OUTAGE_SLOT:
        text = "SNR below 10 dB for 2 s"
        yield Incident(t_s + SLOT_S, slot, "outage", "r1", "", "ap1", SLOT_S, text)


def _robot(path: Path, problem: Problem, slot: int) -> Iterator[Record]:
    t_s = slot * SLOT_S
    if slot > path.arrival + 1:
        return
    now = min(slot, path.arrival)
    here, a = int(path.vertices[now]), int(path.aps[now])
    moves = now < path.arrival and path.edges[now] >= 0
    following = int(path.vertices[now + 1]) if now < path.arrival else here
    out = path.robot == "r1" and slot == OUTAGE_SLOT
    state = RobotState(
        t_s=t_s,
        slot=slot,
        robot=path.robot,
        visit=now,
        vertex=here,
        edge=int(path.edges[now]) if moves else -1,
        next_vertex=following,
        activity=MOVING if moves else WAITING,
        waits_for="",
        ap=APS[a],
        link=OUTAGE if out else CONNECTED,
        snr_db=5.0 if out else float(problem.snr_db[here, a]),
        rate_mbps=0.0 if out else 800.0,
    )
    if slot > path.arrival:
        yield replace(state, activity=GONE, ap="", link="none", snr_db=-1000.0, rate_mbps=0.0)
    elif slot == path.arrival:
        yield replace(state, activity=ARRIVED)
        yield Arrival(t_s, slot, path.robot, here)
    elif path.aps[now + 1] != a:
        b = APS[int(path.aps[now + 1])]
        x, y = problem.xy_m[here].tolist()
        end = t_s + INTERRUPTION_S
        yield replace(state, ap=b, link=HANDOVER, rate_mbps=0.0)
        yield Handover(t_s, slot, path.robot, APS[a], b, here, following, x, y, end, planned=True)
        yield replace(state, t_s=end, ap=b)
    else:
        yield state


def _sample(problem: Problem, paths: list[Path], slot: int, k: int) -> Sample:
    rows = []
    for i, path in enumerate(paths):
        if slot > path.arrival:
            continue
        following = min(slot + 1, path.arrival)
        u, v = problem.xy_m[path.vertices[slot]], problem.xy_m[path.vertices[following]]
        x, y = u + (v - u) * k / SAMPLES
        heading = math.atan2(*(v - u)[::-1]) if following > slot else 0.0
        a = int(path.aps[following])
        snr = float(snr_db(np.array([[x, y]]))[0, a])
        link = HANDOVER if path.aps[slot] != a and k == 0 else CONNECTED
        if path.robot == "r1" and slot == OUTAGE_SLOT:
            snr, link = 5.0, OUTAGE
        rate = 800.0 if link == CONNECTED else 0.0
        rows.append((i, float(x), float(y), heading, a, snr, snr + 0.5, LINKS.index(link), rate))
    columns = list(zip(*rows, strict=True)) or [()] * 9
    return Sample((slot + k / SAMPLES) * SLOT_S, slot, *columns)
