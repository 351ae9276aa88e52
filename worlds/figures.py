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

SUFFIXES = (".png", ".svg")

_GROUND, _OBSTACLE, _INK = "#ececec", "#5a5a5a", "#111111"


_NARROW = 0.4
"""Halls narrower than this share of their depth have no room for names beside the APs."""


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
    _draw_one_way(ax, floor)
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
            label = ap.id if ap.enabled else f"{ap.id} (off)"
            if width < _NARROW * span and 0.2 * width < x < 0.8 * width:
                up = 0.025 * span if y < 0.5 * depth else -0.025 * span
                side = "bottom" if y < 0.5 * depth else "top"
                _write(ax, x, y + up, label, size=9, ha="center", va=side)
                continue
            right = x > 0.8 * width  # keep the label within the walls
            shift = -0.025 * span if right else 0.025 * span
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
    mesh = draw_cells(ax, floor, snr, "viridis", norm or snr_norm(radio_map))
    hatch(ax, floor, snr < radio_map.threshold_db, "white")
    return mesh


def draw_coverage_count(ax: Axes, floor: Floor, radio_map: RadioMap) -> QuadMesh:
    """How many APs cover each vertex (k-coverage); uncovered cells are hatched."""
    return draw_count(ax, floor, radio_map.coverage_count, max(1, len(radio_map.ap_ids)))


def draw_count(ax: Axes, floor: Floor, count: NDArray[np.integer], most: int) -> QuadMesh:
    """A number per vertex (V,), 0 … `most`, in steps of colour; cells with 0 are hatched."""
    colours = mpl.colormaps["YlGnBu"].resampled(most + 1)
    norm = BoundaryNorm(np.arange(most + 2) - 0.5, most + 1)
    mesh = draw_cells(ax, floor, count.astype(np.float64), colours, norm)
    hatch(ax, floor, count == 0, _INK)
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


def draw_cells(
    ax: Axes, floor: Floor, value: NDArray[np.float64], colours: str | Colormap, norm: Normalize
) -> QuadMesh:
    """A value per vertex as coloured cells; blocked positions stay ground."""
    ax.set_facecolor(_GROUND)
    grid = floor.vertex_grid()
    cells = np.ma.masked_where(grid < 0, np.append(value, 0.0)[grid])
    x, y = (
        floor.origin_m[axis] + floor.cell_m * (np.arange(count + 1) - 0.5)
        for axis, count in enumerate((floor.columns, floor.rows))
    )
    return ax.pcolormesh(x, y, cells, cmap=colours, norm=norm, rasterized=True, zorder=1)


def _draw_one_way(ax: Axes, floor: Floor) -> None:
    """An arrow head in the middle of each one-way lane."""
    u, v = floor.edge_uv[floor.edge_oneway].T
    if not len(u):
        return
    way = floor.vertex_xy_m[v] - floor.vertex_xy_m[u]
    length = np.hypot(way[:, 0], way[:, 1])[:, None]
    head = way / length * np.minimum(0.4 * floor.pitch_m, 0.5 * length)
    tip = (floor.vertex_xy_m[u] + floor.vertex_xy_m[v] + head) / 2
    left = np.column_stack((-head[:, 1], head[:, 0])) / 2
    corners = np.stack((tip, tip - head + left, tip - head - left), axis=1)
    ax.add_collection(
        PolyCollection(list(corners), fc=_INK, ec="white", lw=0.5, alpha=0.45, zorder=3.5)
    )


def hatch(ax: Axes, floor: Floor, chosen: NDArray[np.bool_], colour: str) -> None:
    """Hatch the cells of the chosen vertices, all as one shape."""
    cell = floor.vertex_cell[chosen]
    if floor.raster_m is not None:
        grid = floor.vertex_grid()
        cell = np.argwhere((grid >= 0) & np.append(chosen, False)[grid])[:, ::-1].astype(np.int32)
    low = np.array(floor.origin_m) + floor.cell_m * (cell - 0.5)
    if not len(low):
        return
    steps = floor.cell_m * np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)])
    corners = (low[:, None] + steps).reshape(-1, 2)
    codes = np.tile([Outline.MOVETO, *[Outline.LINETO] * 3, Outline.CLOSEPOLY], len(low))
    shape = Outline(corners, codes)
    ax.add_patch(PathPatch(shape, fc="none", ec=colour, hatch="////", lw=0, zorder=2))


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
