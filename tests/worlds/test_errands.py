"""Who drives from where to where, and whether that is possible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.worlds.small_hall import errand, faults_of, make, picture, reachable
from worlds.errands import components, with_robots
from worlds.errors import WorldError
from worlds.generate import resolve
from worlds.world import World

# Random robots


def random_world(seed: int, count: int, share: float = 0.25, robot_seed: int = 0) -> World:
    """A 9 x 9 hall with drawn boxes and robots."""
    return make(
        {"size_m": (9, 9), "body": {"length_m": 0.4, "width_m": 0.4}},
        obstacles={"random": {"share": share, "seed": seed}},
        robots={"random": {"count": count, "seed": robot_seed}},
    )


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 500), st.integers(1, 12), st.integers(0, 5), st.integers(0, 2**63 - 1))
def test_adding_robots_keeps_the_others_errands(
    seed: int, count: int, more: int, robot_seed: int
) -> None:
    """Robot k's errand does not depend on how many come after it."""
    few = resolve(random_world(seed, count, robot_seed=robot_seed))
    many = resolve(random_world(seed, count + more, robot_seed=robot_seed))
    assert many.robot_ids[:count] == few.robot_ids
    assert many.start[:count].tolist() == few.start.tolist()
    assert many.goal[:count].tolist() == few.goal.tolist()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 500), st.integers(1, 25), st.integers(0, 50))
def test_drawn_errands_are_distinct_and_within_the_largest_component(
    seed: int, count: int, robot_seed: int
) -> None:
    """§1.2, §1.5: distinct origins, distinct goals, no goal its own origin; all connected."""
    floor = resolve(random_world(seed, count, robot_seed=robot_seed))
    start, goal = floor.start.tolist(), floor.goal.tolist()
    assert len(floor.robot_ids) == len(set(floor.robot_ids)) == count
    assert len(set(start)) == len(set(goal)) == count
    assert all(s != g for s, g in zip(start, goal, strict=True))
    home = reachable(floor, start[0])
    assert {*start, *goal} <= home
    everywhere = set(range(len(floor.vertex_xy_m)))
    while everywhere:
        part = reachable(floor, min(everywhere))
        assert len(part) <= len(home)
        everywhere -= part


def test_same_seed_same_floor_other_seed_other_errands() -> None:
    """A world resolves to the same floor every time."""
    one, two = (resolve(random_world(7, 10)) for _ in range(2))
    for name in ("vertex_xy_m", "vertex_cell", "edge_uv", "start", "goal"):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes()
    assert one.boxes.center_m.tobytes() == two.boxes.center_m.tobytes()
    assert one.start.tolist() != resolve(random_world(7, 10, robot_seed=1)).start.tolist()


def test_the_draw_is_the_one_of_the_first_release() -> None:
    """Seeds mean the same halls and errands for ever."""
    floor = resolve(random_world(1, 5))
    assert picture(floor) == PICTURE
    assert floor.start.tolist() == START
    assert floor.goal.tolist() == GOAL


PICTURE = [
    "#..#.....",
    ".......#.",
    ".....#...",
    ".#.....##",
    "#....#..#",
    "#....##.#",
    "...#...##",
    "...#.#...",
    "...#.....",
]
START = [39, 35, 8, 34, 2]
GOAL = [56, 16, 36, 40, 31]


def test_robots_keep_to_what_is_usable() -> None:
    """§1.8: with the coverage known, robots are drawn in the largest covered component."""
    world = make(robots={"random": {"count": 3}})
    floor = resolve(world)
    column = floor.vertex_cell[:, 0]
    vertex_ok = column != 2  # 2 columns on the left, 3 on the right
    edge_ok = np.ones(len(floor.edge_uv), np.bool_)
    right = with_robots(world, floor, vertex_ok)
    assert (column[[*right.start, *right.goal]] > 2).all()
    edge_ok[(column[floor.edge_uv] == (3, 4)).all(axis=1)] = False
    left = with_robots(world, floor, vertex_ok, edge_ok)  # the right falls into 1 and 2 columns
    assert left.edge_uv is floor.edge_uv
    sizes = np.bincount(components(floor, vertex_ok, edge_ok)[vertex_ok])
    assert sizes.tolist() == [8, 8, 4]
    assert (column[[*left.start, *left.goal]] < 2).all()  # of equals the one with vertex 0


