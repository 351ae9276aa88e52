"""`twin compare`: two studies side by side."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from twin.cli_console import guarded, print_json, stdout
from twin.cli_options import AsJson, Debug

if TYPE_CHECKING:
    from twin.study_compare import Change, Comparison

TURNED_SHOWN = 12


def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="Folder of a study.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="Folder of another, to compare with it.")],
    kpi: Annotated[
        list[str] | None,
        typer.Option("--kpi", metavar="NAME", help="Only this figure. Can be given many times."),
    ] = None,
    sure: Annotated[
        bool, typer.Option("--sure", help="Only differences that chance hardly explains.")
    ] = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Compare two studies: per variant and key figure the means and their (paired) difference."""
    with guarded(debug):
        from twin.errors import TwinError
        from twin.study_compare import compare as compared
        from worlds.part import nearest

        for folder in (a, b):
            if not folder.is_dir():
                raise TwinError(f"{folder}: is no folder; give the folders of two studies")
        found = compared(a, b)
        known = list(dict.fromkeys(change.kpi for change in found.changes))
        for name in kpi or []:
            if known and name not in known:
                hint = nearest(name, known) or f" both have {', '.join(known)}"
                raise TwinError(f"--kpi {name}: is no figure of both studies;{hint}")
        changes = [c for c in found.changes if not kpi or c.kpi in kpi]
        if sure:
            changes = [c for c in changes if c.difference.sure]
        if as_json:
            print_json(_values(found, changes, a, b))
        else:
            _print(stdout(), found, changes, a, b)


def _plain(value: float) -> float | None:
    return None if math.isnan(value) else value


def _cell(found: Comparison, cell: tuple[str, ...]) -> dict[str, object]:
    return {"scenario": cell[0], "levels": dict(zip(found.factors, cell[1:], strict=True))}


def _values(found: Comparison, changes: list[Change], a: Path, b: Path) -> dict[str, object]:
    """The comparison as plain values."""
    return {
        "a": str(a),
        "b": str(b),
        "changes": [
            {
                **_cell(found, c.cell),
                "kpi": c.kpi,
                "a": {"n": c.a.n, "mean": _plain(c.a.mean)},
                "b": {"n": c.b.n, "mean": _plain(c.b.mean)},
                "pairs": c.pairs,
                "difference": _plain(c.difference.mean),
                "low_95": _plain(c.difference.low),
                "high_95": _plain(c.difference.high),
                "sure": c.difference.sure,
            }
            for c in changes
        ],
        "turned": [
            {"a": x.run, "b": y.run, "seed": x.seed, "status_a": x.status, "status_b": y.status}
            for x, y in found.turned
        ],
        "only_a": [_cell(found, cell) for cell in found.only_a],
        "only_b": [_cell(found, cell) for cell in found.only_b],
        "kpis_left_out": list(found.kpis_left_out),
    }


def _print(console: Console, found: Comparison, changes: list[Change], a: Path, b: Path) -> None:
    from twin.study_report import plus_minus

    varying = [
        k
        for k, _ in enumerate(("scenario", *found.factors))
        if len({change.cell[k] for change in found.changes}) > 1
    ]
    names = ("scenario", *found.factors)
    table = Table(title=f"A = {a}, B = {b}", title_justify="left")
    for name in (*(names[k] for k in varying), "figure", "A", "B", "B − A", "pairs"):
        table.add_column(name, overflow="fold")
    for change in changes:
        d = change.difference
        sign = "+" if d.mean > 0 else ""
        said = Text(f"{sign}{plus_minus(d)}", style="bold" if d.sure else "")
        table.add_row(
            *(Text(change.cell[k]) for k in varying),
            Text(change.kpi),
            Text(plus_minus(change.a, change.kpi)),
            Text(plus_minus(change.b, change.kpi)),
            said if d.n else Text("–"),
            Text(str(change.pairs)),
        )
    if changes:
        console.print(table)
    else:
        console.print(Text("no difference to show"))
    for x, y in found.turned[:TURNED_SHOWN]:
        which = ", ".join((x.scenario, *(f"{f} = {v}" for f, v in x.levels.items())))
        words = f"seed {x.seed}: {x.status} in A, {y.status} in B ({which})"
        console.print(Text(words), soft_wrap=True)
    if len(found.turned) > TURNED_SHOWN:
        console.print(Text(f"… and {len(found.turned) - TURNED_SHOWN} more such runs"))
    for cells, where in ((found.only_a, a), (found.only_b, b)):
        if cells:
            console.print(Text(f"only in {where}: {len(cells)} variants"), soft_wrap=True)
    if found.kpis_left_out:
        left = ", ".join(found.kpis_left_out)
        console.print(Text(f"only in one of them: {left}"), soft_wrap=True)
