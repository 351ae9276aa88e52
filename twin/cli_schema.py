"""`twin schema`: what a world file may say, for editors and for readers."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from twin.cli_console import guarded
from twin.cli_options import Debug, Overwrite


def schema(
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="world.schema.json",
            help="Else stdout. A name in .md gives the page docs/world-format.md instead, "
            "check-codes.md the page of findings, log-format.md that of logs.",
        ),
    ] = None,
    overwrite: Overwrite = False,
    debug: Debug = False,
) -> None:
    """Give the JSON schema of world files, with which editors complete keys and mark mistakes."""
    with guarded(debug):
        from twin.outputs import check_file, write_text
        from worlds.schema import schema_text

        if output is None:
            sys.stdout.write(schema_text())
            return
        check_file(output, (".json", ".md"), overwrite=overwrite)
        as_json = output.suffix.lower() == ".json"
        write_text(output, schema_text() if as_json else _page(output.stem))


def _page(name: str) -> str:
    """A page of the documentation that is told from the code."""
    from logs.format_page import format_page as log_page
    from worlds.check_codes import codes_page
    from worlds.schema import format_page

    pages = {"check-codes": codes_page, "log-format": log_page}
    return pages.get(name, format_page)()
