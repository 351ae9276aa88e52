"""Compiled kernels of the exact search: costs through states, and what two robots can do together.

See `planner.exact` and `planner.cuts.arrival_conflict` for what they are for.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.kernels import BLOCKED, INFINITE


@njit(cache=True, nogil=True)
def costs_behind(
    horizon,
    arc_ptr,
    arc_to,
    arc_move,
    arc_slots,
    arc_cost,
    node_vertex,
    node_ap,
    goal_nodes,
    scale,
    pv,
    pm,
    pa,
    forbidden,
    park,
    earliest,
    latest,
    at_arrival,
):
    """The least penalised cost from each state of G' to a robot's arrival.

    One sweep over the slots, back from the destination.

    Args:
        horizon, arc_*, node_*, scale, pv, pm, pa, forbidden, park, earliest, latest, at_arrival:
            as for `kernels.astar`.
        goal_nodes: nodes of the destination.

    Returns:
        (T+1, n) int64, the penalties of the state itself not included; and (T+1, goal nodes) int64
        the cost of arriving at one in a slot, parking included. At least INFINITE where it cannot.
    """
    n_nodes = len(node_vertex)
    last = min(latest, horizon)
    with_forbidden = forbidden.shape[0] > 0
    with_amid = forbidden.shape[1] > n_nodes
    behind = np.full((horizon + 1, n_nodes), INFINITE)
    ending = np.full((horizon + 1, len(goal_nodes)), INFINITE)
    rest = np.zeros(pa.shape[1], np.int64)
    for t in range(horizon, -1, -1):
        if park and t < horizon and len(goal_nodes) > 0:
            v = node_vertex[goal_nodes[0]]
            wait = pm.shape[1] - pv.shape[1] + v
            for n in goal_nodes:
                a = node_ap[n]
                rest[a] = min(rest[a] + pv[t + 1, v] + pa[t + 1, a] + pm[t, wait], BLOCKED)
                if with_forbidden and forbidden[t + 1, n]:
                    rest[a] = BLOCKED
        if t > last:
            continue
        for k in range(len(goal_nodes)):
            n = goal_nodes[k]
            arriving = rest[node_ap[n]]
            if len(at_arrival) > 0:
                arriving += at_arrival[t]
            if t >= earliest and arriving < BLOCKED:
                if not (with_forbidden and forbidden[t, n]):
                    ending[t, k] = arriving
                    behind[t, n] = arriving
        for n in range(n_nodes):
            if with_forbidden and forbidden[t, n]:
                continue
            best = behind[t, n]
            for arc in range(arc_ptr[n], arc_ptr[n + 1]):
                k = arc_slots[arc]
                m = arc_to[arc]
                if t + k > last or behind[t + k, m] >= INFINITE:
                    continue
                step = pv[t + k, node_vertex[m]] + pa[t + k, node_ap[m]] + pm[t, arc_move[arc]]
                for j in range(1, k):
                    step += pm[t + j, arc_move[arc]] + pa[t + j, node_ap[n]]
                    if with_amid and forbidden[t + j, n_nodes + node_ap[n]]:
                        step = BLOCKED
                if step >= BLOCKED:
                    continue
                best = min(best, behind[t + k, m] + arc_cost[arc] * scale + step)
            behind[t, n] = best
    return behind, ending


@njit(cache=True, nogil=True)
def costs_through(
    horizon,
    arc_ptr,
    arc_to,
    arc_move,
    arc_slots,
    arc_cost,
    node_vertex,
    node_ap,
    start_nodes,
    goal_nodes,
    scale,
    pv,
    pm,
    pa,
    forbidden,
    park,
    latest,
    at_arrival,
):
    """The least penalised cost of a robot's paths through each state of G'.

    Two sweeps over the slots, one back from the destination (`costs_behind`) and one from the
    origin.

    Args:
        horizon, arc_*, node_*, scale, pv, pm, pa, forbidden, park, latest, at_arrival: as for
            `kernels.astar`.
        start_nodes, goal_nodes: nodes of the origin and of the destination.

    Returns:
        (T+1, n) int64, at least INFINITE where no path passes (or parks); and (T+1,) int64 the
        least cost of a path that arrives in a slot.
    """
    n_nodes = len(node_vertex)
    last = min(latest, horizon)
    with_amid = forbidden.shape[1] > n_nodes
    behind, ending = costs_behind(
        horizon,
        arc_ptr,
        arc_to,
        arc_move,
        arc_slots,
        arc_cost,
        node_vertex,
        node_ap,
        goal_nodes,
        scale,
        pv,
        pm,
        pa,
        forbidden,
        park,
        0,
        latest,
        at_arrival,
    )
    before = np.full((horizon + 1, n_nodes), INFINITE)
    for n in start_nodes:
        if pa[0, node_ap[n]] < BLOCKED:
            before[0, n] = pa[0, node_ap[n]]
    for t in range(last):
        for n in range(n_nodes):
            # A state from which the goal is out of reach is on no path: forbidden ones are such.
            if before[t, n] >= INFINITE or behind[t, n] >= INFINITE:
                continue
            for arc in range(arc_ptr[n], arc_ptr[n + 1]):
                k = arc_slots[arc]
                m = arc_to[arc]
                if t + k > last:
                    continue
                step = pv[t + k, node_vertex[m]] + pa[t + k, node_ap[m]] + pm[t, arc_move[arc]]
                for j in range(1, k):
                    step += pm[t + j, arc_move[arc]] + pa[t + j, node_ap[n]]
                    if with_amid and forbidden[t + j, n_nodes + node_ap[n]]:
                        step = BLOCKED
                if step >= BLOCKED:
                    continue
                cost = before[t, n] + arc_cost[arc] * scale + step
                if cost < before[t + k, m]:
                    before[t + k, m] = cost
    arriving = np.full(horizon + 1, INFINITE)
    parked = np.full((horizon + 1, len(goal_nodes)), INFINITE)
    for k in range(len(goal_nodes)):
        n = goal_nodes[k]
        for t in range(last + 1):
            if before[t, n] < INFINITE and ending[t, k] < INFINITE:
                total = before[t, n] + ending[t, k]
                arriving[t] = min(arriving[t], total)
                if park:
                    parked[t, k] = total
        # Who has arrived passes the goal's states up to T.
        for t in range(1, horizon + 1):
            parked[t, k] = min(parked[t, k], parked[t - 1, k])
    for t in range(horizon + 1):
        for n in range(n_nodes):
            if before[t, n] < INFINITE:
                before[t, n] = min(before[t, n] + behind[t, n], INFINITE)
    for k in range(len(goal_nodes)):
        for t in range(horizon + 1):
            before[t, goal_nodes[k]] = min(before[t, goal_nodes[k]], parked[t, k])
    return before, arriving


@njit(cache=True, nogil=True)
def pair_frontier(
    horizon, ptr, head, single, excess_i, excess_j, arrive_i, arrive_j, room, ends, park, max_steps
):
    """When two robots can arrive if they keep out of each other's way (edges of one slot only).

    A sweep over the slots with all pairs of vertices the two can stand at without a conflict
    (§1.2, §1.3); once one has arrived only the other moves on.

    Args:
        horizon: T.
        ptr, head, single: vertices next to v, v itself included, are head[ptr[v]:ptr[v+1]];
            `single` where only one edge leads there.
        excess_i, excess_j: (T+1, V) int64, what a path of each costs at least above its least cost
            if it stands there, INFINITE where it may not.
        arrive_i, arrive_j: (T+1,) int64, the same for arriving in a slot.
        room: pairs of states whose sum of excesses is more are of no interest.
        ends: (4,) start of i, goal of i, start of j, goal of j.
        park: whether who has arrived keeps its goal occupied.
        max_steps: give up after so many pairs of moves.

    Returns:
        (T+1,) int32: for each arrival slot of i the least one of j, T+1 if none, but dominated
        entries may be missing; None was found out if the first entry is -1.
    """
    n_vertices = excess_i.shape[1]
    never = horizon + 1
    frontier = np.full(horizon + 1, never, np.int32)
    start_i, goal_i, start_j, goal_j = ends[0], ends[1], ends[2], ends[3]
    # alone_i[v]: least slot in which j has arrived while i is still on its way, at v now.
    alone_i = np.full(n_vertices, never, np.int32)
    alone_j = np.full(n_vertices, never, np.int32)
    index_i, index_j = np.zeros(n_vertices, np.int32), np.zeros(n_vertices, np.int32)
    at_i = np.array([start_i], np.int32)
    at_j = np.array([start_j], np.int32)
    pairs = np.ones((1, 1), np.bool_)
    if excess_i[0, start_i] + excess_j[0, start_j] > room:
        pairs[0, 0] = False
    steps = 0
    for t in range(horizon + 1):
        for x in range(len(at_i)):
            u = at_i[x]
            for y in range(len(at_j)):
                if not pairs[x, y]:
                    continue
                w = at_j[y]
                i_there = u == goal_i and arrive_i[t] <= room
                j_there = w == goal_j and arrive_j[t] <= room
                if i_there:
                    alone_j[w] = min(alone_j[w], t)
                if j_there:
                    alone_i[u] = min(alone_i[u], t)
        if arrive_j[t] <= room and alone_j[goal_j] < never:
            tau = alone_j[goal_j]
            frontier[tau] = min(frontier[tau], t)
        if arrive_i[t] <= room and alone_i[goal_i] < never:
            frontier[t] = min(frontier[t], alone_i[goal_i])
        if t == horizon:
            break
        next_i = np.flatnonzero(excess_i[t + 1] <= room).astype(np.int32)
        next_j = np.flatnonzero(excess_j[t + 1] <= room).astype(np.int32)
        for x in range(len(next_i)):
            index_i[next_i[x]] = x
        for y in range(len(next_j)):
            index_j[next_j[y]] = y
        after = np.zeros((len(next_i), len(next_j)), np.bool_)
        for x in range(len(at_i)):
            u = at_i[x]
            for y in range(len(at_j)):
                if not pairs[x, y]:
                    continue
                w = at_j[y]
                for a in range(ptr[u], ptr[u + 1]):
                    u2 = head[a]
                    left = room - excess_i[t + 1, u2]
                    if left < 0:
                        continue
                    for b in range(ptr[w], ptr[w + 1]):
                        w2 = head[b]
                        steps += 1
                        if w2 == u2 or excess_j[t + 1, w2] > left:
                            continue
                        if u2 == w and w2 == u and single[a]:
                            continue
                        after[index_i[u2], index_j[w2]] = True
        if steps > max_steps:
            frontier[0] = -1
            return frontier
        for who in range(2):
            alone = alone_i if who == 0 else alone_j
            excess = excess_i if who == 0 else excess_j
            taken = goal_j if who == 0 else goal_i
            moved = np.full(n_vertices, never, np.int32)
            for v in range(n_vertices):
                if alone[v] < never:
                    for a in range(ptr[v], ptr[v + 1]):
                        v2 = head[a]
                        if excess[t + 1, v2] <= room and not (park and v2 == taken):
                            moved[v2] = min(moved[v2], alone[v])
            alone[:] = moved
        at_i, at_j, pairs = next_i, next_j, after
    return frontier


@njit(cache=True, nogil=True)
def pair_states(
    horizon, ptr, head, single, excess_i, excess_j, arrive_i, arrive_j, room, ends, park, max_steps
):
    """Which states two robots can be in together, in every slot (edges of one slot only).

    Sweeps forward over what they can reach without a conflict, and back over what leads to the
    goals of both. A robot's state in a slot is its vertex, or "arrived" (then, and not before).

    Args:
        horizon, ptr, head, single, excess_i, excess_j, arrive_i, arrive_j, room, ends, park: as
            for `pair_frontier`.
        max_steps: give up after so many pairs of moves.

    Returns:
        Places in the list of states (T+1, V) int32 of i and of j, by slot, -1 if not allowed, the
        last place of a slot is "arrived"; (T+2,) int64 where each slot's matrix begins; the
        matrices [place of i, place of j] end to end (empty when given up).
    """
    V = excess_i.shape[1]
    place_i = np.full((horizon + 1, V), -1, np.int32)
    place_j = np.full((horizon + 1, V), -1, np.int32)
    n_i, n_j = np.zeros(horizon + 1, np.int64), np.zeros(horizon + 1, np.int64)
    begin = np.zeros(horizon + 2, np.int64)
    for t in range(horizon + 1):
        for v in range(V):
            if excess_i[t, v] <= room:
                place_i[t, v] = n_i[t]
                n_i[t] += 1
            if excess_j[t, v] <= room:
                place_j[t, v] = n_j[t]
                n_j[t] += 1
        begin[t + 1] = begin[t] + (n_i[t] + 1) * (n_j[t] + 1)
    nothing = np.zeros(0, np.bool_)
    if begin[horizon + 1] > max_steps:
        return place_i, place_j, begin, nothing
    both = np.zeros(begin[horizon + 1], np.bool_)
    start_i, goal_i, start_j, goal_j = ends[0], ends[1], ends[2], ends[3]
    if place_i[0, start_i] >= 0 and place_j[0, start_j] >= 0:
        both[place_i[0, start_i] * (n_j[0] + 1) + place_j[0, start_j]] = True
    # The least excess of having arrived by a slot.
    by_i, by_j = arrive_i.copy(), arrive_j.copy()
    for t in range(1, horizon + 1):
        by_i[t] = min(by_i[t], by_i[t - 1])
        by_j[t] = min(by_j[t], by_j[t - 1])
    steps = 0
    for sweep in range(2):
        for slot in range(horizon + 1):
            t = slot if sweep == 0 else horizon - slot
            width = n_j[t] + 1
            at_i = np.flatnonzero(excess_i[t] <= room)
            at_j = np.flatnonzero(excess_j[t] <= room)
            # Forward: arrivals follow from active states. Backward: the other way round.
            for order in range(4):
                phase = order if sweep == 0 else 3 - order
                # 0: both on their way, 1: i only, 2: j only, 3: both arrived.
                count_i = len(at_i) if phase in (0, 1) else 1
                count_j = len(at_j) if phase in (0, 2) else 1
                for x in range(count_i):
                    i_moves = phase == 0 or phase == 1
                    u = at_i[x] if i_moves else -1
                    px = x if i_moves else n_i[t]
                    for y in range(count_j):
                        j_moves = phase == 0 or phase == 2
                        w = at_j[y] if j_moves else -1
                        py = y if j_moves else n_j[t]
                        here = begin[t] + px * width + py
                        if not both[here]:
                            continue
                        ok = phase == 3 and t == horizon
                        # Arriving now.
                        rest = room - (excess_j[t, w] if j_moves else by_j[t])
                        if i_moves and u == goal_i and arrive_i[t] <= rest:
                            there = begin[t] + n_i[t] * width + py
                            if sweep == 0:
                                both[there] = True
                            elif both[there]:
                                ok = True
                        rest = room - (excess_i[t, u] if i_moves else by_i[t])
                        if j_moves and w == goal_j and arrive_j[t] <= rest:
                            there = begin[t] + px * width + n_j[t]
                            if sweep == 0:
                                both[there] = True
                            elif both[there]:
                                ok = True
                        # Moving on.
                        if t < horizon and not ok:
                            next_width = n_j[t + 1] + 1
                            low_a, high_a = (ptr[u], ptr[u + 1]) if i_moves else (0, 1)
                            low_b, high_b = (ptr[w], ptr[w + 1]) if j_moves else (0, 1)
                            for a in range(low_a, high_a):
                                u2 = head[a] if i_moves else -1
                                left = room - (excess_i[t + 1, u2] if i_moves else by_i[t + 1])
                                if left < 0:
                                    continue
                                if i_moves:
                                    if not j_moves and park and u2 == goal_j:
                                        continue
                                px2 = place_i[t + 1, u2] if i_moves else n_i[t + 1]
                                for b in range(low_b, high_b):
                                    steps += 1
                                    w2 = head[b] if j_moves else -1
                                    if (excess_j[t + 1, w2] if j_moves else by_j[t + 1]) > left:
                                        continue
                                    if j_moves:
                                        if not i_moves and park and w2 == goal_i:
                                            continue
                                    if i_moves and j_moves:
                                        if u2 == w2:
                                            continue
                                        if u2 == w and w2 == u and single[a]:
                                            continue
                                    py2 = place_j[t + 1, w2] if j_moves else n_j[t + 1]
                                    there = begin[t + 1] + px2 * next_width + py2
                                    if sweep == 0:
                                        both[there] = True
                                    elif both[there]:
                                        ok = True
                                        break
                                if sweep == 1 and ok:
                                    break
                        if sweep == 1 and not ok:
                            both[here] = False
            if steps > max_steps:
                return place_i, place_j, begin, nothing
    return place_i, place_j, begin, both


@njit(cache=True, nogil=True)
def best_exclusion_slot(begin, both, states_i, states_j, weight_i, weight_j, width_j):
    """Paths of two robots, likeliest in sum, whose states in one slot exclude each other.

    Args:
        begin, both: of `pair_states`.
        states_i, states_j: (p, T+1), (q, T+1) int64, places of the paths' states; p at most 12.
        weight_i, weight_j: (p,), (q,) float64.
        width_j: (T+1,) int64, places of j in each slot.

    Returns:
        The weight, the slot (of equals the first), and the chosen paths of i as bits.
    """
    p, q = len(weight_i), len(weight_j)
    excluded = np.zeros(q, np.int64)
    best, best_slot, best_set = 0.0, 0, 0
    for t in range(1, len(width_j)):
        any_pair = False
        for y in range(q):
            excluded[y] = 0
            for x in range(p):
                if states_i[x, t] >= 0 and states_j[y, t] >= 0:
                    if not both[begin[t] + states_i[x, t] * width_j[t] + states_j[y, t]]:
                        excluded[y] |= 1 << x
                        any_pair = True
        if not any_pair:
            continue
        for chosen in range(1, 1 << p):
            total = 0.0
            for x in range(p):
                if chosen >> x & 1:
                    total += weight_i[x]
            for y in range(q):
                if excluded[y] & chosen == chosen:
                    total += weight_j[y]
            if total > best + 1e-9:
                best, best_slot, best_set = total, t, chosen
    return best, best_slot, best_set
