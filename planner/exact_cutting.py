"""Separation in the exact search: asks the families of cuts in turn and adds what they find."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planner.cuts import Cut, CutPool, arrival_conflict, state_exclusion, wait_edge
from planner.exact_fixing import Fixing
from planner.master import LpSolution, Master
from planner.resources import Resources

FAMILIES = ("arrival_conflict", "state_exclusion", "wait_edge")
"""Names of the families of cuts."""


class Separation:
    """Finds cuts; the tables of pairs of robots that they need are made once and kept.

    Args:
        resources: of the problem.
        pool: where cuts are kept.
        fixing: states of interest, from which the tables are made.
        families: those used, of `FAMILIES`.
        stop: True ends the search for cuts early.
    """

    def __init__(
        self,
        resources: Resources,
        pool: CutPool,
        fixing: Fixing,
        families: tuple[str, ...],
        stop: Callable[[], bool],
    ) -> None:
        self.problem, self.resources, self.pool, self.fixing = (
            resources.problem,
            resources,
            pool,
            fixing,
        )
        self.families, self.stop = families, stop
        self._one_slot = not np.any(self.problem.edge_slots > 1)
        self._conflicts: arrival_conflict.PairConflicts | None = None
        self._exclusions: state_exclusion.StateExclusions | None = None

    def forget_states(self) -> None:
        """Fewer states are of interest: more of them exclude each other."""
        self._exclusions = None

    def add_cuts(self, master: Master, lp: LpSolution) -> bool:
        """Adds cuts that the solution violates to the pool and the master; False if none are."""
        found = self._find(master, lp)
        if not found:
            return False
        numbers = self.resources.n + len(self.pool.cuts) - len(found)
        members: list[list[int]] = [[] for _ in found]
        for k, column in enumerate(master.columns):
            if column.path is not None:
                for c in self.pool.of(column.robot, column.path, since=numbers).tolist():
                    members[c - numbers].append(k)
        master.add_cuts(
            np.array([cut.capacity for cut in found], np.int32),
            [np.array(m, np.int64) for m in members],
        )
        return True

    def _find(self, master: Master, lp: LpSolution) -> list[Cut]:
        """New cuts; the families that cost most are asked when the others have none."""
        columns, found = master.columns, []
        if "wait_edge" in self.families:
            found += self.pool.add(list(wait_edge.separate(self.problem, columns, lp.x)))
        if not self._one_slot:
            return found
        if "arrival_conflict" in self.families:
            if self._conflicts is None:
                self._conflicts = self.fixing.pair_conflicts()
            if self._conflicts is None:
                return found
            conflicts = arrival_conflict.separate(
                self._conflicts, columns, lp.x, self.resources, stop=self.stop
            )
            found += self.pool.add(list(conflicts))
        if not found and "state_exclusion" in self.families and self.fixing.at is not None:
            if self._exclusions is None:
                self._exclusions = self.fixing.pair_states()
            exclusions = state_exclusion.separate(
                self._exclusions, columns, lp.x, self.resources, stop=self.stop
            )
            found += self.pool.add(list(exclusions))
        return found
