"""`worlds.check`: every code is given where it should be, and not where it should not."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import QuadMesh

from tests.worlds.floors import grid_floor
from worlds.check import CheckReport, Finding, check_world
from worlds.check_codes import CODES, codes_page, known_code, parse_codes, severity
from worlds.check_figure import check_figure
from worlds.check_floor import cut_off_sizes
from worlds.check_radio import _unserved
from worlds.errors import WorldError
from worlds.toml_file import parse_world, read_world

ROOT = Path(__file__).resolve().parents[2]

# 8 x 4 positions, 1 m apart; two APs above it that both reach everything; two robots.
GOOD = """\
format = "mapp-world/1"
name = "good"
[hall]
size_m = [8.0, 4.0]
pitch_m = 1.0
[hall.body]
length_m = 0.5
width_m = 0.4
[[obstacle]]
name = "rack"
center_m = [4.0, 3.0]
size_m = [2.0, 2.0]
[[ap]]
id = "west"
position_m = [1.0, 1.0, 4.0]
[[ap]]
id = "east"
position_m = [7.0, 1.0, 4.0]
capacity = 2
[radio]
ap_capacity = 2
[[robot]]
id = "anna"
start = {cell = [0, 0]}
goal = {cell = [7, 3]}
[[robot]]
id = "bert"
start = {cell = [7, 0]}
goal = {cell = [0, 3]}
[plan]
horizon = 30
"""
ONE_AP = GOOD[GOOD.index('[[ap]]\nid = "east"') : GOOD.index("[radio]")]
STATION = '[[station]]\nname = "dock"\n'


def wall(x: float, name: str = "wall", height: float = 2.0, depth: float = 4.0) -> str:
    """A wall across the lower `depth` metres of the hall."""
    box = f"center_m = [{x}, {depth / 2}]\nsize_m = [0.4, {depth}]\nheight_m = {height}\n"
    return f'[[obstacle]]\nname = "{name}"\n{box}'


def edited(*edits: tuple[str, str], more: str = "") -> str:
    """GOOD with replacements (each is there once) and more tables at its end."""
    text = GOOD
    for old, new in edits:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text + more


def check(text: str, **options: Any) -> CheckReport:
    """The report on a text."""
    return check_world(parse_world(text), **options)


def codes(report: CheckReport) -> list[str]:
    """Its codes, in order."""
    return [finding.code for finding in report.findings]


def one(text: str, code: str) -> Finding:
    """The first finding of a code."""
    found = [f for f in check(text).findings if f.code == code]
    assert found, f"{code} is missing: {codes(check(text))}"
    return found[0]


def test_nothing_is_found_in_a_good_world() -> None:
    """Only that each AP could be left out, which the notes of a small hall cannot avoid."""
    report = check(GOOD)
    assert set(codes(report)) <= {"W202"}
    assert report.passed()


# What makes a world unusable: code, edits, further tables, part of the message
ERRORS: dict[str, tuple[list[tuple[str, str]], str, str]] = {
    "E101": ([("[7.0, 1.0, 4.0]", "[7000.0, 1000.0, 4.0]")], "", "millimetres"),
    "E102": ([("[7.0, 1.0, 4.0]", "[4.0, 3.0, 1.0]")], "", "'east' inside 'rack'"),
    "E103": ([("[4.0, 3.0]", "[40.0, 3.0]")], "", "'rack' outside"),
    "E104": ([], STATION + "cell = [8, 0]\n", "'dock'"),
    "E105": ([("[7, 3]", "[7, 4]")], "", "outside the grid"),
    "E106": ([("[7, 3]", "[3, 3]")], "", "touches 'rack'"),
    "E107": ([("[plan]", "[run]\nseed = 1\n[plan]")], "", ""),  # see its own test
    "E108": ([("[7, 0]", "[0, 0]")], "", "'anna' already"),
    "E109": ([], wall(6.0, depth=4.0), "no free way"),
    "E111": ([("horizon = 30", "horizon = 9")], "", "needs 10 slots"),
    "E112": ([("width_m = 0.4", "width_m = 0.8")], "", "too wide"),
    "E113": ([("[2.0, 2.0]", "[20.0, 20.0]")], "", "none of the 8 x 4"),
    "E114": ([(GOOD[GOOD.index("[[robot]]") : GOOD.index("[plan]")], "")], "", "no robot"),
    "E115": ([('"west"', '"west"\nenabled = false'), (ONE_AP, "")], "", "switched off"),
    "E116": ([("ap_capacity = 2", "threshold_db = 200.0")], "", "reached nowhere"),
    "E117": ([("ap_capacity = 2", "ap_capacity = 1"), (ONE_AP, "")], "", "serve 1 robots"),
}


@pytest.mark.parametrize("code", [c for c in ERRORS if c != "E107"])
def test_errors(code: str) -> None:
    """Each error is found, says what is wrong, and makes the check fail."""
    edits, more, words = ERRORS[code]
    text = edited(*edits, more=more)
    assert words in one(text, code).message
    assert not check(text).passed()


FAR = """\
[[ap]]
id = "far"
position_m = [0.5, 0.5, 4.0]
tx_power_dbm = -7.0
"""


def test_a_place_without_coverage_is_told_by_robot() -> None:
    """E107: only the robot beyond the reach of the weak AP is named, with the key of its place."""
    text = GOOD[: GOOD.index("[[ap]]")] + FAR + GOOD[GOOD.index("[radio]") :]
    found = [f for f in check(text).findings if f.code == "E107"]
    assert {f.key for f in found} <= {
        ("robot", i, end) for i in (0, 1) for end in ("start", "goal")
    }
    assert ("robot", 0, "goal") in {f.key for f in found}
    assert ("robot", 0, "start") not in {f.key for f in found}
    assert found[0].places_m


def test_a_goal_behind_a_radio_hole_is_told() -> None:
    """E110: floor leads there, coverage does not; W206 tells it of the floor."""
    weak = ("ap_capacity = 2", "ap_capacity = 2\ntx_power_dbm = -8.0")
    report = check(edited(weak, ("[7, 3]", "[7, 1]"), ("[0, 3]", "[0, 1]")))
    assert "E110" in codes(report), [f.message for f in report.findings]
    assert "W206" in codes(report)
    assert "W204" in codes(report)


def test_robots_that_start_under_one_access_point_overload_it() -> None:
    """E118: capacity is enough in all, but three stand where only one AP for two reaches (§1.6)."""
    weak = ("ap_capacity = 2", "ap_capacity = 2\ntx_power_dbm = -7.0")
    text = edited(weak, ("[7, 3]", "[7, 1]"), ("[0, 3]", "[7, 0]"))
    third = '[[robot]]\nid = "carl"\nstart = {cell = [0, 1]}\ngoal = {cell = [6, 0]}\n'
    fourth = third.replace("carl", "dora").replace("[0, 1]", "[1, 0]").replace("[6, 0]", "[6, 1]")
    text = text.replace("start = {cell = [7, 0]}", "start = {cell = [1, 1]}")
    report = check(text.replace("[plan]", f"{third}{fourth}[plan]"))
    assert "E117" not in codes(report)
    assert "E118" in codes(report), [f.message for f in report.findings]


def test_service_at_once_is_a_matching() -> None:
    """A serves two robots and B one: two only A reaches and one both are served, a third not."""
    covered = np.array([[1, 0], [1, 0], [1, 1]], dtype=bool)
    assert not len(_unserved(covered, np.array([2, 1])))
    assert len(_unserved(np.vstack((covered, [[1, 0]])).astype(bool), np.array([2, 1]))) == 1
    assert len(_unserved(covered, np.array([0, 0]))) == 3


WARNINGS: dict[str, tuple[list[tuple[str, str]], str, str]] = {
    "W101": ([], STATION + "cell = [3, 3]\n", "'rack'"),
    "W103": ([], wall(1.5, depth=4.0).replace("0.4, 4.0", "0.9, 4.0"), "cut off by one blocked"),
    "W104": ([], wall(2.0), "not connected"),
    "W105": ([], wall(6.0, depth=3.0), "the only way"),
    "W106": ([("width_m = 0.4", "width_m = 0.6")], "", "corners"),
    "W108": ([("horizon = 30", "horizon = 11")], "", "80%"),
    "W201": ([("capacity = 2\n[radio]", "tx_power_dbm = -90.0\n[radio]")], "", "'east' reaches"),
    "W202": ([], "", "redundancy"),
    "W203": ([(ONE_AP, "")], "", "one access point only"),
    "W207": ([("capacity = 2\n[radio]", "capacity = 1\n[radio]")], "", "without 'west'"),
    "W208": ([("[7.0, 1.0, 4.0]", "[7.0, 1.0, 0.4]")], "", "0.4 m high"),
    "W301": ([("[7.0, 1.0, 4.0]", "[7.0, 1.0, 100.0]")], "", "then write 0.1"),
    "W302": ([("pitch_m = 1.0", "pitch_m = 1.0\nslot_s = 0.1")], "", "10 m/s"),
    "W303": ([], wall(4.0, "copy").replace("4.0, 2.0", "4.0, 3.0").replace("0.4, 4.0", "1, 1"), ""),
    "W304": ([], wall(1.0, "lamp") + "base_m = 9.0\n", "above all"),
    "N101": ([], STATION + "cell = [1, 1]\n", "'dock'"),
    "N102": ([("capacity = 2\n[radio]", "enabled = false\n[radio]")], "", "'east' is off"),
    "N103": ([("[0, 3]", "[7, 3]")], "", "same goal"),
}


@pytest.mark.parametrize("code", WARNINGS)
def test_warnings_and_notes(code: str) -> None:
    """Each is found with its words, and alone does not make the check fail."""
    edits, more, words = WARNINGS[code]
    found = one(edited(*edits, more=more), code)
    assert words in found.message
    assert found.severity in {"warning", "note"}


def test_crowded_floor() -> None:
    """W107: fourteen robots on 28 positions."""
    drawn = GOOD[: GOOD.index("[[robot]]")] + "[robots.random]\ncount = 14\n[plan]\nhorizon = 30\n"
    drawn = drawn.replace("ap_capacity = 2", "ap_capacity = 20")
    assert "W107" in codes(check(drawn))
    assert "W107" not in codes(check(drawn.replace("count = 14", "count = 11")))


def test_station_without_coverage() -> None:
    """W102: an unused station out of reach."""
    text = GOOD[: GOOD.index("[[ap]]")] + FAR + GOOD[GOOD.index("[radio]") :]
    assert "'dock'" in one(text + STATION + "cell = [7, 1]\n", "W102").message


def test_edges_with_a_hole_depend_on_the_rule() -> None:
    """W205: the paper's hall, whose rule looks at the ends only, has edges with holes (page 3)."""
    world = read_world(ROOT / "worlds/paper_hall.toml")
    (found,) = [f for f in check_world(world).findings if f.code == "W205"]
    assert "unawares" in found.message
    sampled = read_world(ROOT / "worlds/paper_hall.toml", overrides={"radio.edge_rule": "samples"})
    (found,) = [f for f in check_world(sampled).findings if f.code == "W205"]
    assert "not used" in found.message


