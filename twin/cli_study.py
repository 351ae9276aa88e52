"""`twin study`: many runs of many variants, and what they show together."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from twin.cli_console import (
    DONE,
    INTERRUPTED,
    NO,
    Meter,
    guarded,
    print_json,
    say_errors,
    stdout,
)
from twin.cli_options import AsJson, Debug, Overwrite, require_suffix

if TYPE_CHECKING:
    from twin.study import Tally
    from twin.study_engine import Engine
    from twin.study_grid import Grid
    from twin.study_summary import Results

LINES_SHOWN = 40


def study(
    file: Annotated[
        Path, typer.Argument(metavar="STUDY.toml", help="What is varied and what is measured.")
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Folder; else runs/<name of the file>."),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, max=1024, help="Runs at a time; as many as there are cores."),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="tcp://HOST:PORT", help="Run on a dask cluster (extra `cluster`) instead."
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with a study that was stopped.")
    ] = False,
    quick: Annotated[
        bool, typer.Option("--quick", help="The study's short form, for a first look.")
    ] = False,
    replications: Annotated[
        int | None,
        typer.Option(min=1, max=100_000, help="Instead of the file's; more with --resume."),
    ] = None,
    list_only: Annotated[bool, typer.Option("--list", help="Only say what would be run.")] = False,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Run every variant of a study in every replication; sum them up in tables and a report."""
    with guarded(debug):
        from twin.errors import TwinError
        from twin.study import plan_study

        require_suffix(file, (".toml",), "a study file")
        if resume and overwrite:
            raise TwinError("--resume goes on with results, --overwrite replaces them; choose one")
        if jobs is not None and cluster is not None:
            raise TwinError("--jobs is for this machine, --cluster for others; choose one")
        with Meter() as meter:
            meter.phase("study")
            grid = plan_study(file, quick=quick, replications=replications)
        if list_only:
            _list(grid, as_json)
            return
        folder = output or Path("runs") / file.stem
        results = _run(grid, folder, file.stem, _engine(jobs, cluster), resume, overwrite)
        if as_json:
            print_json(_values(results, folder))
        else:
            _print(stdout(), results, folder)
        good = all(row.status == "ok" for row in results.rows)
        raise typer.Exit(DONE if good else NO)


def _engine(jobs: int | None, cluster: str | None) -> Engine:
    from twin.study_engine import ClusterEngine, LocalEngine

    return LocalEngine(jobs) if cluster is None else ClusterEngine(cluster)


def _run(
    grid: Grid, folder: Path, name: str, engine: Engine, resume: bool, overwrite: bool
) -> Results:
    """The study's runs, with their progress shown; Ctrl-C keeps what has ended."""
    from twin.study import run_study
    from twin.study_store import FolderStore

    done: list[Tally] = []
    begin = time.monotonic()
    with Meter() as meter:

        def on_progress(tally: Tally) -> None:
            done[:] = [tally]
            seconds = time.monotonic() - begin
            meter.step(progress_text(tally, seconds), tally.done / max(1, tally.total))

        try:
            with FolderStore(folder, overwrite=overwrite) as store:
                return run_study(
                    grid,
                    store,
                    engine,
                    name=name,
                    resume=resume,
                    on_progress=on_progress,
                    on_step=meter.phase,
                )
        except KeyboardInterrupt:
            pass
    kept = f"{done[0].done} of {done[0].total} runs are kept in {folder}" if done else "no run yet"
    say_errors(f"interrupted; {kept}; --resume goes on with them")
    raise typer.Exit(INTERRUPTED)


def progress_text(tally: Tally, seconds: float) -> str:
    """`57 done, 2 without success, 141 left, 3 min`."""
    parts = [f"{tally.done} done"]
    if tally.failed:
        parts.append(f"{tally.failed} without success")
    parts.append(f"{tally.left} left")
    here = tally.done - tally.resumed
    if here and tally.left:
        parts.append(f"about {duration(seconds / here * tally.left)}")
    return ", ".join(parts)


