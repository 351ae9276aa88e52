"""Pictures of the prices: where in the hall, and at which AP, the fleet is short of room.

The map shows the positions and ways with a price, the dearer the larger and darker (one hue from
light to dark, told apart in grey, too), and the APs with theirs. Below it stands when the APs'
prices arise. With a world the hall is drawn behind, without one only the graph.
"""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from logs.colors import ap_color
from planner.plan import Plan
from planner.prices import Prices
from planner.problem import Problem
from worlds.figures import draw_hall, save
from worlds.floor import Floor
from worlds.world import World

Hall = tuple[World, Floor]

MAX_PANELS = 8
"""APs that get a panel of their price over time; the dearest are shown."""
NAMED_POSITIONS = 8
"""Positions with their price beside them, at most."""
_INK, _FREE, _NO_PRICE = "#111111", "#c4c8cc", "#6b7075"
_LEAST_PT, _MOST_PT = 2.0, 7.0  # width of a way
_LEAST_PT2, _MOST_PT2 = 14.0, 190.0  # area of a position
_AP_PT, _AP_MORE_PT = 9.0, 13.0  # size of an AP without a price; what the dearest has more


def draw_congestion(path: Path, problem: Problem, plan: Plan, hall: Hall | None = None) -> None:
    """Draw the prices of a plan to a .png or .svg file.

    Raises:
        ValueError: the plan has no prices.
        WorldError: the file cannot be written.
    """
    save(congestion_figure(problem, plan, hall), path)


def congestion_figure(problem: Problem, plan: Plan, hall: Hall | None = None) -> Figure:
    """The prices of a plan as a matplotlib figure.

    Args:
        problem: what was planned.
        plan: with prices.
        hall: its world and floor, for walls, obstacles and the places of the APs.

    Raises:
        ValueError: the plan has no prices.
    """
    prices = plan.prices
    if prices is None:
        raise ValueError("the plan has no prices; plan with the method auto or pgcp")
    low, high = _extent(problem, hall)
    shown = _priced_aps(prices)
    map_w, map_h = _map_size(high - low)
    below = 1.9 if shown else 0.0
    title = _title(problem, plan, prices)
    height = map_h + below + 0.6 + 0.19 * len(title)
    figure = Figure(figsize=(map_w + 4.1, height), layout="constrained")
    FigureCanvasAgg(figure)
    heights = (map_h, below) if shown else (map_h,)
    grid = figure.add_gridspec(len(heights), max(1, len(shown)), height_ratios=heights)
    ax = figure.add_subplot(grid[0, :])
    norm = Normalize(0.0, max(_dearest(prices), 1e-9))
    _draw_map(ax, problem, prices, norm, hall)
    if hall is None:
        ax.set_xlim(low[0], high[0])
        ax.set_ylim(low[1], high[1])
    ax.set_title("\n".join(title), loc="left", size=11)
    if _dearest(prices) > 0:
        bar = figure.colorbar(
            mpl.cm.ScalarMappable(norm, _colours()), ax=ax, shrink=0.8, aspect=32, pad=0.015
        )
        bar.set_label(f"price of a position or way, all slots together [{prices.unit}]")
    if shown:
        over_time = [figure.add_subplot(grid[1, 0])]
        for k in range(1, len(shown)):
            over_time.append(figure.add_subplot(grid[1, k], sharey=over_time[0]))
            over_time[k].tick_params(labelleft=False)
        _draw_over_time(over_time, problem, prices)
    figure.legend(*_keys(prices, hall), loc="outside right upper", frameon=False, labelspacing=0.8)
    return figure


# --- the map --------------------------------------------------------------------------------------


def _colours() -> Colormap:
    """Yellow to deep brown, without the palest, which would be lost on white."""
    return ListedColormap(mpl.colormaps["YlOrBr"](np.linspace(0.25, 1.0, 256)))


