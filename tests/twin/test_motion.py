"""Poses along edges, and the true clearance of bodies in motion."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.twin.plans import grid, make_plan, make_problem, random_plan, walk
from twin.clearance import clearance_m, nearness
from twin.motion import Roads, SlotMotion
from twin.order import visit_order
from worlds.floor import Boxes
from worlds.world import Body

BODY = Body(length_m=0.8, width_m=0.6)
NO_BOXES = Boxes((), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
QUICK = settings(max_examples=60, deadline=None, derandomize=True)


def roads_of(problem, *paths, boxes=NO_BOXES):
    """The visit order of a plan of these paths, and its roads."""
    order = visit_order(problem, make_plan(problem, *paths))
    return order, Roads(problem, order, boxes, BODY, BODY.height_m)


def slot_of(roads, order, *at, held=()):
    """The motion of robots at these states, all advancing but those held."""
    at = np.array(at, np.int32)
    advance = ~order.done(at)
    advance[list(held)] = False
    return roads.motion(at, advance)


# --- poses ------------------------------------------------------------------------------------


def test_a_robot_moves_linearly_along_its_edge_and_keeps_its_heading_while_it_waits():
    """Position and heading at the instants of each slot, edges driven either way."""
    problem = make_problem([(0, 0), (2, 0), (2, -4)], [(0, 1), (2, 1)], [(0, 2)])
    order, roads = roads_of(problem, walk(problem, "r0", 0, 1, 1, 2))
    quarters = np.array([0.0, 0.25, 0.5, 0.75])
    first, waiting, last = (slot_of(roads, order, t) for t in (0, 1, 2))
    assert first.xy_m(quarters)[0].tolist() == [[0, 0], [0.5, 0], [1, 0], [1.5, 0]]
    assert first.heading_rad.tolist() == [0.0]
    assert waiting.xy_m(quarters)[0].tolist() == [[2, 0]] * 4
    assert waiting.heading_rad.tolist() == [0.0]
    # Edge 1 runs from vertex 2 to vertex 1 and is driven from its v to its u.
    assert last.xy_m(quarters)[0].tolist() == [[2, 0], [2, -1], [2, -2], [2, -3]]
    assert last.heading_rad.tolist() == [-np.pi / 2]
    assert last.fraction(quarters)[0].tolist() == [1.0, 0.75, 0.5, 0.25]
    assert (last.enters.tolist(), last.leaves.tolist()) == ([2], [False])


def test_an_edge_of_several_slots_is_driven_in_equal_pieces():
    """§1.1: entered at t, left at t + k; in slot t + s it covers the share s/k … (s + 1)/k."""
    problem = make_problem([(0, 0), (6, 0)], [(0, 1)], [(0, 1), (1, 0)], slots=[3])
    order, roads = roads_of(problem, walk(problem, "r0", 0, 1), walk(problem, "r1", 1, 1, 1, 1, 0))
    ends = np.array([0.0, 1.0])
    for t in range(3):
        motion = slot_of(roads, order, t, 0)
        assert motion.xy_m(ends)[0, :, 0].tolist() == pytest.approx([2 * t, 2 * t + 2])
        assert motion.enters[0] == (1 if t == 2 else -1)
    for t in range(3):
        motion = slot_of(roads, order, 3, 3 + t)
        assert motion.xy_m(ends)[1, :, 0].tolist() == pytest.approx([6 - 2 * t, 4 - 2 * t])
    stuck = slot_of(roads, order, 2, 0, held=[0])
    assert stuck.xy_m(ends)[0, :, 0].tolist() == pytest.approx([4, 4])
    assert stuck.edge.tolist() == [0, -1]


def test_the_first_heading_is_that_of_the_first_move():
    """Before its first move a robot heads as in it; one that never moves heads along x."""
    problem = make_problem([(0, 0), (0, 3)], [(0, 1)], [(0, 1), (1, 1)])
    order, roads = roads_of(problem, walk(problem, "r0", 0, 0, 1), walk(problem, "r1", 1))
    assert slot_of(roads, order, 0, 0).heading_rad.tolist() == [np.pi / 2, 0.0]


def test_a_robot_held_before_a_turn_has_not_turned_yet():
    """It keeps the heading it came with until it moves."""
    problem = make_problem([(0, 0), (1, 0), (1, 1)], [(0, 1), (1, 2)], [(0, 2)])
    order, roads = roads_of(problem, walk(problem, "r0", 0, 1, 2))
    assert slot_of(roads, order, 1, held=[0]).heading_rad.tolist() == [0.0]
    assert slot_of(roads, order, 1).heading_rad.tolist() == [np.pi / 2]
    assert slot_of(roads, order, 0, held=[0]).heading_rad.tolist() == [0.0]


@QUICK
@given(st.integers(0, 10**6))
def test_motion_is_continuous_from_slot_to_slot(seed):
    """Every body begins a slot where the last one has left it, at its vertex if it is at one."""
    rng = np.random.default_rng(seed)
    xy, edges = grid(4, 3, 1.5)
    slots = rng.integers(1, 4, len(edges)).tolist()
    errands = np.column_stack([rng.permutation(12)[:5], rng.permutation(12)[:5]]).tolist()
    problem = make_problem(xy, edges, errands, slots=slots)
    order, roads = roads_of(problem, *random_plan(problem, rng).paths)
    before = {}
    for t in range(int(order.arrival.max(initial=0)) + 1):
        at = np.full(5, t, np.int32)
        motion = roads.motion(at, ~order.done(at))
        start, end = np.moveaxis(motion.xy_m(np.array([0.0, 1.0])), 1, 0)
        for k, i in enumerate(motion.robot.tolist()):
            if order.piece[motion.row[k]] == 0:
                assert start[k].tolist() == problem.xy_m[motion.vertex[k]].tolist()
            if i in before:
                assert start[k] == pytest.approx(before[i], abs=1e-12)
            before[i] = end[k]


# --- obstacles --------------------------------------------------------------------------------


POST_AND_BRIDGE = Boxes(
    ("post", "bridge"),
    np.array([[1.0, 0.35, 1.0], [6.0, 1.5, 1.5]]),
    np.array([[0.1, 0.1, 1.0]] * 2),
    np.zeros(2),
)
"""A post beside the first third of an edge along x, a bridge 0.5 m above one along y."""


@pytest.mark.parametrize("backwards", [False, True])
def test_a_body_that_touches_a_box_on_its_way_is_found(backwards):
    """Only in the slot, and on the piece of the edge, in which it happens; bridges by height."""
    places = [0, 1, 2][:: -1 if backwards else 1]
    problem = make_problem(
        [(0, 0), (6, 0), (6, 3)], [(0, 1), (1, 2)], [(places[0], places[-1])], slots=[3, 1]
    )
    order, roads = roads_of(problem, walk(problem, "r0", *places), boxes=POST_AND_BRIDGE)
    found = [
        roads.obstacle(slot_of(roads, order, t), np.array([t], np.int32)).tolist() for t in range(5)
    ]
    assert found == ([[-1], [-1], [-1], [0], [-1]] if backwards else [[0], *[[-1]] * 4])
    higher = Roads(problem, order, POST_AND_BRIDGE, BODY, 0.5)
    t = 0 if backwards else 3
    assert higher.obstacle(slot_of(higher, order, t), np.array([t], np.int32)).tolist() == [1]
    # Held at the end of the piece beside the post it touches it still.
    if not backwards:
        held = slot_of(roads, order, 1, held=[0])
        assert roads.obstacle(held, np.array([1], np.int32)).tolist() == [0]


def test_a_body_that_stands_in_a_box_is_found():
    """Also without any move: a robot at home in an obstacle."""
    problem = make_problem([(0, 0)], [], [(0, 0)])
    boxes = Boxes(
        ("crate",), np.array([[0.45, 0.0, 0.2]]), np.array([[0.1, 0.1, 0.2]]), np.zeros(1)
    )
    order, roads = roads_of(problem, walk(problem, "r0", 0), boxes=boxes)
    assert roads.obstacle(slot_of(roads, order, 0), np.zeros(1, np.int32)).tolist() == [0]
    problem = make_problem([(0, 0)], [], [(0, 0)])
    beside = Boxes(("crate",), boxes.center_m + np.array([0.1, 0, 0]), boxes.half_m, np.zeros(1))
    order, roads = roads_of(problem, walk(problem, "r0", 0), boxes=beside)
    assert roads.obstacle(slot_of(roads, order, 0), np.zeros(1, np.int32)).tolist() == [-1]


# --- clearance --------------------------------------------------------------------------------


def corners(center, half, yaw):
    """(4, 2) corners of a rectangle."""
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    return center + (np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * half) @ turn.T


def outline(rectangle, points):
    """Evenly spaced points on all four sides."""
    share = np.linspace(0.0, 1.0, points)[:, None]
    ring = [*rectangle, rectangle[0]]
    return np.concatenate([(1 - share) * p + share * q for p, q in pairwise(ring)])


def sampled_clearance(apart, step, half_a, yaw_a, half_b, yaw_b, times=61, points=41):
    """Oracle: dense points on both outlines at dense times; depth by dense directions."""
    angles = np.linspace(0.0, 2 * np.pi, 720, endpoint=False)
    angles = np.concatenate([angles, *(yaw + np.arange(4) * np.pi / 2 for yaw in (yaw_a, yaw_b))])
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    b = corners(np.zeros(2), half_b, yaw_b)
    outline_b = outline(b, points)
    least = np.inf
    for s in np.linspace(0.0, 1.0, times):
        a = corners(apart + s * step, half_a, yaw_a)
        # How far a must be pushed along each direction to clear b; the least is the depth.
        push = (b @ directions.T).max(axis=0) - (a @ directions.T).min(axis=0)
        if push.min() > 0:
            least = min(least, -push.min())
            continue
        gaps = outline(a, points)[:, None] - outline_b
        least = min(least, np.hypot(gaps[..., 0], gaps[..., 1]).min())
    return least


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(0, 10**6))
def test_clearance_equals_a_dense_sampling_of_points_and_times(seed):
    """Random rectangles in random linear motion: within the sampling's own error."""
    rng = np.random.default_rng(seed)
    apart, step = rng.uniform(-2, 2, 2), rng.uniform(-2.5, 2.5, 2) * rng.integers(0, 2)
    half_a, half_b = rng.uniform(0.1, 0.8, 2), rng.uniform(0.1, 0.8, 2)
    yaws = rng.uniform(-np.pi, np.pi, 2)
    if rng.random() < 0.4:  # axis-parallel bodies and paths are the usual and the degenerate case
        yaws = rng.integers(0, 4, 2) * np.pi / 2
        step = step * np.eye(2)[rng.integers(2)]
    found = clearance_m(apart[None], step[None], half_a[None], yaws[:1], half_b[None], yaws[1:])
    wanted = sampled_clearance(apart, step, half_a, yaws[0], half_b, yaws[1])
    # Sampling never finds less; it errs by half a step in time and in one outline.
    tolerance = np.hypot(*step) / 120 + 0.02
    assert wanted - tolerance <= found[0] <= wanted + 1e-9


