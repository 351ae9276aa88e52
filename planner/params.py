"""What `solve` may spend, and how it tells how far it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Method = Literal["auto", "exact", "pgcp", "cooperative", "decoupled"]


@dataclass(frozen=True)
class SolveParams:
    """What `solve` may spend and how.

    Attributes:
        method: "auto" (cooperative A*, neighbourhood search, path generation for the bound; with a
            time limit or `nodes` a tree search for the rest of it), "exact" (the same, and the
            tree search until the plan is proven optimal or `nodes` are processed; with a time
            limit only where the master of the whole fleet can be solved in it),
            "pgcp" (the paper's Algorithm 1), "cooperative" (cooperative A* with restarts),
            "decoupled" (shortest motions first, then the best APs for them: a baseline).
        seed: of all random choices.
        restarts: further orders tried by cooperative A* while a robot finds no way.
        iterations: neighbourhoods tried.
        time_limit: seconds after which the best answer so far is returned; None for no limit.
        gap: relative gap at which to stop.
        nodes: most nodes of the tree search; None for no limit.
    """

    method: Method = "auto"
    seed: int = 0
    restarts: int = 20
    iterations: int = 3000
    time_limit: float | None = None
    gap: float = 0.0
    nodes: int | None = None

    def __post_init__(self) -> None:
        if self.method not in get_args(Method):
            raise ValueError(f"method must be one of {get_args(Method)}, got {self.method!r}")
        for name in ("seed", "restarts", "iterations", "gap"):
            value = getattr(self, name)
            if not value >= 0:  # NaN neither
                raise ValueError(f"{name} must not be negative, got {value}")
        if self.time_limit is not None and not self.time_limit > 0:
            raise ValueError(f"time_limit must be positive, got {self.time_limit}")


@dataclass(frozen=True)
class Progress:
    """How far the planner is.

    Attributes:
        phase: what it is doing.
        served: robots with a path in the best plan.
        cost: of the best plan so far.
        bound: proven lower bound so far [cost units].
        columns: paths generated.
        seconds: since the start.
    """

    phase: str
    served: int
    cost: int
    bound: float
    columns: int
    seconds: float
