"""The time-coverage expanded graph G' of the paper (section IV-A), written out arc by arc."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planner.plan import Path
from planner.problem import Problem

WAIT = -1

Floats = NDArray[np.float64]


@dataclass
class Penalties:
    """What using a place in a slot costs on top: duals of the master's rows, or reservations.

    Attributes:
        vertex: (T+1, V) float64, γ.
        edge: (T, E) float64, π.
        ap: (T+1, A) float64, λ.
    """

    vertex: Floats
    edge: Floats
    ap: Floats

    @classmethod
    def none(cls, problem: Problem) -> Penalties:
        """All zero."""
        T = problem.horizon
        return cls(
            np.zeros((T + 1, problem.n_vertices)),
            np.zeros((T, problem.n_edges)),
            np.zeros((T + 1, problem.n_aps)),
        )


@dataclass
class Weights:
    """Penalties spread over G': what each of its edges and vertices costs."""

    arc: Floats
    node: Floats
    penalties: Penalties


@dataclass
class ExplicitGraph:
    """G' with every vertex v^{at} and every edge of it in memory.

    Node number t·|pairs| + k is the copy of pair k in slot t. Arcs are sorted by their head.

    Attributes:
        problem: what it expands.
        pairs: (vertex, AP) for all v and a in A_v.
        tail, head: (M,) int64, nodes.
        edge: (M,) int32, edge of G crossed, WAIT for waiting.
        slots: (M,) int32, slots it takes.
        cost: (M,) float64, c_t · slots, and c_h with a handover (equation 2).
        node_slot, node_vertex, node_ap: of every node.
    """

    problem: Problem
    pairs: list[tuple[int, int]] = field(init=False)
    tail: NDArray[np.int64] = field(init=False)
    head: NDArray[np.int64] = field(init=False)
    edge: NDArray[np.int32] = field(init=False)
    slots: NDArray[np.int32] = field(init=False)
    cost: Floats = field(init=False)
    node_slot: NDArray[np.int64] = field(init=False)
    node_vertex: NDArray[np.int64] = field(init=False)
    node_ap: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        p = self.problem
        T = p.horizon
        self.pairs = [(v, a) for v in range(p.n_vertices) for a in aps_at(p, v)]
        number = {pair: k for k, pair in enumerate(self.pairs)}
        n = len(self.pairs)
        moves = [  # (pair left, pair reached, edge, slots) as they can start in any slot
            (number[v, a], number[v, b], WAIT, 1)
            for v in range(p.n_vertices)
            for a in aps_at(p, v)
            for b in aps_at(p, v)
        ]
        for e, (u, v) in enumerate(p.edge_uv.tolist()):
            k = int(p.edge_slots[e])
            for a in aps_at(p, u):
                for b in aps_at(p, v):
                    if p.edge_cover[e, a] if a == b else p.edge_handover[e, a, b]:
                        moves.append((number[u, a], number[v, b], e, k))
                        if not p.edge_oneway[e]:
                            moves.append((number[v, b], number[u, a], e, k))
        left, reached, edge, slots = np.array(moves, np.int64).T
        tails, heads, which = [], [], []
        for t in range(T):
            fits = np.flatnonzero(t + slots <= T)
            tails.append(t * n + left[fits])
            heads.append((t + slots[fits]) * n + reached[fits])
            which.append(fits)
        order = np.argsort(np.concatenate(heads), kind="stable")
        move = np.concatenate(which)[order]
        self.tail, self.head = np.concatenate(tails)[order], np.concatenate(heads)[order]
        self.edge, self.slots = edge[move].astype(np.int32), slots[move].astype(np.int32)
        node = np.arange((T + 1) * n)
        self.node_slot = node // n
        self.node_vertex = np.tile([v for v, _ in self.pairs], T + 1)
        self.node_ap = np.tile([a for _, a in self.pairs], T + 1)
        handover = self.node_ap[self.tail] != self.node_ap[self.head]
        self.cost = p.c_t * self.slots.astype(np.float64) + p.c_h * handover
        # Arcs of one head lie together, and heads of one slot too: the layers of the search.
        self._head_first = np.flatnonzero(np.diff(self.head, prepend=-1))
        head_slot = self.node_slot[self.head[self._head_first]]
        self._layers = np.searchsorted(head_slot, np.arange(1, T + 2))

    @property
    def n_nodes(self) -> int:
        """|V'|."""
        return len(self.node_slot)

    @property
    def n_arcs(self) -> int:
        """|E'|."""
        return len(self.tail)

    def nodes_of(self, vertex: int, slot: int | None = None) -> NDArray[np.int64]:
        """All copies of a vertex, or those of one slot."""
        found = np.flatnonzero(self.node_vertex == vertex)
        return found if slot is None else found[self.node_slot[found] == slot]

    def weigh(self, penalties: Penalties) -> Weights:
        """Cost of every arc with the penalties of all it uses after its tail's own slot.

        That is: the edge in each slot of the crossing (§1.3), the AP of the vertex left in the
        slots amid the edge (§1.6), and vertex and AP of the head in the slot of arrival.
        """
        # Standing at a vertex with an AP; slot 0 has no vertex row.
        node = np.where(
            self.node_slot == 0, 0.0, penalties.vertex[self.node_slot, self.node_vertex]
        )
        node += penalties.ap[self.node_slot, self.node_ap]
        weight = self.cost + node[self.head]
        entered, ap = self.node_slot[self.tail], self.node_ap[self.tail]
        for j in range(int(self.slots.max(initial=0))):
            crossing = (self.edge != WAIT) & (self.slots > j)
            weight[crossing] += penalties.edge[entered[crossing] + j, self.edge[crossing]]
            if j:
                weight[crossing] += penalties.ap[entered[crossing] + j, ap[crossing]]
        return Weights(weight, node, penalties)

    def shortest_path(self, robot: int, weights: Weights) -> tuple[float, Path | None]:
        """The cheapest path of a robot, penalties included (the pricing problem, equation 3).

        Bellman's recursion over the slots: every arc leads to a later one.

        Returns:
            Its weight and the path; (inf, None) if there is none.
        """
        p = self.problem
        start, goal = int(p.start[robot]), int(p.goal[robot])
        weight = weights.arc
        distance = np.full(self.n_nodes, np.inf)
        first = self.nodes_of(start, 0)
        distance[first] = weights.node[first]
        if start != goal:  # otherwise the path is that one state (§1.5)
            bounds = np.append(self._head_first, self.n_arcs)
            for lo, hi in zip(self._layers, self._layers[1:], strict=False):
                if lo == hi:
                    continue
                arcs = slice(bounds[lo], bounds[hi])
                reach = distance[self.tail[arcs]] + weight[arcs]
                heads = self._head_first[lo:hi]
                distance[self.head[heads]] = np.minimum.reduceat(reach, heads - heads[0])
        ends = self.nodes_of(goal, 0 if start == goal else None)
        total = (
            distance[ends]
            + self._parking(weights.penalties, goal)[self.node_slot[ends], self.node_ap[ends]]
        )
        best = int(np.argmin(total))
        if not np.isfinite(total[best]):
            return np.inf, None
        arcs_back = []
        node = int(ends[best])
        while self.node_slot[node] > 0:
            lo, hi = np.searchsorted(self.head, [node, node + 1])
            reach = distance[self.tail[lo:hi]] + weight[lo:hi]
            arc = int(lo + np.argmin(reach))
            arcs_back.append(arc)
            node = int(self.tail[arc])
        return float(total[best]), self.path(robot, node, arcs_back[::-1])

    def _parking(self, penalties: Penalties, goal: int) -> Floats:
        """(T+1, A): what standing at the goal from the slot after arrival until T costs (§1.4)."""
        parking = np.zeros_like(penalties.ap)
        if self.problem.at_goal == "park":
            for t in range(self.problem.horizon - 1, -1, -1):
                later = penalties.vertex[t + 1, goal] + penalties.ap[t + 1]
                parking[t] = parking[t + 1] + later
        return parking

    def path(self, robot: int, node: int, arcs: list[int]) -> Path:
        """The states along arcs of G' that begin at `node`."""
        vertices, aps = [int(self.node_vertex[node])], [int(self.node_ap[node])]
        edges: list[int] = []
        for arc in arcs:
            k = int(self.slots[arc])
            vertices += [vertices[-1]] * (k - 1) + [int(self.node_vertex[self.head[arc]])]
            aps += [aps[-1]] * (k - 1) + [int(self.node_ap[self.head[arc]])]
            edges += [int(self.edge[arc])] * k
        columns = (np.array(x, np.int32) for x in (vertices, aps, edges))
        return Path(self.problem.robot_ids[robot], *columns)


