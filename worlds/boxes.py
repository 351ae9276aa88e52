"""Boxes, points and footprints: what contains what, what touches what. Exact, on numpy alone.

Touching counts: a body that grazes a rack is a damaged body. Two shapes closer than `TOUCH_M`
touch, so that a robot of 1 m between racks 1 m apart is blocked whatever the rounding.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worlds.floor import Boxes

TOUCH_M = 1e-9
"""Far above the rounding of coordinates below 10 km, far below any clearance."""

OVERLAP_M = 1e-6
"""Bodies that overlap by less only touch."""

_PAIRS_AT_ONCE = 1_000_000  # bounds the memory of the exact test to some 100 MB


def contains(boxes: Boxes, points_m: ArrayLike, grow_m: float = 0.0) -> NDArray[np.int32]:
    """The box a point lies in or on.

    Args:
        boxes: B boxes.
        points_m: (P, 3) [m].
        grow_m: the boxes are this much larger on every side [m].

    Returns:
        (P,) int32, the lowest index of a box that contains the point, -1 where none does.
    """
    points = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
    half = boxes.half_m + grow_m
    found = _Lowest(len(points))
    reach = _extent(half[:, :2], boxes.yaw_rad) + TOUCH_M
    for b, p in _near(boxes.center_m[:, :2], reach, points[:, :2]):
        away = points[p] - boxes.center_m[b]
        cos, sin = np.cos(boxes.yaw_rad[b]), np.sin(boxes.yaw_rad[b])
        inside = (
            (np.abs(cos * away[:, 0] + sin * away[:, 1]) <= half[b, 0] + TOUCH_M)
            & (np.abs(cos * away[:, 1] - sin * away[:, 0]) <= half[b, 1] + TOUCH_M)
            & (np.abs(away[:, 2]) <= half[b, 2] + TOUCH_M)
        )
        found.take(p[inside], b[inside])
    return found.index


def footprint_hits(
    boxes: Boxes,
    xy_m: ArrayLike,
    half_m: ArrayLike,
    yaw_rad: ArrayLike = 0.0,
    *,
    body_height_m: float = np.inf,
) -> NDArray[np.int32]:
    """The box a rectangle on the floor touches: a body that stands there, a strip it sweeps.

    Two rectangles are apart exactly if one of their four edge directions separates them (the
    separating axis theorem: S. Gottschalk et al., OBBTree, SIGGRAPH 1996,
    doi:10.1145/237170.237244).

    Args:
        boxes: B boxes.
        xy_m: (P, 2), centres of the rectangles [m].
        half_m: (2,) or (P, 2), their half extents before the turn [m].
        yaw_rad: () or (P,), their turn.
        body_height_m: boxes whose underside is higher than this do not matter.

    Returns:
        (P,) int32, the lowest index of a box that is touched, -1 where none is.
    """
    xy = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
    half = np.broadcast_to(np.asarray(half_m, dtype=np.float64), xy.shape)
    yaw = np.broadcast_to(np.asarray(yaw_rad, dtype=np.float64), len(xy))
    found = _Lowest(len(xy))
    if not len(xy):
        return found.index
    low = np.flatnonzero(boxes.center_m[:, 2] - boxes.half_m[:, 2] <= body_height_m + TOUCH_M)
    reach = _extent(boxes.half_m[low, :2], boxes.yaw_rad[low]) + _extent(half, yaw).max(axis=0)
    for near, p in _near(boxes.center_m[low, :2], reach + TOUCH_M, xy):
        b = low[near]
        away = xy[p] - boxes.center_m[b, :2]
        apart = np.zeros(len(p), dtype=np.bool_)
        # How far each rectangle reaches along an axis at angle phi: h0 |cos| + h1 |sin| of the
        # angle between the axis and its own first direction.
        for phi in (boxes.yaw_rad[b], yaw[p]):
            for angle in (phi, phi + np.pi / 2):
                distance = np.abs(np.cos(angle) * away[:, 0] + np.sin(angle) * away[:, 1])
                reached = _reach_along(boxes.half_m[b, :2], angle - boxes.yaw_rad[b])
                reached += _reach_along(half[p], angle - yaw[p])
                apart |= distance > reached + TOUCH_M
        found.take(p[~apart], b[~apart])
    return found.index


def swept(
    from_m: ArrayLike, to_m: ArrayLike, length_m: float, width_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The strips that bodies sweep which drive straight ahead.

    Args:
        from_m: (E, 2), where the body's centre starts [m].
        to_m: (E, 2), where it ends [m].
        length_m: of the body, along its heading [m].
        width_m: of the body, across [m].

    Returns:
        Centres (E, 2) [m], half extents (E, 2) [m] and turns (E,) [rad] for `footprint_hits`.
    """
    start = np.asarray(from_m, dtype=np.float64).reshape(-1, 2)
    end = np.asarray(to_m, dtype=np.float64).reshape(-1, 2)
    way = end - start
    along = (np.hypot(way[:, 0], way[:, 1]) + length_m) / 2
    half = np.column_stack((along, np.full(len(way), width_m / 2)))
    return (start + end) / 2, half, np.arctan2(way[:, 1], way[:, 0])


