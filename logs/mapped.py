"""A log's bytes, mapped into memory and read as they are used."""

from __future__ import annotations

import mmap
from pathlib import Path

from logs.errors import LogError


def mapped(path: Path) -> memoryview:
    """The file's bytes.

    Raises:
        LogError: there is no such file, or it is empty, no file on a disk, or cannot be read.
    """
    try:
        if path.is_dir():
            raise LogError(f"{path}: is a folder; give the log in it")
        if path.exists() and not path.is_file():  # a pipe would wait for ever
            raise LogError(f"{path}: is not a file on a disk; copy the log to one")
        with path.open("rb") as file:
            if not path.stat().st_size:
                raise LogError(f"{path}: is empty; run the world again")
            return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    except LogError:
        raise
    except FileNotFoundError as error:
        raise LogError(f"{path}: is not there; give a log written by `twin run`") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise LogError(f"{path}: cannot be read: {reason}") from error
