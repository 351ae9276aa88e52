"""Charts of a report as plain geometry, to be drawn as SVG by a template.

Everything is in the units of a chart's own viewBox; time runs to the right in seconds. Texts stay
texts: names of robots and APs get into the page through the template's escaping only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from logs.colors import ap_color
from logs.report_data import ApStory, RobotStory, Span

LOAD_W, LOAD_H = 540.0, 150.0
BARS_W = 1100.0
ROBOTS_PER_CHART = 40
"""Robots in one chart of bars: as many as fit on a page."""
CHAR_W = 6.4  # of a digit or letter at the size of labels
TEXT_SHIFT = 7.0
"""A name in a bar begins so far behind the bar's beginning: the mark of a handover goes before."""
_LABEL_CHARS = 14  # of a robot's name beside its bar


@dataclass(frozen=True, slots=True)
class Tick:
    """A mark on an axis: where, and what is written there."""

    at: float
    text: str


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle.

    Attributes:
        x, y, w, h: where and how large.
        fill: its colour, "" for the pattern of lost connection.
        text: written in it if there is room.
        ink: colour of that text.
        title: what it says in full.
    """

    x: float
    y: float
    w: float
    h: float
    fill: str
    text: str = ""
    ink: str = "#fff"
    title: str = ""


@dataclass(frozen=True, slots=True)
class Mark:
    """A point and what it says in full."""

    x: float
    y: float
    title: str


@dataclass(frozen=True)
class LoadChart:
    """Load of one AP over time.

    Attributes:
        name: of the AP.
        color: of the AP.
        area, over: SVG paths: the load, and what of it is over capacity ("" if nothing).
        limit: SVG path of the capacity.
        limit_text: beside the line.
        limit_at: height of that text.
        x, y: ticks.
        left, right, top, bottom: of the plotting area.
    """

    name: str
    color: str
    area: str
    over: str
    limit: str
    limit_text: str
    limit_at: float
    x: tuple[Tick, ...]
    y: tuple[Tick, ...]
    left: float
    right: float
    top: float
    bottom: float


@dataclass(frozen=True)
class Row:
    """One robot's bar.

    Attributes:
        name: of the robot, shortened; `title` in full.
        y: middle of its row.
        boxes: its links.
        held: times it stood against its plan.
        handovers, arrival: marks.
    """

    name: str
    title: str
    y: float
    boxes: tuple[Box, ...]
    held: tuple[Box, ...]
    handovers: tuple[Mark, ...]
    arrival: tuple[Mark, ...]


@dataclass(frozen=True)
class BarChart:
    """Which AP served each robot over time; `changes` are instants that concern all."""

    rows: tuple[Row, ...]
    height: float
    x: tuple[Tick, ...]
    changes: tuple[Mark, ...]
    left: float
    right: float
    bottom: float
    font: float


def hex_color(index: int) -> str:
    """`#rrggbb` of the AP of that index."""
    return "#" + "".join(f"{round(255 * part):02x}" for part in ap_color(index))


def ink_on(color: str) -> str:
    """Black or white, whichever is read better on a colour (WCAG relative luminance)."""

    def linear(part: float) -> float:
        return part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4

    red, green, blue = (linear(int(color[i : i + 2], 16) / 255) for i in (1, 3, 5))
    luminance = 0.2126 * red + 0.7152 * green + 0.0722 * blue
    return "#000" if luminance > 0.18 else "#fff"


def steps_of(most: float, about: int) -> float:
    """A round step (1, 2 or 5 times a power of ten) that cuts `most` into about so many parts."""
    if not (math.isfinite(most) and most > 0):
        return 1.0
    raw = most / max(1, about)
    power = 10.0 ** math.floor(math.log10(raw))
    return next(power * k for k in (1, 2, 5, 10) if power * k >= raw * (1 - 1e-9))


def ticks(most: float, left: float, right: float, about: int) -> tuple[Tick, ...]:
    """Marks from 0 to `most` along an axis."""
    step = steps_of(most, about)
    count = int(most / step + 1e-9) if math.isfinite(most) else 0
    span = right - left
    return tuple(
        Tick(left + span * k * step / (most or 1), f"{k * step:g}") for k in range(count + 1)
    )


def load_chart(ap: ApStory, index: int, end_s: float, highest: int) -> LoadChart:
    """Load over time with the capacity as a line.

    Args:
        ap: whose.
        index: of the AP, for its colour.
        end_s: when the run ends [s].
        highest: load or capacity at the top of the chart, the same for all APs.
    """
    left, right, top, bottom = 34.0, LOAD_W - 8.0, 10.0, LOAD_H - 26.0
    end, highest = max(end_s, 1e-9), max(highest, 1)

    def x(t_s: float) -> float:
        return left + (right - left) * min(max(t_s / end, 0.0), 1.0)

    def y(robots: float) -> float:
        return bottom - (bottom - top) * min(robots / (highest * 1.05), 1.0)

    ends = [*(t for t, *_ in ap.loads[1:]), end_s]
    steps = [(t, u, load, m) for (t, load, m), u in zip(ap.loads, ends, strict=bool(ap.loads))]
    steps = _joined(steps)
    area = _outline([(x(t), x(u), y(load), y(0)) for t, u, load, _ in steps])
    over = _outline([(x(t), x(u), y(load), y(m)) for t, u, load, m in steps if load > m])
    limit = " ".join(
        f"{'M' if k == 0 else 'L'}{x(t):.1f} {y(m):.1f} H{x(u):.1f}"
        for k, (t, u, _, m) in enumerate(steps)
    )
    last = steps[-1][3] if steps else 0
    whole = int(steps_of(highest * 1.05, 4)) or 1
    marks = tuple(Tick(y(k), str(k)) for k in range(0, highest + 1, whole))
    return LoadChart(
        name=ap.name,
        color=hex_color(index),
        area=area,
        over=over,
        limit=limit,
        limit_text=f"capacity {last}",
        limit_at=y(last) - 4 if y(last) > top + 14 else y(last) + 13,
        x=ticks(end_s, left, right, 6),
        y=marks,
        left=left,
        right=right,
        top=top,
        bottom=bottom,
    )


def _joined(
    steps: Sequence[tuple[float, float, int, int]],
) -> list[tuple[float, float, int, int]]:
    """Neighbours of one load and capacity as one step."""
    joined: list[tuple[float, float, int, int]] = []
    for t, u, load, capacity in steps:
        if joined and joined[-1][2:] == (load, capacity):
            joined[-1] = (joined[-1][0], u, load, capacity)
        else:
            joined.append((t, u, load, capacity))
    return joined


def _outline(steps: Sequence[tuple[float, float, float, float]]) -> str:
    """SVG path of boxes from x to x', from y to y'; those without height are left out."""
    return "".join(
        f"M{a:.1f} {base:.1f} V{top:.1f} H{b:.1f} V{base:.1f} Z"
        for a, b, top, base in steps
        if top != base and b > a
    )


def bar_chart(
    robots: Sequence[RobotStory],
    aps: Sequence[str],
    end_s: float,
    changes: Sequence[tuple[float, str]] = (),
) -> BarChart:
    """Bars of these robots, one row each; `changes` are times [s] and words that concern all."""
    height = 17.0 if len(robots) <= 20 else 13.0
    font = min(11.0, height - 3)
    left, right, top = 14 + _LABEL_CHARS * CHAR_W, BARS_W - 12, 4.0
    end = max(end_s, 1e-9)
    index = {name: k for k, name in enumerate(aps)}

    def x(t_s: float) -> float:
        return left + (right - left) * min(max(t_s / end, 0.0), 1.0)

    rows = []
    for row, robot in enumerate(robots):
        y0 = top + row * height
        middle, thick = y0 + height / 2, height - 4
        boxes = [
            _span_box(
                span,
                x(span.begin_s),
                x(span.end_s),
                y0 + 2,
                thick,
                index,
                named=not k or robot.spans[k - 1].ap != span.ap,
            )
            for k, span in enumerate(robot.spans)
        ]
        held = [
            Box(
                x(wait.begin_s),
                y0 + height - 4.5,
                max(x(wait.end_s) - x(wait.begin_s), 1.0),
                2.5,
                "#000",
                title=_wait_title(robot.name, wait.begin_s, wait.end_s, wait.waits_for),
            )
            for wait in robot.waits
        ]
        handovers = [
            Mark(
                x(h.t_s),
                middle,
                f"{robot.name}: handover {h.from_ap} to {h.to_ap} at {h.t_s:.1f} s"
                + ("" if h.planned else ", not in the plan"),
            )
            for h in robot.handovers
        ]
        arrival = robot.arrival_s
        there = (
            (Mark(x(arrival), middle, f"{robot.name}: at its goal at {arrival:.1f} s"),)
            if arrival is not None
            else ()
        )
        rows.append(
            Row(
                short(robot.name, _LABEL_CHARS),
                robot.name,
                middle,
                tuple(boxes),
                tuple(held),
                tuple(handovers),
                there,
            )
        )
    bottom = top + len(robots) * height
    marks = ticks(end_s, left, right, 10)
    lines = tuple(Mark(x(t_s), 0.0, words) for t_s, words in changes)
    return BarChart(tuple(rows), bottom + 34, marks, lines, left, right, bottom, font)


def _span_box(
    span: Span, a: float, b: float, y: float, h: float, index: dict[str, int], *, named: bool
) -> Box:
    """The box of a span; `named` where another AP begins to serve, whose name is written."""
    color = hex_color(index[span.ap]) if span.ap in index and not span.lost else ""
    served = f"served by {span.ap}" if span.ap else "no access point"
    state = f"no connection ({served})" if span.lost else served
    room = (b - a) >= CHAR_W * len(span.ap) + TEXT_SHIFT + 4
    return Box(
        a,
        y,
        max(b - a, 1.2 if span.lost else 0.2),
        h,
        color,
        text=span.ap if named and room and not span.lost else "",
        ink=ink_on(color) if color else "#000",
        title=f"{state} from {span.begin_s:.1f} to {span.end_s:.1f} s",
    )


def _wait_title(name: str, begin_s: float, end_s: float, waits_for: str) -> str:
    whom = f" for {waits_for}" if waits_for else ""
    return f"{name}: waits{whom} against its plan from {begin_s:.1f} to {end_s:.1f} s"


def short(text: str, most: int) -> str:
    """A text cut to so many characters."""
    return text if len(text) <= most else text[: most - 1] + "…"
