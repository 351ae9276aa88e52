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
    pairs: set[tuple[int, int]] = set()
    positive = [k for k in np.flatnonzero(x > 1e-6).tolist() if columns[k].path is not None]
    if not positive:
        return []
    used = np.concatenate([columns[k].used for k in positive])
    user = np.concatenate([np.full(len(columns[k].used), columns[k].robot) for k in positive])
    scarce = used < resources.first_ap  # vertices and edges
    order = np.lexsort((user[scarce], used[scarce]))
    used, user = used[scarce][order], user[scarce][order]
    if not len(used):
        return []
    low = np.flatnonzero(np.diff(used, prepend=-1))
    for begin, end in zip(low.tolist(), [*low[1:].tolist(), len(used)], strict=True):
        if end - begin > 1:
            robots = sorted(set(user[begin:end].tolist()))
            pairs.update((i, j) for n, i in enumerate(robots) for j in robots[n + 1 :])
    return sorted(pairs)
