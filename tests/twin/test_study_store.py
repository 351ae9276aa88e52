"""Rows of a study survive everything; means and intervals are the textbook's."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from tests.cli_tools import DRAWN
from twin.errors import TwinError
from twin.study import plan_study
from twin.study_compare import compare, welch
from twin.study_grid import Grid
from twin.study_run import STATUSES
from twin.study_spec import Reference
from twin.study_store import RUNS, FolderStore, Header, Row, read_rows
from twin.study_summary import Results, jackknife, summary_csv, t_interval, wilson_interval

HEADER = Header(("plan.horizon",), ("success", "cost"))


def row(number: int, **changes: object) -> Row:
    """A row with the id `number`."""
    plain: dict[str, object] = {
        "run": f"{number:012x}",
        "scenario": "base",
        "levels": {"plan.horizon": "20"},
        "replication": number,
        "seed": 7 + number,
        "status": "ok",
        "seconds": 0.25,
        "values": {"success": 1, "cost": 10.5 + number},
    }
    return Row(**(plain | changes))


ROWS = [
    row(0),
    row(1, status="broken", error='a "quoted", word; ü', values={"success": None, "cost": None}),
    row(2),
]
IDS = [r.run for r in ROWS]


def written(folder: Path) -> bytes:
    """A folder with ROWS; its runs.csv."""
    with FolderStore(folder) as store:
        assert store.begin(HEADER, IDS, resume=False) == []
        for entry in ROWS:
            store.append(entry)
    return (folder / RUNS).read_bytes()


def test_rows_are_on_disk_as_soon_as_they_are_appended(tmp_path):
    """Nothing waits in a buffer for a second row or for the end."""
    with FolderStore(tmp_path) as store:
        store.begin(HEADER, IDS, resume=False)
        for k, entry in enumerate(ROWS):
            store.append(entry)
            assert (tmp_path / RUNS).read_bytes().count(b"\n") == 2 + k


def test_a_file_cut_off_anywhere_loses_no_whole_row(tmp_path):
    """Truncate runs.csv after every byte: all whole rows are read, the rest is written again."""
    whole = written(tmp_path / "whole")
    folder = tmp_path / "cut"
    for end in range(len(whole) + 1):
        folder.mkdir(exist_ok=True)
        (folder / RUNS).write_bytes(whole[:end])
        complete = max(0, whole[:end].count(b"\n") - 1)
        with FolderStore(folder) as store:
            there = store.begin(HEADER, IDS, resume=True)
            assert there == ROWS[:complete], end
            for entry in ROWS[complete:]:
                store.append(entry)
        assert (folder / RUNS).read_bytes() == whole


text = st.text(st.characters(exclude_categories=["Cs", "Cc", "Zl", "Zp"]), max_size=20)


@settings(max_examples=60, deadline=None)
@given(
    error=text.map(lambda t: " ".join(t.split())),
    scenario=text,
    status=st.sampled_from(sorted(STATUSES)),
    values=st.tuples(
        st.none() | st.integers(-(10**12), 10**12),
        st.none() | st.floats(allow_nan=False, allow_infinity=False),
    ),
)
def test_a_row_is_read_as_it_was_written(tmp_path_factory, error, scenario, status, values):
    """Any text, any number: runs.csv gives back exactly what was put in."""
    folder = tmp_path_factory.mktemp("rows")
    figures = dict(zip(HEADER.kpis, values, strict=True))
    entry = row(5, error=error, scenario=scenario, status=status, values=figures)
    with FolderStore(folder) as store:
        store.begin(HEADER, [entry.run], resume=False)
        store.append(entry)
    header, (found,) = read_rows(folder / RUNS)
    assert header == HEADER
    assert found == entry


def test_results_of_something_else_are_not_gone_on_with(tmp_path):
    """Other columns, other runs, a foreign file: refused with a sentence, and left as they are."""
    before = written(tmp_path)
    for header, ids, said in (
        (Header(("plan.horizon",), ("success",)), IDS, "has other columns than this study .cost"),
        (HEADER, IDS[:1], "2 of its 3 runs are none of this study as it is now"),
    ):
        with FolderStore(tmp_path) as store, pytest.raises(TwinError, match=said):
            store.begin(header, ids, resume=True)
    with FolderStore(tmp_path) as store, pytest.raises(TwinError, match=r"--resume.*--overwrite"):
        store.begin(HEADER, IDS, resume=False)
    assert (tmp_path / RUNS).read_bytes() == before
    damaged = before.replace(b"ok", b"good")
    (tmp_path / RUNS).write_bytes(damaged)
    with FolderStore(tmp_path) as store, pytest.raises(TwinError, match=r"runs.csv:2: .*damaged"):
        store.begin(HEADER, IDS, resume=True)
    assert (tmp_path / RUNS).read_bytes() == damaged
    (tmp_path / RUNS).write_text("my,own,file\n")
    with FolderStore(tmp_path) as store, pytest.raises(TwinError, match=r"is no runs.csv"):
        store.begin(HEADER, IDS, resume=True)


def test_two_studies_do_not_write_to_one_folder(tmp_path):
    """The second is refused while the first writes, and let in when it has ended."""
    with FolderStore(tmp_path) as store:
        store.begin(HEADER, IDS, resume=False)
        with FolderStore(tmp_path) as other, pytest.raises(TwinError, match="another study is wri"):
            other.begin(HEADER, IDS, resume=True)
    with FolderStore(tmp_path) as other:
        assert other.begin(HEADER, IDS, resume=True) == []


# --- statistics -----------------------------------------------------------------------------------

values_in = st.floats(-1e6, 1e6).map(lambda v: round(v, 3))
numbers = st.lists(values_in, min_size=2, max_size=30)


@given(numbers)
def test_t_interval_is_scipys(values):
    """The same as scipy.stats, which computes it another way."""
    found = t_interval(values)
    error = stats.sem(values)
    low, high = stats.t.interval(0.95, len(values) - 1, np.mean(values), error)
    if error > 0:
        assert (found.low, found.high) == pytest.approx((low, high), rel=1e-6, abs=1e-6)
    assert found.mean == pytest.approx(np.mean(values), abs=1e-6)


@pytest.mark.parametrize(("ones", "n"), [(0, 5), (5, 5), (3, 10), (49, 50)])
def test_wilson_interval_is_scipys(ones, n):
    """The same as scipy.stats; it has a length even when all runs agree."""
    found = wilson_interval([1.0] * ones + [0.0] * (n - ones))
    other = stats.binomtest(ones, n).proportion_ci(0.95, "wilson")
    assert (found.low, found.high) == pytest.approx((other.low, other.high), abs=1e-9)
    assert found.half_width > 0


@given(numbers, numbers)
def test_welch_interval_is_scipys(a, b):
    """The same as scipy.stats' unequal variances test."""
    if len(set(a)) == 1 and len(set(b)) == 1:
        return
    found = welch(a, b)
    other = stats.ttest_ind(b, a, equal_var=False).confidence_interval(0.95)
    if math.isfinite(other.low):
        assert (found.low, found.high) == pytest.approx((other.low, other.high), rel=1e-4, abs=1e-4)


