"""Phase 1: a proof that no plan exists within T (§1.12), by Farkas pricing.

In this master real paths cost 0 and artificial ones 1, so its optimum is 0 if and only if the
relaxation has a solution without artificial paths. The proof kept is the penalties p ≥ 0
themselves: if Σ_i (least penalty of any path of i, at most 1) > Σ p · capacity, then the robots
need more than there is. Both sides are integers; nothing in the proof is rounded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.master import Column, Master
from planner.plan import Path
from planner.resources import SCALE, Resources
from planner.search import Penalties, Search


@dataclass(frozen=True)
class InfeasibilityProof:
    """Penalties under which the robots need more than there is.

    Attributes:
        robots: those that take part in the bottleneck (a positive least penalty).
        resources: (k,) int64, resources with a positive penalty.
        penalty: (k,) int64 [1/SCALE].
        need: Σ_i least penalty of robot i, at most SCALE each.
        room: Σ penalty · capacity, less than `need`.
    """

    robots: tuple[int, ...]
    resources: NDArray[np.int64]
    penalty: NDArray[np.int64]
    need: int
    room: int


def prove_infeasible(
    search: Search,
    resources: Resources,
    paths: Sequence[tuple[int, Path]],
    *,
    stop: Callable[[], bool] = lambda: False,
) -> InfeasibilityProof | None:
    """Solves the phase-1 master to its optimum by path generation.

    Args:
        search, resources: of the problem.
        paths: (robot, path) to start with.
        stop: asked after every round; True gives up.

    Returns:
        The proof, or None if the relaxation has a solution (or `stop` said so).
    """
    master = Master(resources, artificial_cost=1.0)
    nothing = np.empty(0, np.int64)
    master.add([Column(i, path, 0.0, resources.used_by(path)) for i, path in paths])
    penalties = Penalties(resources)
    previous = nothing
    while True:
        lp = master.solve()
        if lp.value < 1e-7:
            return None
        penalty = lp.penalty()
        penalties.set(previous, np.int64(0))
        penalties.set(lp.rows, penalty)
        previous = lp.rows
        new, need, robots = [], 0, []
        for i in range(master.n_robots):
            limit = min(SCALE, max(0, int(np.floor(lp.robot_dual[i] * SCALE))))
            least, path = search.shortest(i, penalties, scale=0, limit=limit)
            need += least
            if least > 0:
                robots.append(i)
            if path is not None:
                new.append(Column(i, path, 0.0, resources.used_by(path)))
        room = int(penalty @ resources.capacity[lp.rows].astype(np.int64))
        if need > room:
            used = penalty > 0
            return InfeasibilityProof(tuple(robots), lp.rows[used], penalty[used], need, room)
        if master.add(new) == 0 or stop():
            return None
