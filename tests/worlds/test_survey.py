"""Measured radio: what is read from a table, what is refused, and the map it makes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from worlds.errors import WorldError
from worlds.formats.survey_csv import Survey, parse_survey, read_survey
from worlds.radio_map import RadioMap, build_radio_map
from worlds.survey import at_vertices, compare
from worlds.toml_file import dump_world, open_world, parse_world, read_world
from worlds.world import Measured

APS = ("west", "east")

# 4 x 1 positions, 2 m apart, at x = 1, 3, 5, 7
WORLD = """\
name = "strip"
[hall]
size_m = [8.0, 2.0]
pitch_m = 2.0
[[ap]]
id = "west"
position_m = [0.5, 1.0, 3.0]
[[ap]]
id = "east"
position_m = [7.5, 1.0, 3.0]
[radio]
measured = {file = "s.csv"MORE}
[[robot]]
id = "r"
start = {cell = [0, 0]}
goal = {cell = [3, 0]}
"""


def write(folder: Path, rows: str, more: str = "") -> Path:
    """The world and its survey; `more` are further keys of `radio.measured`."""
    (folder / "s.csv").write_text(rows)
    path = folder / "w.toml"
    path.write_text(WORLD.replace("MORE", more))
    return path


def measured_map(folder: Path, rows: str, more: str = "") -> RadioMap:
    """Its radio map."""
    world, floor = open_world(write(folder, rows, more))
    return build_radio_map(world, floor)


def model_map(folder: Path) -> RadioMap:
    """That of the world without a survey."""
    path = write(folder, "x,y,ap,snr_db\n1,1,west,1\n")
    world, floor = open_world(path, overrides={"radio.measured": None})
    return build_radio_map(world, floor)


def parsed(text: str, **more: Any) -> Survey:
    """A table for the two APs, noise −80 dBm."""
    return parse_survey(text, "s.csv", APS, -80.0, **more)


FORMS = {
    "plain": "x,y,ap,snr_db\n1.5,2,east,20.5\n",
    "units in names": "x_m,y_m,ap,snr_db\n1.5,2,east,20.5\n",
    "other order, more columns": "time,snr_db,ap,floor,y,x\n12:00,20.5,east,1,2,1.5\n",
    "rssi": "x,y,ap,rssi_dbm\n1.5,2,east,-59.5\n",
    "semicolons and commas": "x;y;ap;snr_db\n1,5;2,0;east;20,5\n",
    "comments, blanks, BOM-free CRLF": "# tool 7\r\n\r\nx, y, ap, snr_db\r\n1.5, 2, east, 20.5\r\n",
    "quotes": '"x","y","ap","snr_db"\n"1.5","2","east","20.5"\n',
    "capitals": "X,Y,AP,SNR_dB\n1.5,2,east,20.5",
}


@pytest.mark.parametrize("form", FORMS)
def test_forms_that_are_read(form: str) -> None:
    """All say the same: at (1.5, 2) m 20.5 dB from 'east'."""
    survey = parsed(FORMS[form])
    assert survey.xy_m.tolist() == [[1.5, 2.0]]
    assert survey.ap.tolist() == [1]
    assert survey.snr_db.tolist() == [20.5]


HEAD = "x,y,ap,snr_db\n"
WRONG = {
    "NaN": (HEAD + "1,1,west,20\n1,1,west,NaN\n", "s.csv:3: snr_db is NaN; leave out rows"),
    "infinite": (HEAD + "inf,1,west,20\n", "s.csv:2: x is inf"),
    "unknown AP": (HEAD + "1,1,wets,20\n", "s.csv:2: 'wets' is not an access point of the world;"),
    "RSSI as SNR": (HEAD + "1,1,west,-60\n", "s.csv:2: snr_db = -60 is outside -25 to 110; an SNR"),
    "SNR as RSSI": ("x,y,ap,rssi_dbm\n1,1,west,30\n", "s.csv:2: rssi_dbm = 30 is outside"),
    "millimetres": (
        HEAD + "1500,1000,west,20\n",
        "s.csv:2: x = 1500 m is outside the hall of 8 m;",
    ),
    "no number": (HEAD + "1,one,west,20\n", "s.csv:2: y = 'one' is not a number"),
    "nothing": (HEAD + "1,,west,20\n", "s.csv:2: y is missing"),
    "short row": (HEAD + "1,1,west\n", "s.csv:2: has 3 fields, the heading asks for 4"),
    "open quote": (HEAD + '1,1,"west,20\n', "s.csv:2: is no line of a table"),
    "no heading": ("1,1,west,20\n", "s.csv:1: there is no column x, y, ap, snr_db or rssi_dbm"),
    "column misspelt": ("x,y,ap,snr\n1,1,west,2\n", "in 'snr' did you mean 'snr_db'?"),
    "column in mm": ("x_mm,y_mm,ap,snr_db\n1,1,west,2\n", "column x_mm: give metres"),
    "both values": ("x,y,ap,snr_db,rssi_dbm\n", "has both snr_db and rssi_dbm"),
    "column twice": ("x,x_m,y,ap,snr_db\n", "s.csv:1: the column x stands twice"),
    "empty": ("\n# nothing\n", "s.csv: is empty"),
    "heading only": (HEAD, "has a heading, but no measurements"),
    "binary": ("\x00\x01", "s.csv:1: "),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_tables_are_refused_with_their_line(case: str) -> None:
    """One line: file, line, what is wrong."""
    text, words = WRONG[case]
    with pytest.raises(WorldError) as caught:
        parsed(text, size_m=(8.0, 2.0))
    assert len(caught.value.lines) == 1, caught.value.lines
    assert words in caught.value.lines[0]


def test_all_wrong_rows_are_told_but_not_without_end() -> None:
    """Eight of them, and how many more."""
    with pytest.raises(WorldError) as caught:
        parsed(HEAD + "1,1,west,nan\n" * 20)
    assert len(caught.value.lines) == 9
    assert caught.value.lines[-1] == "s.csv: and 12 more lines"


@settings(max_examples=60, deadline=None)
@given(st.text(alphabet='xyap,;"\n\r\t 019.-+eEnaif_#\x00wst', max_size=60))
def test_no_text_makes_it_stumble(text: str) -> None:
    """Any text is a table or refused as a WorldError."""
    lines: tuple[str, ...] = ()
    try:
        assert np.isfinite(parsed(HEAD + text).snr_db).all()
    except WorldError as error:
        lines = error.lines
    assert all(line.startswith("s.csv") for line in lines)


def test_files_are_read_with_care(tmp_path: Path) -> None:
    """No such file, a folder, no text."""
    (tmp_path / "b.csv").write_bytes(b"x,y\n\xff")
    for name, words in (("no.csv", "no such file"), ("", "is a directory"), ("b.csv", "not UTF-8")):
        with pytest.raises(WorldError, match=words):
            read_survey(tmp_path / name, APS, -80.0)


ROWS = HEAD + "".join(f"{x},1,west,{v}\n" for x, values in ((1, (20, 22, 40)), (3, (5, 6, 30)))
                      for v in values)  # fmt: skip


def test_a_position_takes_the_median_near_it(tmp_path: Path) -> None:
    """Median of three at (1, 1) and (3, 1); elsewhere the model stands in."""
    found, model = measured_map(tmp_path, ROWS), model_map(tmp_path)
    np.testing.assert_allclose(found.snr_db[:2, 0], [22, 6], atol=1e-9)
    np.testing.assert_array_equal(found.snr_db[2:, 0], model.snr_db[2:, 0])
    np.testing.assert_array_equal(found.snr_db[:, 1], model.snr_db[:, 1])
    np.testing.assert_array_equal(found.los, model.los)


def test_the_tenth_percentile_is_more_careful(tmp_path: Path) -> None:
    """Of 20, 22, 40 it is 20.4, linear between the sorted values."""
    found = measured_map(tmp_path, ROWS, ', statistic = "p10"')
    np.testing.assert_allclose(found.snr_db[0, 0], 20.4, atol=1e-9)


def test_the_correction_runs_linearly_along_edges(tmp_path: Path) -> None:
    """Half-way between two measured positions the model is off by the mean of both errors."""
    found, model = measured_map(tmp_path, ROWS), model_map(tmp_path)
    off = found.edge_snr_db[0, :, 0] - model.edge_snr_db[0, :, 0]
    ends = found.snr_db[:2, 0] - model.snr_db[:2, 0]
    np.testing.assert_allclose(off, np.linspace(ends[0], ends[1], 5), atol=1e-9)
    np.testing.assert_allclose(found.fading_db[:2, 0], ends, atol=1e-9)


def test_radius_and_least_number_decide_what_counts(tmp_path: Path) -> None:
    """A radius of 2.5 m takes in the neighbours' measurements; four are asked for, three there."""
    wide = measured_map(tmp_path, ROWS, ", radius_m = 2.5")
    np.testing.assert_allclose(wide.snr_db[:3, 0], [21, 21, 6], atol=1e-9)
    four = measured_map(tmp_path, ROWS, ", min_samples = 4")
    np.testing.assert_array_equal(four.snr_db, model_map(tmp_path).snr_db)


