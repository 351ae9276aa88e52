"""The picture of a radio map: every access point, the best one, the second best, and how many."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from worlds.figures import (
    draw_cells,
    draw_coverage,
    draw_coverage_count,
    draw_hall,
    hatch,
    snr_norm,
)
from worlds.floor import Floor
from worlds.radio_map import RadioMap
from worlds.world import World

if TYPE_CHECKING:
    from matplotlib.collections import QuadMesh

MAX_AP_PANELS = 6
"""APs that get a panel of their own."""

_INK = "#111111"
_PANEL_IN2 = 13.0  # drawing area of a panel [square inches]

Array = NDArray[np.float64]


def radio_figure(
    world: World,
    floor: Floor,
    radio_map: RadioMap,
    *,
    handover_xy_m: Array | None = None,
    source: str = "",
) -> Figure:
    """Heat maps of the APs, best and second-best SNR, who serves where, k-coverage, distribution.

    Of more than `MAX_AP_PANELS` APs those that cover least are shown, and the title says so.

    Args:
        world, floor, radio_map: what is shown.
        handover_xy_m: (H, 2) where a plan or run changes APs [m]; a panel more.
        source: what those come from.
    """
    shown = _weakest(radio_map)
    aps = len(radio_map.ap_ids)
    names = ["best", *(["second"] if aps > 1 else []), *(["server"] if aps else []), "count"]
    names += ["handovers"] if handover_xy_m is not None else []
    halls = len(shown) + len(names)
    figure, axes, columns = _page(halls + 1, world)
    norm = snr_norm(radio_map)
    for ax, ap in zip(axes, shown, strict=False):
        draw_coverage(ax, floor, radio_map, ap=ap, norm=norm)
        draw_hall(ax, world, floor, highlight=radio_map.ap_ids[ap])
        share = radio_map.covered[:, ap].mean() if len(radio_map.snr_db) else 0.0
        ax.set_title(f"{radio_map.ap_ids[ap]} covers {share:.1%}")
    panel = dict(zip(names, axes[len(shown) : halls], strict=True))
    snr = draw_coverage(panel["best"], floor, radio_map, norm=norm)
    panel["best"].set_title(f"best AP: {radio_map.covered_share():.1%} covered")
    if "second" in panel:
        draw_second(panel["second"], floor, radio_map, norm)
        panel["second"].set_title("second-best AP")
    if "server" in panel:
        draw_server(panel["server"], floor, radio_map)
        panel["server"].set_title("the AP of highest SNR")
    count = draw_coverage_count(panel["count"], floor, radio_map)
    panel["count"].set_title(f"{radio_map.covered_share(2):.1%} covered by two APs or more")
    if handover_xy_m is not None:
        draw_server(panel["handovers"], floor, radio_map)
        draw_handovers(panel["handovers"], handover_xy_m, floor)
        many = f"{len(handover_xy_m)} handover{'s' if len(handover_xy_m) != 1 else ''}"
        panel["handovers"].set_title(f"{many} of {source}" if source else many)
    for ax in panel.values():
        draw_hall(ax, world, floor)
    for place, ax in enumerate(axes[:halls]):
        if place + columns < halls:
            ax.set_xlabel("")
        if place % columns:
            ax.set_ylabel("")
    draw_distribution(axes[halls], radio_map)
    for ax in axes[halls + 1 :]:
        ax.set_axis_off()

    # The bar of the count first: it stands next to the panels.
    bar = figure.colorbar(count, ax=axes, shrink=0.9, aspect=40, pad=0.01)
    bar.set_label("APs that cover the place (panel “two APs or more”)")
    bar.set_ticks(range(0, aps + 1, 1 + aps // 10))
    bar = figure.colorbar(snr, ax=axes, extend="both", shrink=0.9, aspect=40, pad=0.02)
    bar.set_label("SNR [dB] (panels of an AP, best, second; line: threshold)")
    bar.ax.axhline(radio_map.threshold_db, color="white", lw=3)
    bar.ax.axhline(radio_map.threshold_db, color=_INK, lw=1.5)
    figure.suptitle(_headline(world, radio_map, shown), weight="bold", size=13)
    return figure


def _page(panels: int, world: World) -> tuple[Figure, list[Axes], int]:
    """A page with that many panels of the hall's shape, and how many stand side by side."""
    width, depth = world.hall.size_m
    columns = _columns(panels, width / depth)
    rows = math.ceil(panels / columns)
    panel_w = min(max(math.sqrt(_PANEL_IN2 * width / depth), 2.8), 6.5)
    panel_h = min(max(panel_w * depth / width, 0.9), 6.5)
    size = (columns * panel_w + 2.2, rows * (panel_h + 0.62) + 0.5)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, list(figure.subplots(rows, columns, squeeze=False).ravel()), columns


