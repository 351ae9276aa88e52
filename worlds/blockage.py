"""Knife-edge blockage: how much a path loses at the boxes in or near its way.

Model B of 3GPP TR 38.901 v16.1.0, clause 7.6.4.2. Seen from the side and from above, a blocker has
two edges each; with D1 and D2 the distances of an edge from the two ends of the path, in the same
view, and r the path's length there,

    F = atan(± π/2 · sqrt(π/λ · (D1 + D2 − r))) / π                                (7.6-30)
    L = −20 lg(1 − (F_h1 + F_h2)(F_w1 + F_w2))   [dB]

with a plus for an edge that the path would have to go round, a minus for one it clears. The losses
of several blockers add up. It comes on top of the path loss with line of sight.

The report's blockers are flat screens across the path. Ours are boxes, and their edges are: from
above, the corners of the footprint farthest to the left and right of the path; from the side, the
corner of the vertical cut along the path that reaches farthest above it, or below. For a thin box
across the path this is the report's screen.

The formula falls off slowly: an edge that the path clears by far would still cost a tenth of a
decibel, and a hundred boxes 10 dB. Edges cleared by a detour of more than `NEAR_WAVELENGTHS` do not
count; what is left out then is less than 0.3 dB for a box.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from worlds.floor import Boxes

Array = NDArray[np.float64]
Ints = NDArray[np.intp]

LIGHT_M_S = 299_792_458.0

NEAR_WAVELENGTHS = 16.0
"""A box counts if the detour around the edge that the path clears is at most this long."""

_PAIRS = 400_000
"""(path, box) pairs looked at together."""

_FAN = 50
"""Paths from one place from which on they are sorted by direction."""

_PORTION = 20_000
"""Paths sorted together."""

_SHORTEST_M = 1e-9
"""Paths straight down are taken as this long in the plan, so that they have a direction."""

_LEVEL_M = 1e-9
"""Two corners count as equally far from the path within this."""

_CORNERS = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])


def knife_edge_db(
    boxes: Boxes, from_m: Array, to_m: Array, frequency_ghz: float, ignored: Ints | None = None
) -> Array:
    """What each path loses at the boxes [dB], 0 where none is near.

    Args:
        boxes: B boxes, as large as they are.
        from_m: (n, 3) where the paths begin [m].
        to_m: (n, 3) where they end [m]; exchanging both changes nothing.
        frequency_ghz: carrier.
        ignored: (n,) a box that costs a path nothing, −1 for none.

    Returns:
        (n,) float64, ≥ 0.
    """
    loss = np.zeros(len(from_m))
    path, box = near_pairs(boxes, from_m, to_m, frequency_ghz)
    if ignored is not None:
        counts = box != ignored[path]
        path, box = path[counts], box[counts]
    for first in range(0, len(path), _PAIRS):
        part = slice(first, first + _PAIRS)
        lost = pair_loss_db(
            _chosen(boxes, box[part]), from_m[path[part]], to_m[path[part]], frequency_ghz
        )
        loss += np.bincount(path[part], weights=lost, minlength=len(loss))
    return loss


def near_pairs(boxes: Boxes, from_m: Array, to_m: Array, frequency_ghz: float) -> tuple[Ints, Ints]:
    """Paths and boxes near each other, sorted by path: a superset of those that count.

    An edge at offset o of a path of length L makes a detour of at least about 2 o² / L.
    """
    paths, found = [np.empty(0, np.intp)], [np.empty(0, np.intp)]
    for path, box in _candidates(boxes, from_m, to_m, frequency_ghz):
        away = boxes.center_m[box, :2] - from_m[path, :2]
        way = to_m[path, :2] - from_m[path, :2]
        length = np.linalg.norm(way, axis=1)
        u = np.where((length > 0)[:, None], way / np.maximum(length, _SHORTEST_M)[:, None], (1, 0))
        ahead = away[:, 0] * u[:, 0] + away[:, 1] * u[:, 1]
        aside = away[:, 1] * u[:, 0] - away[:, 0] * u[:, 1]
        radius = np.linalg.norm(boxes.half_m[box, :2], axis=1)
        near = np.abs(aside) <= radius + _reach_m(length, frequency_ghz)
        near &= (ahead >= -radius) & (ahead <= length + radius)
        near &= ~_far_below(
            boxes, box, from_m[path, 2], to_m[path, 2], length, ahead, radius, frequency_ghz
        )
        paths.append(path[near])
        found.append(box[near])
    path, box = np.concatenate(paths), np.concatenate(found)
    order = np.lexsort((box, path))
    return path[order], box[order]


def _reach_m(length: Array, frequency_ghz: float) -> Array:
    """How far aside of a path an edge can be that counts: the half minor axis of an ellipse."""
    limit = NEAR_WAVELENGTHS * LIGHT_M_S / (frequency_ghz * 1e9)
    return np.asarray(np.sqrt(limit**2 + 2.0 * limit * length) / 2.0)


def _far_below(
    boxes: Boxes,
    box: Ints,
    from_z: Array,
    to_z: Array,
    length: Array,
    ahead: Array,
    radius: Array,
    frequency_ghz: float,
) -> NDArray[np.bool_]:
    """Pairs whose path passes so high above the box that its top cannot count."""
    rise = (to_z - from_z) / np.maximum(length, _SHORTEST_M)
    ends = (np.clip(ahead + side, 0.0, length) for side in (-radius, radius))
    lowest = np.minimum(*(from_z + rise * at for at in ends))
    above = lowest - boxes.center_m[box, 2] - boxes.half_m[box, 2]
    whole = np.hypot(length, to_z - from_z)
    return np.asarray(above * length > _reach_m(whole, frequency_ghz) * whole + _LEVEL_M)


def _candidates(
    boxes: Boxes, from_m: Array, to_m: Array, frequency_ghz: float
) -> Iterator[tuple[Ints, Ints]]:
    """Paths and boxes that may be near each other, in portions.

    Many paths from one access point are sorted by direction, and each box looks up those that lead
    past it; a few paths are compared with all boxes.
    """
    if not len(from_m) or not len(boxes):
        return
    start, group = np.unique(from_m[:, :2], axis=0, return_inverse=True)
    if len(from_m) < _FAN * len(start):
        step = max(1, _PAIRS // len(boxes))
        for first in range(0, len(from_m), step):
            count = min(step, len(from_m) - first)
            path, box = np.divmod(np.arange(count * len(boxes)), len(boxes))
            yield path + first, box
        return
    for g, origin in enumerate(start):
        fan = np.flatnonzero(group.ravel() == g)
        for first in range(0, len(fan), _PORTION):
            part = fan[first : first + _PORTION]
            way = to_m[part, :2] - origin
            reach = float(_reach_m(np.linalg.norm(way, axis=1), frequency_ghz).max())
            path, box = _by_direction(boxes, origin, way, reach)
            yield part[path], box


def _by_direction(boxes: Boxes, origin: Array, way: Array, reach: float) -> tuple[Ints, Ints]:
    """Ways (n, 2) from one place and boxes whose directions differ by less than they are wide."""
    away = boxes.center_m[:, :2] - origin
    distance = np.hypot(away[:, 0], away[:, 1])
    wide = np.linalg.norm(boxes.half_m[:, :2], axis=1) + reach + _LEVEL_M
    # Whose circle holds the origin, or nearly, is near in every direction.
    half = np.where(distance > 2.0 * wide, np.arcsin(wide / np.maximum(distance, wide)), np.pi)
    angle = np.arctan2(way[:, 1], way[:, 0])
    order = np.argsort(angle, kind="stable")
    around = np.concatenate([angle[order] + turn for turn in (-2 * np.pi, 0.0, 2 * np.pi)])
    middle = np.arctan2(away[:, 1], away[:, 0])
    low = np.searchsorted(around, middle - half - 1e-9, side="left")
    high = np.searchsorted(around, middle + half + 1e-9, side="right")
    count = np.minimum(high - low, len(way))
    box = np.repeat(np.arange(len(boxes)), count)
    rank = np.arange(len(box)) - np.repeat(np.cumsum(count) - count, count)
    return order[(np.repeat(low, count) + rank) % len(way)], box


def pair_loss_db(boxes: Boxes, from_m: Array, to_m: Array, frequency_ghz: float) -> Array:
    """(n,) what path i loses at box i [dB]."""
    way = to_m[:, :2] - from_m[:, :2]
    length = np.maximum(np.linalg.norm(way, axis=1), _SHORTEST_M)
    still = np.linalg.norm(way, axis=1) < _SHORTEST_M
    u = np.where(still[:, None], (1.0, 0.0), way / length[:, None])
    # The plan, in the path's frame: s along it, o to its left.
    turn = np.stack((np.cos(boxes.yaw_rad), np.sin(boxes.yaw_rad)), axis=-1)
    local = _CORNERS * boxes.half_m[:, None, :2]
    cos, sin = turn[:, None, 0], turn[:, None, 1]
    corner = np.stack(
        (cos * local[..., 0] - sin * local[..., 1], sin * local[..., 0] + cos * local[..., 1]),
        axis=-1,
    )
    corner += (boxes.center_m[:, :2] - from_m[:, :2])[:, None]
    s = corner[..., 0] * u[:, None, 0] + corner[..., 1] * u[:, None, 1]
    o = corner[..., 1] * u[:, None, 0] - corner[..., 0] * u[:, None, 1]
    row = np.arange(len(s))
    o_left, o_right = o.max(axis=1), o.min(axis=1)
    over = (o_left >= 0.0) & (o_right <= 0.0)
    detour = _detour(s, o, length[:, None], 0.0)
    # Of two corners equally far to the side, the path has to go round both.
    d_left = np.where(o >= o_left[:, None] - _LEVEL_M, detour, 0.0).max(axis=1)
    d_right = np.where(o <= o_right[:, None] + _LEVEL_M, detour, 0.0).max(axis=1)

    # The cut along the path: where it enters and leaves the footprint, or its nearest corner.
    nearest = s[row, np.abs(o).argmin(axis=1)]
    chord = _chord(s, o)
    enter = np.where(over, np.maximum(chord[0], 0.0), nearest)
    leave = np.where(over, np.minimum(chord[1], length), nearest)
    between = np.where(over, enter <= leave, (enter > 0.0) & (enter < length))

    low = boxes.center_m[:, 2] - boxes.half_m[:, 2]
    high = boxes.center_m[:, 2] + boxes.half_m[:, 2]
    drop = to_m[:, 2] - from_m[:, 2]
    at_enter, at_leave = (from_m[:, 2] + drop / length * at for at in (enter, leave))
    # How far the top lies above the path where that is lowest, and the bottom below it.
    c_top = high - np.minimum(at_enter, at_leave)
    c_low = np.maximum(at_enter, at_leave) - low
    low, high = low - from_m[:, 2], high - from_m[:, 2]
    d_top = _farther(at_leave - at_enter, enter, leave, high, length, drop)
    d_low = _farther(at_enter - at_leave, enter, leave, low, length, drop)
    met = over & between & (c_top >= 0.0) & (c_low >= 0.0)
    d_top[met], d_low[met] = _around(
        chord[0][met], chord[1][met], low[met], high[met], length[met], drop[met]
    )

    wavelength = LIGHT_M_S / (frequency_ghz * 1e9)
    cleared = np.maximum.reduce(
        [
            np.where(c < 0.0, d, 0.0)
            for c, d in ((o_left, d_left), (-o_right, d_right), (c_top, d_top), (c_low, d_low))
        ]
    )
    counts = between & (cleared <= NEAR_WAVELENGTHS * wavelength)
    across = _edge(o_left, d_left, wavelength) + _edge(-o_right, d_right, wavelength)
    upright = _edge(c_top, d_top, wavelength) + _edge(c_low, d_low, wavelength)
    # The sum of both F is below 1; rounding may not take the loss below 0.
    loss = -20.0 * np.log10(1.0 - np.clip(across * upright, 0.0, 1.0 - 1e-12))
    return np.where(counts, loss, 0.0)


def _detour(s: Array, o: Array, length: Array, drop: Array | float) -> Array:
    """D1 + D2 − r in a view: from (0, 0) to (length, drop) by way of (s, o) [m], ≥ 0."""
    longer = np.hypot(s, o) + np.hypot(length - s, drop - o)
    return np.asarray(np.maximum(longer - np.hypot(length, drop), 0.0))


def _farther(
    rise: Array, enter: Array, leave: Array, o: Array, length: Array, drop: Array
) -> Array:
    """Detour by way of the cut's corner at `enter` where `rise` > 0, at `leave` where it is < 0.

    On a level path both are equally far from it, and it has to go round both.
    """
    first, last = (_detour(at, o, length, drop) for at in (enter, leave))
    level = np.abs(rise) <= _LEVEL_M
    return np.where(level, np.maximum(first, last), np.where(rise > 0.0, first, last))


def _around(
    enter: Array, leave: Array, low: Array, high: Array, length: Array, drop: Array
) -> tuple[Array, Array]:
    """Detours over and under the cut of a box that the path meets.

    By way of the corners farthest from the path to either side; a path may well be so steep that
    the way "over" it leads round its end.
    """
    s = np.stack((enter, enter, leave, leave), axis=-1)
    o = np.stack((low, high, low, high), axis=-1)
    off = (length[:, None] * o - drop[:, None] * s) / np.hypot(length, drop)[:, None]
    detour = _detour(s, o, length[:, None], drop[:, None])
    top = off >= off.max(axis=1, keepdims=True) - _LEVEL_M
    bottom = off <= off.min(axis=1, keepdims=True) + _LEVEL_M
    return np.where(top, detour, 0.0).max(axis=1), np.where(bottom, detour, 0.0).max(axis=1)


def _edge(beyond: Array, detour: Array, wavelength: float) -> Array:
    """F of an edge (7.6-30): `beyond` ≥ 0 where the path has to go round it."""
    sign = np.where(beyond >= 0.0, 1.0, -1.0)
    return np.asarray(np.arctan(sign * np.pi / 2 * np.sqrt(np.pi / wavelength * detour)) / np.pi)


def _chord(s: Array, o: Array) -> tuple[Array, Array]:
    """Where the line o = 0 enters and leaves quadrangles (n, 4); (inf, −inf) where it misses."""
    s_next, o_next = np.roll(s, -1, axis=1), np.roll(o, -1, axis=1)
    crosses = (np.minimum(o, o_next) <= 0.0) & (np.maximum(o, o_next) >= 0.0)
    gap = o - o_next
    level = gap == 0.0
    share = np.where(level, 0.0, o / np.where(level, 1.0, gap))
    at = s + share * (s_next - s)
    first = np.where(crosses, np.where(level, np.minimum(s, s_next), at), np.inf).min(axis=1)
    last = np.where(crosses, np.where(level, np.maximum(s, s_next), at), -np.inf).max(axis=1)
    return first, last


def _chosen(boxes: Boxes, index: Ints) -> Boxes:
    """The boxes of these indices, repeated as they are."""
    return Boxes(
        ("",) * len(index), boxes.center_m[index], boxes.half_m[index], boxes.yaw_rad[index]
    )