def test_gaps_can_count_as_uncovered(tmp_path: Path) -> None:
    """Only what was measured to be covered is: −1000 dB elsewhere, and no edge leads there."""
    found = measured_map(tmp_path, ROWS, ', gaps = "uncovered"')
    assert found.covered.tolist() == [[True, False], [False, False]] + [[False, False]] * 2
    np.testing.assert_allclose(found.snr_db[2:], -1000.0)
    assert not found.edge_covered.any()


def test_gaps_can_be_an_error(tmp_path: Path) -> None:
    """Each AP with gaps is told, with the first positions."""
    with pytest.raises(WorldError) as caught:
        measured_map(tmp_path, ROWS, ', gaps = "error"')
    assert [f.key for f in caught.value.faults] == [("radio", "measured")] * 2
    assert (
        "'west' has fewer than 3 measurements within 1 m of 2 of 4 positions (cell [2, 0],"
        in (caught.value.lines[0])
    )


def test_the_survey_is_embedded(tmp_path: Path) -> None:
    """A world once read needs its file no more, and gives the same map to the last bit."""
    path = write(tmp_path, ROWS.replace("\n", "\r\n"))
    world, floor = open_world(path)
    (tmp_path / "s.csv").unlink()
    again = parse_world(dump_world(world))
    assert again == world
    assert again.radio.measured is not None
    assert again.radio.measured.source == "s.csv"
    assert build_radio_map(again, floor).to_bytes() == build_radio_map(world, floor).to_bytes()


