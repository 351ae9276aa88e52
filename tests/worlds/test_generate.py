"""From world to floor: what is free and what is misplaced."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.worlds.small_hall import AP, faults_of, make, picture
from worlds.errands import components
from worlds.errors import WorldError
from worlds.generate import boxes_of, resolve
from worlds.places import positions_m

# The grid


@pytest.mark.parametrize(
    ("hall", "columns", "rows", "pitch", "first", "slot"),
    [
        ({"size_m": (60, 60), "positions": (20, 20), "margin_m": 0}, 20, 20, 60 / 19, 0, 60 / 19),
        ({"size_m": (8, 5), "positions": (8, 5)}, 8, 5, 1, 0.5, 1),
        ({"size_m": (16, 10), "pitch_m": 2, "speed_m_s": 0.5}, 8, 5, 2, 1, 4),
        ({"size_m": (16, 10.9), "pitch_m": 2, "slot_s": 1.5}, 8, 5, 2, 1, 1.5),
        ({"size_m": (16, 10), "pitch_m": 2, "margin_m": 0}, 9, 6, 2, 0, 2),
        ({"size_m": (60, 0.3), "pitch_m": 0.1}, 600, 3, 0.1, 0.05, 0.1),
        ({"size_m": (10, 4), "positions": (4, 1), "margin_m": 2}, 4, 1, 2, 2, 2),
    ],
)
def test_the_grid_is_laid_out_as_the_hall_says(
    hall: dict[str, Any], columns: int, rows: int, pitch: float, first: float, slot: float
) -> None:
    """Columns, rows, pitch, first position and slot length follow from either way to give them."""
    body = {"length_m": 0.05, "width_m": 0.05}
    hall = {"pitch_m": None, **hall, "body": body}
    floor = resolve(make(hall))
    assert (floor.columns, floor.rows) == (columns, rows)
    assert floor.pitch_m == pytest.approx(pitch)
    assert floor.slot_s == pytest.approx(slot)
    cells = [(c, r) for r in range(rows) for c in range(columns)]
    assert floor.vertex_cell.tolist() == [list(cell) for cell in cells]
    wanted = [(first + c * pitch, first + r * pitch) for c, r in cells]
    np.testing.assert_allclose(floor.vertex_xy_m, wanted, atol=1e-9)
    assert (floor.vertex_xy_m <= np.array(hall["size_m"]) + 1e-9).all()


def test_an_empty_floor_has_all_edges_once_in_order() -> None:
    """Neighbours are joined by one edge, u < v, sorted, of one slot, both ways (§1.1)."""
    floor = resolve(make())
    wanted = sorted(
        [(r * 6 + c, r * 6 + c + 1) for r in range(4) for c in range(5)]
        + [(r * 6 + c, r * 6 + c + 6) for r in range(3) for c in range(6)]
    )
    assert [tuple(e) for e in floor.edge_uv.tolist()] == wanted
    assert floor.edge_slots.tolist() == [1] * len(wanted)
    assert not floor.edge_oneway.any()
    for array in (floor.vertex_xy_m, floor.vertex_cell, floor.edge_uv, floor.start, floor.goal):
        assert not array.flags.writeable


# What is free


def test_obstacles_take_the_positions_a_robot_would_touch_them_at() -> None:
    """A turned box blocks where the body's square meets it, no further."""
    turned = {"center_m": (3, 2), "size_m": (1.2, 1.2), "yaw_deg": 45}  # corners 0.85 m off
    floor = resolve(make(obstacle=[turned]))
    assert picture(floor) == ["......", "..##..", "..##..", "......"]
    slim = resolve(make({"body": {"length_m": 0.02, "width_m": 0.02}}, obstacle=[turned]))
    assert picture(slim) == ["......"] * 4


def test_a_narrow_gap_stops_a_wide_robot_only() -> None:
    """Between two posts beside an edge a body passes if it is narrower than the gap."""
    posts = [{"center_m": (3, y), "size_m": (0.1, 0.1)} for y in (1.8, 1.2)]  # gap 0.5 m
    for width, passes in ((0.52, False), (0.48, True)):
        body = {"length_m": 0.6, "width_m": width}
        floor = resolve(make({"body": body}, obstacle=posts))
        assert picture(floor) == ["......"] * 4  # everybody can stand on both sides
        u, v = floor.vertex_grid()[1, 2:4].tolist()
        assert ((u, v) in set(map(tuple, floor.edge_uv.tolist()))) is passes


