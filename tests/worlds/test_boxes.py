"""Geometry of boxes against literal, slow checks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from worlds import boxes as module
from worlds.boxes import contains, footprint_hits, swept
from worlds.floor import Boxes

Rect = tuple[float, float, float, float, float]  # x, y, half x, half y, yaw

coordinate = st.floats(-4, 4)
extent = st.floats(0.05, 3)
turn = st.floats(-7, 7)
rect = st.tuples(coordinate, coordinate, extent, extent, turn)


def make_boxes(*rects: Rect, z: float = 1.0, half_z: float = 1.0) -> Boxes:
    """Boxes 2 m high over these rectangles."""
    a = np.array(rects, dtype=np.float64).reshape(-1, 5)
    column = np.ones(len(a))
    return Boxes(
        tuple(f"b{i}" for i in range(len(a))),
        np.column_stack((a[:, :2], z * column)),
        np.column_stack((a[:, 2:4], half_z * column)),
        a[:, 4].copy(),
    )


def sampled(r: Rect, n: int = 61) -> NDArray[np.float64]:
    """(n², 2), points spread evenly over a rectangle, its sides included."""
    x, y, hx, hy, yaw = r
    u, v = np.meshgrid(np.linspace(-hx, hx, n), np.linspace(-hy, hy, n))
    cos, sin = math.cos(yaw), math.sin(yaw)
    return np.column_stack(((x + cos * u - sin * v).ravel(), (y + sin * u + cos * v).ravel()))


def distance_to(r: Rect, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of points to a filled rectangle, 0 within."""
    x, y, hx, hy, yaw = r
    cos, sin = math.cos(yaw), math.sin(yaw)
    away = points - (x, y)
    u = np.maximum(np.abs(away @ (cos, sin)) - hx, 0)
    v = np.maximum(np.abs(away @ (-sin, cos)) - hy, 0)
    return np.hypot(u, v)


def check_against_samples(box: Rect, body: Rect, hit: int) -> None:
    """A hit exactly where sample points of the body say so; between two samples is undecided."""
    nearest = distance_to(box, sampled(body)).min()
    spacing = math.hypot(body[2], body[3]) / 60
    if nearest == 0:
        assert hit == 0
    elif nearest > spacing * 1.01:
        assert hit == -1


@settings(max_examples=200, deadline=None)
@given(rect, rect)
def test_a_body_hits_a_box_where_its_points_lie_in_it(box: Rect, body: Rect) -> None:
    """The separating axes agree with dense sampling of the body, however both are turned."""
    x, y, hx, hy, yaw = body
    hit = footprint_hits(make_boxes(box), [(x, y)], (hx, hy), yaw)
    check_against_samples(box, body, int(hit[0]))


@settings(max_examples=100, deadline=None)
@given(rect, rect)
def test_hitting_is_mutual(a: Rect, b: Rect) -> None:
    """If a body hits a box, the box as a body hits the body as a box."""
    there = footprint_hits(make_boxes(a), [b[:2]], b[2:4], b[4])
    back = footprint_hits(make_boxes(b), [a[:2]], a[2:4], a[4])
    assert there == back


@settings(max_examples=50, deadline=None)
@given(rect, st.tuples(coordinate, coordinate), st.tuples(coordinate, coordinate))
def test_a_strip_is_hit_where_the_body_passes(
    box: Rect, start: tuple[float, float], end: tuple[float, float]
) -> None:
    """The swept strip holds the body's place at every moment of the drive, and nothing beside."""
    center, half, yaw = swept([start], [end], 0.8, 0.6)
    hit = int(footprint_hits(make_boxes(box), center, half, yaw)[0])
    heading = math.atan2(end[1] - start[1], end[0] - start[0])
    body = sampled((0, 0, 0.4, 0.3, heading), 15)
    way = np.linspace(start, end, 201)
    points = (way[:, None] + body).reshape(-1, 2)
    nearest = distance_to(box, points).min()
    if nearest == 0:
        assert hit == 0
    elif nearest > 0.1:  # samples are at most 0.06 m apart
        assert hit == -1


@settings(max_examples=100, deadline=None)
@given(
    rect,
    st.lists(st.tuples(coordinate, coordinate, st.floats(-1, 4)), min_size=1, max_size=20),
    st.floats(0, 0.5),
)
def test_contains_agrees_with_the_distance_to_the_grown_box(
    box: Rect, points: list[tuple[float, float, float]], grow: float
) -> None:
    """A point is in a box iff it is in its grown footprint and between its grown floor and lid."""
    found = contains(make_boxes(box), points, grow)
    grown = (*box[:2], box[2] + grow, box[3] + grow, box[4])
    for point, index in zip(points, found, strict=True):
        apart = distance_to(grown, np.array([point[:2]]))[0]
        over = max(-grow - point[2], point[2] - 2 - grow, 0.0)
        if max(apart, over) == 0:
            assert index == 0
        elif max(apart, over) > 1e-6:
            assert index == -1


