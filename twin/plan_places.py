"""Where the robots of a plan or a run stand and change access points, as places in the hall."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twin.errors import TwinError

if TYPE_CHECKING:
    from planner.plan import Plan
    from planner.problem import Problem
    from worlds.floor import Floor
    from worlds.radio_map import RadioMap
    from worlds.world import World

_SAME_M = 1e-6


@dataclass(frozen=True)
class PlanPlaces:
    """What a plan or a run does at places.

    Attributes:
        source: the file, for titles.
        slots: (V,) int64, robot-slots at each vertex of the floor.
        handover_xy_m: (H, 2) where access points change [m].
        handovers: (H,) from which access point to which.
    """

    source: str
    slots: NDArray[np.int64]
    handover_xy_m: NDArray[np.float64]
    handovers: tuple[tuple[str, str], ...]


def plan_places(path: Path, world: World, floor: Floor, radio_map: RadioMap) -> PlanPlaces:
    """What a plan.json for the world, or the log of a run of it, does where.

    A plan's handover lies in the middle of the way of its slot; a log tells where it happened.

    Raises:
        TwinError: the log is of another hall, or the file is neither.
        WorldError, PlannerError, LogError: the file cannot be read, or is for another world.
    """
    suffix = path.suffix.lower()
    if suffix == ".mcap":
        return _of_run(path, floor)
    if suffix != ".json":
        raise TwinError(f"{path}: is neither a plan.json nor a RUN.mcap")
    from planner.json_files import read_plan
    from twin.instance import survey

    problem = survey(world, floor, radio_map=radio_map).problem
    plan = read_plan(path, problem)
    xy, pairs = _planned(plan, problem)
    return PlanPlaces(path.name, _slots(plan, problem, floor, path), xy, pairs)


def _of_run(path: Path, floor: Floor) -> PlanPlaces:
    from logs.mcap_reader import read
    from logs.records import Handover

    run = read(path)
    told = [h for h in run.of(Handover) if h.from_ap]
    xy = np.array([(h.x_m, h.y_m) for h in told], dtype=np.float64).reshape(-1, 2)
    slots = _slots(run.plan, run.problem, floor, path)
    return PlanPlaces(path.name, slots, xy, tuple((h.from_ap, h.to_ap) for h in told))


def _planned(
    plan: Plan, problem: Problem
) -> tuple[NDArray[np.float64], tuple[tuple[str, str], ...]]:
    """Places and access points of a plan's handovers, robot by robot in the order of time."""
    places, pairs = [], []
    for path in plan.paths:
        if path is None:
            continue
        for t in np.flatnonzero(np.diff(path.aps)).tolist():
            ends = problem.xy_m[[path.vertices[t], path.vertices[t + 1]]]
            places.append(ends.mean(axis=0))
            pairs.append((problem.ap_ids[path.aps[t]], problem.ap_ids[path.aps[t + 1]]))
    return np.array(places, dtype=np.float64).reshape(-1, 2), tuple(pairs)


def _slots(plan: Plan, problem: Problem, floor: Floor, path: Path) -> NDArray[np.int64]:
    """(V,) robot-slots at each vertex of the floor."""
    from scipy.spatial import cKDTree

    away, vertex = cKDTree(floor.vertex_xy_m).query(problem.xy_m)
    if (away > _SAME_M).any():
        raise TwinError(f"{path}: is of a run in another hall; give one of this world")
    stood = [route.vertices for route in plan.paths if route is not None]
    count = np.bincount(np.concatenate([[], *stood]).astype(np.intp), minlength=len(vertex))
    slots = np.zeros(len(floor.vertex_xy_m), dtype=np.int64)
    slots[vertex] = count
    return slots
