"""What stands for a run in tests of the engine: quick, and able to die in every way."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from twin.study_run import Outcome, Task


def figure(task: Task) -> Outcome:
    """A number that depends on the task alone; at once."""
    value = int(task.id, 16) % 1000
    return Outcome(task.id, "ok", values={"success": 1, "cost": value})


def slow_figure(task: Task) -> Outcome:
    """The same after 20 ms."""
    time.sleep(0.02)
    return figure(task)


def moody(task: Task) -> Outcome:
    """What its `planner` option `mood` says: die, hang, leave or answer."""
    match task.planner.get("mood"):
        case "segfault":
            os.kill(os.getpid(), signal.SIGSEGV)
        case "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        case "exit":
            os._exit(3)
        case "raise":
            raise RuntimeError("a mistake outside of what run_task guards")
        case "hang":
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
            time.sleep(600)
        case _:
            pass
    return figure(task)


def busy(task: Task) -> Outcome:
    """A second of work for one core."""
    begin = time.process_time()
    total = 0
    while time.process_time() - begin < float(task.planner.get("cpu_s", 1.0)):
        total += sum(range(1000))
    return Outcome(task.id, "ok", values={"success": 1})


def pid(task: Task) -> Outcome:
    """Leaves its pid in a folder, then works for a while."""
    folder = Path(str(task.planner["folder"]))
    (folder / str(os.getpid())).touch()
    time.sleep(0.3)
    return figure(task)


def tasks(n: int, function: str, **planner: object) -> list[Task]:
    """`n` tasks of one of the functions above."""
    return [
        Task(f"{i:012x}", "", planner=dict(planner), function=f"tests.twin.study_tasks:{function}")
        for i in range(n)
    ]