def test_the_short_form_is_a_file(tmp_path: Path) -> None:
    """`measured = "s.csv"` is short for a table with the file."""
    path = write(tmp_path, ROWS)
    long = read_world(path)
    path.write_text(path.read_text().replace('{file = "s.csv"}', '"s.csv"'))
    assert read_world(path) == long


WRONG_WORLDS = {
    "file not there": ("s.csv", "x.csv", "w.toml:12: radio.measured: x.csv: there is no such file"),
    "bad row": ("s.csv", "bad.csv", "w.toml:12: radio.measured: bad.csv:2: 'north' is not an"),
    "file and text": ('"s.csv"', '"s.csv", csv = "x"', "radio.measured.csv: is given beside file"),
    "nothing": ('file = "s.csv"', "min_samples = 2", "radio.measured: has none of file, csv"),
    "word": ('"s.csv"', '"s.csv", gaps = "guess"', "radio.measured.gaps"),
}


@pytest.mark.parametrize("case", WRONG_WORLDS)
def test_what_is_wrong_with_a_survey_is_told_at_its_key(tmp_path: Path, case: str) -> None:
    """World, line and key, then the survey's file and line."""
    old, new, words = WRONG_WORLDS[case]
    path = write(tmp_path, ROWS)
    (tmp_path / "bad.csv").write_text(HEAD + "1,1,north,20\n")
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))
    with pytest.raises(WorldError) as caught:
        read_world(path)
    lines = [line.replace(f"{tmp_path}/", "") for line in caught.value.lines]
    assert any(words in line for line in lines), lines


def test_a_forged_survey_in_a_world_is_refused(tmp_path: Path) -> None:
    """A text that is no table is found when the map is made, not a traceback."""
    world, floor = open_world(write(tmp_path, ROWS))
    measured = Measured(csv="no,table\n1,2\n")
    radio = world.radio.model_copy(update={"measured": measured})
    with pytest.raises(WorldError, match="there is no column x"):
        build_radio_map(world.model_copy(update={"radio": radio}), floor)


