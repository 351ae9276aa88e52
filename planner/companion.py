"""Neighbourhood search beside the proof: plan and bound close in on each other at the same time.

Only under a time limit, where the clock decides the result anyway (§1.15). The compiled loop
releases the GIL, so on two cores it costs the tree search nothing; on one the two take turns.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence

from planner.improve import LargeNeighbourhoodSearch
from planner.parallel import n_threads
from planner.plan import Path
from planner.resources import Resources
from planner.search import Search

PATIENCE = 3000
"""Neighbourhoods without a cheaper plan until dearer ones are allowed on the way to one."""

DEVIATION = 0.003
"""How much dearer they may be, as a share of the cost."""

BATCH_S = 0.05
"""A batch of neighbourhoods takes about so long [s]."""


class Companion:
    """Improves a plan until it is closed; use as a context manager.

    Args:
        search, resources: of the problem.
        paths: the plan to start with; it may leave robots out.
        seed: of the random choices.
    """

    def __init__(
        self, search: Search, resources: Resources, paths: Sequence[Path | None], *, seed: int
    ) -> None:
        self._search, self._resources, self._seed = search, resources, seed
        self._walk = LargeNeighbourhoodSearch(search, resources, paths, seed=seed)
        self._lock = threading.Lock()
        self._told = self._known = self._walk.cost
        self._best: list[Path | None] = list(paths)
        self._outside: list[Path | None] | None = None
        self._batch, self._last = 1, time.perf_counter()
        self.neighbourhoods = self._in_vain = 0
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._loop, daemon=True, name="neighbourhoods")

    def __enter__(self) -> Companion:
        if n_threads() > 1:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        if self._thread.is_alive():
            self._thread.join()

    def _loop(self) -> None:
        while not self._ends.is_set():
            self._step()

    def _step(self) -> None:
        """One batch of neighbourhoods, of a plan from outside if that is the better one."""
        with self._lock:
            outside, self._outside = self._outside, None
        if outside is not None:
            self._seed += 1
            walk = LargeNeighbourhoodSearch(self._search, self._resources, outside, seed=self._seed)
            if walk.cost < self._walk.cost:
                self._walk = walk
        walk = self._walk
        began = time.perf_counter()
        cost = walk.cost
        stuck = self._in_vain >= PATIENCE and cost < walk.unserved_cost
        walk.run(self._batch, deviation=int(DEVIATION * cost) if stuck else 0)
        self.neighbourhoods += self._batch
        self._in_vain = 0 if walk.cost < cost else self._in_vain + self._batch
        spent = time.perf_counter() - began
        self._batch = max(1, min(500, 2 * self._batch if spent < BATCH_S else self._batch // 2))
        if walk.cost < self._known:
            paths = walk.paths()
            with self._lock:
                self._known, self._best = walk.cost, paths

    def better(self) -> list[Path | None] | None:
        """A plan better than the last one told, None if there is none.

        On one core this is where the search goes on, for as long as it was away.
        """
        if n_threads() == 1:
            away = time.perf_counter() - self._last
            until = time.perf_counter() + away
            self._step()
            while time.perf_counter() < until and not self._ends.is_set():
                self._step()
            self._last = time.perf_counter()
        with self._lock:
            if self._known >= self._told:
                return None
            self._told = self._known
            return list(self._best)

    def offer(self, paths: Sequence[Path | None]) -> None:
        """Takes a plan found elsewhere, to improve that if it is better."""
        with self._lock:
            self._outside = list(paths)
