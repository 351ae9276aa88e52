"""The compiled loop of large neighbourhood search; see `planner.improve` for what it does.

All costs are in whole cost units.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.kernels_fleet import occupy, plan_robot

N_STRATEGIES = 4
RANDOM, WALK, PLACE, AP = range(N_STRATEGIES)

SALTS = 1 << 30
"""Ways to decide between paths of equal cost."""


class Workspace(NamedTuple):
    """The paths a neighbourhood had, and the cheapest plan so far."""

    old_arcs: NDArray[np.int32]
    old_first: NDArray[np.int32]
    old_arrival: NDArray[np.int64]
    old_cost: NDArray[np.int64]
    best_arcs: NDArray[np.int32]  # the cheapest plan so far, as `Fleet` has it
    best_first: NDArray[np.int32]
    best_arrival: NDArray[np.int64]
    best_cost: NDArray[np.int64]


@njit(cache=True, nogil=True)
def _include(members, size, wanted, i):
    if i < 0 or size >= wanted:
        return size
    for k in range(size):
        if members[k] == i:
            return size
    members[size] = i
    return size + 1


@njit(cache=True, nogil=True)
def _one_served_by(graph, fleet, t, a, rng):
    """A random robot served by AP a in slot t, -1 if none."""
    chosen, seen = -1, 0
    for i in range(len(fleet.arrival)):
        node = fleet.node_at[i, t]
        if node >= 0 and graph.node_ap[node] == a:
            seen += 1
            if rng.random() * seen < 1.0:
                chosen = i
    return chosen


@njit(cache=True, nogil=True)
def _random_walk(graph, fleet, i, members, size, wanted, rng):
    """Who stands in the way of robot i where it could be cheaper: random walks off its path."""
    to_go, slots_to_go = graph.cost_to_go[graph.goal_of[i]], graph.slots_to_go[graph.goal_of[i]]
    for _ in range(10 * wanted):
        if size >= wanted:
            break
        # Start anywhere on its path; a robot without one starts at its origin.
        if fleet.arrival[i] > 0:
            t_start = int(rng.random() * fleet.arrival[i])
            t, node, cost = 0, fleet.first[i], 0
            while t < t_start:
                arc = fleet.arcs[i, t]
                t += graph.arc_slots[arc]
                node = graph.arc_to[arc]
                cost += graph.arc_cost[arc]
        else:
            choices = graph.start_ptr[i + 1] - graph.start_ptr[i]
            t, cost = 0, 0
            node = graph.start_nodes[graph.start_ptr[i] + int(rng.random() * choices)]
        while t < graph.horizon and size < wanted:
            # A uniformly random arc that may still lead to a cheaper path in time.
            chosen, seen = -1, 0
            for arc in range(graph.arc_ptr[node], graph.arc_ptr[node + 1]):
                m = graph.arc_to[arc]
                if (
                    cost + graph.arc_cost[arc] + to_go[m] < fleet.cost[i]
                    and t + graph.arc_slots[arc] + slots_to_go[m] <= graph.horizon
                ):
                    seen += 1
                    if rng.random() * seen < 1.0:
                        chosen = arc
            if chosen < 0:
                break
            move, k, m = graph.arc_move[chosen], graph.arc_slots[chosen], graph.arc_to[chosen]
            if move < 2 * graph.n_edges:
                for j in range(t, t + k):
                    size = _include(members, size, wanted, fleet.on_edge[j, move >> 1])
            size = _include(members, size, wanted, fleet.at_vertex[t + k, graph.node_vertex[m]])
            a = graph.node_ap[m]
            if fleet.ap_load[t + k, a] >= graph.ap_capacity[a]:
                blocker = _one_served_by(graph, fleet, t + k, a, rng)
                size = _include(members, size, wanted, blocker)
            t += k
            cost += graph.arc_cost[chosen]
            node = m
            if cost + to_go[node] >= fleet.cost[i]:
                break
    return size


@njit(cache=True, nogil=True)
def _around_place(graph, fleet, i, members, size, wanted, rng):
    """Robots that pass a place on the path of robot i, or next to it, at about the same time."""
    if fleet.arrival[i] <= 0:
        return size
    t0 = int(rng.random() * (fleet.arrival[i] + 1))
    centre = fleet.node_at[i, t0]
    for away in range(graph.horizon + 1):
        for side in (-1, 1):
            t = t0 + side * away
            if t < 1 or t > graph.horizon or size >= wanted:
                continue
            size = _include(members, size, wanted, fleet.at_vertex[t, graph.node_vertex[centre]])
            for arc in range(graph.arc_ptr[centre], graph.arc_ptr[centre + 1]):
                v = graph.node_vertex[graph.arc_to[arc]]
                size = _include(members, size, wanted, fleet.at_vertex[t, v])
        if size >= wanted:
            break
    return size


@njit(cache=True, nogil=True)
def _choose(graph, fleet, strategy, seed_robot, members, wanted, rng):
    """Fills `members` with a neighbourhood; returns its size."""
    n = len(fleet.arrival)
    size = _include(members, 0, wanted, seed_robot)
    if strategy == WALK:
        size = _random_walk(graph, fleet, seed_robot, members, size, wanted, rng)
    elif strategy == PLACE:
        size = _around_place(graph, fleet, seed_robot, members, size, wanted, rng)
    elif strategy == AP and fleet.arrival[seed_robot] >= 0:
        t = int(rng.random() * (fleet.arrival[seed_robot] + 1))
        a = graph.node_ap[fleet.node_at[seed_robot, t]]
        for _ in range(3 * wanted):
            size = _include(members, size, wanted, _one_served_by(graph, fleet, t, a, rng))
    tries = 0
    while size < min(wanted, n) and (strategy == RANDOM or size < 2) and tries < 8 * wanted:
        size = _include(members, size, wanted, int(rng.random() * n))
        tries += 1
    return size


@njit(cache=True, nogil=True)
def keep_best(fleet, work):
    """Notes the fleet's plan as the cheapest so far."""
    work.best_arcs[:] = fleet.arcs
    work.best_first[:] = fleet.first
    work.best_arrival[:] = fleet.arrival
    work.best_cost[:] = fleet.cost