def test_comparing_finds_the_planted_errors(tmp_path: Path) -> None:
    """+3 dB at 'west', −2 ± 1 dB at 'east': mean, absolute error and deviation by hand."""
    world, floor = open_world(write(tmp_path, ROWS), overrides={"radio.measured": None})
    model = build_radio_map(world, floor)
    error = np.column_stack(([3.0] * 4, [-1.0, -3.0, -1.0, -3.0]))
    rows = [
        f"{x},1,{ap},{float(model.snr_db[v, a] + error[v, a])!r}"
        for v, x in enumerate((1, 3, 5, 7))
        for a, ap in enumerate(APS)
    ]
    survey = parse_survey(HEAD + "\n".join(rows), "s", APS, -80.0)
    both, west, east = compare(survey, floor, model, Measured(csv="", min_samples=1))
    assert (west.ap, west.places, west.samples) == ("west", 4, 4)
    np.testing.assert_allclose((west.mean_db, west.mae_db, west.std_db), (3, 3, 0), atol=1e-9)
    np.testing.assert_allclose((east.mean_db, east.mae_db, east.std_db), (-2, 2, 1), atol=1e-9)
    np.testing.assert_allclose(east.rest_mae_db, 1.0, atol=1e-9)
    np.testing.assert_allclose((both.mean_db, both.mae_db), (0.5, 2.5), atol=1e-9)
    # With the fitted offsets the model's mean error is gone.
    fitted = world.model_copy(
        update={
            "ap": tuple(
                ap.model_copy(update={"offset_db": row.mean_db})
                for ap, row in zip(world.ap, (west, east), strict=True)
            )
        }
    )
    after = compare(survey, floor, build_radio_map(fitted, floor), Measured(csv="", min_samples=1))
    np.testing.assert_allclose([row.mean_db for row in after], 0.0, atol=1e-9)


def test_comparing_needs_measurements_near_positions(tmp_path: Path) -> None:
    """None within the radius: refused in words."""
    world, floor = open_world(write(tmp_path, ROWS), overrides={"radio.measured": None})
    survey = parse_survey(HEAD + "2.5,0,west,20\n", "s", APS, -80.0)
    how = Measured(csv="", min_samples=1, radius_m=0.1)
    with pytest.raises(WorldError, match=r"no position has 1 measurements of an AP within 0.1 m"):
        compare(survey, floor, build_radio_map(world, floor), how)


def test_offsets_are_added_to_every_snr(tmp_path: Path) -> None:
    """`radio.offset_db` for all, an AP's own in its place."""
    plain = model_map(tmp_path)
    overrides = {"radio.measured": None, "radio.offset_db": 2.0, "ap.east.offset_db": -1.5}
    shifted = build_radio_map(*open_world(tmp_path / "w.toml", overrides=overrides))
    np.testing.assert_allclose(shifted.snr_db - plain.snr_db, [[2.0, -1.5]] * 4, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 8), st.integers(0, 1), st.floats(0, 50)), min_size=1,
                max_size=60), st.integers(1, 4))  # fmt: skip
def test_statistics_agree_with_a_plain_loop(
    tmp_path_factory: pytest.TempPathFactory, rows: list[tuple[int, int, float]], least: int
) -> None:
    """Each position against a literal count of the measurements within 1 m."""
    folder = tmp_path_factory.mktemp("survey")
    _, floor = open_world(write(folder, ROWS))
    text = HEAD + "".join(f"{x},1,{APS[a]},{v!r}\n" for x, a, v in rows)
    found = at_vertices(parsed(text), floor, APS, Measured(csv="", min_samples=least, radius_m=1.0))
    for v, (vx, _) in enumerate(floor.vertex_xy_m.tolist()):
        for a in (0, 1):
            near = [value for x, b, value in rows if b == a and abs(x - vx) <= 1.0]
            assert found.count[v, a] == len(near)
            if len(near) < least:
                assert np.isnan(found.snr_db[v, a])
            else:
                assert found.snr_db[v, a] == pytest.approx(float(np.median(near)))
