"""The compiled search kernels: static distances, and A* on G' with penalties.

They are plain functions over arrays, compiled by numba on first use and cached beside this file.
Costs are int64 in penalty units (`planner.resources.SCALE` per cost unit), so equal costs compare
equal and ties are broken the same way on every machine (§1.15).
"""

from __future__ import annotations

import numpy as np
from numba import njit

INFINITE = np.int64(1) << 60
BLOCKED = np.int64(1) << 52
MANY_BUCKETS = 4096


@njit(cache=True, nogil=True)
def _sift_up(key, tie, item, k):
    f, s, x = key[k], tie[k], item[k]
    while k > 0:
        parent = (k - 1) >> 1
        if key[parent] < f or (key[parent] == f and tie[parent] <= s):
            break
        key[k], tie[k], item[k] = key[parent], tie[parent], item[parent]
        k = parent
    key[k], tie[k], item[k] = f, s, x


@njit(cache=True, nogil=True)
def _sift_down(key, tie, item, n):
    f, s, x = key[0], tie[0], item[0]
    k = 0
    while True:
        child = 2 * k + 1
        if child >= n:
            break
        right = child + 1
        if right < n and (
            key[right] < key[child] or (key[right] == key[child] and tie[right] < tie[child])
        ):
            child = right
        if f < key[child] or (f == key[child] and s <= tie[child]):
            break
        key[k], tie[k], item[k] = key[child], tie[child], item[child]
        k = child
    key[k], tie[k], item[k] = f, s, x


@njit(cache=True, nogil=True)
def distances(ptr, arc, tail, weight, sources, n_nodes):
    """Dijkstra against the arcs: (n_nodes,) int64 least weight from each node to a source.

    Args:
        ptr, arc: arcs entering node k are arc[ptr[k]:ptr[k+1]].
        tail: (m,) node an arc leaves.
        weight: (m,) int64 ≥ 0.
        sources: nodes at distance 0.
        n_nodes: number of nodes.
    """
    dist = np.full(n_nodes, INFINITE)
    capacity = len(tail) + len(sources) + 1
    most = weight.max() if len(weight) > 0 else 0
    if most < MANY_BUCKETS:
        _by_buckets(ptr, arc, tail, weight, sources, dist, most + 1, capacity)
    else:
        _by_heap(ptr, arc, tail, weight, sources, dist, capacity)
    return dist


@njit(cache=True, nogil=True)
def _by_buckets(ptr, arc, tail, weight, sources, dist, n_buckets, capacity):
    """Small integer weights: nodes wait in a ring of buckets, one per distance (Dial, 1969)."""
    first = np.full(n_buckets, -1, np.int64)
    after = np.empty(capacity, np.int64)
    item = np.empty(capacity, np.int64)
    made = waiting = d = 0
    for s in sources:
        dist[s] = 0
        item[made], after[made], first[0] = s, first[0], made
        made += 1
        waiting += 1
    while waiting > 0:
        k = first[d % n_buckets]
        if k < 0:
            d += 1
            continue
        first[d % n_buckets] = after[k]
        waiting -= 1
        n = item[k]
        if dist[n] < d:
            continue
        for j in range(ptr[n], ptr[n + 1]):
            e = arc[j]
            m = tail[e]
            there = d + weight[e]
            if there < dist[m]:
                dist[m] = there
                b = there % n_buckets
                item[made], after[made], first[b] = m, first[b], made
                made += 1
                waiting += 1


@njit(cache=True, nogil=True)
def _by_heap(ptr, arc, tail, weight, sources, dist, capacity):
    key = np.empty(capacity, np.int64)
    tie = np.zeros(capacity, np.int64)
    item = np.empty(capacity, np.int64)
    size = 0
    for s in sources:
        dist[s] = 0
        key[size], item[size] = 0, s
        size += 1
        _sift_up(key, tie, item, size - 1)
    while size > 0:
        d, n = key[0], item[0]
        size -= 1
        key[0], tie[0], item[0] = key[size], tie[size], item[size]
        if size > 1:
            _sift_down(key, tie, item, size)
        if d > dist[n]:
            continue
        for k in range(ptr[n], ptr[n + 1]):
            e = arc[k]
            m = tail[e]
            if d + weight[e] < dist[m]:
                dist[m] = d + weight[e]
                key[size], item[size] = dist[m], m
                size += 1
                _sift_up(key, tie, item, size - 1)


