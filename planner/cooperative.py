"""Cooperative A* (Silver, AIIDE 2005): robots plan one after another around those before them.

It gives the initial solution of Algorithm 1 (line 2) and, restarted over other orders with the
robots that failed put first, a plan where one order does not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from planner.fleet import FleetPlan
from planner.plan import Path
from planner.resources import BLOCKED, Resources
from planner.search import Penalties, Search


class Reservations:
    """What the planned robots occupy: a resource that is full is blocked for the others.

    Attributes:
        penalties: 0 where there is room, `BLOCKED` where there is none.
        count: (R,) int32 robots per resource.
    """

    def __init__(self, resources: Resources) -> None:
        self.resources = resources
        self.penalties = Penalties(resources)
        self.count = np.zeros(resources.n, np.int32)
        nothing = np.flatnonzero(resources.capacity <= 0)  # an AP that may serve nobody
        self.penalties.set(nothing, BLOCKED)

    def add(self, used: NDArray[np.int64]) -> None:
        """Occupies the resources of a path (`Resources.used_by`)."""
        self.count[used] += 1
        full = used[self.count[used] >= self.resources.capacity[used]]
        self.penalties.set(full, BLOCKED)

    def remove(self, used: NDArray[np.int64]) -> None:
        """Frees the resources of a path that was added."""
        self.count[used] -= 1
        free = used[self.count[used] < self.resources.capacity[used]]
        self.penalties.set(free, np.int64(0))


def cooperative_astar(
    search: Search,
    resources: Resources,
    order: Iterable[int],
    *,
    stop: Callable[[], bool] = lambda: False,
) -> list[Path | None]:
    """Plans the robots in `order`, each around those before it.

    Args:
        search, resources: of the problem.
        order: of the robots.
        stop: asked before every robot; True ends it.

    Returns:
        One path per robot, None for robots that found no way (and for robots not in `order`).
    """
    fleet = FleetPlan(search)
    for robot in order:
        if stop():
            break
        fleet.plan(robot)
    return fleet.paths()


def cooperative_with_restarts(
    search: Search,
    resources: Resources,
    *,
    restarts: int,
    rng: np.random.Generator,
    stop: Callable[[], bool] = lambda: False,
) -> list[Path | None]:
    """Cooperative A* over up to 1 + `restarts` orders: the given one first, then failures first.

    Args:
        search, resources: of the problem.
        restarts: orders after the first one, while a robot finds no way.
        rng: makes the orders.
        stop: asked after the first order and before every robot of the others; True ends it.

    Returns:
        The paths of the first order that serves every robot, else of the one that serves most.
    """
    n = len(search.problem.robot_ids)
    order: Sequence[int] = range(n)
    best: list[Path | None] = [None] * n
    served = -1
    for attempt in range(1 + restarts):
        again = {"stop": stop} if attempt else {}
        paths = cooperative_astar(search, resources, order, **again)
        failed = [i for i in range(n) if paths[i] is None]
        if n - len(failed) > served:
            best, served = paths, n - len(failed)
        if not failed or stop():
            break
        rest = [i for i in order if paths[i] is not None]
        # Those that failed go first; the others keep their order but for a little shuffling,
        # so that what worked is mostly kept.
        keys = np.arange(len(rest)) + rng.uniform(0, max(2.0, len(rest) / 4), len(rest))
        order = [*rng.permutation(failed).tolist(), *(rest[int(k)] for k in np.argsort(keys))]
    return best
