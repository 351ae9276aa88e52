"""`twin validate`: check a log, and run it again if asked."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from twin.cli_console import DONE, NO, Meter, guarded, print_json, refuse, stdout
from twin.cli_options import Debug, LogFile, Overwrite
from twin.errors import TwinError

if TYPE_CHECKING:
    from logs.findings import Report


class ValidateCommand(TyperCommand):
    """Lets `--json` stand without a FILE, as on the other commands: then stdout is meant.

    What follows `--json` is taken for its FILE only if it ends in .json or is a plain `-`; so a log
    behind it is never taken for a file to write.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put in the `-` that is left out."""
        complete: list[str] = []
        for place, arg in enumerate(args):
            complete.append(arg)
            following = args[place + 1] if place + 1 < len(args) else ""
            if arg == "--json" and not (following == "-" or following.lower().endswith(".json")):
                complete.append("-")
        return super().parse_args(ctx, complete)


def validate(
    log: LogFile,
    replay: Annotated[
        bool,
        typer.Option(
            "--replay",
            help="Also run the log's inputs again, in another process with another hash seed, and "
            "compare message by message.",
        ),
    ] = False,
    hash_seed: Annotated[
        int | None,
        typer.Option(min=0, max=2**32 - 1, help="The hash seed of --replay; else another one."),
    ] = None,
    json_file: Annotated[
        Path | None,
        typer.Option(
            "--json", metavar="[FILE]", help="Write the findings as JSON, without FILE to stdout."
        ),
    ] = None,
    junit: Annotated[
        Path | None,
        typer.Option("--junit", metavar="FILE", help="Write them as JUnit XML, for CI."),
    ] = None,
    overwrite: Overwrite = False,
    debug: Debug = False,
) -> None:
    """Check a log: the file itself, the plan, the run slot by slot, and every key figure."""
    with guarded(debug):
        from logs.validate import validate as check
        from twin.cli_tables import print_report
        from twin.outputs import check_file, write_text

        if hash_seed is not None and not replay:
            raise TwinError("--hash-seed: is for --replay; add --replay")
        to_stdout = json_file == Path("-")
        targets = [(junit, ".xml"), (None if to_stdout else json_file, ".json")]
        for path, suffix in targets:
            if path is not None:
                check_file(path, (suffix,), overwrite=overwrite)
        with Meter() as meter:
            report = check(log, on_progress=lambda share: meter.step("validation", share))
            if replay:
                report = _replayed(report, log, hash_seed, meter)
        if junit is not None:
            write_text(junit, report.to_junit_xml())
        if json_file is not None and not to_stdout:
            write_text(json_file, json.dumps(report.to_dict(), indent=2) + "\n")
        if to_stdout:
            print_json(report.to_dict())
        else:
            print_report(stdout(), report)
        if any(finding.rule == "container:structure" for finding in report.findings):
            refuse(f"{log}: is cut off or damaged; run the world again")
        raise typer.Exit(DONE if report.valid else NO)


def _replayed(report: Report, log: Path, hash_seed: int | None, meter: Meter) -> Report:
    """The report with step 5: what running the log again gives, or why it could not be."""
    from twin.rerun import rerun_elsewhere, with_rerun, without_rerun

    seed = hash_seed if hash_seed is not None else _other_seed()
    meter.phase("running it again")
    try:
        answer = rerun_elsewhere(
            log, hash_seed=seed, on_progress=lambda share: meter.step("running it again", share)
        )
    except TwinError as error:
        return without_rerun(report, str(error))
    return with_rerun(report, answer)


def _other_seed() -> int:
    """A hash seed that is not this process's, which is random unless it is set."""
    return 2 if os.environ.get("PYTHONHASHSEED") == "1" else 1
