"""MovingAI maps and scenarios (design page 7, "Formats"): what is read, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from worlds.errors import WorldError
from worlds.formats.movingai import errands, parse_map, parse_scenario, read_map, read_scenario

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data" / "movingai"

MAP = """type octile
height 3
width 5
map
..@.S
TG.W.
O....
"""
ROWS = [
    ("0", "yard.map", "5", "3", "0", "0", "4", "2", "4.82842712"),
    ("0", "yard.map", "5", "3", "4", "0", "1", "1", "3.41421356"),
    ("1", "maps/yard.map", "5", "3", "1", "2", "0", "0", "2.41421356"),
]


def scen(*rows: tuple[str, ...], version: str = "version 1") -> str:
    """The text of a scenario."""
    return "\n".join([version, *("\t".join(row) for row in rows)]) + "\n"


def changed(row: int, field: int, value: str) -> str:
    """The scenario with one field of one row replaced."""
    rows = [list(r) for r in ROWS]
    rows[row][field] = value
    return scen(*(tuple(r) for r in rows))


def refusal(text: str, *, name: str = "yard.map", **options: str) -> str:
    """The one line a map is refused with."""
    with pytest.raises(WorldError) as error:
        parse_map(text, name, **options)
    assert len(error.value.lines) == 1
    return error.value.lines[0]


def scenario_refusal(text: str) -> tuple[str, ...]:
    """The lines a scenario is refused with."""
    with pytest.raises(WorldError) as error:
        parse_scenario(text, "yard.scen")
    return error.value.lines


def errand_refusal(text: str, agents: int = 3, map_text: str = MAP) -> tuple[str, ...]:
    """The lines with which the errands of a scenario are refused."""
    with pytest.raises(WorldError) as error:
        errands(parse_map(map_text, "dir/yard.map"), parse_scenario(text, "yard.scen"), agents)
    return error.value.lines


def test_origin_is_the_upper_left_cell():
    """Row 0 of the array is the first row of the file, column 0 its first symbol."""
    grid = parse_map(MAP, "a/yard.map")
    assert (grid.name, grid.source) == ("yard.map", "a/yard.map")
    assert (grid.width, grid.height) == (5, 3)
    expected = [[1, 1, 0, 1, 1], [0, 1, 1, 0, 1], [0, 1, 1, 1, 1]]
    assert np.array_equal(grid.passable, np.array(expected, bool))
    assert not grid.passable.flags.writeable


def test_passable_symbols_are_a_parameter():
    """Water can be made passable and swamp blocked; a new symbol becomes known by being named."""
    grid = parse_map(MAP, "yard.map", passable=".GW")
    assert grid.passable[1, 3]
    assert not grid.passable[0, 4]
    assert parse_map(MAP.replace("S", "x"), "yard.map", passable=".x").passable[0, 4]


@pytest.mark.parametrize("ending", ["\n", "\r\n"])
@pytest.mark.parametrize("tail", ["", "\n\n"])
def test_line_ends_and_empty_lines_at_the_end_do_not_matter(ending, tail):
    """Files written on any system read alike."""
    text = (MAP.rstrip("\n") + tail).replace("\n", ending)
    assert np.array_equal(parse_map(text, "m").passable, parse_map(MAP, "m").passable)
    assert parse_scenario(scen(*ROWS).replace("\n", ending), "s").rows[2].goal == (0, 0)


def test_files_are_read(tmp_path):
    """From disk, a byte order mark included, with the path in messages."""
    (tmp_path / "yard.map").write_text("\ufeff" + MAP, encoding="utf-8")
    (tmp_path / "yard.scen").write_text(scen(*ROWS))
    grid, scenario = read_map(tmp_path / "yard.map"), read_scenario(tmp_path / "yard.scen")
    starts, goals = errands(grid, scenario, 2)
    assert starts.tolist() == [[0, 0], [4, 0]]
    assert goals.tolist() == [[4, 2], [1, 1]]
    assert grid.source == str(tmp_path / "yard.map")


def test_unknown_symbol_names_row_and_column():
    """Both counted from 0 as in scenarios, the line from 1 as in editors."""
    line = refusal(MAP.replace("TG.W.", "TG.W?"))
    assert line.startswith("yard.map:6: row 1, column 4: unknown symbol '?'")
    assert "passable are . G S" in line


def test_all_unknown_symbols_are_told_at_once_up_to_a_number():
    """Eight in words, the others counted."""
    with pytest.raises(WorldError) as error:
        parse_map(MAP.replace(".", "?"), "yard.map")
    lines = error.value.lines
    assert len(lines) == 9
    assert lines[0].startswith("yard.map:5: row 0, column 0")
    assert lines[-1] == "yard.map: and 1 more of this kind"


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("type octile", "type hexagonal", 1),
        ("type octile", "P2", 1),
        ("height 3", "width 5", 2),
        ("height 3", "height three", 2),
        ("height 3", "height 0", 2),
        ("height 3", "height -3", 2),
        ("width 5", "width 5 5", 3),
        ("\nmap\n", "\nmaps\n", 4),
    ],
)
def test_wrong_header_names_the_line(old, new, line):
    """And says what should stand there."""
    message = refusal(MAP.replace(old, new, 1))
    assert message.startswith(f"yard.map:{line}: wrong header: expected")


def test_header_may_end_early():
    """An empty file and one of two lines are wrong headers, not crashes."""
    assert "expected 'type octile', found the end of the file" in refusal("")
    assert "expected 'width W', found the end of the file" in refusal("type octile\nheight 3\n")


def test_truncated_map_is_refused():
    """Rows missing, or the last one cut."""
    message = refusal(MAP[: MAP.index("O....")])
    assert message.startswith("yard.map:6: the map is cut short: it has 2 rows")
    message = refusal(MAP.rstrip()[:-2])
    assert message.startswith("yard.map:7: the map is cut short: row 2 has 3 symbols")


def test_rows_too_many_or_too_long_are_refused():
    """The header and the rows must agree."""
    assert "there are 4 rows, the header says height 3" in refusal(MAP + ".....\n")
    assert "row 1 has 6 symbols, the header says width 5" in refusal(MAP.replace("TG", "TGG"))


def test_map_without_a_passable_cell_is_refused():
    """Nobody could stand anywhere."""
    assert "no cell is passable" in refusal(MAP, passable="x")
    assert "no symbol is passable" in refusal(MAP, passable="")


def test_size_is_limited_before_memory_is_used():
    """A header of astronomical size is an error, not an allocation."""
    big = MAP.replace("height 3", "height 9999999").replace("width 5", "width 9999999")
    assert "cells are more than" in refusal(big)


@pytest.mark.parametrize("reader", [read_map, read_scenario])
def test_files_that_are_none(reader, tmp_path):
    """Missing, a folder, or not text: one sentence each."""
    cases = {"missing": "there is no such file", "folder": "is not a regular", "binary": "not text"}
    (tmp_path / "folder").mkdir()
    (tmp_path / "binary").write_bytes(b"type octile\n\xff\xfe\x00")
    for name, words in cases.items():
        with pytest.raises(WorldError, match=words) as error:
            reader(tmp_path / name)
        assert error.value.lines[0].startswith(str(tmp_path / name))


def test_scenario_rows():
    """All nine columns, the map's folder dropped, the line kept."""
    row = parse_scenario(scen(*ROWS), "yard.scen").rows[2]
    assert (row.line, row.bucket, row.map_name) == (4, 1, "yard.map")
    assert (row.width, row.height, row.start, row.goal) == (5, 3, (1, 2), (0, 0))
    assert row.optimal_length == pytest.approx(2.41421356)


