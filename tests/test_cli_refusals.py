"""The `twin` command when it cannot do what it was asked: sentences, exit codes, no harm done."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from logs.mcap_reader import read
from tests.cli_tools import HALL, files_below, good_run, hall, twin
from twin import cli_console, instance

__all__ = ["good_run", "hall"]  # fixtures

ROOT = Path(__file__).resolve().parents[1]
TIMEOUT_S = 300

# --- bad input ----------------------------------------------------------------------------------

FIVE_MISTAKES = (
    HALL.replace("pitch_m = 2.0", "pitch_m = -2.0")
    .replace("height_m = 3.0", 'height_m = "three"')
    .replace("tx_power_dbm", "tx_pwr_dbm")
    .replace("start = { cell = [0, 0] }", 'start = "dock"')
    .replace("horizon = 20", "horizon = 0")
)


def line_of(text: str, part: str) -> int:
    """Number of the first line that holds `part`."""
    return next(i for i, line in enumerate(text.splitlines(), 1) if part in line)


def test_all_mistakes_of_a_file_are_told_at_once(hall):
    """A TOML file with five different mistakes: five lines, each with the line it speaks of."""
    hall.write_text(FIVE_MISTAKES)
    done = twin("run", hall)
    assert done.code == 2
    told = done.err.strip().splitlines()
    assert len(told) == 5
    parts = ("pitch_m", '"three"', "tx_pwr", '"dock"', "horizon")
    for line, part in zip(told, parts, strict=True):
        assert f"hall.toml:{line_of(FIVE_MISTAKES, part)}: " in line
    assert files_below(hall.parent) == {"hall.toml"}


RACK = "center_m = [5.0, 5.0]\nsize_m = [1.0, 4.0]"
BAD_WORLDS = {
    "no free position": (RACK, "center_m = [6.0, 4.0]\nsize_m = [11.9, 7.9]", "position"),
    "AP inside a rack": ("position_m = [1.0, 4.0, 3.5]", "position_m = [5.0, 5.0, 2.0]", "rack"),
    "robot on a blocked cell": ("start = { cell = [0, 0] }", "start = { cell = [2, 2] }", "rack"),
    "no coverage": ("tx_power_dbm = 6.0", "tx_power_dbm = -200.0", "threshold"),
    "robot without coverage": ("tx_power_dbm = 6.0", "tx_power_dbm = -6.0", "coverage"),
    "no robot": (HALL[HALL.index("[[robot]]") : HALL.index("[plan]")], "", "robot"),
    "broken TOML": ("[hall]", "[hall", ":4"),
}


@pytest.mark.parametrize("case", BAD_WORLDS)
def test_bad_world_is_refused_in_words(hall, case):
    """What cannot be run is refused: exit 2, a sentence with the file's name, nothing written."""
    old, new, word = BAD_WORLDS[case]
    assert old in HALL
    hall.write_text(HALL.replace(old, new))
    done = twin("run", hall)
    assert done.code == 2, done.out
    assert "hall.toml" in done.err
    assert word in done.err
    assert "Traceback" not in done.err
    assert done.out == ""
    assert files_below(hall.parent) == {"hall.toml"}


def test_no_coverage_is_told_once_and_not_robot_by_robot(hall):
    """One cause, one message."""
    done = twin("run", hall, "--set", "radio.tx_power_dbm=-200")
    assert done.code == 2
    assert len(done.err.strip().splitlines()) == 1


@pytest.mark.parametrize("command", ["run", "plan", "radio", "validate", "info"])
def test_missing_file_is_refused(hall, command):
    """A file that is not there: exit 2 and its name, for each command."""
    name = "nowhere.mcap" if command in {"validate", "info"} else "nowhere.toml"
    done = twin(command, name)
    assert done.code == 2
    assert name in done.err
    assert len(done.err.strip().splitlines()) == 1


