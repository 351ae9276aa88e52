"""Compiles every search kernel ahead, so that no time limit is spent on it."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

from planner import kernels
from planner.json_problem import parse_problem
from planner.params import SolveParams

MODULES = (
    "kernels",
    "kernels_exact",
    "kernels_fleet",
    "kernels_joint",
    "kernels_lns",
    "kernels_pricing",
)
"""Where the kernels are."""

FLOOR = ("..#..#..", "........", "..#..#..")
"""A passage with bays (# is no position)."""
ERRANDS = (
    ((0, 1), (7, 1)),
    ((7, 1), (0, 1)),
    ((0, 0), (7, 2)),
    ((7, 0), (0, 2)),
    ((1, 1), (6, 1)),
    ((6, 1), (1, 1)),
)
"""Robots that meet in it: the search for the optimum needs all it has."""
HORIZON = 24


def kernels_are_compiled() -> bool:
    """Whether the kernels of every module were compiled before, by this process or on this machine.

    Where numba compiles nothing (`NUMBA_DISABLE_JIT`) there is nothing left to do.
    """
    stats = getattr(kernels.astar, "stats", None)
    if stats is None or compile_kernels.cache_info().currsize:
        return True
    folder = stats.cache_path
    return folder is not None and all(any(Path(folder).glob(f"{m}.*.nbi")) for m in MODULES)


@cache
def compile_kernels() -> None:
    """Plans a few robots until proven optimal; numba keeps what it compiles for later processes.

    Once per process, so that it costs little where numba cannot keep anything.
    """
    from planner.solve import solve

    cell = {
        (x, y): v
        for v, (x, y) in enumerate(
            (x, y) for y, row in enumerate(FLOOR) for x, sign in enumerate(row) if sign != "#"
        )
    }
    middle = len(FLOOR[0]) // 2
    vertices = [
        {"x": x, "y": y, "aps": [0] if x < middle else [0, 1] if x == middle else [1]}
        for x, y in cell
    ]
    edges = [
        {"u": cell[x, y], "v": cell[there]}
        for x, y in cell
        for there in ((x + 1, y), (x, y + 1))
        if there in cell
    ]
    robots = [
        {"id": f"r{i}", "start": cell[a], "goal": cell[b]} for i, (a, b) in enumerate(ERRANDS)
    ]
    problem = parse_problem(
        json.dumps(
            {
                "format": "mapp-problem/1",
                "name": "warm-up",
                "horizon": HORIZON,
                "ap_capacity": len(ERRANDS),
                "objective": "hp",
                "at_goal": "leave",
                "aps": ["a", "b"],
                "vertices": vertices,
                "edges": edges,
                "robots": robots,
            }
        )
    )
    solve(problem, SolveParams(method="exact", iterations=100, nodes=50))
