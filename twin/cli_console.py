"""What every command shares: consoles, the meter of long work, JSON on stdout, refusals."""

from __future__ import annotations

import json
import os
import sys
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import TracebackType
from typing import NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.text import Text

from logs.errors import LogError
from planner.errors import PlannerError
from twin.errors import TwinError
from worlds.errors import WorldError

DONE, NO, BAD_INPUT = 0, 1, 2
"""Exit codes: done; done, but the answer is no; bad input."""
DEFECT, INTERRUPTED = 70, 130
"""Exit codes nobody should see: a defect of the program (EX_SOFTWARE); stopped by Ctrl-C."""

PIPE_COLUMNS = 120
"""Width of tables that no terminal limits."""
SECONDS_OF_SILENCE = 1.0
ISSUES = "please report it with this line, the command and its input"


def stdout() -> Console:
    """Console for results."""
    return _console(stderr=False)


def stderr() -> Console:
    """Console for refusals and progress."""
    return _console(stderr=True)


def _console(*, stderr: bool) -> Console:
    stream = sys.stderr if stderr else sys.stdout
    return Console(
        stderr=stderr,
        width=None if stream.isatty() else PIPE_COLUMNS,
        highlight=False,
        soft_wrap=False,
    )


def print_json(result: object) -> None:
    """Print one JSON document on stdout; NaN and infinity never occur in results."""
    sys.stdout.write(json.dumps(result, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def refuse(*lines: str) -> NoReturn:
    """End the command for bad input: one line per mistake on stderr, exit code 2."""
    say_errors(*lines)
    raise typer.Exit(BAD_INPUT)


def say_errors(*lines: str) -> None:
    """Print each line on stderr after a red `error:`; brackets in it are text, not markup."""
    console = stderr()
    for line in lines:
        console.print(Text.assemble(("error: ", "bold red"), line), soft_wrap=True)


@contextmanager
def guarded(debug: bool) -> Iterator[None]:
    """Run a command's body: whatever goes wrong ends in a sentence and an exit code.

    Args:
        debug: show tracebacks before the sentence.
    """
    try:
        yield
        sys.stdout.flush()
    except typer.Exit:
        raise
    except KeyboardInterrupt:
        say_errors("interrupted; nothing was written")
        raise typer.Exit(INTERRUPTED) from None
    except BrokenPipeError:
        # The reader of stdout has gone (`twin info … | head`): nobody is left to tell.
        with suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(NO) from None
    except Exception as error:
        if debug:
            traceback.print_exc()
        lines, code = _explain(error)
        say_errors(*lines)
        raise typer.Exit(code) from None


def _explain(error: Exception) -> tuple[tuple[str, ...], int]:
    """Sentences for the user and the exit code."""
    if isinstance(error, (WorldError, PlannerError)):
        return error.lines, BAD_INPUT
    if isinstance(error, (LogError, TwinError)):
        return tuple(str(error).splitlines()), BAD_INPUT
    if isinstance(error, OSError) and error.strerror:
        place = f"{error.filename}: " if error.filename else ""
        return (f"{place}{error.strerror.lower()}; nothing was written",), BAD_INPUT
    if isinstance(error, MemoryError):
        return ("out of memory; try fewer positions, robots or slots",), BAD_INPUT
    said = " ".join(str(error).split()) or "no message"
    where = _last_own_frame(error)
    return (
        f"a defect of this program: {type(error).__name__} at {where}: {said}",
        f"{ISSUES}; --debug (or MAPP_DEBUG=1) shows the traceback",
    ), DEFECT


def _last_own_frame(error: Exception) -> str:
    """`package/file.py:line` of the innermost frame in this project's packages."""
    place = "unknown place"
    for frame in traceback.extract_tb(error.__traceback__):
        folder, name = os.path.split(frame.filename)
        package = os.path.basename(folder)
        if package in {"twin", "planner", "worlds", "logs", "formats"}:
            place = f"{package}/{name}:{frame.lineno}"
    return place


class Meter:
    """Says on stderr what is going on: only on a terminal, only after a second, gone at the end.

    A context manager. `phase` names what is done now; `step` tells how far it is.
    """

    def __init__(self) -> None:
        self._console = stderr()
        self._lock = threading.Lock()
        self._progress: Progress | None = None
        self._task: TaskID | None = None
        self._timer: threading.Timer | None = None
        self._text = ""
        self.visible = self._console.is_terminal

    def __enter__(self) -> Meter:
        """Start the second of silence."""
        if self.visible:
            self._timer = threading.Timer(SECONDS_OF_SILENCE, self._show)
            self._timer.daemon = True
            self._timer.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave the terminal as it was."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()
                self._timer = None
            self.visible = False
            if self._progress is not None:
                self._progress.stop()

    def phase(self, text: str) -> None:
        """A new part of the work begins; how long it takes is unknown so far."""
        self.step(text, None)

    def step(self, text: str, share: float | None) -> None:
        """The work `text` is done to `share` (0 … 1, None: unknown)."""
        with self._lock:
            self._text = text
            if self._progress is None or self._task is None:
                return
            self._progress.update(
                self._task,
                description=Text(text).markup,
                total=None if share is None else 1.0,
                completed=0.0 if share is None else share,
            )

    def say(self, text: str) -> None:
        """Print one line that stays, on a terminal only."""
        if self.visible:
            console = self._console if self._progress is None else self._progress.console
            console.print(Text(text, style="dim"))

    def _show(self) -> None:
        with self._lock:
            if not self.visible:
                return
            self._progress = Progress(
                SpinnerColumn(),
                TextColumn("{task.description}"),
                BarColumn(bar_width=24),
                TimeElapsedColumn(),
                console=self._console,
                transient=True,
            )
            self._task = self._progress.add_task(self._text, total=None)
            self._progress.start()
