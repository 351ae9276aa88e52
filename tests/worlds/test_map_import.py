"""Maps become complete worlds: exact obstacles, covering access points, robots that can drive."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from worlds.errands import with_covered_robots
from worlds.errors import WorldError
from worlds.formats.movingai import parse_map, parse_scenario
from worlds.formats.ros_map import FREE, OCCUPIED, RosMap, RosMapInfo
from worlds.generate import resolve
from worlds.import_maps import movingai_grid, parse_body, ros_grid
from worlds.map_import import BlockedGrid, ImportParams, crop, import_grid, pitch_for
from worlds.radio_map import build_radio_map
from worlds.toml_file import dump_world, parse_world

ROOMS = """\
type octile
height 6
width 9
map
.........
.@@@@@@@.
.....@...
.@@@.@.@.
...@...@.
.@.@@@.@.
"""
SCENARIO = "version 1\n0\trooms.map\t9\t6\t0\t0\t8\t5\t13\n0\trooms.map\t9\t6\t4\t2\t0\t5\t7\n"


def few(**more: object) -> ImportParams:
    """Parameters with few robots."""
    return ImportParams(**{"robots": 3, "name": "rooms", **more})  # type: ignore[arg-type]


def ros(picture: list[str], pixel_m: float) -> RosMap:
    """A map, rows from the top, # occupied."""
    state = np.array([[OCCUPIED if s == "#" else FREE for s in row] for row in picture[::-1]])
    info = RosMapInfo("m.yaml", Path("m.pgm"), pixel_m, (-1.0, 2.0), False, 0.65, 0.2, "trinary")
    return RosMap(info, state.astype(np.uint8))


def test_free_positions_are_exactly_the_passable_cells() -> None:
    """Boxes as large as their cells block these and no others; (x, y) is row height − 1 − y."""
    grid = parse_map(ROOMS, "rooms.map")
    imported = import_grid(movingai_grid(grid, few())[0], few())
    free = resolve(imported.world).vertex_grid() >= 0
    np.testing.assert_array_equal(free, grid.passable[::-1])


def test_neighbours_are_joined() -> None:
    """Every two free cells side by side have an edge: a body of the default size fits its cell."""
    grid = parse_map(ROOMS, "rooms.map")
    floor = import_grid(movingai_grid(grid, few())[0], few()).floor
    p = grid.passable
    assert len(floor.edge_uv) == (p[1:] & p[:-1]).sum() + (p[:, 1:] & p[:, :-1]).sum()


def test_the_text_is_the_world_and_says_what_is_assumed() -> None:
    """Parsing gives the world back; defaults are marked; equal inputs give equal bytes."""
    grid, _ = movingai_grid(parse_map(ROOMS, "rooms.map"), few())
    imported = import_grid(grid, few())
    assert parse_world(imported.text) == imported.world
    assert parse_world(dump_world(imported.world)) == imported.world
    assert "PROPOSED" in imported.text
    assert imported.text.count("(default)") >= 4
    assert import_grid(grid, few()).text == imported.text


def test_the_proposed_access_points_cover_what_was_asked_for() -> None:
    """Coverage of the proposal is that of the radio map, and reaches the target."""
    imported = import_grid(movingai_grid(parse_map(ROOMS, "rooms.map"), few())[0], few())
    radio_map = build_radio_map(imported.world, imported.floor)
    assert radio_map.covered_share() == imported.proposal.covered_share >= 0.99


def test_more_access_points_are_proposed_where_walls_block() -> None:
    """Two halls far apart behind a high wall need one each; one open hall of that size one."""
    blocked = np.zeros((4, 80), dtype=bool)
    params = few(robots=2, pitch_m=1.0)
    assert len(import_grid(BlockedGrid(blocked, 1.0, ""), params).world.ap) == 1
    blocked[:3, 40] = True
    high = few(robots=2, pitch_m=1.0, obstacle_height_m=6.0)
    walled = import_grid(BlockedGrid(blocked, 1.0, ""), high)
    assert len(walled.world.ap) >= 2
    assert walled.proposal.covered_share >= 0.99


def test_capacity_fits_the_fleet() -> None:
    """Forty robots are more than two access points of 15 serve, so more are proposed."""
    grid = BlockedGrid(np.zeros((12, 12), dtype=bool), 1.0, "")
    world = import_grid(grid, few(robots=40)).world
    assert len(world.ap) * world.radio.ap_capacity >= 40


def test_the_horizon_leaves_room_beyond_the_longest_errand() -> None:
    """Distances are those of the robots drawn; a horizon that is given is kept, with a hint."""
    grid, _ = movingai_grid(parse_map(ROOMS, "rooms.map"), few())
    imported = import_grid(grid, few())
    assert imported.world.plan.horizon > imported.longest_errand > 0
    short = import_grid(grid, few(horizon=1))
    assert short.world.plan.horizon == 1
    assert "no plan exists" in short.hints[0]


