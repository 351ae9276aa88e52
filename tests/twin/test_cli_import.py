"""`twin import` as a user meets it: from a map to a world that runs; refusals harm nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.cli_tools import files_below, twin
from tests.worlds.test_map_import import ROOMS, SCENARIO
from tests.worlds.test_ros_map import YAML, write

SHARED = Path(__file__).parents[3] / "shared/data"


@pytest.fixture
def maps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder, the current one, with a ROS map of 12 m x 10 m and a MovingAI map."""
    monkeypatch.chdir(tmp_path)
    levels = np.full((20, 24), 255)
    levels[6:14, 10:13] = 0
    write(tmp_path, levels, YAML)
    Path("rooms.map").write_text(ROOMS)
    Path("rooms.scen").write_text(SCENARIO)
    return tmp_path


def test_from_a_ros_map_to_a_run(maps: Path) -> None:
    """Import, check, radio and run with default options but for the number of robots."""
    done = twin("import", "map.yaml", "--robots", "4", "--json")
    assert done.code == 0, done.err
    assert done.json["file"] == "map.toml"
    assert done.json["robots"] == 4
    assert twin("check", "map.toml").code == 0
    assert twin("radio", "map.toml").code == 0
    run = twin("run", "map.toml", "-o", "out", "--json")
    assert run.code == 0, run.err
    assert run.json["succeeded"]


def test_from_a_benchmark_map_with_its_scenario(maps: Path) -> None:
    """Errands from the scenario; a plan exists."""
    done = twin("import", "rooms.map", "--scen", "rooms.scen", "--robots", "2", "-o", "w/r.toml")
    assert done.code == 0, done.err
    assert "2 of 0.57 m x 0.42 m" in done.out
    assert twin("plan", "w/r.toml", "--json").json["plan"]["served"] == 2


REFUSED = {
    "no such file": (["none.yaml"], "no such file"),
    "no map": (["rooms.scen"], "is not a map"),
    "exists": (["rooms.map", "-o", "there.toml"], "--overwrite"),
    "no world's name": (["rooms.map", "-o", "rooms.txt"], "must end in .toml"),
    "unknown symbol": (["bad.map"], "bad.map:5: row 0, column 0: unknown symbol 'x'"),
    "cut short": (["short.map"], "cut short"),
    "image absent": (["lost.yaml"], "there is no such image"),
    "option of the other format": (["rooms.map", "--unknown", "free"], "--unknown: not for a"),
    "scenario for a ROS map": (["map.yaml", "--scen", "rooms.scen"], "--scen: not for a ROS"),
    "scenario for another map": (
        ["other.map", "--scen", "rooms.scen", "--robots", "1"],
        "this map",
    ),
    "scenario too short": (["rooms.map", "--scen", "rooms.scen"], "20 agents are asked for"),
    "body": (["rooms.map", "--body", "big"], "such as 0.8,0.6"),
    "body too wide": (["rooms.map", "--body", "0.9,0.9", "--pitch", "1"], "too wide"),
    "pitch": (["map.yaml", "--pitch", "0"], "outside 0.01 to 100"),
    "pitch below a pixel": (["map.yaml", "--pitch", "0.1"], "finer than the map's pixels"),
    "pitch above the hall": (["map.yaml", "--pitch", "50"], "none is free next to another"),
    "coverage in per cent": (["map.yaml", "--coverage", "99"], "give 0.99 for 99 %"),
    "unknown model": (["map.yaml", "--model", "office"], "is not a channel model"),
    "too many robots": (["rooms.map", "--robots", "500"], "500 robots need 501"),
    "APs far too high": (["map.yaml", "--ap-height", "500"], "outside 0 to 100 m"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_imported_is_refused_in_words(maps: Path, case: str) -> None:
    """Exit code 2, one line with the words, and nothing written or changed."""
    Path("there.toml").write_text("mine")
    Path("bad.map").write_text(ROOMS.replace(".", "x", 1))
    Path("other.map").write_text(ROOMS)
    Path("short.map").write_text(ROOMS[:-12])
    Path("lost.yaml").write_text(YAML.replace("map.pgm", "lost.pgm"))
    before = files_below(maps)
    args, words = REFUSED[case]
    done = twin("import", *args)
    assert done.code == 2, done.out
    assert words in done.err, done.err
    assert len(done.err.strip().splitlines()) == 1, done.err
    assert files_below(maps) == before
    assert Path("there.toml").read_text() == "mine"


@pytest.mark.parametrize("name", ["ros/tb3_sandbox.yaml", "movingai/room-32-32-4.map"])
def test_real_maps_with_default_options(maps: Path, name: str) -> None:
    """Twenty robots, no error found, nearly all of the floor covered."""
    if not SHARED.exists():
        pytest.skip("../shared/data is not here")
    done = twin("import", SHARED / name, "-o", "world.toml", "--json")
    assert done.code == 0, done.err
    assert done.json["robots"] == 20
    assert done.json["covered_share"] > 0.98
    assert twin("check", "world.toml", "--json").json["errors"] == 0
