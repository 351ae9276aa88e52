"""`twin plan MAP.map --scen FILE.scen --agents K`: instances of the MAPF benchmarks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin.errors import TwinError
from worlds.formats import PASSABLE

if TYPE_CHECKING:
    from planner.plan import Plan
    from planner.problem import Problem

Scenario = Annotated[
    Path | None,
    typer.Option("--scen", metavar="FILE.scen", help="MovingAI scenario, with a .map only."),
]
Agents = Annotated[
    int | None,
    typer.Option(metavar="K", help="Its first K rows are the robots, with a .map only."),
]
Horizon = Annotated[
    int | None,
    typer.Option(
        metavar="T", help="Slots to plan for, with a .map only; else chosen safely large."
    ),
]
Passable = Annotated[
    str,
    typer.Option(metavar="SYMBOLS", help="Where robots may stand, with a .map only."),
]


def is_map(source: Path) -> bool:
    """Whether a file's name says that it is a MovingAI map."""
    return source.suffix.lower() == ".map"


def refuse_map_options(
    source: Path, scen: Path | None, agents: int | None, horizon: int | None, passable: str
) -> None:
    """Refuse options that only a .map has a use for.

    Raises:
        TwinError: one line for each that was given.
    """
    given = {
        "--scen": (scen is not None, "its robots are in the file itself"),
        "--agents": (agents is not None, "its robots are in the file itself"),
        "--horizon": (horizon is not None, "a world takes --set plan.horizon=T"),
        "--passable": (passable != PASSABLE, "its floor is in the file itself"),
    }
    wrong = [
        f"{name}: is for a MovingAI .map, {source} is none; {why}"
        for name, (is_given, why) in given.items()
        if is_given
    ]
    if wrong:
        raise TwinError("\n".join(wrong))


def map_problem(
    source: Path,
    scen: Path | None,
    agents: int | None,
    horizon: int | None,
    passable: str,
    *,
    settings: list[str] | None = None,
    objective: str | None = None,
) -> Problem:
    """The problem of the first agents of a scenario.

    Raises:
        TwinError: options are missing, or have no meaning here.
        WorldError: the files cannot be read, or do not fit each other.
        PlannerError: the horizon is none.
    """
    wrong = []
    if scen is None:
        wrong.append(f"{source}: a map has no robots; give --scen FILE.scen and --agents K")
    if settings:
        wrong.append(f"--set: {source} is a map; only the values of a world can be set")
    if objective is not None:
        wrong.append(
            f"--objective: {source} is a map, its plans cost the slots until arrival, "
            "and one AP covers everything"
        )
    if wrong or scen is None:
        raise TwinError("\n".join(wrong))
    from planner.mapf import mapf_problem
    from worlds.formats.movingai import errands, read_map, read_scenario

    grid, scenario = read_map(source, passable=passable), read_scenario(scen)
    if agents is None:
        raise TwinError(
            f"{scen}: say with --agents how many of its {len(scenario.rows)} rows are robots"
        )
    starts, goals = errands(grid, scenario, agents)
    name = f"{grid.name}, {scen.name}, {agents} agents"
    return mapf_problem(name, grid.passable, starts, goals, horizon)


def beyond_values(problem: Problem, plan: Plan) -> dict[str, object]:
    """What the answer says about plans that take longer than the horizon, as JSON."""
    from planner.mapf import cheapest_beyond

    least = cheapest_beyond(problem)
    bound = plan.lower_bound
    return {
        "cheapest_beyond_horizon": least,
        "lower_bound_of_any_horizon": None if bound is None else min(bound, float(least)),
    }


def beyond_sentence(problem: Problem, plan: Plan) -> str:
    """The same in a sentence."""
    from planner.mapf import cheapest_beyond

    T, bound = problem.horizon, plan.lower_bound
    if plan.status == "infeasible":
        return f"This holds for the horizon of {T} slots; --horizon chooses another."
    least = cheapest_beyond(problem)
    if bound is not None and bound > least:
        return (
            f"The bound of {bound:g} is for plans of up to {T} slots; of longer ones it is "
            f"proven that they cost at least {least}. A larger --horizon closes that."
        )
    return f"The bound holds for plans of any length: longer than {T} slots costs at least {least}."
