"""Logs of small runs made on the whole road from world.toml, for the tests of the validator."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from logs.mcap_writer import RunLog
from planner.plan import Path as RobotPath
from planner.plan import Plan
from planner.problem import Problem, problem_from_world
from planner.solve import SolveParams, solve
from twin.twin import run
from worlds.errands import with_covered_robots
from worlds.radio_map import build_radio_map
from worlds.toml_file import open_world

WORLDS = Path(__file__).resolve().parents[2] / "worlds"
POST_WORLD = """
format = "mapp-world/1"
name = "post"
story = "A post hides the access point north from the middle of an edge, not from its ends."

[hall]
size_m = [12.0, 6.0]
pitch_m = 2.0

[[obstacle]]
name = "post"
center_m = [4.41, 2.0]
size_m = [0.2, 0.2]
height_m = 3.0

[[ap]]
id = "north"
position_m = [6.0, 5.9, 1.0]

[[ap]]
id = "corner"
position_m = [11.9, 0.1, 1.0]

[radio]
edge_rule = "endpoints"
tx_power_dbm = 0.0

[[robot]]
id = "r0"
start = { cell = [0, 0] }
goal = { cell = [5, 0] }

[[robot]]
id = "r1"
start = { cell = [5, 2] }
goal = { cell = [0, 2] }

[plan]
objective = "snr"
horizon = 20

[run]
interruption = 400.0
"""
Options = tuple[tuple[str, object], ...]


@cache
def folder() -> Path:
    """Where logs of this test session lie."""
    return Path(tempfile.mkdtemp(prefix="mapp-logs-"))


@cache
def log_of(
    options: Options = (), make_plan: Callable[[Problem], Plan] | None = None, world: str = "tiny"
) -> Path:
    """The log of a run.

    Args:
        options: overrides of the world's keys.
        make_plan: makes the plan instead of the planner.
        world: the name of a world that ships, or a world's text.
    """
    return write_log(folder() / f"run{log_of.cache_info().misses}.mcap", world, options, make_plan)


def write_log(
    path: Path,
    world: str,
    options: Options = (),
    make_plan: Callable[[Problem], Plan] | None = None,
) -> Path:
    """The same, made anew and written to `path`."""
    source = WORLDS / f"{world}.toml"
    if "\n" in world:
        source = path.with_suffix(".toml")
        source.write_text(world)
    world_, floor = open_world(source, overrides=dict(options))
    radio_map = build_radio_map(world_, floor)
    floor = with_covered_robots(world_, floor, radio_map)
    problem = problem_from_world(world_, floor, radio_map)
    planned = make_plan(problem) if make_plan else plan(problem)
    inputs = {"floor": floor, "radio_map": radio_map, "problem": problem, "plan": planned}
    with RunLog(path, world=world_, **inputs) as log:
        run(world_, **inputs, emit=log.write)
    return path


def plan(problem: Problem) -> Plan:
    """A plan, quickly."""
    return solve(problem, SolveParams(method="cooperative"))


def heedless_plan(problem: Problem) -> Plan:
    """Everybody's way as if alone on the floor: robots may meet, and APs be overloaded."""
    paths: list[RobotPath | None] = []
    for i, name in enumerate(problem.robot_ids):
        alone = replace(
            problem,
            robot_ids=(name,),
            start=problem.start[i : i + 1],
            goal=problem.goal[i : i + 1],
            ap_capacity=np.ones_like(problem.ap_capacity),
        )
        paths += plan(alone).paths
    return _of(problem, paths)


def partial_plan(problem: Problem) -> Plan:
    """A plan in which the last robot has no path."""
    return _of(problem, [*plan(problem).paths[:-1], None])


def empty_plan(problem: Problem) -> Plan:
    """A plan in which no robot has a path."""
    return _of(problem, [None] * problem.n_robots)


def _of(problem: Problem, paths: list[RobotPath | None]) -> Plan:
    found = [path for path in paths if path is not None]
    cost = sum(problem.c_t * path.arrival + problem.c_h * path.handovers for path in found)
    return Plan("unknown", problem.robot_ids, tuple(paths), cost, None)
