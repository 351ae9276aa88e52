"""The engine: every task has one outcome, whatever becomes of it, over any executor."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import AbstractContextManager, closing
from pathlib import Path

import pytest

from tests.twin.study_tasks import tasks
from twin.errors import TwinError
from twin.study_engine import CULPRIT, ClusterEngine, LocalEngine, outcomes_of
from twin.study_run import Outcome, Task
from twin.study_worker import Worker


class Threads:
    """An engine of threads: any executor will do."""

    workers = 2

    def executor(self) -> AbstractContextManager[Executor]:
        """Threads of this process."""
        return ThreadPoolExecutor(self.workers)


def by_id(outcomes: Iterator[Outcome]) -> dict[str, Outcome]:
    """Outcomes by task, each of which must come once."""
    found: dict[str, Outcome] = {}
    for outcome in outcomes:
        assert outcome.id not in found
        found[outcome.id] = outcome
    return found


def with_moods(n: int, moods: dict[int, str], timeout_s: float = 60.0) -> list[Task]:
    """Tasks of which some die."""
    return [
        Task(
            t.id,
            "",
            planner={"mood": moods.get(i, "")},
            timeout_s=timeout_s,
            function="tests.twin.study_tasks:moody",
        )
        for i, t in enumerate(tasks(n, "moody"))
    ]


def test_runs_that_die_in_any_way_are_outcomes_and_harm_no_other():
    """Killed, segfault, exit, exception, hanging: each is named and the rest is done."""
    moods = {1: "segfault", 3: "killed", 4: "exit", 5: "raise", 8: "hang"}
    begin = time.monotonic()
    found = by_id(outcomes_of(with_moods(12, moods, timeout_s=1.0), LocalEngine(2)))
    assert time.monotonic() - begin < 60
    status = {int(key, 16): outcome.status for key, outcome in found.items()}
    bad = {1: "crashed", 3: "crashed", 4: "crashed", 5: "crashed", 8: "timeout"}
    assert status == {i: bad.get(i, "ok") for i in range(12)}
    error = {int(key, 16): outcome.error for key, outcome in found.items()}
    assert "SIGSEGV" in error[1]
    assert "SIGKILL; out of memory?" in error[3]
    assert "exit code 3" in error[4]
    assert "RuntimeError: a mistake outside" in error[5]
    assert error[8] == "stopped after 1 s"


def test_results_do_not_depend_on_the_engine():
    """One worker, two, threads: the same outcomes."""
    every = tasks(20, "figure")
    found = [
        {key: (o.status, o.values) for key, o in by_id(outcomes_of(every, engine)).items()}
        for engine in (LocalEngine(1), LocalEngine(2), Threads())
    ]
    assert found[0] == found[1] == found[2]
    assert len(found[0]) == 20


def test_a_killed_worker_of_the_pool_costs_no_run():
    """The pool's own processes are killed in mid-study: it breaks, the rest is run again."""
    from multiprocessing import active_children

    done: list[Outcome] = []
    with closing(outcomes_of(tasks(40, "slow_figure"), LocalEngine(2))) as outcomes:
        for outcome in outcomes:
            done.append(outcome)
            if len(done) == 5:
                children = active_children()
                os.kill(children[0].pid, signal.SIGKILL)
    assert len({o.id for o in done}) == len(done) == 40
    assert {o.status for o in done} == {"ok"}


def breaks_its_worker(task: Task) -> Outcome:
    """Stands for `supervise`: the task 7 takes the executor's worker itself with it."""
    if int(task.id, 16) == 7:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.01)
    return Outcome(task.id, "ok")


def test_who_breaks_the_pool_alone_is_the_culprit():
    """A task that kills the pool's worker is run again alone, breaks it again, and is named."""
    found = by_id(outcomes_of(tasks(20, "figure"), LocalEngine(2), work=breaks_its_worker))
    assert len(found) == 20
    culprits = {key for key, outcome in found.items() if outcome.status == "crashed"}
    assert culprits == {f"{7:012x}"}
    assert found[f"{7:012x}"].error == CULPRIT


def gone(pid: int, within_s: float = 10.0) -> bool:
    """Whether a process ends in time (zombies have ended)."""
    until = time.monotonic() + within_s
    while time.monotonic() < until:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            return True
        if state == "Z":
            return True
        time.sleep(0.05)
    return False


def test_a_closed_engine_leaves_no_process_behind(tmp_path):
    """Ending a study in the middle ends all processes that did its runs."""
    with closing(outcomes_of(tasks(50, "pid", folder=str(tmp_path)), LocalEngine(2))) as outcomes:
        for _ in range(3):
            next(outcomes)
    pids = [int(path.name) for path in tmp_path.iterdir()]
    assert len(pids) >= 1
    assert all(gone(pid) for pid in pids)


