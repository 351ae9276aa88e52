"""Maps of other tools as grids of blocked cells, ready for `worlds.map_import`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from worlds.errors import Fault, WorldError
from worlds.formats.movingai import GridMap, Scenario, errands
from worlds.formats.ros_map import OCCUPIED, UNKNOWN, RosMap, pool_blocked
from worlds.map_import import (
    COARSER_PITCHES_M,
    FINER_PITCHES_M,
    KEPT_SHARE,
    MAX_CELLS,
    POSITIONS_PER_ROBOT,
    BlockedGrid,
    ImportParams,
    crop,
    largest_share,
    pitch_for,
)


@dataclass(frozen=True, eq=False)
class Pooled:
    """A map at a pitch.

    Attributes:
        blocked: (rows, columns), row 0 at the bottom.
        pitch_m: side of a cell.
        connected: cells of the largest connected free area.
        kept_share: its area as a share of what is free in the map.
    """

    blocked: NDArray[np.bool_]
    pitch_m: float
    connected: int
    kept_share: float


def ros_grid(
    ros_map: RosMap, params: ImportParams, *, unknown_is_free: bool = False
) -> tuple[BlockedGrid, list[str]]:
    """A ROS map at the pitch asked for, or at one that suits it; and what the user should know.

    Without a pitch the usual one is taken, a finer one where too little of the floor would be left
    for the fleet, a coarser one where there would be too many cells.
    """
    pixels = ros_map.blocked(unknown_is_free=unknown_is_free)
    pixel_m = ros_map.info.resolution_m
    name = ros_map.info.source
    if pixels.all():
        raise _error(name, _nothing_free(ros_map))
    if max(ros_map.size_m) > 5000:
        size = f"{ros_map.size_m[0]:g} m x {ros_map.size_m[1]:g} m"
        raise _error(name, f"the map measures {size}, more than 5 km; is resolution in metres?")
    if params.pitch_m is not None:
        if params.pitch_m < pixel_m:
            rule = f"--pitch {params.pitch_m:g} m is finer than the map's pixels of {pixel_m:g} m"
            raise _error(name, f"{rule}; give at least {pixel_m:g}")
        pooled = _pooled(pixels, pixel_m, params.pitch_m)
    else:
        pooled = _suitable(pixels, pixel_m, params)
    hints = []
    if pooled.connected and params.pitch_m is None and pooled.pitch_m != pitch_for(params.body_m):
        hints.append(
            f"pitch {pooled.pitch_m:g} m, chosen for this map: at {pitch_for(params.body_m):g} m "
            "it would be too coarse or have too many cells; --pitch and --body give your own"
        )
    if pooled.connected and pooled.kept_share < KEPT_SHARE:
        hints.append(
            f"{pooled.kept_share:.0%} of the free floor is left in one piece at a pitch of "
            f"{pooled.pitch_m:g} m, since a cell with any obstacle in it is blocked; a smaller "
            "--pitch keeps more"
        )
    blocked, (column, row) = crop(pooled.blocked)
    x, y = (
        origin + pooled.pitch_m * k
        for origin, k in zip(ros_map.info.origin_m, (column, row), strict=True)
    )
    rows, columns = ros_map.state.shape
    notes = (
        f"Imported from {Path(name).name}: {columns} x {rows} pixels of {pixel_m:g} m, "
        f"mode {ros_map.info.mode}.",
        f"A cell of {pooled.pitch_m:g} m is blocked if any pixel in it is occupied"
        + ("." if unknown_is_free else " or unknown."),
        f"Frame of the map: x_map = x {_signed(x)}, y_map = y {_signed(y)}.",
    )
    story = f"The map {Path(name).stem}, as a robot's sensors saw it."
    return BlockedGrid(blocked, pooled.pitch_m, story, notes), hints


def movingai_grid(
    grid: GridMap, params: ImportParams, scenario: Scenario | None = None
) -> tuple[BlockedGrid, list[str]]:
    """A MovingAI map, one cell a position; with a scenario its first robots' errands, too.

    Its (x, y) is column x of row `height − 1 − y`, since it counts from the upper left.
    """
    pitch = params.pitch_m or pitch_for(params.body_m)
    size = (grid.width * pitch, grid.height * pitch)
    if max(size) > 5000:
        rule = f"{grid.width} x {grid.height} cells of {pitch:g} m are more than 5 km"
        raise _error(grid.source, f"{rule}; give a smaller --pitch")
    notes = [
        f"Imported from {Path(grid.name).name}: {grid.width} x {grid.height} cells, "
        f"{pitch:g} m each.",
        f"Cell (x, y) of that map is column x of row {grid.height - 1} - y here.",
    ]
    pairs: list[tuple[tuple[int, int], tuple[int, int]]] = []
    if scenario is not None:
        notes.append(f"The robots are the first {params.robots} of {Path(scenario.source).name}.")
        starts, goals = errands(grid, scenario, params.robots)
        top = grid.height - 1
        pairs = [
            ((int(sx), int(top - sy)), (int(gx), int(top - gy)))
            for (sx, sy), (gx, gy) in zip(starts, goals, strict=True)
        ]
    blocked = np.ascontiguousarray(~grid.passable[::-1])
    story = f"The grid map {Path(grid.name).stem} of the MovingAI benchmarks' format."
    return BlockedGrid(blocked, pitch, story, tuple(notes), tuple(pairs)), []


def _suitable(pixels: NDArray[np.bool_], pixel_m: float, params: ImportParams) -> Pooled:
    """The map at the first pitch that suits it, from the usual one on."""
    usual = max(pitch_for(params.body_m), pixel_m)
    first = _pooled(pixels, pixel_m, usual)
    if first.blocked.size > MAX_CELLS:
        coarser = [p for p in COARSER_PITCHES_M if p > usual]
        found = first
        for pitch in coarser:
            found = _pooled(pixels, pixel_m, pitch)
            if found.blocked.size <= MAX_CELLS:
                break
        return found
    if params.body_m is not None or _suits(first, params):
        return first
    finer: list[Pooled] = [first]
    for pitch in FINER_PITCHES_M:
        if pixel_m <= pitch < usual:
            finer.append(_pooled(pixels, pixel_m, pitch))
            if crop(finer[-1].blocked)[0].size > MAX_CELLS:
                finer.pop()
                break
            if _suits(finer[-1], params):
                return finer[-1]
    return max(finer, key=lambda pooled: pooled.connected)


def _suits(pooled: Pooled, params: ImportParams) -> bool:
    room = pooled.connected >= POSITIONS_PER_ROBOT * params.robots
    return room and pooled.kept_share >= KEPT_SHARE


def _pooled(pixels: NDArray[np.bool_], pixel_m: float, pitch_m: float) -> Pooled:
    blocked = pool_blocked(pixels, pixel_m, pitch_m)
    connected, _ = largest_share(blocked)
    free_m2 = float((~pixels).sum()) * pixel_m**2
    return Pooled(blocked, pitch_m, connected, connected * pitch_m**2 / free_m2)


def _nothing_free(ros_map: RosMap) -> str:
    state = np.bincount(ros_map.state.ravel(), minlength=3)
    counted = f"{state[OCCUPIED]} are occupied, {state[UNKNOWN]} unknown"
    other = "1" if not ros_map.info.negate else "0"
    mend = f"is negate {other} meant? are the thresholds those of this image?"
    if state[UNKNOWN]:
        mend += " --unknown free takes unknown for free"
    return f"no pixel is free: {counted}; {mend}"


def _signed(metres: float) -> str:
    return f"{'-' if metres < 0 else '+'} {abs(round(metres, 6)):g}"


def _error(name: str, message: str) -> WorldError:
    return WorldError([Fault((), message)], [f"{name}: {message}"])


def parse_body(text: str) -> tuple[float, float]:
    """`0.8,0.6` → (0.8, 0.6): length and width [m].

    Raises:
        WorldError: anything else.
    """
    parts: Sequence[str] = text.split(",")
    try:
        sides = [float(part) for part in parts]
    except ValueError:
        sides = []
    if len(sides) != 2 or not all(0 < side <= 20 and math.isfinite(side) for side in sides):
        message = f"--body {text}: give length and width in metres, such as 0.8,0.6"
        raise WorldError([Fault((), message)])
    length, width = sides
    return length, width
