"""The report of a run: one HTML file that opens from an e-mail, without network and scripts.

Everything in it is computed from the log. The same log gives the same bytes: no date enters. The
page says to the browser that it may load nothing (Content-Security-Policy), and whatever a world
calls its robots stays text (Jinja's autoescape).
"""

from __future__ import annotations

import base64
import math
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from logs.charts import ROBOTS_PER_CHART, TEXT_SHIFT, bar_chart, hex_color, ink_on, load_chart
from logs.colors import OUTAGE_COLOR
from logs.errors import LogError, in_a_sentence
from logs.mcap_format import VERSIONS_METADATA
from logs.report_data import MAX_EVENTS, RobotStory, RunStory, tell
from logs.report_words import (
    CAUSE_WORDS,
    EVENT_WORDS,
    changes,
    comparisons,
    duration,
    headline,
    sentences,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from logs.mcap_reader import RunFile

OnStep = Callable[[str], None]

TEMPLATES = Path(__file__).parent / "templates"
WORST = 12
"""Robots in the tables of waits and of lost connections."""
_DPI = 130


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture in the page: a `data:` address, and what it shows in words."""

    source: str
    alt: str


def write_report(run: RunFile, path: Path, *, on_step: OnStep | None = None) -> None:
    """Write the report of a run to a file, whole or not at all.

    Raises:
        LogError: the log lacks what is told, or the file cannot be written.
    """
    text = report_html(run, on_step=on_step)
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text, encoding="utf-8")
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise LogError(f"{path}: cannot be written: {error.strerror or error}") from error


def report_html(run: RunFile, *, on_step: OnStep | None = None) -> str:
    """The report as HTML text.

    Args:
        run: the log.
        on_step: told what is being done.

    Raises:
        LogError: the log is damaged or lacks what is told.
    """
    with in_a_sentence(run.path, "told"):
        return _html(run, on_step)


def _html(run: RunFile, on_step: OnStep | None) -> str:
    import jinja2

    step = on_step or (lambda _: None)
    step("reading the run")
    story = tell(run)
    step("drawing the hall")
    pictures = _pictures(run)
    step("writing the page")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["seconds"] = duration
    environment.filters["px"] = lambda value: f"{value:.1f}"
    return environment.get_template("report.html").render(_values(run, story, pictures))


def _values(run: RunFile, story: RunStory, pictures: dict[str, Picture]) -> dict[str, object]:
    """What the template draws."""
    world, start, kpi = run.world, story.start, story.kpi
    names = [ap.name for ap in story.aps]
    # One frame for all: the time until the last record, the highest load or capacity.
    end_s = max(story.end.t_s, 0.0)
    highest = max(
        (max(load, capacity) for ap in story.aps for _, load, capacity in ap.loads), default=1
    )
    groups = [
        story.robots[k : k + ROBOTS_PER_CHART]
        for k in range(0, len(story.robots), ROBOTS_PER_CHART)
    ]
    colors = {name: hex_color(k) for k, name in enumerate(names)}
    return {
        "world": world,
        "start": start,
        "end": story.end,
        "kpi": kpi,
        "good": story.end.verdict == "completed",
        "headline": headline(story),
        "sentences": sentences(run, story),
        "hall": pictures["hall"],
        "congestion": pictures.get("congestion"),
        "advice": run.plan.prices.advice if run.plan.prices else "",
        "loads": [load_chart(ap, k, end_s, highest) for k, ap in enumerate(story.aps)],
        "aps": story.aps,
        "bars": [bar_chart(group, names, end_s, changes(story)) for group in groups],
        "changes": changes(story),
        "text_shift": TEXT_SHIFT,
        "colors": colors,
        "inks": {name: ink_on(color) for name, color in colors.items()},
        "outage_color": OUTAGE_COLOR,
        "lost": _worst(story.robots, lambda r: r.kpi.outage_s if r.kpi else 0.0),
        "held": _worst(story.robots, lambda r: sum(w.end_s - w.begin_s for w in r.waits)),
        "comparisons": comparisons(run, story),
        "robots": story.robots,
        "events": story.events,
        "event_words": EVENT_WORDS,
        "cause_words": CAUSE_WORDS,
        "incidents": sorted(story.incidents.items()),
        "more_events": max(0, sum(story.incidents.values()) - MAX_EVENTS),
        "file": run.path.name,
        "hash": run.stored_hash or "none",
        "library": run.library,
        "versions": dict(run.metadata.get(VERSIONS_METADATA, {})),
        "seeds": {
            key.removeprefix("seed."): value
            for key, value in run.metadata.get("mapp-run", {}).items()
            if key.startswith("seed.")
        },
    }


def _worst(robots: Iterable[RobotStory], figure: Callable[[RobotStory], float]) -> list[RobotStory]:
    """The robots with the largest figures, those with none left out."""
    some = [(figure(robot), robot) for robot in robots]
    some = [pair for pair in some if math.isfinite(pair[0]) and pair[0] > 0]
    return [robot for _, robot in sorted(some, key=lambda pair: (-pair[0], pair[1].name))[:WORST]]


def _pictures(run: RunFile) -> dict[str, Picture]:
    """The hall, and where room is short if the plan has prices that say so."""
    from logs.congestion import congestion_figure
    from logs.figures import run_figure

    hall = "the hall from above with its coverage, the ways driven and the places of handovers"
    pictures = {"hall": Picture(_embedded(run_figure(run)), hall)}
    prices = run.plan.prices
    if prices is not None and prices.total > 0:
        figure = congestion_figure(run.problem, run.plan, (run.world, run.floor))
        words = "the hall from above with the positions and ways at which room is short"
        pictures["congestion"] = Picture(_embedded(figure), words)
    return pictures


def _embedded(figure: Figure) -> str:
    """A figure as the `data:` address of a PNG."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None})
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
