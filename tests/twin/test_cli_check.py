"""`twin check` and `twin schema` as a user meets them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli_tools import HALL, files_below, hall, twin

__all__ = ["hall"]  # a fixture

BLOCKED = HALL.replace("goal = { cell = [5, 3] }", "goal = { cell = [2, 2] }")


def test_a_world_that_can_be_run_passes(hall: Path) -> None:
    """Exit code 0 with warnings, and a sentence at the end; no file is written."""
    done = twin("check", hall)
    assert done.code == 0
    assert "test hall: 0 errors" in done.out
    assert files_below(hall.parent) == {"hall.toml"}


def test_an_error_makes_the_answer_no(hall: Path) -> None:
    """Exit code 1; code, file, line, key, value and remedy in one line."""
    hall.write_text(BLOCKED)
    done = twin("check", hall)
    assert done.code == 1
    line = BLOCKED.splitlines().index("goal = { cell = [2, 2] }") + 1
    assert f"E106 {hall}:{line}: robot[0].goal: cell [2, 2] is blocked" in done.out
    assert done.err == ""


def test_a_file_that_is_no_world_is_bad_input(hall: Path) -> None:
    """Mistakes in the file itself: exit code 2, on stderr, as for every command."""
    hall.write_text(HALL.replace("pitch_m = 2.0", "pich_m = 2.0"))
    done = twin("check", hall)
    assert done.code == 2
    assert "did you mean 'pitch_m'" in done.err


def test_strict_and_ignore(hall: Path) -> None:
    """`--strict` makes warnings count; what is ignored does not count, and is told."""
    codes = [f["code"] for f in twin("check", hall, "--json").json["findings"]]
    assert codes
    assert twin("check", hall, "--strict").code == 1
    done = twin("check", hall, "--strict", "--ignore", ",".join(set(codes)))
    assert done.code == 0
    assert f"{len(codes)} ignored" in done.out


@pytest.mark.parametrize(
    ("codes", "words"), [("W999", "no code"), ("E106", "cannot be ignored"), ("W2O9", "'W209'")]
)
def test_what_cannot_be_ignored(hall: Path, codes: str, words: str) -> None:
    """Errors, and codes that there are none of."""
    done = twin("check", hall, "--ignore", codes)
    assert done.code == 2
    assert words in done.err


def test_json_has_place_and_line(hall: Path) -> None:
    """For programs: code, severity, key, file and line, metres."""
    hall.write_text(BLOCKED)
    values = twin("check", hall, "--json").json
    assert values["passed"] is False
    assert values["errors"] == 1
    finding = values["findings"][0]
    assert finding["code"] == "E106"
    assert finding["severity"] == "error"
    assert finding["key"] == ["robot", 0, "goal"]
    assert finding["place"].startswith(f"{hall}:")
    assert finding["places_m"] == [[5.0, 5.0]]


def test_the_picture(hall: Path) -> None:
    """-o draws; another ending or a file that exists is refused before any work."""
    assert twin("check", hall, "-o", "out/check.png").code == 0
    assert Path("out/check.png").read_bytes().startswith(b"\x89PNG")
    assert twin("check", hall, "-o", "out/check.png").code == 2
    assert twin("check", hall, "-o", "check.txt").code == 2


def test_explain() -> None:
    """A code is explained without a world, in any case; as JSON, too; unknown ones are refused."""
    done = twin("check", "--explain", "w103")
    assert done.code == 0
    assert "W103 floor cut off by one blocked cell" in done.out
    assert twin("check", "--explain", "W103", "--json").json["code"] == "W103"
    assert twin("check", "--explain", "W1").code == 2
    assert "WORLD.toml" in twin("check").err


def test_set_and_seed(hall: Path) -> None:
    """Values set for one check count, and their findings say that they are overrides."""
    done = twin("check", hall, "--set", "plan.horizon=3")
    assert done.code == 1
    assert "E111 hall.toml (override): plan.horizon" in done.out.replace(f"{hall.parent}/", "")
    assert twin("check", hall, "--seed", "3").code == 0


def test_schema(hall: Path) -> None:
    """To stdout or a file; a page when the name ends in .md."""
    assert twin("schema").json["$schema"].endswith("draft-07/schema#")
    assert twin("schema", "-o", "world.schema.json").code == 0
    assert json.loads(Path("world.schema.json").read_text())["title"] == "mapp-twin world"
    assert twin("schema", "-o", "world.schema.json").code == 2
    assert twin("schema", "-o", "format.md").code == 0
    assert Path("format.md").read_text().startswith("# The world file")
    assert twin("schema", "-o", "check-codes.md").code == 0
    assert Path("check-codes.md").read_text().startswith("# Findings")
