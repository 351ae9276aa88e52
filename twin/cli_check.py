"""`twin check`: what is wrong or unwise with a layout, before any result of it is believed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.text import Text

from twin.cli_console import DONE, NO, Meter, guarded, print_json, stdout
from twin.cli_options import AsJson, Debug, Overwrite, Seed, Set, parse_overrides, require_world
from twin.errors import TwinError

if TYPE_CHECKING:
    from worlds.check import CheckReport, Finding

_STYLES = {"error": "bold red", "warning": "yellow", "note": "cyan"}


def check(
    world: Annotated[
        Path | None, typer.Argument(metavar="WORLD.toml", help="The hall and its robots.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="check.png", help="Draw the findings, .png or .svg."
        ),
    ] = None,
    ignore: Annotated[
        str, typer.Option(metavar="CODES", help="Leave these out, e.g. W103,N101; not errors.")
    ] = "",
    strict: Annotated[
        bool, typer.Option("--strict", help="Warnings make the answer no (exit code 1), too.")
    ] = False,
    explain: Annotated[
        str | None, typer.Option(metavar="CODE", help="Say what a code means; needs no world.")
    ] = None,
    seed: Seed = None,
    settings: Set = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Look for what is wrong or unwise in a world: findings with codes, places and remedies."""
    with guarded(debug):
        if explain is not None:
            _explain(explain, as_json)
            return
        if world is None:
            raise TwinError("give a WORLD.toml to check, or --explain with the code of a finding")
        from twin.instance import seed_overrides
        from twin.outputs import PICTURES, check_targets
        from worlds.check import check_world
        from worlds.check_codes import parse_codes
        from worlds.toml_file import read_source, read_world

        require_world(world)
        check_targets((output, PICTURES), overwrite=overwrite)
        ignored = parse_codes(ignore)
        with Meter() as meter:
            meter.phase("world")
            overrides = parse_overrides(settings)
            read = read_world(world, overrides=overrides)
            if seed is not None:
                overrides = seed_overrides(read, seed) | overrides
                read = read_world(world, overrides=overrides)
            meter.phase("radio map")
            report = check_world(
                read,
                ignore=ignored,
                on_progress=lambda done, total: meter.step("radio map", done / total),
            )
            if output is not None:
                meter.phase("picture")
                from worlds.check_figure import check_figure
                from worlds.figures import save

                output.parent.mkdir(parents=True, exist_ok=True)
                save(check_figure(report), output)
        source = read_source(world, overrides=overrides)
        lines = [source.error([finding.fault]).lines[0] for finding in report.findings]
        if as_json:
            print_json(_values(world, report, lines, output, strict))
        else:
            _print(stdout(), world, report, lines, output, strict)
        raise typer.Exit(DONE if report.passed(strict=strict) else NO)


def _explain(text: str, as_json: bool) -> None:
    from worlds.check_codes import CODES, known_code, severity

    code = known_code(text)
    entry = CODES[code]
    if as_json:
        kind = severity(code)
        values = {"code": code, "severity": kind, "title": entry.title, "why": entry.why}
        print_json(values | {"mend": entry.mend})
        return
    console = stdout()
    console.print(Text.assemble((code, _STYLES[severity(code)]), " ", (entry.title, "bold")))
    console.print(Text(f"{entry.why}\n{entry.mend}"))


def _values(
    path: Path, report: CheckReport, lines: list[str], picture: Path | None, strict: bool
) -> dict[str, object]:
    """The report as plain values."""
    return {
        "world": report.world.name,
        "file": str(path),
        "passed": report.passed(strict=strict),
        "strict": strict,
        "errors": report.count("error"),
        "warnings": report.count("warning"),
        "notes": report.count("note"),
        "ignored": report.ignored,
        "findings": [
            {
                "code": finding.code,
                "severity": finding.severity,
                "title": _title(finding),
                "message": finding.message,
                "key": list(finding.key),
                "place": line.removesuffix(str(finding.fault)).rstrip(": "),
                "places_m": [list(place) for place in finding.places_m],
            }
            for finding, line in zip(report.findings, lines, strict=True)
        ],
        "picture": str(picture) if picture else None,
    }


def _title(finding: Finding) -> str:
    from worlds.check_codes import CODES

    return CODES[finding.code].title


def _print(
    console: Console,
    path: Path,
    report: CheckReport,
    lines: list[str],
    picture: Path | None,
    strict: bool,
) -> None:
    """One paragraph per finding, then a sentence."""
    for finding, line in zip(report.findings, lines, strict=True):
        head = Text.assemble((finding.code, _STYLES[finding.severity]), f" {line}")
        console.print(head, soft_wrap=True)
    counts = [
        f"{n} {kind}{'s' if n != 1 else ''}"
        for kind in _STYLES
        if (n := report.count(kind)) or kind == "error"
    ]
    said = f"{report.world.name}: {', '.join(counts)}"
    if report.ignored:
        said += f"; {report.ignored} ignored"
    style = "bold green" if report.passed(strict=strict) else "bold red"
    console.print(Text(said, style=style), soft_wrap=True)
    if report.findings:
        first = report.findings[0].code
        console.print(Text(f"twin check --explain {first} says more", style="dim"))
    if picture is not None:
        console.print(Text(f"picture: {picture}"), soft_wrap=True)
