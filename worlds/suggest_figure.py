"""The picture of a suggestion: who covers what before and after, side by side."""

from __future__ import annotations

import math

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from worlds.figures import draw_count, draw_hall
from worlds.floor import Floor
from worlds.suggest import Suggestion
from worlds.world import World

MOST_COLOURS = 6
"""Places with more access points than this look alike."""

_PANEL_IN2 = 34.0
_NEW, _GONE, _MOUNT = "#D55E00", "#A50026", "#666666"


def suggestion_figure(world: World, floor: Floor, suggestion: Suggestion) -> Figure:
    """Access points per place before and after; the mounts compared as dots, new ones as stars."""
    width, depth = world.hall.size_m
    panel_w = min(max(math.sqrt(_PANEL_IN2 * width / depth), 3.5), 8.0)
    panel_h = min(max(panel_w * depth / width, 1.2), 8.0)
    beside = width / depth < 2.5
    across = (2, 1) if beside else (1, 2)
    size = (across[0] * panel_w + 1.8, across[1] * (panel_h + 0.7) + 0.5)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(across[1], across[0], squeeze=False).ravel()
    vertices = len(floor.vertex_xy_m)  # the ways between them are not drawn
    before, after = suggestion.before[:vertices], suggestion.after[:vertices]
    highest = int(max(before.max(initial=0), after.max(initial=0)))
    most = max(1, min(MOST_COLOURS, highest))
    changed = suggestion.world(world)
    panels = (
        ("now", world, before, suggestion.reached_before),
        ("then", changed, after, suggestion.reached_after),
    )
    for ax, (title, hall, count, reached) in zip(axes, panels, strict=True):
        mesh = draw_count(ax, floor, count.clip(max=most), most)
        ax.plot(*suggestion.mounts[:, :2].T, ls="none", marker=".", ms=2.5, c=_MOUNT, zorder=5)
        draw_hall(ax, hall, floor)
        share = suggestion.share(reached)
        ax.set_title(f"{title}: {share:.1%} {suggestion_words(suggestion)}")
    for ap in suggestion.added:
        x, y, _ = ap.position_m
        axes[1].plot(x, y, marker="*", ms=17, mfc=_NEW, mec="white", mew=0.8, ls="none", zorder=8)
    for ap in world.ap:
        if ap.id in suggestion.removed:
            x, y, _ = ap.position_m
            axes[1].plot(x, y, marker="x", ms=13, mec=_GONE, mew=3, ls="none", zorder=8)
    bar = figure.colorbar(mesh, ax=axes, shrink=0.9, aspect=40, pad=0.01)
    bar.set_label("access points that cover the place (hatched: none)")
    ticks = range(most + 1)
    names = [f"{k} or more" if k == most < highest else str(k) for k in ticks]
    bar.set_ticks(ticks, labels=names)
    figure.suptitle(_headline(world, suggestion), weight="bold", size=12)
    return figure


def suggestion_words(suggestion: Suggestion) -> str:
    """What is counted: `covered`, `covered by 2`, `covered after any single loss`."""
    ask = suggestion.ask
    by = f" by {ask.k}" if ask.k > 1 else ""
    return f"covered{by} after any single loss" if ask.failure else f"covered{by}"


def _headline(world: World, suggestion: Suggestion) -> str:
    if suggestion.removed:
        what = f"{len(suggestion.removed)} not needed (crosses)"
    elif suggestion.added:
        what = f"{len(suggestion.added)} more (stars) of {len(suggestion.mounts)} mounts (dots)"
    else:
        what = "no change"
    return f"{world.name}: access points, {what}"