def test_a_thin_wall_cuts_the_edges_it_crosses() -> None:
    """A wall between two columns blocks no position of a small robot, but every crossing."""
    wall = {"center_m": (3, 2), "size_m": (0.02, 3.9)}
    body = {"length_m": 0.3, "width_m": 0.3}
    floor = resolve(make({"body": body}, obstacle=[wall]))
    assert len(floor.vertex_xy_m) == 24
    assert len(floor.edge_uv) == 38 - 4
    component = components(floor, np.ones(24, np.bool_), np.ones(34, np.bool_))
    assert component[floor.vertex_cell[:, 0] < 3].tolist() == [0] * 12
    assert component[floor.vertex_cell[:, 0] >= 3].tolist() == [1] * 12


@pytest.mark.parametrize(
    ("antenna", "base", "free"), [(0.5, 0.6, True), (0.5, 0.45, False), (0.2, 0.45, True)]
)
def test_robots_drive_under_what_clears_body_and_antenna(
    antenna: float, base: float, free: bool
) -> None:
    """An obstacle blocks the floor iff its underside is not above body and antenna."""
    bridge = {"center_m": (2.5, 1.5), "size_m": (0.5, 0.5), "base_m": base}
    floor = resolve(make({"body": {"antenna_m": antenna}}, obstacle=[bridge]))
    assert (len(floor.vertex_xy_m) == 24) is free


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.floats(0.1, 0.9), st.floats(0.1, 0.7))
def test_vertices_and_edges_against_sampled_bodies(seed: int, length: float, width: float) -> None:
    """No point of a robot that stands at a vertex or drives along an edge is in an obstacle."""
    rng = np.random.default_rng(seed)
    boxes = [
        {
            "center_m": tuple(rng.uniform(0, 5, 2)),
            "size_m": tuple(rng.uniform(0.05, 1.2, 2)),
            "yaw_deg": rng.uniform(-90, 90),
        }
        for _ in range(5)
    ]
    hall = {"size_m": (5, 5), "body": {"length_m": length, "width_m": width}}
    try:
        floor = resolve(make(hall, obstacle=boxes))
    except WorldError:
        assume(False)

    def covered(points: np.ndarray) -> bool:
        for box in boxes:
            away = points - box["center_m"]
            a = math.radians(box["yaw_deg"])
            u = np.abs(away @ (math.cos(a), math.sin(a))) <= box["size_m"][0] / 2
            v = np.abs(away @ (-math.sin(a), math.cos(a))) <= box["size_m"][1] / 2
            if (u & v).any():
                return True
        return False

    def cloud(x: float, y: float) -> np.ndarray:
        gx, gy = np.meshgrid(np.linspace(-x, x, 15), np.linspace(-y, y, 15))
        return np.column_stack((gx.ravel(), gy.ravel()))

    for xy in floor.vertex_xy_m:
        assert not covered(xy + cloud(length / 2, width / 2))
        assert not covered(xy + cloud(width / 2, length / 2))
    for u, v in floor.edge_uv:
        a, b = floor.vertex_xy_m[[u, v]]
        along_x = abs(b[0] - a[0]) > 0.5
        body = cloud(length / 2, width / 2) if along_x else cloud(width / 2, length / 2)
        assert not covered((np.linspace(a, b, 15)[:, None] + body).reshape(-1, 2))


# Random obstacles


@pytest.mark.parametrize("share", [0.0, 0.05, 0.0513, 0.3, 0.99])
@pytest.mark.parametrize("seed", [0, 1, 2**40])
def test_exactly_the_share_carries_a_box(share: float, seed: int) -> None:
    """round(share * positions) different positions carry a box, centred on them."""
    random = {"share": share, "side_m": 0.4, "height_m": 1.5, "seed": seed}
    world = make({"size_m": (20, 20)}, obstacles={"random": random})
    boxes = boxes_of(world)
    assert len(boxes) == round(share * 400)
    spots = set(map(tuple, boxes.center_m[:, :2].tolist()))
    assert len(spots) == len(boxes)
    assert spots <= set(map(tuple, positions_m(world.hall).tolist()))
    assert (boxes.half_m == (0.2, 0.2, 0.75)).all()
    assert (boxes.center_m[:, 2] == 0.75).all()


def test_drawn_boxes_depend_on_their_seed_alone() -> None:
    """Robots and listed obstacles do not move drawn boxes; a larger share keeps the boxes."""

    def spots(share: float = 0.2, seed: int = 3, **parts: Any) -> list[tuple[float, ...]]:
        world = make(
            {"size_m": (9, 9)}, obstacles={"random": {"share": share, "seed": seed}}, **parts
        )
        boxes = boxes_of(world)
        return [
            tuple(c) for n, c in zip(boxes.name, boxes.center_m.tolist(), strict=True) if "box" in n
        ]

    assert spots() == spots(robots={"random": {"count": 4, "seed": 9}})
    assert spots() == spots(obstacle=[{"center_m": (1, 1), "size_m": (1, 1)}])
    assert set(spots()) < set(spots(share=0.4))
    assert spots() != spots(seed=4)


