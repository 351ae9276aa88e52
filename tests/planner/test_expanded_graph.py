"""G' by index arithmetic is the G' one gets by writing it out (§1.11)."""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings

from planner.expanded_graph import ExpandedGraph
from planner.problem import Problem
from tests.oracles.expanded import ExplicitGraph
from tests.oracles.tiny_problems import random_hall, tiny_problem, tiny_problems
from tests.planner.examples import grid

FEW = settings(derandomize=True, deadline=None, max_examples=60)


def arcs_from(graph: ExpandedGraph, vertex: int, ap: int) -> list[tuple[int, int, int, int, int]]:
    """(vertex, AP, edge, slots, cost) of the arcs that leave a pair, sorted."""
    n = graph.node_of[vertex, ap]
    assert n >= 0
    arcs = range(graph.arc_ptr[n], graph.arc_ptr[n + 1])
    return sorted(
        (
            int(graph.node_vertex[graph.arc_to[k]]),
            int(graph.node_ap[graph.arc_to[k]]),
            int(graph.arc_edge[k]),
            int(graph.arc_slots[k]),
            int(graph.arc_cost[k]),
        )
        for k in arcs
    )


@FEW
@given(tiny_problems())
def test_sizes_equal_explicit_counts(problem: Problem) -> None:
    """§1.11: |V'| and |E'| are what one counts in the graph written out, whatever its features."""
    graph, explicit = ExpandedGraph.of(problem), ExplicitGraph(problem)
    assert graph.n_expanded_vertices == explicit.n_nodes
    assert graph.n_expanded_edges == explicit.n_arcs


@FEW
@given(tiny_problems())
def test_arcs_equal_explicit_arcs(problem: Problem) -> None:
    """§1.1, §1.7, §1.9: the static arcs that fit before T are, slot by slot, the arcs of G'."""
    graph, explicit = ExpandedGraph.of(problem), ExplicitGraph(problem)
    T = problem.horizon
    pair = np.stack((explicit.node_vertex, explicit.node_ap), axis=1)
    written_out = Counter(
        (int(explicit.node_slot[u]), *pair[u].tolist(), *pair[v].tolist(), int(e), int(k), int(c))
        for u, v, e, k, c in zip(
            explicit.tail,
            explicit.head,
            explicit.edge,
            explicit.slots,
            explicit.cost,
            strict=True,
        )
    )
    by_arithmetic = Counter(
        (t, v, a, *arc)
        for v, a in np.argwhere(problem.cover).tolist()
        for arc in arcs_from(graph, v, a)
        for t in range(T + 1 - arc[3])
    )
    assert by_arithmetic == written_out


@FEW
@given(tiny_problems(features=False))
def test_sizes_under_endpoints_follow_the_formula(problem: Problem) -> None:
    """§1.11: under `endpoints` |E'| = T · (Σ_v |A_v|² + Σ_{directed (v,u)} |A_v||A_u|)."""
    graph = ExpandedGraph.of(problem)
    size = problem.cover.sum(axis=1).astype(int)
    directed = 2 * sum(int(size[u] * size[v]) for u, v in problem.edge_uv)
    assert graph.n_expanded_vertices == (problem.horizon + 1) * size.sum()
    assert graph.n_expanded_edges == problem.horizon * (int((size**2).sum()) + directed)


@pytest.mark.parametrize(("slots", "starts"), [(1, 5), (3, 3), (5, 1), (6, 0), (90_000, 0)])
def test_slow_edge_starts_early_enough(slots: int, starts: int) -> None:
    """§1.11: an edge of k slots can be entered in T + 1 − k slots each way, in none if k > T."""
    graph = ExpandedGraph.of(grid(2, 1, [(0, 1)], n_aps=1, horizon=5, edge_slots=[slots]))
    waits = 2 * 5
    assert graph.n_expanded_edges == waits + 2 * starts
    # c_t · k + no handover (§1.9).
    assert arcs_from(graph, 0, 0)[1] == (1, 0, 0, slots, slots)


def test_oneway_edge_is_crossed_from_u_to_v_only() -> None:
    """§1.1: a one-way edge has no arc back; its parallel twin written the other way has one."""
    problem = grid(2, 1, [(0, 1)], n_aps=1, edge_uv=[(0, 1), (1, 0)], edge_oneway=[True, True])
    graph = ExpandedGraph.of(problem)
    assert arcs_from(graph, 0, 0) == [(0, 0, -1, 1, 1), (1, 0, 0, 1, 1)]
    assert arcs_from(graph, 1, 0) == [(0, 0, 1, 1, 1), (1, 0, -1, 1, 1)]


