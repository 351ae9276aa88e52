"""Halls for the radio tests, put together by hand: no file, no draw, no generator."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from worlds.floor import Boxes, Floor
from worlds.world import AccessPoint, Body, Hall, Place, Radio, Robot, World


def boxes(
    center_m: ArrayLike = (), half_m: ArrayLike = (0.5, 0.5, 1.0), yaw_rad: ArrayLike = 0.0
) -> Boxes:
    """Boxes called b0, b1, …; one half extent or yaw may stand for all."""
    center = np.asarray(center_m, dtype=float).reshape(-1, 3)
    half = np.broadcast_to(np.asarray(half_m, dtype=float), center.shape).copy()
    yaw = np.broadcast_to(np.asarray(yaw_rad, dtype=float), len(center)).copy()
    return Boxes(tuple(f"b{i}" for i in range(len(center))), center, half, yaw)


def random_boxes(
    rng: np.random.Generator, count: int, hall_m: float, *, yawed: bool = True
) -> Boxes:
    """Boxes of all sizes between 10 cm and a tenth of the hall, anywhere up to 2 m high."""
    center = np.column_stack((rng.uniform(0, hall_m, (count, 2)), rng.uniform(0.3, 2.0, count)))
    half = np.exp(rng.uniform(np.log(0.05), np.log(hall_m / 20), (count, 3)))
    yaw = rng.uniform(-np.pi, np.pi, count) if yawed else 0.0
    return boxes(center, half, yaw)


def grid_floor(
    columns: int,
    rows: int,
    pitch_m: float = 1.0,
    *,
    standing: Boxes | None = None,
    blocked: Iterable[tuple[int, int]] = (),
    origin_m: tuple[float, float] = (0.0, 0.0),
) -> Floor:
    """A grid of positions with all moves between neighbours, but for the blocked ones."""
    gone = set(blocked)
    cells = [(c, r) for r in range(rows) for c in range(columns) if (c, r) not in gone]
    vertex = {cell: index for index, cell in enumerate(cells)}
    steps = [((c, r), (c + 1, r)) for c, r in cells] + [((c, r), (c, r + 1)) for c, r in cells]
    uv = sorted((vertex[a], vertex[b]) for a, b in steps if b in vertex)
    none = np.empty(0, dtype=np.int32)
    return Floor(
        pitch_m=pitch_m,
        slot_s=pitch_m,
        columns=columns,
        rows=rows,
        boxes=standing or boxes(),
        vertex_xy_m=np.array(cells, dtype=float).reshape(-1, 2) * pitch_m + origin_m,
        vertex_cell=np.array(cells, dtype=np.int32).reshape(-1, 2),
        edge_uv=np.array(uv, dtype=np.int32).reshape(-1, 2),
        edge_slots=np.ones(len(uv), dtype=np.int32),
        edge_oneway=np.zeros(len(uv), dtype=np.bool_),
        robot_ids=(),
        start=none,
        goal=none,
    )


def ap(name: str, x: float, y: float, z: float = 5.0, **rest: object) -> AccessPoint:
    """An access point."""
    return AccessPoint(id=name, position_m=(x, y, z), **rest)  # type: ignore[arg-type]


def world(
    aps: Sequence[AccessPoint],
    size_m: tuple[float, float] = (60.0, 60.0),
    *,
    antenna_m: float = 0.5,
    **radio: object,
) -> World:
    """A world of which only the APs, the radio and the antenna matter."""
    return World(
        name="test",
        hall=Hall(size_m=size_m, pitch_m=1.0, body=Body(antenna_m=antenna_m)),
        ap=tuple(aps),
        radio=Radio(**radio),  # type: ignore[arg-type]
        robot=(Robot(id="r", start=Place(cell=(0, 0)), goal=Place(cell=(1, 0))),),
    )
