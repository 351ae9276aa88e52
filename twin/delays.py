"""Delays by chance, drawn from each robot's own streams (the rules stand in `worlds.events`)."""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from worlds.events import DELAYS_STREAM, LENGTHS_STREAM
from worlds.streams import stream

if TYPE_CHECKING:
    from worlds.world import World

Floats = NDArray[np.float64]

_CHUNK = 256  # random numbers drawn at once


class DelayDraws:
    """The delays of all robots by chance, slot after slot (see `worlds.events`)."""

    def __init__(self, world: World, robot_ids: tuple[str, ...]) -> None:
        self._delays = world.delays
        seed = world.run.seed
        self._luck = [stream(seed, DELAYS_STREAM, name) for name in robot_ids]
        self._length = [stream(seed, LENGTHS_STREAM, name) for name in robot_ids]
        p = self._delays.p_delay
        self._chance = p if self._delays.delay_event == "bernoulli" else -math.expm1(-p)
        self._first = -_CHUNK  # slot of the chunk's first column
        self._numbers: Floats = np.empty((2, len(robot_ids), 0))

    def begin(self, slot: int) -> list[tuple[int, int]]:
        """(robot, slots) of the delays that begin in a slot; slots are asked for in order."""
        while slot >= self._first + _CHUNK:
            self._numbers = np.array(
                [[rng.random(_CHUNK) for rng in rngs] for rngs in (self._luck, self._length)]
            )
            self._first += _CHUNK
        luck, length = self._numbers[:, :, slot - self._first]
        return [
            (int(i), self._slots(float(length[i])))
            for i in np.flatnonzero(luck < self._chance).tolist()
        ]

    def _slots(self, w: float) -> int:
        low, high = self._delays.min_delay, self._delays.max_delay
        if self._delays.delay_time == "uniform":
            return low + math.floor(w * (high - low + 1))
        if low == high or not 0.0 < w < 1.0:
            return low
        length = NormalDist((low + high) / 2.0, (high - low) / 6.0).inv_cdf(w)
        return min(max(round(length), low), high)
