"""The floor as numbers: resolved obstacles, positions, the graph of free moves, the errands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Boxes:
    """Boxes standing in the hall (obstacles).

    Attributes:
        name: (B,) what each is called in messages.
        center_m: (B, 3) float64, centres.
        half_m: (B, 3) float64, half extents before the turn.
        yaw_rad: (B,) float64, turn about the vertical through the centre.
    """

    name: tuple[str, ...]
    center_m: NDArray[np.float64]
    half_m: NDArray[np.float64]
    yaw_rad: NDArray[np.float64]

    def __len__(self) -> int:
        """Number of boxes."""
        return len(self.name)


@dataclass(frozen=True)
class Floor:
    """Everything the world's geometry resolves to, before any radio.

    Vertices are the free positions (no obstacle within a robot standing there), edges the free
    moves between them (no obstacle within the strip the robot sweeps).

    Attributes:
        pitch_m, slot_s: grid pitch [m] and slot length [s].
        columns, rows: of the grid of positions, blocked ones included.
        boxes: listed and drawn obstacles.
        vertex_xy_m: (V, 2) float64.
        vertex_cell: (V, 2) int32, (column, row) of each vertex.
        edge_uv: (E, 2) int32, u < v.
        edge_slots: (E,) int32, traversal time in slots.
        edge_oneway: (E,) bool, crossed from u to v only.
        robot_ids: (N,) names.
        start, goal: (N,) int32, vertices.
    """

    pitch_m: float
    slot_s: float
    columns: int
    rows: int
    boxes: Boxes
    vertex_xy_m: NDArray[np.float64]
    vertex_cell: NDArray[np.int32]
    edge_uv: NDArray[np.int32]
    edge_slots: NDArray[np.int32]
    edge_oneway: NDArray[np.bool_]
    robot_ids: tuple[str, ...]
    start: NDArray[np.int32]
    goal: NDArray[np.int32]

    def vertex_grid(self) -> NDArray[np.int32]:
        """(rows, columns) int32, the vertex at each position, -1 where a robot cannot stand."""
        grid = np.full((self.rows, self.columns), -1, dtype=np.int32)
        grid[self.vertex_cell[:, 1], self.vertex_cell[:, 0]] = np.arange(len(self.vertex_cell))
        return grid
