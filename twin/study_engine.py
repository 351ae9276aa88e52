"""The engine of a study: tasks in, outcomes out, over any `concurrent.futures.Executor`.

    for outcome in outcomes_of(tasks, LocalEngine(jobs=2)): …

- `LocalEngine`: a `ProcessPoolExecutor` (spawn) on this machine.
- `ClusterEngine`: `Client.get_executor()` of dask.distributed (extra `cluster`).

A run that fails, hangs or kills its process is an outcome like any other (`twin.study_worker`). If
the workers of the executor themselves go, what was under way is run again one at a time: whoever
then breaks a whole executor alone is named as the culprit, the others are not lost.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from concurrent.futures import BrokenExecutor as Broken
from contextlib import AbstractContextManager
from importlib import import_module
from itertools import islice
from types import TracebackType
from typing import Any, Protocol

from twin.errors import TwinError
from twin.study_run import Outcome, Task
from twin.study_worker import supervise, watch_parent

CONNECT_S = 10.0
CULPRIT = "its worker died, again when it was run alone"


class Engine(Protocol):
    """Gives executors, fresh ones if need be."""

    @property
    def workers(self) -> int:
        """How many tasks it does at a time."""

    def executor(self) -> AbstractContextManager[Executor]:
        """A new executor; leaving the context ends it at once, with all that is running."""


def cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0))


class LocalEngine:
    """Processes on this machine.

    Args:
        jobs: how many; as many as there are cores if None.
    """

    def __init__(self, jobs: int | None = None) -> None:
        self.workers = jobs or cores()

    def executor(self) -> AbstractContextManager[Executor]:
        """A pool of spawned processes."""
        return _Pool(self.workers)


class _Pool:
    """A process pool that ends at once, not after the tasks that are running."""

    def __init__(self, workers: int) -> None:
        from concurrent.futures import ProcessPoolExecutor
        from multiprocessing import active_children, get_context

        self._others = set(active_children())
        self._pool = ProcessPoolExecutor(workers, get_context("spawn"), watch_parent)

    def __enter__(self) -> Executor:
        return self._pool

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        from multiprocessing import active_children

        mine = [child for child in active_children() if child not in self._others]
        self._pool.shutdown(wait=False, cancel_futures=True)
        for child in mine:
            child.terminate()
        for child in mine:
            child.join(10)


class ClusterEngine:
    """The workers of a dask cluster, each in a process of its own.

    Args:
        address: of the scheduler, `tcp://host:8786`.

    Raises:
        TwinError: the extra is missing, nobody answers there, no worker is there, or a worker has
            another version of this program.
    """

    def __init__(self, address: str) -> None:
        try:
            distributed: Any = import_module("distributed")
        except ImportError:
            raise TwinError(
                "--cluster: needs dask.distributed; install the extra: pip install "
                "'mapp-twin[cluster]'"
            ) from None
        self.address = address
        try:
            self._client = distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise TwinError(
                f"--cluster {address}: no scheduler answers ({error or 'timed out'}); start one "
                "with `dask scheduler`, and workers with `dask worker`"
            ) from None
        try:
            self._check()
        except TwinError:
            self.close()
            raise

    def _check(self) -> None:
        from twin.study_lock import version

        self.workers = sum(self._client.nthreads().values())
        if not self.workers:
            raise TwinError(f"--cluster {self.address}: has no workers; start `dask worker` there")
        answers: dict[str, Any] = self._client.run(_version_here, on_error="return")
        for worker, found in answers.items():
            if found != version():
                said = "has no mapp-twin" if isinstance(found, Exception) else f"has {found}"
                raise TwinError(
                    f"--cluster {self.address}: worker {worker} {said}, this is {version()}; "
                    "install the same version there"
                )

    def executor(self) -> AbstractContextManager[Executor]:
        """The cluster as an executor."""
        return _Cluster(self._client)

    def close(self) -> None:
        """Let go of the cluster; it goes on."""
        self._client.close(timeout=5)


def _version_here() -> str:
    """Version on a worker."""
    from twin.study_lock import version

    return version()


class _Cluster:
    """dask's executor; leaving it cancels what has not begun."""

    def __init__(self, client: Any) -> None:
        # Not pure: the same task asked for again is run again.
        self._executor: Executor = client.get_executor(pure=False)

    def __enter__(self) -> Executor:
        return self._executor

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._executor.shutdown(wait=False)


def outcomes_of(
    tasks: Iterable[Task],
    engine: Engine,
    *,
    work: Callable[[Task], Outcome] = supervise,
) -> Generator[Outcome, None, None]:
    """The outcome of every task, in the order in which they end.

    Args:
        tasks: taken one by one, a few more than there are workers at a time.
        engine: gives the executor.
        work: what a worker does with a task.
    """
    waiting = iter(tasks)
    suspects: list[Task] = []
    while True:
        suspects = yield from _until_broken(waiting, engine, work)
        if not suspects:
            return
        yield from _one_at_a_time(suspects, engine, work)


def _until_broken(
    waiting: Iterator[Task], engine: Engine, work: Callable[[Task], Outcome]
) -> Generator[Outcome, None, list[Task]]:
    """Outcomes until all tasks are done or the executor breaks.

    Returns:
        The tasks that were under way when it broke, in the order in which they were begun.
    """
    running: dict[Future[Outcome], Task] = {}
    with engine.executor() as executor:
        while True:
            # One more than there are workers, so that none waits for the next.
            room = engine.workers + 1 + engine.workers // 2 - len(running)
            for task in islice(waiting, max(0, room)):
                try:
                    running[executor.submit(work, task)] = task
                except Broken:
                    return [*running.values(), task]
            if not running:
                return []
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in sorted(done, key=list(running).index):
                try:
                    outcome = future.result()
                except Broken:
                    return list(running.values())
                except Exception as error:
                    outcome = _lost(running[future], error)
                del running[future]
                yield outcome


def _one_at_a_time(
    tasks: list[Task], engine: Engine, work: Callable[[Task], Outcome]
) -> Generator[Outcome, None, None]:
    """Tasks one after another, in a new executor after each that breaks it."""
    waiting = iter(tasks)
    rest = len(tasks)
    while rest:
        with engine.executor() as executor:
            for task in waiting:
                rest -= 1
                try:
                    outcome = executor.submit(work, task).result()
                except Broken:
                    yield Outcome(task.id, "crashed", CULPRIT)
                    break
                except Exception as error:
                    outcome = _lost(task, error)
                yield outcome


def _lost(task: Task, error: Exception) -> Outcome:
    """The outcome of a task whose executor says why it has none.

    Raises:
        TwinError: the executor as a whole is gone.
    """
    name = type(error).__name__
    if name == "KilledWorker":
        return Outcome(task.id, "crashed", "it killed several workers of the cluster, one by one")
    if "Cancelled" in name or "Comm" in name or isinstance(error, OSError):
        raise TwinError(
            f"the cluster is gone ({name}); the runs so far are kept, --resume goes on with them"
        ) from error
    return Outcome(task.id, "crashed", f"its worker says {name}: {error}")
