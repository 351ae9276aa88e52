"""The optimum of a tiny problem as one integer program: every arc of G' a binary per robot.

Slow, and obviously right: robots flow through G' (every robot one unit, from its start in slot 0
to its goal in the slot of its choice), and every capacity of §1.2, §1.3 and §1.6 is one row.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, linprog, milp
from scipy.sparse import coo_array, csr_array

from planner.plan import Path, Plan
from planner.problem import Problem
from tests.oracles.expanded import (
    WAIT,
    ExplicitGraph,
    Penalties,
    path_cost,
    row_capacities,
    rows_of,
)


@dataclass
class _Model:
    """Rows and columns of the program.

    A column is (robot, what, index): "start" and "end" at a node, or along an "arc".
    """

    columns: list[tuple[int, str, int]]
    cost: NDArray[np.float64]
    flow: csr_array
    supply: NDArray[np.float64]
    use: csr_array
    capacity: NDArray[np.float64]


def solve_arcflow(problem: Problem) -> Plan:
    """The cheapest plan ("optimal"), or "infeasible" if there is none.

    When one robot has no path even alone, the answer names it; otherwise it names them all.
    """
    graph = ExplicitGraph(problem)
    free = graph.weigh(Penalties.none(problem))
    alone = [graph.shortest_path(i, free)[1] for i in range(problem.n_robots)]
    stuck = tuple(name for name, path in zip(problem.robot_ids, alone, strict=True) if path is None)
    if stuck:
        return _infeasible(problem, stuck)
    model = _build(graph)
    found = milp(
        model.cost,
        integrality=np.ones(len(model.cost)),
        bounds=Bounds(0, 1),
        constraints=[
            LinearConstraint(model.flow, model.supply, model.supply),
            LinearConstraint(model.use, -np.inf, model.capacity),
        ],
        options={"mip_rel_gap": 0.0},
    )
    if found.status == 2:
        return _infeasible(problem, problem.robot_ids)
    assert found.status == 0, found.message
    paths = _paths(graph, model, found.x > 0.5)
    cost = sum(path_cost(problem, path) for path in paths)
    assert abs(cost - found.fun) < 1e-4, "the paths read off cost what the program says"
    return Plan("optimal", problem.robot_ids, paths, cost, float(cost))


def arcflow_bound(problem: Problem) -> float | None:
    """Value of the program's LP relaxation, None if that is infeasible.

    It equals the value of the paper's master LP over all paths (Dantzig–Wolfe decomposition of
    the flow rows, whose polytope has integer vertices).
    """
    graph = ExplicitGraph(problem)
    free = graph.weigh(Penalties.none(problem))
    if any(graph.shortest_path(i, free)[1] is None for i in range(problem.n_robots)):
        return None
    model = _build(graph)
    found = linprog(
        model.cost,
        model.use,
        model.capacity,
        model.flow,
        model.supply,
        bounds=(0, None),
        method="highs",
    )
    if found.status == 2:
        return None
    assert found.status == 0, found.message
    return float(found.fun)


def _infeasible(problem: Problem, robots: tuple[str, ...]) -> Plan:
    nothing = (None,) * problem.n_robots
    return Plan("infeasible", problem.robot_ids, nothing, 0, None, infeasible_robots=robots)


def _build(graph: ExplicitGraph) -> _Model:
    problem = graph.problem
    columns: list[tuple[int, str, int]] = []
    cost: list[float] = []
    flow: list[tuple[int, int, float]] = []  # (row, column, factor)
    use: list[tuple[int, int]] = []
    places = _Places(problem)
    for i in range(problem.n_robots):
        start, goal = int(problem.start[i]), int(problem.goal[i])
        arcs = _useful_arcs(graph, start, goal)
        # Rows of robot i: one that it starts once, and one per node for the flow through it.
        once = i * (graph.n_nodes + 1)
        node_row = once + 1
        for node in graph.nodes_of(start, 0).tolist():
            flow.append((once, len(columns), 1.0))
            flow.append((node_row + node, len(columns), 1.0))
            use += [(row, len(columns)) for row in places.standing(graph, node)]
            columns.append((i, "start", node))
            cost.append(0.0)
        for arc in arcs:
            tail, head = int(graph.tail[arc]), int(graph.head[arc])
            flow.append((node_row + tail, len(columns), -1.0))
            flow.append((node_row + head, len(columns), 1.0))
            use += [(row, len(columns)) for row in places.along(graph, arc)]
            columns.append((i, "arc", arc))
            cost.append(float(graph.cost[arc]))
        for node in graph.nodes_of(goal, 0 if start == goal else None).tolist():
            flow.append((node_row + node, len(columns), -1.0))
            use += [(row, len(columns)) for row in places.parking(graph, node)]
            columns.append((i, "end", node))
            cost.append(0.0)
    rows, cols, factors = zip(*flow, strict=True)
    n_rows = problem.n_robots * (graph.n_nodes + 1)
    supply = np.zeros(n_rows)
    supply[:: graph.n_nodes + 1] = 1.0
    capacity = row_capacities(problem)
    used, by = zip(*use, strict=True) if use else ((), ())
    return _Model(
        columns,
        np.array(cost),
        coo_array((factors, (rows, cols)), shape=(n_rows, len(columns))).tocsr(),
        supply,
        coo_array((np.ones(len(used)), (used, by)), shape=(len(capacity), len(columns))).tocsr(),
        capacity,
    )


def _useful_arcs(graph: ExplicitGraph, start: int, goal: int) -> list[int]:
    """Arcs on some way from the start in slot 0 to the goal; none if the robot is there already."""
    if start == goal:
        return []
    from_start = np.isin(np.arange(graph.n_nodes), graph.nodes_of(start, 0))
    to_goal = np.isin(np.arange(graph.n_nodes), graph.nodes_of(goal))
    by_tail = np.argsort(graph.tail, kind="stable")
    for arc in by_tail:  # tails in the order of slots: all arcs into a tail are done before
        if from_start[graph.tail[arc]]:
            from_start[graph.head[arc]] = True
    for arc in by_tail[::-1]:
        if to_goal[graph.head[arc]]:
            to_goal[graph.tail[arc]] = True
    return np.flatnonzero(from_start[graph.tail] & to_goal[graph.head]).tolist()


class _Places:
    """Numbers of the capacity rows, as `rows_of` lays them out."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        T, V, E = problem.horizon, problem.n_vertices, problem.n_edges
        first_edge, first_ap = T * V, T * V + T * E
        assert first_ap + (T + 1) * problem.n_aps == len(rows_of(problem, Penalties.none(problem)))
        self.vertex = lambda t, v: (t - 1) * V + v
        self.edge = lambda t, e: first_edge + t * E + e
        self.ap = lambda t, a: first_ap + t * problem.n_aps + a

    def standing(self, graph: ExplicitGraph, node: int) -> list[int]:
        """Vertex (from slot 1 on) and AP of a node."""
        t, v, a = (int(x[node]) for x in (graph.node_slot, graph.node_vertex, graph.node_ap))
        return ([self.vertex(t, v)] if t else []) + [self.ap(t, a)]

    def along(self, graph: ExplicitGraph, arc: int) -> list[int]:
        """What an arc uses after its tail: its edge, its AP while amid the edge, its head."""
        t, a = int(graph.node_slot[graph.tail[arc]]), int(graph.node_ap[graph.tail[arc]])
        edge, k = int(graph.edge[arc]), int(graph.slots[arc])
        rows = self.standing(graph, int(graph.head[arc]))
        rows += [self.ap(t + j, a) for j in range(1, k)]
        return rows + ([] if edge == WAIT else [self.edge(t + j, edge) for j in range(k)])

    def parking(self, graph: ExplicitGraph, node: int) -> list[int]:
        """What a robot that ends at a node uses from the next slot on (§1.4)."""
        if self.problem.at_goal != "park":
            return []
        t, v, a = (int(x[node]) for x in (graph.node_slot, graph.node_vertex, graph.node_ap))
        later = range(t + 1, self.problem.horizon + 1)
        return [self.vertex(s, v) for s in later] + [self.ap(s, a) for s in later]


def _paths(graph: ExplicitGraph, model: _Model, chosen: NDArray[np.bool_]) -> tuple[Path, ...]:
    """The robots' paths from the columns at 1."""
    problem = graph.problem
    first = [0] * problem.n_robots
    next_arc: list[dict[int, int]] = [{} for _ in first]
    for column in np.flatnonzero(chosen):
        robot, what, index = model.columns[column]
        if what == "start":
            first[robot] = index
        elif what == "arc":
            next_arc[robot][int(graph.tail[index])] = index
    paths = []
    for i, node in enumerate(first):
        arcs, at = [], node
        while at in next_arc[i]:
            arcs.append(next_arc[i][at])
            at = int(graph.head[arcs[-1]])
        paths.append(graph.path(i, node, arcs))
    return tuple(paths)
