"""The picture of a run: the hall from above, who drove where, and which AP served him.

Everything is drawn from the log alone. Paths that share an aisle are drawn side by side, as lines
of a metro map are: each robot's is shifted by its own small, fixed amount.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import NDArray

from logs.colors import OUTAGE_COLOR, ap_color, rgb
from logs.errors import LogError
from logs.mcap_reader import RunFile
from logs.records import LINKS, NO_AP, OUTAGE, ApKpi, Handover, Kpi, Record, RunStart, Sample
from worlds.events import Event
from worlds.figures import draw_coverage_count, draw_hall, save
from worlds.floor import Floor
from worlds.world import World

LANES_SHARE = 0.17
"""Paths are shifted by at most this share of the pitch, to either side."""
MAX_APS_IN_LEGEND = 10
MAX_NAMES = 15
"""The names of more robots than this would hide their ways."""
MAX_ENDS = 150
"""Starts and goals of more robots than this would hide the hall."""
_EDGE_IN = 0.12  # free at each edge of the picture
_AXIS_IN = 1.0  # left of the hall, and free at the right
_CHARACTERS_PER_IN = 10.5  # of a title
_GOLDEN = 0.618_033_988_749_895
_NO_LINK = {LINKS.index(OUTAGE), LINKS.index(NO_AP)}
_INK, _COVERED = "#111111", "#c3d9ea"

Line = NDArray[np.float64]


@dataclass
class Trace:
    """What the samples say of one robot.

    Attributes:
        xy_m: its places in the order of time [m].
        ap: index of its serving AP at each, −1 for none.
        lost: whether it had no connection there.
    """

    xy_m: list[tuple[float, float]] = field(default_factory=list)
    ap: list[int] = field(default_factory=list)
    lost: list[bool] = field(default_factory=list)

    def add(self, place: tuple[float, float], ap: int, lost: bool) -> None:
        """The next place; one that only lengthens a straight line takes the last one's place."""
        if len(self.xy_m) > 1 and (self.ap[-2:], self.lost[-2:]) == ([ap] * 2, [lost] * 2):
            (ax, ay), (bx, by) = self.xy_m[-2:]
            turn = (bx - ax) * (place[1] - by) - (by - ay) * (place[0] - bx)
            ahead = (bx - ax) * (place[0] - bx) + (by - ay) * (place[1] - by)
            if abs(turn) < 1e-9 and (ahead > 0 or place == self.xy_m[-1]):
                self.xy_m[-1] = place
                return
        self.xy_m.append(place)
        self.ap.append(ap)
        self.lost.append(lost)


def draw_run(run: RunFile, path: Path) -> None:
    """Draw the hall, its coverage, the paths driven and the handovers to a .png or .svg file.

    Raises:
        LogError: the log lacks what is drawn.
        WorldError: the file cannot be written.
    """
    save(run_figure(run), path)


def run_figure(run: RunFile) -> Figure:
    """The picture of a run as a matplotlib figure."""
    world, floor = run.world, run.floor
    start, traces, handovers, kpi, ap_kpis = _read(run)
    width, depth = world.hall.size_m
    size = _size(width, depth, len(start.aps))
    figure = Figure(figsize=size, layout=ConstrainedLayoutEngine(w_pad=_EDGE_IN, h_pad=_EDGE_IN))
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    ax.set_anchor("NW")

    shades = draw_ground(ax, run)
    _draw_blockages(ax, world)
    _draw_paths(ax, floor, traces, start)
    if len(traces) <= MAX_ENDS:
        _draw_ends(ax, floor, traces, start.robots)
    _draw_handovers(ax, floor, handovers)
    draw_aps(ax, world, start.aps)

    ax.set_title(_wrapped(_title(world, run, kpi), size[0]), loc="left", size=12)
    ax.grid(False)
    counts = run.radio_map.coverage_count
    coverage = _coverage_keys(counts, shades)
    blocked = bool(blockages_of(world))
    _legend(ax, floor, start, ap_kpis, coverage, traces, handovers, blocked)
    return figure


def draw_ground(ax: Axes, run: RunFile) -> list[tuple[float, float, float]]:
    """The hall on pale blues: how many APs cover each place; the colours of 0, 1, … APs."""
    floor = run.floor
    mesh = draw_coverage_count(ax, floor, run.radio_map)
    shades = _shades(len(run.radio_map.ap_ids))
    mesh.set_cmap(ListedColormap(shades))
    draw_hall(ax, run.world, floor)
    return shades


