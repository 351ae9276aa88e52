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
    problem: Problem,
    routes: dict[int, Route],
    serving: Ints,
    capacity: Ints,
    out: NDArray[np.bool_],
) -> dict[int, Route]:
    """The routes with the fewest handovers, beginning with the AP that serves.

    If the loads leave no such APs they are not looked at: late robots may overload an AP, too. A
    route for which the rules of coverage (§1.6, §1.7) leave none is kept as it is. So is the rest
    of a crossing at whose end the route has the AP that serves already.

    Args:
        problem: whose graph the routes are in.
        routes: by robot; their ways are kept.
        serving: (N,) AP that serves each robot now.
        capacity: (A,) places for these robots.
        out: (A,) APs that serve nobody.
    """
    longest = max((len(r.vertices) for r in routes.values()), default=0)
    load = np.zeros((longest, problem.n_aps), np.int64)
    for route in routes.values():
        np.add.at(load, (np.arange(len(route.aps)), route.aps), 1)
    found = {}
    for i, route in routes.items():
        own = np.arange(len(route.aps))
        np.add.at(load, (own, route.aps), -1)
        for room in (load < capacity, np.broadcast_to(~out, load.shape)):
            aps = _fewest_handovers(problem, route, int(serving[i]), room)
            if aps is not None:
                break
        if aps is not None:
            route = replace(route, aps=aps)  # noqa: PLW2901
        np.add.at(load, (own, route.aps), 1)
        found[i] = route
    return found


def has_begun(route: Route, serving: int) -> bool:
    """Whether a route begins amid a crossing whose handover has been made: `serving` serves."""
    if not route.piece or serving in {-1, route.aps[0]}:
        return False
    amid = np.flatnonzero(
        (route.edges != route.edges[0]) | (route.vertices[:-1] != route.vertices[0])
    )
    end = int(amid[0]) if len(amid) else len(route.edges)
    return bool(route.aps[end] == serving)


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
    begun = has_begun(route, first)
    cost = np.where(np.arange(problem.n_aps) == (route.aps[0] if begun else first), 0.0, np.inf)
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
            if begin == 0 and begun:
                allowed = np.outer(eye[route.aps[0]], eye[first])
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
