"""Tidying keeps a plan valid and as cheap, and leaves no reversal that waiting could replace."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from planner.check import check_plan
from planner.plan import Path
from planner.resources import Resources
from planner.solve import SolveParams, solve
from planner.tidy import tidy
from tests.oracles.tiny_problems import random_hall
from tests.planner.examples import grid, plan_of


def _path(robot: str, vertices: list[int], edges: list[int]) -> Path:
    return Path(
        robot, np.array(vertices, np.int32), np.zeros(len(vertices), np.int32), np.array(edges)
    )


def test_a_reversal_becomes_a_wait() -> None:
    """A robot that drives 0 → 1 → 0 → 1 → 2 on an empty floor waits two slots instead (§1.9)."""
    problem = grid(3, 1, [(0, 2)], n_aps=1, horizon=6)
    paths = tidy(
        Resources.of(problem), [_path(problem.robot_ids[0], [0, 1, 0, 1, 2], [0, 0, 0, 1])]
    )
    assert paths[0] is not None
    assert paths[0].vertices.tolist() == [0, 0, 0, 1, 2]


def test_a_reversal_that_makes_way_stays() -> None:
    """A robot that steps aside for another does not wait in its way (§1.2)."""
    # r0 at 1 steps to 4 and back while r1 crosses 0 → 1 → 2 on a floor of 3 × 2.
    problem = grid(3, 2, [(1, 3), (0, 2)], n_aps=1, horizon=8)
    edge = {frozenset(map(int, uv)): e for e, uv in enumerate(problem.edge_uv)}

    def path(robot: int, vertices: list[int]) -> Path:
        pairs = pairwise(vertices)
        return _path(
            problem.robot_ids[robot], vertices, [edge.get(frozenset(p), -1) for p in pairs]
        )

    paths = [path(0, [1, 4, 1, 4, 3]), path(1, [0, 1, 2])]
    tidied = tidy(Resources.of(problem), paths)
    assert tidied[0] is not None
    assert tidied[0].vertices.tolist() in ([1, 4, 1, 4, 3], [1, 4, 4, 4, 3])
    assert not check_plan(
        problem, plan_of(problem, *(" ".join(f"{v}a" for v in p.vertices) for p in tidied if p))
    )


@pytest.mark.parametrize("at_goal", ["leave", "park"])
def test_plans_stay_valid_and_as_cheap(at_goal: str) -> None:
    """On a crowded hall the tidied plan passes the checker at the same cost, and is a fixpoint."""
    problem = random_hall(3, 10, 0.25, 20, 20, 40, "hp", at_goal)
    plan = solve(problem, SolveParams(iterations=100))
    assert not check_plan(problem, plan)
    again = tidy(Resources.of(problem), plan.paths)
    assert [p and p.vertices.tolist() for p in again] == [
        p and p.vertices.tolist() for p in plan.paths
    ]