@njit(cache=True, nogil=True)
def astar(
    horizon,
    arc_ptr,
    arc_to,
    arc_from,
    arc_move,
    arc_slots,
    arc_cost,
    node_vertex,
    node_ap,
    to_go,
    slots_to_go,
    start_nodes,
    goal_nodes,
    scale,
    pv,
    pm,
    pa,
    use,
    forbidden,
    park,
    earliest,
    latest,
    at_arrival,
    limit,
    g,
    ties,
    parent,
    stamp,
    now,
    path,
):
    """Least-cost path on G' from slot 0 to the goal with penalties, by A*.

    Args:
        horizon: T.
        arc_*, node_*: the static graph (`ExpandedGraph`).
        to_go: (n,) int64 cost from each node to the goal without penalties [cost units].
        slots_to_go: (n,) int32 slots from each node to the goal.
        start_nodes, goal_nodes: nodes of the origin and of the destination.
        scale: penalty units per cost unit; 0 prices penalties alone (phase 1).
        pv: (T+1, V) penalty of standing at a vertex in a slot t ≥ 1.
        pm: (T, 2E+V) penalty of a move that occupies its edge (or waits, or parks) in a slot.
        pa: (T+1, A) penalty of being served by an AP in a slot.
        use: (T+1, V) int32 how often others use a vertex: decides between equal costs.
        forbidden: (T+1, n) bool states not to be used, parking included, or shape (0, 0);
            A columns more say in which slots it may not be amid an edge, by the AP that serves.
        park: whether the goal and its AP stay occupied up to T after arrival.
        earliest, latest: slots between which the arrival must lie.
        at_arrival: (T+1,) penalty ≥ 0 of arriving in a slot, or shape (0,).
        limit: only paths that cost less than this are of interest.
        g, ties, parent, stamp: workspace of (T+1)·n entries; `now` is a stamp not used before.
        path: (T+1,) int32 receives the arc taken from each slot (repeated while it lasts).

    Returns:
        (cost, arrival slot, first node); cost is INFINITE if no path costs less than `limit`.
    """
    n_nodes = len(node_vertex)
    with_forbidden = forbidden.shape[0] > 0
    with_amid = forbidden.shape[1] > n_nodes
    with_arrival = len(at_arrival) > 0
    wait_at_goal = -1
    capacity = 4096
    key = np.empty(capacity, np.int64)
    tie = np.empty(capacity, np.int64)
    item = np.empty(capacity, np.int64)
    size = 0

    goal_vertex = node_vertex[goal_nodes[0]] if len(goal_nodes) > 0 else -1
    # Parking after an arrival in slot t costs the penalties of slots t+1 … T: suffix sums.
    after = np.zeros((horizon + 2, pa.shape[1]), np.int64)
    if park and goal_vertex >= 0:
        wait_at_goal = pm.shape[1] - pv.shape[1] + goal_vertex
        for t in range(horizon - 1, -1, -1):
            for k in range(len(goal_nodes)):
                a = node_ap[goal_nodes[k]]
                rest = after[t + 1, a] + pv[t + 1, goal_vertex] + pa[t + 1, a]
                rest += pm[t, wait_at_goal]
                if with_forbidden and forbidden[t + 1, goal_nodes[k]]:
                    rest = BLOCKED
                after[t, a] = min(rest, BLOCKED)
    last = min(latest, horizon)

    for k in range(len(start_nodes)):
        n = start_nodes[k]
        if slots_to_go[n] > last or pa[0, node_ap[n]] >= BLOCKED:
            continue
        if with_forbidden and forbidden[0, n]:
            continue
        cost = pa[0, node_ap[n]]
        f = cost + to_go[n] * scale
        if f >= limit:
            continue
        stamp[n] = now
        g[n] = cost
        ties[n] = 0
        parent[n] = -1
        key[size], tie[size], item[size] = f, slots_to_go[n], n
        size += 1
        _sift_up(key, tie, item, size - 1)

    while size > 0:
        f, order, s = key[0], tie[0], item[0]
        size -= 1
        key[0], tie[0], item[0] = key[size], tie[size], item[size]
        if size > 1:
            _sift_down(key, tie, item, size)
        if s < 0:  # an arrival, not a state
            s = -s - 1
            t_end = s // n_nodes
            t, n = t_end, s - t_end * n_nodes
            while parent[t * n_nodes + n] >= 0:
                arc = parent[t * n_nodes + n]
                k = arc_slots[arc]
                for j in range(t - k, t):
                    path[j] = arc
                t, n = t - k, arc_from[arc]
            return f, t_end, n
        t = s // n_nodes
        n = s - t * n_nodes
        if g[s] + to_go[n] * scale != f or (ties[s] << 20) + slots_to_go[n] != order:
            continue  # a better label of this state was expanded instead
        if node_vertex[n] == goal_vertex and earliest <= t <= last:
            rest = after[t, node_ap[n]] if park else 0
            if with_arrival:
                rest += at_arrival[t]
            if rest < BLOCKED and g[s] + rest < limit:
                if size + 1 >= capacity:
                    key = np.append(key, np.empty(capacity, np.int64))
                    tie = np.append(tie, np.empty(capacity, np.int64))
                    item = np.append(item, np.empty(capacity, np.int64))
                    capacity *= 2
                key[size], tie[size], item[size] = g[s] + rest, ties[s] << 20, -s - 1
                size += 1
                _sift_up(key, tie, item, size - 1)
        for arc in range(arc_ptr[n], arc_ptr[n + 1]):
            k = arc_slots[arc]
            t2 = t + k
            m = arc_to[arc]
            if t2 + slots_to_go[m] > last:
                continue
            if with_forbidden and forbidden[t2, m]:
                continue
            step = pv[t2, node_vertex[m]] + pa[t2, node_ap[m]] + pm[t, arc_move[arc]]
            for j in range(1, k):
                step += pm[t + j, arc_move[arc]] + pa[t + j, node_ap[n]]
                if with_amid and forbidden[t + j, n_nodes + node_ap[n]]:
                    step = BLOCKED
            if step >= BLOCKED:
                continue
            cost = g[s] + arc_cost[arc] * scale + step
            f = cost + to_go[m] * scale
            if f >= limit:
                continue
            s2 = t2 * n_nodes + m
            used = ties[s] + use[t2, node_vertex[m]]
            if stamp[s2] == now and (g[s2] < cost or (g[s2] == cost and ties[s2] <= used)):
                continue
            stamp[s2] = now
            g[s2] = cost
            ties[s2] = used
            parent[s2] = arc
            if size + 1 >= capacity:
                key = np.append(key, np.empty(capacity, np.int64))
                tie = np.append(tie, np.empty(capacity, np.int64))
                item = np.append(item, np.empty(capacity, np.int64))
                capacity *= 2
            key[size], tie[size], item[size] = f, (used << 20) + slots_to_go[m], s2
            size += 1
            _sift_up(key, tie, item, size - 1)
    return INFINITE, -1, -1
