"""Exact segment–box intersection in numpy: the oracle for everything that casts rays.

The slab method (Kay and Kajiya, SIGGRAPH 1986): in the box's own frame a segment is inside the box
exactly where it is inside all three pairs of parallel planes. Brute force over all (ray, box)
pairs, double precision, no shared code with `worlds`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def entries(center: Array, half: Array, yaw: Array, start: Array, end: Array) -> Array:
    """(R, B) fraction of each segment at which it enters each box; inf where it misses.

    A segment that starts inside enters at 0; boxes are closed sets.
    """
    cos, sin = np.cos(yaw), np.sin(yaw)
    enter = np.empty((len(start), len(center)))
    for first in range(0, len(start), 2000):
        part = slice(first, first + 2000)
        origin = _own_frame(start[part, None, :] - center, cos, sin)
        step = _own_frame(np.broadcast_to((end - start)[part, None, :], origin.shape), cos, sin)
        with np.errstate(divide="ignore", invalid="ignore"):
            one = (-half - origin) / step
            two = (half - origin) / step
        near, far = np.minimum(one, two), np.maximum(one, two)
        # Parallel to a pair of planes: between them always, or never.
        parallel = step == 0
        between = np.abs(origin) <= half
        near = np.where(parallel, np.where(between, -np.inf, np.inf), near)
        far = np.where(parallel, np.where(between, np.inf, -np.inf), far)
        t_in = np.maximum(near.max(axis=2), 0.0)
        t_out = np.minimum(far.min(axis=2), 1.0)
        enter[part] = np.where(t_in <= t_out, t_in, np.inf)
    return enter


def _own_frame(vector: Array, cos: Array, sin: Array) -> Array:
    """(R, B, 3) vectors turned by −yaw of each box."""
    x, y = vector[..., 0], vector[..., 1]
    return np.stack((cos * x + sin * y, cos * y - sin * x, vector[..., 2]), axis=-1)