@pytest.mark.parametrize(
    ("apart", "step", "yaw_a", "yaw_b", "expected"),
    [
        ((2, 0), (0, 0), 0, 0, 1.2),  # one behind the other
        ((0, 2), (0, 0), 0, 0, 1.4),  # side by side
        ((2, 0), (0, 0), np.pi / 2, 0, 1.3),  # across
        ((3, 0), (-2, 0), 0, 0, 0.2),  # nearest at the end
        ((-3, 1), (6, 0), 0, 0, 0.4),  # passes by: nearest in between only
        ((-3, 0.5), (6, 0), 0, 0, -0.1),  # grazes in passing: overlaps by 0.1
        ((0, 0), (0, 0), 0, 0, -0.6),  # on top of each other: 0.6 parts them across
        ((0, 0), (0, 0), np.pi / 2, 0, -0.7),  # a cross: no corner lies in the other
        ((0.8, 0), (0, 0), 0, 0, 0.0),  # touching is no overlap
        ((1, -1), (-1, 1), 0, np.pi / 2, -0.7),  # meets the other one across at the end
    ],
)
def test_clearance_of_bodies_by_hand(apart, step, yaw_a, yaw_b, expected):
    """Bodies of 0.8 m x 0.6 m in positions that can be worked out by hand."""
    half = np.array([0.4, 0.3])
    found = clearance_m(
        np.array([apart], float), np.array([step], float), half, np.array([yaw_a]), half,
        np.array([yaw_b]),
    )  # fmt: skip
    assert found[0] == pytest.approx(expected, abs=1e-12)


