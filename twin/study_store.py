"""Where a study keeps its results: rows as they come, files, and what was there before.

runs.csv is the truth: one line per run, written and flushed when the run ends, so that killing the
study at any moment loses no run that has ended. A line cut off by a kill is dropped on resuming.
"""

from __future__ import annotations

import csv
import fcntl
import io
import os
import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Protocol, Self

from twin.errors import TwinError
from twin.outputs import check_writable
from twin.study_kpi import Value
from twin.study_run import STATUSES

RUNS, SUMMARY, LOCK, REPORT = "runs.csv", "summary.csv", "study.lock.toml", "report.html"

_BEFORE, _AFTER, _LAST = ("run", "scenario"), ("replication", "seed", "status", "error"), "log"
SECONDS = "seconds"
_ID = re.compile(r"[0-9a-f]{12}")


@dataclass(frozen=True)
class Row:
    """A run and what became of it: one line of runs.csv.

    Attributes:
        run: its id.
        scenario, levels: of its cell; levels by factor, as text.
        replication, seed: which instance it was.
        status, error, seconds: how it ended.
        values: key figures by column, None where there is none.
        log: its log's file, relative to the folder of the study; "" if none was kept.
    """

    run: str
    scenario: str
    levels: dict[str, str]
    replication: int
    seed: int
    status: str
    error: str = ""
    seconds: float = 0.0
    values: dict[str, Value] = field(default_factory=dict)
    log: str = ""

    @property
    def cell(self) -> tuple[str, ...]:
        """Scenario and levels."""
        return (self.scenario, *self.levels.values())


@dataclass(frozen=True)
class Header:
    """The columns of runs.csv: those of every study, its factors, its key figures."""

    factors: tuple[str, ...]
    kpis: tuple[str, ...]

    @property
    def names(self) -> list[str]:
        """All of them, in order."""
        return [*_BEFORE, *self.factors, *_AFTER, SECONDS, *self.kpis, _LAST]

    @classmethod
    def of(cls, names: Sequence[str]) -> Header:
        """The header that has these names.

        Raises:
            ValueError: it is none.
        """
        end = names.index(_AFTER[0])
        header = cls(tuple(names[len(_BEFORE) : end]), tuple(names[end + len(_AFTER) + 1 : -1]))
        if header.names != list(names):
            raise ValueError("these are not the columns of a study")
        return header

    def line(self, row: Row) -> str:
        """The row as a line of CSV, with its end."""
        fields: list[object] = [row.run, row.scenario, *(row.levels[f] for f in self.factors)]
        fields += [row.replication, row.seed, row.status, " ".join(row.error.split())]
        fields.append(f"{row.seconds:.4f}")
        fields += ["" if (v := row.values.get(k)) is None else repr(v) for k in self.kpis]
        return _csv_line([*fields, row.log])

    def row(self, fields: Sequence[str]) -> Row:
        """The row that a line of CSV says.

        Raises:
            ValueError: it is no whole row.
        """
        if len(fields) != len(self.names):
            raise ValueError(f"has {len(fields)} fields, not {len(self.names)}")
        named = dict(zip(self.names, fields, strict=True))
        if not _ID.fullmatch(named["run"]) or named["status"] not in STATUSES:
            raise ValueError("is no run of a study")
        return Row(
            run=named["run"],
            scenario=named["scenario"],
            levels={f: named[f] for f in self.factors},
            replication=int(named["replication"]),
            seed=int(named["seed"]),
            status=named["status"],
            error=named["error"],
            seconds=float(named[SECONDS]),
            values={k: _number(named[k]) for k in self.kpis},
            log=named[_LAST],
        )


