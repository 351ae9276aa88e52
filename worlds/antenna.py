"""How much less than at its boresight an access point sends in other directions.

The element of 3GPP TR 38.901 v16.1.0, table 7.3-1. With θ″ the zenith angle and φ″ the azimuth in
the antenna's own frame (boresight θ″ = 90°, φ″ = 0°), W the width of the beam between the
directions of half power (65°) and M the front-to-back ratio (30 dB):

    A_v = −min(12 ((θ″ − 90°) / W)², M),  A_h = −min(12 (φ″ / W)², M),  A = −min(−(A_v + A_h), M)

The own frame is the hall's, turned by the azimuth about the vertical and then tilted down (clause
7.1.3, with bearing and downtilt, no slant).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from worlds.world import Antenna

Array = NDArray[np.float64]


def pattern_db(antenna: Antenna, away_m: Array) -> Array:
    """Gain relative to the boresight's in each direction [dB], from −`front_to_back_db` to 0.

    Args:
        antenna: where it points and how wide.
        away_m: (n, 3) from the antenna to the receivers [m]; a receiver at its very place counts as
            at the boresight.

    Returns:
        (n,) float64.
    """
    zenith_deg, azimuth_deg = own_angles_deg(antenna, away_m)
    most, width = antenna.front_to_back_db, antenna.beamwidth_deg
    vertical = np.minimum(12.0 * ((zenith_deg - 90.0) / width) ** 2, most)
    horizontal = np.minimum(12.0 * (azimuth_deg / width) ** 2, most)
    return np.asarray(-np.minimum(vertical + horizontal, most))


def own_angles_deg(antenna: Antenna, away_m: Array) -> tuple[Array, Array]:
    """Zenith angle [0 … 180°] and azimuth [−180 … 180°] in the antenna's frame, each (n,)."""
    x, y, z = (away_m @ _frame(antenna)).T
    length = np.linalg.norm(away_m, axis=1)
    here = length == 0.0
    zenith = np.degrees(np.arccos(np.clip(z / np.where(here, 1.0, length), -1.0, 1.0)))
    return np.where(here, 90.0, zenith), np.where(here, 0.0, np.degrees(np.arctan2(y, x)))


def _frame(antenna: Antenna) -> Array:
    """(3, 3) the antenna's own x (boresight), y and z axes as columns."""
    bearing, down = np.radians(antenna.azimuth_deg), np.radians(antenna.tilt_deg)
    cos_b, sin_b, cos_d, sin_d = np.cos(bearing), np.sin(bearing), np.cos(down), np.sin(down)
    boresight = (cos_d * cos_b, cos_d * sin_b, -sin_d)
    left = (-sin_b, cos_b, 0.0)
    up = (sin_d * cos_b, sin_d * sin_b, cos_d)
    return np.array([boresight, left, up], dtype=np.float64).T