def test_few_values_have_no_interval():
    """One value has a mean and no interval, none has neither."""
    assert math.isnan(t_interval([]).mean)
    assert t_interval([3.0]).mean == 3.0
    assert math.isnan(t_interval([3.0]).low)


def test_jackknife_of_a_ratio():
    """Ratio of sums less 1; a constant ratio has no spread."""
    found = jackknife([(1.0, 2.0), (2.0, 4.0), (3.0, 6.0)])
    assert (found.mean, found.low, found.high) == pytest.approx((-0.5, -0.5, -0.5))
    assert jackknife([(1.0, 2.0), (4.0, 4.0)]).mean == pytest.approx(5 / 6 - 1)
    assert jackknife([(1.0, 0.0)]).n == 0


STUDY = """\
format = "mapp-study/1"
[study]
world = "drawn.toml"
run = "plan"
replications = 3
baseline = { method = "a" }
[factors]
"plan.horizon" = [20, 30]
[factors.method]
a = { "planner.restarts" = 1 }
b = { "planner.restarts" = 2 }
c = { "planner.restarts" = 3 }
[kpi]
columns = ["success", "cost"]
common = { method = ["a", "b"] }
[kpi.relative.share]
kpi = "cost"
of = { method = "a" }
"""
COSTS = {  # (horizon, method): the cost in each replication, None for a run without success
    ("20", "a"): [10.0, 20.0, None],
    ("20", "b"): [12.0, 26.0, 40.0],
    ("20", "c"): [11.0, 21.0, 31.0],
    ("30", "a"): [1.0, 2.0, 3.0],
    ("30", "b"): [2.0, 2.0, 2.0],
    ("30", "c"): [3.0, None, 3.0],
}


@pytest.fixture
def results(tmp_path) -> Results:
    """The costs above as the rows of a study."""
    (tmp_path / "drawn.toml").write_text(DRAWN)
    (tmp_path / "study.toml").write_text(STUDY)
    grid = plan_study(tmp_path / "study.toml")
    return Results(grid, rows_of(grid, COSTS))


