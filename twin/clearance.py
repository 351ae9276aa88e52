"""The true clearance between bodies in motion, exactly: minima over motions, not over samples.

Within a slot every robot stands or moves straight at constant speed with constant heading
(`twin.motion`), so the clearance of two bodies is a minimum over one linear motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twin.motion import half_m as half_of

if TYPE_CHECKING:
    from twin.motion import SlotMotion
    from worlds.world import Body

Floats = NDArray[np.float64]

ROUNDING_M = 1e-9
"""Clearances nearer to 0 than this are 0: bodies that touch do not overlap."""

_PAIRS_AT_ONCE = 20_000


def clearance_m(
    apart_m: Floats,
    step_m: Floats,
    half_a_m: Floats,
    yaw_a: Floats,
    half_b_m: Floats,
    yaw_b: Floats,
) -> Floats:
    """The least clearance of two rectangles while one moves past the other.

    Where they stay apart, their least distance; where they overlap at some time, minus the greatest
    depth of it, i.e. of the shortest displacement that would part them (so always by the separating
    axis theorem: S. Gottschalk et al., OBBTree, SIGGRAPH 1996, doi:10.1145/237170.237244).

    Args:
        apart_m: (P, 2), centre of a minus centre of b at the beginning [m].
        step_m: (P, 2), displacement of a relative to b [m].
        half_a_m: (P, 2) or (2,), half extents of a along and across its heading [m].
        yaw_a: (P,), heading of a [rad].
        half_b_m: the same of b.
        yaw_b: the same of b.

    Returns:
        (P,) float64 [m].
    """
    half_a, half_b = (np.broadcast_to(h, apart_m.shape) for h in (half_a_m, half_b_m))
    turn = yaw_a - yaw_b
    apart_b, step_b = _rotated(apart_m, -yaw_b), _rotated(step_m, -yaw_b)
    apart_a, step_a = _rotated(-apart_m, -yaw_a), _rotated(-step_m, -yaw_a)
    # Disjoint convex polygons are nearest at a corner of one of them: its path past the other.
    both = _corner_distance(
        np.concatenate([apart_b, apart_a]),
        np.concatenate([step_b, step_a]),
        np.concatenate([half_a, half_b]),
        np.concatenate([turn, -turn]),
        np.concatenate([half_b, half_a]),
    )
    clearance = np.minimum(both[: len(turn)], both[len(turn) :])
    # They can overlap only where the circles around them meet.
    reach = np.hypot(half_a[:, 0], half_a[:, 1]) + np.hypot(half_b[:, 0], half_b[:, 1])
    near = np.flatnonzero(_nearest_m(apart_m, step_m) <= reach + ROUNDING_M)
    if len(near):
        overlap = _least_separation(apart_b[near], step_b[near], half_a[near], turn[near],
                                    half_b[near])  # fmt: skip
        clearance[near] = np.where(overlap < 0, overlap, clearance[near])
    return np.where(np.abs(clearance) < ROUNDING_M, 0.0, clearance)


def _nearest_m(apart_m: Floats, step_m: Floats) -> Floats:
    """(P,) the least distance of two centres, at first `apart_m` (P, 2), in a motion [m]."""
    speed = (step_m**2).sum(axis=1)
    nearest = -(apart_m * step_m).sum(axis=1) / np.where(speed > 0, speed, 1.0)
    at = apart_m + nearest.clip(0.0, 1.0)[:, None] * step_m
    return np.asarray(np.hypot(at[:, 0], at[:, 1]))


def _rotated(vector: Floats, angle: Floats) -> Floats:
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = vector[:, 0], vector[:, 1]
    return np.column_stack([cos * x - sin * y, sin * x + cos * y])


def _corner_distance(
    center: Floats, step: Floats, half: Floats, turn: Floats, box: Floats
) -> Floats:
    """(P,) least distance from the four corners of a moving rectangle to a box [m].

    All in the frame of the box, which has half extents `box` (P, 2). The distance is convex in
    time; its minimum lies at an end of the motion, where a corner's path meets the line through a
    side, or where it is nearest to a corner of the box.
    """
    signs = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    along, across = half[:, :1] * signs[:, 0], half[:, 1:] * signs[:, 1]
    corner = center[:, None, :] + np.stack(
        [cos * along - sin * across, sin * along + cos * across], axis=2
    )  # (P, 4, 2)
    way = step[:, None, :]
    sides = box[:, None, None, :] * np.array([1.0, -1.0])[:, None]  # (P, 1, 2, 2): ±half by axis
    with np.errstate(divide="ignore", invalid="ignore"):
        meets = (sides - corner[:, :, None, :]) / way[:, :, None, :]  # (P, 4, 2, 2)
        to_corners = box[:, None, None, :] * signs - corner[:, :, None, :]  # (P, 4, 4, 2)
        nearest = (to_corners * way[:, :, None, :]).sum(axis=3) / (way**2).sum(axis=2)[:, :, None]
    times = np.empty((len(center), 4, 10))
    times[:, :, :4], times[:, :, 4:8] = meets.reshape(-1, 4, 4), nearest
    times[:, :, 8], times[:, :, 9] = 0.0, 1.0  # the ends
    times[np.isnan(times)] = 0.0
    np.minimum(np.maximum(times, 0.0, out=times), 1.0, out=times)
    x = np.abs(corner[:, :, :1] + times * way[:, :, :1]) - box[:, None, :1]
    y = np.abs(corner[:, :, 1:] + times * way[:, :, 1:]) - box[:, None, 1:]
    return np.asarray(np.hypot(np.maximum(x, 0.0), np.maximum(y, 0.0)).min(axis=(1, 2)))


_LINES = np.array(list(combinations(range(8), 2)))


def _least_separation(
    center: Floats, step: Floats, half: Floats, turn: Floats, box: Floats
) -> Floats:
    """(P,) least over time of the greatest gap along the four axes of two rectangles [m].

    Negative values are depths of overlap. The gap along an axis is the greater of two linear
    functions of time; the greatest of all eight is convex and has its minimum at an end of the
    motion or where two of them are equal.
    """
    cos, sin = np.cos(turn), np.sin(turn)
    one, zero = np.ones_like(turn), np.zeros_like(turn)
    axes = np.stack([one, zero, zero, one, cos, sin, -sin, cos], axis=1).reshape(-1, 4, 2)
    c, s = np.abs(cos), np.abs(sin)
    reach = np.column_stack(
        [
            box[:, 0] + c * half[:, 0] + s * half[:, 1],
            box[:, 1] + s * half[:, 0] + c * half[:, 1],
            half[:, 0] + c * box[:, 0] + s * box[:, 1],
            half[:, 1] + s * box[:, 0] + c * box[:, 1],
        ]
    )
    begin = np.einsum("pad,pd->pa", axes, center)
    rate = np.einsum("pad,pd->pa", axes, step)
    begin = np.concatenate([begin - reach, -begin - reach], axis=1)  # (P, 8)
    rate = np.concatenate([rate, -rate], axis=1)
    i, j = _LINES.T
    with np.errstate(divide="ignore", invalid="ignore"):
        times = (begin[:, j] - begin[:, i]) / (rate[:, i] - rate[:, j])
    times = np.column_stack([np.nan_to_num(times).clip(0.0, 1.0), zero, one])
    gaps = begin[:, :, None] + rate[:, :, None] * times[:, None, :]
    return np.asarray(gaps.max(axis=1).min(axis=1))


@lru_cache(maxsize=4)
def _once(n: int) -> Floats:
    """(n, n) 0 above the diagonal, infinite elsewhere: leaves one of each two pairs."""
    mask = np.where(np.arange(n)[:, None] < np.arange(n), 0.0, np.inf)
    mask.flags.writeable = False
    return mask


@dataclass(frozen=True)
class Nearness:
    """The least clearance of any two bodies in a slot, and all pairs that overlap.

    Attributes:
        clearance_m: the least one, None where no two bodies are to be measured.
        pair: indices (into the motion) of the two, the lowest of several equal ones.
        overlaps: (index, index, clearance) of each pair whose bodies overlap at some time.
    """

    clearance_m: float | None
    pair: tuple[int, int]
    overlaps: tuple[tuple[int, int, float], ...]


def nearness(motion: SlotMotion, body: Body) -> Nearness:
    """The least clearance within a slot between any two bodies.

    Not measured is a robot that drives off the floor in this slot against the one that moves into
    its vertex: §1.4 lets the vertex be entered in the slot after the arrival, so the one is on its
    way out while the other comes.

    The distance of the centres bounds the clearance from both sides (circles around and within
    the bodies); only pairs that can be the nearest, or overlap, are measured exactly.
    """
    start, step = motion.start_m, motion.step_m
    middle = start + step / 2
    square = (middle[:, None, 0] - middle[:, 0]) ** 2 + (middle[:, None, 1] - middle[:, 1]) ** 2
    square += _once(len(start))
    for leaver in np.flatnonzero(motion.leaves):
        follower = motion.enters == motion.vertex[leaver]
        square[leaver, follower] = square[follower, leaver] = np.inf
    half_m = half_of(body)
    around, within = float(np.hypot(*half_m)), float(half_m.min())
    closest = float(np.sqrt(square.min(initial=np.inf)))
    if closest == np.inf:
        return Nearness(None, (-1, -1), ())
    # Two centres come no nearer than they are at half time less the way of both from there.
    reach = float(np.hypot(step[:, 0], step[:, 1]).max())
    limit = max(closest - 2 * within, 0.0) + 2 * around + ROUNDING_M
    a, b = np.divmod(np.flatnonzero(square <= (limit + reach) ** 2), len(start))
    apart, way = start[a] - start[b], step[a] - step[b]
    center = _nearest_m(apart, way)
    limit = max(float(center.min()) - 2 * within, 0.0) + 2 * around + ROUNDING_M
    near = np.flatnonzero(center <= limit)
    a, b = a[near], b[near]
    found = np.empty(len(a))
    heading = motion.heading_rad
    for first in range(0, len(a), _PAIRS_AT_ONCE):
        i, j = (k[first : first + _PAIRS_AT_ONCE] for k in (a, b))
        found[first : first + len(i)] = clearance_m(
            start[i] - start[j], step[i] - step[j], half_m, heading[i], half_m, heading[j]
        )
    k = int(found.argmin())
    overlaps = tuple((int(a[q]), int(b[q]), float(found[q])) for q in np.flatnonzero(found < 0))
    return Nearness(float(found[k]), (int(a[k]), int(b[k])), overlaps)
