"""The decoupled baseline: shortest motions first, then the best APs for them (§1.6, §1.7)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner import assignment
from planner.assignment import assign
from planner.check import check_plan
from planner.decoupled import decoupled, shortest_motions, without_radio
from planner.plan import Path, Plan
from planner.problem import Problem
from planner.solve import SolveParams, solve
from tests.oracles.arcflow import solve_arcflow
from tests.oracles.tiny_problems import random_hall, tiny_problem, tiny_problems
from tests.planner.examples import grid, path_of


def sequences(problem: Problem, motion: Path) -> Iterator[tuple[int, ...]]:
    """Every sequence of APs that §1.6 and §1.7 allow along a motion, by plain recursion."""
    vertices, edges = motion.vertices.tolist(), motion.edges.tolist()

    def fits(t: int, a: int, b: int) -> bool:
        e = edges[t]
        if e < 0:
            return True
        if vertices[t + 1] == vertices[t]:
            return a == b
        if a == b:
            return bool(problem.edge_cover[e, a])
        forward = vertices[t] == problem.edge_uv[e, 0]
        return bool(problem.edge_handover[e, a, b] if forward else problem.edge_handover[e, b, a])

    def extend(so_far: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        t = len(so_far)
        if t == len(vertices):
            yield so_far
            return
        for a in np.flatnonzero(problem.cover[vertices[t]]).tolist():
            if t == 0 or fits(t - 1, so_far[-1], a):
                yield from extend((*so_far, a))

    return extend(())


def fewest_by_force(problem: Problem, motions: Sequence[Path]) -> int | None:
    """Fewest handovers over all combinations within capacity; None if there is none."""
    park, T = problem.at_goal == "park", problem.horizon
    options = []
    for motion in motions:
        found: dict[tuple[tuple[int, int], ...], int] = {}
        for aps in sequences(problem, motion):
            use = [*enumerate(aps)]
            if park:
                use += [(t, aps[-1]) for t in range(len(aps), T + 1)]
            found[tuple(use)] = sum(a != b for a, b in pairwise(aps))
        options.append(sorted(found.items(), key=lambda item: item[1]))
    capacity = problem.ap_capacity.tolist()
    best: int | None = None

    def place(i: int, load: Counter[tuple[int, int]], handovers: int) -> None:
        nonlocal best
        if i == len(options):
            best = handovers
            return
        for use, count in options[i]:
            if best is not None and handovers + count >= best:
                return
            if all(load[t, a] < capacity[a] for t, a in use):
                load.update(use)
                place(i + 1, load, handovers + count)
                load.subtract(use)

    place(0, Counter(), 0)
    return best


def with_aps(problem: Problem, motions: Sequence[Path | None], aps: Sequence[object]) -> Plan:
    """The plan of motions and APs."""
    paths = tuple(
        None if m is None or a is None else replace(m, aps=a)
        for m, a in zip(motions, aps, strict=True)
    )
    cost = sum(problem.c_t * p.arrival + problem.c_h * p.handovers for p in paths if p)
    status = "feasible" if None not in paths else "unknown"
    return Plan(status, problem.robot_ids, paths, cost, 0.0)


@settings(max_examples=120, deadline=None)
@given(tiny_problems(max_robots=3, max_slots=6), st.booleans())
def test_assignment_is_the_best_of_all(problem, negotiate):
    """For fixed motions: as few handovers as exhaustive search finds, none exactly if it does.

    With and without the negotiation that spares most instances the integer program.
    """
    motions = shortest_motions(problem, seed=0, restarts=5, iterations=50).paths
    if None in motions:
        return
    with pytest.MonkeyPatch.context() as patch:
        if not negotiate:
            patch.setattr(assignment._Program, "negotiate", lambda _self: None)
        answer = assign(problem, motions)
    best = fewest_by_force(problem, motions)
    assert all(aps is not None for aps in answer.aps) == (best is not None)
    assert check_plan(problem, with_aps(problem, motions, answer.aps)) == []
    if best is not None:
        assert answer.handovers == answer.bound == best
        assert not answer.stuck
        assert not answer.overloads
    else:
        assert answer.stuck or answer.overloads


@settings(max_examples=60, deadline=None)
@given(tiny_problems(max_robots=3, max_slots=6))
def test_never_cheaper_than_the_optimum(problem):
    """A decoupled plan is a plan: it keeps every rule, and joint planning is never dearer."""
    plan = decoupled(problem, iterations=50)
    assert check_plan(problem, plan) == []
    exact = solve_arcflow(problem)
    if None not in plan.paths:
        assert exact.status == "optimal"
        assert plan.cost >= exact.cost
        assert plan.lower_bound <= exact.cost
    if plan.status == "infeasible":
        assert exact.status == "infeasible"


@settings(max_examples=60, deadline=None)
@given(tiny_problems(max_robots=3, max_slots=6, features=False))
def test_motions_are_the_shortest(problem):
    """On tiny floors the motions reach the exact minimum of the sum of arrival slots."""
    motions = shortest_motions(problem, seed=0, restarts=20, iterations=300)
    exact = solve_arcflow(without_radio(problem)[0])
    if exact.status == "infeasible":
        assert None in motions.paths
    elif None not in motions.paths:
        assert exact.cost <= motions.slots <= exact.cost + 2
        assert motions.bound <= exact.cost


def test_motions_disregard_the_aps():
    """A shorter way through poor radio is taken where joint planning would go round."""
    # Below, the way of 4 slots changes AP twice; above, one of 6 slots needs none.
    cover = [[0], [0], [0], [0], [0], [0], [1], [1], [1], [0]]
    p = grid(5, 2, [(5, 9)], cover=cover, horizon=8)
    plan = decoupled(p)
    assert plan.paths[0].vertices.tolist() == [5, 6, 7, 8, 9]
    assert (plan.slots, plan.handovers, plan.cost) == (4, 2, 4 + 2 * 8)
    joint = solve(p)
    assert (joint.slots, joint.handovers) == (6, 0)


def test_handovers_are_placed_where_there_is_room():
    """With one place per AP the two robots share out the APs instead of both using the first."""
    p = grid(3, 2, [(0, 2), (3, 5)], ap_capacity=np.array([1, 1]))
    plan = decoupled(p)
    assert plan.status == "optimal"
    assert plan.handovers == 0
    assert {int(path.aps[0]) for path in plan.paths} == {0, 1}


def test_parked_robots_keep_their_place_at_the_ap():
    """§1.4: who arrives first occupies its AP until T, so the other must have the other AP."""
    cover = [[0, 1], [0, 1], [0, 1], [0, 1], [0], [0]]
    p = grid(
        3, 2, [(0, 1), (3, 5)], cover=cover, at_goal="park", ap_capacity=np.array([1, 2]), horizon=6
    )
    plan = decoupled(p)
    assert check_plan(p, plan) == []
    assert plan.handovers == 0
    assert plan.paths[0].aps.tolist() == [1, 1]


def test_overload_is_told_with_ap_and_slots():
    """Two robots where one AP with one place is all there is: unknown, and where (§1.12)."""
    p = grid(3, 2, [(0, 2), (3, 5)], n_aps=1, ap_capacity=np.array([1]))
    plan = decoupled(p)
    assert plan.status == "unknown"
    assert plan.unserved == ("r0",)
    assert "leave no AP assignment within capacity" in plan.message
    assert "ap0 (up to 2 robots for 1 places) in slots 0 to 2" in plan.message
    assert check_plan(p, plan) == []


def test_overload_of_parked_robots_lasts_until_the_horizon():
    """§1.4: the place is missing in every slot up to T, not only while they drive."""
    p = grid(3, 2, [(0, 2), (3, 5)], n_aps=1, ap_capacity=np.array([1]), at_goal="park", horizon=7)
    assert "in slots 0 to 7" in decoupled(p).message


def test_least_overload_is_told():
    """Only the slots in which capacity is missing however the APs are shared out."""
    # All meet under ap1 in the middle column; at both ends ap0 has room for everybody.
    cover = [[0], [1], [0]] * 3
    p = grid(3, 3, [(0, 2), (3, 5), (6, 8)], cover=cover, ap_capacity=np.array([3, 2]))
    plan = decoupled(p)
    assert "ap1 (3 robots for 2 places) in slot 1;" in plan.message
    assert len(plan.unserved) == 1


def test_robot_no_ap_can_follow_is_told():
    """§1.7: both edges of its way need another AP and no handover is allowed between them."""
    base = grid(3, 1, [(0, 2)], cover=[[0], [0, 1], [1]])
    handover = np.zeros_like(base.edge_handover)
    handover[0, 0, 1] = True
    ok = replace(base, edge_handover=handover)
    assert decoupled(ok).status in {"optimal", "feasible"}
    # On edge 0 only a handover to ap1 is possible, on edge 1 only ap0 is left: no way through,
    # but waiting in between would have made one.
    cover = np.array([[1, 0], [1, 1], [1, 1]], bool)
    stuck = replace(
        ok,
        cover=cover,
        edge_cover=np.array([[False, False], [True, False]]),
        edge_handover=handover,
    )
    plan = decoupled(stuck)
    assert plan.status == "unknown"
    assert "no AP can follow on their shortest ways: r0 after slot 1 at vertex 1" in plan.message
    assert solve(stuck).status == "optimal"  # joint planning waits one slot and is handed back


def test_edges_nobody_can_cross_are_not_used():
    """An edge without any association is off the floor of the motions, indices kept."""
    p = grid(3, 2, [(0, 2)], n_aps=1)
    cover = p.edge_cover.copy()
    cover[0] = False
    blocked = replace(p, edge_cover=cover)
    plan = decoupled(blocked)
    assert check_plan(blocked, plan) == []
    assert plan.slots == 4
    bare, edge_of = without_radio(blocked)
    assert edge_of.tolist() == [e for e in range(p.n_edges) if e != 0]
    assert (bare.n_aps, bare.c_t, bare.c_h) == (1, 1, 0)


def test_edges_of_several_slots():
    """§1.6: the AP of the vertex left serves until arrival; the handover comes with it."""
    p = grid(2, 1, [(0, 1)], cover=[[0], [1]], edge_slots=np.array([3]))
    plan = decoupled(p)
    assert plan.paths[0].vertices.tolist() == [0, 0, 0, 1]
    assert plan.paths[0].aps.tolist() == [0, 0, 0, 1]
    assert check_plan(p, plan) == []


def test_robot_that_cannot_arrive_is_proven():
    """§1.12: too far for the horizon is infeasible for everyone, not a failing of this method."""
    plan = decoupled(grid(5, 1, [(0, 4)], horizon=3))
    assert plan.status == "infeasible"
    assert plan.infeasible_robots == ("r0",)


def test_limit_of_nodes_reports_its_gap():
    """Without branching what is left unproven is told: bound ≤ handovers, and the plan is sound."""
    for seed in range(3):
        p = random_hall(seed, n=50, m=13)
        motions = shortest_motions(p, seed=0, restarts=20, iterations=300).paths
        answer = assign(p, motions, max_nodes=1)
        assert answer.bound <= answer.handovers
        assert check_plan(p, with_aps(p, motions, answer.aps)) == []


def test_negotiation_and_integer_program_agree():
    """On a hall with room to negotiate both prove the same number of handovers."""
    p = random_hall(0, n=30, m=9)
    motions = shortest_motions(p, seed=0, restarts=20, iterations=200).paths
    first = assign(p, motions)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(assignment._Program, "negotiate", lambda _self: None)
        second = assign(p, motions)
    for answer in (first, second):
        assert check_plan(p, with_aps(p, motions, answer.aps)) == []
        assert answer.bound == answer.handovers
    assert first.handovers == second.handovers


def test_no_time_for_the_assignment_still_gives_a_sound_plan():
    """Robot by robot when the limit comes before the first solution; what is missing is told."""
    p = random_hall(0, n=50, m=15)
    plan = decoupled(p, iterations=0, time_limit=1e-6)
    assert check_plan(p, plan) == []
    assert plan.status in {"feasible", "unknown"}
    assert plan.status == "feasible" or plan.message


def test_same_seed_same_plan():
    """§1.15: byte for byte, and the random choices come from the seed alone."""
    p = random_hall(3, n=30, m=15)
    first, second = (decoupled(p, seed=4, iterations=200) for _ in range(2))
    assert first.paths == second.paths
    assert first.cost == second.cost


def test_solve_dispatches():
    """`SolveParams(method="decoupled")` is this method with its limits."""
    p = random_hall(1, n=20, m=15)
    plan = solve(p, SolveParams(method="decoupled", iterations=200, seed=2))
    assert plan.paths == decoupled(p, seed=2, iterations=200).paths
    assert "motion_slots" in plan.solver


@pytest.mark.parametrize("seed", range(3))
def test_paper_like_halls(seed):
    """Halls like the paper's, hp: sound, and slots close to the least, handovers above joint's."""
    p = random_hall(seed, n=30, m=15)
    plan = decoupled(p, iterations=500)
    assert check_plan(p, plan) == []
    assert plan.status == "feasible"
    assert plan.solver["assignment_bound"] == plan.solver["assignment_handovers"] == plan.handovers
    joint = solve(p, SolveParams(iterations=1000))
    assert joint.cost <= plan.cost
    assert joint.handovers <= plan.handovers


def test_one_robot_at_its_goal():
    """§1.5: a path of one state, served by one AP."""
    p = replace(tiny_problem(0), robot_ids=("r",), start=np.array([0]), goal=np.array([0]))
    plan = decoupled(p)
    assert check_plan(p, plan) == []
    assert plan.cost == 0


def test_assign_takes_any_motions():
    """APs of the given paths are disregarded, robots without a motion stay without."""
    p = grid(3, 1, [(0, 2), (1, 0)], cover=[[0], [0, 1], [1]])
    answer = assign(p, [path_of(p, 0, "0a 1a 2b"), None])
    assert answer.aps[1] is None
    assert answer.handovers == answer.bound == 1


def test_told_to_stop():
    """`solve` ends it with the best answer so far, whatever the number of iterations left."""
    p = random_hall(1, size=8, n=14, T=24, m=14)
    asked = []

    def stop():
        asked.append(True)
        return len(asked) > 3

    plan = solve(p, SolveParams(method="decoupled", iterations=10**9), stop=stop)
    assert check_plan(p, plan) == []
    assert plan.status in {"feasible", "optimal", "unknown"}
    assert len(asked) > 3
