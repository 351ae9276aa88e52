"""The ways of robots in Foxglove: where each one goes next, and where it comes from.

The scene `/scene/paths` is written once per slot: ahead of each robot the next `AHEAD` states of
its path, in the colours of the APs that will serve it, and behind it the last `TRAIL` ones, in
grey. A new path (`NewPath`) takes the place of what was ahead.
"""

from __future__ import annotations

from bisect import bisect_right
from itertools import pairwise

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

    def __init__(self, vertices: Ints, aps: Ints, xy_m: NDArray[np.float64]) -> None:
        self.vertices, self.aps = vertices, aps
        self.at: int | None = None
        self.base = 0
        self._corners = _corners(xy_m[vertices], aps)

    def states(self, first: int, last: int) -> list[int]:
        """The first and last of these states, and those between where the line bends."""
        if last <= first:
            return [first]
        begin, end = bisect_right(self._corners, first), bisect_right(self._corners, last - 1)
        return [first, *self._corners[begin:end], last]


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
        self._points = [self.point(float(x), float(y), _HEIGHT_M) for x, y in problem.xy_m]
        self._colors = [self.pair(ap_color(k), 0.85) for k in range(len(problem.ap_ids))]
        self._trail = self.pair(rgb(_TRAIL_COLOR), 0.6)
        self._ways: dict[str, _Way] = {}
        for path in plan.paths:
            if path is not None:
                self._ways[path.robot] = _Way(path.vertices, path.aps, self._xy_m)

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
        way = _Way(vertices, aps, self._xy_m)
        way.base = way.at = been
        self._ways[path.robot] = way

    def pack(self) -> bytes:
        """Points and colours of all lines."""
        points: list[bytes] = []
        colors: list[bytes] = []
        for way in self._ways.values():
            if way.at is None:
                continue
            last = min(way.at + AHEAD, len(way.vertices) - 1)
            for a, b in pairwise(way.states(way.at, last)):
                # A crossing is served by the AP of the vertex it leaves (§1.6).
                if way.vertices[a] != way.vertices[b]:
                    points += self._points[way.vertices[a]], self._points[way.vertices[b]]
                    colors.append(self._colors[way.aps[a]])
            for a, b in pairwise(way.states(max(0, way.at - TRAIL), way.at)):
                if way.vertices[a] != way.vertices[b]:
                    points += self._points[way.vertices[a]], self._points[way.vertices[b]]
                    colors.append(self._trail)
        return b"".join(points + colors)
