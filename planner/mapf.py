"""Plain multi-agent path finding (MAPF) as a special case: one AP everywhere, capacity N.

So the planner can be measured against the MAPF field on its benchmarks: agents stay at their goals
(`park`), a plan costs the sum of its arrival slots ("sum of costs"), edges join the four
neighbours of a cell (R. Stern et al., SoCS 2019, DOI 10.1609/socs.v10i1.18510).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import shortest_path

from planner.errors import PlannerError
from planner.problem import Problem, edge_cover_of_ends
from planner.validation import MAX_HORIZON

CHUNK = 64
"""Agents whose distances are computed at a time; bounds the memory."""


def mapf_problem(
    name: str,
    passable: NDArray[np.bool_],
    starts: NDArray[np.integer],
    goals: NDArray[np.integer],
    horizon: int | None = None,
) -> Problem:
    """The problem of agents on a grid.

    Vertex k is the k-th passable cell, row by row. A cell's side is 1 m; y points up in `xy_m`, so
    that a picture of it looks like the map's file.

    MAPF knows no horizon, ours needs one. If none is given it is the longest of the agents'
    shortest paths plus 32 + 24·K²/V slots. That slack is a guess, on the safe side, at the sum of
    all delays in a best plan (on the benchmark's maps with up to 150 agents, at most 21 times
    K²/V): no single agent of it can then be later than the horizon. What the horizon may cut off
    all the same is no guess: `cheapest_beyond` is a proven bound on every plan that it excludes,
    so a bound or an optimum up to there holds for any horizon. "Infeasible", however, always means
    within the horizon.

    Args:
        name: of the instance.
        passable: (height, width) bool, [y, x] from the upper left.
        starts, goals: (K, 2) integers, (x, y) of each agent.
        horizon: T [slots]; chosen as above if None.

    Raises:
        PlannerError: an agent starts or ends off the map, on a blocked cell, or where another
            does; a horizon out of range.
    """
    free = np.asarray(passable, np.bool_)
    height, width = free.shape
    index = np.full(free.shape, -1, np.int32)
    index[free] = np.arange(int(free.sum()), dtype=np.int32)
    ends = []
    faults = []
    for what, cells in (("start", starts), ("goal", goals)):
        xy = np.asarray(cells, np.int64).reshape(-1, 2)
        inside = np.all((xy >= 0) & (xy < (width, height)), axis=1)
        at = np.where(inside, index[tuple(np.where(inside[:, None], xy, 0)[:, ::-1].T)], -1)
        faults += [
            f"{name}: agent {i}: its {what}, (x {xy[i, 0]}, y {xy[i, 1]}), is not a passable cell"
            for i in np.flatnonzero(at < 0)
        ]
        ends.append(at.astype(np.int32))
    if faults:
        raise PlannerError(*faults)

    rows, columns = np.nonzero(free)
    right, down = free[:, :-1] & free[:, 1:], free[:-1] & free[1:]
    edge_uv = np.concatenate(
        (
            np.stack((index[:, :-1][right], index[:, 1:][right]), axis=1),
            np.stack((index[:-1][down], index[1:][down]), axis=1),
        )
    )
    V, N = len(rows), len(ends[0])
    cover = np.ones((V, 1), np.bool_)
    edge_cover, edge_handover = edge_cover_of_ends(cover, edge_uv)
    if horizon is None:
        alone = _distances(V, edge_uv, *ends)
        longest = int(alone[np.isfinite(alone)].max(initial=0))
        horizon = min(max(1, longest + 32 + 24 * N * N // V), MAX_HORIZON)
    digits = len(str(max(N - 1, 0)))
    return Problem(
        name=name,
        horizon=horizon,
        objective="costs",
        c_t=1,
        c_h=0,
        at_goal="park",
        ap_ids=("everywhere",),
        ap_capacity=np.array([N], np.int32),
        xy_m=np.stack((columns, height - 1 - rows), axis=1).astype(np.float64),
        cover=cover,
        snr_db=np.full((V, 1), np.nan),
        edge_uv=edge_uv,
        edge_slots=np.ones(len(edge_uv), np.int32),
        edge_oneway=np.zeros(len(edge_uv), np.bool_),
        edge_cover=edge_cover,
        edge_handover=edge_handover,
        robot_ids=tuple(f"r{i:0{max(digits, 2)}d}" for i in range(N)),
        start=ends[0],
        goal=ends[1],
    )


def cheapest_beyond(problem: Problem) -> int:
    """A lower bound on the cost of every plan of a MAPF problem that its horizon excludes.

    In such a plan some agent i arrives in slot T + 1 at the earliest, the others no earlier than
    their shortest paths d_j allow: it costs at least T + 1 + Σ_{j≠i} d_j, and that is least for
    the longest d_i. So a lower bound proven within the horizon holds without it up to this number,
    and a plan that is optimal within the horizon and costs no more is optimal.

    Args:
        problem: made by `mapf_problem`.

    Returns:
        T + 1 + Σ d − max d; agents that cannot reach their goal at all count 0.
    """
    alone = _distances(problem.n_vertices, problem.edge_uv, problem.start, problem.goal)
    slots = np.where(np.isfinite(alone), alone, 0).astype(np.int64)
    return int(problem.horizon + 1 + slots.sum() - slots.max(initial=0))


def _distances(
    n_vertices: int,
    edge_uv: NDArray[np.int32],
    start: NDArray[np.int32],
    goal: NDArray[np.int32],
) -> NDArray[np.float64]:
    """(N,) slots each agent needs alone, infinite where there is no way."""
    graph = coo_array(
        (np.ones(len(edge_uv)), (edge_uv[:, 0], edge_uv[:, 1])), shape=(n_vertices, n_vertices)
    ).tocsr()
    found = np.empty(len(start))
    for k in range(0, len(start), CHUNK):
        part = slice(k, k + CHUNK)
        tree = shortest_path(
            graph, method="D", directed=False, unweighted=True, indices=start[part]
        )
        found[part] = tree[np.arange(len(tree)), goal[part]]
    return found
