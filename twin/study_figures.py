"""The figures of a study: a key figure along one factor, a line per level of others, intervals.

Drawn from the rows alone, as SVG, the same bytes every time.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from twin.study_grid import Grid
from twin.study_kpi import column
from twin.study_spec import SCENARIO
from twin.study_summary import Estimate, Results

MAX_LINES = 8
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#555555", "#9a6324")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
_STYLES = ("-", "--", ":", "-.")


@dataclass(frozen=True)
class Drawing:
    """A figure to be drawn.

    Attributes:
        kpi: what is shown.
        x: factor along the axis.
        lines: factors of which each combination of levels is a line.
        over: varying factors over whose levels the mean is taken.
        where: levels of the cells shown.
        title: "" for one made of these.
        says: what to expect, for the caption.
    """

    kpi: str
    x: str
    lines: tuple[str, ...] = ()
    over: tuple[str, ...] = ()
    where: Mapping[str, object] | None = None
    title: str = ""
    says: str = ""


def drawings(grid: Grid) -> list[Drawing]:
    """The figures a study asks for, then one for every key figure and factor."""
    study = grid.study
    found = []
    for f in study.figure:
        varying = _varying(grid, f.where)
        over = tuple(v for v in varying if v not in (f.x, *f.lines))
        found.append(Drawing(f.kpi, f.x, f.lines, over, f.where, f.title, f.says))
    varying = _varying(grid, {})
    for kpi in study.shown:
        for x in varying:
            lines, over = _lines(grid, [f for f in varying if f != x])
            found.append(Drawing(kpi, x, lines, over))
    return found


def _varying(grid: Grid, where: Mapping[str, object]) -> list[str]:
    """Factors with several levels among the cells that match."""
    cells = [cell for cell in grid.cells if cell.matches(where)]
    factors = [SCENARIO, *grid.factors]
    return [f for f in factors if len({cell.at(f) for cell in cells}) > 1]


def _lines(grid: Grid, factors: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Which factors are told apart by lines, and over which the mean is taken."""
    lines: list[str] = []
    for factor in factors:
        combinations = {tuple(cell.at(f) for f in [*lines, factor]) for cell in grid.cells}
        if len(combinations) <= MAX_LINES:
            lines.append(factor)
    return tuple(lines), tuple(f for f in factors if f not in lines)


@dataclass(frozen=True)
class Line:
    """One line: its levels, and an estimate for each level of the axis that it has."""

    levels: tuple[str, ...]
    points: dict[str, Estimate]


def lines_of(results: Results, drawing: Drawing) -> list[Line]:
    """What is drawn, as numbers."""
    grid = results.grid
    groups: dict[tuple[str, ...], dict[str, list[int]]] = {}
    for i, cell in enumerate(grid.cells):
        if cell.matches(drawing.where or {}):
            levels = tuple(cell.at(f) for f in drawing.lines)
            groups.setdefault(levels, {}).setdefault(cell.at(drawing.x), []).append(i)
    found = []
    for levels, by_x in groups.items():
        points = {x: results.estimate(cells, drawing.kpi) for x, cells in by_x.items()}
        points = {x: e for x, e in points.items() if e.n}
        if points:
            found.append(Line(levels, points))
    return found


def draw(results: Results, drawing: Drawing) -> bytes | None:
    """The figure as SVG; None if there is nothing to show."""
    lines = lines_of(results, drawing)
    if not lines:
        return None
    order = [x for x in results.grid.levels(drawing.x) if any(x in k.points for k in lines)]
    numbers = [_number(x) for x in order]
    numeric = all(math.isfinite(v) for v in numbers)
    wide = not numeric and (len(order) > 6 or max(map(len, order)) > 14)
    figure = Figure(figsize=(8.6 if wide else 6.4, 3.9), layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    span = (max(numbers) - min(numbers) if numeric else len(order) - 1) or 1.0
    for k, line in enumerate(lines):
        # Lines stand a little apart so that their intervals do not hide one another.
        shift = (k - (len(lines) - 1) / 2) * span * 0.012
        at = {x: (numbers[j] if numeric else float(j)) for j, x in enumerate(order)}
        _draw_line(ax, [(at[x] + shift, e) for x in order if (e := line.points.get(x))], k, line)
    ax.set_xlabel(_axis_name(drawing.x))
    ax.set_ylabel(column(drawing.kpi).label)
    if numeric and len(order) <= 12:
        ax.set_xticks(numbers, order)
    elif not numeric:
        ax.set_xticks(range(len(order)), order)
        if wide:
            ax.tick_params(axis="x", rotation=25)
            for tick in ax.get_xticklabels():
                tick.set_horizontalalignment("right")
    if column(drawing.kpi).share:
        ax.set_ylim(-0.04, 1.04)
    else:
        _limit(ax, [e for line in lines for e in line.points.values()])
    ax.grid(color="#dddddd", lw=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    if drawing.lines:
        named = ", ".join(_axis_name(f) for f in drawing.lines)
        many = len(lines) > 3
        figure.legend(
            title=named,
            loc="outside right upper" if many else "outside upper left",
            ncols=1 if many else len(lines),
            fontsize=8,
            title_fontsize=8,
            frameon=False,
        )
    return _svg(figure)


def _limit(ax: Axes, shown: list[Estimate]) -> None:
    """Show all means; intervals of two values, which may be huge, do not decide what is seen."""
    trusted = [e for e in shown if e.n > 2]
    low = min(*(e.mean for e in shown), *(e.low for e in trusted), math.inf)
    high = max(*(e.mean for e in shown), *(e.high for e in trusted), -math.inf)
    if math.isfinite(low) and high > low:
        room = 0.05 * (high - low)
        least = 0.0 if all(e.mean >= 0 for e in shown) else -math.inf
        ax.set_ylim(max(low - room, least - room / 2), high + room)


def _draw_line(ax: Axes, points: list[tuple[float, Estimate]], k: int, line: Line) -> None:
    x = [at for at, _ in points]
    y = [e.mean for _, e in points]
    below = [0.0 if math.isnan(e.low) else e.mean - e.low for _, e in points]
    above = [0.0 if math.isnan(e.high) else e.high - e.mean for _, e in points]
    ax.errorbar(
        x,
        y,
        yerr=(below, above),
        color=_COLORS[k % len(_COLORS)],
        marker=_MARKERS[k % len(_MARKERS)],
        ls=_STYLES[(k // 4) % len(_STYLES)],
        ms=4.5,
        lw=1.4,
        elinewidth=0.9,
        capsize=2.5,
        label=", ".join(line.levels) or None,
    )


def _axis_name(factor: str) -> str:
    names = {
        "robots.random.count": "robots",
        "radio.ap_capacity": "robots per AP (m)",
        "plan.horizon": "horizon [slots]",
        "plan.objective": "objective",
        "planner.method": "method",
    }
    return names.get(factor, factor)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _svg(figure: Figure) -> bytes:
    text = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "mapp", "svg.fonttype": "none"}):
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()


def title_of(drawing: Drawing) -> str:
    """What a figure shows, in words."""
    if drawing.title:
        return drawing.title
    over = ", ".join(_axis_name(f) for f in drawing.over)
    label = column(drawing.kpi).label
    text = f"{label} along {_axis_name(drawing.x)}"
    return text + (f", mean over {over}" if over else "")