def _csv_line(fields: Iterable[object]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(fields)
    return text.getvalue()


def _number(text: str) -> Value:
    if not text:
        return None
    return int(text) if re.fullmatch(r"-?\d+", text) else float(text)


class Store(Protocol):
    """What a study needs of a place for its results."""

    def begin(self, header: Header, runs: Iterable[str], *, resume: bool) -> list[Row]:
        """Get ready to take rows; returns those that are there already."""

    def append(self, row: Row) -> None:
        """Keep a row; when this returns, a kill does not lose it."""

    def put(self, name: str, content: bytes) -> None:
        """Keep a file, as a whole or not at all."""

    def finish(self, rows: Sequence[Row]) -> None:
        """Put the rows in this order, now that all are there."""


class FolderStore:
    """Results in a folder. A context manager; one study at a time can write to a folder."""

    def __init__(self, folder: Path, *, overwrite: bool = False) -> None:
        self.folder, self._overwrite = folder, overwrite
        self._file: IO[bytes] | None = None
        self._header: Header | None = None

    def __enter__(self) -> Self:
        """Nothing is done before `begin`."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Let others write to the folder."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def begin(self, header: Header, runs: Iterable[str], *, resume: bool) -> list[Row]:
        """Take the folder, and read what is there.

        Args:
            header: columns of this study.
            runs: ids of all runs of this study.
            resume: whether results may be there.

        Raises:
            TwinError: they are and may not be, or they are of another study, or somebody else is
                writing, or the folder cannot be written to.
        """
        path = self.folder / RUNS
        if self.folder.exists() and not self.folder.is_dir():
            raise TwinError(f"{self.folder}: is a file; -o names the folder of a study")
        check_writable(self.folder)
        if path.exists() and not resume and not self._overwrite:
            raise TwinError(
                f"{self.folder}: holds a study already ({RUNS}); go on with it (--resume), choose "
                "another folder (-o), or replace it (--overwrite)"
            )
        self.folder.mkdir(parents=True, exist_ok=True)
        file = self._file = path.open("a+b")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise TwinError(f"{self.folder}: another study is writing there just now") from None
        self._header = header
        if not resume:
            self._clear()
        rows, end = _read(file, path) if resume else ([], 0)
        if end == 0:
            file.truncate(0)
            file.write(_csv_line(header.names).encode())
            self._flush()
            return []
        self._check(path, header, rows, set(runs))
        file.truncate(end)
        file.seek(0, os.SEEK_END)
        return rows

    def _check(self, path: Path, header: Header, rows: list[Row], runs: set[str]) -> None:
        """Refuse to go on with results of something else."""
        there = read_header(path)
        mend = "give the study another folder (-o), or replace these results (--overwrite)"
        if there != header:
            old, new = set(there.names), set(header.names)
            changed = ", ".join(sorted(old ^ new)) or "their order"
            raise TwinError(f"{path}: has other columns than this study ({changed}); {mend}")
        strange = [row for row in rows if row.run not in runs]
        if strange:
            first = strange[0]
            raise TwinError(
                f"{path}: {len(strange)} of its {len(rows)} runs are none of this study as it is "
                f"now, the first of them {first.run} (scenario {first.scenario}, replication "
                f"{first.replication}); the study, its world or the program have changed; {mend}"
            )

    def _clear(self) -> None:
        """Remove the results of the study that is replaced."""
        for name in (SUMMARY, LOCK, REPORT):
            (self.folder / name).unlink(missing_ok=True)
        for below, pattern in (("logs", "*.mcap"), ("figures", "*.svg")):
            for path in sorted((self.folder / below).glob(pattern)):
                path.unlink()
            with suppress(OSError):
                (self.folder / below).rmdir()

    def append(self, row: Row) -> None:
        """Write a line and make sure it reaches the disk."""
        if self._file is None or self._header is None:
            raise RuntimeError("begin comes first")
        self._file.write(self._header.line(row).encode())
        self._flush()

    def _flush(self) -> None:
        if self._file is not None:
            self._file.flush()
            os.fsync(self._file.fileno())

    def put(self, name: str, content: bytes) -> None:
        """Write a file below the folder, under another name first."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(path.name + ".part")
        part.write_bytes(content)
        os.replace(part, path)

    def finish(self, rows: Sequence[Row]) -> None:
        """Write runs.csv anew, in this order."""
        if self._header is None:
            raise RuntimeError("begin comes first")
        lines = [_csv_line(self._header.names), *(self._header.line(row) for row in rows)]
        self.put(RUNS, "".join(lines).encode())


def read_header(path: Path) -> Header:
    """The columns of a runs.csv.

    Raises:
        TwinError: it is none.
    """
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        first = next(csv.reader(file), [])
    try:
        return Header.of(first)
    except ValueError:
        raise TwinError(f"{path}: is no {RUNS} of a study; choose another folder") from None


def read_rows(path: Path) -> tuple[Header, list[Row]]:
    """Columns and rows of a runs.csv; a last line that was cut off is left out.

    Raises:
        TwinError: it is none, or is damaged.
    """
    if not path.is_file():
        raise TwinError(f"{path.parent}: holds no study; there is no {RUNS}")
    with path.open("rb") as file:
        rows, _ = _read(file, path)
    return read_header(path), rows


def _read(file: IO[bytes], path: Path) -> tuple[list[Row], int]:
    """Rows of an open runs.csv, and where the last whole one ends [bytes]; 0 without a header."""
    file.seek(0)
    data = file.read()
    end = data.rfind(b"\n") + 1  # what stands behind it was cut off
    lines = data[:end].decode("utf-8", errors="replace").split("\n")[:-1]
    if not lines:
        return [], 0
    header = read_header(path)
    rows: list[Row] = []
    seen: set[str] = set()
    for number, fields in enumerate(csv.reader(lines[1:]), 2):
        try:
            row = header.row(fields)
        except ValueError as error:
            raise TwinError(f"{path}:{number}: {error}; the file is damaged") from None
        if row.run not in seen:
            rows.append(row)
            seen.add(row.run)
    return rows, end
