"""Blockages of a run in time: where each box is at an instant, and what it sweeps in a span."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twin.association import nanoseconds
from worlds.boxes import TOUCH_M, swept
from worlds.events import Event
from worlds.floor import Boxes

Floats = NDArray[np.float64]

NEVER_NS = 2**62
"""The end of what lasts to the end of the run."""


def end_ns(event: Event) -> int:
    """When an event is over."""
    return NEVER_NS if event.to_s is None else nanoseconds(event.to_s)


@dataclass(frozen=True)
class Blockage:
    """A box in the way.

    Attributes:
        name: in messages.
        size_m: along its heading and across [m].
        z_m, height_m: of its centre, and of the box [m].
        from_ns, to_ns: when it is there.
        times_s: (k,) when it is at each way-point, ascending.
        way_m: (k, 2) the way-points; one for a blockage that stands.
        yaw_rad: (k,) heading from each way-point on.
    """

    name: str
    size_m: tuple[float, float]
    z_m: float
    height_m: float
    from_ns: int
    to_ns: int
    times_s: Floats
    way_m: Floats
    yaw_rad: Floats

    @classmethod
    def of(cls, event: Event, name: str) -> Blockage:
        """What an event of kind "blockage" declares."""
        assert event.size_m is not None  # the model asks for it
        way = np.array(event.way_m or [event.center_m], np.float64)
        legs = np.diff(way, axis=0)
        lengths = np.hypot(legs[:, 0], legs[:, 1])
        times = event.from_s + np.concatenate([[0.0], np.cumsum(lengths)]) / event.speed_m_s
        yaw = np.arctan2(legs[:, 1], legs[:, 0])
        yaw = np.append(yaw, yaw[-1]) if len(yaw) else np.array([math.radians(event.yaw_deg)])
        z = event.base_m + event.height_m / 2.0
        return cls(
            name,
            event.size_m,
            z,
            event.height_m,
            nanoseconds(event.from_s),
            end_ns(event),
            times,
            way,
            yaw,
        )

    def there(self, t_ns: int) -> bool:
        """Whether it is there at an instant."""
        return self.from_ns <= t_ns < self.to_ns

    def moves(self, begin_s: float, end_s: float) -> bool:
        """Whether it moves within a span of time."""
        return bool(begin_s < self.times_s[-1] and end_s > self.times_s[0])

    def pose(self, t_s: float) -> tuple[float, float, float]:
        """x, y [m] and yaw [rad] at a time, by linear motion between way-points."""
        k = int(np.clip(np.searchsorted(self.times_s, t_s, "right") - 1, 0, len(self.way_m) - 1))
        x, y = self.way_m[k]
        if k + 1 < len(self.way_m):
            span = self.times_s[k + 1] - self.times_s[k]
            share = min(max((t_s - self.times_s[k]) / span, 0.0), 1.0)
            x, y = (1.0 - share) * self.way_m[k] + share * self.way_m[k + 1]
        return float(x), float(y), float(self.yaw_rad[k])

    def sweeps(self, begin_s: float, end_s: float) -> tuple[Floats, Floats, Floats]:
        """Centres (s, 2), half extents (s, 2), yaws (s,) of the strips covered in a span."""
        inner = self.times_s[(self.times_s > begin_s) & (self.times_s < end_s)]
        stops = [begin_s, *inner.tolist(), end_s]
        strips = [(*self.pose(a)[:2], *self.pose(b)[:2]) for a, b in pairwise(stops)]
        legs = np.array(strips).reshape(-1, 4)
        center, half, yaw = swept(legs[:, :2], legs[:, 2:], *self.size_m)
        still = np.hypot(*(legs[:, 2:] - legs[:, :2]).T) <= TOUCH_M
        yaw[still] = [self.pose(t)[2] for t, flag in zip(stops, still, strict=False) if flag]
        return center, half, yaw


def strips(of: Iterable[tuple[Blockage, tuple[Floats, Floats, Floats]]]) -> Boxes:
    """The strips as boxes."""
    names, centers, halves, yaws = list[str](), list[Floats](), list[Floats](), list[float]()
    for b, (center, half, yaw) in of:
        for c, h, phi in zip(center, half, yaw, strict=True):
            names.append(b.name)
            centers.append(np.array([*c, b.z_m]))
            halves.append(np.array([*h, b.height_m / 2.0]))
            yaws.append(float(phi))
    return Boxes(
        tuple(names),
        np.array(centers).reshape(-1, 3),
        np.array(halves).reshape(-1, 3),
        np.array(yaws),
    )
