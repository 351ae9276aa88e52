"""Where access points could hang: on a grid under the ceiling, along the walls, or as listed."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from worlds.boxes import contains
from worlds.errors import Fault, WorldError
from worlds.floor import Floor
from worlds.scene import ray_growth_m
from worlds.world import AccessPoint, World

Array = NDArray[np.float64]

MOUNTS = 300
"""About so many places a grid has whose distance is not given."""

MAX_MOUNTS = 20_000

APART_M = 0.1
"""No new access point hangs nearer than this to one that is there [m]."""


def usual_height_m(world: World) -> float:
    """The height at which most access points of the world hang, the greater of equals [m].

    Raises:
        WorldError: there is none.
    """
    heights = Counter(ap.position_m[2] for ap in world.ap)
    if not heights:
        message = "there is no access point to take the height from; give it (--height)"
        raise WorldError([Fault(("ap",), message)])
    return max(heights, key=lambda height: (heights[height], height))


def grid_spacing_m(world: World) -> float:
    """A spacing, whole half metres, at which a grid has about `MOUNTS` places [m]."""
    width, depth = world.hall.size_m
    return max(0.5, math.ceil(2.0 * math.sqrt(width * depth / MOUNTS)) / 2.0)


def grid_m(world: World, spacing_m: float) -> Array:
    """(n, 2) a grid over the hall, as far from opposite walls [m], row by row."""
    sides = []
    for size in world.hall.size_m:
        count = max(1, math.floor(size / spacing_m + 1e-9))
        sides.append((size - (count - 1) * spacing_m) / 2 + spacing_m * np.arange(count))
    _check_number(len(sides[0]) * len(sides[1]), spacing_m)
    return np.column_stack((np.tile(sides[0], len(sides[1])), np.repeat(sides[1], len(sides[0]))))


def walls_m(world: World, spacing_m: float) -> Array:
    """(n, 2) places on the four walls, corners included, at most `spacing_m` apart [m]."""
    width, depth = world.hall.size_m
    parts = [max(1, math.ceil(size / spacing_m - 1e-9)) for size in (width, depth)]
    _check_number(2 * sum(parts), spacing_m)
    x = width * np.arange(parts[0] + 1) / parts[0]
    y = depth * np.arange(1, parts[1]) / parts[1]
    south, north = (np.column_stack((x, np.full(len(x), at))) for at in (0.0, depth))
    west, east = (np.column_stack((np.full(len(y), at), y)) for at in (0.0, width))
    return np.concatenate((south, west, east, north))


def _check_number(mounts: int, spacing_m: float) -> None:
    if mounts > MAX_MOUNTS:
        message = f"{spacing_m:g} m apart makes {mounts} mounts, more than {MAX_MOUNTS}"
        raise WorldError([Fault((), f"{message}; space them wider")])


def read_mounts(path: Path, height_m: float) -> list[tuple[float, float, float]]:
    """Mounts from a CSV file with the columns x_m, y_m and, if it has one, height_m.

    Raises:
        WorldError: with every line that is wrong.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        why = (getattr(error, "strerror", None) or "is not UTF-8 text").lower()
        raise WorldError([Fault((), f"{path}: {why}; give a CSV file of mounts")]) from None
    reader = csv.DictReader(text.splitlines())
    if not {"x_m", "y_m"} <= set(reader.fieldnames or ()):
        message = f"{path}:1: the first line must name the columns x_m,y_m or x_m,y_m,height_m"
        raise WorldError([Fault((), message)])
    found, faults = [], []
    for row in reader:
        try:
            place = (float(row["x_m"]), float(row["y_m"]), float(row.get("height_m") or height_m))
            if not all(map(math.isfinite, place)):
                raise ValueError
            found.append(place)
        except (TypeError, ValueError):
            message = f"{path}:{reader.line_num}: x_m, y_m and height_m must be numbers"
            faults.append(Fault((), message))
    if not faults and not found:
        faults.append(Fault((), f"{path}: names no mount; give a line for each"))
    if faults:
        raise WorldError(faults)
    return found


def mounts(
    world: World, floor: Floor, positions_m: Iterable[tuple[float, float, float]]
) -> tuple[AccessPoint, ...]:
    """An access point of the world's `[radio]` at each place where one can hang.

    Left out are places outside the hall, in an obstacle as rays see it, where an access point that
    is on hangs already, and repetitions. The id says where it hangs, `x12.5y30`, so that shadow
    fading, drawn from ids, is the same whichever others are chosen.

    Raises:
        WorldError: none is left.
    """
    (width, depth), growth = world.hall.size_m, ray_growth_m(world)
    places = np.array(list(positions_m), dtype=np.float64).reshape(-1, 3)
    places = np.round(places, 3)
    there = np.array([ap.position_m for ap in world.ap if ap.enabled]).reshape(-1, 3)
    inside = (places[:, :2] >= 0).all(axis=1) & (places[:, :2] <= (width, depth)).all(axis=1)
    inside &= contains(floor.boxes, places, grow_m=growth) < 0
    if len(there) and len(places):
        away = np.linalg.norm(places[:, None] - there[None], axis=2).min(axis=1)
        inside &= away >= APART_M
    taken = {ap.id for ap in world.ap}
    found: dict[tuple[float, ...], AccessPoint] = {}
    for place in places[inside].tolist():
        x, y, z = place
        name = f"x{x:.10g}y{y:.10g}"
        while name in taken:
            name += "'"
        if tuple(place) not in found:
            taken.add(name)
            found[tuple(place)] = AccessPoint(id=name, position_m=(x, y, z))
    if not found:
        message = (
            f"none of the {len(places)} mounts is in the hall, free of obstacles and {APART_M:g} m "
            "from every access point that hangs there; give others"
        )
        raise WorldError([Fault(("ap",), message)])
    return tuple(found.values())
