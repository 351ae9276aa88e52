"""Records as columns: the same numbers, by name, read-only."""

from __future__ import annotations

import builtins
import sys
from dataclasses import fields

import numpy as np
import pytest

import logs
from logs.errors import LogError
from logs.records import LINKS, RECORD_TYPES, ApLoad, Handover, RobotState, RunStart, Sample
from tests.logs.mcap_files import write
from tests.logs.sample_run import sample_run


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The sample run's log, opened."""
    return logs.read(write(tmp_path_factory.mktemp("t") / "run.mcap", sample_run(10)))


@pytest.mark.parametrize("record_type", [t for t in RECORD_TYPES if t is not Sample])
def test_columns_hold_the_records_values(run, record_type):
    """One row per record, one column per field, in their order, with the fields' types."""
    table = run.table(record_type)
    expected = run.of(record_type)
    assert list(table) == [field.name for field in fields(record_type)]
    assert table.rows == len(expected)
    for name, column in table.items():
        assert column.tolist() == [getattr(record, name) for record in expected]
        assert not column.flags.writeable


def test_samples_have_one_row_per_body(run):
    """Columns of samples are laid end to end; numbers that stand for names say for which."""
    table = run.table(Sample)
    samples = run.of(Sample)
    for name in ("robot", "x_m", "ap", "link", "rate_mbps"):
        assert table[name].tolist() == [v for s in samples for v in getattr(s, name)]
    assert table["t_s"].tolist() == [s.t_s for s in samples for _ in s.robot]
    start = run.of(RunStart)[0]
    assert dict(table.categories) == {"robot": start.robots, "ap": start.aps, "link": LINKS}


def test_a_question_in_one_line(run):
    """Peak load of an AP: a comparison of a column of names selects rows."""
    loads = run.table(ApLoad)
    peak = loads["load"][loads["ap"] == "ap1"].max()
    assert peak == max(r.load for r in run.of(ApLoad) if r.ap == "ap1")


def test_tables_become_structured_arrays(run):
    """Fields of the array are the columns."""
    table = run.table(RobotState)
    array = table.to_numpy()
    assert array.dtype.names == tuple(table)
    assert array.dtype["t_s"] == np.float64
    np.testing.assert_array_equal(array["snr_db"], table["snr_db"])


def test_an_unknown_column_names_the_known_ones(run):
    """A misspelt field is told with those there are."""
    with pytest.raises(KeyError, match="no field 'to'; it has t_s, slot, robot, from_ap"):
        run.table(Handover)["to"]


def test_pandas_is_optional(run, monkeypatch):
    """Without it a sentence says what to install; with it names come as categories."""
    real = builtins.__import__

    def without(name, *args, **kwargs):
        if name == "pandas":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    with monkeypatch.context() as patch:
        patch.delitem(sys.modules, "pandas", raising=False)
        patch.setattr(builtins, "__import__", without)
        with pytest.raises(LogError, match="pip install pandas"):
            run.table(Sample).to_pandas()
    pytest.importorskip("pandas", reason="pandas is not installed")
    frame = run.table(Sample).to_pandas()
    assert set(frame["link"].cat.categories) == set(LINKS)


def test_reading_a_log_by_name(tmp_path):
    """`logs.read` takes a path or its text, and refuses what is no log."""
    with pytest.raises(LogError, match="is not there"):
        logs.read(str(tmp_path / "none.mcap"))
