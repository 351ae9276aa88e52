"""Lines 7 to 12 of Algorithm 1, compiled: prices robot after robot with one set of duals."""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.kernels import astar


@njit(cache=True, nogil=True)
def price(
    graph, robots, limit, scale, pv, pm, pa, use, g, ties, parent, stamp, now, cost, arcs, nodes
):
    """The least-cost path of each robot below its limit; each avoids, at equal cost, those before.

    Args:
        graph: `kernels_fleet.Graph`.
        robots: (k,) which.
        limit: (k,) int64, only a path that costs less is of interest [penalty units].
        scale, pv, pm, pa: as `kernels.astar` takes them.
        use: (T+1, V) int32 as there; the paths that are found are added to it.
        g, ties, parent, stamp, now: workspace as there; stamps now … now + k − 1 are used.
        cost: (k,) int64 receives the costs, or the limits where there is no path below them.
        arcs: (k, T) int32 receives the arc taken from each slot.
        nodes: (k, T+1) int32 receives the state in each slot.

    Returns:
        (k,) arrival slots, −1 where there is no path below the limit.
    """
    nothing_forbidden = np.zeros((0, 0), np.bool_)
    no_arrival = np.zeros(0, np.int64)
    arrival = np.empty(len(robots), np.int64)
    for k in range(len(robots)):
        i = robots[k]
        goal = graph.goal_of[i]
        found, tau, first = astar(
            graph.horizon,
            graph.arc_ptr,
            graph.arc_to,
            graph.arc_from,
            graph.arc_move,
            graph.arc_slots,
            graph.arc_cost,
            graph.node_vertex,
            graph.node_ap,
            graph.cost_to_go[goal],
            graph.slots_to_go[goal],
            graph.start_nodes[graph.start_ptr[i] : graph.start_ptr[i + 1]],
            graph.goal_nodes[graph.goal_ptr[i] : graph.goal_ptr[i + 1]],
            scale,
            pv,
            pm,
            pa,
            use,
            nothing_forbidden,
            graph.park,
            0,
            graph.latest[i],
            no_arrival,
            limit[k],
            g,
            ties,
            parent,
            stamp,
            now + k,
            arcs[k],
        )
        arrival[k] = tau
        cost[k] = limit[k] if tau < 0 else found
        if tau < 0:
            continue
        # A robot is at the tail of an arc until its last slot is over.
        node = np.int64(first)
        t = 0
        nodes[k, 0] = node
        while t < tau:
            arc = arcs[k, t]
            for j in range(1, graph.arc_slots[arc]):
                nodes[k, t + j] = node
            t += graph.arc_slots[arc]
            node = graph.arc_to[arc]
            nodes[k, t] = node
        for t in range(tau + 1):
            use[t, graph.node_vertex[nodes[k, t]]] += 1
    return arrival
