"""`python -m benchmarks`: run, compare, plot.

python -m benchmarks run --family paper_hall --phase auto --seeds 5 -o results.json
python -m benchmarks run --smoke
python -m benchmarks radio -o radio.json
python -m benchmarks compare old.json new.json
python -m benchmarks plot results.json -o results.png
"""

from __future__ import annotations

import json
import multiprocessing
import os
import platform
import resource
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.execution import execution
from benchmarks.families import FAMILIES
from benchmarks.phases import PHASES, Figures
from planner.problem import Problem
from planner.warm_up import compile_kernels

app = typer.Typer(add_completion=False, help=__doc__)
Row = dict[str, Any]


@app.command()
def run(
    family: Annotated[list[str] | None, typer.Option(help="instance families; all if none")] = None,
    phase: Annotated[list[str] | None, typer.Option(help="what to time; all if none")] = None,
    size: Annotated[str, typer.Option(help="only sizes that contain this text")] = "",
    seeds: Annotated[int, typer.Option(min=1)] = 3,
    smoke: Annotated[bool, typer.Option(help="one tiny case per family and phase")] = False,
    apart: Annotated[
        bool, typer.Option(help="a process of its own for each, so that its peak memory is its own")
    ] = False,
    output: Annotated[Path | None, typer.Option("--output", "-o")] = None,
) -> None:
    """Time phases on instances; results as JSON, medians on the screen."""
    families, phases = family or list(FAMILIES), phase or list(PHASES)
    for given, known in ((families, FAMILIES), (phases, PHASES)):
        for name in given:
            if name not in known:
                typer.echo(f"there is no {name!r}; choose among {', '.join(known)}", err=True)
                raise typer.Exit(2)
    rows: list[Row] = []
    # Compiled before anything is timed: kernels are cached once per machine.
    warm = next(FAMILIES["paper_hall"](True, 1)).build()
    compile_kernels()
    for name in phases:
        PHASES[name](warm)
    for name in families:
        for case in FAMILIES[name](smoke, 1 if smoke else seeds):
            if size and size not in case.size:
                continue
            problem = case.build()
            for what in phases:
                row = {"family": case.family, "size": case.size, "seed": case.seed, "phase": what}
                row |= (_apart if apart else _timed)(PHASES[what], problem)
                rows.append(row)
                typer.echo(_line(row), err=True)
    result = {"machine": _machine(), "rows": rows}
    if output is not None:
        output.write_text(json.dumps(result, indent=1) + "\n")
    _print_medians(rows)


@app.command()
def radio(
    seeds: Annotated[int, typer.Option(min=1)] = 1,
    smoke: Annotated[bool, typer.Option(help="one tiny hall")] = False,
    output: Annotated[Path | None, typer.Option("--output", "-o")] = None,
) -> None:
    """Time the radio map of a large hall: our rays, those saved, and a plain loop over all."""
    from benchmarks.radio import measure

    rows: list[Row] = []
    for row in measure(smoke, seeds):
        rows.append(row | {"peak_mb": _peak_mb()})
        typer.echo(_line(rows[-1]), err=True)
    if output is not None:
        output.write_text(json.dumps({"machine": _machine(), "rows": rows}, indent=1) + "\n")
    _print_medians(rows)
    # By CPU: neither side waits for anything, and other work on the machine does not count.
    times = {(r["size"], r["seed"], r["phase"]): r["cpu_seconds"] for r in rows}
    for size in dict.fromkeys(row["size"] for row in rows):
        for phase in ("radio_map", "radio_map_coverage"):
            ratio = statistics.median(
                times[size, seed, "plain_loop"] / times[size, seed, phase]
                for seed in range(1, seeds + 1)
            )
            said = f"the plain loop takes {ratio:.1f} times the CPU time of {phase}"
            typer.echo(f"radio {size}: {said}")


@app.command()
def compare(before: Path, after: Path) -> None:
    """Median ratio after / before of the seconds of the same cases, by family, size and phase."""
    old, new = _by_case(before), _by_case(after)
    ratios: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    costs: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    for key in sorted(old.keys() & new.keys()):
        group = key[:2] + key[3:]
        ratios[group].append(new[key]["seconds"] / old[key]["seconds"])
        if old[key].get("cost") and new[key].get("cost"):
            costs[group].append(new[key]["cost"] / old[key]["cost"])
    for group, values in ratios.items():
        cost = f"cost × {statistics.median(costs[group]):.4f}" if costs[group] else ""
        typer.echo(
            f"{group[0]:24} {group[1]:18} {group[2]:16} seconds × "
            f"{statistics.median(values):6.2f} ({len(values)} cases) {cost}"
        )
    if not ratios:
        typer.echo("the two files have no case in common", err=True)
        raise typer.Exit(1)


