"""What is known while a problem is being solved: the best plan, the bound, the time left."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from planner.params import Progress, SolveParams
from planner.plan import Path, Plan
from planner.prices import Prices
from planner.problem import Problem
from planner.resources import SCALE


class Incumbent:
    """The best plan and the best bound of one call of `solve`; they only ever get better.

    Args:
        problem: the instance.
        params: limits.
        on_progress: told by `report`.
        told_to_stop: whether somebody wants the answer now.

    Attributes:
        paths, cost: the best plan; robots it leaves out have None, and cost nothing.
        bound: proven lower bound on the cost of every plan [1/SCALE cost units].
        lp_value: of the master at the end of path generation, None if not reached.
        prices: that prove the bound of path generation, None if there was none.
        columns: paths generated.
        counts: what was done, by name; `seconds_<phase>` among them.
    """

    def __init__(
        self,
        problem: Problem,
        params: SolveParams,
        on_progress: Callable[[Progress], None] | None,
        told_to_stop: Callable[[], bool],
    ) -> None:
        self.problem, self.params = problem, params
        self._on_progress, self._told_to_stop = on_progress, told_to_stop
        self._started = time.perf_counter()
        self.paths: list[Path | None] = [None] * problem.n_robots
        self.cost = 0
        self.bound = 0
        self.lp_value: float | None = None
        self.prices: Prices | None = None
        self.columns = 0
        self.counts: dict[str, float] = {}

    # -- the clock -----------------------------------------------------------------------------

    def elapsed(self) -> float:
        """Seconds since the start."""
        return time.perf_counter() - self._started

    def seconds_left(self, share: float = 1.0) -> float:
        """Until a share of the time limit; infinite without one."""
        limit = self.params.time_limit
        return float("inf") if limit is None else share * limit - self.elapsed()

    def out_of_time(self, share: float = 1.0) -> bool:
        """Whether this share of the time limit is over, or somebody wants the answer now."""
        return self._told_to_stop() or self.seconds_left(share) <= 0

    def lap(self, phase: str, since: float) -> None:
        """Adds the seconds since then to those of a phase."""
        self.count(f"seconds_{phase}", time.perf_counter() - since)

    def count(self, name: str, more: float) -> None:
        """Adds to a count."""
        self.counts[name] = self.counts.get(name, 0) + more

    # -- plan and bound ------------------------------------------------------------------------

    @property
    def complete(self) -> bool:
        """Whether the best plan serves every robot."""
        return all(path is not None for path in self.paths)

    def rounded_bound(self) -> int:
        """Costs are integers, so the bound may be rounded up (§1.13)."""
        return -(-self.bound // SCALE)

    def good_enough(self) -> bool:
        """Whether the plan serves all and is as near to the bound as was asked for."""
        bound = self.rounded_bound()
        return self.complete and self.cost - bound <= self.params.gap * max(bound, 0)

    def offer(self, paths: Sequence[Path | None]) -> None:
        """Takes a plan if it serves more robots, or as many for less."""
        cost = self.cost_of(paths)
        served, best = sum(p is not None for p in paths), sum(p is not None for p in self.paths)
        if served > best or (served == best and cost < self.cost):
            self.paths, self.cost = list(paths), cost

    def replace(self, paths: Sequence[Path | None]) -> None:
        """Takes a plan of the same robots that is no dearer."""
        self.paths, self.cost = list(paths), self.cost_of(paths)

    def cost_of(self, paths: Sequence[Path | None]) -> int:
        """Cost of the paths there are (§1.9)."""
        problem = self.problem
        return sum(problem.c_t * p.arrival + problem.c_h * p.handovers for p in paths if p)

    def raise_bound(self, bound: int) -> None:
        """Takes over a proven bound [1/SCALE cost units] if it is higher."""
        self.bound = max(self.bound, bound)

    # -- telling -------------------------------------------------------------------------------

    def report(self, phase: str) -> None:
        """Tells how far it is."""
        if self._on_progress is not None:
            served = sum(p is not None for p in self.paths)
            bound = self.bound / SCALE
            self._on_progress(
                Progress(phase, served, self.cost, bound, self.columns, self.elapsed())
            )

    def plan(self, infeasible: Sequence[int] = (), message: str = "") -> Plan:
        """The answer; `infeasible` are robots named by a proof that there is no plan."""
        bound = self.rounded_bound()
        if infeasible:
            status = "infeasible"
        elif not self.complete:
            status = "unknown"
        else:
            status = "optimal" if self.cost <= bound else "feasible"
        return Plan(
            status=status,
            robot_ids=self.problem.robot_ids,
            paths=tuple(self.paths),
            cost=self.cost,
            lower_bound=None if infeasible else float(bound),
            infeasible_robots=tuple(self.problem.robot_ids[i] for i in infeasible),
            message=message,
            lp_value=self.lp_value,
            seconds=self.elapsed(),
            solver=self.counts,
            prices=None if infeasible else self.prices,
        )
