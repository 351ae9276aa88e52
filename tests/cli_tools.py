"""Small worlds and a way to run the `twin` command, for the tests of the command."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from twin.cli import app

HALL = """\
format = "mapp-world/1"
name = "test hall"

[hall]
size_m = [12.0, 8.0]
pitch_m = 2.0
speed_m_s = 1.0

[[obstacle]]
name = "rack"
center_m = [5.0, 5.0]
size_m = [1.0, 4.0]
height_m = 3.0

[[ap]]
id = "left"
position_m = [1.0, 4.0, 3.5]

[[ap]]
id = "right"
position_m = [11.0, 7.0, 3.5]

[radio]
tx_power_dbm = 6.0

[[robot]]
id = "r0"
start = { cell = [0, 0] }
goal = { cell = [5, 3] }

[[robot]]
id = "r1"
start = { cell = [5, 1] }
goal = { cell = [0, 2] }

[plan]
horizon = 20
"""
DRAWN = HALL[: HALL.index("[[robot]]")] + "[robots.random]\ncount = 4\n\n[plan]\nhorizon = 25\n"
# One aisle, one position wide: two robots that must pass each other cannot.
AISLE = """\
format = "mapp-world/1"
name = "aisle"
[hall]
size_m = [10.0, 2.0]
pitch_m = 2.0
speed_m_s = 1.0
[[ap]]
id = "ap0"
position_m = [5.0, 1.0, 3.0]
[[robot]]
id = "east"
start = { cell = [0, 0] }
goal = { cell = [4, 0] }
[[robot]]
id = "west"
start = { cell = [4, 0] }
goal = { cell = [0, 0] }
[plan]
horizon = 20
at_goal = "park"
"""


class Outcome:
    """Exit code, stdout and stderr of a command."""

    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err

    @property
    def json(self) -> Any:
        """What was printed, as data."""
        return json.loads(self.out)


def twin(*args: object) -> Outcome:
    """Run the command in this process, as if piped."""
    result = CliRunner().invoke(app, [str(arg) for arg in args])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return Outcome(result.exit_code, result.stdout, result.stderr)


def files_below(folder: Path) -> set[str]:
    """Names of all files and folders in a folder, relative to it."""
    return {str(p.relative_to(folder)) for p in folder.rglob("*")}


@pytest.fixture
def hall(tmp_path, monkeypatch) -> Path:
    """A world in an empty folder that is also the current one."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "hall.toml"
    path.write_text(HALL)
    return path


@pytest.fixture(scope="session")
def good_run(tmp_path_factory) -> tuple[Path, Outcome]:
    """The folder of one good run, and what the command said."""
    folder = tmp_path_factory.mktemp("good")
    (folder / "hall.toml").write_text(HALL)
    outcome = twin("run", folder / "hall.toml", "-o", folder / "out", "--json")
    assert outcome.code == 0, outcome.err
    return folder / "out", outcome