def draw_second(ax: Axes, floor: Floor, radio_map: RadioMap, norm: Normalize) -> QuadMesh:
    """SNR of the second-best AP; hatched where its loss of the best would leave a hole."""
    snr = radio_map.ranked_snr_db(2)
    mesh = draw_cells(ax, floor, snr, "viridis", norm)
    hatch(ax, floor, snr < radio_map.threshold_db, "white")
    return mesh


def draw_server(ax: Axes, floor: Floor, radio_map: RadioMap) -> QuadMesh:
    """Which AP has the highest SNR, a colour each; uncovered cells are hatched."""
    aps = len(radio_map.ap_ids)
    listed = mpl.colormaps["tab20"].colors  # type: ignore[attr-defined]
    # tab20 goes dark, light, dark, light: first all dark ones, so that neighbours differ.
    palette = [*listed[::2], *listed[1::2]]
    colours = ListedColormap([palette[k % len(palette)] for k in range(aps)])
    norm = BoundaryNorm(np.arange(aps + 1) - 0.5, aps)
    best = radio_map.best_ap.astype(np.float64)
    mesh = draw_cells(ax, floor, best, colours, norm)
    hatch(ax, floor, radio_map.coverage_count == 0, _INK)
    return mesh


def draw_handovers(ax: Axes, xy_m: Array, floor: Floor) -> None:
    """A disc where access points change, as large as there are handovers within a pitch."""
    if not len(xy_m):
        return
    cell = np.round(xy_m / floor.pitch_m).astype(np.int64)
    _, group, number = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    at = np.column_stack(
        [np.bincount(group.ravel(), weights=xy_m[:, axis]) / number for axis in (0, 1)]
    )
    ax.scatter(at[:, 0], at[:, 1], s=36.0 * number, c="white", ec=_INK, lw=1.2, alpha=0.9, zorder=5)
    for (x, y), n in zip(at.tolist(), number.tolist(), strict=True):
        if n > 1:
            ax.text(x, y, str(n), size=7, ha="center", va="center", color=_INK, zorder=6)


def draw_distribution(ax: Axes, radio_map: RadioMap) -> None:
    """Share of the positions with at least so much SNR: from the best AP, and the second best."""
    positions = len(radio_map.snr_db)
    for rank, name, style in ((1, "best AP", "-"), (2, "second-best AP", "--")):
        if rank <= len(radio_map.ap_ids) and positions:
            snr = np.sort(radio_map.ranked_snr_db(rank))
            share = 1.0 - np.arange(positions) / positions
            ax.step(snr, 100.0 * share, style, where="pre", color=_INK, lw=1.5, label=name)
    ax.axvline(radio_map.threshold_db, color="#D55E00", lw=1.2, label="threshold")
    ax.set(xlabel="SNR [dB]", ylabel="positions with at least as much [%]", ylim=(0, 102))
    ax.set_title("distribution of the SNR")
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8, loc="lower left")


def _weakest(radio_map: RadioMap) -> list[int]:
    """The APs that get a panel, in the world's order."""
    order = np.argsort(radio_map.covered.sum(axis=0), kind="stable")
    return sorted(order[:MAX_AP_PANELS].tolist())


def _columns(panels: int, aspect: float) -> int:
    """How many panels of that width : height stand side by side on a page of about 3 : 2.

    Two empty places are worth avoiding at the price of a page twice as wide or high.
    """

    def cost(columns: int) -> float:
        page = columns**2 * aspect / panels
        return abs(math.log(page / 1.5)) + 0.35 * (-panels % columns)

    return min(range(1, min(panels, 4) + 1), key=cost)


def _headline(world: World, radio_map: RadioMap, shown: list[int]) -> str:
    """Name of the world and how to read the picture."""
    aps = len(radio_map.ap_ids)
    which = f", the {len(shown)} of {aps} APs that cover least" if len(shown) < aps else ""
    reading = f"hatched: SNR below {radio_map.threshold_db:g} dB, not covered"
    return f"{world.name}: radio map{which} ({reading})"
