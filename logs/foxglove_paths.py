"""The ways of robots in Foxglove: where each one goes next, and where it comes from.

The scene `/scene/paths` is written once per slot: ahead of each robot the next `AHEAD` states of
its path, in the colours of the APs that will serve it, and behind it the last `TRAIL` ones, in
grey. A new path (`NewPath`) takes the place of what was ahead.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from logs.colors import ap_color, rgb
from logs.foxglove_pack import Lines
from logs.records import GONE, NewPath, RobotState
from planner.plan import Plan
from planner.problem import Problem

AHEAD = 30
"""States of its path that are drawn ahead of a robot."""
TRAIL = 15
"""States that are drawn behind it."""

_HEIGHT_M = 0.06
_TRAIL_COLOR = "#8a939e"

Ints = NDArray[np.int32]


class _Way:
    """A robot's states from the beginning to the end of its present path.

    Attributes:
        at: the state it is in, None while it is not on the floor.
        base: index of the first state of its present path.
    """

    def __init__(
        self,
        vertices: Ints,
        aps: Ints,
        xy_m: NDArray[np.float64],
        points: Sequence[bytes],
        colors: Sequence[bytes],
    ) -> None:
        """Lay a way out.

        Args:
            vertices, aps: of its states.
            xy_m: of all vertices [m].
            points: these, packed.
            colors: of each AP, packed.
        """
        self.vertices, self.aps = vertices, aps
        self.at: int | None = None
        self.base = 0
        self._stands = vertices.tolist()
        self._points = [points[v] for v in self._stands]
        self._colors = [colors[a] for a in aps.tolist()]
        self._corners = corners = _corners(xy_m[vertices], aps)
        # The pieces between corners one after the other, and where each begins.
        pieces = [self._piece(a, b) for a, b in pairwise(corners)]
        self._lines = b"".join([line for line, _ in pieces])
        self._paint = b"".join([paint for _, paint in pieces])
        self._line_at = _ends(line for line, _ in pieces)
        self._paint_at = _ends(paint for _, paint in pieces)
        self._drawn: tuple[int, tuple[bytes, bytes]] | None = None

    def _piece(self, a: int, b: int) -> tuple[bytes, bytes]:
        """Points and colours of the straight piece from state a to b; none for a wait."""
        if self._stands[a] == self._stands[b]:
            return b"", b""
        # A crossing is served by the AP of the vertex it leaves (§1.6).
        return self._points[a] + self._points[b], self._colors[a]

    def _between(self, first: int, last: int) -> tuple[bytes, bytes]:
        """Points and colours from state `first` to `last`, corner by corner."""
        if last <= first:
            return b"", b""
        begin = bisect_right(self._corners, first)
        end = bisect_right(self._corners, last - 1) - 1
        if end < begin:
            return self._piece(first, last)
        head, paint_head = self._piece(first, self._corners[begin])
        tail, paint_tail = self._piece(self._corners[end], last)
        line = self._lines[self._line_at[begin] : self._line_at[end]]
        paint = self._paint[self._paint_at[begin] : self._paint_at[end]]
        return head + line + tail, paint_head + paint + paint_tail

    def draw(self, at: int, trail: bytes) -> tuple[bytes, bytes]:
        """Points and colours of the way ahead of state `at` and, in the colours `trail`, behind."""
        if self._drawn is None or self._drawn[0] != at:
            ahead, paint = self._between(at, min(at + AHEAD, len(self._stands) - 1))
            behind, _ = self._between(max(0, at - TRAIL), at)
            pieces = len(behind) // (2 * len(self._points[0]))
            self._drawn = at, (ahead + behind, paint + pieces * trail)
        return self._drawn[1]


def _ends(parts: Iterable[bytes]) -> list[int]:
    """Where each of some parts begins when they are joined, and where the last one ends."""
    return list(accumulate(map(len, parts), initial=0))


def _corners(xy_m: NDArray[np.float64], aps: Ints) -> list[int]:
    """States in which the direction or the AP changes; waits begin and end in one."""
    if len(xy_m) < 3:
        return []
    step = np.diff(xy_m, axis=0)
    bends = np.any(np.abs(np.diff(step, axis=0)) > 1e-9, axis=1) | (aps[1:-1] != aps[:-2])
    corners: list[int] = (np.flatnonzero(bends) + 1).tolist()
    return corners


class Paths(Lines):
    """Follows robots along their paths and packs the scene of these."""

    def __init__(self, problem: Problem, plan: Plan) -> None:
        super().__init__("paths", 0.07)
        self._xy_m = problem.xy_m
        self._points = [self.point(x, y, _HEIGHT_M) for x, y in problem.xy_m.tolist()]
        self._colors = [self.pair(ap_color(k), 0.85) for k in range(len(problem.ap_ids))]
        self._trail = self.pair(rgb(_TRAIL_COLOR), 0.6)
        self._ways: dict[str, _Way] = {}
        for path in plan.paths:
            if path is not None:
                self._ways[path.robot] = self._way(path.vertices, path.aps)

    def _way(self, vertices: Ints, aps: Ints) -> _Way:
        return _Way(vertices, aps, self._xy_m, self._points, self._colors)

    def state(self, state: RobotState) -> None:
        """Where a robot is in its path."""
        way = self._ways.get(state.robot)
        if way is not None:
            at = way.base + state.visit
            way.at = None if state.activity == GONE or not 0 <= at < len(way.vertices) else at

    def new_path(self, path: NewPath) -> None:
        """What was ahead of a robot is no more; this is, from where it is now."""
        old = self._ways.get(path.robot)
        vertices, aps = np.array(path.vertices, np.int32), np.array(path.aps, np.int32)
        if not len(vertices) or len(vertices) != len(aps):
            return
        been = old.at or 0 if old is not None else 0
        if old is not None:
            vertices = np.concatenate([old.vertices[:been], vertices])
            aps = np.concatenate([old.aps[:been], aps])
        way = self._way(vertices, aps)
        way.base = way.at = been
        self._ways[path.robot] = way

    def pack(self) -> bytes:
        """Points and colours of all lines."""
        points: list[bytes] = []
        colors: list[bytes] = []
        for way in self._ways.values():
            if way.at is not None:
                line, paint = way.draw(way.at, self._trail)
                points.append(line)
                colors.append(paint)
        return b"".join(points + colors)
