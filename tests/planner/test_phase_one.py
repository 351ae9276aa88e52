"""Proofs of infeasibility are found where there are any, and hold in integers (§1.12)."""

from __future__ import annotations

import numpy as np
import pytest

from planner.cooperative import cooperative_astar
from planner.expanded_graph import ExpandedGraph
from planner.phase_one import InfeasibilityProof, prove_infeasible
from planner.plan import Path
from planner.problem import Problem
from planner.resources import SCALE, Resources
from planner.search import Search
from tests.oracles import expanded as explicit
from tests.oracles.arcflow import arcflow_bound, solve_arcflow
from tests.oracles.tiny_problems import random_hall, tiny_problem
from tests.planner.examples import grid


def attempt(problem: Problem, *, known: bool = True) -> InfeasibilityProof | None:
    """Phase 1, begun with what cooperative A* found (or with nothing)."""
    search, resources = Search(ExpandedGraph.of(problem)), Resources.of(problem)
    paths: list[tuple[int, Path]] = []
    if known:
        found = cooperative_astar(search, resources, range(problem.n_robots))
        paths = [(i, path) for i, path in enumerate(found) if path is not None]
    return prove_infeasible(search, resources, paths)


def verify(problem: Problem, proof: InfeasibilityProof) -> None:
    """Checks a proof anew: all in integers, by the explicit G' and the rules alone.

    Every plan uses each resource at most as often as it has room, so its penalties sum to at most
    the room. If the robots' least penalties alone sum to more, there is no plan.
    """
    T, V, E, A = problem.horizon, problem.n_vertices, problem.n_edges, problem.n_aps
    assert (proof.penalty > 0).all()
    table = explicit.Penalties.none(problem)
    room = 0
    for index, penalty in zip(proof.resources.tolist(), proof.penalty.tolist(), strict=True):
        if index < (T + 1) * V:
            t, v = divmod(index, V)
            assert t >= 1, "vertices in slot 0 are nobody's to fight for (§1.2)"
            table.vertex[t, v] = penalty
            room += penalty
        elif index < (T + 1) * V + T * E:
            t, e = divmod(index - (T + 1) * V, E)
            table.edge[t, e] = penalty
            room += penalty
        else:
            t, a = divmod(index - (T + 1) * V - T * E, A)
            assert t <= T
            table.ap[t, a] = penalty
            room += penalty * int(problem.ap_capacity[a])
    assert room == proof.room
    graph = explicit.ExplicitGraph(problem)
    need = 0
    for robot in range(problem.n_robots):
        least = least_penalty(problem, graph, robot, table)
        need += min(least, SCALE)
        assert (robot in proof.robots) <= (least > 0)
    assert need >= proof.need > proof.room
    assert proof.robots
    assert list(proof.robots) == sorted(set(proof.robots))


def least_penalty(
    problem: Problem, graph: explicit.ExplicitGraph, robot: int, table: explicit.Penalties
) -> int:
    """The least sum of penalties on any path, by Bellman's recursion over Python integers."""
    never = 1 << 62
    start, goal = int(problem.start[robot]), int(problem.goal[robot])
    vertex, edge, ap = (a.astype(np.int64).tolist() for a in (table.vertex, table.edge, table.ap))
    best = [never] * graph.n_nodes
    for node in graph.nodes_of(start, 0).tolist():
        best[node] = ap[0][int(graph.node_ap[node])]
    if start != goal:
        for arc in range(graph.n_arcs):  # sorted by head: tails are final
            tail, head, e = int(graph.tail[arc]), int(graph.head[arc]), int(graph.edge[arc])
            t, k = int(graph.node_slot[tail]), int(graph.slots[arc])
            step = vertex[t + k][int(graph.node_vertex[head])]
            step += ap[t + k][int(graph.node_ap[head])]
            step += sum(ap[t + j][int(graph.node_ap[tail])] for j in range(1, k))
            if e != explicit.WAIT:
                step += sum(edge[t + j][e] for j in range(k))
            best[head] = min(best[head], best[tail] + step)
    least = never
    for node in graph.nodes_of(goal).tolist():
        t, a = int(graph.node_slot[node]), int(graph.node_ap[node])
        later = range(t + 1, problem.horizon + 1) if problem.at_goal == "park" else ()
        least = min(least, best[node] + sum(vertex[s][goal] + ap[s][a] for s in later))
    return least


def reachable(problem: Problem) -> bool:
    """Every robot alone on the floor reaches its goal; the others are found before any LP."""
    search = Search(ExpandedGraph.of(problem))
    return all(search.can_arrive(i) for i in range(problem.n_robots))


SEEDS = [seed for seed in range(110) if reachable(tiny_problem(seed))]


@pytest.mark.parametrize("seed", SEEDS)
def test_proof_if_and_only_if_the_relaxation_is_infeasible(seed: int) -> None:
    """§1.12: there is a proof exactly where the arc-flow LP has no solution, and it holds."""
    problem = tiny_problem(seed)
    proof = attempt(problem)
    assert (proof is not None) == (arcflow_bound(problem) is None)
    if proof is not None:
        verify(problem, proof)
        assert solve_arcflow(problem).status == "infeasible"


