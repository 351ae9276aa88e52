"""The radio benchmark runs, and what it compares is the same work."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from benchmarks.__main__ import app
from benchmarks.radio import RADIO_PHASES, hall, plain_loop, radio_map, radio_map_coverage


def test_the_smoke_run_writes_a_row_per_phase(tmp_path: Path) -> None:
    """Rows like those of the planner's benchmarks: `compare` reads them."""
    out = tmp_path / "radio.json"
    result = CliRunner().invoke(app, ["radio", "--smoke", "-o", str(out)])
    assert result.exit_code == 0, result.output
    rows = json.loads(out.read_text())["rows"]
    assert [row["phase"] for row in rows] == list(RADIO_PHASES)
    assert "times the CPU time of radio_map" in result.output
    assert CliRunner().invoke(app, ["compare", str(out), str(out)]).exit_code == 0


def test_both_sides_look_at_the_same_links() -> None:
    """As many links, the same sight, and rays are only saved where coverage is known without."""
    world, floor = hall(14, 10, 2, 2, 40, 3, "inf-dl")()
    ours, exact = radio_map(world, floor)
    fewer, quick = radio_map_coverage(world, floor)
    plain, _ = plain_loop(world, floor)
    assert ours["links"] == fewer["links"] == plain["links"] == plain["rays"]
    assert int(str(fewer["rays"])) < int(str(ours["rays"]))
    np.testing.assert_array_equal(exact.edge_covered, quick.edge_covered)
    at_vertices = exact.los.mean()
    assert 0.2 < at_vertices < 0.95
    assert abs(float(str(plain["line_of_sight_share"])) - at_vertices) < 0.1
