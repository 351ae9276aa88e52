"""The benchmarks keep running; what they time is not judged here."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks.__main__ import app


def _run(*arguments: str) -> str:
    result = CliRunner().invoke(app, list(arguments))
    assert result.exit_code == 0, result.output
    return result.output


def test_smoke_run_compares_with_itself(tmp_path: Path) -> None:
    """Every phase gives figures for a tiny case, the literal Algorithm 1 the same LP value."""
    out = tmp_path / "results.json"
    phases = ["path_generation", "yardstick", "cooperative", "pgcp", "auto", "decoupled"]
    chosen = [word for phase in phases for word in ("--phase", phase)]
    _run("run", "--smoke", "--family", "paper_hall", *chosen, "-o", str(out))
    rows = {row["phase"]: row for row in json.loads(out.read_text())["rows"]}
    assert set(rows) == set(phases)
    lp_value = rows["yardstick"]["lp_value"]
    assert rows["path_generation"]["lp_value"] == pytest.approx(lp_value, abs=1e-6)
    assert rows["auto"]["served_share"] == 1.0
    assert "× " in _run("compare", str(out), str(out))
    picture = tmp_path / "results.png"
    _run("plot", str(out), "-o", str(picture))
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_process_of_its_own(tmp_path: Path) -> None:
    """`--apart` gives the same figures, and a peak memory that is the case's own."""
    out = tmp_path / "results.json"
    chosen = ["--family", "warehouse", "--phase", "path_generation", "-o", str(out)]
    values = []
    for more in ([], ["--apart"]):
        _run("run", "--smoke", *chosen, *more)
        (row,) = json.loads(out.read_text())["rows"]
        assert row["peak_mb"] > 10
        values.append(row["lp_value"])
    assert values[0] == values[1]


def test_unknown_names_are_refused() -> None:
    """A family or phase that does not exist is answered with those that do."""
    result = CliRunner().invoke(app, ["run", "--family", "paper"])
    assert result.exit_code == 2
    assert "paper_hall" in result.output


def test_smoke_run_of_disturbed_runs(tmp_path: Path) -> None:
    """A tiny case of delays and of a storm: it is executed, and nobody collides."""
    out = tmp_path / "execution.json"
    _run("execution", "--smoke", "--what", "delays", "--what", "storm", "-o", str(out))
    rows = json.loads(out.read_text())["rows"]
    assert {row["what"] for row in rows} == {"delays", "storm"}
    assert all(row["collisions"] == 0 for row in rows)
