"""Tidying: a robot that drives to and fro waits instead, where it may and costs no more.

Waiting costs like moving (§1.9), so a plan of least cost may hold detours u → v → u that a plant
engineer would rightly ask about. Each is replaced by waiting at u if that leaves the plan valid.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.plan import Path
from planner.resources import Resources


def tidy(resources: Resources, paths: Sequence[Path | None]) -> list[Path | None]:
    """The plan with every needless reversal replaced by waiting; cost and arrivals stay.

    Args:
        resources: of the problem.
        paths: a plan that breaks no rule.
    """
    used = [None if path is None else resources.used_by(path) for path in paths]
    count = np.zeros(resources.n, np.int64)
    for mine in used:
        if mine is not None:
            count[mine] += 1
    tidied: list[Path | None] = list(paths)
    for i, path in enumerate(paths):
        if path is None:
            continue
        for t in range(path.arrival - 1):
            current = tidied[i]
            assert current is not None
            candidate = _waiting(resources, current, t)
            if candidate is None or candidate.handovers > current.handovers:
                continue
            before, after = used[i], resources.used_by(candidate)
            count[before] -= 1
            if np.all(count[after] < resources.capacity[after]):
                tidied[i], used[i] = candidate, after
                count[after] += 1
            else:
                count[before] += 1
    return tidied


def _waiting(resources: Resources, path: Path, t: int) -> Path | None:
    """The path with u → v → u over slots t … t+2 replaced by waiting, None if it is not there."""
    problem = resources.problem
    there, back = int(path.edges[t]), int(path.edges[t + 1])
    if there < 0 or there != back or problem.edge_slots[there] != 1:
        return None
    if path.vertices[t] != path.vertices[t + 2] or path.vertices[t] == path.vertices[t + 1]:
        return None
    vertices, aps, edges = path.vertices.copy(), path.aps.copy(), path.edges.copy()
    vertices[t + 1] = vertices[t]
    edges[t] = edges[t + 1] = -1
    # Any change of AP happens in the second of the two slots; both APs cover u.
    aps[t + 1] = aps[t]
    return Path(path.robot, vertices, aps, edges)