def test_scenario_fields_may_be_separated_by_blanks():
    """As some older files have it; and version 1.0 is version 1."""
    text = scen(*ROWS, version="version 1.0").replace("\t", " ")
    assert len(parse_scenario(text, "s").rows) == 3


@pytest.mark.parametrize("text", ["", MAP, scen(*ROWS, version="version 2"), scen(*ROWS)[10:]])
def test_scenario_with_wrong_header(text):
    """What does not begin with `version 1` is no scenario."""
    (line,) = scenario_refusal(text)
    assert line.startswith("yard.scen:1: a scenario begins with the line 'version 1'")


def test_all_bad_rows_are_told_at_once():
    """Each with its line and what is wrong in it."""
    bad = [ROWS[0], ROWS[1][:5], (*ROWS[2][:4], "x", *ROWS[2][5:]), (*ROWS[2][:8], "long")]
    lines = scenario_refusal(scen(*bad))
    assert [line.split(": ")[0] for line in lines] == [f"yard.scen:{k}" for k in (3, 4, 5)]
    assert "has 5 fields instead of 9" in lines[0]
    assert "start x: 'x' is not a whole number" in lines[1]
    assert "optimal length: 'long' is not a number" in lines[2]


def test_scenario_without_rows():
    """A header alone has no agents."""
    assert "has no rows" in scenario_refusal("version 1\n")[0]


