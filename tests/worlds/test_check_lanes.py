"""`twin check` on graphs and surveys: every code of theirs, planted and found."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.worlds.lifs import edge, layout, node, spoilt, write_world
from worlds.check import Finding, check_world
from worlds.toml_file import read_world

Edits = tuple[tuple[str, str], ...]

RACK = '[[obstacle]]\nname = "rack"\ncenter_m = [{}]\nsize_m = [1.0, 1.0]\n[plan]'


def findings(folder: Path, *edits: tuple[str, str], lif: str | None = None) -> list[Finding]:
    """What the check finds in the ring's world after replacements."""
    return list(check_world(read_world(write_world(folder, *edits, lif=lif))).findings)


def test_a_sound_graph_is_clean(tmp_path: Path) -> None:
    """Nothing but that each AP could be left out, once the spur is as fast as the ring."""
    speed = {"maxSpeed": 1.0}
    fast = spoilt(lambda v: layout(v)["edges"][4]["vehicleTypeEdgeProperties"][0].update(speed))
    assert {f.code for f in findings(tmp_path, lif=fast)} <= {"W202"}


def _add(*edges: dict[str, Any], nodes: tuple[dict[str, Any], ...] = ()) -> str:
    def change(value: Any) -> None:
        layout(value)["edges"] += edges
        layout(value)["nodes"] += nodes

    return spoilt(change)


TRAJECTORY = {"trajectory": {"knotVector": [], "controlPoints": []}}
CASES: dict[str, tuple[str, Edits, str | None, str]] = {
    "against the lanes": ("E119", (("[plan]", RACK.format("8.0, 2.0")),), None, "to goal node 'b'"),
    "no way out": (
        "W109",
        (),
        _add(edge("c", "e"), nodes=(node("e", 8.0, 4.0),)),
        "node 'e' cannot be left along the lanes",
    ),
    "no way in": (
        "W109",
        (),
        _add(edge("e", "c"), nodes=(node("e", 8.0, 4.0),)),
        "node 'e' cannot be entered along the lanes",
    ),
    "no lane": ("W109", (), _add(nodes=(node("e", 8.0, 4.0),)), "node 'e' has no lane"),
    "trap": (
        "W110",
        (),
        _add(
            *(edge("c", "e"), edge("e", "f"), edge("f", "e")),
            nodes=(node("e", 8.0, 4.0), node("f", 8.0, 2.0)),
        ),
        "nodes 'e', 'f' can be entered, but not left",
    ),
    "source": (
        "W110",
        (),
        _add(
            *(edge("e", "c"), edge("e", "f"), edge("f", "e")),
            nodes=(node("e", 8.0, 4.0), node("f", 8.0, 2.0)),
        ),
        "nodes 'e', 'f' can be left, but not entered",
    ),
    "blocked": ("W111", (("[plan]", RACK.format("8.0, 6.0")),), None, "'c'–'d' ('rack')"),
    "near nodes": (
        "W112",
        (),
        _add(edge("c", "e"), edge("e", "c"), nodes=(node("e", 6.5, 4.0),)),
        "1 pair of nodes are nearer than bodies of 0.6 m x 0.4 m: 'c' and 'e'",
    ),
    "crossing": (
        "W113",
        (),
        _add(
            *(edge("e", "f"), edge("f", "e")),
            nodes=(node("e", 3.0, -1.0), node("f", 3.0, 2.0)),
        ),
        "'a'–'b' and 'e'–'f'",
    ),
    "slow corner": ("W114", (("slot_s = 1.0", "slot_s = 0.5"),), None, "robots following each"),
    "trajectory": (
        "W115",
        (),
        spoilt(lambda v: layout(v)["edges"][0]["vehicleTypeEdgeProperties"][0].update(TRAJECTORY)),
        "1 edge has a trajectory",
    ),
    "slots too long": ("W116", (("slot_s = 1.0", "slot_s = 7.0"),), None, "lanes take"),
    "stations": ("N101", (('goal = "shelf"', 'goal = {node = "c"}'),), None, ""),
}


@pytest.mark.parametrize("case", [c for c in CASES if c != "stations"])
def test_planted_defects_are_found(tmp_path: Path, case: str) -> None:
    """The code, with the words that name the place."""
    code, edits, lif, words = CASES[case]
    found = [f.message for f in findings(tmp_path, *edits, lif=lif) if f.code == code]
    assert any(words in message for message in found), found


def test_many_unused_stations_of_a_layout_are_one_note(tmp_path: Path) -> None:
    """A layout has all stations of the plant; ten notes would hide what matters."""

    def more(value: Any) -> None:
        layout(value)["stations"] += [
            {"stationId": f"s{k}", "interactionNodeIds": ["c"]} for k in range(6)
        ]

    notes = [f for f in findings(tmp_path, lif=spoilt(more)) if f.code == "N101"]
    assert [f.message for f in notes] == [
        "no robot starts or ends at 6 of 8 stations, 's0', 's1', 's2' among them"
    ]


MEASURED: Edits = (("[plan]", '[radio]\nmeasured = "s.csv"\n[plan]'),)


def _survey(folder: Path, *rows: str) -> list[Finding]:
    (folder / "s.csv").write_text("\n".join(["x,y,ap,snr_db", *rows]))
    return findings(folder, *MEASURED)


def test_gaps_of_a_survey_are_found(tmp_path: Path) -> None:
    """W210: which access point lacks measurements where; none where there are enough."""
    three = [f"5.0,2.0,west,{value}" for value in (20, 21, 22)]
    found = [f for f in _survey(tmp_path, *three) if f.code == "W210"]
    assert "'west' has fewer than 3 measurements within 0.75 m of 4 of 5" in found[0].message
    assert found[0].key == ("radio", "measured")
    at = [(5, 2), (11, 2), (11, 6), (5, 6), (2, 6)]
    full = [f"{x},{y},{ap},30" for x, y in at for ap in ("west", "east") for _ in range(3)]
    assert "W210" not in {f.code for f in _survey(tmp_path, *full)}


def test_a_survey_far_from_the_model_is_told(tmp_path: Path) -> None:
    """W211 names the access point whose measurements are 10 dB off; not the other."""
    rows = [f"5.0,2.0,west,{value}" for value in (-10, -10, -10)]
    found = [f for f in _survey(tmp_path, *rows) if f.code == "W211"]
    assert len(found) == 1
    assert found[0].message.startswith("'west' is measured")
    assert "worse than the model" in found[0].message
    assert found[0].key == ("ap", 0)
