"""`twin plan MAP.map --scen FILE.scen --agents K` and `--method decoupled`, seen by a user."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli_tools import hall, twin

__all__ = ["hall"]  # a fixture

MAP = "type octile\nheight 3\nwidth 5\nmap\n..@..\n.....\n..@..\n"
ROWS = ("0\tgate.map\t5\t3\t0\t1\t4\t1\t4\n", "0\tgate.map\t5\t3\t4\t0\t0\t0\t4.8\n")


@pytest.fixture
def gate(tmp_path, monkeypatch) -> Path:
    """A map with a gate, its scenario of two agents beside it, in the current folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gate.map").write_text(MAP)
    (tmp_path / "gate.scen").write_text("version 1\n" + "".join(ROWS))
    return tmp_path


def test_map_and_scenario_are_planned(gate):
    """Cost = slots, a horizon chosen by itself, and a word on what lies beyond it."""
    done = twin("plan", "gate.map", "--scen", "gate.scen", "--agents", 2, "-o", "plan.json")
    assert done.code == 0, done.err
    assert "gate.map, gate.scen, 2 agents" in done.out
    assert "The bound holds for plans of any length" in done.out
    assert [p["robot"] for p in json.loads((gate / "plan.json").read_text())["paths"]] == [
        "r00",
        "r01",
    ]


def test_json_says_what_holds_for_any_horizon(gate):
    """The bound, cut at the least cost of a plan that the horizon excludes."""
    done = twin("plan", "gate.map", "--scen", "gate.scen", "--agents", 2, "--json")
    mapf, plan = done.json["mapf"], done.json["plan"]
    assert plan["cost"] == plan["slots"] == 12  # 4 + 6 alone, and one gate for both
    assert mapf["lower_bound_of_any_horizon"] == plan["lower_bound"]
    assert mapf["cheapest_beyond_horizon"] > plan["cost"]


def test_horizon_and_passable_cells_are_options(gate):
    """Too few slots is a proof for these slots only; other symbols open the wall."""
    arguments = ("plan", "gate.map", "--scen", "gate.scen", "--agents", 2)
    short = twin(*arguments, "--horizon", 5)
    assert short.code == 1
    assert "This holds for the horizon of 5 slots; --horizon chooses another." in short.out
    open_gate = twin(*arguments, "--passable", ".@", "--json")
    assert open_gate.json["plan"]["cost"] == 8  # 4 each
    assert open_gate.json["problem"]["vertices"] == 15


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "gate.map: a map has no robots; give --scen FILE.scen and --agents K"),
        (("--scen", "gate.scen"), "say with --agents how many of its 2 rows are robots"),
        (("--scen", "gate.scen", "--agents", 3), "ask for at most 2"),
        (("--scen", "gate.map", "--agents", 1), "a scenario begins with the line 'version 1'"),
        (("--scen", "none.scen", "--agents", 1), "none.scen: there is no such file"),
        (("--scen", "gate.scen", "--agents", 1, "--horizon", 0), "horizon: 0: must be 1 to"),
        (("--scen", "gate.scen", "--agents", 1, "--objective", "hp"), "--objective: gate.map is"),
        (("--scen", "gate.scen", "--agents", 1, "--set", "a.b=1"), "--set: gate.map is a map"),
    ],
)
def test_refusals(gate, arguments, words):
    """One sentence on stderr, exit code 2."""
    done = twin("plan", "gate.map", *arguments)
    assert done.code == 2
    assert words in done.err
    assert done.out == ""


def test_options_of_maps_are_refused_elsewhere(hall):
    """A world has its own robots and horizon."""
    done = twin("plan", hall, "--agents", 2, "--horizon", 9)
    assert done.code == 2
    assert "--agents: is for a MovingAI .map" in done.err
    assert "--set plan.horizon=T" in done.err


def test_decoupled_method(hall):
    """It plans a world, and its halves are in the counters."""
    done = twin("plan", hall, "--method", "decoupled", "--iterations", 50, "--json")
    assert done.code == 0, done.err
    solver = done.json["plan"]["solver"]
    assert solver["motion_slots"] == done.json["plan"]["slots"]
    assert solver["assignment_handovers"] == done.json["plan"]["handovers"]


def test_decoupled_without_room_says_where(hall):
    """Exit code 1, no plan, and the AP and the slots in which places are missing."""
    arguments = ("--set", "radio.ap_capacity=1", "--set", "ap.right.enabled=false")
    arguments += ("--set", "radio.tx_power_dbm=40")
    done = twin("plan", hall, "--method", "decoupled", "--iterations", 50, "--json", *arguments)
    assert done.code == 1, done.err
    plan = done.json["plan"]
    assert plan["status"] == "unknown"
    assert "left (up to 2 robots for 1 places) in slots" in plan["message"]
