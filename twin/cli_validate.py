"""`twin validate --json` with or without a file name."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand


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
