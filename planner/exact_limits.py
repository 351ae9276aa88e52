"""Which states, paths and columns the exact search still looks at, everywhere and at a node.

What is excluded everywhere comes from `Fixing` at the root; a node excludes further states where
its decisions leave pairs of robots no room (`JointBound`), and its children inherit them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planner.branching import Arrive, Decision, Restriction, restrict
from planner.cuts.pairs import clashing_pairs, positive_by_robot
from planner.exact_fixing import Fixing
from planner.exact_pricing import Pricing
from planner.joint import JointBound
from planner.master import Column, LpSolution, Master
from planner.resources import Resources

MAX_STATES = 600
"""States of interest per robot up to which all pairs of robots are looked at, at the root."""

MAX_PAIRS = 8
"""Pairs of robots looked at at a node, those first whose paths clash most."""

Excluded = dict[int, NDArray[np.uint8]]
"""States excluded at a node: by robot the bits of a (T+1, n+A) array."""


class Limits:
    """Excluded states, and the columns that they and decisions leave.

    Args:
        pricing, resources, fixing: of the search.
        master: its columns are told by `add`.
        stop: True ends looking at pairs early.
    """

    def __init__(
        self,
        pricing: Pricing,
        resources: Resources,
        fixing: Fixing,
        master: Master,
        stop: Callable[[], bool],
    ) -> None:
        self.pricing, self.resources, self.fixing, self.master = pricing, resources, fixing, master
        self.problem, self.graph = pricing.problem, pricing.search.graph
        self.n = self.problem.n_robots
        self._joint = JointBound(pricing, stop)
        self._one_slot = not np.any(self.problem.edge_slots > 1)
        # Of every column; the artificial ones come first.
        self._robot = np.arange(self.n)
        self._arrival = np.full(self.n, -1, np.int64)
        self._states = [np.empty(0, np.int64)] * self.n
        self._kept = np.ones(self.n, np.bool_)
        self._here: dict[int, NDArray[np.bool_]] = {}

    def add(self, columns: list[Column]) -> None:
        """Columns new in the master."""
        arrival = np.array([c.path.arrival for c in columns if c.path is not None], np.int64)
        first = len(self._robot)
        self._arrival = np.concatenate((self._arrival, arrival))
        self._robot = np.concatenate((self._robot, np.array([c.robot for c in columns], np.int64)))
        self._states += [self.fixing.states(column) for column in columns]
        kept = [self._is_kept(k) for k in range(first, len(self._robot))]
        self._kept = np.concatenate((self._kept, np.array(kept, np.bool_)))

    def enter(self, excluded: Excluded) -> None:
        """Goes to a node with these states excluded."""
        shape = (self.problem.horizon + 1, self.graph.n_nodes + self.problem.n_aps)
        size = shape[0] * shape[1]
        self._here = {
            i: np.unpackbits(bits, count=size).reshape(shape).astype(np.bool_)
            for i, bits in excluded.items()
        }

    def restrictions(self, decisions: tuple[Decision, ...]) -> list[Restriction]:
        """What pricing must keep to, per robot."""
        own: dict[int, list[Decision]] = {}
        for decision in decisions:
            own.setdefault(decision.robot, []).append(decision)
        return [
            restrict(i, own.get(i, []), self.graph, self.resources, self._excluded(i))
            for i in range(self.n)
        ]

    def _excluded(self, i: int) -> NDArray[np.bool_]:
        here, everywhere = self._here.get(i), self.fixing.excluded[i]
        return everywhere if here is None else everywhere | here

    def allowed(self, decisions: tuple[Decision, ...]) -> NDArray[np.bool_]:
        """(columns,) which columns keep the decisions; artificial ones always do."""
        allowed = self._kept.copy()
        for i, excluded in self._here.items():
            for k in np.flatnonzero((self._robot == i) & allowed).tolist():
                allowed[k] = self.fixing.keeps(self._states[k], excluded)
        for decision in decisions:
            mine = np.flatnonzero((self._robot == decision.robot) & allowed)
            if isinstance(decision, Arrive):
                early = self._arrival[mine] <= decision.latest
                out = (early != decision.early) & (self._arrival[mine] >= 0)
                allowed[mine[out]] = False
            else:
                for k in mine.tolist():
                    allowed[k] = decision.keeps(self.master.columns[k])
        return allowed

    def _is_kept(self, column: int) -> bool:
        return self.fixing.keeps(
            self._states[column], self.fixing.excluded[int(self._robot[column])]
        )

    def _keep_to_fixing(self) -> bool:
        kept = [self._is_kept(k) for k in range(len(self._robot))]
        before, self._kept = self._kept, np.array(kept, np.bool_)
        return bool(np.any(before & ~self._kept))

    # Each of these takes `most`, what a plan of interest costs at most [1/SCALE cost units].

    def fix(self, lp: LpSolution, most: int) -> bool:
        """Reduced-cost fixing by an LP's duals; whether columns were excluded."""
        self.fixing.exclude(most, self._load(lp))
        return self._keep_to_fixing()

    def propagate(
        self, lp: LpSolution, most: int, decisions: tuple[Decision, ...]
    ) -> tuple[int | None, bool]:
        """Excludes states everywhere that do not fit with any of another robot's.

        Returns:
            A bound (0: nothing was done; None: no plan is of interest), and whether columns were
            excluded.
        """
        if not self._one_slot or self.fixing.n_states() > MAX_STATES * self.n:
            return 0, False
        found = self._joint.propagate(self.restrictions(decisions), most, self._load(lp))
        if found is None:
            return None, True
        return found.bound, self.fixing.exclude_more(found.excluded) and self._keep_to_fixing()

    def propagate_here(
        self, lp: LpSolution, most: int, kept: list[Restriction], known: Excluded
    ) -> tuple[int | None, bool]:
        """As `propagate` at a node, for the pairs that clash most; they are added to `known`."""
        if not self._one_slot:
            return 0, False
        columns = self.master.columns
        pairs = clashing_pairs(columns, lp.x, self.resources, MAX_PAIRS)
        found = self._joint.propagate(kept, most, self._load(lp), pairs)
        if found is None:
            return None, True
        amid = np.zeros((self.problem.horizon + 1, self.problem.n_aps), np.bool_)
        mine, hit = positive_by_robot(columns, lp.x), False
        for i, out in sorted(found.excluded.items()):
            excluded = np.concatenate((out, amid), axis=1)
            hit |= any(not self.fixing.keeps(self._states[k], excluded) for k in mine[i])
            self._here[i] = excluded | self._here.get(i, excluded)
            known[i] = np.packbits(self._here[i])
        return found.bound, hit

    def _load(self, lp: LpSolution) -> int:
        """Takes an LP's duals as penalties; Σ p · capacity of them."""
        self.pricing.load(lp)
        return int(lp.penalty() @ self.master.capacity[lp.rows].astype(np.int64))
