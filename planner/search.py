"""Shortest paths on G' for one robot at a time: cooperative A*, pricing and repair alike use it.

The heuristic is the exact distance on the static graph. Penalties are never negative, so it is
admissible and consistent, and A* expands little more than the states of its answer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner import kernels
from planner.expanded_graph import ExpandedGraph
from planner.parallel import each
from planner.plan import Path
from planner.problem import Problem
from planner.resources import BLOCKED, SCALE, Resources

INFINITE = int(kernels.INFINITE)
NOTHING_FORBIDDEN = np.zeros((0, 0), np.bool_)
NO_ARRIVAL_PENALTY = np.zeros(0, np.int64)


@dataclass(frozen=True)
class Distances:
    """Exact static distances to one goal vertex (any AP there).

    Attributes:
        cost: (n,) int64 [cost units], INFINITE where the goal cannot be reached.
        slots: (n,) int32 least slots, more than T where it cannot be reached in time.
    """

    cost: NDArray[np.int64]
    slots: NDArray[np.int32]


class Penalties:
    """Penalties on resources and moves, as the kernel reads them.

    Attributes:
        resource: (R,) int64 by resource index, the truth for vertices and APs.
        move: (T, 2E+V) int64 by slot and move; an edge's penalty stands at both its directions.
    """

    def __init__(self, resources: Resources) -> None:
        problem = resources.problem
        self.resources = resources
        self.resource = np.zeros(resources.n, np.int64)
        self.vertex, self.edge, self.ap = resources.shaped(self.resource)
        n_edges = len(problem.edge_uv)
        self.move = np.zeros((problem.horizon, 2 * n_edges + len(problem.xy_m)), np.int64)
        self._n_edge_moves = 2 * n_edges

    def set(self, index: NDArray[np.int64], value: NDArray[np.int64] | np.int64) -> None:
        """Sets the penalties of some resources."""
        self.resource[index] = value
        first_edge, first_ap = self.resources.first_edge, self.resources.first_ap
        is_edge = (index >= first_edge) & (index < first_ap)
        slot, edge = np.divmod(index[is_edge] - first_edge, max(self.edge.shape[1], 1))
        edge_value = value[is_edge] if isinstance(value, np.ndarray) else value
        self.move[slot, 2 * edge] = edge_value
        self.move[slot, 2 * edge + 1] = edge_value

    def clear(self) -> None:
        """Sets all penalties to 0."""
        self.resource[:] = 0
        self.move[:] = 0


class Search:
    """A* for the robots of one problem; holds the distances, the workspace and nothing else.

    One instance must not be used by two threads at a time.
    """

    def __init__(
        self, graph: ExpandedGraph, distances: tuple[Distances, ...] | None = None
    ) -> None:
        self.graph = graph
        self.problem: Problem = graph.problem
        self.distances = distances if distances is not None else static_distances(graph)
        problem = self.problem
        states = (problem.horizon + 1) * graph.n_nodes
        self._g = np.empty(states, np.int64)
        self._ties = np.empty(states, np.int64)
        self._parent = np.empty(states, np.int32)
        self._stamp = np.zeros(states, np.int64)
        self._now = 0
        self._path = np.empty(problem.horizon + 1, np.int32)
        self._start = tuple(graph.nodes_at(int(v)) for v in problem.start)
        self._goal = tuple(graph.nodes_at(int(v)) for v in problem.goal)
        # A robot that starts at its goal has arrived: it must not stroll off and return (§1.5).
        self.latest = np.where(problem.start == problem.goal, 0, problem.horizon).astype(np.int32)
        self.no_use = np.zeros((problem.horizon + 1, len(problem.xy_m)), np.int32)

    def shortest(
        self,
        robot: int,
        penalties: Penalties,
        *,
        scale: int = SCALE,
        limit: int = INFINITE,
        use: NDArray[np.int32] | None = None,
        forbidden: NDArray[np.bool_] = NOTHING_FORBIDDEN,
        earliest: int = 0,
        latest: int | None = None,
        at_arrival: NDArray[np.int64] = NO_ARRIVAL_PENALTY,
    ) -> tuple[int, Path | None]:
        """Least-cost path of a robot under penalties.

        Args:
            robot: its index.
            penalties: on resources and moves.
            scale: penalty units per cost unit, 0 to price the penalties alone.
            limit: only a path that costs less is looked for [penalty units].
            use: (T+1, V) int32, decides between equal costs: fewer is better.
            forbidden: (T+1, n) bool, states not to be used, parking included; or (T+1, n+A), where
                the last A columns forbid being amid an edge in a slot, by the AP that serves.
            earliest, latest: bounds on the arrival slot.
            at_arrival: (T+1,) int64 ≥ 0, penalty of arriving in a slot.

        Returns:
            (cost [penalty units], path), or (min(limit, INFINITE), None) if there is none below it:
            in both cases the first value is a lower bound on the cost of every path.
        """
        graph, problem = self.graph, self.problem
        self._now += 1
        cost, tau, first = kernels.astar(
            problem.horizon,
            graph.arc_ptr,
            graph.arc_to,
            graph.arc_from,
            graph.arc_move,
            graph.arc_slots,
            graph.arc_cost,
            graph.node_vertex,
            graph.node_ap,
            self.distances[robot].cost,
            self.distances[robot].slots,
            self._start[robot],
            self._goal[robot],
            scale,
            penalties.vertex,
            penalties.move,
            penalties.ap,
            self.no_use if use is None else use,
            forbidden,
            problem.at_goal == "park",
            earliest,
            int(self.latest[robot]) if latest is None else min(latest, int(self.latest[robot])),
            at_arrival,
            min(limit, INFINITE),
            self._g,
            self._ties,
            self._parent,
            self._stamp,
            self._now,
            self._path,
        )
        if tau < 0:
            return min(limit, INFINITE), None
        return int(cost), self.path_of(robot, self._path[:tau], first)

    def workspace(
        self, searches: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32], NDArray[np.int64], int]:
        """What `searches` runs of a kernel need: g, ties, parent, stamp, and the first stamp."""
        first = self._now + 1
        self._now += searches
        return self._g, self._ties, self._parent, self._stamp, first

    def path_of(self, robot: int, arcs: NDArray[np.int32], first: int) -> Path:
        """The path of the arcs taken from each slot (an arc of k slots stands k times)."""
        graph = self.graph
        tau = len(arcs)
        # The state after slot t: the arc's head where it ends, its tail while it lasts.
        ends = np.ones(tau, bool)
        slots = graph.arc_slots[arcs]
        if np.any(slots > 1):
            ends[:] = False
            t = 0
            while t < tau:
                t += int(slots[t])
                ends[t - 1] = True
        nodes = np.empty(tau + 1, np.int32)
        nodes[0] = first
        nodes[1:] = np.where(ends, graph.arc_to[arcs], graph.arc_from[arcs])
        path = Path(
            self.problem.robot_ids[robot],
            graph.node_vertex[nodes],
            graph.node_ap[nodes],
            graph.arc_edge[arcs],
        )
        for array in (path.vertices, path.aps, path.edges):
            array.flags.writeable = False
        return path

    def can_arrive(self, robot: int) -> bool:
        """Whether the robot alone on the floor reaches its goal within T."""
        slots = self.distances[robot].slots[self._start[robot]]
        return bool(len(slots)) and int(slots.min()) <= self.problem.horizon

    def least_cost(self, robot: int) -> int:
        """Cost of its best path alone on the floor, T disregarded: a lower bound [cost units]."""
        cost = self.distances[robot].cost[self._start[robot]]
        return int(cost.min()) if len(cost) else INFINITE


def static_distances(graph: ExpandedGraph) -> tuple[Distances, ...]:
    """`Distances` of every robot's goal; robots with one goal share them."""
    problem = graph.problem
    ptr, arc = graph.reversed_arcs
    slots = graph.arc_slots.astype(np.int64)
    goals = list(dict.fromkeys(problem.goal.tolist()))

    def to(goal: int) -> Distances:
        args = (graph.nodes_at(goal), graph.n_nodes)
        cost = kernels.distances(ptr, arc, graph.arc_from, graph.arc_cost, *args)
        least = kernels.distances(ptr, arc, graph.arc_from, slots, *args)
        return Distances(cost, np.minimum(least, problem.horizon + 1).astype(np.int32))

    known = dict(zip(goals, each(to, goals), strict=True))
    return tuple(known[int(goal)] for goal in problem.goal)


__all__ = ["BLOCKED", "INFINITE", "SCALE", "Distances", "Penalties", "Search", "static_distances"]
