"""Small halls for the tests of the twin, resolved and mapped."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from logs.records import Incident
from planner.plan import Plan
from planner.problem import Problem, problem_from_world
from tests.twin.plans import make_plan, random_plan, walk
from twin.twin import run
from worlds.floor import Floor
from worlds.generate import resolve
from worlds.radio_map import RadioMap, build_radio_map, kept_vertices
from worlds.world import World

SQUARE = {"size": (8.0, 8.0), "aps": (("ap", (4.0, 4.0, 3.0)),)}
"""4 x 4 positions 2 m apart, all covered."""


class Hall(NamedTuple):
    """A world with all that follows from it."""

    world: World
    floor: Floor
    radio_map: RadioMap
    problem: Problem

    def walk(self, robot, *cells, aps=None):
        """The path through these cells (column, row), served by the APs of these names."""
        names = list(self.problem.ap_ids)
        numbers = [names.index(ap) for ap in aps] if aps else None
        return walk(self.problem, robot, *(self.vertex(*cell) for cell in cells), aps=numbers)

    def vertex(self, column, row):
        """The problem's vertex at a cell."""
        xy = self.floor.vertex_xy_m[(self.floor.vertex_cell == (column, row)).all(axis=1)][0]
        return int((self.problem.xy_m == xy).all(axis=1).argmax())

    def run(self, *paths, **options):
        """The records of the execution of a plan with these paths."""
        records = []
        run(*self, make_plan(self.problem, *paths), emit=records.append, **options)
        return records


def make_hall(
    *,
    size=(16.0, 2.0),
    aps=(("west", (0.0, 1.0, 3.0)),),
    obstacles=(),
    errands=(((0, 0), (7, 0)),),
    radio=None,
    plan=None,
    run=None,
    hall=None,
) -> Hall:
    """A hall of `size` with positions every 2 m, a slot of 2 s, and robots r0, r1, ….

    With its power of 4 dBm and a gain of 15 dB, an AP covers 18.8 m in line of sight and 5.4 m
    without (InH-Office at 60 GHz, threshold 10 dB); a robot's antenna is 0.5 m high.
    """
    world = make_world(size, aps, obstacles, radio, plan, run, hall, errands)
    floor = resolve(world)
    radio_map = build_radio_map(world, floor)
    return Hall(world, floor, radio_map, problem_from_world(world, floor, radio_map))


def make_world(size, aps, obstacles, radio, plan, run, hall, errands) -> World:
    """The world of `make_hall`; with one robot somewhere if `errands` is None."""
    listed = [
        {"id": f"r{i}", "start": {"cell": start}, "goal": {"cell": goal}}
        for i, (start, goal) in enumerate(errands or ())
    ]
    return World.model_validate(
        {
            "name": "test hall",
            "hall": {"size_m": size, "pitch_m": 2.0, "slot_s": 2.0, **(hall or {})},
            "obstacle": obstacles,
            "ap": [{"id": name, "position_m": place} for name, place in aps],
            **({"robots": {"random": {"count": 1}}} if errands is None else {"robot": listed}),
            "radio": {"tx_power_dbm": 4.0, "edge_rule": "samples", **(radio or {})},
            "plan": {"horizon": 40, **(plan or {})},
            "run": {"interruption": 100.0, **(run or {})},
        }
    )


def random_hall(
    seed: int, *, rule: str, slow: bool = False, at_goal: str = "leave", robots: int = 8
) -> tuple[Hall, Plan]:
    """A hall with random racks, pillars, APs and errands, and a random plan for it.

    Args:
        seed: of everything; even ones have shadow fading.
        rule: "samples" or "endpoints".
        slow: edges take 1 to 3 slots.
        at_goal: "leave" or "park".
        robots: how many.
    """
    rng = np.random.default_rng(seed)
    obstacles = [
        {
            "center_m": tuple(rng.uniform(2, 10, 2).tolist()),
            "size_m": tuple(rng.uniform(0.3, 2.0, 2).tolist()),
            "height_m": float(rng.uniform(1, 3.5)),
            "yaw_deg": float(rng.uniform(0, 90)),
        }
        for _ in range(6)
    ]
    radio = {"edge_rule": rule, "tx_power_dbm": 2.0, "shadow_fading": seed % 2 == 0}
    aps = [(f"ap{k}", (*rng.uniform(0, 12, 2).tolist(), 4.0)) for k in range(3)]
    world = make_world(
        (14.0, 12.0), aps, obstacles, radio, {"at_goal": at_goal}, None, None, errands=None
    )
    floor = resolve(world)
    radio_map = build_radio_map(world, floor)
    kept = kept_vertices(radio_map)
    starts, goals = (rng.permutation(kept)[:robots] for _ in range(2))
    edges = len(floor.edge_uv)
    floor = replace(
        floor,
        edge_slots=(rng.integers(1, 4, edges) if slow else np.ones(edges)).astype(np.int32),
        robot_ids=tuple(f"r{i}" for i in range(len(starts))),
        start=starts,
        goal=goals,
    )
    problem = problem_from_world(world, floor, radio_map)
    return Hall(world, floor, radio_map, problem), random_plan(problem, rng)


def of_type(records, *types):
    """The records of these types."""
    return [r for r in records if isinstance(r, types)]


def incidents(records):
    """(slot, kind, robot, other, ap) of each incident."""
    return [(r.slot, r.kind, r.robot, r.other, r.ap) for r in of_type(records, Incident)]
