"""Aisles: stretches of a grid line on which robots can drive without a gap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SAME_M = 1e-6
"""Coordinates nearer than this are one [m]."""

Line = tuple[int, tuple[int, ...], tuple[int, ...]]
"""(axis, vertices, edges): axis 0 for equal x, 1 for equal y; all in the order of the indices."""


def grid_lines(xy_m: NDArray[np.float64], edge_uv: NDArray[np.int32]) -> list[Line]:
    """The aisles of a graph whose edges all run along x or y; none if any runs otherwise.

    Args:
        xy_m: (V, 2) float64.
        edge_uv: (E, 2) int32.

    Returns:
        Every set of at least two vertices joined by edges along one axis, with these edges; each
        edge is in exactly one of them.
    """
    if not len(edge_uv):
        return []
    step = np.abs(xy_m[edge_uv[:, 0]] - xy_m[edge_uv[:, 1]])
    if not ((step < SAME_M).sum(axis=1) == 1).all():
        return []
    lines: list[Line] = []
    for axis in (0, 1):
        edges = np.flatnonzero(step[:, axis] < SAME_M)
        part = _components(len(xy_m), edge_uv[edges])
        by_part: dict[int, list[int]] = {}
        for e, root in zip(edges.tolist(), part[edge_uv[edges, 0]].tolist(), strict=True):
            by_part.setdefault(root, []).append(e)
        lines += [
            (axis, tuple(np.flatnonzero(part == root).tolist()), tuple(members))
            for root, members in sorted(by_part.items())
        ]
    return lines


def _components(n: int, edge_uv: NDArray[np.int32]) -> NDArray[np.int64]:
    """(n,) the least vertex of each vertex's connected component."""
    root = np.arange(n)

    def find(v: int) -> int:
        while root[v] != v:
            root[v] = root[root[v]]
            v = int(root[v])
        return v

    for u, v in edge_uv.tolist():
        a, b = find(u), find(v)
        root[max(a, b)] = min(a, b)
    return np.array([find(v) for v in range(n)], np.int64)
