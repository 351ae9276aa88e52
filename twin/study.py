"""What-if studies: one world, many variants, the same draws for each, all results kept.

    with FolderStore(Path("runs/fleet")) as store:
        results = run_study(plan_study(Path("studies/fleet_size.toml")), store)

Read in this order: `study_spec` (the file), `study_grid` (cells and runs), `study_run` (one run),
`study_worker` and `study_engine` (many), `study_store` (rows), `study_summary` and `study_report`
(what they say). A failed run is a result, not an exception; the store gets every row as soon as its
run ends, so a study can be killed at any moment and resumed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from twin.study_engine import Engine, LocalEngine, outcomes_of
from twin.study_grid import Grid, Run, expand
from twin.study_kpi import Value
from twin.study_lock import lock_text, version
from twin.study_run import OK, Outcome, Task
from twin.study_spec import read_study
from twin.study_store import LOCK, SUMMARY, Header, Row, Store
from twin.study_summary import Results, summary_csv

RUN_FUNCTION = Task.function


@dataclass(frozen=True)
class Tally:
    """How far a study is.

    Attributes:
        done: runs that have ended, those of an earlier start among them.
        failed: how many of these did not succeed.
        total: runs in all.
        resumed: runs that were there when it began.
    """

    done: int
    failed: int
    total: int
    resumed: int

    @property
    def left(self) -> int:
        """Runs still to be done."""
        return self.total - self.done


def plan_study(path: Path, *, quick: bool = False, replications: int | None = None) -> Grid:
    """All cells and runs of a study file, without running any.

    Args:
        path: of the study file.
        quick: the short form.
        replications: instead of the file's; more of them leave the runs there are as they are.

    Raises:
        WorldError: with all problems of the file, each with its line.
    """
    study, source = read_study(path, quick=quick, replications=replications)
    return expand(study, source, version())


def run_study(
    grid: Grid,
    store: Store,
    engine: Engine | None = None,
    *,
    name: str = "study",
    resume: bool = False,
    on_progress: Callable[[Tally], None] = lambda _tally: None,
    on_step: Callable[[str], None] = lambda _text: None,
    function: str = RUN_FUNCTION,
) -> Results:
    """Do all runs of a study that are not done yet, and say what they show.

    Args:
        grid: from `plan_study`.
        store: gets rows as they come, and files.
        engine: what does the runs; the cores of this machine if None.
        name: title of the report where the study has none.
        resume: whether the store may hold rows of this study already.
        on_progress: told after every run.
        on_step: told what is done after the last one.
        function: `module:name` of what does a run.

    Raises:
        TwinError: the store cannot be used, or the engine is gone.
    """
    header = Header(grid.factors, grid.study.columns)
    rows = {
        row.run: row for row in store.begin(header, (run.id for run in grid.runs), resume=resume)
    }
    store.put(LOCK, lock_text(grid))
    resumed = len(rows)
    failed = sum(row.status != OK for row in rows.values())

    def keep(run: Run, outcome: Outcome) -> None:
        nonlocal failed
        row = _row(grid, run, outcome)
        if outcome.log is not None:
            store.put(row.log, outcome.log)
        store.append(row)
        rows[run.id] = row
        failed += row.status != OK
        on_progress(Tally(len(rows), failed, len(grid.runs), resumed))

    on_progress(Tally(len(rows), failed, len(grid.runs), resumed))
    runs = {run.id: run for run in grid.runs if run.id not in rows}
    for run in list(runs.values()):
        if error := grid.cells[run.cell].error:
            keep(run, Outcome(run.id, "broken", error, values=_no_success(grid)))
            del runs[run.id]
    if runs:
        tasks = _tasks(grid, runs.values(), function)
        with closing(outcomes_of(tasks, engine or LocalEngine())) as outcomes:
            for outcome in outcomes:
                keep(runs[outcome.id], outcome)

    on_step("summary")
    ordered = [rows[run.id] for run in grid.runs]
    store.finish(ordered)
    return write_results(grid, ordered, store, name=name, on_step=on_step)


def write_results(
    grid: Grid,
    rows: list[Row],
    store: Store,
    *,
    name: str,
    on_step: Callable[[str], None] = lambda _text: None,
) -> Results:
    """Summary, figures and report of the rows there are."""
    from twin.study_report import report_files

    results = Results(grid, rows)
    store.put(SUMMARY, summary_csv(results))
    on_step("report")
    for file, content in report_files(results, name).items():
        store.put(file, content)
    return results


def _tasks(grid: Grid, runs: Iterable[Run], function: str) -> Iterator[Task]:
    """The runs as tasks, made when they are asked for."""
    study = grid.study
    for run in runs:
        cell = grid.cells[run.cell]
        log = study.log.mcap
        if log == "first":
            log = "all" if run.replication == 0 else "none"
        yield Task(
            id=run.id,
            world=cell.world,
            seeds=dict.fromkeys(cell.seeds, run.seed),
            planner=cell.planner.model_dump(),
            execute=study.study.run == "execute",
            columns=study.columns,
            log=log,
            validate=study.log.validate_logs,
            timeout_s=study.study.timeout_s,
            function=function,
        )


def _row(grid: Grid, run: Run, outcome: Outcome) -> Row:
    cell = grid.cells[run.cell]
    values: dict[str, Value] = dict(outcome.values)
    if outcome.status != OK:
        values |= _no_success(grid)
    return Row(
        run=run.id,
        scenario=cell.scenario,
        levels=cell.levels,
        replication=run.replication,
        seed=run.seed,
        status=outcome.status,
        error=outcome.error,
        seconds=outcome.seconds,
        values=values,
        log=f"logs/{run.id}.mcap" if outcome.log is not None else "",
    )


def _no_success(grid: Grid) -> dict[str, Value]:
    return {"success": 0} if "success" in grid.study.columns else {}