@njit(cache=True, nogil=True)
def improve(graph, fleet, work, iterations, max_size, deviation, unserved_cost, weights, tabu, rng):
    """Tries `iterations` neighbourhoods (record-to-record travel: Dueck, 1993).

    A neighbourhood is kept if it makes the fleet no dearer than the cheapest plan so far plus
    `deviation`; with 0 the fleet only ever gets cheaper or stays as cheap.

    Args:
        graph, fleet, work: see their types.
        iterations: neighbourhoods to try.
        max_size: robots in a neighbourhood, at most.
        deviation: how much dearer than the cheapest plan the fleet may be; no robot is given up
            for it.
        unserved_cost: what a robot without a path counts: more than all paths together.
        weights: (N_STRATEGIES,) float64, adapted to what helped.
        tabu: (N,) int64, how often a robot was the seed since its cost last fell.
        rng: numpy Generator.

    Returns:
        Number of neighbourhoods that made a cheaper plan than ever.
    """
    n = len(fleet.arrival)
    # For the choices below a robot without a path counts as the dearest path, not as all of them.
    dearest = unserved_cost // n + 1
    members = np.empty(max_size, np.int64)
    successes = 0
    current, best = fleet.cost.sum(), work.best_cost.sum()
    for _ in range(iterations):
        slack = max(0, best + deviation - current)
        # Strategy by roulette.
        pick = rng.random() * weights.sum()
        strategy = 0
        while strategy < N_STRATEGIES - 1 and pick >= weights[strategy]:
            pick -= weights[strategy]
            strategy += 1
        # Seed: the robot farthest above its least cost per try so far, or any robot.
        seed_robot = int(rng.random() * n)
        if strategy == WALK:
            most = -1.0
            for i in range(n):
                worth = (min(fleet.cost[i], dearest) - graph.least_cost[i]) / (1.0 + tabu[i])
                if worth > most:
                    most, seed_robot = worth, i
            tabu[seed_robot] += 1
        wanted = 2 + int(rng.random() * (max_size - 1))
        size = _choose(graph, fleet, strategy, seed_robot, members, wanted, rng)
        # Take them out, in random order.
        before = 0
        floor_cost = 0
        for k in range(size - 1, 0, -1):
            j = int(rng.random() * (k + 1))
            members[k], members[j] = members[j], members[k]
        for k in range(size):
            i = members[k]
            before += fleet.cost[i]
            floor_cost += graph.least_cost[i]
            occupy(graph, fleet, i, False)
            work.old_arcs[k] = fleet.arcs[i]
            work.old_first[k] = fleet.first[i]
            work.old_arrival[k] = fleet.arrival[i]
            work.old_cost[k] = fleet.cost[i]
        # Put them back one by one, as long as the sum can still be no worse.
        after = 0
        planned = 0
        for k in range(size):
            i = members[k]
            floor_cost -= graph.least_cost[i]
            room = before + slack - after - floor_cost
            salt = 1 + int(rng.random() * SALTS)
            if plan_robot(graph, fleet, i, min(room + 1, unserved_cost), salt):
                occupy(graph, fleet, i, True)
            elif room - slack >= unserved_cost:
                fleet.arrival[i] = -1
                fleet.cost[i] = unserved_cost
            else:
                break
            after += fleet.cost[i]
            planned += 1
        gain = before - after
        if planned < size:
            gain = 0
            for k in range(planned):
                occupy(graph, fleet, members[k], False)
            for k in range(size):
                i = members[k]
                fleet.arcs[i] = work.old_arcs[k]
                fleet.first[i] = work.old_first[k]
                fleet.arrival[i] = work.old_arrival[k]
                fleet.cost[i] = work.old_cost[k]
                occupy(graph, fleet, i, True)
        else:
            current -= gain
            if gain > 0:
                for k in range(size):
                    tabu[members[k]] = 0
            if current < best:
                successes += 1
                best = current
                keep_best(fleet, work)
        worth = min(max(gain, 0), dearest) / max(size, 1)
        weights[strategy] = max(0.99 * weights[strategy] + 0.01 * worth, 0.02)
    return successes


__all__ = ["N_STRATEGIES", "Workspace", "improve", "keep_best"]