# What is misplaced


def test_all_faults_of_the_hall_at_once() -> None:
    """Body, obstacles, stations and APs are all looked at before anything is refused."""
    faults = faults_of(
        make(
            {"body": {"length_m": 1.0, "width_m": 0.71}},
            obstacle=[
                {"name": "far", "center_m": (7.1, 2), "size_m": (2, 2), "yaw_deg": 45},
                {"name": "off", "center_m": (3000, 2000), "size_m": (1, 1)},
                {"name": "near", "center_m": (6.4, 2), "size_m": (1, 1)},
                {"name": "post", "center_m": (0.1, 3.9), "size_m": (0.3, 0.3), "height_m": 3},
            ],
            station=[{"name": "s", "cell": (6, 0)}, {"name": "t", "at_m": (-0.1, 1)}],
            ap=[
                {"id": "in", "position_m": (0.1, 3.9, 3.0)},
                {"id": "on", "position_m": (0.1, 3.9, 3.01)},
                {"id": "out", "position_m": (1, 4.5, 3)},
                {"id": "mm", "position_m": (5000, 2000, 3)},
            ],
            robot=[],
        )
    )
    assert faults.keys() == {
        ("hall", "body", "length_m"),
        ("hall", "body", "width_m"),
        ("obstacle", 1, "center_m"),
        ("station", 0, "cell"),
        ("station", 1, "at_m"),
        ("ap", 0, "position_m"),
        ("ap", 2, "position_m"),
        ("ap", 3, "position_m"),
        (),
    }
    assert "0.707 m" in faults[("hall", "body", "width_m")]
    assert "millimetres? then write [3.0, 2.0]" in faults[("obstacle", 1, "center_m")]
    assert "inside 'post'" in faults[("ap", 0, "position_m")]
    assert "millimetres? then write [5.0, 2.0]" in faults[("ap", 3, "position_m")]
    assert "no robot" in faults[()]


def test_an_obstacle_wholly_beyond_a_corner_is_outside() -> None:
    """The turned footprint counts, not the box around it."""
    beyond = {"center_m": (6.9, 4.9), "size_m": (1.4, 1.4), "yaw_deg": 45}  # corners 0.99 m off
    assert list(faults_of(make(obstacle=[beyond]))) == [("obstacle", 0, "center_m")]
    assert resolve(make(obstacle=[{**beyond, "yaw_deg": 0.0, "size_m": (1.9, 1.9)}]))


def test_an_ap_in_the_clearance_of_an_obstacle_is_inside_it() -> None:
    """Rays see obstacles grown by `clearance_m`; a ray from within one would see nothing."""
    box = {"name": "pillar", "center_m": (0, 0), "size_m": (1, 1), "height_m": 8.9}
    assert resolve(make(obstacle=[box]))
    faults = faults_of(make(obstacle=[box], radio={"clearance_m": 0.1}))
    assert "inside 'pillar'" in faults[("ap", 0, "position_m")]


@pytest.mark.parametrize(
    ("parts", "key", "text"),
    [
        ({"ap": []}, ("ap",), "no access point"),
        ({"ap": [{**AP, "enabled": False}]}, ("ap",), "switched off"),
        ({"robot": []}, (), "no robot"),
        ({"obstacle": [{"center_m": (3, 2), "size_m": (6, 4)}]}, ("hall",), "none of the 6 x 4"),
    ],
)
def test_a_world_that_lacks_something_is_refused(
    parts: dict[str, Any], key: tuple[str, ...], text: str
) -> None:
    """No AP, no robot, no floor: one fault that says so."""
    faults = faults_of(make(**parts))
    assert list(faults) == [key]
    assert text in faults[key]


def test_a_large_hall_resolves_well_under_a_second() -> None:
    """100 m x 60 m at 1 m with 2000 turned boxes takes 0.1 s; the limit stops a relapse."""
    rng = np.random.default_rng(0)
    boxes = [
        {
            "center_m": (rng.uniform(0, 100), rng.uniform(0, 60)),
            "size_m": (rng.uniform(0.2, 0.6), rng.uniform(0.2, 0.6)),
            "yaw_deg": rng.uniform(0, 90),
        }
        for _ in range(2000)
    ]
    body = {"length_m": 0.4, "width_m": 0.3}
    world = make(
        {"size_m": (100, 60), "body": body},
        obstacle=boxes,
        robots={"random": {"count": 100}},
        ap=[{"id": "a", "position_m": (1, 1, 5)}],
    )
    resolve(make())  # imports
    began = time.process_time()
    floor = resolve(world)
    assert time.process_time() - began < 1.0
    assert 4000 < len(floor.vertex_xy_m) < 5900