def overlap(
    center_a: ArrayLike,
    half_a: ArrayLike,
    yaw_a: ArrayLike,
    center_b: ArrayLike,
    half_b: ArrayLike,
    yaw_b: ArrayLike,
) -> NDArray[np.bool_]:
    """Whether pairs of rectangles overlap by more than `OVERLAP_M`; touching does not count.

    Args:
        center_a, center_b: (P, 2), centres [m].
        half_a, half_b: (P, 2) or (2,), half extents before the turn [m].
        yaw_a, yaw_b: (P,), turns [rad].

    Returns:
        (P,) bool, by the separating axis theorem (see `footprint_hits`).
    """
    away = np.asarray(center_b, dtype=np.float64) - np.asarray(center_a, dtype=np.float64)
    halves = [
        np.broadcast_to(np.asarray(h, dtype=np.float64), away.shape) for h in (half_a, half_b)
    ]
    yaws = [np.broadcast_to(np.asarray(y, dtype=np.float64), len(away)) for y in (yaw_a, yaw_b)]
    apart = np.zeros(len(away), dtype=np.bool_)
    for phi in yaws:
        for angle in (phi, phi + np.pi / 2):
            distance = np.abs(np.cos(angle) * away[:, 0] + np.sin(angle) * away[:, 1])
            reached = sum(_reach_along(h, angle - y) for h, y in zip(halves, yaws, strict=True))
            apart |= distance > reached - OVERLAP_M
    return ~apart


class _Lowest:
    """The lowest index of a box seen so far for each of P places."""

    def __init__(self, places: int) -> None:
        self._lowest = np.full(places, np.iinfo(np.int32).max, dtype=np.int32)

    def take(self, places: NDArray[np.intp], boxes: NDArray[np.intp]) -> None:
        np.minimum.at(self._lowest, places, boxes.astype(np.int32))

    @property
    def index(self) -> NDArray[np.int32]:
        none = np.iinfo(np.int32).max
        return np.where(self._lowest == none, np.int32(-1), self._lowest)


def _reach_along(half: NDArray[np.float64], angle: NDArray[np.float64]) -> NDArray[np.float64]:
    return half[:, 0] * np.abs(np.cos(angle)) + half[:, 1] * np.abs(np.sin(angle))


def _extent(half: NDArray[np.float64], yaw: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 2), half extents of the upright rectangles around turned ones."""
    return np.column_stack((_reach_along(half, -yaw), _reach_along(half, np.pi / 2 - yaw)))


def _near(
    center: NDArray[np.float64], reach: NDArray[np.float64], xy: NDArray[np.float64]
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Pairs (box, point) whose coordinates differ by at most `reach` (B, 2), in portions.

    The points are cut into strips along x and sorted by y within each, as one ascending key; a
    box looks up its interval of y in every strip it reaches.
    """
    if not len(xy) or not len(center):
        return
    low, span = xy.min(axis=0), np.ptp(xy, axis=0)
    strips = max(1, int(np.sqrt(len(xy))))
    per_m = (strips - 1) / span[0] if span[0] > 0 else 0.0
    room = span[1] + 2.0  # between the keys of neighbouring strips lies at least 1 m
    key = np.floor((xy[:, 0] - low[0]) * per_m) * room + (xy[:, 1] - low[1])
    order = np.argsort(key, kind="stable")
    key = key[order]

    slack = reach + 1e-6  # for the rounding of keys; the exact comparison comes last
    west, east = (
        np.clip(np.floor((center[:, 0] + side - low[0]) * per_m), -1, strips).astype(np.intp)
        for side in (-slack[:, 0], slack[:, 0])
    )
    box, strip = _ranges(west, east - west + 1)
    south, north = (
        strip * room + np.clip(center[box, 1] + side - low[1], -0.5, span[1] + 0.5)
        for side in (-slack[box, 1], slack[box, 1])
    )
    first = np.searchsorted(key, south, side="left")
    count = np.searchsorted(key, north, side="right") - first
    ends = np.cumsum(count)
    at = 0
    while at < len(box):
        done = ends[at - 1] if at else 0
        until = max(at + 1, int(np.searchsorted(ends, done + _PAIRS_AT_ONCE, side="right")))
        row, rank = _ranges(first[at:until], count[at:until])
        b, p = box[at + row], order[rank]
        near = (np.abs(xy[p] - center[b]) <= reach[b]).all(axis=1)
        yield b[near], p[near]
        at = until


def _ranges(
    first: NDArray[np.intp], count: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The ranges first[i] … first[i] + count[i] − 1, one after the other: each i, each number."""
    row = np.repeat(np.arange(len(first)), count)
    skipped = np.cumsum(count) - count
    return row, np.arange(len(row)) - (skipped - first)[row]
