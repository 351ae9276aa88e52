"""Which AP serves along ways that are fixed, if the first one is given.

A planner chooses the first AP of a path freely (§1.9). In the middle of a run there is one that
serves already, and to begin with another one is a handover. So the APs of new ways are chosen anew,
one robot after the other, by dynamic programming over the APs with the loads of the others as they
are.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twin.order import Route

if TYPE_CHECKING:
    from planner.problem import Problem

Ints = NDArray[np.int32]


def keep_serving(
    problem: Problem, routes: dict[int, Route], serving: Ints, capacity: Ints
) -> dict[int, Route]:
    """The routes with the fewest handovers, beginning with the AP that serves.

    A route for which there are no such APs within the rules (§1.6, §1.7) is left as it is.

    Args:
        problem: whose graph the routes are in.
        routes: by robot; their ways are kept.
        serving: (N,) AP that serves each robot now.
        capacity: (A,) places for these robots.
    """
    longest = max((len(r.vertices) for r in routes.values()), default=0)
    load = np.zeros((longest, problem.n_aps), np.int64)
    for route in routes.values():
        np.add.at(load, (np.arange(len(route.aps)), route.aps), 1)
    found = {}
    for i, route in routes.items():
        own = np.arange(len(route.aps))
        np.add.at(load, (own, route.aps), -1)
        aps = _fewest_handovers(problem, route, int(serving[i]), load < capacity)
        if aps is not None:
            route = replace(route, aps=aps)  # noqa: PLW2901
        np.add.at(load, (own, route.aps), 1)
        found[i] = route
    return found


def _fewest_handovers(
    problem: Problem, route: Route, first: int, room: NDArray[np.bool_]
) -> Ints | None:
    """(τ+1,) APs, None if the rules leave none."""
    stops = [0]
    while stops[-1] < len(route.edges):
        t = stops[-1]
        edge = int(route.edges[t])
        k = int(problem.edge_slots[edge]) if edge >= 0 else 1
        stops.append(t + k - (route.piece if t == 0 else 0))
    eye = np.eye(problem.n_aps, dtype=np.bool_)
    cost = np.where(np.arange(problem.n_aps) == first, 0.0, np.inf)
    back: list[NDArray[np.intp]] = []
    for begin, end in pairwise(stops):
        edge, v = int(route.edges[begin]), int(route.vertices[begin])
        if edge < 0:
            cover = problem.cover[v]
            allowed = np.outer(cover, cover) | np.diag(eye[first] if begin == 0 else cover)
        else:
            pairs = problem.edge_handover[edge]
            pairs = pairs if problem.edge_uv[edge, 0] == v else pairs.T
            allowed = pairs | np.diag(problem.edge_cover[edge])
        # In its first slot a robot is served as it is; there may be no room for it by the count.
        fits = room[max(begin, 1) : end].all(axis=0)
        until = room[end] & problem.cover[route.vertices[end]]
        step = np.where(allowed, np.where(eye, 0.0, 1.0), np.inf)
        total = cost[:, None] + step + np.where(fits, 0.0, np.inf)[:, None]
        total = total + np.where(until, 0.0, np.inf)
        back.append(total.argmin(axis=0))
        cost = total.min(axis=0)
    if not np.isfinite(cost).any():
        return None
    aps = np.empty(len(route.vertices), np.int32)
    a = int(cost.argmin())
    aps[-1] = a
    for (begin, end), choice in reversed(list(zip(pairwise(stops), back, strict=True))):
        a = int(choice[a])
        aps[begin:end] = a
    return aps
