"""Compiled kernels of `planner.joint`: layered graphs of one robot, and their products."""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.kernels import BLOCKED, INFINITE

GONE = -1


@njit(cache=True, nogil=True)
def robot_layers(
    arc_ptr,
    arc_to,
    arc_move,
    arc_cost,
    node_vertex,
    node_ap,
    start_nodes,
    goal_nodes,
    scale,
    pv,
    pm,
    pa,
    park,
    behind,
    ending,
    last,
    limit,
):
    """The states and moves of one robot's paths that cost at most `limit` (edges of one slot).

    Args:
        arc_*, node_*, scale, pv, pm, pa, park: as for `kernels.astar`.
        start_nodes, goal_nodes: nodes of the origin and of the destination.
        behind, ending: of `kernels_exact.costs_behind`.
        last: latest arrival.
        limit: of the penalised cost.

    Returns:
        (T+3,) first state of each layer: slots 0 … T, and T+1 where it is gone for good; nodes and
        vertices of the states (a gone robot has none, a parked one is at its goal); (S+1,) first
        arc of each state; heads and costs of the arcs; least cost from the origin, and to the end.
    """
    horizon, n_nodes = behind.shape[0] - 1, behind.shape[1]
    room = 1024
    node, vertex = np.empty(room, np.int32), np.empty(room, np.int32)
    g, h = np.empty(room, np.int64), np.empty(room, np.int64)
    ptr = np.zeros(room + 1, np.int64)
    wide = 4096
    head, cost = np.empty(wide, np.int64), np.empty(wide, np.int64)
    layer = np.zeros(horizon + 3, np.int64)
    number = np.full((2, n_nodes + 1), -1)  # of the layers at hand; the last entry: gone
    goal_vertex = node_vertex[goal_nodes[0]]
    which = np.full(n_nodes, -1)
    for k in range(len(goal_nodes)):
        which[goal_nodes[k]] = k
    count, arcs = 0, 0
    for n in start_nodes:
        before = pa[0, node_ap[n]]
        if before < BLOCKED and behind[0, n] < INFINITE and before + behind[0, n] <= limit:
            node[count], vertex[count], g[count], h[count] = n, node_vertex[n], before, behind[0, n]
            number[0, n] = count
            count += 1
    for t in range(horizon + 1):
        layer[t + 1] = count
        there = (t + 1) % 2
        number[there, :] = -1
        for s in range(layer[t], layer[t + 1]):
            ptr[s] = arcs
            n = node[s]
            low, high = (arc_ptr[n], arc_ptr[n + 1]) if n >= 0 and t < horizon else (0, 0)
            for arc in range(low - 1, high):
                # Before the arcs: being gone from the next slot on.
                if arc < low:
                    m = n_nodes
                    if n < 0:
                        step, rest = np.int64(0), np.int64(0)
                    elif which[n] >= 0 and t <= last and ending[t, which[n]] < INFINITE:
                        step, rest = ending[t, which[n]], np.int64(0)
                    else:
                        continue
                else:
                    m = arc_to[arc]
                    if t + 1 > last or behind[t + 1, m] >= INFINITE:
                        continue
                    step = pv[t + 1, node_vertex[m]] + pa[t + 1, node_ap[m]] + pm[t, arc_move[arc]]
                    if step >= BLOCKED:
                        continue
                    step += arc_cost[arc] * scale
                    rest = behind[t + 1, m]
                if g[s] + step + rest > limit:
                    continue
                s2 = number[there, m]
                if s2 < 0:
                    if count == room:
                        node = np.append(node, np.empty(room, np.int32))
                        vertex = np.append(vertex, np.empty(room, np.int32))
                        g = np.append(g, np.empty(room, np.int64))
                        h = np.append(h, np.empty(room, np.int64))
                        ptr = np.append(ptr, np.zeros(room, np.int64))
                        room *= 2
                    s2 = count
                    number[there, m] = s2
                    node[s2] = m if m < n_nodes else GONE
                    if m < n_nodes:
                        vertex[s2] = node_vertex[m]
                    else:
                        vertex[s2] = goal_vertex if park and t < horizon else GONE
                    g[s2], h[s2] = g[s] + step, rest
                    count += 1
                g[s2] = min(g[s2], g[s] + step)
                if arcs == wide:
                    head = np.append(head, np.empty(wide, np.int64))
                    cost = np.append(cost, np.empty(wide, np.int64))
                    wide *= 2
                head[arcs], cost[arcs] = s2, step
                arcs += 1
    layer[horizon + 2] = count
    for s in range(layer[horizon + 1], count + 1):
        ptr[s] = arcs
    return (
        layer,
        node[:count],
        vertex[:count],
        ptr[: count + 1],
        head[:arcs],
        cost[:arcs],
        g[:count],
        h[:count],
    )


@njit(cache=True, nogil=True)
def _fit(vertex_a, vertex_b, x, y, x2, y2, single):
    """Whether two moves keep §1.2 and §1.3 towards each other."""
    for i in range(vertex_a.shape[1]):
        u, u2 = vertex_a[x, i], vertex_a[x2, i]
        for j in range(vertex_b.shape[1]):
            w2 = vertex_b[y2, j]
            if u2 >= 0 and u2 == w2:
                return False
            if u2 >= 0 and w2 >= 0 and u != u2 and u == w2 and u2 == vertex_b[y, j]:
                if single[u, u2]:
                    return False
    return True


