"""The validator's own geometry of moving rectangles."""

from __future__ import annotations

import numpy as np
import pytest

from logs.validate_bodies import Motions, candidates, least_clearance

HALF_M = np.array([0.4, 0.3])


def motions(start, end, heading, **kind) -> Motions:
    """Motions of a few bodies, none of which enters a vertex or leaves unless told."""
    n = len(start)
    none = {
        "vertex": np.arange(n),
        "enters": np.full(n, -1),
        "leaves": np.zeros(n, np.bool_),
    }
    arrays = {name: np.asarray(value, float) for name, value in (("s", start), ("e", end))}
    return Motions(arrays["s"], arrays["e"], np.asarray(heading, float), **(none | kind))


def least(bodies: Motions) -> float:
    """The clearance of the first two."""
    pair = bodies.pairs(np.array([0]), np.array([1]))
    return float(least_clearance(pair, HALF_M)[0])


def test_known_clearances():
    """Following, passing, crossing corners and head-on motion have the clearances of a drawing."""
    assert least(motions([(0, 0), (2, 0)], [(2, 0), (4, 0)], [0, 0])) == pytest.approx(1.2)
    assert least(motions([(0, 0), (4, 1)], [(4, 0), (0, 1)], [0, np.pi])) == pytest.approx(0.4)
    # Around a corner: the one leaves it to the north while the other comes from the west. At half
    # time they are 1 m apart in x and in y, of which (0.8 + 0.6) / 2 are body.
    corner = motions([(0, 0), (-2, 0)], [(0, 2), (0, 0)], [np.pi / 2, 0])
    assert least(corner) == pytest.approx(0.3 * np.sqrt(2), abs=1e-9)
    assert least(motions([(0, 0), (2, 0)], [(2, 0), (0, 0)], [0, np.pi])) == pytest.approx(-0.6)


def test_clearance_equals_a_dense_search():
    """At no instant of 201 are any two bodies nearer than the least clearance, at one almost."""
    rng = np.random.default_rng(3)
    for _ in range(8):
        start = rng.uniform(0, 3, (2, 2))
        bodies = motions(start, start + rng.normal(0, 1.5, (2, 2)), rng.uniform(-4, 4, 2))
        still = []
        for t in np.linspace(0, 1, 201):
            place = (1 - t) * bodies.start_m + t * bodies.end_m
            still.append(_apart(place, bodies.heading_rad))
        assert least(bodies) == pytest.approx(min(still), abs=2e-2)
        assert least(bodies) <= min(still) + 1e-9


def _apart(place, heading) -> float:
    """Distance of the outlines of two rectangles by points on them, or minus their overlap."""
    share = np.linspace(-1, 1, 33)
    edge = np.concatenate(
        [
            np.column_stack([share, np.full(33, side)])
            if along
            else np.column_stack([np.full(33, side), share])
            for side in (-1.0, 1.0)
            for along in (True, False)
        ]
    )
    outline, axes = [], []
    for centre, angle in zip(place, heading, strict=True):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        outline.append(centre + edge * HALF_M @ turn.T)
        axes += [turn[:, 0], turn[:, 1]]
    gaps = []
    for axis in axes:
        a, b = (points @ axis for points in outline)
        gaps.append(max(a.min() - b.max(), b.min() - a.max()))
    if max(gaps) <= 0:
        return max(gaps)
    away = outline[0][:, None, :] - outline[1][None, :, :]
    return float(np.hypot(away[..., 0], away[..., 1]).min())


def test_candidates_hold_the_nearest_pair_and_all_overlaps():
    """Leaving out far pairs loses neither the least clearance nor a contact."""
    rng = np.random.default_rng(5)
    for _ in range(12):
        n = int(rng.integers(2, 20))
        start = rng.uniform(0, rng.uniform(2, 20), (n, 2))
        bodies = motions(start, start + rng.normal(0, 1, (n, 2)), rng.uniform(-4, 4, n))
        a, b = np.triu_indices(n, 1)
        every = least_clearance(bodies.pairs(a, b), HALF_M)
        few = least_clearance(bodies.pairs(*candidates(bodies, HALF_M)), HALF_M)
        assert few.min() == pytest.approx(every.min())
        assert (few < 0).sum() == (every < 0).sum()


def test_a_robot_that_leaves_does_not_count_against_the_one_that_follows():
    """In its last slot a robot makes room for the one that enters its goal (§1.4)."""
    start, end = [(0, 0), (2, 0), (9, 9)], [(2, 0), (2, 0), (9, 9)]
    kind = {"enters": np.array([1, -1, -1]), "leaves": np.array([False, True, False])}
    stays = motions(start, end, [0, 0, 0], enters=kind["enters"])
    goes = motions(start, end, [0, 0, 0], **kind)
    assert [p.tolist() for p in candidates(stays, HALF_M)] == [[0], [1]]
    assert (0, 1) not in set(zip(*(p.tolist() for p in candidates(goes, HALF_M)), strict=True))


def test_fewer_than_two_bodies_have_no_clearance():
    """Nobody, or one robot alone, gives no pair."""
    for n in (0, 1):
        empty = motions(np.zeros((n, 2)), np.zeros((n, 2)), np.zeros(n))
        assert [len(p) for p in candidates(empty, HALF_M)] == [0, 0]
        assert len(least_clearance(np.empty((0, 6)), HALF_M)) == 0