@app.command()
def plot(results: Path, output: Annotated[Path, typer.Option("--output", "-o")]) -> None:
    """Medians over sizes, a row of panels per family: seconds, and the gap where there is one."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    rows = json.loads(results.read_text())["rows"]
    families = list(dict.fromkeys(row["family"] for row in rows))
    figure, axes = plt.subplots(
        len(families), 2, figsize=(13, 3.2 * len(families)), squeeze=False, layout="constrained"
    )
    for (left, right), family in zip(axes, families, strict=True):
        mine = [row for row in rows if row["family"] == family]
        _draw(left, mine, "seconds", 1.0)
        left.set(yscale="log", ylabel="median time [s]", title=family)
        _draw(right, mine, "gap", 100.0)
        right.set(ylabel="median gap [%]", ylim=(0, None), title=f"{family}: proven within")
    figure.savefig(output, dpi=120)


def _draw(axis: Any, rows: list[Row], figure: str, unit: float) -> None:
    """A line per phase of the medians of a figure over sizes."""
    sizes = list(dict.fromkeys(row["size"] for row in rows))
    for phase in dict.fromkeys(row["phase"] for row in rows):
        found = [
            [
                unit * r[figure]
                for r in rows
                if (r["size"], r["phase"]) == (size, phase) and r.get(figure) is not None
            ]
            for size in sizes
        ]
        if any(found):
            medians = [statistics.median(values or [float("nan")]) for values in found]
            axis.plot(range(len(sizes)), medians, "o-", label=phase)
            axis.legend(fontsize=7, ncols=4)
    axis.set_xticks(range(len(sizes)), sizes, rotation=30, ha="right", fontsize=7)
    axis.grid(alpha=0.3)


def _by_case(path: Path) -> dict[tuple[str, str, int, str], Row]:
    rows = json.loads(path.read_text())["rows"]
    return {(r["family"], r["size"], r["seed"], r["phase"]): r for r in rows}


def _timed(phase: Callable[[Problem], Figures], problem: Problem) -> Row:
    """Seconds, peak memory and figures of a phase."""
    began = time.perf_counter()
    figures = phase(problem)
    return {"seconds": time.perf_counter() - began, "peak_mb": _peak_mb(), **figures}


def _apart(phase: Callable[[Problem], Figures], problem: Problem) -> Row:
    """The same in a process of its own: what came before counts only as far as it is still there.

    Raises:
        RuntimeError: the process ended without an answer.
    """
    fork = multiprocessing.get_context("fork")  # a case cannot be sent to a fresh process
    mine, theirs = fork.Pipe(duplex=False)
    child = fork.Process(target=lambda: theirs.send(_timed(phase, problem)))
    child.start()
    theirs.close()
    try:
        row: Row = mine.recv()
    except EOFError as error:
        raise RuntimeError("the process of this case ended without an answer") from error
    child.join()
    return row


def _peak_mb() -> float:
    """Largest resident size of this process so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _machine() -> dict[str, str | int | None]:
    return {
        "python": platform.python_version(),
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "argv": " ".join(sys.argv[1:]),
    }


def _line(row: Row) -> str:
    rest = {
        k: round(v, 4) if isinstance(v, float) else v
        for k, v in row.items()
        if k not in {"family", "size", "seed", "phase", "seconds"} and v is not None
    }
    place = f"{row['family']:16} {row['size']:16} seed {row['seed']:2} {row['phase']:16}"
    return f"{place} {row['seconds']:8.3f} s {rest}"


def _print_medians(rows: list[Row]) -> None:
    groups: dict[tuple[str, str, str], list[Row]] = defaultdict(list)
    for row in rows:
        groups[row["family"], row["size"], row["phase"]].append(row)
    for (family, size, phase), mine in groups.items():
        gaps = [r["gap"] for r in mine if r.get("gap") is not None]
        served = [r["served_share"] for r in mine if "served_share" in r]
        states = sorted({str(r["status"]) for r in mine if "status" in r})
        text = f"{family:24} {size:18} {phase:16}"
        text += f" {statistics.median(r['seconds'] for r in mine):8.3f} s"
        text += f"  gap {statistics.median(gaps):.2%}" if gaps else ""
        text += f"  served {statistics.mean(served):.1%}" if served else ""
        typer.echo(f"{text}  {' '.join(states)}")
    # The yardstick of the same run, case by case.
    times = {(r["family"], r["size"], r["seed"], r["phase"]): r["seconds"] for r in rows}
    ratios: dict[tuple[str, str], list[float]] = defaultdict(list)
    for (family, size, seed, phase), seconds in times.items():
        if phase == "yardstick" and (family, size, seed, "path_generation") in times:
            ours = times[family, size, seed, "path_generation"]
            ratios[family, size].append(seconds / ours)
    for (family, size), values in ratios.items():
        ratio = statistics.median(values)
        typer.echo(f"{family:24} {size:18} literal Algorithm 1 takes {ratio:.0f} times as long")


app.command()(execution)

if __name__ == "__main__":
    app()
