"""The report of a study: one HTML file for somebody who did not run it, and its figures as SVG."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Sequence

from twin.study_figures import Drawing, draw, drawings, title_of
from twin.study_kpi import column
from twin.study_lock import versions
from twin.study_run import OK, STATUSES
from twin.study_spec import BASE, SCENARIO, Reference
from twin.study_store import REPORT, Row
from twin.study_summary import Estimate, Results, cell_name

ROWS_SHOWN = 200
MAX_FIGURES = 120
"""More would make a page nobody scrolls through; summary.csv has them all."""


def report_files(results: Results, name: str) -> dict[str, bytes]:
    """report.html, and the figures the study itself asks for as files."""
    found = drawings(results.grid)
    asked = len(results.grid.study.figure)
    files: dict[str, bytes] = {}
    shown: list[dict[str, str]] = []
    rest: list[dict[str, str]] = []
    for k, drawing in enumerate(found[:MAX_FIGURES]):
        svg = draw(results, drawing)
        if svg is None:
            continue
        entry = _figure_values(drawing, svg)
        (shown if k < asked or not asked else rest).append(entry)
        if k < asked:
            files[f"figures/{slug(drawing.title)}.svg"] = svg
    files[REPORT] = _page(results, name, shown, rest).encode()
    return files


def slug(title: str) -> str:
    """`Fig. 3: solution ratio` → `fig-3-solution-ratio`."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")[:60] or "figure"


def _figure_values(drawing: Drawing, svg: bytes) -> dict[str, str]:
    data = base64.b64encode(svg).decode()
    return {"title": title_of(drawing), "says": drawing.says, "data": data}


def _page(
    results: Results, name: str, figures: list[dict[str, str]], more: list[dict[str, str]]
) -> str:
    from jinja2 import Environment, StrictUndefined

    from twin.study_template import PAGE

    grid, study = results.grid, results.grid.study
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    options = study.study
    done, total = len(results.rows), len(grid.runs)
    what = "planned and executed" if options.run == "execute" else "planned"
    facts = (
        f"{total} runs of {options.world}, {what}: {len(grid.cells)} variants in "
        f"{options.replications} replications (seeds {options.seed} to "
        f"{options.seed + options.replications - 1}), the same draws for every variant."
    )
    if done < total:
        facts += f" Only {done} have been run so far."
    scenarios = [(s.name, s.about or _settings(s.set)) for s in study.scenario]
    if any(c.scenario == BASE for c in grid.cells) and BASE not in dict(scenarios):
        scenarios = [(BASE, "the world as its file has it"), *scenarios]
    return environment.from_string(PAGE).render(
        title=options.name or name,
        facts=facts,
        story=[part for part in options.story.strip().split("\n\n") if part],
        statuses=[(s, n, STATUSES[s]) for s, n in results.statuses().items()],
        failures=_listed(results, [r for r in results.rows if r.status != OK]),
        logs=_listed(results, [r for r in results.rows if r.log]),
        scenarios=scenarios if len(scenarios) > 1 or study.scenario else [],
        factors=[(f, ", ".join(grid.levels(f))) for f in grid.factors],
        references=[reference_values(results, r) for r in study.reference],
        differences=_differences(results),
        difference_kpis=[column(k).label for k in study.shown],
        common=_common(results),
        figures=figures,
        more_figures=more,
        table_head=[SCENARIO, *grid.factors, *(column(k).label for k in study.shown)],
        table=_table(results),
        repeat=f"twin study {name}.toml gives the same rows (all but seconds) with these versions; "
        "study.lock.toml beside this page has every value, world and seed.",
        versions=list(versions().items()),
    )


def _settings(settings: dict[str, object]) -> str:
    return ", ".join(f"{path} = {value}" for path, value in settings.items())


def _listed(results: Results, rows: Sequence[Row]) -> list[dict[str, object]]:
    """The first of some rows, each with the name of its cell."""
    names = {cell.key: cell_name(cell) for cell in results.grid.cells}
    return [
        {
            "run": row.run,
            "cell": names[row.cell],
            "replication": row.replication,
            "seed": row.seed,
            "status": row.status,
            "error": row.error,
            "log": row.log,
        }
        for row in rows[:ROWS_SHOWN]
    ]


def _common(results: Results) -> str:
    common = results.grid.study.kpi.common
    if not common:
        return ""
    named = "; ".join(f"{f} {', '.join(map(str, levels))}" for f, levels in common.items())
    return (
        "Costs, times and handovers are means over the replications in which all of these "
        f"succeeded: {named}."
    )


def number(value: float) -> str:
    """Four figures that matter; whole numbers as they are; nothing for NaN."""
    if math.isnan(value):
        return ""
    if value == int(value) and abs(value) < 1e6:
        return str(int(value))
    return f"{value:.4g}"


def plus_minus(estimate: Estimate, kpi: str = "") -> str:
    """`12.3 ± 0.4 (10)`; a share of runs with the ends of its interval, `90 % [60, 98] (10)`."""
    if not estimate.n:
        return "–"
    if column(kpi).share:
        low, high = 100 * estimate.low, 100 * estimate.high
        return f"{100 * estimate.mean:.0f} % [{low:.0f}, {high:.0f}] ({estimate.n})"
    half = "" if math.isnan(estimate.half_width) else f" ± {estimate.half_width:.2g}"
    return f"{number(estimate.mean)}{half} ({estimate.n})"


def reference_values(results: Results, reference: Reference) -> dict[str, str]:
    """A printed figure and the measured one, as text."""
    found = results.reference(reference)
    share = column(reference.kpi).share or reference.against is not None

    def text(value: float) -> str:
        if math.isnan(value):
            return "–"
        if share:
            sign = "+" if reference.against is not None and value > 0 else ""
            return f"{sign}{100 * value:.1f} %"
        return number(value)

    printed = reference.says if reference.value is None else text(reference.value)
    known = not math.isnan(found.low)
    interval = f"{text(found.low)} … {text(found.high)}" if known else "–"
    return {
        "text": reference.text,
        "printed": printed,
        "measured": text(found.mean) if found.n else "–",
        "interval": interval,
        "n": str(found.n),
    }


def _differences(results: Results) -> list[tuple[str, list[tuple[str, bool]]]]:
    """Per cell with a baseline: every figure's paired difference, and whether it is sure."""
    grid = results.grid
    found = []
    for i, cell in enumerate(grid.cells):
        if cell.baseline is None:
            continue
        entries = []
        for kpi in grid.study.shown:
            d = results.difference(i, cell.baseline, kpi)
            sign = "+" if d.mean > 0 else ""
            entries.append((f"{sign}{plus_minus(d)}" if d.n else "–", d.sure))
        base = cell_name(grid.cells[cell.baseline], cell)
        found.append((f"{cell_name(cell)} (against {base})", entries))
    return found


def _table(results: Results) -> list[list[tuple[str, bool]]]:
    lines = []
    for i, cell in enumerate(results.grid.cells):
        line = [(text, False) for text in cell.key]
        line += [(plus_minus(results.estimate([i], k), k), True) for k in results.grid.study.shown]
        lines.append(line)
    return lines
