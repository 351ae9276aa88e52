"""Of all penalties that prove a bound, those of the least sum: prices that promise least.

The optimal duals of the master are seldom unique. Where as many robots stand on the floor as its
APs have places, any amount can be added to the penalties of all APs in that slot and taken from
every robot's cost: the bound stays, and each AP looks dear although one place more would save
nothing. So the penalties are chosen anew: least Σ p, such that the bound is still proven. It is the
master's dual with one more row, solved over the columns there are; robots are priced exactly with
its answer, and the paths that refute it come in, until none does.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planner.master import Column
from planner.pgcp import PgcpState
from planner.resources import SCALE
from planner.search import Penalties

ROUNDS = 12
LOSS = 1e-4
"""The new penalties may prove this much less, by rounding [cost units]."""

Rows = NDArray[np.int64]


def least_penalties(
    state: PgcpState, *, stop: Callable[[], bool] = lambda: False
) -> tuple[Rows, Rows, int]:
    """Penalties of nearly the least sum that prove the bound of path generation.

    Args:
        state: at the end of path generation.
        stop: asked after every round; True gives up.

    Returns:
        (resources, penalties > 0 [1/SCALE], the bound they prove [1/SCALE]); those that path
        generation found where it gives up or finds none of a lesser sum.
    """
    given = state.bound_rows, state.bound_penalty, state.bound
    rows = state.bound_rows
    if not len(rows):
        return given
    least = int(state.bound - LOSS / 2 * SCALE)
    needed = -(-state.bound // SCALE)  # the bound as it is told, rounded up
    columns = [c for c in state.master.columns if c.path is not None]
    capacity = state.resources.capacity[rows].astype(np.int64)
    penalties = Penalties(state.resources)
    for _ in range(ROUNDS):
        penalty = _least_sum(state, columns, rows, least / SCALE)
        if penalty is None or stop():
            break
        penalties.set(rows, penalty)
        total, new = 0, []
        for i in range(state.master.n_robots):
            cost, path = state.search.shortest(i, penalties)
            total += cost
            if path is not None:
                new.append(state.master.column(i, path))
        bound = total - int(penalty @ capacity)
        if bound >= state.bound - LOSS * SCALE and -(-bound // SCALE) >= needed:
            if int(penalty.sum()) >= int(state.bound_penalty.sum()):
                break
            used = penalty > 0
            return rows[used], penalty[used], bound
        columns += new
    return given


def _least_sum(
    state: PgcpState, columns: list[Column], rows: Rows, least: float
) -> NDArray[np.int64] | None:
    """Penalties [1/SCALE] on `rows` of the least sum that give `least` over these columns."""
    from scipy.optimize import linprog
    from scipy.sparse import coo_array, vstack

    n, k = state.master.n_robots, len(rows)
    place = np.full(state.resources.n, -1, np.int64)
    place[rows] = np.arange(k)
    # φ_i − Σ_{r in s} p_r ≤ c_s for each column, and Σ cap_r p_r − Σ φ_i ≤ −least.
    used = np.concatenate([c.used for c in columns])
    of = np.repeat(np.arange(len(columns)), [len(c.used) for c in columns])
    mine = place[used] >= 0
    row = np.concatenate((np.arange(len(columns)), of[mine]))
    column = np.concatenate(([c.robot for c in columns], n + place[used[mine]]))
    factor = np.concatenate((np.ones(len(columns)), -np.ones(int(mine.sum()))))
    capacity = state.resources.capacity[rows].astype(np.float64)
    bound_row = coo_array(np.concatenate((-np.ones(n), capacity))[None, :])
    matrix = vstack((coo_array((factor, (row, column)), (len(columns), n + k)), bound_row))
    limit = np.concatenate(([float(c.cost) for c in columns], [-least]))
    found = linprog(
        np.concatenate((np.zeros(n), np.ones(k))),
        matrix.tocsr(),
        limit,
        bounds=[(None, None)] * n + [(0, None)] * k,
        method="highs-ds",
    )
    if found.status != 0:
        return None
    penalty: NDArray[np.int64] = np.rint(np.maximum(found.x[n:], 0.0) * SCALE).astype(np.int64)
    return penalty