def _size(width_m: float, depth_m: float, aps: int) -> tuple[float, float]:
    """Inches: the longer side of the hall takes 8, the legend stands to the right."""
    scale = 8.0 / max(width_m, depth_m)
    rows = min(aps, MAX_APS_IN_LEGEND + 1) + 9  # at most, of the legend
    return max(width_m * scale, 2.0) + 4.4, max(depth_m * scale, rows * 0.22) + 1.2


def _read(
    run: RunFile,
) -> tuple[RunStart, dict[int, Trace], list[Handover], Kpi | None, list[ApKpi]]:
    """One pass over the records that are drawn."""
    start: RunStart | None = None
    traces: dict[int, Trace] = {}
    handovers: list[Handover] = []
    kpi: Kpi | None = None
    ap_kpis: list[ApKpi] = []
    wanted: tuple[type[Record], ...] = (RunStart, Sample, Handover, Kpi, ApKpi)
    for record in run.iter_records(wanted):
        match record:
            case RunStart():
                start = record
            case Sample():
                _add_sample(traces, record)
            case Handover():
                handovers.append(record)
            case Kpi():
                kpi = record
            case ApKpi():
                ap_kpis.append(record)
            case _:
                pass
    if start is None:
        raise LogError(f"{run.path}: holds no run (no {RunStart.__name__}); run the world again")
    return start, traces, handovers, kpi, ap_kpis


def _add_sample(traces: dict[int, Trace], sample: Sample) -> None:
    columns = (sample.robot, sample.x_m, sample.y_m, sample.ap, sample.link)
    for robot, x, y, ap, link in zip(*columns, strict=True):
        traces.setdefault(robot, Trace()).add((x, y), ap, link in _NO_LINK)


# --- layers -------------------------------------------------------------------------------------


def _shades(aps: int) -> list[tuple[float, float, float]]:
    """Pale blues for 0 … `aps` covering APs: the more, the deeper; none is white (and hatched)."""
    depth = np.linspace(0.25, 1.0, max(aps, 1))[:, None]
    blues = 1.0 - depth * (1.0 - np.array(rgb(_COVERED)))
    return [(1.0, 1.0, 1.0), *(tuple(blue) for blue in blues.tolist())]


def lane_m(robot: int, pitch_m: float) -> float:
    """How far the path of a robot is shifted, in x and in y [m]: even over the robots."""
    return ((robot * _GOLDEN) % 1.0 - 0.5) * 2 * LANES_SHARE * pitch_m


def strokes(trace: Trace) -> list[tuple[int, Line]]:
    """A trace as (AP, polyline) pieces, cut where the AP changes, without points in between.

    A piece begins where the one before it ends.
    """
    xy = np.array(trace.xy_m)
    ap = np.array(trace.ap)
    # Segment k goes from place k to k+1 and has the AP at its end, where a handover is done.
    cuts = (np.flatnonzero(np.diff(ap[1:])) + 1).tolist()
    pieces = []
    for first, last in zip([0, *cuts], [*cuts, len(ap) - 1], strict=True):
        if last > first:
            pieces.append((int(ap[last]), _corners(xy[first : last + 1])))
    return pieces


def _corners(line: Line) -> Line:
    """A polyline without repeated places and without places on a straight line."""
    moved = np.any(np.diff(line, axis=0) != 0, axis=1)
    line = line[np.concatenate([[True], moved])]
    if len(line) < 3:
        return line
    step = np.diff(line, axis=0)
    turn = step[:-1, 0] * step[1:, 1] - step[:-1, 1] * step[1:, 0]
    back = (step[:-1] * step[1:]).sum(axis=1) < 0
    return np.asarray(line[np.concatenate([[True], (np.abs(turn) > 1e-9) | back, [True]])])


def _draw_paths(ax: Axes, floor: Floor, traces: dict[int, Trace], start: RunStart) -> None:
    thick = 1.7 if len(traces) <= 60 else 1.0
    halo = [Stroke(linewidth=thick + 1.2, foreground="white", alpha=0.75), Normal()]
    lost = []
    for robot, trace in sorted(traces.items()):
        lane = lane_m(robot, floor.pitch_m)
        pieces = strokes(trace)
        ax.add_collection(
            LineCollection(
                [line + lane for _, line in pieces],
                colors=[ap_color(ap) if ap >= 0 else OUTAGE_COLOR for ap, _ in pieces],
                linewidths=thick,
                capstyle="round",
                joinstyle="round",
                path_effects=halo,
                zorder=4,
            )
        )
        xy = np.array(trace.xy_m) + lane
        ends = np.flatnonzero(np.array(trace.lost[:-1], dtype=np.bool_))
        lost += [xy[k : k + 2] for k in ends.tolist()]
    if lost:
        ax.add_collection(
            LineCollection(lost, colors=OUTAGE_COLOR, linewidths=thick + 1.6, zorder=5)
        )


