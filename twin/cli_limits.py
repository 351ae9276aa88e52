"""How long the planner may think: options that `run` and `plan` share, and Ctrl-C."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import typer

from twin.cli_options import Method
from twin.errors import TwinError

if TYPE_CHECKING:
    from planner.solve import SolveParams

MethodOption = Annotated[
    Method,
    typer.Option(
        help="auto: as good as it gets, with a proof; exact: until the plan is proven optimal; "
        "pgcp: the paper's algorithm; cooperative: cooperative A* alone, fast and without a proof; "
        "decoupled: shortest motions first, then the best APs for them."
    ),
]
Iterations = Annotated[
    int | None,
    typer.Option(min=1, help="Stop improving after so many iterations (same result every time)."),
]
TimeLimit = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        help="Use this time to improve plan and proof, both at once, and then answer.",
    ),
]
Gap = Annotated[
    float | None,
    typer.Option(
        min=0.0, metavar="SHARE", help="Stop when the plan is proven this near: 0.01 is 1 %."
    ),
]
Nodes = Annotated[
    int | None,
    typer.Option(min=1, help="Stop the tree search after so many nodes (same result every time)."),
]


TAKEN_BY: dict[str, frozenset[Method]] = {
    "iterations": frozenset({Method.auto, Method.exact, Method.decoupled}),
    "gap": frozenset({Method.auto, Method.exact}),
    "nodes": frozenset({Method.auto, Method.exact}),
}
"""Which methods a limit means something to; to any other it would be an idle promise."""


def solver_params(
    method: Method,
    seed: int,
    *,
    iterations: int | None = None,
    time_limit: float | None = None,
    gap: float | None = None,
    nodes: int | None = None,
) -> SolveParams:
    """What the options ask of the planner; what is not given is the planner's default.

    Raises:
        TwinError: a time limit that is none, or a limit that the method does not know.
    """
    from planner.solve import SolveParams

    if time_limit is not None and not time_limit > 0:
        raise TwinError(f"--time-limit {time_limit:g}: must be more than 0 seconds")
    given = {"iterations": iterations, "time_limit": time_limit, "gap": gap, "nodes": nodes}
    for name, methods in TAKEN_BY.items():
        if given[name] is not None and method not in methods:
            known = ", ".join(sorted(m.value for m in methods))
            raise TwinError(
                f"--{name} {given[name]:g}: --method {method.value} knows no such limit (only "
                f"{known} do); leave it out, or use --time-limit"
            )
    return SolveParams(
        method=method.value,
        seed=seed,
        **{name: value for name, value in given.items() if value is not None},  # type: ignore[arg-type]
    )


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """Ctrl-C asks to stop thinking and to answer; a second one stops at once.

    Yields:
        Whether it was pressed.
    """
    pressed = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield pressed.is_set
        return

    def on_interrupt(_number: int, _frame: FrameType | None) -> None:
        if pressed.is_set():
            raise KeyboardInterrupt
        pressed.set()

    before = signal.signal(signal.SIGINT, on_interrupt)
    try:
        yield pressed.is_set
    finally:
        signal.signal(signal.SIGINT, before)
