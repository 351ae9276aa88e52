"""Step 3 of validation, what moves in the scene: blockages as told, robots where they shade."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from logs.validate_context import Context, Floats, Ints
from worlds.link import LinkModel

if TYPE_CHECKING:
    from logs.validate_disturbances import DisturbanceCheck, Truth
    from worlds.scene import Scene

_NOTHING = -2


class Bodies:
    """Puts the bodies of a sample into the validator's own scene, and casts rays there.

    Attributes:
        needed: something moves in this run.
    """

    def __init__(
        self, context: Context, scene: Scene, truth: Truth, disturbances: DisturbanceCheck
    ) -> None:
        self._scene, self._told = scene, disturbances
        self._links = LinkModel(context.inputs.world)
        body = context.inputs.world.hall.body
        self._half = (body.length_m / 2.0, body.width_m / 2.0, body.height_m / 2.0)
        self._robots_block = truth.robots_block
        self.needed = truth.has_blockages or truth.robots_block
        self._added: list[int] = []
        self._own: dict[int, int] = {}

    def place(self, robot: Ints, xy_m: Floats, heading_rad: Floats) -> None:
        """Replace all bodies by those of a sample: n robots at (n, 2) [m], (n,) [rad]."""
        for handle in self._added:
            self._scene.remove_body(handle)
        boxes = self._told.boxes()
        self._added = [
            self._scene.add_body(center, half, yaw)
            for center, half, yaw in zip(
                boxes.center_m, boxes.half_m, boxes.yaw_rad.tolist(), strict=True
            )
        ]
        self._own = {}
        if self._robots_block:
            for i, (x, y), yaw in zip(
                robot.tolist(), xy_m.tolist(), heading_rad.tolist(), strict=True
            ):
                self._own[i] = self._scene.add_body((x, y, self._half[2]), self._half, yaw)
            self._added += self._own.values()

    def snr_db(self, robot: Sequence[int], ap: Ints, xy_m: Floats, fading_db: Floats) -> Floats:
        """(m,) SNR of robots from an AP each; their own bodies do not shade them [dB]."""
        antenna = self._links.antenna_m(xy_m)
        own = np.array([self._own.get(i, _NOTHING) for i in robot], dtype=np.int64)
        return self._links.measure(self._scene, ap, antenna, fading_db, own)[0]
