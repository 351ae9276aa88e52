"""A hall with a graph: lanes instead of a grid, from the file to the radio map and the problem."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planner.problem import problem_from_world
from tests.worlds.lifs import edge, layout, spoilt, write_world
from worlds.check import check_world
from worlds.check_figure import check_figure
from worlds.errors import WorldError
from worlds.floor import Floor
from worlds.lanes import traversal_slots
from worlds.places import position_m, position_name, position_of
from worlds.radio_map import build_radio_map
from worlds.toml_file import dump_world, open_world, parse_world, read_world
from worlds.world import Place, World


def opened(folder: Path, *edits: tuple[str, str], lif: str | None = None) -> tuple[World, Floor]:
    """The ring's world with replacements, and its floor."""
    return open_world(write_world(folder, *edits, lif=lif))


def lines_of(folder: Path, *edits: tuple[str, str], lif: str | None = None) -> list[str]:
    """The lines of the error it causes."""
    with pytest.raises(WorldError) as caught:
        open_world(write_world(folder, *edits, lif=lif))
    return [line.replace(f"{folder}/", "") for line in caught.value.lines]


def test_the_floor_is_the_graph(tmp_path: Path) -> None:
    """Nodes at their places plus the offset; one-way lanes; k = ceil(length / (speed · slot))."""
    _, floor = opened(tmp_path)
    assert floor.node_id == ("a", "b", "c", "d", "dock")
    assert floor.vertex_xy_m.tolist() == [[5, 2], [11, 2], [11, 6], [5, 6], [2, 6]]
    lanes = [(floor.node_id[u], floor.node_id[v]) for u, v in floor.edge_uv.tolist()]
    assert lanes == [("a", "b"), ("b", "c"), ("c", "d"), ("d", "a"), ("d", "dock")]
    assert floor.edge_oneway.tolist() == [True, True, True, True, False]
    # The robots drive 1 m/s at most; into the dock, 3 m, at 0.5 m/s, so both ways take 6 slots.
    assert floor.edge_slots.tolist() == [6, 4, 6, 4, 6]
    for array in (floor.vertex_xy_m, floor.edge_uv, floor.edge_slots, floor.edge_oneway):
        assert not array.flags.writeable


def test_slots_follow_speed_and_slot_length(tmp_path: Path) -> None:
    """Faster robots only gain where lanes allow it; at least one slot each."""
    _, floor = opened(tmp_path, ("offset_m", "speed_m_s = 3.0\noffset_m"))
    assert floor.edge_slots.tolist() == [3, 4, 2, 4, 6]
    _, floor = opened(tmp_path, ("slot_s = 1.0", "slot_s = 60.0"))
    assert floor.edge_slots.tolist() == [1] * 5


@given(st.integers(1, 60), st.floats(0.1, 10), st.floats(0.1, 60))
def test_rounding_never_costs_a_slot(k: int, speed: float, slot: float) -> None:
    """A lane that takes exactly k slots takes k; what is longer by 1 % of a slot takes k + 1."""
    exact = np.array([k * speed * slot])
    assert traversal_slots(exact, np.array([speed]), slot).tolist() == [k]
    longer = exact + 0.01 * speed * slot
    assert traversal_slots(longer, np.array([speed]), slot).tolist() == [k + 1]


def test_a_world_with_a_lif_file_is_complete_once_read(tmp_path: Path) -> None:
    """The graph is embedded: dumped and parsed again without the file, it is the same world."""
    path = write_world(tmp_path)
    world = read_world(path)
    (tmp_path / "ring.lif.json").unlink()
    assert world.hall.graph is not None
    assert world.hall.graph.lif is None
    text = dump_world(world)
    assert parse_world(text) == world
    assert dump_world(parse_world(text)) == text


def test_only_a_world_from_a_file_may_name_files(tmp_path: Path) -> None:
    """A text from elsewhere, such as a log's attachment, reads nothing."""
    text = write_world(tmp_path).read_text()
    with pytest.raises(WorldError, match=r"hall.graph.lif: 'ring.lif.json' is a file, which only"):
        parse_world(text)


def test_a_wrong_lif_file_is_told_at_its_key(tmp_path: Path) -> None:
    """World, line and key, then the LIF file with its place; unknown stations do not follow."""
    text = spoilt(lambda v: layout(v)["edges"].append(edge("a", "z")))
    lines = lines_of(tmp_path, lif=text)
    assert lines == [
        "ring.toml:6: hall.graph.lif: ring.lif.json: layouts[0].edges[6].endNodeId: 'z' is not the "
        "id of a node; add it, or take the edge out"
    ]