def test_restricted_handovers_and_edge_cover() -> None:
    """§1.7: only the pairs an edge allows are arcs, mirrored on the way back."""
    allowed = np.zeros((1, 2, 2), bool)
    allowed[0, 0, 1] = True  # AP 0 at vertex 0, AP 1 at vertex 1
    problem = grid(2, 1, [(0, 1)], edge_cover=np.array([[False, True]]), edge_handover=allowed)
    graph = ExpandedGraph.of(problem)
    c = problem.c_h + 1

    def crossings(vertex: int, ap: int) -> list[tuple[int, int, int, int, int]]:
        return [arc for arc in arcs_from(graph, vertex, ap) if arc[2] >= 0]

    assert crossings(0, 0) == [(1, 1, 0, 1, c)]
    assert crossings(0, 1) == [(1, 1, 0, 1, 1)]
    assert crossings(1, 0) == []
    assert crossings(1, 1) == [(0, 0, 0, 1, c), (0, 1, 0, 1, 1)]


def test_waiting_may_hand_over_between_any_aps_of_the_vertex() -> None:
    """§1.7, §1.9: waiting has an arc for each pair of APs at the vertex, c_h where they differ."""
    problem = grid(2, 1, [(0, 1)], n_aps=3, cover=[[0, 2], [1]], horizon=4)
    graph = ExpandedGraph.of(problem)
    assert [arc for arc in arcs_from(graph, 0, 2) if arc[2] < 0] == [
        (0, 0, -1, 1, 1 + 4),
        (0, 2, -1, 1, 1),
    ]
    assert graph.nodes_at(0).tolist() == [0, 1]
    assert graph.nodes_at(1).tolist() == [2]
    assert graph.node_of.tolist() == [[0, -1, 1], [-1, 2, -1]]


@pytest.mark.parametrize("seed", range(20))
def test_moves_tell_edge_and_direction(seed: int) -> None:
    """§1.3: 2e and 2e+1 are the two ways over edge e, 2E+v is waiting at v; APs do not matter."""
    problem = tiny_problem(seed)
    graph = ExpandedGraph.of(problem)
    E = problem.n_edges
    for k in range(len(graph.arc_to)):
        tail, head = graph.node_vertex[graph.arc_from[k]], graph.node_vertex[graph.arc_to[k]]
        move, e = int(graph.arc_move[k]), int(graph.arc_edge[k])
        if e < 0:
            assert tail == head
            assert move == 2 * E + tail
        else:
            assert move >> 1 == e
            ends = problem.edge_uv[e].tolist()
            assert [tail, head] == (ends if move % 2 == 0 else ends[::-1])


@pytest.mark.parametrize("seed", range(20))
def test_reversed_arcs_enter_their_node(seed: int) -> None:
    """The reversed lists hold every arc once, under the node it enters."""
    graph = ExpandedGraph.of(tiny_problem(seed))
    ptr, arc = graph.reversed_arcs
    assert sorted(arc.tolist()) == list(range(len(graph.arc_to)))
    for n in range(graph.n_nodes):
        assert (graph.arc_to[arc[ptr[n] : ptr[n + 1]]] == n).all()
        assert (graph.arc_from[graph.arc_ptr[n] : graph.arc_ptr[n + 1]] == n).all()


def test_graph_without_edges_has_waiting_only() -> None:
    """A floor of one vertex: |V'| = (T+1)·|A_v| and |E'| = T·|A_v|²."""
    graph = ExpandedGraph.of(grid(1, 1, [(0, 0)], horizon=3))
    assert (graph.n_expanded_vertices, graph.n_expanded_edges) == (4 * 2, 3 * 4)
    assert (graph.arc_edge == -1).all()


def test_graph_is_read_only() -> None:
    """Everything in the graph is frozen."""
    graph = ExpandedGraph.of(tiny_problem(0))
    arrays = [getattr(graph, field.name) for field in dataclasses.fields(graph)]
    arrays = [array for array in arrays if isinstance(array, np.ndarray)]
    assert len(arrays) == 10
    assert not any(array.flags.writeable for array in arrays)


def test_size_of_the_paper_hall() -> None:
    """§1.11: the paper's hall gives about 50 000 vertices and 600 000 edges at T = 60."""
    graphs = [ExpandedGraph.of(random_hall(seed)) for seed in range(3)]
    assert np.mean([g.n_expanded_vertices for g in graphs]) == pytest.approx(50_000, rel=0.1)
    assert np.mean([g.n_expanded_edges for g in graphs]) == pytest.approx(600_000, rel=0.2)
