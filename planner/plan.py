"""`Plan`: one path per robot, with the proof of how good it is (1-semantics §1.12–§1.14)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError

if TYPE_CHECKING:
    from planner.prices import Prices

STATUSES: tuple[str, ...] = ("optimal", "feasible", "infeasible", "unknown")
"""What a planner may answer (§1.12)."""


@dataclass(frozen=True, eq=False)
class Path:
    """A robot's states for t = 0 … τ; whether they keep the rules is `planner.check`'s to say.

    The arrays are copied if need be and read-only.

    Attributes:
        robot: its id.
        vertices: (τ+1,) int32; on an edge of k slots the vertex left is repeated k times in all.
        aps: (τ+1,) int32, serving AP.
        edges: (τ,) int32, the edge being crossed in each slot, -1 while waiting.
    """

    robot: str
    vertices: NDArray[np.int32]
    aps: NDArray[np.int32]
    edges: NDArray[np.int32]

    def __post_init__(self) -> None:
        for name in ("vertices", "aps", "edges"):
            given = getattr(self, name)
            try:
                array = np.asarray(given, np.int32)
            except (TypeError, ValueError, OverflowError) as error:
                raise PlannerError(f"path of robot {self.robot}: {name}: {error}") from error
            if array.ndim != 1:
                raise PlannerError(
                    f"path of robot {self.robot}: {name}: must be one row of integers"
                )
            if array.flags.writeable:
                array = array.copy()
                array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __eq__(self, other: object) -> bool:
        """The same robot in the same states by the same edges."""
        if not isinstance(other, Path):
            return NotImplemented
        return self.robot == other.robot and all(
            np.array_equal(getattr(self, name), getattr(other, name))
            for name in ("vertices", "aps", "edges")
        )

    __hash__ = None  # type: ignore[assignment]  # arrays have no hash

    @property
    def arrival(self) -> int:
        """τ, the slot of arrival."""
        return len(self.vertices) - 1

    @property
    def handovers(self) -> int:
        """Number of consecutive states with different APs."""
        return int(np.count_nonzero(np.diff(self.aps)))


@dataclass(frozen=True)
class Plan:
    """The planner's answer.

    Attributes:
        status: "optimal", "feasible", "infeasible" or "unknown" (§1.12).
        paths: one per robot in the robots' order, None for robots without one.
        cost: total cost of the paths there are.
        lower_bound: proven bound on the cost of any plan, None if there is none.
        infeasible_robots: ids named by a proof of infeasibility.
        lp_value: value of the master LP at the end of path generation, None if not reached.
        seconds: wall-clock time spent.
        solver: counters and phases (columns, rows, iterations, seconds per phase).
        prices: what more room would be worth, None if no bound was computed by prices.
    """

    status: str
    robot_ids: tuple[str, ...]
    paths: tuple[Path | None, ...]
    cost: int
    lower_bound: float | None
    infeasible_robots: tuple[str, ...] = ()
    message: str = ""
    lp_value: float | None = None
    seconds: float = 0.0
    solver: dict[str, float] = field(default_factory=dict)
    prices: Prices | None = None

    @property
    def gap(self) -> float | None:
        """(cost − bound) / bound (§1.13); None without a complete plan or a bound."""
        if self.unserved or self.lower_bound is None or self.status == "infeasible":
            return None
        if self.lower_bound <= 0:
            return 0.0 if self.cost <= 0 else None
        return (self.cost - self.lower_bound) / self.lower_bound

    @property
    def handovers(self) -> int:
        """Handovers of all paths together."""
        return sum(p.handovers for p in self.paths if p is not None)

    @property
    def slots(self) -> int:
        """Slots until arrival, summed over the paths."""
        return sum(p.arrival for p in self.paths if p is not None)

    @property
    def unserved(self) -> tuple[str, ...]:
        """Robots without a path."""
        return tuple(r for r, p in zip(self.robot_ids, self.paths, strict=True) if p is None)
