"""Suggested access points: what is promised is what the changed world's radio map shows."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.worlds.floors import ap, boxes, grid_floor, world
from tests.worlds.radio_maps import FOUR, paper_floor
from worlds.errors import WorldError
from worlds.floor import Floor
from worlds.mounts import (
    grid_m,
    grid_spacing_m,
    mounts,
    read_mounts,
    usual_height_m,
    walls_m,
)
from worlds.placement import Ask
from worlds.radio_map import build_radio_map
from worlds.suggest import cast_mounts, held_places, needless, place_weights, suggest
from worlds.suggest_figure import suggestion_figure
from worlds.world import AccessPoint, World

PHYSICS: tuple[dict[str, object], ...] = (
    {},
    {"shadow_fading": True, "fading_seed": 2},
    {"shadow_fading": True, "fading_correlation": "table", "oxygen": True, "model": "inf-dl"},
    {"blockage": "knife-edge", "low_antenna_los_db": 10.7},
)


def candidates(hall: World, floor: Floor, spacing: float = 12.0) -> tuple[AccessPoint, ...]:
    """Mounts on a grid, 5 m high."""
    return mounts(hall, floor, [(x, y, 5.0) for x, y in grid_m(hall, spacing).tolist()])


@pytest.mark.parametrize("physics", PHYSICS)
def test_mounts_cover_what_a_radio_map_says(physics: dict[str, object]) -> None:
    """The table of who covers what is that of a map with all of them hung, to the last bit."""
    floor = paper_floor(3)
    hall = world(FOUR, **physics)
    new = candidates(hall, floor)
    covers = cast_mounts(hall, floor, new)
    every = build_radio_map(hall.model_copy(update={"ap": (*hall.ap, *new)}), floor)
    np.testing.assert_array_equal(covers, every.covered[:, 4:])
    more = cast_mounts(hall, floor, new, margin_db=7.0)
    np.testing.assert_array_equal(more, every.snr_db[:, 4:] >= 17.0)
    ways = cast_mounts(hall, floor, new[:5], ways=True)
    np.testing.assert_array_equal(ways, held_places(every, ways=True)[:, 4:9])
    assert len(ways) == len(floor.vertex_xy_m) + 3 * len(floor.edge_uv)


@pytest.mark.parametrize("physics", PHYSICS[:2])
def test_the_promise_is_kept_and_nothing_less_would_do(physics: dict[str, object]) -> None:
    """Fewest for all positions: the new world is covered, and no smaller choice of mounts is."""
    floor = paper_floor(3)
    hall = world(FOUR[:2], **physics)
    held = build_radio_map(hall, floor).covered
    new = candidates(hall, floor)
    covers = cast_mounts(hall, floor, new)
    for k in (1, 2):
        found = suggest(new, covers, held, Ask(k=k))
        assert found.placement.optimal
        after = build_radio_map(found.world(hall), floor)
        np.testing.assert_array_equal(after.coverage_count, found.after)
        assert (after.coverage_count >= k).all()
        fewer = len(found.added) - 1
        assert not any(
            (held.sum(axis=1) + covers[:, list(some)].sum(axis=1) >= k).all()
            for some in combinations(range(len(new)), fewer)
        )


def test_redundancy_survives_every_single_loss() -> None:
    """Each access point switched off in turn: still everything covered."""
    floor = paper_floor(2, share=0.15)
    hall = world(FOUR[:2])
    held = build_radio_map(hall, floor).covered
    new = candidates(hall, floor)
    found = suggest(new, cast_mounts(hall, floor, new), held, Ask(failure=True))
    assert found.placement.possible
    changed = found.world(hall)
    for lost in range(len(changed.ap)):
        rest = [*changed.ap[:lost], *changed.ap[lost + 1 :]]
        without = changed.model_copy(update={"ap": tuple(rest)})
        assert build_radio_map(without, floor).covered_share() == 1.0


def test_places_out_of_reach_are_counted() -> None:
    """A walled-in position no mount sees: not possible, nothing is added, one position is named."""
    middle = [(5.0, 4.0, 2.5), (5.0, 6.0, 2.5), (4.0, 5.0, 2.5), (6.0, 5.0, 2.5)]
    across, along = (1.2, 0.2, 2.5), (0.2, 1.2, 2.5)
    cage = boxes(middle, [across, across, along, along])
    around = [(c, r) for c in (4, 5, 6) for r in (4, 5, 6) if (c, r) != (5, 5)]
    floor = grid_floor(11, 11, standing=cage, blocked=around)
    hall = world([ap("a", 0.5, 0.5, 3.0)], (11, 11), tx_power_dbm=1.0)
    new = mounts(hall, floor, [(x, y, 3.0) for x, y in walls_m(hall, 5.5).tolist()])
    held = build_radio_map(hall, floor).covered
    found = suggest(new, cast_mounts(hall, floor, new), held, Ask())
    assert not found.placement.possible
    assert found.added == ()
    assert floor.vertex_cell[found.out_of_reach].tolist() == [[5, 5]]


def test_needless_access_points_are_found_by_the_most() -> None:
    """Of five that overlap the most that can go together, by enumeration; fleet and k respected."""
    floor = paper_floor(5)
    five = (*FOUR, ap("mid", 30, 30), ap("mid2", 31, 29))
    hall = world(five, ap_capacity=4)
    found_map = build_radio_map(hall, floor)
    covered = found_map.covered
    for k, robots in ((1, 0), (2, 0), (1, 20), (1, 999)):
        found = needless(hall, found_map, k=k, robots=robots)
        need = np.minimum(covered.sum(axis=1), k)
        least = min(robots, 24)
        good = [
            set(some)
            for size in range(7)
            for some in combinations(range(6), size)
            if (covered[:, list(some)].sum(axis=1) >= need).all() and 4 * size >= least
        ]
        kept = {a for a, name in enumerate(found_map.ap_ids) if name not in found.removed}
        assert kept in good
        assert len(kept) == min(map(len, good)) == found.placement.bound
        after = build_radio_map(found.world(hall), floor)
        np.testing.assert_array_equal(after.coverage_count, found.after)


def test_weights_decide() -> None:
    """Positions that no robot needs may stay uncovered."""
    floor = paper_floor(3)
    hall = world(FOUR[:1])
    held = build_radio_map(hall, floor).covered
    new = candidates(hall, floor)
    covers = cast_mounts(hall, floor, new)
    weight = held.any(axis=1).astype(np.int64)
    assert suggest(new, covers, held, Ask(), weight).added == ()
    assert suggest(new, covers, held, Ask()).added != ()
    radio_map = build_radio_map(hall, floor)
    places = place_weights(floor, radio_map, weight)
    assert len(places) == len(held_places(radio_map, ways=True))
    ends = weight[floor.edge_uv].min(axis=1)
    np.testing.assert_array_equal(places[len(weight) :].reshape(-1, 3), ends[:, None].repeat(3, 1))
    removed = needless(hall, radio_map, weight=np.zeros(len(held), np.int64))
    assert removed.removed == ("ap0",)


# Mounts


def test_a_grid_is_centred_and_walls_have_their_corners() -> None:
    """Equal margins on opposite sides; distances as asked, or a little less along a wall."""
    hall = world(FOUR, (20.0, 10.0))
    grid = grid_m(hall, 3.0)
    assert len(grid) == 6 * 3
    np.testing.assert_allclose(grid.min(axis=0) + grid.max(axis=0), (20.0, 10.0))
    np.testing.assert_allclose(np.diff(grid[:6, 0]), 3.0)
    walls = walls_m(hall, 3.0)
    assert len(walls) == len(np.unique(walls, axis=0)) == 2 * (7 + 4)
    assert {(0.0, 0.0), (20.0, 0.0), (0.0, 10.0), (20.0, 10.0)} <= set(map(tuple, walls.tolist()))
    edge = (walls == 0).any(axis=1) | (walls[:, 0] == 20) | (walls[:, 1] == 10)
    assert edge.all()
    assert 150 <= len(grid_m(world(FOUR), grid_spacing_m(world(FOUR)))) <= 300


def test_mounts_that_cannot_be_are_left_out() -> None:
    """Outside, inside a box, at an access point that hangs, twice: gone; ids tell the place."""
    floor = grid_floor(4, 4, standing=boxes([(2.0, 2.0, 1.0)]))
    hall = world([ap("x1y1", 3, 3), ap("off", 0, 0, enabled=False)], (4, 4))
    places = [(1, 1, 5), (2, 2, 1), (2, 2, 5), (3, 3, 5), (9, 1, 5), (1, 1, 5), (0, 0, 5)]
    found = mounts(hall, floor, [(float(x), float(y), float(z)) for x, y, z in places])
    assert [m.id for m in found] == ["x1y1'", "x2y2", "x0y0"]
    with pytest.raises(WorldError, match="none of the 1 mounts"):
        mounts(hall, floor, [(3.0, 3.0, 5.0)])


def test_the_usual_height() -> None:
    """As most hang; the higher of equals; nothing to go by is said."""
    assert usual_height_m(world([ap("a", 0, 0, 3), ap("b", 0, 0, 4), ap("c", 0, 0, 4)])) == 4.0
    assert usual_height_m(world([ap("a", 0, 0, 3), ap("b", 0, 0, 4)])) == 4.0
    with pytest.raises(WorldError, match="--height"):
        usual_height_m(world([]))


def test_mounts_from_a_file(tmp_path: Path) -> None:
    """x_m, y_m and perhaps height_m; every wrong line is told."""
    path = tmp_path / "mounts.csv"
    path.write_text("x_m,y_m,height_m\n1,2,\n3,4,6.5\n")
    assert read_mounts(path, 5.0) == [(1.0, 2.0, 5.0), (3.0, 4.0, 6.5)]
    path.write_text("x_m,y_m\n1,two\n3,4\nnan,0\n")
    with pytest.raises(WorldError) as caught:
        read_mounts(path, 5.0)
    assert [line.split(": ")[0] for line in caught.value.lines] == [f"{path}:2", f"{path}:4"]
    path.write_text("x,y\n1,2\n")
    with pytest.raises(WorldError, match="x_m,y_m"):
        read_mounts(path, 5.0)
    with pytest.raises(WorldError, match="no such file"):
        read_mounts(tmp_path / "none.csv", 5.0)


def test_the_picture_shows_both_and_marks_the_new() -> None:
    """Two panels to scale, now and then, with a star for each new access point."""
    floor, hall = paper_floor(3), world(FOUR[:2])
    held = build_radio_map(hall, floor).covered
    new = candidates(hall, floor)
    found = suggest(new, cast_mounts(hall, floor, new), held, Ask(add=2))
    figure = suggestion_figure(hall, floor, found)
    assert isinstance(figure, Figure)
    now, then = (ax for ax in figure.axes if ax.get_title())
    assert now.get_title().startswith("now: ")
    assert then.get_title().startswith("then: ")
    stars = [line for line in then.lines if line.get_marker() == "*"]
    assert len(stars) == len(found.added) == 2
    assert not [line for line in now.lines if line.get_marker() == "*"]