@pytest.mark.parametrize("gap_m", [-1e-6, 0.0, 1e-12])
def test_touching_is_hitting(gap_m: float) -> None:
    """A body of 1 m between two boxes 1 m apart is blocked, rounding or not."""
    pair = make_boxes((-1 - gap_m, 0, 0.5, 1, 0), (1 + gap_m, 0, 0.5, 1, math.pi))
    assert footprint_hits(pair, [(0, 0)], (0.5, 0.4)) == [0]
    assert contains(pair, [(-0.5, 0, 1), (0.5, 1, 2)], grow_m=0.0).tolist() == [0, 1]


def test_a_micrometre_of_clearance_is_free() -> None:
    """What does not touch is free, even if by a thousandth of a millimetre."""
    box = make_boxes((1 + 1e-6, 0, 0.5, 1, 0))
    assert footprint_hits(box, [(0, 0)], (0.5, 0.4)) == [-1]
    assert contains(box, [(0.5, 0, 1)]) == [-1]


def test_the_lowest_box_is_named() -> None:
    """Of several boxes at a place the first of the list is reported."""
    pile = make_boxes((9, 9, 1, 1, 0), (0, 0, 1, 1, 0.3), (0.1, 0, 1, 1, 0))
    assert footprint_hits(pile, [(0, 0), (5, 5)], (0.1, 0.1)).tolist() == [1, -1]
    assert contains(pile, [(0, 0, 0.5), (9, 9, 2.5)]).tolist() == [1, -1]


def test_a_body_drives_under_what_is_higher() -> None:
    """A box whose underside is above the body does not block; at its height it does."""
    bridge = make_boxes((0, 0, 1, 1, 0), z=1.5, half_z=0.5)  # from 1.0 m to 2.0 m
    at = [(0, 0)]
    assert footprint_hits(bridge, at, (0.4, 0.4), body_height_m=0.99) == [-1]
    assert footprint_hits(bridge, at, (0.4, 0.4), body_height_m=1.0) == [0]
    assert footprint_hits(bridge, at, (0.4, 0.4)) == [0]


def test_nothing_hits_nothing() -> None:
    """No boxes, or no places, are no reason to fail."""
    none = make_boxes()
    assert footprint_hits(none, [(0, 0)], (1, 1)).tolist() == [-1]
    assert contains(none, [(0, 0, 0)]).tolist() == [-1]
    assert footprint_hits(make_boxes((0, 0, 1, 1, 0)), np.empty((0, 2)), (1, 1)).size == 0
    assert contains(make_boxes((0, 0, 1, 1, 0)), []).size == 0


@pytest.mark.parametrize("layout", ["scattered", "one column", "one row"])
def test_many_boxes_and_places_as_one_by_one(monkeypatch: pytest.MonkeyPatch, layout: str) -> None:
    """Sorting into strips and working in portions gives what each pair alone gives."""
    rng = np.random.default_rng(5)
    rects = [
        (*rng.uniform(-1, 11, 2), *rng.uniform(0.05, 4 if i % 5 == 0 else 1, 2), rng.uniform(-4, 4))
        for i in range(25)
    ]
    line = np.arange(40) / 4
    xy = {
        "scattered": rng.uniform(-2, 12, (60, 2)),
        "one column": np.column_stack((np.full(40, 4.0), line)),
        "one row": np.column_stack((line, np.full(40, 7.0))),
    }[layout]
    half = rng.uniform(0.05, 0.3, (len(xy), 2))
    yaw = rng.uniform(-4, 4, len(xy))
    points = np.column_stack((xy, np.full(len(xy), 0.5)))
    hit, inside = np.full(len(xy), -1), np.full(len(xy), -1)
    for k in reversed(range(25)):
        single = make_boxes(rects[k])
        for p in range(len(xy)):
            if footprint_hits(single, xy[p], half[p], yaw[p])[0] == 0:
                hit[p] = k
            if contains(single, points[p])[0] == 0:
                inside[p] = k
    assert len(set(hit)) > 3
    assert len(set(inside)) > 1

    many = make_boxes(*rects)
    for at_once in (1, 7, 1_000_000):
        monkeypatch.setattr(module, "_PAIRS_AT_ONCE", at_once)
        assert footprint_hits(many, xy, half, yaw).tolist() == hit.tolist()
        assert contains(many, points).tolist() == inside.tolist()