def _draw_map(
    ax: Axes, problem: Problem, prices: Prices, norm: Normalize, hall: Hall | None
) -> None:
    xy, uv = problem.xy_m, problem.edge_uv
    if hall is not None:
        draw_hall(ax, *hall)
        for marker in list(ax.lines):  # the APs, drawn below with their prices
            marker.remove()
        for text in list(ax.texts):
            text.remove()
    ax.set_aspect("equal")
    ax.set_xlabel("x [m]")
    ax.set_ylabel("y [m]")
    ax.set_facecolor("white")
    ax.add_collection(LineCollection(list(xy[uv]), colors=_FREE, lw=0.7, zorder=1))
    ax.plot(*xy.T, ls="none", marker=".", ms=2.5, color=_FREE, zorder=1)

    edge, vertex = prices.in_units(prices.edge), prices.in_units(prices.vertex)
    # The dearest last, on top of the others.
    order = [e for e in np.argsort(edge, kind="stable") if edge[e] > 0]
    ax.add_collection(
        LineCollection(
            list(xy[uv[order]]),
            colors=_colours()(norm(edge[order])),
            lw=_LEAST_PT + (_MOST_PT - _LEAST_PT) * norm(edge[order]),
            capstyle="round",
            zorder=4.2,
        )
    )
    order = [v for v in np.argsort(vertex, kind="stable") if vertex[v] > 0]
    ax.scatter(
        xy[order, 0],
        xy[order, 1],
        c=vertex[order],
        s=_LEAST_PT2 + (_MOST_PT2 - _LEAST_PT2) * norm(vertex[order]),
        cmap=_colours(),
        norm=norm,
        edgecolors=_INK,
        linewidths=0.6,
        zorder=4.4,
    )
    _name_dearest(ax, problem, vertex)
    if hall is not None:
        _draw_aps(ax, problem, prices, hall[0])


def _name_dearest(ax: Axes, problem: Problem, vertex: NDArray[np.float64]) -> None:
    """Write the price beside the dearest positions, as far as there is room for it."""
    room = 0.1 * float(np.ptp(problem.xy_m, axis=0).max())
    named: list[NDArray[np.float64]] = []
    for v in np.argsort(-vertex, kind="stable")[:NAMED_POSITIONS]:
        here = problem.xy_m[v]
        if vertex[v] > 0 and all(np.abs(here - other).max() > room for other in named):
            _write(ax, here, f"{vertex[v]:.3g}", (7, 6))
            named.append(here)


def _draw_aps(ax: Axes, problem: Problem, prices: Prices, world: World) -> None:
    price = prices.in_units(prices.ap)
    most = max(float(price.max(initial=0.0)), 1e-9)
    places = {ap.id: ap.position_m for ap in world.ap}
    right = 0.75 * world.hall.size_m[0]
    for k, name in enumerate(problem.ap_ids):
        if name not in places:
            continue
        x, y, _ = places[name]
        short = price[k] > 0
        ax.plot(
            x,
            y,
            marker="^",
            ls="none",
            ms=_AP_PT + _AP_MORE_PT * math.sqrt(price[k] / most),
            mfc=ap_color(k) if short else "white",
            mec=_INK if short else _NO_PRICE,
            mew=1.2,
            zorder=6,
        )
        text = f"{name}: {price[k]:.3g}" if short else f"{name}: 0"
        shift = (-11, -4) if x > right else (11, -4)
        _write(ax, np.array([x, y]), text, shift, "right" if x > right else "left")


def _write(
    ax: Axes,
    at: NDArray[np.float64],
    text: str,
    shift: tuple[float, float],
    ha: str = "left",
) -> None:
    """Text beside a place, readable on any ground."""
    ax.annotate(
        text,
        (float(at[0]), float(at[1])),
        xytext=shift,
        textcoords="offset points",
        size=9,
        weight="bold",
        ha=ha,
        color=_INK,
        path_effects=[withStroke(linewidth=2.5, foreground="white")],
        zorder=7,
    )


