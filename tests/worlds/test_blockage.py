"""Knife-edge blockage against the formulas of TR 38.901, clause 7.6.4.2, and plain optics."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.oracles import slab
from tests.worlds.floors import boxes, random_boxes
from worlds.blockage import LIGHT_M_S, NEAR_WAVELENGTHS, knife_edge_db, near_pairs, pair_loss_db
from worlds.floor import Boxes

GHZ = 60.0
WAVE_M = LIGHT_M_S / (GHZ * 1e9)


def one(standing: Boxes, start: tuple[float, ...], end: tuple[float, ...]) -> float:
    """What a single path loses [dB]."""
    return float(knife_edge_db(standing, np.array([start]), np.array([end]), GHZ)[0])


def report(d1: float, d2: float, sides: dict[str, float], ghz: float = GHZ) -> float:
    """7.6-30 by hand: a screen d1 from one end of a level path and d2 from the other.

    `sides`: how far each edge (h1, h2, w1, w2) lies beyond the path; negative if it is cleared.
    """
    wave = 299_792_458.0 / (ghz * 1e9)
    f = {}
    for name, beyond in sides.items():
        detour = math.sqrt(d1**2 + beyond**2) + math.sqrt(d2**2 + beyond**2) - (d1 + d2)
        sign = 1 if beyond >= 0 else -1
        f[name] = math.atan(sign * math.pi / 2 * math.sqrt(math.pi / wave * detour)) / math.pi
    return -20 * math.log10(1 - (f["h1"] + f["h2"]) * (f["w1"] + f["w2"]))


@pytest.mark.parametrize(
    ("side", "top", "base"),
    [(0.0, 2.0, 0.0), (0.2, 2.0, 0.0), (0.5, 1.7, 0.0), (-0.35, 1.2, 0.0), (0.0, 1.3, 0.9)],
)
def test_a_thin_box_is_the_reports_screen(side: float, top: float, base: float) -> None:
    """A thin box across a level path, off its middle by `side`: L of the report, to 0.01 dB."""
    middle = (base + top) / 2
    screen = boxes([(4.0, side, middle)], (1e-7, 0.4, (top - base) / 2))
    found = one(screen, (0.0, 0.0, 1.0), (10.0, 0.0, 1.0))
    sides = {"h1": top - 1.0, "h2": 1.0 - base, "w1": 0.4 + side, "w2": 0.4 - side}
    assert found == pytest.approx(report(4.0, 6.0, sides), abs=0.01)


def test_a_worked_number() -> None:
    """A person (0.3 m wide, 1.7 m high) in the middle of a level path of 10 m at 1 m: 11.56 dB.

    Detours 97.52 and 198.04 mm over and under, 4.497 mm to each side; F = 0.4742, 0.4819, 0.3848.
    """
    person = boxes([(5.0, 0.0, 0.85)], (1e-7, 0.15, 0.85))
    by_hand = -20 * math.log10(1 - (0.4742 + 0.4819) * (2 * 0.3848))
    assert by_hand == pytest.approx(11.56, abs=0.01)
    assert one(person, (0, 0, 1), (10, 0, 1)) == pytest.approx(by_hand, abs=0.01)


def test_at_the_very_edge_six_decibels_are_lost() -> None:
    """The classic figure: half the field, 6.02 dB, at the edge of a screen wide and deep."""
    wall = boxes([(5.0, 0.0, -999.0)], (1e-7, 1000.0, 1000.0))  # its top at 1 m
    assert one(wall, (0, 0, 1.0), (10, 0, 1.0)) == pytest.approx(6.02, abs=0.05)
    assert one(wall, (0, 0, 1.05), (10, 0, 1.05)) < 3.0
    assert one(wall, (0, 0, 0.5), (10, 0, 0.5)) > 20.0


def test_losses_add_up() -> None:
    """Two boxes cost what each costs alone, together."""
    a, b = ([(3.0, 0.1, 1.0)], [(7.0, -0.2, 1.0)])
    path = ((0.0, 0.0, 1.0), (10.0, 0.0, 1.0))
    alone = [one(boxes(at, (0.1, 0.3, 1.0)), *path) for at in (a, b)]
    assert one(boxes(a + b, (0.1, 0.3, 1.0)), *path) == pytest.approx(sum(alone))
    assert min(alone) > 5.0


def test_what_is_behind_an_end_or_far_aside_costs_nothing() -> None:
    """Boxes behind the robot, behind the AP, far below or far beside the path."""
    for at in ((12.0, 0.0, 1.0), (-2.0, 0.0, 1.0), (5.0, 4.0, 1.0), (5.0, 0.0, -3.0)):
        assert one(boxes([at]), (0, 0, 1.0), (10, 0, 1.0)) == 0.0, at


def test_a_long_rack_behind_the_robot_is_not_in_the_way() -> None:
    """A path that ends before the face of a long rack loses at most the 6 dB of an edge."""
    rack = boxes([(5.0, 3.0, 1.0)], (20.0, 0.5, 1.0))
    assert one(rack, (-10.0, -4.0, 5.0), (5.0, 2.3, 0.5)) == 0.0
    assert one(rack, (-10.0, 8.0, 5.0), (5.0, 2.3, 0.5)) > 10.0


def test_straight_down_works() -> None:
    """An AP right above the robot, free or through a box that hangs between them."""
    hanging = boxes([(0.0, 0.0, 3.0)], (2.0, 2.0, 0.2))
    assert one(hanging, (0, 0, 5.0), (0, 0, 0.5)) > 10.0
    assert one(hanging, (9, 9, 5.0), (9, 9, 0.5)) == 0.0


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_blocked_is_what_rays_call_blocked(seed: int) -> None:
    """A box costs more than an edge's 6 dB only if an exact ray meets it; exchange changes nothing.

    And the culling before the formula loses nothing.
    """
    rng = np.random.default_rng(seed)
    standing = random_boxes(rng, 25, 20.0)
    n = 60
    start = np.column_stack((rng.uniform(0, 20, (n, 2)), rng.uniform(2.5, 6.0, n)))
    end = np.column_stack((rng.uniform(0, 20, (n, 2)), rng.uniform(0.2, 1.0, n)))
    entries = slab.entries(standing.center_m, standing.half_m, standing.yaw_rad, start, end)
    inside = ~np.isfinite(
        slab.entries(standing.center_m, standing.half_m, standing.yaw_rad, end, end + 1e-6)
    ).any(axis=1)
    path, box = np.meshgrid(np.arange(n), np.arange(25), indexing="ij")
    p, b = path.ravel(), box.ravel()
    chosen = Boxes(("",) * len(b), standing.center_m[b], standing.half_m[b], standing.yaw_rad[b])
    every = pair_loss_db(chosen, start[p], end[p], GHZ).reshape(n, 25)
    assert (every >= 0.0).all()
    met = np.isfinite(entries)
    assert (every[inside][~met[inside]] <= 6.03).all()
    assert (every[inside][met[inside]] > 0.5).all()
    total = knife_edge_db(standing, start, end, GHZ)
    np.testing.assert_allclose(total, every.sum(axis=1), atol=1e-9)
    np.testing.assert_allclose(knife_edge_db(standing, end, start, GHZ), total, atol=1e-6)
    near = set(zip(*(k.tolist() for k in near_pairs(standing, start, end, GHZ)), strict=True))
    assert {(i, j) for i, j in np.argwhere(every > 0).tolist()} <= near


def test_what_is_left_out_is_small() -> None:
    """At the detour where boxes cease to count a wall still costs less than 0.3 dB."""
    limit = NEAR_WAVELENGTHS * WAVE_M
    clear = math.sqrt((10 + limit) ** 2 - 100) / 2  # in the middle of a path of 10 m
    for off, counts in ((clear * 0.999, True), (clear * 1.001, False)):
        wall = boxes([(5.0, 100.0 + off, 0.0)], (1e-7, 100.0, 100.0))
        lost = one(wall, (0, 0, 1.0), (10, 0, 1.0))
        assert (lost > 0.0) == counts
        assert lost < 0.3


def test_no_boxes_no_paths() -> None:
    """Nothing in the hall costs nothing, and no path gives no loss."""
    assert one(boxes(), (0, 0, 1), (9, 0, 1)) == 0.0
    assert knife_edge_db(boxes([(1, 1, 1)]), np.empty((0, 3)), np.empty((0, 3)), GHZ).shape == (0,)


@given(st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_a_fan_of_paths_finds_the_same_boxes(seed: int) -> None:
    """Many paths from one place, sorted by direction, meet what each meets alone; so with two."""
    rng = np.random.default_rng(seed)
    standing = random_boxes(rng, 40, 20.0)
    n = 150
    end = np.column_stack((rng.uniform(0, 20, (n, 2)), rng.uniform(0.2, 1.0, n)))
    places = np.column_stack((rng.uniform(0, 20, (2, 2)), rng.uniform(2.5, 6.0, 2)))
    end[0, :2] = places[0, :2]  # straight down
    end[1] = (20.0, places[0, 1], 0.5)  # along the axes, where angles jump
    end[2] = (0.0, places[0, 1], 0.5)
    start = places[rng.integers(0, 2, n)]
    start[:3] = places[0]
    path, box = near_pairs(standing, start, end, GHZ)
    alone = [near_pairs(standing, start[k : k + 1], end[k : k + 1], GHZ)[1] for k in range(n)]
    np.testing.assert_array_equal(path, np.repeat(np.arange(n), [len(a) for a in alone]))
    np.testing.assert_array_equal(box, np.concatenate(alone))
