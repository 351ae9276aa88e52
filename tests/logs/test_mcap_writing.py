"""A log is written whole or not at all, and never over another."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import mcap.writer
import pytest

from logs import mcap_writer
from logs.errors import LogError
from logs.mcap_reader import read
from logs.mcap_writer import RunLog
from logs.records import (
    RobotState,
    Sample,
)
from tests.logs.mcap_files import write
from tests.logs.sample_run import sample_run


def left(folder: Path) -> set[str]:
    """Names of the files in a folder."""
    return {p.name for p in folder.iterdir()}


def test_the_log_and_its_layout_lie_side_by_side(tmp_path):
    """Nothing else is left, and the folder is made if need be."""
    write(tmp_path / "new" / "folder" / "run.mcap", sample_run(10))
    assert left(tmp_path / "new" / "folder") == {"run.mcap", "run.layout.json"}


@pytest.mark.parametrize("taken", ["run.mcap", "run.layout.json"])
def test_an_older_log_is_not_overwritten_unless_told(tmp_path, taken):
    """The refusal names the file and the remedy, and comes before anything is written."""
    (tmp_path / taken).write_text("older")
    with pytest.raises(LogError, match=rf"{taken}: exists already.*--overwrite"):
        write(tmp_path / "run.mcap", sample_run(10))
    assert left(tmp_path) == {taken}
    assert (tmp_path / taken).read_text() == "older"
    write(tmp_path / "run.mcap", sample_run(10), overwrite=True)
    assert read(tmp_path / "run.mcap").records


@pytest.mark.parametrize("after", [0, 1, 40])
def test_a_run_that_fails_midway_leaves_nothing(tmp_path, after):
    """The exception passes, no file is left, and an older log is untouched."""
    (tmp_path / "old.mcap").write_text("older")

    def failing():
        yield from sample_run(10).records[:after]
        raise RuntimeError("the twin broke")

    with pytest.raises(RuntimeError, match="the twin broke"):
        write(tmp_path / "new.mcap", sample_run(10), failing())
    with pytest.raises(RuntimeError, match="the twin broke"):
        write(tmp_path / "old.mcap", sample_run(10), failing(), overwrite=True)
    assert left(tmp_path) == {"old.mcap"}
    assert (tmp_path / "old.mcap").read_text() == "older"


def test_inputs_that_cannot_be_attached_leave_nothing(tmp_path, monkeypatch):
    """A failure before the first record is cleaned up as well."""

    def broken(*_):
        raise RuntimeError("no such thing")

    monkeypatch.setattr(mcap_writer, "_attachments", broken)
    with pytest.raises(RuntimeError, match="no such thing"):
        write(tmp_path / "run.mcap", sample_run(10))
    assert left(tmp_path) == set()


def test_a_full_disk_is_said_in_one_sentence(tmp_path, monkeypatch):
    """An error of the file system becomes a LogError with the path, and nothing is left."""

    def full(*_args, **_kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(mcap.writer.Writer, "add_message", full)
    with pytest.raises(LogError, match=r"run\.mcap: cannot be written: No space left on device"):
        write(tmp_path / "run.mcap", sample_run(10))
    assert left(tmp_path) == set()


def test_a_place_that_takes_no_file_is_refused(tmp_path):
    """A folder of that name, or a file where the folder should be."""
    (tmp_path / "run.mcap").mkdir()
    with pytest.raises(LogError, match="is a folder"):
        write(tmp_path / "run.mcap", sample_run(10))
    (tmp_path / "file").write_text("")
    with pytest.raises(LogError, match="cannot be written"):
        write(tmp_path / "file" / "run.mcap", sample_run(10))
    with pytest.raises(LogError, match="cannot be written"):
        write(tmp_path / ("x" * 300 + ".mcap"), sample_run(10))


def test_records_that_do_not_fit_are_refused(tmp_path):
    """RunStart first, RunEnd last, times that only grow, robots and columns of the problem."""
    records = list(sample_run(10).records)
    start, end = records[0], records[-1]
    state = next(r for r in records if isinstance(r, RobotState))
    sample = next(r for r in records if isinstance(r, Sample))
    replace = dataclasses.replace
    cases = [
        ([state], "first record of a log is RunStart"),
        ([start, start], "RunStart is the first"),
        ([start, end, end], "RunEnd its last"),
        ([start], "no RunEnd"),
        ([], "no RunEnd"),
        ([start, replace(state, t_s=4.0), replace(state, t_s=3.9)], "time only grows"),
        ([replace(start, robots=("r0",))], "not those of the problem"),
        ([start, replace(state, robot="r9")], "none of the problem's"),
        ([start, replace(sample, x_m=sample.x_m[1:])], "not equally long"),
        ([start, replace(sample, robot=(0, 3))], "robot's index"),
        ([start, replace(sample, robot=(0, -1))], "robot's index"),
        ([start, replace(sample, ap=(0, 2))], "AP's index"),
        ([start, replace(sample, ap=(0, -2))], "AP's index"),
        ([start, replace(state, slot=2**40)], "cannot be written"),
        ([start, replace(state, t_s=math.nan)], "its time is no number"),
        ([start, replace(state, t_s=math.inf)], "its time is no number"),
    ]
    for given, words in cases:
        with pytest.raises(LogError, match=words):
            write(tmp_path / "run.mcap", sample_run(10), given)
        assert left(tmp_path) == set()


def test_writing_needs_an_open_log(tmp_path):
    """Before and after `with`, write says so."""
    run = sample_run(10)
    log = RunLog(tmp_path / "run.mcap", **run.inputs)
    with pytest.raises(LogError, match="not open"):
        log.write(run.records[0])
    with log:
        for record in run.records:
            log.write(record)
    with pytest.raises(LogError, match="not open"):
        log.write(run.records[0])
    assert read(tmp_path / "run.mcap").records == run.records


def test_a_robot_called_as_a_fixed_frame_is_refused(tmp_path):
    """`world` and `hall` are frames of every log."""
    run = sample_run(10)
    problem = dataclasses.replace(run.problem, robot_ids=("world", "r1", "lift 2"))
    with pytest.raises(LogError, match="robot 'world'"):
        RunLog(tmp_path / "run.mcap", **(run.inputs | {"problem": problem}))