def test_a_worker_ends_with_the_process_that_watches_it(tmp_path):
    """SIGKILL of the watcher: its worker, busy or not, does not stay."""
    import subprocess
    import sys

    code = (
        "import sys; from tests.twin.study_tasks import tasks;"
        "from twin.study_worker import Worker;"
        f"w = Worker(); w.do(tasks(1, 'pid', folder={str(tmp_path)!r})[0]);"
        "print(w._process.pid, flush=True); sys.stdin.read()"
    )
    root = Path(__file__).parents[2]
    watcher = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=root,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    pid = int(watcher.stdout.readline())
    watcher.kill()
    watcher.communicate()
    assert gone(pid)


def test_a_worker_has_one_thread_for_each_library():
    """BLAS and numba are told so by the environment of the process."""
    worker = Worker()
    try:
        environment = Path(f"/proc/{worker._process.pid}/environ").read_bytes().split(b"\0")
    finally:
        worker.end()
    for name in (b"OMP_NUM_THREADS", b"OPENBLAS_NUM_THREADS", b"NUMBA_NUM_THREADS"):
        assert name + b"=1" in environment


def test_overhead_of_a_run_without_work_is_small():
    """A run that does nothing costs less than 50 ms, start of the processes apart."""
    with closing(outcomes_of(tasks(150, "figure"), LocalEngine(1))) as outcomes:
        next(outcomes)
        begin = time.perf_counter()
        rest = list(outcomes)
        seconds = time.perf_counter() - begin
    assert len(rest) == 149
    assert seconds / len(rest) < 0.05


def test_tasks_are_taken_as_they_are_needed():
    """A study of a million runs does not hold a million tasks."""
    taken = []

    def every() -> Iterator[Task]:
        for task in tasks(40, "figure"):
            taken.append(task)
            yield task

    with closing(outcomes_of(every(), Threads())) as outcomes:
        next(outcomes)
        assert len(taken) <= 2 * Threads.workers + 1


# --- dask -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cluster():
    """A dask cluster of two workers on this machine."""
    distributed = pytest.importorskip(
        "distributed", reason="the extra `cluster` (dask.distributed) is not installed"
    )
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        silence_logs=50,
    ) as found:
        yield found


def test_a_cluster_gives_the_same_and_survives_the_loss_of_a_worker(cluster):
    """Two dask workers, one killed in mid-study: every run is done, with the same results."""
    engine = ClusterEngine(cluster.scheduler_address)
    try:
        assert engine.workers == 2
        every = tasks(60, "slow_figure")
        done: list[Outcome] = []
        with closing(outcomes_of(every, engine)) as outcomes:
            for outcome in outcomes:
                done.append(outcome)
                if len(done) == 10:
                    pids = list(engine._client.run(os.getpid).values())
                    os.kill(pids[0], signal.SIGKILL)
    finally:
        engine.close()
    assert len({o.id for o in done}) == len(done) == 60
    local = by_id(outcomes_of(every, LocalEngine(1)))
    assert {o.id: o.values for o in done} == {key: o.values for key, o in local.items()}


def test_runs_that_die_on_a_cluster_leave_its_workers_alone(cluster):
    """A crash and a hanging run are outcomes; the dask workers' processes stay the same."""
    engine = ClusterEngine(cluster.scheduler_address)
    try:
        before = sorted(engine._client.run(os.getpid).values())
        found = by_id(outcomes_of(with_moods(6, {1: "segfault", 4: "hang"}, 1.0), engine))
        after = sorted(engine._client.run(os.getpid).values())
    finally:
        engine.close()
    status = {int(key, 16): outcome.status for key, outcome in found.items()}
    assert status == {0: "ok", 1: "crashed", 2: "ok", 3: "ok", 4: "timeout", 5: "ok"}
    assert before == after


def test_a_cluster_that_is_not_there_is_a_sentence(monkeypatch):
    """No scheduler at an address: refused with what to start."""
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    monkeypatch.setattr("twin.study_engine.CONNECT_S", 0.5)
    with pytest.raises(TwinError, match=r"no scheduler answers.*dask scheduler"):
        ClusterEngine("tcp://127.0.0.1:9")


def test_without_the_extra_the_remedy_is_said(monkeypatch):
    """`--cluster` without dask.distributed names the extra."""
    import sys

    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(TwinError, match=r"pip install 'mapp-twin\[cluster\]'"):
        ClusterEngine("tcp://127.0.0.1:9")


def test_threads_have_workers_of_their_own():
    """Two threads of one process do not share a process that runs."""
    seen: set[int] = set()
    lock = threading.Lock()

    def work(task: Task) -> Outcome:
        from twin import study_worker

        outcome = study_worker.supervise(task)
        with lock:
            seen.add(study_worker._local.worker._process.pid)
        return outcome

    found = list(outcomes_of(tasks(30, "slow_figure"), Threads(), work=work))
    assert len(found) == 30
    assert len(seen) == 2
