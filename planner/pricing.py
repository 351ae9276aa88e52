"""The best path of each robot under one set of duals, in one compiled call."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner import kernels_pricing
from planner.fleet import graph_of
from planner.plan import Path
from planner.resources import SCALE
from planner.search import INFINITE, Penalties, Search


def best_paths(
    search: Search,
    robots: Sequence[int],
    penalties: Penalties,
    *,
    limits: NDArray[np.int64],
    use: NDArray[np.int32],
    scale: int = SCALE,
) -> tuple[NDArray[np.int64], list[Path | None]]:
    """The same as `Search.shortest` for one robot after another, each marking what it uses.

    Args:
        search: of the problem.
        robots: k of them.
        penalties: on resources and moves.
        limits: (k,) only a path that costs less is looked for [penalty units].
        use: (T+1, V) how often others use a vertex, which decides between equal costs; the paths
            found are added.
        scale: penalty units per cost unit, 0 to price the penalties alone.

    Returns:
        (k,) costs [penalty units] and the paths; where there is none below the limit, that limit
        (at most INFINITE) and None. In both cases the first is a lower bound.
    """
    graph, k, T = search.graph, len(robots), search.problem.horizon
    cost = np.empty(k, np.int64)
    arcs, nodes = np.empty((k, T), np.int32), np.empty((k, T + 1), np.int32)
    arrival = kernels_pricing.price(
        graph_of(search),
        np.asarray(robots, np.int64),
        np.minimum(limits, INFINITE),
        scale,
        penalties.vertex,
        penalties.move,
        penalties.ap,
        use,
        *search.workspace(k),
        cost,
        arcs,
        nodes,
    )
    paths: list[Path | None] = [None] * k
    for row in np.flatnonzero(arrival >= 0).tolist():
        tau = int(arrival[row])
        states, taken = nodes[row, : tau + 1], arcs[row, :tau]
        path = Path(
            search.problem.robot_ids[robots[row]],
            graph.node_vertex[states],
            graph.node_ap[states],
            graph.arc_edge[taken],
        )
        for array in (path.vertices, path.aps, path.edges):
            array.flags.writeable = False
        paths[row] = path
    return cost, paths
