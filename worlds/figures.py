"""Pictures of a hall and its radio map: seen from above, axes in metres.

Colours are those that people with a colour vision deficiency tell apart (viridis, YlGnBu), and what
matters most, the lack of coverage, is hatched besides. Only files are drawn, no windows.
"""

from __future__ import annotations

import math
import os
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.colors import BoundaryNorm, Colormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch, Rectangle
from matplotlib.path import Path as Outline
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from worlds.errors import Fault, WorldError
from worlds.floor import Boxes, Floor
from worlds.radio_map import RadioMap
from worlds.world import World

MAX_AP_PANELS = 6
"""APs that get a panel of their own in `radio_figure`."""

SUFFIXES = (".png", ".svg")

_GROUND, _OBSTACLE, _INK = "#ececec", "#5a5a5a", "#111111"
_PANEL_IN2 = 13.0  # drawing area of a panel [square inches]


def draw_hall(
    ax: Axes, world: World, floor: Floor, *, highlight: str | None = None, names: bool = False
) -> None:
    """Walls, obstacles and access points of a hall.

    Args:
        ax: where to draw; its limits and labels are set.
        world: for the walls and the APs; those switched off are hollow.
        floor: for the obstacles.
        highlight: id of an AP to mark among the others.
        names: write the names of the listed obstacles on them.
    """
    width, depth = world.hall.size_m
    ax.add_patch(Rectangle((0, 0), width, depth, fill=False, ec=_INK, lw=1.2, zorder=4))
    corners = footprints_m(floor.boxes)
    if len(corners):
        ax.add_collection(PolyCollection(list(corners), fc=_OBSTACLE, ec="white", lw=0.3, zorder=3))
    if names:
        for index in range(len(world.obstacle)):
            x, y = floor.boxes.center_m[index, :2]
            _write(ax, x, y, floor.boxes.name[index], size=7, ha="center", va="center")
    span = max(width, depth)
    for ap in world.ap:
        x, y, _ = ap.position_m
        chosen = ap.id == highlight
        ax.plot(
            x,
            y,
            marker="*" if chosen else "^",
            ms=13 if chosen else 8,
            mfc="white" if ap.enabled else "none",
            mec=_INK,
            mew=1.2,
            ls="none",
            zorder=6,
        )
        if highlight is None or chosen:
            right = x > 0.8 * width  # keep the label within the walls
            shift = -0.025 * span if right else 0.025 * span
            label = ap.id if ap.enabled else f"{ap.id} (off)"
            _write(ax, x + shift, y, label, size=9, ha="right" if right else "left", va="center")
    ax.set_xlim(-0.02 * span, width + 0.02 * span)
    ax.set_ylim(-0.02 * span, depth + 0.02 * span)
    ax.set_aspect("equal")
    ax.set_xlabel("x [m]")
    ax.set_ylabel("y [m]")


def draw_coverage(
    ax: Axes,
    floor: Floor,
    radio_map: RadioMap,
    *,
    ap: int | None = None,
    norm: Normalize | None = None,
) -> QuadMesh:
    """SNR at the vertices as cells of the grid; cells below the threshold are hatched.

    Args:
        ax: where to draw.
        floor: the one the map was made for.
        radio_map: the map.
        ap: index of an AP; the best one of each vertex when left out.
        norm: of the colours, to share them among panels; `snr_norm(radio_map)` when left out.

    Returns:
        The coloured cells, for a colour bar.
    """
    snr = radio_map.ranked_snr_db(1) if ap is None else radio_map.snr_db[:, ap]
    mesh = _draw_cells(ax, floor, snr, "viridis", norm or snr_norm(radio_map))
    _hatch(ax, floor, snr < radio_map.threshold_db, "white")
    return mesh


def draw_coverage_count(ax: Axes, floor: Floor, radio_map: RadioMap) -> QuadMesh:
    """How many APs cover each vertex (k-coverage); uncovered cells are hatched."""
    count = radio_map.coverage_count
    most = max(1, len(radio_map.ap_ids))
    colours = mpl.colormaps["YlGnBu"].resampled(most + 1)
    norm = BoundaryNorm(np.arange(most + 2) - 0.5, most + 1)
    mesh = _draw_cells(ax, floor, count.astype(np.float64), colours, norm)
    _hatch(ax, floor, count == 0, _INK)
    return mesh


