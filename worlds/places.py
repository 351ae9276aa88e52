"""Positions of a hall by number: cells of its grid row by row, or nodes of its graph in order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from worlds.hall import Graph, Hall
from worlds.part import nearest
from worlds.world import Place, Station


class NowhereError(ValueError):
    """A place lies outside the grid or the graph; the text says which."""


def positions_m(hall: Hall) -> NDArray[np.float64]:
    """(P, 2), all positions [m]: of a grid row by row from (0, 0), of a graph in its order."""
    if hall.graph is not None:
        return hall.graph.xy_m()
    columns, rows = hall.grid_positions
    x = hall.grid_margin_m + hall.grid_pitch_m * np.arange(columns)
    y = hall.grid_margin_m + hall.grid_pitch_m * np.arange(rows)
    return np.column_stack((np.tile(x, rows), np.repeat(y, columns)))


def position_m(hall: Hall, position: int) -> tuple[float, float]:
    """Where a position is [m]."""
    if hall.graph is not None:
        x, y = hall.graph.node[position].at_m
        return x + hall.graph.offset_m[0], y + hall.graph.offset_m[1]
    row, column = divmod(position, hall.grid_positions[0])
    margin, pitch = hall.grid_margin_m, hall.grid_pitch_m
    return margin + column * pitch, margin + row * pitch


def position_name(hall: Hall, position: int) -> str:
    """`cell [3, 4]` or `node 'A7'`, for messages."""
    if hall.graph is not None:
        return f"node '{hall.graph.node[position].id}'"
    row, column = divmod(position, hall.grid_positions[0])
    return f"cell {[column, row]}"


def position_of(hall: Hall, place: Place | Station) -> int:
    """The position a place is, or for metres the nearest one; a station's name is not looked up.

    Raises:
        NowhereError: no such cell or node, or metres too far from every position: half a pitch, on
            a graph half a typical lane.
    """
    if hall.graph is not None:
        return _node_of(hall, hall.graph, place)
    columns, rows = hall.grid_positions
    if place.cell is not None:
        if not (0 <= place.cell[0] < columns and 0 <= place.cell[1] < rows):
            given = f"cell {list(place.cell)} is outside the grid of {columns} x {rows} positions"
            raise NowhereError(f"{given}; columns are 0 to {columns - 1}, rows 0 to {rows - 1}")
        return place.cell[1] * columns + place.cell[0]
    at_m = place.at_m or (np.nan, np.nan)
    margin, pitch = hall.grid_margin_m, hall.grid_pitch_m
    steps = tuple((c - margin) / pitch for c in at_m)
    column = min(max(round(steps[0]), 0), columns - 1)
    row = min(max(round(steps[1]), 0), rows - 1)
    if max(abs(steps[0] - column), abs(steps[1] - row)) > 0.5 + 1e-9:
        last = (margin + (columns - 1) * pitch, margin + (rows - 1) * pitch)
        grid = f"the grid spans ({margin:g}, {margin:g}) to ({last[0]:.6g}, {last[1]:.6g}) m"
        given = f"{list(at_m)} is more than half a pitch from every position"
        raise NowhereError(f"{given}; {grid}{millimetres(at_m, hall)}")
    return row * columns + column


def millimetres(xy: tuple[float, float], hall: Hall) -> str:
    """A hint for coordinates outside the hall that were inside if they are millimetres."""
    inside = all(0 <= c / 1000 <= size for c, size in zip(xy, hall.size_m, strict=True))
    likely = all(c == 0 or c >= 100 for c in xy)
    return f"; millimetres? then write {[c / 1000 for c in xy]}" if inside and likely else ""


def _node_of(hall: Hall, graph: Graph, place: Place | Station) -> int:
    if place.cell is not None:
        rule = f"cell {list(place.cell)} is a position of a grid, the hall has a graph"
        raise NowhereError(f"{rule}; name a node or a station, or give at_m")
    names = place.nodes if isinstance(place, Station) else (place.node,)
    if place.at_m is None:
        known = [node.id for node in graph.node]
        name = names[0] if names else None
        if name not in known:
            mend = nearest(str(name), known) or f" known are {', '.join(known[:8])}"
            raise NowhereError(f"'{name}' is not a node of the graph;{mend}")
        return known.index(str(name))
    away = np.hypot(*(graph.xy_m() - np.array(place.at_m)).T)
    best = int(away.argmin())
    if away[best] > graph.spacing_m / 2 + 1e-9:
        rule = f"{list(place.at_m)} is {away[best]:.3g} m from the nearest node, "
        rule += f"'{graph.node[best].id}', more than half a lane ({graph.spacing_m / 2:.3g} m)"
        mend = "name a node, or take a place nearer to one"
        raise NowhereError(f"{rule}; {mend}{millimetres(place.at_m, hall)}")
    return best
