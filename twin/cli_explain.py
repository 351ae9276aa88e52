"""What `twin plan` says beside the plan: the picture of its prices, and why there is no plan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from twin.errors import TwinError

if TYPE_CHECKING:
    from planner.explanation import Explanation
    from planner.plan import Plan
    from planner.problem import Problem
    from twin.instance import Stopwatch
    from worlds.floor import Floor
    from worlds.world import World

Hall = tuple["World", "Floor"]

WITHOUT_PRICES = ("cooperative", "decoupled")
"""Methods whose bound, if any, is not proven by prices."""
NO_PRICES = "not drawn: without a plan or a bound there are no prices"

PricesFile = Annotated[
    Path | None,
    typer.Option(
        "--prices",
        metavar="prices.png",
        help="Draw where room is short: what places, aisles and access points cost the fleet; "
        ".png or .svg.",
    ),
]
Explain = Annotated[
    bool,
    typer.Option(
        "--explain",
        help="If no plan serves every robot: say why, and which horizon or capacity is enough.",
    ),
]


def check_prices(path: Path | None, method: str, *, overwrite: bool) -> None:
    """Refuse a picture of prices that could not be drawn, before anything is computed.

    Raises:
        TwinError: the method has no prices, or the file cannot be written.
    """
    from twin.outputs import check_file

    if path is None:
        return
    if method in WITHOUT_PRICES:
        raise TwinError(f"--prices: --method {method} computes no prices; leave it out")
    check_file(path, (".png", ".svg"), overwrite=overwrite)


def draw_prices(
    path: Path | None, problem: Problem, plan: Plan, hall: Hall | None, watch: Stopwatch
) -> Path | None:
    """Draw the prices to a file as a whole or not at all; returns it, None if nothing was drawn."""
    if path is None or plan.prices is None:
        return None
    from twin.outputs import staged

    with watch.phase("picture"):
        from logs.congestion import draw_congestion

        with staged(path.parent) as stage:
            draw_congestion(stage / path.name, problem, plan, hall)
    return path


def explanation(problem: Problem, plan: Plan, seed: int, watch: Stopwatch) -> Explanation:
    """Why a plan serves not all robots, passing on how far the search is."""
    from planner.explain import explain

    def on_step(text: str) -> None:
        watch.on_step(f"explanation: {text}", None)

    with watch.phase("explanation"):
        return explain(problem, plan, seed=seed, on_step=on_step)


def print_explanation(console: Console, found: Explanation) -> None:
    """The reasons, then what would be enough."""
    from twin.cli_tables import Facts

    facts = Facts("why there is no plan" if found.status == "infeasible" else "explanation")
    facts.section(("reason", text) for text in found.reasons())
    facts.section(("enough", text) for text in found.remedies())
    facts.print(console)