WRONG: dict[str, tuple[tuple[tuple[str, str], ...], str]] = {
    "file not there": ((("ring.lif.json", "rung.json"),), ":6: hall.graph.lif: rung.json: there"),
    "pitch, too": (
        (("slot_s = 1.0", "slot_s = 1.0\npitch_m = 1.0"),),
        "hall.graph: is given beside pitch_m",
    ),
    "speed of a grid": (
        (("slot_s = 1.0", "speed_m_s = 1.0"),),
        "hall.speed_m_s: is for a grid, here is a graph; give hall.graph.speed_m_s",
    ),
    "outside": (
        (("[5.0, 2.0]", "[0.0, 2.0]"),),
        "[-3, 6] puts 'dock' outside the hall of 14 m x 8 m",
    ),
    "no such node": ((('{node = "a"}', '{node = "aa"}'),), "robot[1].goal: 'aa' is not a node"),
    "a cell": (
        (('{node = "a"}', "{cell = [0, 0]}"),),
        "robot[1].goal: cell [0, 0] is a position of a grid, the hall has a graph",
    ),
    "far from all": (
        (('{node = "a"}', "{at_m = [8.0, 4.0]}"),),
        "m from the nearest node, 'a', more than half a lane (2 m)",
    ),
    "drawn obstacles": (
        (("[plan]", "[obstacles.random]\nshare = 0.1\n[plan]"),),
        "obstacles: are drawn on the positions of a grid",
    ),
    "no such station": ((('"gate"', '"gates"'),), "'gates' is not the name of a station; did you"),
    "no such type": (
        (("offset_m", 'vehicle = "truck"\noffset_m'),),
        "has nothing for a vehicle type 'truck'; known are tug",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_does_not_fit_a_graph_is_refused(tmp_path: Path, case: str) -> None:
    """One line that names the key and what is wrong."""
    edits, words = WRONG[case]
    lines = lines_of(tmp_path, *edits)
    assert len(lines) == 1, lines
    assert words in lines[0]


def test_a_graph_can_be_written_by_hand() -> None:
    """Nodes and edges in the world itself; their mistakes have lines, too."""
    text = """\
name = "by hand"
[hall]
size_m = [8.0, 4.0]
[[hall.graph.node]]
id = "a"
at_m = [1.0, 2.0]
[[hall.graph.node]]
id = "b"
at_m = [6.0, 2.0]
[[hall.graph.edge]]
id = "there"
start = "a"
end = "b"
[[hall.graph.edge]]
id = "back"
start = "b"
end = "a"
speed_m_s = 0.5
[[ap]]
id = "x"
position_m = [4.0, 2.0, 3.0]
[[robot]]
id = "r"
start = {node = "a"}
goal = {at_m = [6.5, 2.5]}
"""
    world = parse_world(text)
    assert parse_world(dump_world(world)) == world
    for old, new, words in (
        ('end = "a"', 'end = "c"', ":17: hall.graph.edge[1].end: 'c' is not the id of a node;"),
        ("[6.0, 2.0]", "[1.0, 2.0]", ":10: hall.graph.edge[0]: 'there' has no length"),
        ('id = "b"', 'id = "a"', "hall.graph.node[1].id: 'a' is the id of an earlier node"),
        ('start = "b"\nend = "a"', 'start = "a"\nend = "b"', "'a' to 'b' as 'there' does; keep"),
        ("speed_m_s = 0.5", "speed_m_s = 0.0", "hall.graph.edge[1].speed_m_s: 0.0 is too small"),
    ):
        with pytest.raises(WorldError) as caught:
            parse_world(text.replace(old, new), "hand.toml")
        assert any(words in line for line in caught.value.lines), caught.value.lines


def test_places_are_nodes_stations_and_metres(tmp_path: Path) -> None:
    """A station is its first node; metres are the nearest node, in the hall's frame."""
    world, floor = opened(tmp_path, ('{node = "a"}', "{at_m = [10.2, 5.4]}"))
    assert [floor.node_id[v] for v in floor.start.tolist()] == ["dock", "b"]
    assert [floor.node_id[v] for v in floor.goal.tolist()] == ["b", "c"]
    hall = world.hall
    assert position_of(hall, Place(node="d")) == 3
    assert position_m(hall, 3) == (5.0, 6.0)
    assert position_name(hall, 3) == "node 'd'"
    assert floor.vertex_name(4) == "node 'dock'"
    assert floor.vertex_at(4) == 4


RACK = '[[obstacle]]\nname = "rack"\ncenter_m = [8.0, 2.6]\nsize_m = [2.0, {}]\n[plan]'


def test_a_lane_needs_room_for_the_body_only(tmp_path: Path) -> None:
    """A rack beside a lane leaves it free if the strip of 0.4 m is; else the lane goes."""
    _, floor = opened(tmp_path, ("[plan]", RACK.format(0.79)))
    assert len(floor.edge_uv) == 5
    _, floor = opened(
        tmp_path, ("[plan]", RACK.format(0.81)), ('goal = "shelf"', 'goal = {node = "a"}')
    )
    assert len(floor.edge_uv) == 4
    assert len(floor.vertex_xy_m) == 5


def test_goals_against_the_lanes_are_found(tmp_path: Path) -> None:
    """E119: with a → b gone, nobody gets to b; the way back does not count."""
    lines = lines_of(tmp_path, ("[plan]", RACK.format(0.81)))
    assert lines == [
        "ring.toml:20: robot[0].goal: no free way leads from start node 'dock' to goal node 'b' "
        "along the one-way lanes; add a lane or choose another goal"
    ]


def test_radio_map_and_problem_keep_the_lanes(tmp_path: Path) -> None:
    """The problem has the floor's slots and directions, and samples along the whole lane."""
    world, floor = opened(tmp_path)
    radio_map = build_radio_map(world, floor)
    problem = problem_from_world(world, floor, radio_map)
    assert problem.edge_slots.tolist() == [6, 4, 6, 4, 6]
    assert problem.edge_oneway.tolist() == [True, True, True, True, False]
    assert radio_map.edge_snr_db.shape == (5, 5, 2)
    ends = radio_map.snr_db[floor.edge_uv]
    np.testing.assert_array_equal(radio_map.edge_snr_db[:, [0, -1]], ends)


def test_shadow_fading_is_drawn_for_a_graph(tmp_path: Path) -> None:
    """Per AP and place: an obstacle shifts no draw where sight stays the same; a seed does."""
    on = ("[plan]", "[radio]\nshadow_fading = true\n[plan]")
    plain = build_radio_map(*opened(tmp_path, on))
    rack = build_radio_map(*opened(tmp_path, (on[0], on[1].replace(on[0], RACK.format(0.79)))))
    world, floor = opened(tmp_path, on)
    radio = world.radio.model_copy(update={"fading_seed": 1})
    other = build_radio_map(world.model_copy(update={"radio": radio}), floor)
    same = plain.los == rack.los
    assert np.ptp(plain.fading_db) > 1.0
    assert same.sum() > 5
    np.testing.assert_array_equal(plain.fading_db[same], rack.fading_db[same])
    assert not np.array_equal(plain.fading_db, other.fading_db)


def test_the_raster_shows_the_lanes(tmp_path: Path) -> None:
    """Cells on a lane belong to its nearer end, cells away from all lanes to none."""
    _, floor = opened(tmp_path)
    grid = floor.vertex_grid()
    assert grid.shape == (floor.rows, floor.columns)

    def at(x: float, y: float) -> int:
        cell = floor.cell_m
        return int(grid[int(y / cell), int(x / cell)])

    for vertex, (x, y) in enumerate(floor.vertex_xy_m.tolist()):
        assert at(x, y) == vertex
    assert (at(7.5, 2.0), at(8.5, 2.0), at(8.0, 4.0)) == (0, 1, -1)


def test_pictures_of_a_graph_are_drawn(tmp_path: Path) -> None:
    """One arrow head per one-way lane; the check's picture, too."""
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

    from worlds.figures import draw_hall

    world, floor = opened(tmp_path)
    ax = Figure().subplots()
    draw_hall(ax, world, floor)
    heads = [c for c in ax.collections if isinstance(c, PolyCollection)]
    assert [len(c.get_paths()) for c in heads] == [4]
    assert check_figure(check_world(world)).axes


def test_a_graph_without_nodes_is_refused() -> None:
    """There would be nowhere to stand."""
    with pytest.raises(WorldError, match="the graph has no nodes"):
        parse_world('name = "n"\nap = []\n[hall]\nsize_m = [9, 9]\n[hall.graph]\nnode = []\n')