def test_two_followers_at_a_corner_come_within_pitch_over_root_two():
    """Page 5: centres within pitch/√2 at a corner, whatever the grid says."""
    pitch, body = 1.0, np.array([1e-9, 1e-9])
    # The leader has turned and drives up, the follower comes from the left.
    found = clearance_m(
        np.array([[pitch, 0.0]]), np.array([[-pitch, pitch]]), body, np.array([np.pi / 2]), body,
        np.zeros(1),
    )  # fmt: skip
    assert found[0] == pytest.approx(pitch / np.sqrt(2), abs=1e-6)


def bodies(rng, n, spread):
    """Random bodies, half of them standing, some driving off or taking another one's place."""
    start = rng.uniform(0, spread, (n, 2))
    end = start + rng.uniform(-1.5, 1.5, (n, 2)) * rng.integers(0, 2, (n, 1))
    return SlotMotion(
        robot=np.arange(n, dtype=np.int32),
        row=np.arange(n, dtype=np.int32),
        vertex=np.arange(n, dtype=np.int32),
        edge=np.zeros(n, np.int32),
        begin=np.zeros(n),
        end=np.ones(n),
        u_m=start,
        v_m=end,
        heading_rad=rng.uniform(-np.pi, np.pi, n),
        enters=np.where(rng.random(n) < 0.3, rng.integers(0, n, n), -1).astype(np.int32),
        leaves=rng.random(n) < 0.3,
    )


