"""Where robots on lanes would touch: planted cases, and a simulation of every pair as the judge."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.clearance import clearance_m
from worlds.lane_conflicts import Lanes, near_lanes, near_vertices, touching_followers
from worlds.world import Body

BODY = Body(length_m=1.0, width_m=0.6)


def lanes(
    xy: list[tuple[float, float]], uv: list[tuple[int, int]], slots: int = 1, both: bool = False
) -> Lanes:
    """Lanes that all take as long."""
    return Lanes(
        np.array(xy, dtype=float),
        np.array(uv, dtype=np.int32).reshape(-1, 2),
        np.full(len(uv), not both),
        np.full(len(uv), slots, dtype=np.int32),
    )


@pytest.mark.parametrize(
    ("gap", "touch"), [(0.99, True), (1.0, False), (1.2, False)], ids=["near", "touching", "apart"]
)
def test_nodes_in_a_row_need_a_length(gap: float, touch: bool) -> None:
    """Two robots standing one behind the other on a lane."""
    found = near_vertices(lanes([(0, 0), (gap, 0), (5, 0)], [(0, 1), (1, 2)]), BODY)
    assert found == ([(0, 1)] if touch else [])


def test_nodes_beside_each_other_need_a_width() -> None:
    """Parallel lanes 0.7 m apart: bodies of 0.6 m width pass."""
    xy = [(0.0, 0.0), (5.0, 0.0), (0.0, 0.7), (5.0, 0.7)]
    assert near_vertices(lanes(xy, [(0, 1), (2, 3)]), BODY) == []
    assert near_lanes(lanes(xy, [(0, 1), (2, 3)]), BODY) == []
    xy = [(x, y * 0.59 / 0.7) for x, y in xy]
    assert near_vertices(lanes(xy, [(0, 1), (2, 3)]), BODY) == [(0, 2), (1, 3)]
    assert near_lanes(lanes(xy, [(0, 1), (2, 3)]), BODY) == [(0, 1)]


def test_lanes_that_cross_without_a_node_are_found() -> None:
    """A cross of two lanes; lanes that share a node are not meant."""
    cross = [(0.0, 3.0), (6.0, 3.0), (3.0, 0.0), (3.0, 6.0)]
    assert near_lanes(lanes(cross, [(0, 1), (2, 3)]), BODY) == [(0, 1)]
    assert near_lanes(lanes(cross, [(0, 1), (1, 3)]), BODY) == []


@pytest.mark.parametrize(("slots", "touch"), [(2, False), (3, True), (4, True)])
def test_robots_turning_off_must_be_out_of_the_way(slots: int, touch: bool) -> None:
    """Right-angled lanes of 4 m: length + width = 1.6 m must be covered in a slot (2 m, 1.33 m)."""
    corner = lanes([(0, 0), (4, 0), (4, 4)], [(0, 1), (1, 2)], slots)
    found = touching_followers(corner, BODY)
    assert bool(found) is touch
    assert {f.vertex for f in found} == ({1} if touch else set())


def test_followers_on_a_straight_lane_need_a_length_a_slot() -> None:
    """1 m a slot is enough for bodies of 1 m, 0.9 m is not."""
    for step, touch in ((1.0, False), (0.9, True)):
        row = lanes([(0, 0), (4 * step, 0), (8 * step, 0)], [(0, 1), (1, 2)], 4)
        assert bool(touching_followers(row, BODY)) is touch


def test_a_robot_turning_round_meets_nobody() -> None:
    """Into a spur and back on the same lane: only one robot is on it (§1.3)."""
    spur = lanes([(0, 0), (3, 0)], [(0, 1)], 5, both=True)
    assert touching_followers(spur, BODY) == []


@settings(max_examples=40, deadline=None)
@given(
    st.floats(15, 345), st.integers(1, 4), st.integers(1, 4), st.floats(1.5, 6), st.floats(1.5, 6)
)
def test_followers_agree_with_the_exact_clearance(
    turn: float, k_in: int, k_out: int, in_m: float, out_m: float
) -> None:
    """By the twin's exact clearance, to the tenth of a millimetre."""
    angle = np.radians(turn)
    xy = np.array([[-in_m, 0.0], [0.0, 0.0], [out_m * np.cos(angle), out_m * np.sin(angle)]])
    two = Lanes(xy, np.array([(0, 1), (1, 2)], np.int32), np.ones(2, bool),
                np.array([k_in, k_out], np.int32))  # fmt: skip
    half = np.array([BODY.length_m / 2, BODY.width_m / 2])
    come, go = -xy[0] / k_in, xy[2] / k_out
    exact = clearance_m(
        (-come)[None], (come - go)[None], half, np.array([0.0]), half, np.array([angle])
    )[0]
    if abs(exact) > 1e-4:
        assert bool(touching_followers(two, BODY)) is bool(exact < 0)
