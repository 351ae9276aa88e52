"""Where results are written: checked before the work, all files at once after it.

Nothing already written is harmed: a file that exists is replaced only when that was asked for, and
only by a finished one.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from twin.errors import TwinError


@dataclass(frozen=True)
class RunFiles:
    """What a run leaves in its folder; all of it can be computed again from the log.

    Attributes:
        folder: where the files lie.
        log: everything about the run, complete on its own.
        layout: for Foxglove, "Import from file".
        picture: the hall with the paths driven.
        plan: the plan as plan.json.
    """

    folder: Path

    @property
    def log(self) -> Path:
        """The MCAP file."""
        return self.folder / "run.mcap"

    @property
    def layout(self) -> Path:
        """The layout the log's writer puts beside it."""
        return self.folder / "run.layout.json"

    @property
    def picture(self) -> Path:
        """The hall."""
        return self.folder / "hall.png"

    @property
    def plan(self) -> Path:
        """The planner's answer."""
        return self.folder / "plan.json"

    @property
    def all(self) -> tuple[Path, ...]:
        """Every file of a run."""
        return (self.log, self.layout, self.picture, self.plan)


def check_run_folder(files: RunFiles, *, overwrite: bool) -> None:
    """Make sure that a run can be written, before anything is computed.

    Raises:
        TwinError: the folder is a file, cannot be written to, or holds a run already.
    """
    folder = files.folder
    if folder.suffix in {".mcap", ".png", ".json", ".toml", ".html"}:
        raise TwinError(
            f"{folder}: -o names the folder of a run, not a file; for example {folder.stem}/"
        )
    if folder.exists() and not folder.is_dir():
        raise TwinError(f"{folder}: is a file; -o names the folder of a run")
    there = [path.name for path in files.all if path.exists()]
    if there and not overwrite:
        raise TwinError(
            f"{folder}: holds a run already ({', '.join(there)}); choose another folder with -o, "
            "or replace the run with --overwrite"
        )
    check_writable(folder)


PICTURES = (".png", ".svg")
"""What the name of a picture may end in."""


def check_file(path: Path, suffixes: tuple[str, ...], *, overwrite: bool) -> None:
    """Make sure that a file can be written, before anything is computed.

    Args:
        path: of the file.
        suffixes: what its name may end in, for example (".json",).
        overwrite: whether it may exist already.

    Raises:
        TwinError: wrong ending, a folder, there already, or in a place that cannot be written to.
    """
    if path.suffix.lower() not in suffixes:
        raise TwinError(
            f"{path}: must end in {' or '.join(suffixes)}; for example {path.stem}{suffixes[0]}"
        )
    if path.is_dir():
        raise TwinError(f"{path}: is a folder; give the name of a file")
    if path.exists() and not overwrite:
        raise TwinError(f"{path}: exists already; choose another name, or add --overwrite")
    check_writable(path.parent)


def check_targets(*targets: tuple[Path | None, tuple[str, ...]], overwrite: bool) -> None:
    """`check_file` for each file that is asked for: (path or None, what it may end in)."""
    for path, suffixes in targets:
        if path is not None:
            check_file(path, suffixes, overwrite=overwrite)


def check_writable(folder: Path) -> None:
    """Try whether files can be made in a folder, or in the nearest one above that exists.

    Raises:
        TwinError: they cannot.
    """
    nearest = folder.absolute()
    while not nearest.exists():
        nearest = nearest.parent
    if not nearest.is_dir():
        raise TwinError(f"{folder}: {nearest} is a file, not a folder")
    try:
        tempfile.TemporaryFile(dir=nearest).close()
    except OSError as error:
        why = (error.strerror or "cannot be written to").lower()
        raise TwinError(f"{folder}: cannot write in {nearest}: {why}") from error


@contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """A hidden folder to write in; all its files move to `folder` when the work has succeeded.

    Whatever else happens, an exception or Ctrl-C, leaves `folder` and the file system as they were.
    """
    made = _make_folders(folder)
    stage: Path | None = None
    try:
        stage = Path(tempfile.mkdtemp(prefix=".run-", suffix=".part", dir=folder))
        yield stage
        for path in sorted(stage.iterdir()):
            os.replace(path, folder / path.name)
        made = []
    finally:
        if stage is not None:
            shutil.rmtree(stage, ignore_errors=True)
        for path in made:
            with suppress(OSError):
                path.rmdir()


def _make_folders(folder: Path) -> list[Path]:
    """Create a folder and those above it; returns the new ones, the deepest first."""
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    return new


def write_text(path: Path, text: str) -> None:
    """Write a file as a whole or not at all."""
    with staged(path.parent) as stage:
        (stage / path.name).write_text(text, encoding="utf-8")
