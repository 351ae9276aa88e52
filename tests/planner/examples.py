"""Problems small enough to follow by eye, and plans for them written state by state."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from planner.plan import Path, Plan
from planner.problem import Problem, edge_cover_of_ends


def grid(
    columns: int,
    rows: int,
    errands: Sequence[tuple[int, int]],
    *,
    n_aps: int = 2,
    horizon: int = 8,
    cover: Sequence[Sequence[int]] | None = None,
    **changes: object,
) -> Problem:
    """A grid of columns × rows vertices, numbered row by row, with robots r0, r1, … on errands.

    Args:
        columns: of the grid.
        rows: of the grid.
        errands: (start, goal) of each robot.
        n_aps: ap0, ap1, …, each of capacity N.
        horizon: T.
        cover: APs at each vertex; all of them when left out.
        **changes: of any field of `Problem`.
    """
    V = columns * rows
    covered = np.zeros((V, n_aps), bool)
    for v in range(V):
        covered[v, list(range(n_aps)) if cover is None else list(cover[v])] = True
    uv = [(v, v + 1) for v in range(V) if v % columns < columns - 1]
    uv += [(v, v + columns) for v in range(V - columns)]
    edge_uv = np.array(uv, np.int32).reshape(-1, 2)
    edge_uv = np.asarray(changes.get("edge_uv", edge_uv), np.int32)
    edge_cover, edge_handover = edge_cover_of_ends(covered, edge_uv)
    fields: dict[str, object] = {
        "name": "grid",
        "horizon": horizon,
        "objective": "hp",
        "c_t": 1,
        "c_h": horizon,
        "at_goal": "leave",
        "ap_ids": tuple(f"ap{a}" for a in range(n_aps)),
        "ap_capacity": np.full(n_aps, len(errands)),
        "xy_m": np.array([(v % columns, v // columns) for v in range(V)], float),
        "cover": covered,
        "snr_db": np.full((V, n_aps), np.nan),
        "edge_uv": edge_uv,
        "edge_slots": np.ones(len(edge_uv), np.int32),
        "edge_oneway": np.zeros(len(edge_uv), bool),
        "edge_cover": edge_cover,
        "edge_handover": edge_handover,
        "robot_ids": tuple(f"r{i}" for i in range(len(errands))),
        "start": np.array([start for start, _ in errands]),
        "goal": np.array([goal for _, goal in errands]),
    }
    return Problem(**{**fields, **changes})  # type: ignore[arg-type]


def path_of(problem: Problem, robot: int, states: str) -> Path:
    """A path written as "0a 1a 1b": vertices, each with its AP as a letter.

    Between different vertices the first edge that joins them is crossed; a mark such as "0a>2"
    says that edge 2 is being crossed in the slot after this state.
    """
    vertices, aps, marks = [], [], []
    for state in states.split():
        place, _, mark = state.partition(">")
        vertices.append(int(place[:-1]))
        aps.append(ord(place[-1]) - ord("a"))
        marks.append(int(mark) if mark else None)
    ends = [set(pair) for pair in problem.edge_uv.tolist()]
    edges = []
    for (u, v), mark in zip(pairwise(vertices), marks, strict=False):
        if mark is None:
            mark = ends.index({u, v}) if u != v and {u, v} in ends else -1  # noqa: PLW2901
        edges.append(mark)
    return Path(problem.robot_ids[robot], np.array(vertices), np.array(aps), np.array(edges, int))


def plan_of(problem: Problem, *states: str | None, **changes: object) -> Plan:
    """A plan of such paths, None for robots without one; its cost is right, its bound 0."""
    paths = tuple(
        None if text is None else path_of(problem, i, text) for i, text in enumerate(states)
    )
    cost = sum(problem.c_t * p.arrival + problem.c_h * p.handovers for p in paths if p)
    fields: dict[str, object] = {
        "status": "unknown" if None in paths else "feasible",
        "robot_ids": problem.robot_ids,
        "paths": paths,
        "cost": cost,
        "lower_bound": 0.0,
    }
    return Plan(**{**fields, **changes})  # type: ignore[arg-type]