def snr_norm(radio_map: RadioMap) -> Normalize:
    """Colour limits for all SNR of a map: multiples of 5 dB, the threshold among them."""
    threshold = radio_map.threshold_db
    snr = radio_map.snr_db if radio_map.snr_db.size else np.array([threshold])
    low = max(float(np.percentile(snr, 1)), threshold - 30)
    high = min(float(np.percentile(snr, 99.5)), threshold + 60)
    return Normalize(
        5 * math.floor(min(low, threshold - 5) / 5), 5 * math.ceil(max(high, threshold + 5) / 5)
    )


def radio_figure(world: World, floor: Floor, radio_map: RadioMap) -> Figure:
    """Heat maps of the APs, best SNR, and k-coverage on one page.

    Of more than `MAX_AP_PANELS` APs those that cover least are shown, and the title says so.
    """
    shown = _weakest(radio_map)
    panels = len(shown) + 2
    width, depth = world.hall.size_m
    columns = _columns(panels, width / depth)
    rows = math.ceil(panels / columns)
    panel_w = min(max(math.sqrt(_PANEL_IN2 * width / depth), 2.8), 6.5)
    panel_h = min(max(panel_w * depth / width, 0.9), 6.5)
    size = (columns * panel_w + 2.2, rows * (panel_h + 0.62) + 0.5)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    norm = snr_norm(radio_map)

    for ax, ap in zip(axes, shown, strict=False):
        draw_coverage(ax, floor, radio_map, ap=ap, norm=norm)
        draw_hall(ax, world, floor, highlight=radio_map.ap_ids[ap])
        share = radio_map.covered[:, ap].mean() if len(radio_map.snr_db) else 0.0
        ax.set_title(f"{radio_map.ap_ids[ap]} covers {share:.1%}")
    best, count = axes[len(shown) : panels]
    snr = draw_coverage(best, floor, radio_map, norm=norm)
    best.set_title(f"best AP: {radio_map.covered_share():.1%} covered")
    aps = draw_coverage_count(count, floor, radio_map)
    count.set_title(f"{radio_map.covered_share(2):.1%} covered by two APs or more")
    for ax in (best, count):
        draw_hall(ax, world, floor)
    for place, ax in enumerate(axes):
        if place >= panels:
            ax.set_axis_off()
        if place + columns < panels:
            ax.set_xlabel("")
        if place % columns:
            ax.set_ylabel("")

    # The bar of the last panel first: it stands next to it.
    bar = figure.colorbar(aps, ax=axes, shrink=0.9, aspect=40, pad=0.01)
    bar.set_label("APs that cover the place (last panel)")
    bar.set_ticks(range(0, len(radio_map.ap_ids) + 1, 1 + len(radio_map.ap_ids) // 10))
    bar = figure.colorbar(snr, ax=axes, extend="both", shrink=0.9, aspect=40, pad=0.02)
    bar.set_label("SNR [dB] (other panels; line: threshold)")
    bar.ax.axhline(radio_map.threshold_db, color="white", lw=3)
    bar.ax.axhline(radio_map.threshold_db, color=_INK, lw=1.5)
    figure.suptitle(_headline(world, radio_map, shown), weight="bold", size=13)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure; its name's ending, .png or .svg, says how.

    The same figure gives the same bytes: no date, no version, fixed ids.

    Raises:
        WorldError: another ending, or a place that cannot be written to.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        message = f"{path} ends in {suffix or 'nothing'!r}; pictures are {' or '.join(SUFFIXES)}"
        raise WorldError([Fault((), message)])
    metadata = {"Date": None} if suffix == ".svg" else {"Software": None}
    part = path.with_name(path.name + ".part")
    try:
        with mpl.rc_context({"svg.hashsalt": "mapp"}), part.open("wb") as file:
            figure.savefig(file, format=suffix[1:], dpi=150, metadata=metadata)
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        message = f"{path} cannot be written: {error.strerror or error}"
        raise WorldError([Fault((), message)]) from error


def footprints_m(boxes: Boxes) -> NDArray[np.float64]:
    """(B, 4, 2) corners of the boxes seen from above, counter-clockwise [m]."""
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    local = signs * boxes.half_m[:, None, :2]
    cos, sin = np.cos(boxes.yaw_rad)[:, None], np.sin(boxes.yaw_rad)[:, None]
    x, y = local[..., 0], local[..., 1]
    turned = np.stack((cos * x - sin * y, sin * x + cos * y), axis=-1)
    return np.asarray(turned + boxes.center_m[:, None, :2])


def _draw_cells(
    ax: Axes, floor: Floor, value: NDArray[np.float64], colours: str | Colormap, norm: Normalize
) -> QuadMesh:
    """A value per vertex as coloured cells; blocked positions stay ground."""
    ax.set_facecolor(_GROUND)
    grid = floor.vertex_grid()
    cells = np.ma.masked_where(grid < 0, np.append(value, 0.0)[grid])
    first = _first_m(floor)
    x, y = (
        first[axis] + floor.pitch_m * (np.arange(count + 1) - 0.5)
        for axis, count in enumerate((floor.columns, floor.rows))
    )
    return ax.pcolormesh(x, y, cells, cmap=colours, norm=norm, rasterized=True, zorder=1)


def _hatch(ax: Axes, floor: Floor, chosen: NDArray[np.bool_], colour: str) -> None:
    """Hatch the cells of the chosen vertices, all as one shape."""
    low = floor.vertex_xy_m[chosen] - floor.pitch_m / 2
    if not len(low):
        return
    steps = floor.pitch_m * np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)])
    corners = (low[:, None] + steps).reshape(-1, 2)
    codes = np.tile([Outline.MOVETO, *[Outline.LINETO] * 3, Outline.CLOSEPOLY], len(low))
    shape = Outline(corners, codes)
    ax.add_patch(PathPatch(shape, fc="none", ec=colour, hatch="////", lw=0, zorder=2))