@pytest.mark.parametrize(("field", "value"), [(1, "other.map"), (2, "6"), (3, "4")])
def test_scenario_of_another_map(field, value):
    """By name or by size; the first such row is named."""
    (line,) = errand_refusal(changed(1, field, value))
    assert line.startswith("yard.scen:3: is for the map ")
    assert "dir/yard.map is yard.map of 5 x 3" in line


def test_more_agents_than_rows():
    """The number that is possible is told."""
    (line,) = errand_refusal(scen(*ROWS), agents=4)
    assert "4 agents are asked for, the scenario has 3 rows; ask for at most 3" in line
    (line,) = errand_refusal(scen(*ROWS), agents=0)
    assert "at least 1" in line


def test_only_the_rows_in_use_are_held_against_the_map():
    """A bad fourth row does not spoil the first three."""
    text = changed(2, 4, "0")
    grid = parse_map(MAP, "yard.map")
    assert len(errands(grid, parse_scenario(text, "s"), 2)[0]) == 2


@pytest.mark.parametrize(
    ("row", "field", "value", "words"),
    [
        (0, 4, "2", "the start (x 2, y 0) is blocked in dir/yard.map (its row 0, column 2)"),
        (1, 7, "2", None),
        (1, 6, "0", "the goal (x 0, y 1) is blocked"),
        (2, 4, "5", "the start (x 5, y 2) is outside: the map has 5 columns and 3 rows"),
        (2, 7, "9", "the goal (x 0, y 9) is outside"),
    ],
)
def test_start_and_goal_must_be_free_cells(row, field, value, words):
    """Blocked or outside: the row's line, which end, and where."""
    text = changed(row, field, value)
    if words is None:  # the control: this one is free
        assert len(errands(parse_map(MAP, "yard.map"), parse_scenario(text, "s"), 3)[0]) == 3
        return
    (line,) = errand_refusal(text)
    assert line.startswith(f"yard.scen:{row + 2}: {words}")


def test_agents_need_cells_of_their_own():
    """Equal starts and equal goals are told with both lines, all at once (§1.2, §1.5)."""
    rows = [ROWS[0], ROWS[0]]
    lines = errand_refusal(scen(*rows), agents=2)
    assert len(lines) == 2
    assert "the goal (x 4, y 2) is that of line 2 already" in lines[0]
    assert "the start (x 0, y 0) is that of line 2 already" in lines[1]


@pytest.mark.skipif(not SHARED.is_dir(), reason="../shared/data/movingai is not here")
@pytest.mark.parametrize(
    ("name", "free"),
    [
        ("empty-16-16", 256),
        ("random-32-32-20", 819),
        ("room-32-32-4", 682),
        ("warehouse-10-20-10-2-1", 5699),
    ],
)
def test_benchmark_files(name, free):
    """The benchmark's own maps have the sizes published for them, and their scenarios fit."""
    grid = read_map(SHARED / f"{name}.map")
    scenario = read_scenario(SHARED / f"{name}-random-1.scen")
    assert grid.passable.sum() == free
    starts, _ = errands(grid, scenario, min(100, len(scenario.rows)))
    assert grid.passable[starts[:, 1], starts[:, 0]].all()
