"""`twin suggest` as a user meets it: lines to paste, a new world, proofs and refusals."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from tests.cli_tools import HALL, files_below, hall, twin
from worlds.radio_map import build_radio_map, kept_edges
from worlds.toml_file import open_world, read_world

__all__ = ["hall"]  # a fixture

# So little power that the shadows of the rack and the far corners are dark.
WEAK = ("--set", "radio.tx_power_dbm=-2", "--set", "radio.threshold_db=12")


def test_lines_to_paste_make_the_world_it_writes(hall: Path) -> None:
    """The `[[ap]]` lines printed, appended by hand, give what -o writes; comments survive there."""
    hall.write_text("# mine\n" + HALL.replace("tx_power_dbm = 6.0", "tx_power_dbm = -8.0"))
    printed = twin("suggest", hall, "--grid", "2")
    assert printed.code == 0, printed.err
    lines = printed.out[printed.out.index("[[ap]]") : printed.out.rindex("\n\n") + 1]
    assert tomllib.loads(lines)["ap"]
    written = twin(
        "suggest", hall, "--grid", "2", "-o", "new.toml", "--picture", "new.png", "--json"
    )
    assert written.code == 0, written.err
    text = Path("new.toml").read_text()
    assert text.startswith("# mine\n")
    by_hand = hall.parent / "pasted.toml"
    by_hand.write_text(hall.read_text() + "\n" + lines)
    assert read_world(Path("new.toml")) == read_world(by_hand)
    assert Path("new.png").read_bytes().startswith(b"\x89PNG")
    result = written.json
    assert result["optimal"]
    assert result["share_before"] < result["share_after"] == 1.0
    radio = twin("radio", "new.toml", "--json").json
    assert radio["covered"] == radio["positions"]


def test_with_overrides_the_world_is_written_anew(hall: Path) -> None:
    """What --set changes is in the new file, too."""
    done = twin("suggest", hall, *WEAK, "--grid", "2", "-o", "new.toml", "--json")
    assert done.code == 0, done.err
    new = read_world(Path("new.toml"))
    assert (new.radio.tx_power_dbm, new.radio.threshold_db) == (-2, 12)
    assert len(new.ap) == 2 + len(done.json["added"])


def test_a_proof_is_told_in_words(hall: Path) -> None:
    """Optimal, how many mounts were compared, and the share before and after."""
    done = twin("suggest", hall, *WEAK, "--add", "1", "--walls", "2")
    assert done.code == 0
    assert "optimal: no choice of 1 of these mounts covers more" in done.out
    assert "mounts" in done.out
    assert "1 more access point: " in done.out
    both = twin("suggest", hall, *WEAK, "--redundant", "--grid", "2", "--json")
    assert both.code == 0, both.err
    assert both.json["share_after"] == 1.0
    assert both.json["single_after"] == 0


def test_not_needed_ones_are_named_and_switched_off(hall: Path) -> None:
    """A third access point beside another is not needed; -o keeps it, off."""
    extra = '[[ap]]\nid = "spare"\nposition_m = [1.2, 4.0, 3.5]\n\n[radio]'
    hall.write_text(HALL.replace("[radio]", extra))
    done = twin("suggest", hall, "--remove", "-o", "less.toml", "--json")
    assert done.code == 0, done.err
    assert len(done.json["removed"]) == 1
    (gone,) = done.json["removed"]
    assert gone in {"left", "spare"}
    assert {a.id: a.enabled for a in read_world(Path("less.toml")).ap}[gone] is False
    assert "not needed: " in twin("suggest", hall, "--remove").out
    assert twin("suggest", hall, "--remove", "--json").json["removed"] == [gone]


def test_out_of_reach_is_an_answer(hall: Path) -> None:
    """Mounts that cannot do it: exit code 1 and how many positions are out of their reach."""
    Path("mounts.csv").write_text("x_m,y_m,height_m\n1,1,3.5\n")
    done = twin("suggest", hall, *WEAK, "--mounts", "mounts.csv", "--k", "3")
    assert done.code == 1
    assert "places are out of reach of these mounts" in done.out


def test_from_nothing(hall: Path) -> None:
    """--fresh looks at the floor without what hangs there, and writes it so."""
    done = twin("suggest", hall, "--fresh", "--grid", "2", "-o", "new.toml", "--json")
    assert done.code == 0, done.err
    assert done.json["share_before"] == 0.0
    ids = [a.id for a in read_world(Path("new.toml")).ap]
    assert ids == [a["id"] for a in done.json["added"]]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--add", "1", "--remove"), "three questions"),
        (("--grid", "2", "--walls", "2"), "give one"),
        (("--remove", "--fresh"), "what hangs there"),
        (("--mounts", "none.csv"), "no such file"),
        (("--grid", "0.1", "--set", "hall.size_m=[40,20]"), "space them wider"),
        (("-o", "new.png"), "must end in .toml"),
        (("--plan", "nothing.txt"), "neither a plan.json nor a RUN.mcap"),
    ],
)
def test_refusals(hall: Path, options: tuple[str, ...], told: str) -> None:
    """Exit code 2, a sentence with the remedy, and no file."""
    done = twin("suggest", hall, *options)
    assert done.code == 2, done.out
    assert told in done.err
    assert files_below(hall.parent) == {"hall.toml"}


def test_places_count_by_a_plan(hall: Path) -> None:
    """With --plan only where robots stand must be covered: fewer access points will do."""
    assert twin("plan", hall, "-o", "plan.json", "--method", "cooperative").code == 0
    every = twin("suggest", hall, "--fresh", "--k", "2", "--grid", "2", "--json").json
    used = twin(
        "suggest", hall, "--fresh", "--k", "2", "--grid", "2", "--plan", "plan.json", "--json"
    ).json
    assert used["value"] <= every["value"]
    assert used["share_after"] == 1.0


def test_too_little_capacity_is_hinted_at(hall: Path) -> None:
    """Coverage is what is asked, but a fleet that cannot be served is not passed over."""
    told = "serve 1 robots at once, the fleet has 2"
    done = twin("suggest", hall, "--fresh", "--grid", "2", "--set", "radio.ap_capacity=1")
    added = done.out.count("[[ap]]")
    assert (told in done.out) == (added == 1)
    assert "serve" not in twin("suggest", hall).out


def test_the_ways_between_positions_can_count(hall: Path) -> None:
    """With --ways no edge of the new world hides a hole or is without coverage somewhere."""
    done = twin("suggest", hall, *WEAK, "--ways", "--grid", "1.5", "-o", "new.toml", "--json")
    assert done.code == 0, done.err
    positions = twin("radio", "new.toml", "--json").json["positions"]
    assert done.json["places"] > positions
    assert done.json["share_after"] == 1.0
    less = twin("suggest", hall, *WEAK, "--grid", "1.5", "--json").json
    assert less["places"] == positions
    assert less["value"] <= done.json["value"]
    assert twin("suggest", "new.toml", "--ways", "--remove", "--json").code == 0
    new, floor = open_world(Path("new.toml"))
    radio_map = build_radio_map(new, floor)
    assert len(kept_edges(floor, radio_map)) == len(floor.edge_uv)
