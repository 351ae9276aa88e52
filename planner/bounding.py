"""The lower bound of `solve`: robots alone, path generation for all at once, or group by group."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from planner.group_bounds import SIZES, group_bounds
from planner.incumbent import Incumbent
from planner.least_prices import least_penalties
from planner.master import Master
from planner.pgcp import PgcpState, artificial_cost, generate_paths
from planner.plan import Path
from planner.prices import prices_of
from planner.resources import SCALE, Resources
from planner.search import Search

WHOLE_FLEET = 250
"""Up to so many robots all of them are in one master."""

BOUND_SHARE = 0.6
"""Share of a time limit after which path generation ends while robots are left out."""

NEXT_LP = 4.0
"""The next LP may take so many times as long as the last one did."""

LONG_LP_S = 0.2
"""An LP that takes longer is counted with when time is short [s]."""


class Bounding:
    """Works on the bound of an incumbent.

    Args:
        incumbent: takes bound, prices and counts.
        search, resources: of the problem.
        ask: looks for a better plan found elsewhere; asked after every round.

    Attributes:
        fits: the master fits into one LP; False as soon as it turns out not to be solved in time.
        columns: (robot, path) generated.
    """

    def __init__(
        self,
        incumbent: Incumbent,
        search: Search,
        resources: Resources,
        ask: Callable[[], object],
    ) -> None:
        self._incumbent, self._search, self._resources = incumbent, search, resources
        self._ask = ask
        self._alone = 0
        self.fits = search.problem.n_robots <= WHOLE_FLEET
        self.columns: list[tuple[int, Path]] = []

    def robots_alone(self) -> None:
        """No plan costs less than all robots do, each alone on the floor."""
        search = self._search
        self._alone = sum(search.least_cost(i) for i in range(search.problem.n_robots))
        self._incumbent.raise_bound(self._alone * SCALE)

    def run(self) -> PgcpState | None:
        """Raises the bound by path generation; its state, None where it went group by group."""
        state = self._generate() if self.fits else None
        if self.fits:
            return state
        self._by_groups()
        return None  # its LPs take too long for anything else, too

    def _generate(self) -> PgcpState:
        """Path generation for the bound, with the best plan's paths to begin with."""
        incumbent, since = self._incumbent, time.perf_counter()
        problem = self._search.problem
        state = PgcpState(
            self._search.graph,
            self._resources,
            self._search,
            Master(self._resources, artificial_cost(problem)),
        )
        state.master.add(
            [state.master.column(i, p) for i, p in enumerate(incumbent.paths) if p is not None]
        )

        def hurry() -> bool:
            return incumbent.out_of_time(1.0 if incumbent.complete else BOUND_SHARE)

        def stop(state: PgcpState) -> bool:
            incumbent.raise_bound(state.bound)
            incumbent.columns = len(state.master.columns)
            self._ask()
            incumbent.report("path generation")
            spent = state.lp_seconds
            if spent > LONG_LP_S and NEXT_LP * spent > incumbent.seconds_left():
                self.fits = False
            return hurry() or not self.fits or incumbent.good_enough()

        incumbent.lp_value = generate_paths(
            state, range(problem.n_robots), stop=stop, complete=False, hurry=hurry
        )
        incumbent.raise_bound(state.bound)
        self.columns = [(c.robot, c.path) for c in state.master.columns if c.path is not None]
        self.count(state)
        incumbent.lap("path_generation", since)
        self.price(state, least=self.fits)
        return state

    def _by_groups(self) -> None:
        """The sum of the groups' bounds, for as long as there is time."""
        incumbent, since = self._incumbent, time.perf_counter()
        nothing = np.empty(0, np.int64)
        proof = nothing, nothing, self._alone * SCALE
        for found in group_bounds(
            self._search,
            self._resources,
            lambda: incumbent.paths,
            sizes=SIZES,
            hurry=lambda: incumbent.out_of_time() or incumbent.good_enough(),
        ):
            proof = found.rows, found.penalty, found.bound
            incumbent.raise_bound(found.bound)
            incumbent.columns = incumbent.counts["columns"] = len(found.columns)
            incumbent.counts["iterations"] = found.rounds
            incumbent.counts["groups"] = len(found.groups)
            self._ask()
            incumbent.report("path generation by groups")
        if incumbent.prices is None or proof[2] >= incumbent.bound:
            incumbent.prices = prices_of(self._resources, *proof)
        incumbent.lap("path_generation", since)

    def count(self, state: PgcpState) -> None:
        """Notes what path generation did."""
        counts = self._incumbent.counts
        self._incumbent.columns = len(state.master.columns)
        counts["columns"] = len(state.master.columns)
        counts["rows"] = state.master.n_rows
        counts["iterations"] = state.iterations
        counts["lp_solves"] = state.master.lp_solves

    def price(self, state: PgcpState, *, least: bool = True) -> None:
        """The prices that prove the bound of path generation; those of the least sum if asked."""
        incumbent, since = self._incumbent, time.perf_counter()
        alone = self._alone * SCALE  # proven by no penalties at all
        if alone >= state.bound:
            nothing = np.empty(0, np.int64)
            proof = nothing, nothing, alone
        elif incumbent.out_of_time() or not least:
            proof = state.bound_rows, state.bound_penalty, state.bound
        else:
            proof = least_penalties(state, stop=incumbent.out_of_time)
        incumbent.prices = prices_of(state.resources, *proof)
        incumbent.lap("prices", since)
