"""How long the planner may think, as the command's options say it, and Ctrl-C."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path

import pytest

from tests.cli_tools import hall, twin
from twin.cli_limits import interruptible, solver_params
from twin.cli_options import Method

__all__ = ["hall"]


def test_exact_proves_the_optimum(hall: Path) -> None:
    """`--method exact` ends with a proof."""
    found = twin("plan", hall, "--method", "exact", "--json")
    assert found.code == 0, found.err
    assert found.json["plan"]["status"] == "optimal"


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (("--time-limit", "0"), "--time-limit"),
        (("--time-limit", "-3"), "--time-limit"),
        (("--gap", "-0.1"), "--gap"),
        (("--nodes", "0"), "--nodes"),
        (("--iterations", "0"), "--iterations"),
    ],
)
def test_limits_that_are_none(hall: Path, options: tuple[str, str], named: str) -> None:
    """A limit that makes no sense is refused by its name, before anything is planned."""
    for command in ("plan", "run"):
        found = twin(command, hall, *options)
        assert found.code == 2
        assert named in found.err
        assert "Traceback" not in found.err
    assert not (hall.parent / "runs").exists()


@pytest.mark.parametrize(
    ("method", "option"), [("pgcp", "--nodes"), ("cooperative", "--iterations"), ("pgcp", "--gap")]
)
def test_limits_a_method_does_not_know(hall: Path, method: str, option: str) -> None:
    """A limit that would change nothing is refused, with the methods that know it."""
    found = twin("plan", hall, "--method", method, option, "1")
    assert found.code == 2
    assert option in found.err
    assert "auto" in found.err


def test_options_reach_the_planner() -> None:
    """What is given is passed on, what is not is the planner's default."""
    default = solver_params(Method.auto, 3)
    assert (default.seed, default.iterations, default.time_limit) == (3, 3000, None)
    given = solver_params(Method.exact, 1, iterations=7, time_limit=2.5, gap=0.01, nodes=9)
    assert (given.method, given.iterations, given.time_limit, given.gap, given.nodes) == (
        "exact", 7, 2.5, 0.01, 9,
    )  # fmt: skip


def test_run_takes_the_limits(hall: Path) -> None:
    """`twin run` plans within the limits it is given."""
    found = twin("run", hall, "--time-limit", "5", "--gap", "0.5", "--json", "-o", "out")
    assert found.code == 0, found.err
    assert (hall.parent / "out" / "run.mcap").exists()


def test_first_interrupt_asks_second_ends() -> None:
    """Ctrl-C once asks for an answer; twice ends; afterwards all is as before."""
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), interruptible() as pressed:  # noqa: PT012
        assert not pressed()
        os.kill(os.getpid(), signal.SIGINT)
        assert pressed()
        os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_interruptible_off_the_main_thread() -> None:
    """Signals belong to the main thread: elsewhere nothing is touched."""
    said: list[bool] = []

    def work() -> None:
        with interruptible() as pressed:
            said.append(pressed())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert said == [False]
