"""`twin diff`: what two logs do not have in common."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.text import Text

from twin.cli_console import DONE, NO, Meter, guarded, print_json, stdout
from twin.cli_options import AsJson, Debug

if TYPE_CHECKING:
    from logs.diff import Change, Difference, Parting

SHOWN = 12
"""Changes of a kind that are listed; `--json` has them all."""


def diff(
    a: Annotated[Path, typer.Argument(metavar="A.mcap", help="The log of a run.")],
    b: Annotated[Path, typer.Argument(metavar="B.mcap", help="The log of another run.")],
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Say what changed from one run to another: world, plan, key figures, and where they part.

    Exit code 0 if both tell the same, 1 if not.
    """
    with guarded(debug):
        from logs.diff import diff as compare
        from logs.mcap_reader import read

        with Meter() as meter:
            meter.phase("reading")
            found = compare(read(a), read(b))
        if as_json:
            print_json(found.to_dict())
        else:
            print_diff(stdout(), found)
        raise typer.Exit(DONE if found.same else NO)


def print_diff(console: Console, found: Difference) -> None:
    """The same as a table."""
    from twin.cli_tables import Facts, Row

    facts = Facts(f"{found.a} → {found.b}")
    if found.same:
        facts.section([("contents", Text("the same, byte by byte", style="bold green"))])
    sections: list[tuple[str, Sequence[Change]]] = [
        ("world", found.world),
        ("plan", found.plan),
        ("key figures", found.figures),
        ("access points", found.aps),
        ("robots", found.robots),
        ("software", found.versions),
    ]
    for title, changes in sections:
        rows: list[Row] = [(change.key, _both(change)) for change in changes[:SHOWN]]
        if len(changes) > SHOWN:
            rows.append(("", f"… and {len(changes) - SHOWN} more, see --json"))
        if title == "plan" and found.paths:
            rows.append(("paths", _paths(found)))
        facts.section([(title, f"{len(changes) or 'nothing'} changed"), *rows])
    same = "the robots are at the same places all the time"
    rows = [("the ways", _parting(found.places) if found.places else same)]
    if found.links is not None:
        rows.append(("the links", _parting(found.links)))
    elif found.places is None:
        rows.append(("the links", "the same all the time"))
    facts.section(rows)
    facts.print(console)


def _both(change: Change) -> str:
    return f"{_value(change.a)} → {_value(change.b)}{_more(change)}"


def _value(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.6g}"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _more(change: Change) -> str:
    """` (+3)` for numbers."""
    a, b = change.a, change.b
    if isinstance(a, bool) or isinstance(b, bool):
        return ""
    if isinstance(a, int | float) and isinstance(b, int | float):
        return f"  ({b - a:+.6g})"
    return ""


def _paths(found: Difference) -> str:
    first = min(found.paths, key=lambda path: path.first_slot)
    names = ", ".join(path.robot for path in found.paths[:SHOWN])
    more = f" and {len(found.paths) - SHOWN} more" if len(found.paths) > SHOWN else ""
    return (
        f"{len(found.paths)} robots are planned otherwise ({names}{more}), "
        f"the first in slot {first.first_slot}: {first.robot}"
    )


def _parting(parting: Parting) -> str:
    when = f"{parting.t_s[0]:g} s"
    if parting.t_s[0] != parting.t_s[1]:
        when += f" and {parting.t_s[1]:g} s"
    lines = [f"part in slot {parting.slot}, at {when}"]
    lines += [
        f"{robot.key}: {_said(robot.a)} → {_said(robot.b)}" for robot in parting.robots[:SHOWN]
    ]
    if len(parting.robots) > SHOWN:
        lines.append(f"… and {len(parting.robots) - SHOWN} more robots")
    return "\n".join(lines)


def _said(body: object) -> str:
    """Place or link of a robot in words."""
    if not isinstance(body, dict):
        return "not on the floor"
    if "x_m" in body:
        return f"({body['x_m']:g}, {body['y_m']:g}) m"
    return f"{body['link']} {body['ap']} {body['snr_db']:.2f} dB".replace("  ", " ")