def _draw_ends(ax: Axes, floor: Floor, traces: dict[int, Trace], names: Sequence[str]) -> None:
    """Starts as rings, with the robots' names where there are few, and goals as squares."""
    lanes = np.array([[lane_m(robot, floor.pitch_m)] for robot in sorted(traces)])
    for at, style in ((0, _START), (-1, _GOAL)):
        places = np.array([traces[robot].xy_m[at] for robot in sorted(traces)]) + lanes
        ax.plot(*places.T, **style, zorder=6)
        if at == 0 and len(traces) <= MAX_NAMES:
            for robot, place in zip(sorted(traces), places.tolist(), strict=True):
                ax.annotate(
                    names[robot],
                    place,
                    xytext=(6, 5),
                    textcoords="offset points",
                    size=8.5,
                    path_effects=[Stroke(linewidth=2.5, foreground="white"), Normal()],
                    zorder=7,
                )


_START: dict[str, Any] = {
    "marker": "o",
    "ls": "none",
    "ms": 4.5,
    "mfc": "white",
    "mec": _INK,
    "mew": 1.0,
}
_GOAL: dict[str, Any] = {
    "marker": "s",
    "ls": "none",
    "ms": 4.2,
    "mfc": _INK,
    "mec": "white",
    "mew": 0.5,
}
_HANDOVER: dict[str, Any] = {
    "marker": "D",
    "ls": "none",
    "ms": 9.5,
    "mfc": "white",
    "mec": _INK,
    "mew": 1.3,
}
_BLOCKAGE: dict[str, Any] = {"fc": "#fde0c5", "ec": "#d95f02", "lw": 1.5, "ls": "--", "hatch": "xx"}
_AP: dict[str, Any] = {"marker": "^", "ls": "none", "ms": 15, "mec": _INK, "mew": 1.4}


def handover_places(
    handovers: Sequence[Handover], pitch_m: float
) -> list[tuple[float, float, int]]:
    """Where handovers happened: (x [m], y [m], how many).

    Those nearer than half a pitch to a place are counted there, so that marks do not overlap.
    """
    places: list[list[tuple[float, float]]] = []
    for here in sorted((h.x_m, h.y_m) for h in handovers):
        near = [p for p in places if math.dist(here, p[0]) < pitch_m / 2]
        if near:
            near[0].append(here)
        else:
            places.append([here])
    return [(*np.mean(place, axis=0).tolist(), len(place)) for place in places]


def _draw_handovers(ax: Axes, floor: Floor, handovers: Sequence[Handover]) -> None:
    for x, y, count in handover_places(handovers, floor.pitch_m):
        ax.plot(x, y, **_HANDOVER, zorder=7)
        if count > 1:
            ax.text(x, y, str(count), size=7, ha="center", va="center_baseline", zorder=8)


def draw_aps(ax: Axes, world: World, aps: Sequence[str], size: float = 15.0) -> None:
    """Those APs of a world that take part, in their colours."""
    for ap in world.ap:
        if ap.id in aps:
            color = ap_color(aps.index(ap.id))
            ax.plot(*ap.position_m[:2], **_AP | {"ms": size}, mfc=color, zorder=7)


def _draw_blockages(ax: Axes, world: World) -> None:
    """Where the world has blockages for a time: their outlines, or the ways they drive."""
    for event in blockages_of(world):
        if event.center_m is not None and event.size_m is not None:
            corners = rectangle_m(*event.center_m, *event.size_m, math.radians(event.yaw_deg))
            ax.add_patch(Polygon(corners, closed=True, **_BLOCKAGE, zorder=3.5))
        else:
            ax.plot(*np.array(event.way_m).T, color=_BLOCKAGE["ec"], ls="--", lw=2, zorder=3.5)


def blockages_of(world: World) -> list[Event]:
    """The events of a world that block ways."""
    return [event for event in world.event if event.kind == "blockage"]