def _first_m(floor: Floor) -> NDArray[np.float64]:
    """(2,) the place of grid position (0, 0) [m]."""
    if not len(floor.vertex_xy_m):
        return np.zeros(2)
    return np.asarray(floor.vertex_xy_m[0] - floor.pitch_m * floor.vertex_cell[0])


def _weakest(radio_map: RadioMap) -> list[int]:
    """The APs that get a panel, in the world's order."""
    order = np.argsort(radio_map.covered.sum(axis=0), kind="stable")
    return sorted(order[:MAX_AP_PANELS].tolist())


def _columns(panels: int, aspect: float) -> int:
    """How many panels of that width : height stand side by side on a page of about 3 : 2.

    An empty place is worth avoiding at the price of a page twice as wide or high.
    """

    def cost(columns: int) -> float:
        page = columns**2 * aspect / panels
        return abs(math.log(page / 1.5)) + 0.7 * (-panels % columns)

    return min(range(1, min(panels, 4) + 1), key=cost)


def _headline(world: World, radio_map: RadioMap, shown: list[int]) -> str:
    """Name of the world and how to read the picture."""
    aps = len(radio_map.ap_ids)
    which = f", the {len(shown)} of {aps} APs that cover least" if len(shown) < aps else ""
    reading = f"hatched: SNR below {radio_map.threshold_db:g} dB, not covered"
    return f"{world.name}: radio map{which} ({reading})"


def _write(ax: Axes, x: float, y: float, text: str, *, size: int, ha: str, va: str) -> None:
    """Text that is readable on any ground."""
    halo = [withStroke(linewidth=2.5, foreground="white")]
    ax.text(
        x,
        y,
        text,
        size=size,
        ha=ha,
        va=va,
        color=_INK,
        weight="bold",
        path_effects=halo,
        clip_on=True,
        zorder=7,
    )
