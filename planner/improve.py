"""Large neighbourhood search (MAPF-LNS2: Li et al., AAAI 2022, DOI 10.1609/aaai.v36i9.21266).

Again and again a few robots are taken out of the plan and planned anew in random order around the
others by A*; the result is kept unless it is worse. Neighbourhoods are chosen adaptively among:
robots in the way of one that is far above its least cost (random walk), robots that pass one place
at about the same time, robots that share an AP in one slot, and random ones. A robot without a path
counts more than all paths together, so the same loop serves those who are left out, and drops none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner import kernels_lns as kernels
from planner.plan import Path
from planner.resources import BLOCKED, Resources
from planner.search import Search


class LargeNeighbourhoodSearch:
    """A plan under improvement. Deterministic by seed and number of iterations.

    Args:
        search, resources: of the problem.
        paths: the plan to start with; it must not break a rule, but may leave robots out.
        seed: of the random choices.
        max_size: robots in a neighbourhood, at most.
    """

    def __init__(
        self,
        search: Search,
        resources: Resources,
        paths: Sequence[Path | None],
        *,
        seed: int,
        max_size: int = 10,
    ) -> None:
        problem, graph = search.problem, search.graph
        T, V, E = problem.horizon, len(problem.xy_m), len(problem.edge_uv)
        A, n = len(problem.ap_ids), len(problem.robot_ids)
        self._search, self._graph_of = search, graph
        self._max_size = max(2, min(max_size, n))
        starts = [graph.nodes_at(int(v)) for v in problem.start]
        goals = [graph.nodes_at(int(v)) for v in problem.goal]
        # More than all robots together can cost: serving one more is worth any delay of the others.
        self.unserved_cost = n * (problem.c_t + problem.c_h) * T + 1
        self._graph = kernels.Graph(
            horizon=T,
            park=problem.at_goal == "park",
            n_edges=E,
            arc_ptr=graph.arc_ptr,
            arc_to=graph.arc_to,
            arc_from=graph.arc_from,
            arc_move=graph.arc_move,
            arc_slots=graph.arc_slots,
            arc_cost=graph.arc_cost,
            node_vertex=graph.node_vertex,
            node_ap=graph.node_ap,
            cost_to_go=np.array([d.cost for d in search.distances]),
            slots_to_go=np.array([d.slots for d in search.distances]),
            start_ptr=np.cumsum([0, *map(len, starts)]),
            start_nodes=np.concatenate(starts),
            goal_ptr=np.cumsum([0, *map(len, goals)]),
            goal_nodes=np.concatenate(goals),
            latest=search.latest,
            ap_capacity=problem.ap_capacity,
            least_cost=np.array([search.least_cost(i) for i in range(n)], np.int64),
            no_use=search.no_use,
            nothing_forbidden=np.zeros((0, 0), np.bool_),
            no_arrival=np.zeros(0, np.int64),
        )
        pa = np.zeros((T + 1, A), np.int64)
        pa[:, problem.ap_capacity <= 0] = BLOCKED
        self._fleet = kernels.Fleet(
            arcs=np.full((n, T), -1, np.int32),
            first=np.full(n, -1, np.int32),
            arrival=np.full(n, -1, np.int64),
            cost=np.full(n, self.unserved_cost, np.int64),
            node_at=np.full((n, T + 1), -1, np.int32),
            at_vertex=np.full((T + 1, V), -1, np.int32),
            on_edge=np.full((T, E), -1, np.int32),
            ap_load=np.zeros((T + 1, A), np.int32),
            pv=np.zeros((T + 1, V), np.int64),
            pm=np.zeros((T, 2 * E + V), np.int64),
            pa=pa,
        )
        states, m = (T + 1) * graph.n_nodes, self._max_size
        self._work = kernels.Workspace(
            g=np.empty(states, np.int64),
            ties=np.empty(states, np.int64),
            parent=np.empty(states, np.int32),
            stamp=np.zeros(states, np.int64),
            now=np.zeros(1, np.int64),
            path=np.empty(T + 1, np.int32),
            old_arcs=np.empty((m, T), np.int32),
            old_first=np.empty(m, np.int32),
            old_arrival=np.empty(m, np.int64),
            old_cost=np.empty(m, np.int64),
            best_arcs=np.empty((n, T), np.int32),
            best_first=np.empty(n, np.int32),
            best_arrival=np.empty(n, np.int64),
            best_cost=np.empty(n, np.int64),
        )
        self._weights = np.ones(kernels.N_STRATEGIES)
        self._tabu = np.zeros(n, np.int64)
        self._rng = np.random.default_rng([seed, 2])
        for i, path in enumerate(paths):
            if path is not None:
                self._place(i, path)
        kernels.keep_best(self._fleet, self._work)

    def _place(self, i: int, path: Path) -> None:
        """Enters a given path."""
        graph, fleet, problem = self._graph_of, self._fleet, self._search.problem
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
        kernels.occupy(self._graph, fleet, i, True)

    def run(self, iterations: int, *, deviation: int = 0) -> int:
        """Tries neighbourhoods; returns how many made a cheaper plan than ever.

        Args:
            iterations: neighbourhoods to try.
            deviation: how much dearer than the cheapest plan the fleet may become on the way.
        """
        return int(
            kernels.improve(
                self._graph,
                self._fleet,
                self._work,
                iterations,
                self._max_size,
                deviation,
                self.unserved_cost,
                self._weights,
                self._tabu,
                self._rng,
            )
        )

    @property
    def cost(self) -> int:
        """Cost of the cheapest plan, robots without a path included at `unserved_cost`."""
        return int(self._work.best_cost.sum())

    def paths(self) -> list[Path | None]:
        """The cheapest plan."""
        best = self._work
        return [
            None
            if best.best_arrival[i] < 0
            else self._search.path_of(
                i, best.best_arcs[i, : best.best_arrival[i]].copy(), int(best.best_first[i])
            )
            for i in range(len(best.best_arrival))
        ]