def aps_at(problem: Problem, vertex: int) -> list[int]:
    """A_v."""
    return np.flatnonzero(problem.cover[vertex]).tolist()


def path_cost(problem: Problem, path: Path) -> int:
    """§1.9."""
    return problem.c_t * path.arrival + problem.c_h * path.handovers


def usage(problem: Problem, path: Path) -> Penalties:
    """b_iet, g_ivt and l_iat of a path as 0/1 arrays (the paper's binary parameters)."""
    used = Penalties.none(problem)
    standing = {0}
    t = 0
    while t < path.arrival:
        k = 1
        if path.edges[t] != WAIT:
            k = int(problem.edge_slots[path.edges[t]])
            used.edge[t : t + k, path.edges[t]] = 1
        t += k
        standing.add(t)
    for t, (v, a) in enumerate(zip(path.vertices, path.aps, strict=True)):
        used.ap[t, a] = 1
        if t in standing:
            used.vertex[t, v] = 1
    if problem.at_goal == "park":
        used.vertex[path.arrival :, path.vertices[-1]] = 1
        used.ap[path.arrival :, path.aps[-1]] = 1
    return used


def rows_of(problem: Problem, used: Penalties) -> Floats:
    """The used places as a column of the master: vertex rows (slots 1 … T), edge rows, AP rows."""
    return np.concatenate([used.vertex[1:].ravel(), used.edge.ravel(), used.ap.ravel()])


def penalties_of(problem: Problem, rows: Floats) -> Penalties:
    """The inverse of `rows_of`."""
    penalties = Penalties.none(problem)
    V, E = penalties.vertex[1:].size, penalties.edge.size
    penalties.vertex[1:] = rows[:V].reshape(penalties.vertex[1:].shape)
    penalties.edge[:] = rows[V : V + E].reshape(penalties.edge.shape)
    penalties.ap[:] = rows[V + E :].reshape(penalties.ap.shape)
    return penalties


def row_capacities(problem: Problem) -> Floats:
    """Right-hand sides of the rows: 1, 1 and m."""
    capacity = Penalties.none(problem)
    capacity.vertex[:] = 1
    capacity.edge[:] = 1
    capacity.ap[:] = problem.ap_capacity
    return rows_of(problem, capacity)
