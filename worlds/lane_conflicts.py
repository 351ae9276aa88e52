"""Where robots on a graph of lanes would touch although every rule of the plan is kept.

The rules keep two robots from the same vertex and from the same edge (1-semantics §1.2, §1.3), and
on a grid whose pitch fits the body that keeps their bodies apart. A layout drawn for other vehicles
gives no such promise: nodes may lie closer than a body is long, lanes may cross where there is no
node, and a robot that has just turned off a node may still be in the way of the next one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from worlds.boxes import OVERLAP_M, overlap, swept
from worlds.world import Body

_STILL_M = 1e-12  # who moves less stands
_ROWS = 2_000_000  # pairs of lanes compared at once

Array = NDArray[np.float64]
Ints = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Lanes:
    """Lanes as bodies meet them.

    Attributes:
        xy_m: (V, 2) vertices.
        uv: (E, 2) ends.
        oneway: (E,) bool, from u to v only.
        slots: (E,) slots a crossing takes.
    """

    xy_m: Array
    uv: NDArray[np.integer]
    oneway: NDArray[np.bool_]
    slots: NDArray[np.int32]


@dataclass(frozen=True)
class Follower:
    """A robot coming to a vertex on one lane touches the one that has just left it on another.

    Attributes:
        vertex: between the lanes.
        first, second: the lanes of the two; of the one that is ahead first.
    """

    vertex: int
    first: int
    second: int


def near_vertices(lanes: Lanes, body: Body) -> list[tuple[int, int]]:
    """Pairs of vertices at which robots cannot stand at the same time without touching."""
    from scipy.spatial import cKDTree

    if not len(lanes.xy_m):
        return []
    heading = _headings(lanes)
    pairs = sorted(cKDTree(lanes.xy_m).query_pairs(math.hypot(body.length_m, body.width_m)))
    rows = [
        (i, j, a, b) for i, j in pairs for a, b in product(heading[i] or [0.0], heading[j] or [0.0])
    ]
    if not rows:
        return []
    i, j = (np.array([row[k] for row in rows], dtype=np.intp) for k in (0, 1))
    yaw = np.array([row[2:] for row in rows])
    half = _half(body)
    hit = overlap(lanes.xy_m[i], half, yaw[:, 0], lanes.xy_m[j], half, yaw[:, 1])
    return sorted({(row[0], row[1]) for row, h in zip(rows, hit.tolist(), strict=True) if h})


def near_lanes(lanes: Lanes, body: Body) -> list[tuple[int, int]]:
    """Pairs of lanes without a common vertex on which robots can touch: they cross, or are near."""
    u, v = lanes.uv.T
    center, half, yaw = swept(lanes.xy_m[u], lanes.xy_m[v], body.length_m, body.width_m)
    cos, sin = np.abs(np.cos(yaw)), np.abs(np.sin(yaw))
    reach = np.column_stack(
        (cos * half[:, 0] + sin * half[:, 1], sin * half[:, 0] + cos * half[:, 1])
    )
    found: list[tuple[int, int]] = []
    step = max(1, _ROWS // max(1, len(u)))
    for first in range(0, len(u), step):
        rows = np.arange(first, min(first + step, len(u)))
        close = np.ones((len(rows), len(u)), dtype=np.bool_)
        for axis in (0, 1):
            apart = np.abs(center[rows, None, axis] - center[None, :, axis])
            close &= apart < reach[rows, None, axis] + reach[None, :, axis]
        close &= rows[:, None] < np.arange(len(u))[None, :]
        for end in (u, v):
            close &= (u[rows, None] != end[None, :]) & (v[rows, None] != end[None, :])
        a, b = np.nonzero(close)
        a = rows[a]
        hit = overlap(center[a], half[a], yaw[a], center[b], half[b], yaw[b])
        found += list(zip(a[hit].tolist(), b[hit].tolist(), strict=True))
    return found


def touching_followers(lanes: Lanes, body: Body) -> list[Follower]:
    """Where robots that follow each other through a vertex touch.

    §1.2 lets a robot reach a vertex in the slot in which another leaves it. In that slot, in the
    one before (both on their way to it) and in the one after (both on their way from it) their
    bodies must be apart; on a grid length + width ≤ pitch sees to that.
    """
    cases = list(_cases(lanes))
    if not cases:
        return []
    vertex, first, second = (np.array([c[k] for c in cases], dtype=np.intp) for k in (0, 1, 2))
    ahead, behind = (np.array([c[k] for c in cases]) for k in (3, 4))  # (n, 4): from and to [m]
    half = _half(body)
    yaw = [np.arctan2(way[:, 3] - way[:, 1], way[:, 2] - way[:, 0]) for way in (ahead, behind)]
    away = ahead - behind
    hit = _meet(away[:, :2], away[:, 2:], half, yaw)
    found = zip(vertex[hit].tolist(), first[hit].tolist(), second[hit].tolist(), strict=True)
    return [Follower(*row) for row in dict.fromkeys(found)]


def _meet(begin: Array, end: Array, half: Array, yaws: list[Array]) -> NDArray[np.bool_]:
    """(n,) whether two rectangles overlap at some time while one moves straight past the other.

    Along each of their four axes they are nearer than their extents for one span of time; they
    overlap where all four spans meet (separating axes, exact for straight and even motion).

    Args:
        begin, end: (n, 2) where one is from the other, first and last [m].
        half: (2,) half extents of both [m].
        yaws: (n,) of each [rad].
    """
    first, last = np.zeros(len(begin)), np.ones(len(begin))
    for phi in yaws:
        for angle in (phi, phi + np.pi / 2):
            p, q = (np.cos(angle) * d[:, 0] + np.sin(angle) * d[:, 1] for d in (begin, end))
            turns = [angle - yaw for yaw in yaws]
            reached = sum(half[0] * np.abs(np.cos(t)) + half[1] * np.abs(np.sin(t)) for t in turns)
            reached = reached - OVERLAP_M
            rate = np.where(np.abs(q - p) > _STILL_M, q - p, np.inf)
            one, other = (-reached - p) / rate, (reached - p) / rate
            moves = np.isfinite(rate)
            always = np.where(np.abs(p) <= reached, 0.0, np.inf)
            first = np.maximum(first, np.where(moves, np.minimum(one, other), always))
            last = np.minimum(last, np.where(moves, np.maximum(one, other), 1.0))
    return np.asarray(first <= last)


Case = tuple[int, int, int, tuple[float, ...], tuple[float, ...]]


def _cases(lanes: Lanes) -> Iterator[Case]:
    """(vertex, lane ahead, lane behind, motion ahead, motion behind) within one slot.

    A motion is where a robot is at the slot's beginning and at its end: x, y, x, y.
    """
    to: dict[int, list[tuple[int, Array]]] = {}
    off: dict[int, list[tuple[int, Array]]] = {}
    for e, (u, v) in enumerate(lanes.uv.tolist()):
        step = (lanes.xy_m[v] - lanes.xy_m[u]) / lanes.slots[e]
        to.setdefault(v, []).append((e, step))
        off.setdefault(u, []).append((e, step))
        if not lanes.oneway[e]:
            to.setdefault(u, []).append((e, -step))
            off.setdefault(v, []).append((e, -step))
    for v in sorted(to.keys() | off.keys()):
        at = lanes.xy_m[v]

        def motion(begin: Array, end: Array, at: Array = at) -> tuple[float, ...]:
            return (*(at + begin).tolist(), *(at + end).tolist())

        none = np.zeros(2)
        for e, come in to.get(v, ()):
            for f, go in off.get(v, ()):
                if e != f:  # one arrives as the other leaves
                    yield v, f, e, motion(none, go), motion(-come, none)
            for g, other in to.get(v, ()):
                if e != g and lanes.slots[g] > 1:  # one arrives, the next is a slot behind it
                    yield v, e, g, motion(-come, none), motion(-2 * other, -other)
        for f, go in off.get(v, ()):
            for g, other in off.get(v, ()):
                if f != g and lanes.slots[f] > 1:  # one left a slot ago, the next leaves now
                    yield v, f, g, motion(go, 2 * go), motion(none, other)


def _headings(lanes: Lanes) -> list[list[float]]:
    """Of each vertex the directions of its lanes; opposite ones are the same to a rectangle."""
    found: list[list[float]] = [[] for _ in range(len(lanes.xy_m))]
    for u, v in lanes.uv.tolist():
        dx, dy = (lanes.xy_m[v] - lanes.xy_m[u]).tolist()
        heading = round(math.atan2(dy, dx) % math.pi, 9)
        for w in (u, v):
            if heading not in found[w]:
                found[w].append(heading)
    return found


def _half(body: Body) -> Array:
    return np.array([body.length_m / 2, body.width_m / 2])
