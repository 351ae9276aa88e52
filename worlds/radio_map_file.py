"""A radio map as bytes, and the key under which they can be kept."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

import numpy as np

from worlds import npz
from worlds.world import World

if TYPE_CHECKING:
    from worlds.radio_map import RadioMap

FORMAT = "mapp-radio-map/1"

DTYPES: dict[str, type[np.generic]] = {
    "snr_db": np.float64,
    "los": np.bool_,
    "blocker": np.int32,
    "edge_snr_db": np.float64,
    "fading_db": np.float64,
}
"""The arrays of a map and their types, in the order in which they are written."""

SCALARS = {"ap_ids": ("U", 1), "threshold_db": ("f", 0), "edge_rule": ("U", 0)}
"""The other fields: kind of numpy type, number of dimensions."""


def to_bytes(radio_map: RadioMap) -> bytes:
    """The map as an `.npz` archive; equal maps give equal bytes."""
    scalars = {
        "format": np.array(FORMAT),
        "ap_ids": np.array(radio_map.ap_ids, dtype=np.str_),
        "threshold_db": np.array(radio_map.threshold_db, dtype=np.float64),
        "edge_rule": np.array(radio_map.edge_rule),
    }
    return npz.pack({**scalars, **{name: getattr(radio_map, name) for name in DTYPES}})


def from_bytes(data: bytes) -> dict[str, Any]:
    """The fields of the `RadioMap` that was written.

    Raises:
        ValueError: what is wrong with the bytes, in words.
    """
    arrays = npz.unpack(data)
    if missing := [name for name in ("format", *SCALARS, *DTYPES) if name not in arrays]:
        raise ValueError(f"{missing[0]} is missing")
    if str(arrays["format"]) != FORMAT:
        raise ValueError(f"its format is {str(arrays['format'])!r}, not {FORMAT!r}")
    for name, (kind, dimensions) in SCALARS.items():
        array = arrays[name]
        if array.dtype.kind != kind or array.ndim != dimensions:
            raise ValueError(f"{name} has type {array.dtype} and shape {array.shape}")
    for name, dtype in DTYPES.items():
        if arrays[name].dtype != np.dtype(dtype):
            raise ValueError(f"{name} has type {arrays[name].dtype}, not {dtype.__name__}")
    return {
        "ap_ids": tuple(arrays["ap_ids"].tolist()),
        "threshold_db": float(arrays["threshold_db"]),
        "edge_rule": str(arrays["edge_rule"]),
        **{name: arrays[name] for name in DTYPES},
    }


def radio_key(world: World) -> str:
    """A hash of all that the radio map depends on: equal keys, equal maps.

    Stations, robots, plan and run do not count, nor what only matters later (capacities, rates).
    Whatever is not known to be irrelevant does, so that a key added to worlds some day can cost a
    needless computation but never give a wrong map.
    """
    content = world.model_dump(
        mode="json",
        exclude={
            "format": True,
            "name": True,
            "story": True,
            "station": True,
            "robot": True,
            "robots": True,
            "plan": True,
            "run": True,
            "hall": {"slot_s", "speed_m_s"},
            "obstacle": {"__all__": {"name"}},
            "radio": {
                "ap_capacity",
                "bandwidth_mhz",
                "efficiency",
                "rate_cap_mbps",
                "rate_sharing",
            },
            "ap": {"__all__": {"capacity"}},
        },
    )
    text = json.dumps([FORMAT, content], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
