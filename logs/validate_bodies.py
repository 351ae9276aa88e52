"""Step 3 of validation, the bodies: how near two turned rectangles come while they move.

Written for the validator alone, and by other means than the twin's: the clearance of two bodies in
straight motion is a convex function of time, so its minimum is found by golden-section search
(J. Kiefer, Sequential minimax search for a maximum, 1953, doi:10.1090/S0002-9939-1953-0055639-3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0
_ROUNDS = 45  # the interval shrinks by 0.618 each: to 4e-10 of the slot
_SAME_M = 9  # decimals to which equal situations are equal (on a grid most are)
_SIGNS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])


@dataclass(frozen=True)
class Motions:
    """Straight motions of n equal rectangles during a slot.

    Attributes:
        start_m, end_m: (n, 2) float64, centres at the slot's beginning and end.
        heading_rad: (n,) float64, kept during the slot.
        vertex: (n,) where it stands, or which it has left last.
        enters: (n,) the vertex it reaches at the slot's end, −1 if none.
        leaves: (n,) bool, it is in its last slot on the floor.
    """

    start_m: Floats
    end_m: Floats
    heading_rad: Floats
    vertex: Ints
    enters: Ints
    leaves: Bools

    def passes(self, a: Ints, b: Ints) -> Bools:
        """(p,) whether one of the two drives off the floor from where the other drives to.

        §1.4 has a robot at its goal in its last slot, and lets another enter that vertex then: the
        one is on its way out while the other comes, so their clearance says nothing.
        """
        return np.asarray(
            (self.leaves[a] & (self.enters[b] == self.vertex[a]))
            | (self.leaves[b] & (self.enters[a] == self.vertex[b]))
        )

    def pairs(self, a: Ints, b: Ints) -> Floats:
        """(p, 6) where b is as seen from a, at the beginning and the end, and their headings."""
        return np.column_stack(
            [
                self.start_m[b] - self.start_m[a],
                self.end_m[b] - self.end_m[a],
                self.heading_rad[a],
                self.heading_rad[b],
            ]
        )


def least_clearance(pairs: Floats, half_m: Floats) -> Floats:
    """The least clearance of pairs of bodies during a slot.

    Args:
        pairs: (p, 6), see `Motions.pairs`.
        half_m: (2,) half extents of each body, along and across its heading [m].

    Returns:
        (p,) [m]; apart, their distance; overlapping, minus the length of the shortest way out of
        each other.
    """
    if not len(pairs):
        return np.empty(0)
    kinds, which = np.unique(np.round(pairs, _SAME_M), axis=0, return_inverse=True)
    least: Floats = _search(kinds, half_m)[which.ravel()]
    return least


def _search(pairs: Floats, half_m: Floats) -> Floats:
    """(p,) minimum over the slot of the clearance of each pair [m]."""
    start, end, heading_a, heading_b = pairs[:, :2], pairs[:, 2:4], pairs[:, 4], pairs[:, 5]

    def at(time: Floats) -> Floats:
        away = (1.0 - time)[:, None] * start + time[:, None] * end
        return _clearance(away, heading_a, heading_b, half_m)

    low, high = np.zeros(len(pairs)), np.ones(len(pairs))
    left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_left, at_right = at(left), at(right)
    least = np.minimum(at(low), at(high))
    for _ in range(_ROUNDS):
        lower = at_left < at_right
        low, high = np.where(lower, low, left), np.where(lower, right, high)
        new = np.where(lower, high - _GOLDEN * (high - low), low + _GOLDEN * (high - low))
        value = at(new)
        left, right = np.where(lower, new, right), np.where(lower, left, new)
        at_left, at_right = (
            np.where(lower, value, at_right),
            np.where(lower, at_left, value),
        )
        least = np.minimum(least, value)
    return least


def _clearance(away: Floats, heading_a: Floats, heading_b: Floats, half: Floats) -> Floats:
    """(p,) clearance of rectangle b, whose centre lies `away` (p, 2) from that of a [m]."""
    seen_by_a, seen_by_b = _turned(away, -heading_a), _turned(-away, -heading_b)
    turn = heading_b - heading_a
    outside = np.maximum(_gap(seen_by_a, turn, half), _gap(seen_by_b, -turn, half))
    # Two rectangles apart are nearest at a corner of one of them.
    distance = np.minimum(
        _corners_to_box(seen_by_a, turn, half), _corners_to_box(seen_by_b, -turn, half)
    )
    return np.where(outside > 0, distance, outside)


def _turned(vector: Floats, angle: Floats) -> Floats:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.column_stack(
        [cos * vector[:, 0] - sin * vector[:, 1], sin * vector[:, 0] + cos * vector[:, 1]]
    )


def _gap(away: Floats, turn: Floats, half: Floats) -> Floats:
    """(p,) the larger gap along the two axes of the first rectangle, in whose frame `away` is."""
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    reach = np.column_stack([cos * half[0] + sin * half[1], sin * half[0] + cos * half[1]])
    gap: Floats = (np.abs(away) - half - reach).max(axis=1)
    return gap


def _corners_to_box(away: Floats, turn: Floats, half: Floats) -> Floats:
    """(p,) least distance of the second rectangle's corners to the first, in the first's frame."""
    least = np.full(len(away), np.inf)
    for corner in _SIGNS * half:
        place = away + _turned(np.broadcast_to(corner, away.shape), turn)
        beyond = np.maximum(np.abs(place) - half, 0.0)
        least = np.minimum(least, np.hypot(beyond[:, 0], beyond[:, 1]))
    return least


def candidates(motions: Motions, half_m: Floats) -> tuple[Ints, Ints]:
    """Pairs of bodies among which are the nearest one and all that overlap.

    Circles around and within a body bound its clearance from both sides. Pairs that pass each
    other at a goal (`Motions.passes`) do not count.
    """
    around, within = float(np.hypot(*half_m)), float(half_m.min())
    step = motions.end_m - motions.start_m
    x, y = (motions.start_m + step / 2.0).T
    middle = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2
    middle[np.tril_indices(len(x))] = np.inf
    leavers, comers = np.flatnonzero(motions.leaves), np.flatnonzero(motions.enters >= 0)
    a, b = (pair.ravel() for pair in np.meshgrid(leavers, comers, indexing="ij"))
    excused = motions.passes(a, b)
    middle[a[excused], b[excused]] = middle[b[excused], a[excused]] = np.inf
    if not len(x) or not np.isfinite(middle.min()):
        return np.empty(0, np.int64), np.empty(0, np.int64)

    # At half time; before and after, two centres come nearer by no more than they both move.
    longest = float(np.hypot(step[:, 0], step[:, 1]).max())
    reach = max(float(np.sqrt(middle.min())) - 2.0 * within, 0.0) + 2.0 * around + 1e-6
    a, b = np.nonzero(middle <= (reach + longest) ** 2)
    start, way = motions.start_m[b] - motions.start_m[a], step[b] - step[a]
    square = (way * way).sum(axis=1)
    time = -(start * way).sum(axis=1) / np.where(square > 0, square, 1.0)
    nearest = start + np.clip(time, 0.0, 1.0)[:, None] * way
    centres = np.hypot(nearest[:, 0], nearest[:, 1])
    reach = max(float(centres.min()) - 2.0 * within, 0.0) + 2.0 * around + 1e-6
    near = np.flatnonzero(centres <= reach)
    return a[near], b[near]
