"""Logs: records of a run, their MCAP file, its validation and the pictures drawn from it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from logs.mcap_reader import RunFile


def read(path: Path | str) -> RunFile:
    """Open a run's log, checking all of it; see `logs.mcap_reader.RunFile` for what it gives.

    Raises:
        LogError: there is no such file, or it is not a whole and sound log of a run.
    """
    from logs.mcap_reader import RunFile

    return RunFile(Path(path))
