"""A fleet whose robots are planned one after another, each around all the others."""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np

from planner import kernels_fleet as kernels
from planner.plan import Path
from planner.search import INFINITE, Search

_GRAPHS: WeakKeyDictionary[Search, kernels.Graph] = WeakKeyDictionary()


class FleetPlan:
    """Paths of some robots and what they occupy; breaks no rule if what is placed breaks none.

    Args:
        search: of the problem.
        paths: to begin with, None for robots without one.
        unserved_cost: what a robot without a path counts in `fleet.cost`.

    Attributes:
        graph, fleet: for compiled kernels, which may change the latter.
    """

    def __init__(
        self, search: Search, paths: Sequence[Path | None] = (), *, unserved_cost: int = 0
    ) -> None:
        problem, self._search = search.problem, search
        T, V, E, n = problem.horizon, problem.n_vertices, problem.n_edges, problem.n_robots
        self.graph = graph_of(search)
        words = T // kernels.WORD + 1
        full = np.zeros((problem.n_aps, words), np.uint64)
        full[problem.ap_capacity <= 0] = ~np.uint64(0)  # an AP that may serve nobody
        self.fleet = kernels.Fleet(
            arcs=np.full((n, T), -1, np.int32),
            first=np.full(n, -1, np.int32),
            arrival=np.full(n, -1, np.int64),
            cost=np.full(n, unserved_cost, np.int64),
            node_at=np.full((n, T + 1), -1, np.int32),
            at_vertex=np.full((T + 1, V), -1, np.int32),
            on_edge=np.full((T, E), -1, np.int32),
            ap_load=np.zeros((T + 1, problem.n_aps), np.int32),
            busy_vertex=np.zeros((V, words), np.uint64),
            busy_edge=np.zeros((E, words), np.uint64),
            full_ap=full,
            head=np.empty(search.graph.n_nodes, np.int64),
            stamp=np.zeros(search.graph.n_nodes, np.int64),
            now=np.zeros(1, np.int64),
            labels=np.zeros(1, np.int64),
        )
        for i, path in enumerate(paths):
            if path is not None:
                self.place(i, path)

    def plan(self, i: int, *, limit: int = INFINITE, salt: int = 0) -> bool:
        """Plans a robot that has no path around all others; whether one costs less than `limit`."""
        if not kernels.plan_robot(self.graph, self.fleet, i, limit, salt):
            return False
        kernels.occupy(self.graph, self.fleet, i, True)
        return True

    def place(self, i: int, path: Path) -> None:
        """Enters a given path of a robot that has none."""
        graph, fleet, problem = self._search.graph, self.fleet, self._search.problem
        nodes = graph.node_of[path.vertices, path.aps]
        t = 0
        while t < path.arrival:
            edge = int(path.edges[t])
            k = int(problem.edge_slots[edge]) if edge >= 0 else 1
            low, high = graph.arc_ptr[nodes[t]], graph.arc_ptr[nodes[t] + 1]
            there = np.flatnonzero(
                (graph.arc_to[low:high] == nodes[t + k]) & (graph.arc_edge[low:high] == edge)
            )
            fleet.arcs[i, t : t + k] = low + there[0]
            t += k
        fleet.first[i] = nodes[0]
        fleet.arrival[i] = path.arrival
        fleet.cost[i] = problem.c_t * path.arrival + problem.c_h * path.handovers
        kernels.occupy(self.graph, fleet, i, True)

    def paths(self) -> list[Path | None]:
        """The paths, None for robots without one."""
        fleet = self.fleet
        return self.read(fleet.arcs, fleet.first, fleet.arrival)

    def read(
        self, arcs: kernels.Ints, first: kernels.Ints, arrival: kernels.Longs
    ) -> list[Path | None]:
        """Paths from arrays like the fleet's."""
        return [
            None if tau < 0 else self._search.path_of(i, arcs[i, :tau].copy(), int(first[i]))
            for i, tau in enumerate(arrival.tolist())
        ]


def graph_of(search: Search) -> kernels.Graph:
    """The static graph and the robots as the kernels read them; made once per `Search`."""
    if search not in _GRAPHS:
        problem, graph = search.problem, search.graph
        starts = [graph.nodes_at(int(v)) for v in problem.start]
        goals = [graph.nodes_at(int(v)) for v in problem.goal]
        by_goal = {int(v): d for v, d in zip(problem.goal, search.distances, strict=True)}
        row = {v: k for k, v in enumerate(by_goal)}
        waits = np.flatnonzero((graph.arc_edge < 0) & (graph.arc_from == graph.arc_to))
        _GRAPHS[search] = kernels.Graph(
            horizon=problem.horizon,
            park=problem.at_goal == "park",
            c_t=problem.c_t,
            n_edges=problem.n_edges,
            arc_ptr=graph.arc_ptr,
            arc_to=graph.arc_to,
            arc_from=graph.arc_from,
            arc_move=graph.arc_move,
            arc_slots=graph.arc_slots,
            arc_cost=graph.arc_cost,
            wait_arc=waits.astype(np.int32),
            node_vertex=graph.node_vertex,
            node_ap=graph.node_ap,
            goal_of=np.array([row[int(v)] for v in problem.goal], np.int32),
            cost_to_go=np.array([d.cost for d in by_goal.values()]),
            slots_to_go=np.array([d.slots for d in by_goal.values()]),
            start_ptr=np.cumsum([0, *map(len, starts)]),
            start_nodes=np.concatenate(starts),
            goal_ptr=np.cumsum([0, *map(len, goals)]),
            goal_nodes=np.concatenate(goals),
            latest=search.latest,
            ap_capacity=problem.ap_capacity,
            least_cost=np.array([search.least_cost(i) for i in range(problem.n_robots)], np.int64),
        )
    return _GRAPHS[search]
