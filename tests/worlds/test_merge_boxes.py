"""Blocked cells become few rectangles, exactly."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from worlds.formats.movingai import read_map
from worlds.merge_boxes import Rectangle, merge_boxes

SHARED = Path(__file__).parents[3] / "shared/data/movingai"


def grid(*rows: str) -> np.ndarray:
    """Rows from the top, # is blocked; row 0 of the array is the bottom."""
    return np.array([[symbol == "#" for symbol in row] for row in rows[::-1]])


def covers(rectangles: list[Rectangle], shape: tuple[int, int]) -> np.ndarray:
    """How many rectangles lie on each cell."""
    count = np.zeros(shape, dtype=int)
    for x, y, columns, rows in rectangles:
        assert columns > 0
        assert rows > 0
        count[y : y + rows, x : x + columns] += 1
    return count


def fewest(blocked: np.ndarray) -> int:
    """The least number of rectangles of a partition, by trying all that hold the first cell."""
    rows, columns = blocked.shape

    @cache
    def least(left: int) -> int:
        if not left:
            return 0
        first = (left & -left).bit_length() - 1
        y, x = divmod(first, columns)
        best = 10**9
        for y2 in range(y, rows):
            for x2 in range(x, columns):
                mask = 0
                for r in range(y, y2 + 1):
                    for c in range(x, x2 + 1):
                        mask |= 1 << (r * columns + c)
                if mask & ~left:
                    break
                best = min(best, 1 + least(left & ~mask))
        return best

    flat = sum(1 << int(k) for k in np.flatnonzero(blocked))
    return least(flat)


@pytest.mark.parametrize(
    ("picture", "count"),
    [
        ((".",), 0),
        (("#",), 1),
        (("###", "###"), 1),
        (("##", "#."), 2),
        (("#.", ".#"), 2),
        ((".#.", "###", ".#."), 3),
        (("###", "#.#", "###"), 4),
        (("#.#", "###"), 3),
    ],
)
def test_known_shapes(picture: tuple[str, ...], count: int) -> None:
    """Point, block, L, touching corners, cross, ring and U need the known number of rectangles."""
    blocked = grid(*picture)
    found = merge_boxes(blocked)
    assert len(found) == count
    np.testing.assert_array_equal(covers(found, blocked.shape), blocked)


@settings(max_examples=60, deadline=None)
@given(hnp.arrays(bool, st.tuples(st.integers(1, 14), st.integers(1, 14))))
def test_the_rectangles_are_disjoint_and_exactly_the_blocked_cells(blocked: np.ndarray) -> None:
    """No cell is lost, none is added, none is in two."""
    np.testing.assert_array_equal(covers(merge_boxes(blocked), blocked.shape), blocked)


@pytest.mark.parametrize("seed", range(40))
def test_no_partition_has_fewer(seed: int) -> None:
    """On small random grids the count is the least there is, found by exhaustive search."""
    rng = np.random.default_rng(seed)
    blocked = rng.random((4, 5)) < (0.55, 0.7, 0.85)[seed % 3]
    assert len(merge_boxes(blocked)) == fewest(blocked)


def test_the_order_is_that_of_the_grid() -> None:
    """Rectangles come by row, then by column; equal grids give equal lists."""
    blocked = grid("#.##", "....", "##.#")
    found = merge_boxes(blocked)
    assert found == sorted(found, key=lambda r: (r.row, r.column))
    assert found == merge_boxes(blocked.copy())


def test_benchmark_maps_shrink() -> None:
    """The 4444 blocked cells of the warehouse map are 204 boxes: racks, and four walls."""
    if not SHARED.exists():
        pytest.skip("../shared/data/movingai is not here")
    blocked = ~read_map(SHARED / "warehouse-10-20-10-2-1.map").passable
    assert blocked.sum() == 4444
    assert len(merge_boxes(blocked)) == 204


def test_an_array_of_another_shape_is_refused() -> None:
    """A programming error is told as such."""
    with pytest.raises(ValueError, match="rows, columns"):
        merge_boxes(np.ones(3, dtype=bool))
