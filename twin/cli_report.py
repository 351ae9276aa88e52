"""`twin report`: a run as one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin.cli_console import Meter, guarded, print_json, stdout
from twin.cli_options import AsJson, Debug, LogFile, Overwrite


def report(
    log: LogFile,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="run.html", help="Else beside the log."),
    ] = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Write a run down as one HTML page: it needs no network and can be sent by e-mail."""
    with guarded(debug):
        from logs.mcap_reader import read
        from logs.report import write_report
        from twin.outputs import check_file

        target = output or log.with_suffix(".html")
        check_file(target, (".html",), overwrite=overwrite)
        with Meter() as meter:
            meter.phase("reading")
            run = read(log)
            target.parent.mkdir(parents=True, exist_ok=True)
            write_report(run, target, on_step=meter.phase)
        size = target.stat().st_size
        if as_json:
            print_json({"file": str(target), "bytes": size})
        else:
            stdout().print(f"{target} ({size / 1e6:.1f} MB); open it in a browser", soft_wrap=True)
