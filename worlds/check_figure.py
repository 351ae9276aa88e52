"""The picture of a check: the hall from above, each finding marked where it is."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from worlds.check import CheckReport, Finding
from worlds.check_codes import CODES, severity
from worlds.figures import draw_coverage_count, draw_hall
from worlds.floor import Boxes, Floor
from worlds.generate import boxes_of

_MARKS = ("o", "s", "D", "v", "P", "X", "p", "h", "<", ">", "*", "d")
_COLOURS = {
    # Okabe and Ito's colours, told apart with any colour vision; severities differ in hue.
    "error": ("#D55E00", "#A50026"),
    "warning": ("#E69F00", "#CC79A7", "#F0E442"),
    "note": ("#56B4E9", "#0072B2"),
}
MAX_COUNTS = 6

_PAGE_IN2 = 60.0
_LEGEND_IN = 4.6


def check_figure(report: CheckReport) -> Figure:
    """Coverage in the background (how many APs reach a place), findings as marks, codes beside.

    Findings without a place are in the list beside the hall only.
    """
    world, floor = report.world, report.floor
    width, depth = world.hall.size_m
    aspect = min(max(depth / width, 0.25), 2.5)
    across = min(max(math.sqrt(_PAGE_IN2 / aspect), 5.0), 13.0)
    size = (across + _LEGEND_IN, min(max(across * aspect + 1.5, 4.5), 14.0))
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    ax, side = figure.subplots(1, 2, width_ratios=[across, _LEGEND_IN])
    side.set_axis_off()
    ax.set_anchor("N")
    ground: list[Patch] = []
    if floor is not None and report.radio_map is not None:
        mesh = draw_coverage_count(ax, floor, report.radio_map)
        mesh.set_alpha(0.55)
        for count in sorted(set(report.radio_map.coverage_count.tolist()) - {0})[:MAX_COUNTS]:
            many = f"{count} access point{'s' if count != 1 else ''}"
            colour = mesh.to_rgba(np.array([count]), alpha=0.55)[0]
            ground.append(Patch(fc=colour, label=f"reached by {many}"))
    draw_hall(ax, world, floor if floor is not None else _only_boxes(report))

    handles: list[Line2D | Patch] = []
    used = {kind: 0 for kind in _COLOURS}
    # A mark fits its cell, so that marks on all cells of an area do not run into each other.
    cell_pt = world.hall.grid_pitch_m / width * across * 72
    size_pt = min(max(0.45 * cell_pt, 2.2), 8.0)
    for code, found in _by_code(report).items():
        kind = severity(code)
        colours = _COLOURS[kind]
        number = used[kind]
        used[kind] += 1
        colour, mark = colours[number % len(colours)], _MARKS[number % len(_MARKS)]
        xy = np.array([place for f in found for place in f.places_m]).reshape(-1, 2)
        label = f"{code} {CODES[code].title}" + (f" ({len(found)})" if len(found) > 1 else "")
        if not len(xy):
            handles.append(Patch(fc="white", ec=colour, lw=1.2, label=f"{label}: see the list"))
            continue
        inside = np.clip(xy, [0.0, 0.0], [width, depth])  # what is outside is drawn at the wall
        ax.plot(
            inside[:, 0],
            inside[:, 1],
            ls="none",
            marker=mark,
            ms=max(size_pt, 9.0) if kind == "error" else size_pt,
            mfc=colour if kind == "error" else "none",
            mec=colour,
            mew=min(1.6, size_pt / 3),
            zorder=8 if kind == "error" else 7.5,
            clip_on=False,
        )
        handles.append(
            Line2D(
                [], [], ls="none", marker=mark, ms=8, mew=1.6, label=label, mec=colour,
                mfc=colour if kind == "error" else "none",
            )
        )  # fmt: skip
    if handles:
        side.legend(
            handles=[*handles, *ground],
            loc="upper left",
            frameon=False,
            fontsize=9,
            borderaxespad=0.0,
        )
    figure.suptitle(_headline(report), weight="bold", size=12)
    return figure


def _headline(report: CheckReport) -> str:
    counts = [(report.count(kind), kind) for kind in _COLOURS]
    said = ", ".join(f"{n} {kind}{'s' if n != 1 else ''}" for n, kind in counts)
    ground = " (hatched: no coverage)" if report.radio_map is not None else ""
    return f"{report.world.name}: {said}{ground}"


def _by_code(report: CheckReport) -> dict[str, list[Finding]]:
    found: dict[str, list[Finding]] = {}
    for finding in report.findings:
        found.setdefault(finding.code, []).append(finding)
    return found


def _only_boxes(report: CheckReport) -> Floor:
    """A floor without positions, for a hall in which there are none."""
    boxes: Boxes = boxes_of(report.world)
    none = np.empty(0, dtype=np.int32)
    return Floor(
        pitch_m=report.world.hall.grid_pitch_m,
        slot_s=report.world.hall.grid_slot_s,
        columns=0,
        rows=0,
        boxes=boxes,
        vertex_xy_m=np.empty((0, 2)),
        vertex_cell=np.empty((0, 2), dtype=np.int32),
        edge_uv=np.empty((0, 2), dtype=np.int32),
        edge_slots=none,
        edge_oneway=np.empty(0, dtype=np.bool_),
        robot_ids=(),
        start=none,
        goal=none,
    )
