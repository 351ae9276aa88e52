"""Step 2 of validation, the radio map: derived anew from the world the log carries.

Rays are cast in a fresh scene; shadow fading is drawn again from its seed, and measurements are
read again from the survey that the world embeds. What the attached map says must be what comes out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from logs.findings import Checks
from worlds.floor import Floor
from worlds.radio_map import RadioMap, build_radio_map
from worlds.world import World

DECIBELS = 1e-6
"""SNRs that differ by more are different: transforms of a correlated field round differently."""

RULE = "page6:radio-map"
_SHOWN = 3


def check_radio_map(world: World, floor: Floor, radio_map: RadioMap, checks: Checks) -> None:
    """Compare a map with the one its world gives; shapes and APs have been found equal before."""
    checks.count(2, RULE, radio_map.snr_db.size + radio_map.edge_snr_db.size)
    try:
        expected = build_radio_map(world, floor)
    except ValueError as error:
        checks.find(2, RULE, f"the world gives no radio map: {error}", "one")
        return
    for name in ("snr_db", "edge_snr_db", "fading_db"):
        found, wanted = getattr(radio_map, name), getattr(expected, name)
        _compare(name, found, wanted, np.abs(found - wanted) > DECIBELS, checks)
    for name in ("los", "blocker"):
        found, wanted = getattr(radio_map, name), getattr(expected, name)
        _compare(name, found, wanted, found != wanted, checks)


def _compare(
    name: str,
    found: NDArray[np.generic],
    wanted: NDArray[np.generic],
    wrong: NDArray[np.bool_],
    checks: Checks,
) -> None:
    places = np.argwhere(wrong)
    if not len(places):
        return
    shown = ", ".join(
        f"{p.tolist()}: {found[tuple(p)]} instead of {wanted[tuple(p)]}" for p in places[:_SHOWN]
    )
    more = f" and {len(places) - _SHOWN} more" if len(places) > _SHOWN else ""
    checks.find(2, RULE, f"{name} at {shown}{more}", "what the world gives, derived anew")
