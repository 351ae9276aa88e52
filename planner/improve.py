"""Large neighbourhood search (MAPF-LNS2: Li et al., AAAI 2022, DOI 10.1609/aaai.v36i9.21266).

Again and again a few robots are taken out of the plan and planned anew in random order around the
others (`planner.kernels_fleet`), at random among paths of equal cost; the result is kept unless it
is worse. Neighbourhoods are chosen adaptively among: robots in the way of one that is far above its
least cost (random walk), robots that pass one place at about the same time, robots that share an AP
in one slot, and random ones. A robot without a path counts more than all paths together, so the
same loop serves those who are left out, and drops none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner import kernels_lns as kernels
from planner.fleet import FleetPlan
from planner.plan import Path
from planner.resources import Resources
from planner.search import Search


class LargeNeighbourhoodSearch:
    """A plan under improvement. Deterministic by seed and number of iterations.

    Args:
        search, resources: of the problem.
        paths: the plan to start with; it must not break a rule, but may leave robots out.
        seed: of the random choices.
        max_size: robots in a neighbourhood, at most.
    """

    def __init__(
        self,
        search: Search,
        resources: Resources,
        paths: Sequence[Path | None],
        *,
        seed: int,
        max_size: int = 10,
    ) -> None:
        problem = search.problem
        T, n = problem.horizon, problem.n_robots
        self._max_size = m = max(2, min(max_size, n))
        # More than all robots together can cost: serving one more is worth any delay of the others.
        self.unserved_cost = n * (problem.c_t + problem.c_h) * T + 1
        self._plan = FleetPlan(search, paths, unserved_cost=self.unserved_cost)
        self._work = kernels.Workspace(
            old_arcs=np.empty((m, T), np.int32),
            old_first=np.empty(m, np.int32),
            old_arrival=np.empty(m, np.int64),
            old_cost=np.empty(m, np.int64),
            best_arcs=np.empty((n, T), np.int32),
            best_first=np.empty(n, np.int32),
            best_arrival=np.empty(n, np.int64),
            best_cost=np.empty(n, np.int64),
        )
        self._weights = np.ones(kernels.N_STRATEGIES)
        self._tabu = np.zeros(n, np.int64)
        self._rng = np.random.default_rng([seed, 2])
        kernels.keep_best(self._plan.fleet, self._work)

    def run(self, iterations: int, *, deviation: int = 0) -> int:
        """Tries neighbourhoods; returns how many made a cheaper plan than ever.

        Args:
            iterations: neighbourhoods to try.
            deviation: how much dearer than the cheapest plan the fleet may become on the way.
        """
        return int(
            kernels.improve(
                self._plan.graph,
                self._plan.fleet,
                self._work,
                iterations,
                self._max_size,
                deviation,
                self.unserved_cost,
                self._weights,
                self._tabu,
                self._rng,
            )
        )

    @property
    def cost(self) -> int:
        """Cost of the cheapest plan, robots without a path included at `unserved_cost`."""
        return int(self._work.best_cost.sum())

    def paths(self) -> list[Path | None]:
        """The cheapest plan."""
        best = self._work
        return self._plan.read(best.best_arcs, best.best_first, best.best_arrival)