def _keys(prices: Prices, hall: Hall | None) -> tuple[list[Artist], list[str]]:
    """Everything in the map, in words."""
    brown = _colours()(0.7)
    keys: list[tuple[Artist, str]] = [
        (_marker("o", 9, brown, _INK), "position with a price"),
        (Line2D([], [], color=brown, lw=4), "way with a price"),
        (Line2D([], [], color=_FREE, marker=".", lw=0.7), "without a price"),
    ]
    if hall is not None:
        if (prices.ap > 0).any():
            dearest = int(np.argmax(prices.ap))
            keys.append(
                (_marker("^", 12, ap_color(dearest), _INK), f"AP with a price [{prices.unit}]")
            )
        if not (prices.ap > 0).all():
            keys.append((_marker("^", 9, "white", _NO_PRICE), "AP without a price"))
        keys.append((Patch(fc="#5a5a5a"), "obstacle"))
    handles, labels = zip(*keys, strict=True)
    return list(handles), list(labels)


def _marker(shape: str, size: float, fill: object, edge: str) -> Line2D:
    style = {"marker": shape, "ls": "none", "ms": size, "mfc": fill, "mec": edge}
    return Line2D([], [], **style)  # type: ignore[arg-type]


# --- APs over time --------------------------------------------------------------------------------


def _draw_over_time(axes: list[Axes], problem: Problem, prices: Prices) -> None:
    """One panel per AP with a price: what one place more would be worth in each slot."""
    shown = _priced_aps(prices)
    slots = np.arange(problem.horizon + 2) - 0.5
    table = prices.in_units(prices.ap_by_slot)
    last = int(np.flatnonzero(table.any(axis=1)).max())
    for ax, a in zip(axes, shown, strict=True):
        ax.stairs(table[:, a], slots, fill=True, color=ap_color(a))
        ax.stairs(table[:, a], slots, color=_INK, lw=0.7)
        ax.set_title(f"{problem.ap_ids[a]} (m = {problem.ap_capacity[a]})", size=10)
        ax.set_xlabel("slot")
        ax.set_xlim(-0.7, last + max(2, 0.05 * last))
        ax.set_ylim(0, 1.05 * table[:, shown].max())
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel(f"price in the slot\n[{prices.unit}]")


# --- sizes and words ------------------------------------------------------------------------------


def _priced_aps(prices: Prices) -> list[int]:
    """The dearest APs, in the problem's order."""
    order = np.argsort(-prices.ap, kind="stable")[:MAX_PANELS].tolist()
    return sorted(a for a in order if prices.ap[a] > 0)


def _dearest(prices: Prices) -> float:
    """The highest price of any position or way, in the picture's unit."""
    both = np.concatenate((prices.vertex, prices.edge))
    return float(prices.in_units(both).max(initial=0.0))


def _extent(problem: Problem, hall: Hall | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lower left and upper right corner of what is drawn [m]."""
    if hall is not None:
        return np.zeros(2), np.array(hall[0].hall.size_m)
    low, high = problem.xy_m.min(axis=0), problem.xy_m.max(axis=0)
    margin = 0.05 * max(float((high - low).max()), 1.0)
    return low - margin, high + margin


def _map_size(span_m: NDArray[np.float64]) -> tuple[float, float]:
    """Inches: the longer side takes 8."""
    scale = 8.0 / float(span_m.max())
    width, height = span_m * scale
    return max(float(width), 4.5), max(float(height), 2.4)


def _title(problem: Problem, plan: Plan, prices: Prices) -> list[str]:
    """What was planned, what is proven, and the advice, line by line."""
    name = problem.name or "problem"
    proof = f"prices that prove: no plan costs less than {math.ceil(prices.bound - 1e-9)}"
    proof += f" (this one: {plan.cost})" if not plan.unserved else ""
    robots = f"{name}: what room is worth to {problem.n_robots} robots"
    return [robots, proof, *prices.advice.split("; ")]