def test_beyond_the_range_of_the_model() -> None:
    """W209: InH is made for 150 m; at 200 m there is coverage, but no measurement behind it."""
    text = GOOD.replace("[8.0, 4.0]", "[210.0, 4.0]").replace("pitch_m = 1.0", "pitch_m = 2.0")
    text = text.replace(ONE_AP, "").replace("[7, 3]", "[7, 1]").replace("[0, 3]", "[0, 1]")
    assert "150 m" in one(text.replace(GOOD[GOOD.index("[[obstacle]]") : GOOD.index("[[ap]]")], ""),
                          "W209").message  # fmt: skip


def test_one_error_does_not_hide_another() -> None:
    """A misplaced AP, robot and station, a lost obstacle and a hole are all told in one go."""
    text = edited(
        ("[7.0, 1.0, 4.0]", "[4.0, 3.0, 1.0]"),
        ("[7, 3]", "[3, 3]"),
        ("horizon = 30", "horizon = 5"),
        more=STATION + "cell = [9, 9]\n" + wall(50.0),
    )
    found = codes(check(text))
    assert {"E102", "E103", "E104", "E106", "E111"} <= set(found)
    assert "E117" not in found  # nor is one mistake told twice: with that AP capacity would do
    assert len(found) == len(
        set(zip(found, [f.message for f in check(text).findings], strict=True))
    )