@pytest.mark.parametrize("command", ["validate", "info"])
@pytest.mark.parametrize("defect", ["truncated", "text", "empty", "folder"])
def test_unreadable_log_is_refused(hall, good_run, command, defect):
    """A truncated log, a text called .mcap, an empty file, a folder: exit 2 and one sentence."""
    log = Path("bad.mcap")
    match defect:
        case "truncated":
            whole = (good_run[0] / "run.mcap").read_bytes()
            log.write_bytes(whole[: len(whole) * 2 // 3])
        case "text":
            log.write_text("dear log,\n")
        case "empty":
            log.touch()
        case _:
            log.mkdir()
    done = twin(command, log)
    assert done.code == 2, done.out
    assert "bad.mcap" in done.err
    assert "Traceback" not in done.err


BAD_OPTIONS = {
    "-o is a file": ["run", "hall.toml", "-o", "hall.toml"],
    "-o below a file": ["run", "hall.toml", "-o", "hall.toml/out"],
    "-o of run is no folder's name": ["run", "hall.toml", "-o", "run.mcap"],
    "-o in a place that takes no files": ["run", "hall.toml", "-o", "/proc/nowhere"],
    "-o of plan is no .json": ["plan", "hall.toml", "-o", "plan.txt"],
    "-o of radio is no picture": ["radio", "hall.toml", "-o", "radio.json"],
    "-o of plan is a folder": ["plan", "hall.toml", "-o", "folder.json"],
    "world is no .toml": ["run", "folder.json"],
    "--set without a value": ["run", "hall.toml", "--set", "plan.horizon"],
    "--set of an unknown key": ["run", "hall.toml", "--set", "plan.horison=9"],
    "--set of a bad value": ["run", "hall.toml", "--set", "plan.horizon=many"],
    "--set twice": ["run", "hall.toml", "--set", "plan.seed=1", "--set", "plan.seed=2"],
    "unknown AP": ["run", "hall.toml", "--set", "ap.top.enabled=false"],
    "unknown objective": ["plan", "hall.toml", "--objective", "fast"],
    "unknown method": ["plan", "hall.toml", "--method", "magic"],
    "unknown option": ["run", "hall.toml", "--quick"],
    "negative seed": ["run", "hall.toml", "--seed", "-1"],
    "report of validate is no .xml": ["validate", "hall.toml", "--junit", "out.txt"],
}


@pytest.mark.parametrize("case", BAD_OPTIONS)
def test_bad_option_is_refused(hall, case):
    """Options that make no sense: exit 2, a message on stderr, nothing written."""
    Path("folder.json").mkdir()
    done = twin(*BAD_OPTIONS[case])
    assert done.code == 2, done.out
    assert done.err.strip()
    assert "Traceback" not in done.err
    assert files_below(hall.parent) == {"hall.toml", "folder.json"}


def test_problem_file_with_mistakes_is_refused(hall):
    """A problem.json of another format: exit 2, every fault in a line."""
    Path("p.json").write_text('{"format": "mapp-problem/9", "horizon": 0}')
    done = twin("plan", "p.json")
    assert done.code == 2
    assert "mapp-problem/1" in done.err
    assert "horizon" in done.err


def test_set_does_not_go_with_a_problem_file(hall):
    """Values of a world cannot be set in a problem."""
    Path("p.json").write_text("{}")
    done = twin("plan", "p.json", "--set", "plan.horizon=9")
    assert done.code == 2
    assert "--set" in done.err


def test_existing_run_is_refused_before_any_work(hall, monkeypatch):
    """A folder with a run is refused at once, not after the planning; its files stay."""
    out = Path("out")
    out.mkdir()
    (out / "run.mcap").write_text("precious")

    def never(*_args, **_options):
        raise AssertionError("work was begun")

    monkeypatch.setattr(instance, "open_instance", never)
    done = twin("run", hall, "-o", out)
    assert done.code == 2
    assert "--overwrite" in done.err
    assert (out / "run.mcap").read_text() == "precious"


@pytest.mark.parametrize(("command", "name"), [("plan", "there.json"), ("radio", "there.png")])
def test_existing_file_is_refused(hall, command, name):
    """Files are replaced only when that was asked for."""
    Path(name).write_text("precious")
    done = twin(command, hall, "-o", name)
    assert done.code == 2
    assert "--overwrite" in done.err
    assert Path(name).read_text() == "precious"
    assert twin(command, hall, "-o", name, "--overwrite").code == 0
    assert Path(name).read_bytes() != b"precious"


def test_overwrite_replaces_a_run_and_nothing_else(hall):
    """`--overwrite` replaces the run's own files; a stranger in the folder stays."""
    out = Path("out")
    out.mkdir()
    (out / "run.mcap").write_text("old")
    (out / "notes.txt").write_text("mine")
    assert twin("run", hall, "-o", out, "--overwrite").code == 0
    assert (out / "notes.txt").read_text() == "mine"
    assert read(out / "run.mcap").world.name == "test hall"


# --- when things go wrong -----------------------------------------------------------------------


def test_failure_on_the_way_leaves_no_trace(hall, monkeypatch):
    """A defect after the log was written: exit 70, two sentences, no file, an old run intact."""
    out = Path("out")
    out.mkdir()
    (out / "run.mcap").write_text("old")

    def broken(*_args):
        raise RuntimeError("no ink")

    monkeypatch.setattr("logs.figures.draw_run", broken)
    done = twin("run", hall, "-o", out, "--overwrite")
    assert done.code == cli_console.DEFECT
    assert "RuntimeError" in done.err
    assert "no ink" in done.err
    assert "--debug" in done.err
    assert "Traceback" not in done.err
    assert files_below(hall.parent) == {"hall.toml", "out", "out/run.mcap"}
    assert (out / "run.mcap").read_text() == "old"


@pytest.mark.parametrize("how", ["option", "environment"])
def test_debug_shows_the_traceback(hall, monkeypatch, how):
    """--debug or MAPP_DEBUG=1 shows where a defect is."""

    def broken(*_args, **_options):
        raise RuntimeError("no ink")

    monkeypatch.setattr("logs.figures.draw_run", broken)
    if how == "environment":
        monkeypatch.setenv("MAPP_DEBUG", "1")
    done = twin("run", hall, *(["--debug"] if how == "option" else []))
    assert "Traceback" in done.err
    assert done.code == cli_console.DEFECT


INTERRUPTED = """
import os, signal, sys, time
import logs.figures
from twin.cli import main

def interrupted(*_):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(30)

logs.figures.draw_run = interrupted
sys.argv = ["twin", "run", "hall.toml", "-o", "deep/out"]
main()
"""


def python(code: str, folder: Path, **options) -> subprocess.CompletedProcess[str]:
    """Run code in a fresh interpreter in `folder`."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env=environment,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
        **options,
    )


def test_ctrl_c_leaves_no_partial_files(hall):
    """SIGINT with the log half-way out: exit 130, a sentence, not even an empty folder."""
    done = python(INTERRUPTED, hall.parent, capture_output=True)
    assert done.returncode == 128 + signal.SIGINT
    assert "interrupted" in done.stderr
    assert "Traceback" not in done.stderr
    assert files_below(hall.parent) == {"hall.toml"}


SLOW = """
import sys, time
import planner.warm_up, twin.cli_console
twin.cli_console.SECONDS_OF_SILENCE = 0.0
planner.warm_up.kernels_are_compiled = lambda: False
from twin.cli import main
sys.argv = ["twin", "plan", "hall.toml"]
main()
"""


def test_progress_is_shown_on_a_terminal_only(hall):
    """On a terminal stderr tells what is going on; piped, it stays empty (see the other tests)."""
    ours, theirs = pty.openpty()
    try:
        done = python(SLOW, hall.parent, stdout=subprocess.PIPE, stderr=theirs)
    finally:
        os.close(theirs)
    seen = b""
    try:
        while piece := os.read(ours, 65536):
            seen += piece
    except OSError:  # the other side is closed
        pass
    os.close(ours)
    assert done.returncode == 0
    assert b"compiling the search kernels" in seen
    assert "plan cost" in done.stdout


def test_closed_pipe_is_no_error(good_run):
    """`twin info … | head -1` ends quietly."""
    command = f"{sys.executable} -m twin.cli info {good_run[0] / 'run.mcap'} | head -1"
    done = subprocess.run(
        command, shell=True, cwd=ROOT, capture_output=True, text=True, timeout=TIMEOUT_S, check=True
    )
    assert done.stderr == ""