def rectangle_m(x: float, y: float, length: float, width: float, yaw_rad: float) -> Line:
    """(4, 2) corners of a rectangle about (x, y), `length` along its turn [m]."""
    local = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (length / 2, width / 2)
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.asarray(local @ np.array([[cos, sin], [-sin, cos]]) + (x, y))


# --- words --------------------------------------------------------------------------------------


def _title(world: World, run: RunFile, kpi: Kpi | None) -> str:
    """What was run and how it went, in two lines."""
    plan = run.plan
    title = f"{world.name}: {len(plan.robot_ids)} robots, {len(run.radio_map.ap_ids)} access points"
    cost = f"plan cost {plan.cost}"
    if plan.status == "optimal":
        cost += " (optimal)"
    elif plan.gap is not None:
        # Rounded up: the words never promise more than is proven.
        cost += f" (at most {math.ceil(1000 * plan.gap - 1e-9) / 10:.1f} % above the optimum)"
    if kpi is None:
        return f"{title}\n{cost}"
    arrived = f"{kpi.arrived} arrived by slot {kpi.makespan_slots}"
    return f"{title}\n{cost}, {kpi.handovers} handovers, {arrived}"


def _coverage_keys(
    counts: NDArray[np.int32], shades: list[tuple[float, float, float]]
) -> list[tuple[Patch, str]]:
    """Patches for how many APs cover a place: the numbers that occur, at most five."""
    present = np.unique(counts).tolist()
    if len(present) > 5:
        present = [*present[:2], present[len(present) // 2], present[-1]]
    keys = []
    for n in present:
        hatch = "////" if n == 0 else None
        words = "no coverage" if n == 0 else f"covered by {n} AP{'s' if n > 1 else ''}"
        keys.append((Patch(fc=shades[n], ec=_INK, lw=0.4, hatch=hatch), words))
    return keys


def _wrapped(title: str, width_in: float) -> str:
    """The lines of a title, broken where they would run out of a picture of this width."""
    columns = max(20, int((width_in - _AXIS_IN) * _CHARACTERS_PER_IN))
    return "\n".join(part for line in title.split("\n") for part in textwrap.wrap(line, columns))


def _legend(
    ax: Axes,
    floor: Floor,
    start: RunStart,
    ap_kpis: list[ApKpi],
    coverage: list[tuple[Patch, str]],
    traces: dict[int, Trace],
    handovers: Sequence[Handover],
    blocked: bool,
) -> None:
    """Everything in the picture, in words, to the right of it and below its title."""
    peaks = {kpi.ap: kpi.peak_load for kpi in ap_kpis}
    keys: list[tuple[object, str]] = []
    for index, (ap, capacity) in enumerate(zip(start.aps, start.ap_capacity, strict=True)):
        if index == MAX_APS_IN_LEGEND:
            keys.append((Line2D([], [], ls="none"), f"… and {len(start.aps) - index} more APs"))
            break
        color = ap_color(index)
        pair = (Line2D([], [], color=color, lw=2.5), Line2D([], [], **_AP | {"ms": 9}, mfc=color))
        peak = f" (up to {peaks[ap]} of {capacity})" if ap in peaks else ""
        keys.append((pair, f"served by {ap}{peak}"))
    if any(any(trace.lost) for trace in traces.values()):
        keys.append((Line2D([], [], color=OUTAGE_COLOR, lw=4), "no connection"))
    if handovers:
        times = [count for *_, count in handover_places(handovers, floor.pitch_m)]
        words = "handover" + (" (number: how many)" if max(times) > 1 else "")
        keys.append((Line2D([], [], **_HANDOVER | {"ms": 8}), words))
    if len(traces) <= MAX_ENDS:
        keys.append((Line2D([], [], **_START), "start of a robot"))
        keys.append((Line2D([], [], **_GOAL), "goal of a robot"))
    keys.append((Patch(fc="#5a5a5a"), "obstacle"))
    if blocked:
        keys.append((Patch(**_BLOCKAGE), "blockage, for a time"))
    keys += coverage
    handles, labels = zip(*keys, strict=True)
    ax.legend(
        handles,
        labels,
        loc="upper left",
        bbox_to_anchor=(1.0, 1.0),
        borderaxespad=0.8,
        frameon=False,
        handler_map={tuple: HandlerTuple(ndivide=None)},
        handlelength=2.6,
        labelspacing=0.7,
    )
