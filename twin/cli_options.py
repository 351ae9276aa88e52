"""The options the commands share, and what their values mean."""

from __future__ import annotations

import tomllib
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from twin.errors import TwinError

WorldFile = Annotated[Path, typer.Argument(metavar="WORLD.toml", help="The hall and its robots.")]
LogFile = Annotated[Path, typer.Argument(metavar="RUN.mcap", help="The log of a run.")]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Replace a value of the world, e.g. plan.horizon=90, ap.ap3.enabled=false, "
        "ap.ap0.position_m=[10,20,5]. Can be given many times.",
    ),
]
Seed = Annotated[
    int | None,
    typer.Option(
        min=0,
        max=2**32 - 1,
        help="Another instance of the same family: replaces the seeds of drawn obstacles and "
        "robots, of the shadow fading, of the planner and of the run.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON on stdout.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace files that exist.")]
Debug = Annotated[
    bool,
    typer.Option("--debug", envvar="MAPP_DEBUG", help="Show tracebacks of errors."),
]


class Method(StrEnum):
    """How to plan; see `planner.solve.SolveParams`."""

    auto = "auto"
    exact = "exact"
    pgcp = "pgcp"
    cooperative = "cooperative"
    decoupled = "decoupled"


class PolicyName(StrEnum):
    """Who may advance; see `run.policy` of the world."""

    group = "group"
    strict = "strict"


ExecutionPolicy = Annotated[
    PolicyName | None,
    typer.Option(
        help="group: all that can advance together do; strict: only into places that are empty "
        "already (refuses plans in which robots rotate). The world's run.policy if left out."
    ),
]
Replanning = Annotated[
    bool | None,
    typer.Option(
        "--replan/--no-replan",
        help="Plan anew when the plan cannot be kept. The world's run.replan if left out.",
    ),
]


def run_overrides(policy: PolicyName | None, replan: bool | None) -> dict[str, object]:
    """What the options of a run set in the world."""
    chosen: dict[str, object] = {}
    if policy is not None:
        chosen["run.policy"] = policy.value
    if replan is not None:
        chosen["run.replan"] = replan
    return chosen


def parse_overrides(settings: list[str] | None) -> dict[str, object]:
    """`plan.horizon=90` → {"plan.horizon": 90}; values are TOML, or else plain text.

    Raises:
        TwinError: with every setting that has no `=` or no key, or that is given twice.
    """
    chosen: dict[str, object] = {}
    wrong = []
    for setting in settings or []:
        key, equals, text = (part.strip() for part in setting.partition("="))
        if not key or not equals:
            wrong.append(f"--set {setting}: is not KEY=VALUE; write for example plan.horizon=90")
        elif key in chosen:
            wrong.append(f"--set {setting}: {key} is set twice; keep one of the two")
        else:
            chosen[key] = _value(text)
    if wrong:
        raise TwinError("\n".join(wrong))
    return chosen


def _value(text: str) -> object:
    """A TOML value; what is none is text, so that quotes may be left out."""
    try:
        table = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    return table["value"] if len(table) == 1 else text


def parse_objective(text: str) -> str | dict[str, int]:
    """`hp`, `tp` or `snr` as they are; `1,60` as the costs of a slot and of a handover.

    Raises:
        TwinError: anything else.
    """
    if text in {"hp", "tp", "snr"}:
        return text
    slot, comma, handover = text.partition(",")
    if comma and slot.strip().isdecimal() and handover.strip().isdecimal():
        return {"c_t": int(slot), "c_h": int(handover)}
    raise TwinError(
        f"--objective {text}: must be hp (fewest handovers first), tp (shortest time first), snr "
        "(best AP everywhere) or two integers, the costs of a slot and of a handover: 1,60"
    )


def require_suffix(path: Path, suffixes: tuple[str, ...], kind: str) -> None:
    """Refuse an input file whose name says that it is something else.

    Raises:
        TwinError: its name ends otherwise.
    """
    if path.suffix.lower() not in suffixes:
        raise TwinError(f"{path}: is not {kind}; its name must end in {' or '.join(suffixes)}")


def require_world(path: Path) -> None:
    """Refuse what is no world file by its name; see `require_suffix`."""
    require_suffix(path, (".toml",), "a world file")
