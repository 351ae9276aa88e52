"""`Scene`: the hall's boxes in PyBullet, asked whether a ray gets through.

On grids aligned with the access points many rays run exactly along a face. So every box is
`grow_m` larger for rays than it is drawn (2 mm by default: boxes that touch leave no gap, a ray
along a face is blocked). PyBullet finds the box a ray meets; since it takes rays that pass up to
3 mm beside an edge for hits (measured on 2 million rays aimed at edges; it missed none), a hit
counts only if the exact slab test confirms it, and the few rays left in doubt are tested exactly
against all boxes. The answer is that of exact geometry, the same in both directions.

What PyBullet 3.2.7 does that the code below minds:
    - a call of `rayTestBatch` with 16 384 rays or more silently returns fewer results;
    - a ray that starts inside a box does not meet it;
    - after `createMultiBody(batchPositions=…)` `getNumBodies()` is wrong: the ids count;
    - without `physicsClientId` a call goes to whichever client came first;
    - importing it prints a line.
"""

from __future__ import annotations

import itertools
import os
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worlds.boxes import contains
from worlds.floor import Boxes, Floor
from worlds.world import World

Array = NDArray[np.float64]

GROW_M = 0.002
"""Boxes are this much larger for rays on every side, besides `radio.clearance_m` [m]."""

GUARD_M = 0.001
"""The boxes in PyBullet are this much larger still, lest rounding lets a ray slip through [m]."""

MAX_RAYS = 16_000
"""Rays in one call; from 16 384 on results are lost."""

MAX_BATCH = 4_000
"""Boxes in one call."""

_KNOWN_STARTS = 4_000
"""Starts of rays whose box is remembered."""

_PAIRS = 200_000
"""(ray, box) pairs the exact test holds in memory at once."""

_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
_TRIANGLES = [
    *(0, 1, 3, 0, 3, 2, 4, 6, 7, 4, 7, 5),  # x = −1, +1
    *(0, 4, 5, 0, 5, 1, 2, 3, 7, 2, 7, 6),  # y
    *(0, 2, 6, 0, 6, 4, 1, 5, 7, 1, 7, 3),  # z
]
"""A box as 12 triangles: PyBullet answers rays 2 to 3 times faster than for its box shape."""

_SOLID, _MOVING, _HIDDEN = 2, 4, 8
"""Collision groups: static bodies (Bullet's own value), moving ones, those rays pass through."""


