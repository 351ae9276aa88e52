"""The floor as numbers: resolved obstacles, positions, the graph of free moves, the errands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

RIBBON_CELLS = 2.0
"""On a graph, cells of the raster nearer than this to a lane show it [cells]."""


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

    A hall with a graph has no grid; for pictures its floor has a raster instead, a grid of small
    cells that covers the hall.

    Attributes:
        pitch_m: of the grid [m]; on a graph, the typical distance of things drawn beside each
            other.
        slot_s: slot length [s].
        columns, rows: of the grid of positions, blocked ones included; or of the raster.
        boxes: listed and drawn obstacles.
        vertex_xy_m: (V, 2) float64.
        vertex_cell: (V, 2) int32, (column, row) of each vertex; on a graph, in the raster.
        edge_uv: (E, 2) int32; u < v on a grid.
        edge_slots: (E,) int32, traversal time in slots.
        edge_oneway: (E,) bool, crossed from u to v only.
        robot_ids: (N,) names.
        start, goal: (N,) int32, vertices.
        raster_m: side of a cell of the raster [m]; None on a grid.
        node: (V,) int32, the graph's node that each vertex is; empty on a grid.
        node_id: (V,) their ids.
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
    raster_m: float | None = None
    node: NDArray[np.int32] | None = None
    node_id: tuple[str, ...] = ()

    @property
    def cell_m(self) -> float:
        """Side of a cell of the grid or raster [m]."""
        return self.pitch_m if self.raster_m is None else self.raster_m

    @property
    def origin_m(self) -> tuple[float, float]:
        """The centre of cell (0, 0) of the grid or raster [m]."""
        if self.raster_m is not None:
            return self.raster_m / 2, self.raster_m / 2
        if not len(self.vertex_xy_m):
            return 0.0, 0.0
        x, y = self.vertex_xy_m[0] - self.pitch_m * self.vertex_cell[0]
        return float(x), float(y)

    def vertex_name(self, vertex: int) -> str:
        """`cell [3, 4]` or `node 'A7'`, for messages."""
        if self.node is not None:
            return f"node '{self.node_id[vertex]}'"
        return f"cell {self.vertex_cell[vertex].tolist()}"

    def vertex_at(self, position: int) -> int:
        """The vertex at a position (numbered as by `worlds.places`), −1 if it is not free."""
        if self.node is not None:
            found = np.flatnonzero(self.node == position)
        else:
            row, column = divmod(position, self.columns)
            found = np.flatnonzero((self.vertex_cell == (column, row)).all(axis=1))
        return int(found[0]) if len(found) else -1

    def vertex_grid(self) -> NDArray[np.int32]:
        """(rows, columns) int32, the vertex at each position, -1 where a robot cannot stand.

        On a graph, of the raster: the nearer end of the lane that a cell lies on.
        """
        if self.raster_m is not None:
            return self._ribbons(self.raster_m)
        grid = np.full((self.rows, self.columns), -1, dtype=np.int32)
        grid[self.vertex_cell[:, 1], self.vertex_cell[:, 0]] = np.arange(len(self.vertex_cell))
        return grid

    def _ribbons(self, cell_m: float) -> NDArray[np.int32]:
        from scipy.spatial import cKDTree

        u, v = self.edge_uv.T
        way = self.vertex_xy_m[v] - self.vertex_xy_m[u]
        steps = np.ceil(np.hypot(way[:, 0], way[:, 1]) / cell_m).astype(np.intp) + 1
        edge = np.repeat(np.arange(len(u)), steps)
        rank = np.arange(len(edge)) - np.repeat(np.cumsum(steps) - steps, steps)
        share = rank / np.maximum(steps[edge] - 1, 1)
        along = self.vertex_xy_m[u[edge]] + share[:, None] * way[edge]
        points = np.concatenate((self.vertex_xy_m, along))
        vertex = np.concatenate(
            (np.arange(len(self.vertex_xy_m)), np.where(share < 0.5, u[edge], v[edge]))
        )
        row, column = np.divmod(np.arange(self.rows * self.columns), self.columns)
        centres = np.column_stack((column + 0.5, row + 0.5)) * cell_m
        _, nearest = cKDTree(points).query(centres, distance_upper_bound=RIBBON_CELLS * cell_m)
        grid = np.append(vertex, -1)[nearest].astype(np.int32)
        return np.asarray(grid.reshape(self.rows, self.columns))
