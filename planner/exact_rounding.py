"""A plan from a fractional LP solution: likely paths first, A* around them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.cooperative import Reservations
from planner.master import Column
from planner.plan import Path
from planner.resources import Resources
from planner.search import Search


def rounded_plan(
    search: Search, resources: Resources, columns: list[Column], x: NDArray[np.float64]
) -> list[Path | None]:
    """Takes paths by falling x while they fit, then the best ones around them for the others.

    Returns:
        A path per robot that keep the rules together, None for robots that found no way.
    """
    order = sorted(
        (k for k in np.flatnonzero(x > 1e-6).tolist() if columns[k].path is not None),
        key=lambda k: (-round(float(x[k]), 6), k),
    )
    taken = Reservations(resources)
    paths: list[Path | None] = [None] * search.problem.n_robots
    for k in order:
        column = columns[k]
        used = column.used[column.used < resources.n]
        room = taken.count[used] < resources.capacity[used]
        if paths[column.robot] is None and room.all():
            paths[column.robot] = column.path
            taken.add(used)
    for i, path in enumerate(paths):
        if path is None:
            _, found = search.shortest(i, taken.penalties)
            paths[i] = found
            if found is not None:
                taken.add(resources.used_by(found))
    return paths