def test_components_respect_one_way_edges() -> None:
    """§1.1: what one can only leave, or only enter, is a component of its own."""
    floor = resolve(make({"size_m": (5, 1)}))
    both = [np.ones(n, np.bool_) for n in (5, 4)]
    oneway = np.array([False, True, False, False])
    lane = replace(floor, edge_oneway=oneway)
    assert components(floor, *both).tolist() == [0] * 5
    assert components(lane, *both).tolist() == [1, 1, 0, 0, 0]


def test_too_many_random_robots_are_refused() -> None:
    """As many robots as positions can leave the last one nowhere to go; one less is fine."""
    assert len(resolve(make(robots={"random": {"count": 23}})).start) == 23
    faults = faults_of(make(robots={"random": {"count": 24}}))
    message = faults[("robots", "random", "count")]
    assert "24 robots" in message
    assert "but there are 24" in message
    world = make()
    floor = resolve(world)
    with pytest.raises(WorldError, match="but there are 0"):
        with_robots(world, floor, np.zeros(24, np.bool_))


# Listed robots


def test_places_resolve_to_the_same_vertex_however_given() -> None:
    """A station, a cell and metres within half a pitch name the same position."""
    station = [{"name": "here", "at_m": (2.9, 1.1)}, {"name": "there", "cell": (5, 3)}]
    robots = [
        errand("a", "here", {"at_m": (5.99, 3.01)}),
        errand("b", (0, 0), "there"),
        errand("c", {"at_m": (0.0, 4.0)}, (2, 1)),
    ]
    floor = resolve(make(robot=robots, station=station))
    grid = floor.vertex_grid()
    assert floor.robot_ids == ("a", "b", "c")
    assert floor.start.tolist() == [grid[1, 2], grid[0, 0], grid[3, 0]]
    assert floor.goal.tolist() == [grid[3, 5], grid[3, 5], grid[1, 2]]
    assert floor.start.dtype == floor.goal.dtype == np.int32


def test_all_faults_of_the_robots_at_once() -> None:
    """Blocked, outside, doubled and cut off: each is told, with the obstacle by its name."""
    obstacle = [
        {"name": "rack 7", "center_m": (1.5, 1.5), "size_m": (0.5, 0.5)},
        {"name": "wall", "center_m": (4, 2), "size_m": (0.1, 4)},
    ]
    faults = faults_of(
        make(
            {"body": {"length_m": 0.6, "width_m": 0.5}},
            obstacle=obstacle,
            robot=[
                errand("a", (0, 0), (1, 1)),
                errand("b", (0, 0), (6, 0)),
                errand("c", (2, 2), (5, 3)),
                errand("d", {"at_m": (9000, 1)}, (0, 0)),
            ],
        )
    )
    assert faults.keys() == {
        ("robot", 0, "goal"),
        ("robot", 1, "goal"),
        ("robot", 1, "start"),
        ("robot", 2, "goal"),
        ("robot", 3, "start"),
    }
    assert "'rack 7'" in faults[("robot", 0, "goal")]
    assert "outside the grid of 6 x 4" in faults[("robot", 1, "goal")]
    assert "robot 'a'" in faults[("robot", 1, "start")]
    assert "no free way leads from start [2, 2] to goal [5, 3]" in faults[("robot", 2, "goal")]
    assert "half a pitch" in faults[("robot", 3, "start")]


def test_equal_goals_are_for_robots_that_leave() -> None:
    """§1.5: goals must differ under `park` only; a robot may start at its own goal."""
    robots = [errand("a", (0, 0), (3, 3)), errand("b", (1, 0), (3, 3)), errand("c", (2, 2), (2, 2))]
    assert resolve(make(robot=robots, plan={"at_goal": "leave"})).goal.tolist() == [21, 21, 14]
    faults = faults_of(make(robot=robots, plan={"at_goal": "park"}))
    assert list(faults) == [("robot", 1, "goal")]


def test_a_listed_place_without_coverage_is_a_fault() -> None:
    """A robot cannot start or end where no AP serves it (§1.8)."""
    world = make(robot=[errand("a", (0, 0), (3, 3)), errand("b", (1, 0), (4, 3))])
    floor = resolve(world)
    vertex_ok = np.ones(24, np.bool_)
    vertex_ok[floor.vertex_grid()[3, 4]] = False
    with pytest.raises(WorldError) as caught:
        with_robots(world, floor, vertex_ok)
    assert [f.key for f in caught.value.faults] == [("robot", 1, "goal")]
    assert "coverage" in str(caught.value)