def test_both_outcomes_occur() -> None:
    """The problems above have enough proofs, and enough problems without, to mean something."""
    proofs = sum(attempt(tiny_problem(seed)) is not None for seed in SEEDS)
    assert proofs >= 10
    assert len(SEEDS) - proofs >= 40


@pytest.mark.parametrize("seed", SEEDS[::4])
def test_proof_does_not_depend_on_the_paths_it_starts_with(seed: int) -> None:
    """Begun without any path, phase 1 comes to the same conclusion."""
    problem = tiny_problem(seed)
    proof = attempt(problem, known=False)
    assert (proof is not None) == (attempt(problem) is not None)
    if proof is not None:
        verify(problem, proof)


KNOWN = {
    "one AP, one place, two robots (§1.6)": (
        grid(4, 1, [(0, 1), (3, 2)], n_aps=1, ap_capacity=[1]),
        (0, 1),
    ),
    "an AP without places (§1.6)": (
        grid(3, 1, [(0, 1), (2, 2)], cover=[[0], [0], [1]], ap_capacity=[0, 1]),
        (0,),
    ),
    "a swap over one edge in no more time than it takes (§1.3)": (
        grid(2, 1, [(0, 1), (1, 0)], horizon=1),
        (0, 1),
    ),
    "a swap in a corridor in no more time than it takes (§1.2)": (
        grid(5, 1, [(0, 4), (4, 0)], horizon=4),
        (0, 1),
    ),
    "a robot that parks in the only passage (§1.4)": (
        grid(3, 1, [(0, 2), (1, 1)], at_goal="park"),
        (0, 1),
    ),
    "a passage too narrow for all in time (§1.2)": (
        # Six robots through the middle column of one vertex, and time for three.
        grid(
            3,
            3,
            [(0, 2), (3, 5), (6, 8), (2, 0), (5, 3), (8, 6)],
            n_aps=1,
            horizon=5,
            edge_uv=[(0, 3), (3, 6), (3, 4), (4, 5), (2, 5), (5, 8)],
        ),
        None,
    ),
    "parked robots fill the AP of the last goal (§1.4, §1.6)": (
        grid(
            3,
            2,
            [(0, 0), (3, 3), (1, 2)],
            n_aps=2,
            cover=[[0], [0, 1], [0], [0], [0], [0]],
            ap_capacity=[2, 1],
            at_goal="park",
        ),
        None,
    ),
}


@pytest.mark.parametrize("name", KNOWN)
def test_known_bottleneck(name: str) -> None:
    """§1.12: cases whose infeasibility can be seen are proven, and the robots at fault named."""
    problem, robots = KNOWN[name]
    proof = attempt(problem)
    assert proof is not None
    verify(problem, proof)
    if robots is not None:
        assert proof.robots == robots


def test_bystanders_are_not_named() -> None:
    """§1.12: a robot far from the bottleneck takes no part in the proof."""
    # r0 and r1 share an AP with one place; r2 is alone with its own.
    problem = grid(
        3,
        2,
        [(0, 1), (1, 0), (3, 5)],
        n_aps=2,
        horizon=2,
        cover=[[0], [0], [0], [1], [1], [1]],
        ap_capacity=[1, 1],
        edge_uv=[(0, 1), (3, 4), (4, 5)],
    )
    proof = attempt(problem)
    assert proof is not None
    verify(problem, proof)
    assert proof.robots == (0, 1)


def test_no_proof_for_what_can_be_done() -> None:
    """A crowded hall that has a plan: phase 1 answers None."""
    assert attempt(random_hall(1, size=8, n=14, T=24, m=5)) is None


def test_a_hall_with_too_little_room() -> None:
    """A hall whose APs hold fewer robots than there are is proven impossible."""
    problem = random_hall(1, size=6, n=10, T=12, m=2)
    proof = attempt(problem)
    assert proof is not None
    verify(problem, proof)


def test_stop_gives_up() -> None:
    """Told to stop, phase 1 answers None rather than anything unproven."""
    problem, _ = KNOWN["a passage too narrow for all in time (§1.2)"]
    search, resources = Search(ExpandedGraph.of(problem)), Resources.of(problem)
    asked = []

    def stop() -> bool:
        asked.append(True)
        return True

    assert prove_infeasible(search, resources, [], stop=stop) is None
    assert asked == [True]


@pytest.mark.parametrize("seed", SEEDS[:20])
def test_same_proof_twice(seed: int) -> None:
    """§1.15: the same problem gives the same proof."""
    one, two = attempt(tiny_problem(seed)), attempt(tiny_problem(seed))
    assert (one is None) == (two is None)
    if one is not None and two is not None:
        assert (one.robots, one.need, one.room) == (two.robots, two.need, two.room)
        assert (one.resources == two.resources).all()
        assert (one.penalty == two.penalty).all()