def rows_of(grid: Grid, costs: dict[tuple[str, str], list[float | None]]) -> list[Row]:
    """Rows with these costs."""
    rows = []
    for run in grid.runs:
        cell = grid.cells[run.cell]
        cost = costs[cell.levels["plan.horizon"], cell.levels["method"]][run.replication]
        rows.append(
            Row(
                run.id,
                cell.scenario,
                cell.levels,
                run.replication,
                run.seed,
                "ok" if cost is not None else "unserved",
                values={"success": int(cost is not None), "cost": cost},
            )
        )
    return rows


def index(results: Results, horizon: str, method: str) -> int:
    """Of a cell."""
    wanted = {"plan.horizon": horizon, "method": method}
    return next(i for i, cell in enumerate(results.grid.cells) if cell.levels == wanted)


def test_only_common_cases_are_in_means(results):
    """Costs are over replications that a and b both solved, as the paper counts; success is not."""
    assert results.values(index(results, "20", "b"), "cost") == [12.0, 26.0]
    assert results.values(index(results, "20", "c"), "cost") == [11.0, 21.0]
    assert results.values(index(results, "20", "a"), "success") == [1.0, 1.0, 0.0]
    assert results.values(index(results, "30", "c"), "cost") == [3.0, 3.0]


def test_differences_are_paired(results):
    """B less a in the same replication: 2 and 6; not a difference of means over other cases."""
    cell = results.grid.cells[index(results, "20", "b")]
    found = results.difference(index(results, "20", "b"), cell.baseline, "cost")
    assert (found.n, found.mean) == (2, 4.0)
    assert found.half_width == pytest.approx(
        stats.t.ppf(0.975, 1) * np.std([2, 6], ddof=1) / 2**0.5
    )
    c = results.difference(index(results, "30", "c"), index(results, "30", "a"), "cost")
    assert (c.n, c.mean) == (2, 1.0)


def test_relative_figures_divide_by_the_run_of_the_same_replication(results):
    """Share = cost over a's cost in the same hall."""
    assert results.values(index(results, "20", "b"), "share") == [1.2, 1.3]
    assert results.values(index(results, "30", "a"), "share") == [1.0, 1.0, 1.0]


def test_references_pool_cells_and_compare_means(results):
    """A reference over several cells is their mean; with `against` the change of the means."""
    every = results.reference(Reference(text="t", kpi="cost", where={"method": "b"}))
    assert (every.n, every.mean) == (5, (12 + 26 + 2 + 2 + 2) / 5)
    against = Reference(text="t", kpi="cost", where={"method": "b"}, against={"method": "a"})
    change = results.reference(against)
    assert change.mean == pytest.approx((12 + 2 + 26 + 2 + 2) / (10 + 1 + 20 + 2 + 3) - 1)
    assert change.n == 3  # replications are what is independent


def test_summary_has_a_line_per_cell_and_figure(results):
    """summary.csv: n, mean, interval, and the baseline's paired difference."""
    lines = summary_csv(results).decode().splitlines()
    assert len(lines) == 1 + 6 * 3
    head = lines[0].split(",")
    (line,) = [x for x in lines if x.startswith("base,20,b,cost")]
    named = dict(zip(head, line.split(","), strict=True))
    assert (named["runs"], named["n"], named["mean"]) == ("3", "2", "19")
    assert (named["baseline"], named["pairs"], named["difference"]) == ("method = a", "2", "4")


def test_compare_pairs_by_seed_and_names_what_turned(results, tmp_path):
    """Two studies: paired differences, runs that succeeded in one only, variants of one only."""
    grid = results.grid
    other = dict(COSTS)
    other["20", "b"] = [13.0, 28.0, None]
    for name, costs in (("one", COSTS), ("two", other)):
        rows = rows_of(grid, costs)
        rows = rows if name == "one" else [r for r in rows if r.levels["method"] != "c"]
        with FolderStore(tmp_path / name) as store:
            store.begin(Header(grid.factors, ("success", "cost")), [], resume=False)
            store.finish(rows)
    found = compare(tmp_path / "one", tmp_path / "two")
    (change,) = [c for c in found.changes if c.cell == ("base", "20", "b") and c.kpi == "cost"]
    assert (change.pairs, change.difference.mean) == (2, 1.5)
    assert [(a.seed, a.status, b.status) for a, b in found.turned] == [(2, "ok", "unserved")]
    assert found.only_a == (("base", "20", "c"), ("base", "30", "c"))
    assert found.only_b == ()
