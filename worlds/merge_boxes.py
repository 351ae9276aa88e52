"""Blocked cells of a grid as few rectangles: exact, disjoint, and as few as a partition can have.

A partition of an orthogonal polygon with holes into rectangles has at least

    concave corners − largest set of disjoint chords + pieces − holes

of them (T. Ohtsuki, Minimum dissection of rectilinear regions, ISCAS 1982; L. Ferrari, P. V. Sankar
and J. Sklansky, Minimal rectangular partitions of digitized blobs, CVGIP 28, 1984,
doi:10.1016/0734-189X(84)90139-7). A chord is a straight inner segment between two concave corners;
horizontal and vertical chords that meet are the two sides of a bipartite graph, whose largest
independent set follows from its largest matching (König). Cutting along these chords, and from
every other concave corner straight on to the next border or cut, leaves rectangles only and reaches
the bound. Greedy choice of the largest rectangle, the usual way, needs a few per cent more.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Bools = NDArray[np.bool_]


class Rectangle(NamedTuple):
    """Cells from (column, row) to (column + columns − 1, row + rows − 1)."""

    column: int
    row: int
    columns: int
    rows: int


class _Chord(NamedTuple):
    """A segment along grid line `line` from `first` to `last`, lines counted in cells."""

    line: int
    first: int
    last: int


def merge_boxes(blocked: ArrayLike) -> list[Rectangle]:
    """The fewest disjoint rectangles that are together exactly the blocked cells.

    Args:
        blocked: (rows, columns) bool.

    Returns:
        The rectangles by row, then by column of their first cell. Cells that touch at a corner only
        are never in one rectangle.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    cells = np.asarray(blocked, dtype=np.bool_)
    if cells.ndim != 2:
        raise ValueError(f"blocked has shape {cells.shape}; give (rows, columns)")
    if not cells.any():
        return []
    cut_below, cut_left = _cuts(cells)
    number = np.where(cells, np.cumsum(cells).reshape(cells.shape) - 1, -1)
    up = cells[1:] & cells[:-1] & ~cut_below[1:-1]
    right = cells[:, 1:] & cells[:, :-1] & ~cut_left[:, 1:-1]
    tail = np.concatenate((number[1:][up], number[:, 1:][right]))
    head = np.concatenate((number[:-1][up], number[:, :-1][right]))
    n = int(cells.sum())
    graph = csr_array((np.ones(len(tail), dtype=np.int8), (tail, head)), shape=(n, n))
    pieces, label = connected_components(graph, directed=False)

    row, column = np.nonzero(cells)
    extent = np.full((4, pieces), np.iinfo(np.int64).max)
    for k, value in enumerate((column, row, -column, -row)):
        np.minimum.at(extent[k], label, value)
    west, south, east, north = extent[0], extent[1], -extent[2], -extent[3]
    found = [
        Rectangle(x, y, x2 - x + 1, y2 - y + 1)
        for x, y, x2, y2 in zip(
            west.tolist(), south.tolist(), east.tolist(), north.tolist(), strict=True
        )
    ]
    if sum(r.columns * r.rows for r in found) != n:
        raise AssertionError("a piece is no rectangle")  # a defect here, never the input's
    return sorted(found, key=lambda r: (r.row, r.column))


def _cuts(cells: Bools) -> tuple[Bools, Bools]:
    """(rows + 1, columns) cut below each cell; (rows, columns + 1) cut left of each cell."""
    rows, columns = cells.shape
    padded = np.pad(cells, 1)
    # Point (y, x) is the lower left corner of cell (y, x); around it lie four cells.
    around = [padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]]
    concave = np.sum(around, axis=0) == 3
    inner_east = padded[:-1, 1:] & padded[1:, 1:]  # the unit segment east of the point is inside
    inner_north = padded[1:, :-1] & padded[1:, 1:]

    horizontal = _chords(concave, inner_east)
    vertical = _chords(concave.T, inner_north.T)
    horizontal, vertical = _independent(horizontal, vertical)

    cut_below = np.zeros((rows + 1, columns), dtype=np.bool_)
    cut_left = np.zeros((rows, columns + 1), dtype=np.bool_)
    crossed = np.zeros((rows + 1, columns + 1), dtype=np.bool_)  # points on a vertical cut
    done = np.zeros_like(concave)
    for y, x, x2 in horizontal:
        cut_below[y, x:x2] = True
        done[y, [x, x2]] = True
    for x, y, y2 in vertical:
        cut_left[y:y2, x] = True
        crossed[y : y2 + 1, x] = True
        done[[y, y2], x] = True
    for y, corner in np.argwhere(concave & ~done).tolist():
        x, step = corner, 1 if inner_east[y, corner] else -1
        while True:
            segment = x if step > 0 else x - 1
            if not 0 <= segment < columns or not inner_east[y, segment]:
                break
            cut_below[y, segment] = True
            x += step
            if crossed[y, x]:
                break
    return cut_below, cut_left


def _chords(concave: Bools, inner: Bools) -> list[_Chord]:
    """Inner segments between concave points, along the rows of the arrays."""
    found = []
    line, place = np.nonzero(concave)
    # inside[y, x] inner segments lie before point x: a stretch is inner if all its segments are.
    inside = np.cumsum(np.pad(inner, ((0, 0), (1, 0))), axis=1)
    for k in range(len(line) - 1):
        y, x, x2 = line[k], place[k], place[k + 1]
        if line[k + 1] == y and inside[y, x2] - inside[y, x] == x2 - x:
            found.append(_Chord(int(y), int(x), int(x2)))
    return found


def _independent(
    horizontal: list[_Chord], vertical: list[_Chord]
) -> tuple[list[_Chord], list[_Chord]]:
    """The largest set of chords of which no two meet, at their ends neither (König)."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import maximum_bipartite_matching

    if not horizontal or not vertical:
        return horizontal, vertical
    line, first, last = np.array(vertical).T
    meets = [
        np.flatnonzero((line >= h.first) & (line <= h.last) & (first <= h.line) & (last >= h.line))
        for h in horizontal
    ]
    counts = np.array([len(m) for m in meets])
    pointer = np.concatenate(([0], np.cumsum(counts)))
    graph = csr_array(
        (np.ones(pointer[-1], dtype=np.int8), np.concatenate(meets), pointer),
        shape=(len(horizontal), len(vertical)),
    )
    match_of_vertical = maximum_bipartite_matching(graph, perm_type="row")
    match_of_horizontal = np.full(len(horizontal), -1)
    matched = np.flatnonzero(match_of_vertical >= 0)
    match_of_horizontal[match_of_vertical[matched]] = matched

    # Reached from unmatched horizontal chords along alternating paths: the independent set is the
    # horizontal chords reached and the vertical ones not reached.
    reached_h = match_of_horizontal < 0
    reached_v = np.zeros(len(vertical), dtype=np.bool_)
    todo = np.flatnonzero(reached_h).tolist()
    while todo:
        for v in meets[todo.pop()].tolist():
            if not reached_v[v]:
                reached_v[v] = True
                h = int(match_of_vertical[v])
                if h >= 0 and not reached_h[h]:
                    reached_h[h] = True
                    todo.append(h)
    return (
        [h for h, keep in zip(horizontal, reached_h, strict=True) if keep],
        [v for v, gone in zip(vertical, reached_v, strict=True) if not gone],
    )
