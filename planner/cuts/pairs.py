"""What the families that look at pairs of robots share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.master import Column
from planner.problem import Problem
from planner.resources import Resources


def neighbours(
    problem: Problem,
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.bool_]]:
    """Vertices next to each, itself included: (V+1,) pointers, heads, and whether by one edge only.

    Two robots may swap places where two edges join them, so only `single` ones forbid it (§1.3).
    """
    V, uv = problem.n_vertices, problem.edge_uv
    back = ~problem.edge_oneway
    tail = np.concatenate((np.arange(V), uv[:, 0], uv[back, 1])).astype(np.int64)
    head = np.concatenate((np.arange(V), uv[:, 1], uv[back, 0])).astype(np.int64)
    pair = np.sort(uv, axis=1).astype(np.int64) @ np.array([V, 1])
    times = dict(zip(*(x.tolist() for x in np.unique(pair, return_counts=True)), strict=True))
    arcs = np.unique(tail * V + head)
    tail, head = arcs // V, arcs % V
    between = np.minimum(tail, head) * V + np.maximum(tail, head)
    single = np.array([times.get(k, 1) == 1 for k in between.tolist()], np.bool_)
    ptr = np.searchsorted(tail, np.arange(V + 1)).astype(np.int32)
    return ptr, head.astype(np.int32), single


def interacting_pairs(
    columns: list[Column], x: NDArray[np.float64], resources: Resources
) -> list[tuple[int, int]]:
    """Pairs of robots with paths of x > 0 that cannot both be in a plan, in order."""
    positive = [k for k in np.flatnonzero(x > 1e-6).tolist() if columns[k].path is not None]
    if not positive:
        return []
    robots, row = np.unique([columns[k].robot for k in positive], return_inverse=True)
    meet = _meeting([columns[k] for k in positive], row, resources)
    first, second = np.nonzero(np.triu(meet, 1))
    return list(zip(robots[first].tolist(), robots[second].tolist(), strict=True))


def _meeting(
    columns: list[Column], row: NDArray[np.int64], resources: Resources
) -> NDArray[np.bool_]:
    """(rows, rows) bool: columns of the two rows use one vertex or edge in one slot."""
    used = [column.used[column.used < resources.first_ap] for column in columns]
    n = int(row.max()) + 1
    both = np.concatenate(used) * n + np.repeat(row, [len(u) for u in used])
    resource, user = np.divmod(np.unique(both), n)
    meet = np.zeros((n, n), np.bool_)
    for apart in range(1, len(user)):
        same = resource[apart:] == resource[:-apart]
        if not same.any():
            break
        meet[user[:-apart][same], user[apart:][same]] = True
    return meet | meet.T


def partners(pairs: list[tuple[int, int]]) -> dict[int, set[int]]:
    """The robots that each one is paired with."""
    near: dict[int, set[int]] = {}
    for i, j in pairs:
        near.setdefault(i, set()).add(j)
        near.setdefault(j, set()).add(i)
    return near


def positive_by_robot(columns: list[Column], x: NDArray[np.float64]) -> dict[int, list[int]]:
    """Real columns of x > 0, by robot, in order."""
    mine: dict[int, list[int]] = {}
    for k in np.flatnonzero(x > 1e-6).tolist():
        if columns[k].path is not None:
            mine.setdefault(columns[k].robot, []).append(k)
    return mine


def sweep_ends(problem: Problem, pair: tuple[int, int]) -> NDArray[np.int32]:
    """(4,) int32: start and goal of the one, start and goal of the other, as the sweeps take it."""
    i, j = pair
    ends = [problem.start[i], problem.goal[i], problem.start[j], problem.goal[j]]
    return np.array(ends, np.int32)


def clashing_pairs(
    columns: list[Column], x: NDArray[np.float64], resources: Resources, most: int
) -> list[tuple[int, int]]:
    """Pairs of robots with more than one path of x > 0 each that exclude each other most, in order.

    How much is Σ x_p x_q over their pairs of paths that use one vertex or edge in one slot: the
    chance of a clash if each drew its path by x.
    """
    mine = {i: ks for i, ks in positive_by_robot(columns, x).items() if len(ks) > 1}
    users = [k for ks in mine.values() for k in ks]
    if not users:
        return []
    meet = _meeting([columns[k] for k in users], np.arange(len(users)), resources)
    clash = meet * np.outer(x[users], x[users])
    # Summed over the paths of each robot.
    first = np.cumsum([0, *(len(ks) for ks in mine.values())][:-1])
    weight = np.add.reduceat(np.add.reduceat(clash, first, axis=0), first, axis=1)
    robots = list(mine)
    found = [
        (-round(float(weight[a, b]), 6), min(robots[a], robots[b]), max(robots[a], robots[b]))
        for a, b in zip(*(side.tolist() for side in np.nonzero(np.triu(weight, 1))), strict=True)
    ]
    return sorted((i, j) for _, i, j in sorted(found)[:most])