@QUICK
@given(st.integers(0, 10**6), st.integers(0, 14), st.sampled_from([3.0, 8.0, 40.0]))
def test_nearness_finds_the_least_clearance_and_all_overlaps_of_all_pairs(seed, n, spread):
    """The search among near pairs only leaves out none that matters."""
    motion = bodies(np.random.default_rng(seed), n, spread)
    half = np.array([0.4, 0.3])
    exact = {}
    for i, j in combinations(range(n), 2):
        leaving_home = motion.leaves[i] and motion.enters[j] == motion.vertex[i]
        coming_home = motion.leaves[j] and motion.enters[i] == motion.vertex[j]
        if leaving_home or coming_home:
            continue
        exact[i, j] = clearance_m(
            motion.start_m[[i]] - motion.start_m[[j]], motion.step_m[[i]] - motion.step_m[[j]],
            half, motion.heading_rad[[i]], half, motion.heading_rad[[j]],
        )[0]  # fmt: skip
    near = nearness(motion, BODY)
    if not exact:
        assert near.clearance_m is None
        return
    assert near.clearance_m == pytest.approx(min(exact.values()), abs=1e-12)
    assert exact[near.pair] == pytest.approx(near.clearance_m, abs=1e-12)
    assert {(i, j) for i, j, _ in near.overlaps} == {p for p, c in exact.items() if c < 0}


@pytest.mark.parametrize(("at_goal", "expected"), [("leave", None), ("park", -0.6)])
def test_a_robot_that_drives_off_is_not_measured_against_its_successor(at_goal, expected):
    """§1.4, `leave`: the goal may be entered in the slot after the arrival; parked bodies stay."""
    xy, edges = grid(3, 1, 2.0)
    problem = make_problem(xy, edges, [(1, 2), (0, 1)], at_goal=at_goal)
    order, roads = roads_of(problem, walk(problem, "r0", 1, 2), walk(problem, "r1", 0, 1, 2, 1))
    assert nearness(slot_of(roads, order, 0, 0), BODY).clearance_m == pytest.approx(1.2)
    assert nearness(slot_of(roads, order, 1, 1), BODY).clearance_m == expected