def test_scenario_errands_become_robots() -> None:
    """The first K rows, upper left counted, as cells of rows from the bottom."""
    params = few(robots=2)
    scenario = parse_scenario(SCENARIO, "rooms.scen")
    grid, _ = movingai_grid(parse_map(ROOMS, "rooms.map"), params, scenario)
    world = import_grid(grid, params).world
    assert [r.start.cell for r in world.robot] == [(0, 5), (4, 3)]
    assert [r.goal.cell for r in world.robot] == [(8, 0), (0, 0)]
    assert world.robots is None


def test_a_scenario_for_another_map_is_refused() -> None:
    """The scenario's own words about its map are held against the map."""
    with pytest.raises(WorldError, match="give the scenario made for this map"):
        movingai_grid(
            parse_map(ROOMS, "other.map"), few(robots=1), parse_scenario(SCENARIO, "rooms.scen")
        )


# ROS maps at a pitch


def test_the_frame_of_the_map_is_told() -> None:
    """The hall begins at the first free cell; how to get back stands in the file."""
    picture = ["####", "#..#", "#..#", "####"]
    grid, _ = ros_grid(ros(picture, 1.0), few(robots=1, pitch_m=1.0))
    assert grid.blocked.tolist() == [[False, False], [False, False]]
    assert any("x_map = x + 0, y_map = y + 3" in note for note in grid.notes)


def test_a_small_map_gets_a_finer_pitch_and_smaller_robots() -> None:
    """A room of 4 m for twenty robots is no place for a pitch of 1 m; what was chosen is told."""
    picture = ["." * 80] * 80
    params = ImportParams(robots=20)
    grid, hints = ros_grid(ros(picture, 0.05), params)
    assert grid.pitch_m == 0.3
    assert "chosen for this map" in hints[0]
    length, width = params.chosen_body_m(grid.pitch_m)
    assert length + width <= grid.pitch_m


def test_a_pitch_that_is_given_is_kept() -> None:
    """Even if little floor is left, of which a hint speaks; never finer than a pixel."""
    picture = ["." * 80] * 38 + ["#" * 80] + ["." * 80] * 41
    grid, hints = ros_grid(ros(picture, 0.05), few(pitch_m=1.0))
    assert grid.pitch_m == 1.0
    assert "a smaller --pitch keeps more" in hints[0]
    with pytest.raises(WorldError, match="finer than the map's pixels"):
        ros_grid(ros(picture, 0.05), few(pitch_m=0.01))


def test_a_map_without_free_pixels_is_refused() -> None:
    """The counts tell what to look at: negate, or the thresholds."""
    with pytest.raises(WorldError, match="no pixel is free: 4 are occupied, 0 unknown"):
        ros_grid(ros(["##", "##"], 1.0), few())


def test_crop_keeps_all_that_is_free() -> None:
    """The smallest part with all free cells, and where it begins."""
    blocked = np.ones((5, 6), dtype=bool)
    blocked[2, 1] = blocked[3, 4] = False
    part, first = crop(blocked)
    assert part.shape == (2, 4)
    assert first == (1, 2)
    assert crop(np.ones((2, 2), dtype=bool))[0].shape == (2, 2)


@pytest.mark.parametrize("pitch", [0.1, 0.3, 0.5, 1.0, 1.4, 2.0])
def test_default_bodies_never_touch_at_corners(pitch: float) -> None:
    """Length + width ≤ pitch, and never more than the format's default body."""
    length, width = ImportParams().chosen_body_m(pitch)
    assert 0 < length + width <= pitch + 1e-9
    assert length <= 0.8
    assert width <= 0.6
    assert pitch_for((0.8, 0.6)) == pytest.approx(1.4)


@pytest.mark.parametrize("text", ["0.8", "0.8,0.6,0.4", "wide,0.6", "0.8,-0.6", "0.8,nan", ""])
def test_a_body_is_two_lengths(text: str) -> None:
    """Anything else is refused with an example."""
    with pytest.raises(WorldError, match=r"such as 0\.8,0\.6"):
        parse_body(text)


def test_wrong_parameters_are_told_at_once() -> None:
    """Three, in three lines."""
    with pytest.raises(WorldError) as caught:
        ImportParams(pitch_m=-1, coverage=99, ap_height_m=0)
    assert len(caught.value.lines) == 3


def test_robots_too_large_for_the_pitch_are_refused_or_warned_of() -> None:
    """Wider than pitch/√2: refused as any world is; length + width above the pitch: a hint."""
    grid = BlockedGrid(np.zeros((6, 6), dtype=bool), 1.0, "")
    with pytest.raises(WorldError, match="too wide"):
        import_grid(grid, few(body_m=(0.9, 0.8)))
    assert "touch at corners" in import_grid(grid, few(body_m=(0.8, 0.6))).hints[0]


def test_the_robots_are_those_of_a_run() -> None:
    """The floor that is returned holds the errands that `twin run` draws under coverage (§1.8)."""
    imported = import_grid(movingai_grid(parse_map(ROOMS, "rooms.map"), few())[0], few())
    floor = resolve(imported.world)
    again = with_covered_robots(imported.world, floor, build_radio_map(imported.world, floor))
    np.testing.assert_array_equal(imported.floor.start, again.start)
    np.testing.assert_array_equal(imported.floor.goal, again.goal)
