"""The time-coverage expanded graph G' (paper, section IV-A) by index arithmetic.

G' has a copy of every (vertex, AP) pair for every slot. It is never built: all its slots look
alike, so one static graph of (vertex, AP) pairs, here called *nodes*, and the arcs between them say
it all.
The state (node n, slot t) has index t·n_nodes + n.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planner.problem import Problem

Ints = NDArray[np.int32]


@dataclass(frozen=True)
class ExpandedGraph:
    """G' of a problem.

    Attributes:
        problem: what it expands.
        node_vertex, node_ap: (n,) int32, the pair a node stands for, sorted by vertex, then AP.
        node_of: (V, A) int32, the node of a pair, -1 where the AP does not cover the vertex.
        arc_ptr: (n+1,) int32, arcs leaving node k are arc_ptr[k]:arc_ptr[k+1].
        arc_from, arc_to: (m,) int32, nodes.
        arc_edge: (m,) int32, edge of G, -1 for waiting.
        arc_move: (m,) int32, what the robot's body does: 2e crosses edge e as written, 2e+1 the
            other way, 2E+v waits at v. Two arcs with one move differ in APs only.
        arc_slots: (m,) int32, slots it takes.
        arc_cost: (m,) int64, c_t · slots + c_h if the AP changes (§1.9).
    """

    problem: Problem
    node_vertex: Ints
    node_ap: Ints
    node_of: Ints
    arc_ptr: Ints
    arc_from: Ints
    arc_to: Ints
    arc_edge: Ints
    arc_move: Ints
    arc_slots: Ints
    arc_cost: NDArray[np.int64]

    @classmethod
    def of(cls, problem: Problem) -> ExpandedGraph:
        """Builds the static graph; O(arcs) time and memory."""
        cover = problem.cover
        node_vertex, node_ap = (x.astype(np.int32) for x in np.nonzero(cover))
        node_of = np.full(cover.shape, -1, np.int32)
        node_of[node_vertex, node_ap] = np.arange(len(node_vertex), dtype=np.int32)

        # Waiting at v: any pair of APs that cover it.
        v, a, b = np.nonzero(cover[:, :, None] & cover[:, None, :])
        tails, heads = [node_of[v, a]], [node_of[v, b]]
        edges, slots = [np.full(len(v), -1, np.int32)], [np.ones(len(v), np.int32)]

        # Crossing e from u to v, and back where it is not one-way: A_e without a handover,
        # `edge_handover` with one (§1.7).
        allowed = problem.edge_handover.copy()
        diagonal = np.arange(len(problem.ap_ids))
        allowed[:, diagonal, diagonal] = problem.edge_cover
        u_of, v_of = problem.edge_uv[:, 0], problem.edge_uv[:, 1]
        allowed &= cover[u_of][:, :, None] & cover[v_of][:, None, :]
        e, a, b = np.nonzero(allowed)
        back = ~problem.edge_oneway[e]
        for tail_node, head_node, k in (
            (node_of[u_of[e], a], node_of[v_of[e], b], e),
            (node_of[v_of[e], b][back], node_of[u_of[e], a][back], e[back]),
        ):
            tails.append(tail_node)
            heads.append(head_node)
            edges.append(k.astype(np.int32))
            slots.append(problem.edge_slots[k])

        arc_from, arc_to = np.concatenate(tails), np.concatenate(heads)
        arc_edge, arc_slots = np.concatenate(edges), np.concatenate(slots)
        order = np.lexsort((arc_edge, arc_to, arc_from))
        arc_from, arc_to = arc_from[order], arc_to[order]
        arc_edge, arc_slots = arc_edge[order], arc_slots[order].astype(np.int32)
        tail = node_vertex[arc_from]
        arc_move = np.where(
            arc_edge < 0,
            2 * len(problem.edge_uv) + tail,
            2 * arc_edge + (tail != u_of[arc_edge] if len(u_of) else 0),
        ).astype(np.int32)
        handover = node_ap[arc_from] != node_ap[arc_to]
        arc_cost = arc_slots.astype(np.int64) * problem.c_t + handover * np.int64(problem.c_h)
        counts = np.bincount(arc_from, minlength=len(node_vertex))
        arc_ptr = np.concatenate(([0], np.cumsum(counts))).astype(np.int32)
        graph = cls(
            problem,
            node_vertex,
            node_ap,
            node_of,
            arc_ptr,
            arc_from,
            arc_to,
            arc_edge,
            arc_move,
            arc_slots,
            arc_cost,
        )
        for array in vars(graph).values():
            if isinstance(array, np.ndarray):
                array.flags.writeable = False
        return graph

    @property
    def n_nodes(self) -> int:
        """Σ_v |A_v|."""
        return len(self.node_vertex)

    @property
    def n_expanded_vertices(self) -> int:
        """|V'| (§1.11)."""
        return (self.problem.horizon + 1) * self.n_nodes

    @property
    def n_expanded_edges(self) -> int:
        """|E'| (§1.11): an arc of k slots can start in T + 1 − k of them."""
        starts = np.maximum(self.problem.horizon + 1 - self.arc_slots.astype(np.int64), 0)
        return int(starts.sum())

    @cached_property
    def reversed_arcs(self) -> tuple[Ints, Ints]:
        """(ptr, arc): arc[ptr[k]:ptr[k+1]] are the arcs that enter node k."""
        order = np.argsort(self.arc_to, kind="stable").astype(np.int32)
        counts = np.bincount(self.arc_to, minlength=self.n_nodes)
        return np.concatenate(([0], np.cumsum(counts))).astype(np.int32), order

    def nodes_at(self, vertex: int) -> Ints:
        """The nodes of a vertex, by AP."""
        row = self.node_of[vertex]
        nodes: Ints = row[row >= 0]
        return nodes
