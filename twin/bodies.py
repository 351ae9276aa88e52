"""The bodies that move in the scene: blockages, and robots where they shade each other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from twin.disturbances import Disturbances
    from twin.motion import SlotMotion
    from worlds.scene import Scene
    from worlds.world import World

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

NO_BODY = -2
"""Handle of a robot that is not in the scene; −1 is what a ray that meets nothing says."""


class Bodies:
    """Puts the bodies of a run where they are at an instant.

    A blockage is in the scene from its first instant to its last one. Robots are in it if the world
    says that they block (`run.robots_block`) and are taller than their antenna.

    Attributes:
        scene: for rays.
    """

    def __init__(self, world: World, scene: Scene, disturbances: Disturbances) -> None:
        self.scene = scene
        self._disturbances = disturbances
        self._blockage: dict[int, int] = {}  # handles
        body = world.hall.body
        self._half = (body.length_m / 2.0, body.width_m / 2.0, body.height_m / 2.0)
        self._robots_block = world.run.robots_block and body.height_m > body.antenna_m
        self._robot: dict[int, int] = {}  # handles
        self._bodies: Ints = np.empty(0, np.int32)

    def handle(self, body: NDArray[np.intp]) -> Ints:
        """(m,) handle in the scene of each body of the motion placed last, NO_BODY if none."""
        if not self._robots_block:
            return np.full(len(body), NO_BODY, np.int32)
        return self._bodies[body]

    def place(self, slot: int, step: int, motion: SlotMotion, xy_m: Floats) -> None:
        """Put all bodies where they are at an instant.

        Args:
            slot, step: the instant.
            motion: of the n robots on the floor.
            xy_m: (n, 2) where they are [m].
        """
        self._place_blockages(slot, step)
        if self._robots_block:
            self._place_robots(motion, xy_m)

    def _place_blockages(self, slot: int, step: int) -> None:
        disturbances = self._disturbances
        if not disturbances.blockages:
            return
        there = disturbances.present(slot, step)
        for k in [k for k in self._blockage if k not in there]:
            self.scene.remove_body(self._blockage.pop(k))
        boxes = disturbances.boxes(slot, step)
        for k, center, half, yaw in zip(
            there, boxes.center_m, boxes.half_m, boxes.yaw_rad.tolist(), strict=True
        ):
            if k in self._blockage:
                self.scene.move_body(self._blockage[k], center, yaw)
            else:
                self._blockage[k] = self.scene.add_body(center, half, yaw)

    def _place_robots(self, motion: SlotMotion, xy_m: Floats) -> None:
        robots = motion.robot.tolist()
        for i in [i for i in self._robot if i not in set(robots)]:
            self.scene.remove_body(self._robot.pop(i))
        for i, (x, y), yaw in zip(robots, xy_m.tolist(), motion.heading_rad.tolist(), strict=True):
            center = (x, y, self._half[2])
            if i in self._robot:
                self.scene.move_body(self._robot[i], center, yaw)
            else:
                self._robot[i] = self.scene.add_body(center, self._half, yaw)
        self._bodies = np.array([self._robot[i] for i in robots], np.int32)


def touched_blockages(
    disturbances: Disturbances, slot: int, instants: Floats, motion: SlotMotion
) -> dict[int, str]:
    """The bodies that touch a blockage at some instant of a slot, and its name.

    Args:
        disturbances: of the run.
        slot: which.
        instants: (s,) its instants, as fractions of it.
        motion: of the n bodies in it.
    """
    found: dict[int, str] = {}
    for step, fraction in enumerate(instants.tolist()):
        boxes = disturbances.boxes(slot, step)
        if len(boxes):
            places = motion.xy_m(np.array([fraction]))[:, 0]
            hit = disturbances.touched(boxes, places, motion.heading_rad)
            for k in np.flatnonzero(hit >= 0).tolist():
                found.setdefault(k, boxes.name[hit[k]])
    return found