class Scene:
    """Boxes that block rays.

    A context manager; it holds one PyBullet client until it is closed.

    Attributes:
        grow_m: boxes are this much larger on every side [m].
        rays_cast: rays asked for so far.
        seconds: time spent in `cast` so far [s].
    """

    def __init__(self, boxes: Boxes, *, grow_m: float = GROW_M) -> None:
        if grow_m < 0:
            raise ValueError(f"grow_m is {grow_m}; boxes can only grow")
        self.grow_m = grow_m
        self.rays_cast = 0
        self.seconds = 0.0
        self._static = len(boxes)
        self._center = np.array(boxes.center_m, dtype=np.float64).reshape(-1, 3)
        self._half = np.array(boxes.half_m, dtype=np.float64).reshape(-1, 3) + grow_m
        self._yaw = np.array(boxes.yaw_rad, dtype=np.float64)
        self._visible = np.ones(len(boxes), dtype=np.bool_)
        self._known_starts: dict[bytes, int] = {}  # box around points that rays start from
        self._bodies: list[int] = []  # PyBullet's id of each moving body, −1 when removed
        self._box_of = np.empty(0, dtype=np.int32)  # PyBullet's id -> box
        self._pb = _pybullet()
        self._client: int = self._pb.connect(self._pb.DIRECT)
        if self._client < 0:
            raise RuntimeError("PyBullet has no client left; close scenes that are done with")
        try:
            self._create_static()
        except BaseException:
            self.close()
            raise

    @classmethod
    def of(cls, world: World, floor: Floor) -> Scene:
        """The scene of a floor, its boxes grown as the world's `radio.clearance_m` asks."""
        return cls(floor.boxes, grow_m=ray_growth_m(world))

    def __enter__(self) -> Scene:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give PyBullet's client back; further calls do nothing."""
        if self._client >= 0:
            self._pb.disconnect(physicsClientId=self._client)
            self._client = -1

    # Rays

    def cast(self, start_m: ArrayLike, end_m: ArrayLike) -> NDArray[np.int32]:
        """The box each segment meets first, −1 where it meets none.

        A segment that starts in a box meets that box. Whether a segment is free is exact; which
        of two boxes it meets first is so but for rays that graze the first by millimetres, where
        the second may be named. Moving bodies count from `len(boxes)` on.

        Args:
            start_m: (n, 3), or (3,) for all [m].
            end_m: (n, 3), or (3,) for all [m].

        Returns:
            (n,) int32.
        """
        if self._client < 0:
            raise ValueError("the scene is closed")
        begun = time.perf_counter()
        start, end = np.broadcast_arrays(
            np.atleast_2d(np.asarray(start_m, dtype=np.float64)),
            np.atleast_2d(np.asarray(end_m, dtype=np.float64)),
        )
        if start.shape[1:] != (3,):
            raise ValueError(f"ends of rays have shape {start.shape}; give (n, 3)")
        if not (np.isfinite(start).all() and np.isfinite(end).all()):
            raise ValueError("ends of rays must be finite")
        hit = np.full(len(start), -1, dtype=np.int32)
        if self._visible.any():
            for first in range(0, len(start), MAX_RAYS):
                part = slice(first, first + MAX_RAYS)
                hit[part] = self._cast_part(start[part], end[part])
        self.rays_cast += len(start)
        self.seconds += time.perf_counter() - begun
        return hit

    def _cast_part(self, start: Array, end: Array) -> NDArray[np.int32]:
        """`cast` for one call's worth of rays."""
        found = self._pb.rayTestBatch(
            start, end, collisionFilterMask=_SOLID | _MOVING, physicsClientId=self._client
        )
        if len(found) != len(start):
            raise RuntimeError(f"PyBullet answered {len(found)} of {len(start)} rays")
        body = np.fromiter((ray[0] for ray in found), dtype=np.int32, count=len(found))
        hit = np.where(body >= 0, self._box_of[np.maximum(body, 0)], -1).astype(np.int32)
        # A ray that starts in a box meets that box, whatever PyBullet says.
        inside = self._around(start)
        hit = np.where(inside >= 0, inside, hit)
        rays = np.flatnonzero(hit >= 0)
        enter = self._enter(start[rays], end[rays], hit[rays])
        doubtful = rays[np.where(inside[rays] >= 0, enter > 0.0, np.isinf(enter))]
        hit[doubtful] = self._cast_exactly(start[doubtful], end[doubtful])
        return hit

    def cast_past(
        self, start_m: Array, end_m: Array, own: NDArray[np.integer]
    ) -> NDArray[np.int32]:
        """The moving body besides its own (n,) that each segment (n, 3) meets first, −1 if none."""
        bodies = np.flatnonzero(self._visible[self._static :]).astype(np.int32) + self._static
        return self._cast_exactly(start_m, end_m, bodies, own)

    def _cast_exactly(
        self,
        start: Array,
        end: Array,
        boxes: NDArray[np.int32] | None = None,
        own: NDArray[np.integer] | None = None,
    ) -> NDArray[np.int32]:
        """(n,) the first box of each segment by the slab test against all, or some, but its own."""
        if boxes is None:
            boxes = np.flatnonzero(self._visible).astype(np.int32)
        hit = np.full(len(start), -1, dtype=np.int32)
        if not len(boxes):
            return hit
        step = max(1, _PAIRS // len(boxes))
        for first in range(0, len(start), step):
            part = slice(first, first + step)
            enter = self._enter(start[part, None], end[part, None], boxes)
            if own is not None:
                enter[boxes == own[part, None]] = np.inf
            nearest = np.argmin(enter, axis=1)
            met = np.isfinite(enter[np.arange(len(enter)), nearest])
            hit[part] = np.where(met, boxes[nearest], -1)
        return hit

    def _enter(self, start: Array, end: Array, box: NDArray[np.int32]) -> Array:
        """Fraction of each segment at which it enters its (grown) box, inf where it misses it.

        Slab test: inside a box is inside all three pairs of its planes. `start`, `end` (…, 3) and
        `box` (…) are broadcast.
        """
        origin = self._to_own_frame(start - self._center[box], box)
        step = self._to_own_frame(end - start, box)
        # A ray parallel to a face divides by zero: ±inf is right between the planes or beyond
        # them; 0/0, on the plane itself, counts as between.
        with np.errstate(divide="ignore", invalid="ignore"):
            low = (-self._half[box] - origin) / step
            high = (self._half[box] - origin) / step
        near = np.fmin(low, high)
        far = np.fmax(low, high)
        on_plane = np.isnan(low) | np.isnan(high)
        near = np.where(on_plane, -np.inf, near).max(axis=-1)
        far = np.where(on_plane, np.inf, far).min(axis=-1)
        near = np.maximum(near, 0.0)
        return np.where(near <= np.minimum(far, 1.0), near, np.inf)

    def _to_own_frame(self, vector: Array, box: NDArray[np.int32]) -> Array:
        """Vectors (…, 3) turned by minus the yaw of their box (…)."""
        cos, sin = np.cos(self._yaw[box]), np.sin(self._yaw[box])
        x, y = vector[..., 0], vector[..., 1]
        z = np.broadcast_to(vector[..., 2], np.broadcast_shapes(x.shape, cos.shape))
        return np.stack((cos * x + sin * y, cos * y - sin * x, z), axis=-1)

    def _around(self, point: Array) -> NDArray[np.int32]:
        """(n,) a box that contains each point, as large as it is in PyBullet, or −1."""
        # Rays come in runs from one access point; each run is tested once, and as long as nothing
        # moves each point once and for all.
        new = np.ones(len(point), dtype=np.bool_)
        new[1:] = (point[1:] != point[:-1]).any(axis=1)
        starts = np.ascontiguousarray(point[new])
        keys = [start.tobytes() for start in starts]
        if self._bodies or len(self._known_starts) > _KNOWN_STARTS:
            self._known_starts.clear()
        unknown = [k for k, key in enumerate(keys) if key not in self._known_starts]
        if unknown:
            seen = np.flatnonzero(self._visible).astype(np.int32)
            boxes = Boxes(("",) * len(seen), self._center[seen], self._half[seen], self._yaw[seen])
            found = contains(boxes, starts[unknown], grow_m=GUARD_M)
            holders = np.append(seen, np.int32(-1))[found].tolist()
            self._known_starts.update(zip((keys[k] for k in unknown), holders, strict=True))
        box = np.array([self._known_starts[key] for key in keys], dtype=np.int32)
        return np.asarray(box[np.cumsum(new) - 1])

    def visible_boxes(self) -> tuple[NDArray[np.int32], Boxes]:
        """What rays meet now, moving bodies too: as `cast` numbers it, as large as rays find it."""
        seen = np.flatnonzero(self._visible).astype(np.int32)
        boxes = Boxes(("",) * len(seen), self._center[seen], self._half[seen], self._yaw[seen])
        return seen, boxes

    # Moving bodies

    def add_body(
        self,
        center_m: Sequence[float],
        half_m: Sequence[float],
        yaw_rad: float = 0.0,
        *,
        hidden: bool = False,
    ) -> int:
        """Put a further box into the scene, grown like the others.

        Args:
            center_m: (3,) [m].
            half_m: (3,) half extents before the turn [m].
            yaw_rad: turn about the vertical.
            hidden: rays pass through it (a robot that must not block radio).

        Returns:
            Its handle: what `cast` reports for it; never given again.
        """
        handle = self._static + len(self._bodies)
        self._center = np.vstack((self._center, np.asarray(center_m, dtype=np.float64)))
        self._half = np.vstack((self._half, np.asarray(half_m, dtype=np.float64) + self.grow_m))
        self._yaw = np.append(self._yaw, float(yaw_rad))
        self._visible = np.append(self._visible, False)
        (body,) = self._create(np.array([handle]))
        self._bodies.append(body)
        self.hide_body(handle, hidden)
        return handle

    def move_body(self, handle: int, center_m: Sequence[float], yaw_rad: float = 0.0) -> None:
        """Place a body anew; ValueError when there is none of that handle."""
        body = self._body(handle)
        self._center[handle] = center_m
        self._yaw[handle] = yaw_rad
        self._pb.resetBasePositionAndOrientation(
            body,
            self._center[handle].tolist(),
            _quaternion(yaw_rad),
            physicsClientId=self._client,
        )

    def hide_body(self, handle: int, hidden: bool = True) -> None:
        """Let rays pass through a body, or meet it again; ValueError for an unknown handle."""
        group = _HIDDEN if hidden else _MOVING
        self._pb.setCollisionFilterGroupMask(
            self._body(handle), -1, group, -1, physicsClientId=self._client
        )
        self._visible[handle] = not hidden

    def remove_body(self, handle: int) -> None:
        """Take a body out for good; ValueError when there is none of that handle."""
        self._pb.removeBody(self._body(handle), physicsClientId=self._client)
        self._bodies[handle - self._static] = -1
        self._visible[handle] = False

    def _body(self, handle: int) -> int:
        """PyBullet's id of a moving body."""
        place = handle - self._static
        if not 0 <= place < len(self._bodies) or self._bodies[place] < 0:
            raise ValueError(f"the scene has no moving body {handle}")
        return self._bodies[place]

    # Creation

    def _create_static(self) -> None:
        """All boxes, those of one size and turn together (10 times faster than one by one)."""
        kinds = np.column_stack((self._half, self._yaw))
        _, kind_of = np.unique(kinds, axis=0, return_inverse=True)
        order = np.argsort(kind_of.ravel(), kind="stable")
        ends = np.flatnonzero(np.diff(kind_of.ravel()[order])) + 1
        for kind in np.split(order, ends):
            for first in range(0, len(kind), MAX_BATCH):
                self._create(kind[first : first + MAX_BATCH])

    def _create(self, boxes: NDArray[np.intp]) -> list[int]:
        """Bodies for boxes of one size and turn; PyBullet's ids of them."""
        if not len(boxes):
            return []
        model = boxes[0]
        shape = self._pb.createCollisionShape(
            self._pb.GEOM_MESH,
            vertices=(_CORNERS * (self._half[model] + GUARD_M)).tolist(),
            indices=_TRIANGLES,
            flags=self._pb.GEOM_FORCE_CONCAVE_TRIMESH,
            physicsClientId=self._client,
        )
        ids = self._pb.createMultiBody(
            baseMass=0,
            baseCollisionShapeIndex=shape,
            batchPositions=self._center[boxes].tolist(),
            baseOrientation=_quaternion(float(self._yaw[model])),
            physicsClientId=self._client,
        )
        if not isinstance(ids, tuple) or len(ids) != len(boxes):
            raise RuntimeError(f"PyBullet created {ids} instead of {len(boxes)} bodies")
        missing = max(ids) + 1 - len(self._box_of)
        if missing > 0:
            self._box_of = np.append(self._box_of, np.full(missing, -1, dtype=np.int32))
        self._box_of[list(ids)] = boxes
        return list(ids)


def ray_growth_m(world: World) -> float:
    """How much larger than drawn the world's boxes are for rays [m]."""
    return GROW_M + world.radio.clearance_m


def _quaternion(yaw_rad: float) -> list[float]:
    """PyBullet's (x, y, z, w) of a turn about the vertical."""
    return [0.0, 0.0, float(np.sin(yaw_rad / 2)), float(np.cos(yaw_rad / 2))]


_IMPORT = threading.Lock()


def _pybullet() -> Any:
    """The module, imported without the line it prints."""
    with _IMPORT:
        if "pybullet" in sys.modules:
            return sys.modules["pybullet"]
        with _silence():
            import pybullet
        return pybullet


@contextmanager
def _silence() -> Iterator[None]:
    """Send what C code writes to standard output and error nowhere for a moment."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    kept: dict[int, int] = {}
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for stream_fd in (1, 2):
            try:
                kept[stream_fd] = os.dup(stream_fd)
            except OSError:  # closed, as in a daemon: nothing can be seen on it
                continue
            os.dup2(nowhere, stream_fd)
        yield
    finally:
        for stream_fd, copy in kept.items():
            os.dup2(copy, stream_fd)
            os.close(copy)
        os.close(nowhere)
