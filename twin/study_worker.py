"""The process that does runs, and the one that watches over it.

`supervise(task)` is what an executor's worker is given. It hands the task to a process of its own,
which is kept from one task to the next, and waits: for the outcome, for the clock, or for the end
of that process. So a run that hangs or takes its process down costs this one process, is named,
and leaves all other runs alone, whatever kind of executor there is.

The process is started with `subprocess`, since the workers of some executors may not have children
of `multiprocessing`. It speaks over a pipe of its own, not over stdout, which libraries print to.
It ends when the pipe's other end is gone, so that nothing runs on after a study was killed.
"""

from __future__ import annotations

import atexit
import importlib
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection, Pipe

from twin.study_run import Outcome, Task

START_S = 120.0
"""A process that is not ready after this will never be."""

ONE_THREAD = {
    name: "1"
    for name in (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMEXPR_NUM_THREADS",
        "NUMBA_NUM_THREADS",
    )
}
"""As many processes as cores, each with one thread (HiGHS is told so by the planner)."""

_START = "import sys; sys.path[:] = {path!r}; from twin.study_worker import serve; serve({args})"


class Worker:
    """A process that does one task after another."""

    def __init__(self, function: str = Task.function) -> None:
        """Start it; what `function` needs is loaded before it is ready."""
        self._own, theirs = Pipe()
        # The process never writes to this pipe's other end and nobody else holds it: it is closed
        # when, and only when, this process ends or lets go.
        self._lifeline_theirs, self._lifeline = os.pipe()
        fds = (theirs.fileno(), self._lifeline_theirs)
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  # closed by `end`
        code = _START.format(path=sys.path, args=f"{fds[0]}, {fds[1]}, {function!r}")
        self._process = subprocess.Popen(
            [sys.executable, "-c", code],
            pass_fds=fds,
            env=os.environ | ONE_THREAD,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._errors,
            start_new_session=True,  # Ctrl-C is for the one that watches
        )
        theirs.close()
        os.close(self._lifeline_theirs)

    def do(self, task: Task) -> Outcome:
        """The outcome of a task; afterwards the process may be gone (`alive`)."""
        begin = time.perf_counter()
        try:
            if not self._own.poll(START_S) or self._own.recv() != "ready":
                self.end()
                return Outcome(task.id, "crashed", "its process did not start")
            begin = time.perf_counter()
            self._own.send(task)
            if not self._own.poll(task.timeout_s):
                self.end()
                seconds = time.perf_counter() - begin
                return Outcome(task.id, "timeout", f"stopped after {task.timeout_s:g} s", seconds)
            outcome = self._own.recv()
        except (EOFError, OSError):
            seconds = time.perf_counter() - begin
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(10)
            died = _how_it_died(self._process.returncode) + self._last_words()
            self.end()
            return Outcome(task.id, "crashed", died, seconds)
        assert isinstance(outcome, Outcome)
        return outcome

    def _last_words(self) -> str:
        """The last line the process wrote to stderr, if it wrote any."""
        self._errors.seek(0)
        said = self._errors.read()[-2000:].decode(errors="replace").split("\n")
        last = next((line.strip() for line in reversed(said) if line.strip()), "")
        return f": {last[:300]}" if last else ""

    @property
    def alive(self) -> bool:
        """Whether it can be given another task."""
        return self._process.poll() is None

    def end(self) -> None:
        """Stop the process at once."""
        self._process.kill()
        self._process.wait()
        self._own.close()
        self._errors.close()
        with suppress(OSError):
            os.close(self._lifeline)


def _how_it_died(code: int | None) -> str:
    """What an exit code says."""
    if code is None:
        return "its process closed the pipe"
    if code >= 0:
        return f"its process ended by itself, exit code {code}"
    name = signal.Signals(-code).name
    often = {"SIGKILL": "; out of memory?", "SIGSEGV": ", a defect in a compiled library"}
    return f"its process was killed by {name}{often.get(name, '')}"


_local = threading.local()


def supervise(task: Task) -> Outcome:
    """Do a task in a process kept for it; called in the workers of an executor, in any thread."""
    worker: Worker | None = getattr(_local, "worker", None)
    if worker is None or not worker.alive:
        worker = _local.worker = Worker(task.function)
        atexit.register(worker.end)
    outcome = worker.do(task)
    if not worker.alive:
        atexit.unregister(worker.end)
        _local.worker = None
    return outcome


def watch_parent() -> None:
    """Initialise a pool's worker: deaf to Ctrl-C, and gone as soon as its parent is.

    A pool's workers hold both ends of the pipe they wait at, so they would wait for ever.
    """
    from multiprocessing import parent_process

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is None:
        return

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def serve(pipe: int, lifeline: int, function: str) -> None:
    """Main program of the process: say that it is ready, take a task, answer, until the end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def until_let_go() -> None:
        os.read(lifeline, 1)  # nothing is ever written: it returns when the other end is closed
        os._exit(1)

    threading.Thread(target=until_let_go, daemon=True).start()
    connection = Connection(pipe)
    functions = {function: _loaded(function)}
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            connection.send("ready")
            task: Task = connection.recv()
            if task.function not in functions:
                functions[task.function] = _loaded(task.function)
            connection.send(functions[task.function](task))


def _loaded(function: str) -> Callable[[Task], Outcome]:
    """What `module:name` names; if the module has a `prepare`, that was called."""
    name, _, attribute = function.partition(":")
    module = importlib.import_module(name)
    getattr(module, "prepare", lambda: None)()
    found: Callable[[Task], Outcome] = getattr(module, attribute)
    return found