def test_a_finding_keeps_the_index_of_its_element() -> None:
    """After elements at fault are set aside, later ones are still named by their own place."""
    third = '[[robot]]\nid = "carl"\nstart = {cell = [1, 1]}\ngoal = {cell = [4, 3]}\n'
    report = check(edited(("[7, 3]", "[3, 3]"), ("[plan]", f"{third}[plan]")))
    assert [f.key for f in report.findings if f.code == "E106"] == [
        ("robot", 0, "goal"),
        ("robot", 2, "goal"),
    ]


def test_findings_are_in_order_and_repeatable() -> None:
    """Errors first, then by code; the same world gives the same report."""
    text = edited(("[7, 3]", "[3, 3]"), more=STATION + "cell = [1, 1]\n")
    report = check(text)
    ranks = ["EWN".index(code[0]) for code in codes(report)]
    assert ranks == sorted(ranks)
    assert check(text).findings == report.findings


def test_ignored_codes_are_left_out_and_counted() -> None:
    """`ignore` drops warnings and notes, and says how many."""
    text = edited(more=STATION + "cell = [1, 1]\n")
    whole, less = check(text), check(text, ignore=("N101",))
    assert len(whole.findings) - len(less.findings) == less.ignored == 1
    assert "N101" not in codes(less)


