"""Visit order and group commit: replay, safety, liveness (design page 5; §1.1–§1.5)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.plan import Path
from tests.twin.plans import grid, make_plan, make_problem, random_plan, walk
from twin.errors import TwinError
from twin.order import GroupCommit, catch_up, group_commit, visit_order

QUICK = settings(max_examples=40, deadline=None, derandomize=True)


def random_case(seed: int, robots: int = 9, *, slow: float = 0.3):
    """A random plan on a 4 x 3 grid with some edges of 2 or 3 slots; crowded, so robots rotate."""
    rng = np.random.default_rng(seed)
    xy, edges = grid(4, 3)
    slots = [int(k) for k in np.where(rng.random(len(edges)) < slow, rng.integers(2, 4, 17), 1)]
    starts, goals = (rng.permutation(len(xy))[:robots].tolist() for _ in range(2))
    park = bool(rng.integers(2))
    n = 5 if park else robots
    problem = make_problem(
        xy,
        edges,
        list(zip(starts, goals, strict=True))[:n],
        cover=[{0, 1}] * len(xy),
        slots=slots,
        horizon=30,
        at_goal="park" if park else "leave",
    )
    return problem, random_plan(problem, rng), rng


def execute(problem, order, able, *, limit=2000):
    """(N,) states at the beginning of each slot, until all are done; `able(t)` is (N,) bool."""
    at = np.zeros(problem.n_robots, np.int32)
    history = []
    for t in range(limit):
        at = catch_up(order, at, t)
        history.append(at)
        if order.done(at).all():
            return history
        commit = group_commit(order, at, ~order.done(at) & able(t))
        at = at + commit.advance
    pytest.fail("the run does not end")


def conflicts(problem, order, history):
    """Pairs of robots at one vertex in a slot, or on one edge, as §1.2 and §1.3 forbid them."""
    found = []
    for t, at in enumerate(history):
        vertices, edges = {}, {}
        after = history[t + 1] if t + 1 < len(history) else at
        for i in np.flatnonzero(~order.gone(at)).tolist():
            row = order.first_row[i] + at[i]
            if order.piece[row] == 0:
                vertices.setdefault(int(order.vertex[row]), []).append(i)
            crosses = after[i] > at[i] and order.edge[row] >= 0
            if order.piece[row] > 0 or (crosses and at[i] < order.arrival[i]):
                # Waits that are left out lie between two slots, never within one.
                edges.setdefault(int(order.edge[row]), []).append(i)
        for place in (vertices, edges):
            found += [(t, robots) for robots in place.values() if len(robots) > 1]
    return found


@QUICK
@given(st.integers(0, 10**6))
def test_without_delays_the_plan_is_replayed_slot_for_slot(seed):
    """Every robot is at state t in slot t until it arrives, edges of several slots included."""
    problem, plan, _ = random_case(seed)
    order = visit_order(problem, plan)
    history = execute(problem, order, lambda _t: np.ones(problem.n_robots, bool))
    for t, at in enumerate(history):
        expected = np.minimum(t, order.arrival + (0 if order.park else 1))
        assert (at == np.maximum(expected, 0)).all()


@QUICK
@given(st.integers(0, 10**6), st.floats(0.05, 0.9), st.integers(1, 12))
def test_no_delay_makes_robots_collide_or_wait_for_ever(seed, p_delay, longest):
    """Safety (§1.2, §1.3) and liveness under random delays, and nobody is ever early."""
    problem, plan, rng = random_case(seed)
    order = visit_order(problem, plan)
    held_until = np.zeros(problem.n_robots, int)

    def able(t):
        if t < 60:
            struck = (rng.random(problem.n_robots) < p_delay) & (held_until <= t)
            held_until[struck] = t + rng.integers(1, longest + 1, int(struck.sum()))
        return held_until <= t

    history = execute(problem, order, able)
    assert conflicts(problem, order, history) == []
    for t, at in enumerate(history):
        assert (at <= t).all()
        assert t == 0 or (at >= history[t - 1]).all()


@QUICK
@given(st.integers(0, 10**6))
def test_those_the_plan_has_earliest_always_advance_if_they_are_ready(seed):
    """The liveness argument itself: who is at the least state is never held by another robot."""
    problem, plan, rng = random_case(seed)
    order = visit_order(problem, plan)
    at = np.zeros(problem.n_robots, np.int32)
    for t in range(200):
        at = catch_up(order, at, t)
        unfinished = ~order.done(at)
        if not unfinished.any():
            return
        first = unfinished & (at == at[unfinished].min())
        ready = first | (unfinished & (rng.random(problem.n_robots) < 0.5))
        commit = group_commit(order, at, ready)
        assert commit.advance[first].all()
        assert not commit.advance[~ready].any()
        at = at + commit.advance


@QUICK
@given(st.integers(0, 10**6))
def test_commit_is_the_greatest_fixpoint_of_page_5(seed):
    """`group_commit` equals the fixpoint as page 5 writes it, in any state that can be reached."""
    problem, plan, rng = random_case(seed)
    order = visit_order(problem, plan)
    at = np.zeros(problem.n_robots, np.int32)
    for t in range(25):
        at = catch_up(order, at, t)
        ready = ~order.done(at) & (rng.random(problem.n_robots) < 0.7)
        commit = group_commit(order, at, ready)
        chosen = set(np.flatnonzero(ready).tolist())
        changed = True
        while changed:
            changed = False
            for i in sorted(chosen):
                row = order.first_row[i] + at[i]
                j, left_after = int(order.before[row]), order.left_after[row]
                if j < 0 or at[j] > left_after:
                    continue
                stands_there = at[j] == left_after and not order.strict[row]
                if not (stands_there and j in chosen):
                    chosen.remove(i)
                    changed = True
        assert set(np.flatnonzero(commit.advance).tolist()) == chosen
        held = ready & ~commit.advance
        assert (commit.waits_for[held] >= 0).all()
        assert (commit.waits_for[~held] == -1).all()
        at = at + commit.advance


def rotation(n_robots=4):
    """Robots on the corners of a square, each moving to the next corner in slot 0."""
    ring = [0, 1, 3, 2]
    xy, edges = grid(2, 2)
    errands = [(ring[i], ring[(i + 1) % 4]) for i in range(n_robots)]
    problem = make_problem(xy, edges, errands)
    plan = make_plan(problem, *(walk(problem, f"r{i}", *e) for i, e in enumerate(errands)))
    return problem, visit_order(problem, plan)


def test_robots_rotate_in_a_closed_circle_in_one_slot():
    """A rotation, on which action-dependency graphs deadlock, is made in one slot (§1.3)."""
    _, order = rotation()
    at = np.zeros(4, np.int32)
    commit = group_commit(order, at, np.ones(4, bool))
    assert commit.advance.all()
    assert (commit.waits_for == -1).all()


def test_one_delayed_robot_holds_its_whole_circle_and_is_named():
    """Who follows a robot that is not ready is held, and told for whom it waits."""
    _, order = rotation()
    ready = np.array([True, True, False, True])
    commit = group_commit(order, np.zeros(4, np.int32), ready)
    assert not commit.advance.any()
    assert commit.waits_for.tolist() == [1, 2, -1, 0]


def test_planned_waits_are_kept_and_left_out_only_when_late():
    """A wait is made in its slot ("not before"). A late robot skips it, unless it changes the AP:
    at most one handover is made in a slot (§1.7).
    """
    xy, edges = grid(3, 1)
    problem = make_problem(xy, edges, [(0, 2)], cover=[{0, 1}] * 3)
    path = walk(problem, "r0", 0, 0, 0, 1, 1, 1, 2, aps=[0, 0, 0, 0, 0, 1, 1])
    order = visit_order(problem, make_plan(problem, path))
    at = np.zeros(1, np.int32)
    assert catch_up(order, at, 0).tolist() == [0]
    assert catch_up(order, at, 1).tolist() == [1]  # late by one: one of the two waits is left out
    assert catch_up(order, at, 9).tolist() == [2]
    # At state 3 it waits twice: a plain wait, then the handover.
    assert catch_up(order, np.array([3], np.int32), 9).tolist() == [4]
    assert catch_up(order, np.array([4], np.int32), 9).tolist() == [4]


def test_a_long_edge_may_be_entered_while_another_robot_stands_at_its_end():
    """The vertex is asked for in the last slot of a crossing: the plan is replayed as it is."""
    problem = make_problem(
        [(0, 0), (3, 0), (4, 0)], [(0, 1), (1, 2)], [(0, 1), (1, 2)], slots=[3, 1]
    )
    plan = make_plan(problem, walk(problem, "r0", 0, 1), walk(problem, "r1", 1, 1, 1, 2))
    order = visit_order(problem, plan)
    everybody = np.ones(2, bool)
    history = execute(problem, order, lambda _t: everybody)
    assert [at.tolist() for at in history] == [[0, 0], [1, 1], [2, 2], [3, 3], [4, 4]]
    # If r1 is late, r0 waits on the edge, before its last piece.
    history = execute(problem, order, lambda t: np.array([True, t > 5]))
    assert [at.tolist() for at in history][2:8] == [[2, 2]] * 5 + [[3, 3]]
    commit = group_commit(order, np.array([2, 0], np.int32), np.array([True, False]))
    assert commit.waits_for.tolist() == [1, -1]


def test_an_edge_of_several_slots_is_not_entered_in_the_slot_in_which_it_is_left():
    """§1.3: on an edge of k ≥ 2 slots one robot follows another only when that one is off it."""
    xy, edges = grid(3, 1)
    problem = make_problem(xy, edges, [(1, 2), (0, 2)], slots=[1, 2])
    plan = make_plan(problem, walk(problem, "r0", 1, 2), walk(problem, "r1", 0, 1, 1, 2))
    order = visit_order(problem, plan)
    # r0 is late by one slot: it makes its last piece when r1 wants to enter.
    commit = group_commit(order, np.array([1, 2], np.int32), np.ones(2, bool))
    assert commit.advance.tolist() == [True, False]
    assert commit.waits_for.tolist() == [-1, 0]


def test_a_vertex_left_by_driving_off_is_free_in_the_next_slot():
    """§1.4, `leave`: the goal can be entered in the slot after the arrival, not before."""
    xy, edges = grid(3, 1)
    problem = make_problem(xy, edges, [(1, 2), (0, 2)])
    plan = make_plan(problem, walk(problem, "r0", 1, 2), walk(problem, "r1", 0, 1, 2))
    order = visit_order(problem, plan)
    everybody = np.ones(2, bool)
    assert group_commit(order, np.array([1, 1], np.int32), everybody).advance.all()
    late = group_commit(order, np.array([1, 1], np.int32), np.array([False, True]))
    assert late.waits_for.tolist() == [-1, 0]


@pytest.mark.parametrize("at_goal", ["leave", "park"])
def test_start_at_the_goal_is_a_path_of_one_state(at_goal):
    """§1.5: the one-state path drives off in slot 0, or is done from the outset."""
    problem = make_problem([(0, 0)], [], [(0, 0)], at_goal=at_goal)
    order = visit_order(problem, make_plan(problem, walk(problem, "r0", 0)))
    at = np.zeros(1, np.int32)
    assert order.done(at).tolist() == [at_goal == "park"]
    assert group_commit(order, at, ~order.done(at)).advance.tolist() == [at_goal == "leave"]


def test_a_plan_with_collisions_is_executed_as_it_is():
    """Stays that overlap in the plan have no order between them: the twin replays and reports."""
    xy, edges = grid(3, 1)
    problem = make_problem(xy, edges, [(0, 2), (2, 0)])
    meet = make_plan(problem, walk(problem, "r0", 0, 1, 2), walk(problem, "r1", 2, 1, 0))
    swap = make_plan(problem, walk(problem, "r0", 0, 1, 2), walk(problem, "r1", 2, 2, 1, 0))
    for plan in (meet, swap):
        order = visit_order(problem, plan)
        history = execute(problem, order, lambda _t: np.ones(2, bool))
        assert len(history) == max(p.arrival for p in plan.paths) + 2
        assert conflicts(problem, order, history)


def test_entering_the_vertex_of_a_parked_robot_is_executed_as_planned():
    """§1.4, `park`: a plan that breaks the rule is not turned into a robot that waits for ever."""
    xy, edges = grid(3, 1)
    problem = make_problem(xy, edges, [(1, 2), (0, 1)], at_goal="park")
    plan = make_plan(problem, walk(problem, "r0", 1, 2), walk(problem, "r1", 0, 1, 2, 1))
    order = visit_order(problem, plan)
    history = execute(problem, order, lambda _t: np.ones(2, bool))
    assert [at.tolist() for at in history] == [[0, 0], [1, 1], [1, 2], [1, 3]]


def test_no_robot_waits_for_itself():
    """A robot that visits a vertex twice in a row has no gate there."""
    xy, edges = grid(2, 1)
    problem = make_problem(xy, edges, [(0, 0)])
    order = visit_order(problem, make_plan(problem, walk(problem, "r0", 0, 1, 0, 1, 0)))
    assert (order.before == -1).all()


def test_robots_without_a_path_take_no_part():
    """They are gone from the outset and hold nobody up."""
    xy, edges = grid(2, 1)
    problem = make_problem(xy, edges, [(1, 0), (0, 1)])
    order = visit_order(problem, make_plan(problem, None, walk(problem, "r1", 0, 1)))
    at = np.zeros(2, np.int32)
    assert order.gone(at).tolist() == [True, False]
    assert GroupCommit().decide(order, at, ~order.done(at)).advance.tolist() == [False, True]
    nobody = visit_order(problem, make_plan(problem, None, None))
    assert not group_commit(nobody, at, ~nobody.done(at)).advance.any()


def change(path, **columns):
    """The path with some of its columns replaced."""
    new = {name: np.array(values) for name, values in columns.items()}
    return Path(
        path.robot, **{n: new.get(n, getattr(path, n)) for n in ("vertices", "aps", "edges")}
    )


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (lambda p: change(p, vertices=[0, 1]), "τ"),
        (lambda p: change(p, vertices=[0, 2, 2, 2]), "does not lead from vertex 0 to vertex 2"),
        (lambda p: change(p, vertices=[0, 1, 1, 7]), "vertex 7 does not exist"),
        (lambda p: change(p, aps=[0, 0, 3, 0]), "AP 3 does not exist"),
        (lambda p: change(p, edges=[0, -1, 9]), "edge 9 does not exist"),
        (lambda p: change(p, edges=[0, -1, 0]), "edge 0 does not lead"),
        (lambda p: change(p, edges=[0, -1, -1]), "a wait does not lead"),
        (lambda p: change(p, edges=[-1, 0, 1]), "does not lead from vertex 0 to vertex 1"),
        (lambda p: change(p, vertices=[1, 1, 1, 2]), "at its start"),
        (lambda p: change(p, vertices=[0, 1, 1, 0]), "at its goal"),
    ],
)
def test_paths_that_are_not_walks_are_refused_with_robot_and_place(broken, words):
    """§1.1: every step is a wait or an edge of G in a direction it may be crossed in."""
    xy, edges = grid(3, 1)
    problem = make_problem(xy, edges, [(0, 2)])
    path = walk(problem, "r0", 0, 1, 1, 2)
    with pytest.raises(TwinError, match="robot r0") as error:
        visit_order(problem, make_plan(problem, broken(path)))
    assert words in str(error.value)


def test_broken_crossings_are_refused():
    """§1.1: an edge of k slots is crossed in exactly k, a one-way edge from u to v only."""
    slow = make_problem([(0, 0), (1, 0)], [(0, 1)], [(0, 1)], slots=[3])
    for vertices, taken in (([0, 0, 1], [0, 0]), ([0, 0, 0, 0, 1], [0] * 4), ([0, 1], [0])):
        path = Path("r0", np.array(vertices), np.zeros(len(vertices)), np.array(taken))
        with pytest.raises(TwinError, match="edge 0 does not lead"):
            visit_order(slow, make_plan(slow, path))
    oneway = make_problem([(0, 0), (1, 0)], [(0, 1)], [(1, 0)], oneway=[True])
    with pytest.raises(TwinError, match="edge 0 does not lead"):
        visit_order(oneway, make_plan(oneway, walk(oneway, "r0", 1, 0)))


def test_a_plan_for_other_robots_is_refused():
    """The message names both sides."""
    xy, edges = grid(2, 1)
    problem = make_problem(xy, edges, [(0, 1)])
    plan = make_plan(problem, walk(problem, "r0", 0, 1))
    with pytest.raises(TwinError, match=r"the plan is for robots r0 .*has x"):
        visit_order(replace(problem, robot_ids=("x",)), plan)
