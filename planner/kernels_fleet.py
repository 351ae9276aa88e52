# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators
"""The compiled search of one robot around all others: safe intervals instead of slots.

Where others only block or do not block, a robot that comes to a place earlier may wait there for
what it could do later, as long as nobody else needs the place. So a label is a node and a *safe
interval* of it (SIPP: Phillips, Likhachev, ICRA 2011, DOI 10.1109/ICRA.2011.5980306), not a node
and a slot: a goal that somebody passes late costs a few labels more, not every slot until then at
every place nearby. With handovers a label also says what it has cost beyond its time; one that
came no later and paid no more dominates. What is taken is kept in bits, 64 slots
in a word, so that the next free slot of a place is a few machine instructions away.

All costs are in whole cost units. `planner.kernels.astar` is for prices, which differ slot by slot.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.kernels import INFINITE, _sift_down, _sift_up

Ints = NDArray[np.int32]
Longs = NDArray[np.int64]

WORD = 64
_ONE, _ALL, _SIX = np.uint64(1), np.uint64(0xFFFFFFFFFFFFFFFF), np.uint64(58)
_DE_BRUIJN = np.uint64(0x03F79D71B4CB0A89)
_LOWEST = np.zeros(WORD, np.int64)
for _k in range(WORD):
    _LOWEST[((int(_DE_BRUIJN) << _k) & 0xFFFFFFFFFFFFFFFF) >> 58] = _k

# What a label says; it is a row of integers.
SLOT, EXTRA, NODE, END, PARENT, ARC, NEXT, DEAD, N_FIELDS = range(9)


class Graph(NamedTuple):
    """The static graph and the robots, as the kernels read them."""

    horizon: int
    park: bool
    c_t: int
    n_edges: int
    arc_ptr: NDArray[np.int32]
    arc_to: NDArray[np.int32]
    arc_from: NDArray[np.int32]
    arc_move: NDArray[np.int32]
    arc_slots: NDArray[np.int32]
    arc_cost: NDArray[np.int64]
    wait_arc: NDArray[np.int32]  # (n,) arc that waits at a node with its AP
    node_vertex: NDArray[np.int32]
    node_ap: NDArray[np.int32]
    goal_of: NDArray[np.int32]  # (N,) row of the goal in the tables of distances
    cost_to_go: NDArray[np.int64]  # (goals, n)
    slots_to_go: NDArray[np.int32]  # (goals, n)
    start_ptr: NDArray[np.int64]
    start_nodes: NDArray[np.int32]
    goal_ptr: NDArray[np.int64]
    goal_nodes: NDArray[np.int32]
    latest: NDArray[np.int32]  # (N,) slot by which each must arrive
    ap_capacity: NDArray[np.int32]
    least_cost: NDArray[np.int64]  # (N,) alone on the floor


class Fleet(NamedTuple):
    """Paths and what they occupy; all arrays are changed in place."""

    arcs: NDArray[np.int32]  # (N, T) arc taken from each slot, repeated while it lasts
    first: NDArray[np.int32]  # (N,) node in slot 0
    arrival: NDArray[np.int64]  # (N,) slot, -1 for robots without a path
    cost: NDArray[np.int64]  # (N,) cost, of the caller's choice for robots without a path
    node_at: NDArray[np.int32]  # (N, T+1) node in each slot (left last amid an edge), -1 if none
    at_vertex: NDArray[np.int32]  # (T+1, V) robot there, -1 if none
    on_edge: NDArray[np.int32]  # (T, E)
    ap_load: NDArray[np.int32]  # (T+1, A)
    busy_vertex: NDArray[np.uint64]  # (V, words) bit t & 63 of word t >> 6: taken in slot t
    busy_edge: NDArray[np.uint64]  # (E, words)
    full_ap: NDArray[np.uint64]  # (A, words)
    head: NDArray[np.int64]  # (n,) scratch of the search: last label of each node
    stamp: NDArray[np.int64]  # (n,) and the search that made it
    now: NDArray[np.int64]  # (1,)
    labels: NDArray[np.int64]  # (1,) labels made by all searches so far


@njit(cache=True, nogil=True)
def _put(bits, row, t, taken):
    word, bit = t >> 6, _ONE << np.uint64(t & 63)
    if taken:
        bits[row, word] |= bit
    else:
        bits[row, word] &= ~bit


@njit(cache=True, nogil=True)
def next_slot(x, i, y, j, t, last, taken):
    """The first slot in t … last in which row i of x or row j of y is taken (or neither is).

    Returns:
        last + 1 if there is none.
    """
    if t > last:
        return last + 1
    w, end = t >> 6, last >> 6
    word = x[i, w] | y[j, w]
    if not taken:
        word = ~word
    word &= _ALL << np.uint64(t & 63)
    while word == 0:
        w += 1
        if w > end:
            return last + 1
        word = x[i, w] | y[j, w]
        if not taken:
            word = ~word
    lowest = word & (~word + _ONE)
    return min((w << 6) + _LOWEST[np.int64((lowest * _DE_BRUIJN) >> _SIX)], last + 1)


@njit(cache=True, nogil=True)
def _serve(graph, fleet, i, t, node, add):
    a = graph.node_ap[node]
    fleet.ap_load[t, a] += 1 if add else -1
    _put(fleet.full_ap, a, t, fleet.ap_load[t, a] >= graph.ap_capacity[a])
    fleet.node_at[i, t] = node if add else -1


@njit(cache=True, nogil=True)
def _stand(graph, fleet, i, t, node, add):
    v = graph.node_vertex[node]
    fleet.at_vertex[t, v] = i if add else -1
    _put(fleet.busy_vertex, v, t, add)


@njit(cache=True, nogil=True)
def occupy(graph, fleet, i, add):
    """Adds the path of robot i to what is occupied, or takes it away."""
    tau = fleet.arrival[i]
    if tau < 0:
        return
    node = fleet.first[i]
    _serve(graph, fleet, i, 0, node, add)
    t = 0
    while t < tau:
        arc = fleet.arcs[i, t]
        k = graph.arc_slots[arc]
        move = graph.arc_move[arc]
        if move < 2 * graph.n_edges:
            e = move >> 1
            for j in range(t, t + k):
                fleet.on_edge[j, e] = i if add else -1
                _put(fleet.busy_edge, e, j, add)
        for j in range(t + 1, t + k):
            _serve(graph, fleet, i, j, node, add)
        t += k
        node = graph.arc_to[arc]
        _serve(graph, fleet, i, t, node, add)
        _stand(graph, fleet, i, t, node, add)
    if graph.park:
        for j in range(tau + 1, graph.horizon + 1):
            _serve(graph, fleet, i, j, node, add)
            _stand(graph, fleet, i, j, node, add)


@njit(cache=True, nogil=True)
def _stays_free_from(graph, fleet, node):
    """The first slot from which a node is free up to T, T + 1 if it is not free then."""
    T, v, a = graph.horizon, graph.node_vertex[node], graph.node_ap[node]
    begin = 0
    while True:
        begin = next_slot(fleet.busy_vertex, v, fleet.full_ap, a, begin, T, False)
        taken = next_slot(fleet.busy_vertex, v, fleet.full_ap, a, begin, T, True)
        if taken > T:
            return begin
        begin = taken


@njit(cache=True, nogil=True)
def _mixed(number, salt):
    """20 bits that look random; they decide between labels that are as good."""
    x = np.uint64(number) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(salt)
    x ^= x >> np.uint64(31)
    x *= np.uint64(0xBF58476D1CE4E5B9)
    return np.int64(x >> np.uint64(44))


@njit(cache=True, nogil=True)
def plan_robot(graph, fleet, i, limit, salt):
    """Least-cost path of robot i around all others in the fleet.

    Args:
        graph, fleet: see their types; robot i occupies nothing.
        i: the robot.
        limit: only a path that costs less is of interest.
        salt: decides between paths that cost the same; 0 prefers the label made first.

    Returns:
        Whether there is one; then it is in the fleet, which is not occupied by it yet.
    """
    T, c_t, last = graph.horizon, graph.c_t, graph.latest[i]
    to_go, slots_to_go = graph.cost_to_go[graph.goal_of[i]], graph.slots_to_go[graph.goal_of[i]]
    vertices, aps, edges = fleet.busy_vertex, fleet.full_ap, fleet.busy_edge
    safe = 0  # no arrival before this slot can stay (§1.4)
    goal_vertex = -1
    if graph.goal_ptr[i] < graph.goal_ptr[i + 1]:
        goal_vertex = graph.node_vertex[graph.goal_nodes[graph.goal_ptr[i]]]
        if graph.park:
            safe = T + 1
            for k in range(graph.goal_ptr[i], graph.goal_ptr[i + 1]):
                safe = min(safe, _stays_free_from(graph, fleet, graph.goal_nodes[k]))
    if safe > last:
        return False
    fleet.now[0] += 1
    now = fleet.now[0]
    labels = np.empty((1024, N_FIELDS), np.int64)
    key = np.empty(1024, np.int64)
    tie = np.empty(1024, np.int64)
    item = np.empty(1024, np.int64)
    made, size = 0, 0
    for k in range(graph.start_ptr[i], graph.start_ptr[i + 1]):
        n = graph.start_nodes[k]
        v, a = graph.node_vertex[n], graph.node_ap[n]
        f = max(to_go[n], c_t * safe)
        if slots_to_go[n] > last or f >= limit:
            continue
        end = next_slot(vertices, v, aps, a, 0, T, True) - 1
        if end < 0:
            continue
        labels[made, SLOT], labels[made, EXTRA], labels[made, NODE] = 0, 0, n
        labels[made, END], labels[made, PARENT], labels[made, ARC] = end, -1, -1
        labels[made, NEXT], labels[made, DEAD] = -1, 0
        fleet.stamp[n], fleet.head[n] = now, made
        key[size], tie[size], item[size] = f, np.int64(slots_to_go[n]) << 20, made
        made += 1
        size += 1
        _sift_up(key, tie, item, size - 1)

    while size > 0:
        label = item[0]
        size -= 1
        key[0], tie[0], item[0] = key[size], tie[size], item[size]
        if size > 1:
            _sift_down(key, tie, item, size)
        if labels[label, DEAD]:
            continue
        t, w = labels[label, SLOT], labels[label, EXTRA]
        n = labels[label, NODE]
        end = labels[label, END]
        if graph.node_vertex[n] == goal_vertex and (end == T or not graph.park):
            fleet.arrival[i] = t
            fleet.cost[i] = c_t * t + w
            while labels[label, PARENT] >= 0:
                arc, before = labels[label, ARC], labels[label, PARENT]
                t = labels[label, SLOT] - graph.arc_slots[arc]
                fleet.arcs[i, t : labels[label, SLOT]] = arc
                n = labels[before, NODE]
                fleet.arcs[i, labels[before, SLOT] : t] = graph.wait_arc[n]
                label = before
            fleet.first[i] = n
            fleet.labels[0] += made
            return True
        a = graph.node_ap[n]
        for arc in range(graph.arc_ptr[n], graph.arc_ptr[n + 1]):
            m = graph.arc_to[arc]
            if m == n and arc == graph.wait_arc[n]:
                continue
            k = graph.arc_slots[arc]
            e = graph.arc_move[arc] >> 1
            crosses = graph.arc_move[arc] < 2 * graph.n_edges
            v, b = graph.node_vertex[m], graph.node_ap[m]
            w2 = w + graph.arc_cost[arc] - c_t * k
            until = min(end, last - k - slots_to_go[m])
            d = t
            while d <= until:
                if crosses:
                    d = next_slot(edges, e, edges, e, d, until, False)
                    if d > until:
                        break
                    if k > 1:
                        # The AP of the vertex it left serves until it arrives (§1.6).
                        taken = next_slot(edges, e, aps, a, d, d + k - 1, True)
                        if taken < d + k:
                            d = taken + 1
                            continue
                t2 = next_slot(vertices, v, aps, b, d + k, until + k, False)
                if t2 > d + k:
                    d = t2 - k
                    continue
                f = w2 + max(c_t * t2 + to_go[m], c_t * safe)
                if f >= limit:
                    break
                end2 = next_slot(vertices, v, aps, b, t2, T, True) - 1
                d = end2 + 2 - k  # the next departure that leads into another interval
                dominated = False
                other = fleet.head[m] if fleet.stamp[m] == now else -1
                first = other
                while other >= 0:
                    if labels[other, END] == end2:
                        if labels[other, SLOT] <= t2 and labels[other, EXTRA] <= w2:
                            dominated = True
                            break
                        if labels[other, SLOT] >= t2 and labels[other, EXTRA] >= w2:
                            labels[other, DEAD] = 1
                    other = labels[other, NEXT]
                if dominated:
                    continue
                if made == len(labels):
                    labels = np.concatenate((labels, np.empty_like(labels)))
                    key = np.concatenate((key, np.empty_like(key)))
                    tie = np.concatenate((tie, np.empty_like(tie)))
                    item = np.concatenate((item, np.empty_like(item)))
                labels[made, SLOT], labels[made, EXTRA], labels[made, NODE] = t2, w2, m
                labels[made, END], labels[made, PARENT], labels[made, ARC] = end2, label, arc
                labels[made, NEXT], labels[made, DEAD] = first, 0
                fleet.stamp[m], fleet.head[m] = now, made
                order = np.int64(slots_to_go[m]) << 20
                if salt != 0:
                    order += _mixed(m * (T + 1) + t2, salt)
                key[size], tie[size], item[size] = f, order, made
                made += 1
                size += 1
                _sift_up(key, tie, item, size - 1)
    fleet.labels[0] += made
    return False


__all__ = ["INFINITE", "WORD", "Fleet", "Graph", "next_slot", "occupy", "plan_robot"]
