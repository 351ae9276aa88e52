"""World files: every problem at once, with its line, its value and the remedy."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import worlds
from tests.worlds.good_world import GOOD, edited, lines_of
from worlds.errors import Fault, WorldError
from worlds.toml_file import dump_world, open_world, parse_world, read_source, read_world
from worlds.toml_lines import key_lines

SHIPPED = sorted(Path(worlds.__file__).parent.glob("*.toml"))
TINY = Path(worlds.__file__).parent / "tiny.toml"


# All at once


def test_five_mistakes_are_told_at_once_with_their_lines() -> None:
    """Misspelt key, height below the floor, doubled id, unknown station, quoted number."""
    text = edited(
        ("pitch_m = 1.0", "pich_m = 1.0"),
        ('id = "east"', 'id = "west"'),
        ("position_m = [7.0, 5.0, 4.0]", "position_m = [\n  7.0,\n  5.0, # y\n  -5.0,\n]"),
        ('start = "dock 1"', 'start = "dok 1"'),
        ("horizon = 30", 'horizon = "30"'),
    )
    assert lines_of(text) == [
        "hall.toml:6: hall.pich_m: is not a known key; did you mean 'pitch_m'?",
        "hall.toml:13: ap[1].id: 'west' is the id of ap[0] already; give each its own",
        "hall.toml:17: ap[1].position_m[2]: -5.0 is below the floor; give metres above it",
        "hall.toml:27: robot[0].start: 'dok 1' is not the name of a station;"
        " did you mean 'dock 1'?",
        'hall.toml:36: plan.horizon: "30" is text; write a whole number without quotes',
    ]


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ('name = "good"', "", ":1: name: is missing; give the world a name"),
        ('name = "good"', 'name = ""', ':2: name: "" is empty'),
        ('name = "good"', 'name = "a\\nb"', ":2: name: 'a\\nb' contains a line break"),
        ('name = "good"', "name = 2024-01-01", ":2: name: 2024-01-01 must be text in quotes"),
        ("mapp-world/1", "mapp-world/9", ':1: format: "mapp-world/9" must be one of mapp-world/1'),
        ("pitch_m = 1.0", "", ":4: hall: has none of pitch_m, positions, graph; give one"),
        ("pitch_m = 1.0", "pitch_m = 0", ":6: hall.pitch_m: 0 is too small; give at least 0.01 m"),
        ("pitch_m = 1.0", "pitch_m = nan", ":6: hall.pitch_m: nan is no finite number"),
        ("pitch_m = 1.0", "pitch_m = true", ":6: hall.pitch_m: true is not a number"),
        ("pitch_m = 1.0", "pitch_m = 9", ":6: hall.pitch_m: 9.0 is larger than the hall"),
        ("pitch_m = 1.0", "positions = [8, 5]", ":6: hall.positions: [8, 5] puts columns 1 m"),
        ("pitch_m = 1.0", "positions = [1, 1]\nmargin_m = 0", ":6: hall.positions: [1, 1] is a"),
        ("pitch_m = 1.0", "positions = [8.0, 6]", ":6: hall.positions[0]: 8.0 must be a whole"),
        (
            "pitch_m = 1.0",
            "pitch_m = 1.0\nmargin_m = 4",
            ":7: hall.margin_m: 4.0 leaves no floor in a hall of 8 m x 6 m",
        ),
        (
            "pitch_m = 1.0",
            "pitch_m = 1.0\npositions = [8, 6]",
            ":7: hall.positions: is given beside pitch_m; keep one of the two",
        ),
        (
            "pitch_m = 1.0",
            "pitch_m = 1.0\nslot_s = 2\nspeed_m_s = 1",
            ":8: hall.speed_m_s: is given beside slot_s",
        ),
        (
            "pitch_m = 1.0",
            "pitch_m = 1.0\nbody = { length = 0.5, wide = 1 }",
            ":7: hall.body.length: is not a known key; did you mean 'length_m'?",
        ),
        (
            "size_m = [8.0, 6.0]",
            "size_m = [8000, 6000]",
            ":5: hall.size_m[0]: 8000 is more than 5000 m; millimetres? then write 8",
        ),
        ("size_m = [8.0, 6.0]", "size_m = [8.0]", ":5: hall.size_m: [8.0] has too few entries; gi"),
        ("size_m = [8.0, 6.0]", "size_m = [8, 6, 4]", ":5: hall.size_m: [8, 6, 4] has too many"),
        ("size_m = [8.0, 6.0]", "size_m = 8", ":5: hall.size_m: 8 must be a list in square"),
        (
            "size_m = [8.0, 6.0]\npitch_m = 1.0",
            "size_m = [900.0, 900.0]\npitch_m = 0.01",
            ":6: hall.pitch_m: 0.01 makes 90000 x 90000 positions, more than 1000000",
        ),
        ("[hall]", "[[hall]]", ":4: hall: must be a single table; write [hall] with single"),
        ("[hall]", "[hal]", ":4: hal: is not a known key; did you mean 'hall'?"),
        ("[plan]", "[[plan]]", ":31: plan: must be a single table"),
        (
            "[plan]",
            "[obstacle]\nsize_m = [1, 1]\n[plan]",
            ":31: obstacle: must be a list of tables; write [[obstacle]] with double brackets",
        ),
        ("capacity = 3", "capacity = 3.0", ":15: ap[1].capacity: 3.0 must be a whole number; wr"),
        ("capacity = 3", "capacity = -1", ":15: ap[1].capacity: -1 is too small; give at least 0"),
        ("capacity = 3", "enabled = 1", ":15: ap[1].enabled: 1 must be true or false"),
        ("capacity = 3", 'model = "inf-ld"', ':15: ap[1].model: "inf-ld" must be one of inh-off'),
        ("capacity = 3", "height_m = 3", ":15: ap[1].height_m: is not a known key; height_m bel"),
        (", 5.0, 4.0]", ", 5.0, 4000]", ":14: ap[1].position_m[2]: 4000 is more than 200 m; milli"),
        ('id = "east"\n', "", ":12: ap[1].id: is missing; every [[ap]] needs it"),
        ('id = "anna"', "id = 7", ':22: robot[0].id: 7 must be text in quotes; write "7"'),
        ('id = "bert"', 'id = "anna"', ":27: robot[1].id: 'anna' is the id of robot[0] already"),
        ("at_m = [7.2, 5.4]", "", ":24: robot[0].goal: has none of station, cell, node, at_m"),
        (
            "at_m = [7.2, 5.4]",
            'at_m = [7, 5], station = "dock 1"',
            ":24: robot[0].goal.at_m: is given beside station",
        ),
        ("{ cell = [1, 1] }", "5", ":28: robot[1].start: 5 is no place; give a station's name"),
        ("{ cell = [1, 1] }", "[1, 1]", ":28: robot[1].start: [1, 1] is no place"),
        (
            "cell = [0, 0]",
            "",
            ":17: station[0]: has none of cell, nodes, at_m; give one of them",
        ),
        ("[plan]", "[robots]\nrandom = { count = 2 }\n[plan]", ":31: robots: is given beside the"),
        ("horizon = 30", "horizon = 0", ":32: plan.horizon: 0 is too small; give at least 1"),
        (
            "horizon = 30",
            'objective = "ph"',
            ':32: plan.objective: "ph" must be one of hp, tp, snr',
        ),
        ("horizon = 30", "objective = 3", ':32: plan.objective: 3 must be "hp", "tp", "snr" or {'),
        ("horizon = 30", "objective = { c_t = 1 }", ":32: plan.objective.c_h: is missing"),
        ("horizon = 30", "objective = { c_t = 1, c_h = -1 }", ":32: plan.objective.c_h: -1 is too"),
        ("horizon = 30", "[run]\ninterruption = false", ":33: run.interruption: false must be the"),
        (
            "horizon = 30",
            "[run]\ninterruption = -2",
            ":33: run.interruption: -2 is too small; give",
        ),
        ("horizon = 30", "interruption = 5", ":32: plan.interruption: is not a known key; inter"),
        ("horizon = 30", "horizon = 31\nhorizon = 30", ":33: is not valid TOML: this key is given"),
        ("horizon = 30", "horizon = 3,5", ":32: is not valid TOML: expected newline"),
        ("horizon = 30", "horizon", ":32: is not valid TOML: a key needs '='"),
        ("[plan]", "[hall]", ":31: is not valid TOML: [hall] is headed twice"),
        ("horizon = 30", "[obstacles]\nrandom = { share = 30 }", ":33: obstacles.random.share: 30"),
        ("horizon = 30", "[obstacles]\n", ":32: obstacles.random: is missing; every [obstacles]"),
    ],
)
def test_one_mistake_is_one_line_that_says_where_what_and_how_to_mend(
    old: str, new: str, wanted: str
) -> None:
    """The line is that of the key, or of its table when the key is missing."""
    told = lines_of(edited((old, new)))
    assert any(line.startswith(f"hall.toml{wanted}") for line in told), told


def test_a_misspelt_key_is_not_told_as_missing_too() -> None:
    """One mistake, one line: the key that was meant is not asked for again."""
    assert len(lines_of(edited(('id = "east"', 'idd = "east"')))) == 1
    assert len(lines_of(edited(("pitch_m = 1.0", "pitch = 1.0")))) == 1
    assert len(lines_of(edited(("{ cell = [1, 1] }", "{ cel = [1, 1] }")))) == 1


def test_no_message_speaks_python() -> None:
    """What pydantic says never reaches the reader as it is."""
    wrong = ["5", "true", '"x"', "[]", "{}", "[[1]]", "nan", "1979-05-27", "-1", "[1, 2, 3, 4]"]
    for line in GOOD.splitlines():
        if " = " not in line:
            continue
        for value in wrong:
            changed = f"{line.split(' = ')[0]} = {value}"
            for told in lines_of(GOOD.replace(line, changed, 1)):
                assert re.match(r"hall\.toml:\d+: [a-z_]+[][0-9a-z_.]*: ", told), told
                assert not re.search(r"[Ii]nput|validat|dictionary|instance|pydantic|None", told)


def test_all_faults_of_the_floor_are_located_too(tmp_path: Path) -> None:
    """What only the laid-out hall shows is told with its line, all at once."""
    path = tmp_path / "hall.toml"
    obstacle = '[[obstacle]]\nname = "rack"\ncenter_m = [0.5, 0.5]\nsize_m = [0.4, 0.4]\n\n[plan]'
    path.write_text(edited(("[plan]", obstacle), ("[7.0, 5.0, 4.0]", "[9.0, 5.0, 4.0]")))
    with pytest.raises(WorldError) as caught:
        open_world(path)
    told = [line.removeprefix(f"{path}:") for line in caught.value.lines]
    assert [re.sub(r"(: .*?:) .*", r"\1", line) for line in told] == [
        "14: ap[1].position_m:",
        "23: robot[0].start:",
        "29: robot[1].goal:",
    ]
    assert "touches 'rack'" in told[1]


def test_faults_found_later_can_be_located(tmp_path: Path) -> None:
    """A fault of the radio map or of a plan finds its line through the source."""
    path = tmp_path / "hall.toml"
    path.write_text(GOOD)
    source = read_source(path, overrides={"plan.horizon": 40})
    assert source.line(("ap", 1, "capacity")) == 15
    assert source.line(("ap", 1, "gain_db")) == 12
    assert source.line(("radio", "model")) == 1
    assert source.error([Fault(("robot", 1, "goal"), "b"), Fault(("ap", 0), "a")]).lines == (
        f"{path}:8: ap[0]: a",
        f"{path}:29: robot[1].goal: b",
    )
    assert source.error([Fault(("plan", "horizon"), "c")]).lines == (
        f"{path} (override): plan.horizon: c",
    )


# Files


@pytest.mark.parametrize(
    ("content", "wanted"),
    [
        (b"", "is empty"),
        (b" \n\t\n", "is empty"),
        (GOOD.encode("utf-16"), ":1: byte 0xff is not UTF-8; save"),
        (GOOD.replace("good", "Werkst\xe4tte").encode("latin-1"), ":2: byte 0xe4 is not UTF-8"),
        (b"name = 'x'\nhall = {size_m = [1,\n", ":2: is not valid TOML: "),
        (b"a = " + b"[" * 20_000, "nested too deeply"),
        (b"a = " + b"9" * 6_000, ":1: is not valid TOML: this number has too many digits"),
        (b"\x00\x01\x02", ":1: is not valid TOML"),
        (b"# " + b"x" * 10_000_000, "has 10 MB, a world at most 10 MB"),
    ],
)
def test_files_that_are_no_worlds_are_refused(tmp_path: Path, content: bytes, wanted: str) -> None:
    """Whatever the bytes: one clear line with the name of the file."""
    path = tmp_path / "hall.toml"
    path.write_bytes(content)
    with pytest.raises(WorldError) as caught:
        read_world(path)
    assert len(caught.value.lines) == 1
    assert str(caught.value).startswith(str(path))
    assert wanted in str(caught.value)


def test_a_huge_file_is_refused_unread(tmp_path: Path) -> None:
    """50 MB are refused by their size."""
    path = tmp_path / "huge.toml"
    with path.open("wb") as file:
        file.truncate(50_000_000)
    with pytest.raises(WorldError, match="has 50 MB, a world at most 10 MB"):
        read_world(path)


def test_paths_that_are_no_files_are_refused(tmp_path: Path) -> None:
    """Nothing there, a directory, a device: each by its name."""
    for path, wanted in (
        (tmp_path / "none.toml", "no such file"),
        (tmp_path, "is a directory"),
        (Path("/dev/null"), "not a regular file"),
        (tmp_path / "a\0b", "cannot be read|no such file"),
        (tmp_path / ("x" * 300), "cannot be read|no such file"),
    ):
        with pytest.raises(WorldError, match=wanted) as caught:
            open_world(path)
        assert str(caught.value).startswith(str(path))


def test_windows_files_are_read(tmp_path: Path) -> None:
    """A byte order mark and CRLF change neither the world nor the lines."""
    path = tmp_path / "hall.toml"
    path.write_bytes(b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())
    assert read_world(path) == parse_world(GOOD)
    path.write_bytes(path.read_bytes().replace(b"30", b"0"))
    with pytest.raises(WorldError, match=r":32: plan\.horizon"):
        read_world(path)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_a_damaged_file_is_a_world_or_a_world_error(data: st.DataObject) -> None:
    """Lines dropped, doubled or cut, values swapped: never another exception."""
    lines = TINY.read_text().splitlines()
    for _ in range(data.draw(st.integers(1, 4))):
        i = data.draw(st.integers(0, len(lines) - 1))
        j = data.draw(st.integers(0, len(lines) - 1))
        match data.draw(st.sampled_from(["drop", "double", "cut", "swap", "value"])):
            case "drop":
                lines[i] = ""
            case "double":
                lines[i] += "\n" + lines[j]
            case "cut":
                lines[i] = lines[i][: data.draw(st.integers(0, 10))]
            case "swap":
                lines[i] = lines[i].split("=")[0] + "=" + lines[j].partition("=")[2]
            case _:
                value = data.draw(st.sampled_from(["1e300", "-0.0", "[[]]", "{a.b=1}", "5e-324"]))
                lines[i] = lines[i].split("=")[0] + "=" + value
    text = "\n".join(lines)
    told = lines_of(text)
    assert all(line.startswith("hall.toml") for line in told)
    if not told:
        world = parse_world(text)
        assert parse_world(dump_world(world)) == world
        assert key_lines(text)