def duration(seconds: float) -> str:
    """`40 s`, `12 min`, `3.5 h`."""
    if seconds < 90:
        return f"{math.ceil(seconds)} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _list(grid: Grid, as_json: bool) -> None:
    """Every variant, what it sets, and how many runs that makes."""
    from twin.study_summary import cell_name

    replications = grid.study.study.replications
    if as_json:
        cells = [
            {
                "scenario": cell.scenario,
                "levels": cell.levels,
                "settings": cell.settings,
                "planner": cell.planner.model_dump(),
                "error": cell.error or None,
                "runs": [run.id for run in grid.runs if run.cell == i],
            }
            for i, cell in enumerate(grid.cells)
        ]
        seeds = list(dict.fromkeys(run.seed for run in grid.runs))
        print_json({"runs": len(grid.runs), "seeds": seeds, "cells": cells})
        return
    console = stdout()
    for cell in grid.cells:
        line = Text(cell_name(cell))
        if cell.error:
            line.append(f"  broken: {cell.error}", style="bold red")
        console.print(line, soft_wrap=True)
    console.print(
        Text(f"{len(grid.cells)} variants in {replications} replications: {len(grid.runs)} runs"),
        soft_wrap=True,
    )


def _values(results: Results, folder: Path) -> dict[str, object]:
    """The summary as plain values."""
    grid = results.grid

    def plain(value: float) -> float | None:
        return None if math.isnan(value) else value

    entries = []
    for entry in results.summary():
        cell, d = grid.cells[entry.cell], entry.difference
        entries.append(
            {
                "scenario": cell.scenario,
                "levels": cell.levels,
                "kpi": entry.kpi,
                "n": entry.value.n,
                "mean": plain(entry.value.mean),
                "low_95": plain(entry.value.low),
                "high_95": plain(entry.value.high),
                "difference": None
                if d is None
                else {"pairs": d.n, "mean": plain(d.mean), "half_width_95": plain(d.half_width)},
            }
        )
    return {
        "runs": len(results.rows),
        "statuses": results.statuses(),
        "summary": entries,
        "folder": str(folder),
    }


def _print(console: Console, results: Results, folder: Path) -> None:
    """References or means as a table, then how the runs ended, then where everything is."""
    from twin.study_report import plus_minus, reference_values
    from twin.study_store import REPORT, RUNS, SUMMARY

    grid = results.grid
    study = grid.study
    if study.reference:
        table = Table(title="beside what is printed elsewhere", title_justify="left")
        for name in ("figure", "printed", "measured", "95 % interval", "n"):
            table.add_column(name)
        for reference in study.reference:
            table.add_row(*(Text(v) for v in reference_values(results, reference).values()))
        console.print(table)
    else:
        table = Table(title=study.study.name or "means", title_justify="left")
        varying = [f for f in ("scenario", *grid.factors) if len(grid.levels(f)) > 1]
        for name in (*varying, *study.shown):
            table.add_column(name, overflow="fold")
        for i, cell in list(enumerate(grid.cells))[:LINES_SHOWN]:
            means = (plus_minus(results.estimate([i], kpi), kpi) for kpi in study.shown)
            table.add_row(*(Text(cell.at(f)) for f in varying), *map(Text, means))
        console.print(table)
        if len(grid.cells) > LINES_SHOWN:
            rest = len(grid.cells) - LINES_SHOWN
            console.print(Text(f"… and {rest} more, see {folder / SUMMARY}"), soft_wrap=True)
    counts = ", ".join(f"{n} {status}" for status, n in results.statuses().items())
    good = set(results.statuses()) <= {"ok"}
    console.print(
        Text(f"{len(results.rows)} runs: {counts}", style="bold green" if good else "bold yellow"),
        soft_wrap=True,
    )
    for name in (REPORT, SUMMARY, RUNS):
        console.print(Text(str(folder / name)), soft_wrap=True)