def test_cut_off_sizes_are_those_of_taking_each_position_away() -> None:
    """Against the literal way: remove a vertex, count what no longer hangs together."""
    rng = np.random.default_rng(4)
    for _ in range(12):
        blocked = [(c, r) for c in range(6) for r in range(5) if rng.random() < 0.35]
        floor = grid_floor(6, 5, blocked=blocked)
        n = len(floor.vertex_xy_m)
        near: dict[int, set[int]] = {v: set() for v in range(n)}
        for u, v in floor.edge_uv.tolist():
            near[u].add(v)
            near[v].add(u)

        def spread(start: int, gone: int, near: dict[int, set[int]] = near) -> set[int]:
            seen, todo = {start}, [start]
            while todo:
                for w in near[todo.pop()] - seen - {gone}:
                    seen.add(w)
                    todo.append(w)
            return seen

        main = max((spread(v, -1) for v in range(n)), key=len)
        found = cut_off_sizes(floor, np.array(sorted(main)))
        for v in range(n):
            rest = main - {v}
            largest = max((len(spread(u, v)) for u in rest), default=0)
            assert found[v] == (len(rest) - largest if v in main else 0)


# Codes and their page


def test_every_code_is_tested_and_explained() -> None:
    """The table holds what the tests above provoke, and each entry has all its words."""
    own_tests = {"E100", "E107", "E110", "E118", "W102", "W107", "W204", "W205", "W206", "W209"}
    own_tests |= {"E119", *(f"W{n}" for n in range(109, 117)), "W210", "W211"}  # test_check_lanes
    assert set(ERRORS) | set(WARNINGS) | own_tests == set(CODES)
    for code, entry in CODES.items():
        assert re.fullmatch(r"[EWN]\d{3}", code)
        assert entry.title
        assert entry.why.endswith(".")
        assert entry.mend.endswith(".")


def test_codes_are_parsed_and_misspelt_ones_refused() -> None:
    """Any case and spaces; unknown codes and errors cannot be ignored, all told at once."""
    assert parse_codes(" w103, N101,W103,") == ("W103", "N101")
    assert known_code("e101") == "E101"
    with pytest.raises(WorldError) as caught:
        parse_codes("W2O9,E101")
    assert "did you mean 'W209'" in caught.value.lines[0]
    assert "cannot be ignored" in caught.value.lines[1]


def test_the_committed_page_is_current() -> None:
    """docs/check-codes.md is what the table says; else `twin schema -o docs/check-codes.md`."""
    assert (ROOT / "docs/check-codes.md").read_text(encoding="utf-8") == codes_page()


# The picture


def test_the_picture_marks_findings_with_a_place() -> None:
    """Each code is in the legend; marks are where the findings are; coverage lies below."""
    report = check(edited(("[7, 3]", "[3, 3]"), more=STATION + "cell = [1, 1]\n"))
    figure = check_figure(report)
    hall, side = figure.axes
    said = " ".join(text.get_text() for text in side.get_legend().get_texts())
    assert all(code in said for code in codes(report))
    marks = {(round(x, 2), round(y, 2)) for line in hall.lines for x, y in line.get_xydata()}
    assert (3.5, 3.5) in marks
    assert any(isinstance(c, QuadMesh) for c in hall.collections)


def test_a_hall_without_a_free_position_is_drawn_all_the_same() -> None:
    """No floor, no radio: walls and obstacles, and the codes."""
    report = check(edited(("[2.0, 2.0]", "[20.0, 20.0]")))
    assert report.floor is None
    legend = check_figure(report).axes[1].get_legend()
    assert any("E113" in text.get_text() for text in legend.get_texts())


def test_severities() -> None:
    """By the first letter."""
    assert [severity(code) for code in ("E101", "W101", "N101")] == ["error", "warning", "note"]