@njit(cache=True, nogil=True)
def product_layers(
    layer_a,
    vertex_a,
    ptr_a,
    head_a,
    cost_a,
    g_a,
    h_a,
    layer_b,
    vertex_b,
    ptr_b,
    head_b,
    cost_b,
    g_b,
    h_b,
    single,
    limit,
    max_steps,
):
    """What two groups of robots can do together at a joint cost of at most `limit`.

    Args:
        layer_*, ptr_*, head_*, cost_*, g_*, h_*: of the groups, as `robot_layers` returns them.
        vertex_*: (S, k) the vertices of the groups' robots.
        single: (V, V) bool, where two vertices are joined by one edge only.
        limit: of the joint cost.
        max_steps: give up after so many pairs of moves.

    Returns:
        Layers, the two groups' states of each joint state, arcs, costs from the origins and to the
        ends, as `robot_layers`; and the pairs of moves looked at, -1 when given up.
    """
    n_layers = len(layer_a) - 1
    room, wide = 4096, 8192
    of_a, of_b = np.empty(room, np.int64), np.empty(room, np.int64)
    g = np.empty(room, np.int64)
    ptr = np.zeros(room + 1, np.int64)
    head, cost = np.empty(wide, np.int64), np.empty(wide, np.int64)
    layer = np.zeros(n_layers + 1, np.int64)
    count, arcs, steps = 0, 0, 0
    for x in range(layer_a[0], layer_a[1]):
        for y in range(layer_b[0], layer_b[1]):
            if g_a[x] + h_a[x] + g_b[y] + h_b[y] <= limit:
                if count == room:
                    of_a = np.append(of_a, np.empty(room, np.int64))
                    of_b = np.append(of_b, np.empty(room, np.int64))
                    g = np.append(g, np.empty(room, np.int64))
                    ptr = np.append(ptr, np.zeros(room, np.int64))
                    room *= 2
                of_a[count], of_b[count], g[count] = x, y, g_a[x] + g_b[y]
                count += 1
    layer[1] = count
    for t in range(n_layers - 1):
        base_a, base_b = layer_a[t + 1], layer_b[t + 1]
        number = np.full((layer_a[t + 2] - base_a, layer_b[t + 2] - base_b), -1)
        for s in range(layer[t], layer[t + 1]):
            ptr[s] = arcs
            x, y = of_a[s], of_b[s]
            for arc_a in range(ptr_a[x], ptr_a[x + 1]):
                x2 = head_a[arc_a]
                f_a = g[s] + cost_a[arc_a] + h_a[x2]
                if f_a > limit:
                    continue
                for arc_b in range(ptr_b[y], ptr_b[y + 1]):
                    y2 = head_b[arc_b]
                    steps += 1
                    if f_a + cost_b[arc_b] + h_b[y2] > limit:
                        continue
                    if not _fit(vertex_a, vertex_b, x, y, x2, y2, single):
                        continue
                    step = cost_a[arc_a] + cost_b[arc_b]
                    s2 = number[x2 - base_a, y2 - base_b]
                    if s2 < 0:
                        if count == room:
                            of_a = np.append(of_a, np.empty(room, np.int64))
                            of_b = np.append(of_b, np.empty(room, np.int64))
                            g = np.append(g, np.empty(room, np.int64))
                            ptr = np.append(ptr, np.zeros(room, np.int64))
                            room *= 2
                        s2 = count
                        number[x2 - base_a, y2 - base_b] = s2
                        of_a[s2], of_b[s2], g[s2] = x2, y2, g[s] + step
                        count += 1
                    g[s2] = min(g[s2], g[s] + step)
                    if arcs == wide:
                        head = np.append(head, np.empty(wide, np.int64))
                        cost = np.append(cost, np.empty(wide, np.int64))
                        wide *= 2
                    head[arcs], cost[arcs] = s2, step
                    arcs += 1
            if steps > max_steps:
                return layer, of_a[:0], of_b[:0], ptr[:1], head[:0], cost[:0], g[:0], g[:0], -1
        layer[t + 2] = count
    for s in range(layer[n_layers - 1], count + 1):
        ptr[s] = arcs
    # Back from the end: what the joint states cost from here on, and which are within the limit.
    h = np.full(count, INFINITE)
    for s in range(count - 1, -1, -1):
        if s >= layer[n_layers - 1]:
            h[s] = 0
        for arc in range(ptr[s], ptr[s + 1]):
            h[s] = min(h[s], cost[arc] + h[head[arc]])
    renamed = np.full(count, -1)
    kept = 0
    for s in range(count):
        if h[s] < INFINITE and g[s] + h[s] <= limit:
            renamed[s] = kept
            kept += 1
    new_layer = np.zeros(n_layers + 1, np.int64)
    new_ptr = np.zeros(kept + 1, np.int64)
    filled, t = 0, 0
    for s in range(count):
        while s >= layer[t + 1]:
            t += 1
        if renamed[s] < 0:
            continue
        k = renamed[s]
        of_a[k], of_b[k] = of_a[s], of_b[s]
        new_layer[t + 1] = k + 1
        low, high = ptr[s], ptr[s + 1]
        new_ptr[k] = filled
        for arc in range(low, high):
            s2 = head[arc]
            if renamed[s2] >= 0 and g[s] + cost[arc] + h[s2] <= limit:
                head[filled], cost[filled] = renamed[s2], cost[arc]
                filled += 1
        g[k], h[k] = g[s], h[s]
    new_ptr[kept] = filled
    for t in range(n_layers):
        new_layer[t + 1] = max(new_layer[t + 1], new_layer[t])
    return (
        new_layer,
        of_a[:kept],
        of_b[:kept],
        new_ptr,
        head[:filled],
        cost[:filled],
        g[:kept],
        h[:kept],
        steps,
    )
