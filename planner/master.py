"""The restricted master problem of PGCP as an LP in HiGHS (paper, eqs. 1a–1e relaxed).

Columns are paths, one artificial path per robot among them. Of the rows, only those of the robots
(1b) are there from the start; a resource's row (1c–1e) enters when a solution violates it, which is
a few hundred of tens of thousands. HiGHS keeps its basis across all these changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import highspy
import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.plan import Path
from planner.resources import SCALE, Resources

VIOLATED = 1e-6
"""A row is added when its activity exceeds its capacity by this much."""


@dataclass(frozen=True)
class Column:
    """A path in the master.

    Attributes:
        robot: its index.
        path: the path; None for the artificial one.
        cost: in cost units (§1.9).
        used: resources it uses.
    """

    robot: int
    path: Path | None
    cost: float
    used: NDArray[np.int64]


@dataclass(frozen=True)
class LpSolution:
    """An optimal solution of the master LP over all resource rows and the columns there are.

    Attributes:
        value: objective [cost units].
        x: (columns,) float64.
        robot_dual: (N,) float64, φ_i.
        rows: indices of the resources that have a row.
        row_dual: their duals π, γ, λ ≤ 0, same order.
        reduced_cost: (columns,) float64.
        complete: no resource row is violated; the value is the master's.
    """

    value: float
    x: NDArray[np.float64]
    robot_dual: NDArray[np.float64]
    rows: NDArray[np.int64]
    row_dual: NDArray[np.float64]
    reduced_cost: NDArray[np.float64]
    complete: bool = True

    def penalty(self) -> NDArray[np.int64]:
        """−π, −γ, −λ as penalties ≥ 0 [1/SCALE cost units], same order as `rows`."""
        penalty: NDArray[np.int64] = np.rint(np.maximum(-self.row_dual, 0.0) * SCALE).astype(
            np.int64
        )
        return penalty


class Master:
    """The restricted master: columns in, rows as violated, duals out."""

    def __init__(self, resources: Resources, artificial_cost: float) -> None:
        self.resources = resources
        self.n_robots = len(resources.problem.robot_ids)
        self.artificial_cost = artificial_cost
        self.columns: list[Column] = []
        self.lp_solves = 0
        self._upper: list[float] = []
        self._keys: set[tuple[int, bytes, bytes, bytes]] = set()
        # Cuts are numbered on from the resources, and are rows "activity ≤ capacity" as they are.
        self.capacity: NDArray[np.int32] = resources.capacity
        self._row_of = np.full(resources.n, -1, np.int64)
        # Between uses all 0, and all −1.
        self._activity, self._which = np.zeros(resources.n), np.full(resources.n, -1, np.int64)
        self._rows: list[int] = []
        self._used = np.empty(1 << 14, np.int64)  # resources of all columns, end to end
        self._user = np.empty(1 << 14, np.int64)  # and the column each belongs to
        self._n_used = 0
        self._hash_rng = np.random.default_rng(0)
        self._column_hash = self._hash_rng.integers(0, 1 << 62, 1024, np.int64)
        self._highs = highspy.Highs()  # type: ignore[no-untyped-call]
        for option, value in (
            ("output_flag", False),
            ("threads", 1),
            ("presolve", "off"),
            ("random_seed", 0),
        ):
            self._highs.setOptionValue(option, value)
        empty = np.empty(0)
        nothing = np.empty(0, np.int32)
        ones = np.ones(self.n_robots)
        self._highs.addRows(
            self.n_robots, ones, ones, 0, np.zeros(self.n_robots, np.int32), nothing, empty
        )
        none_used = np.empty(0, np.int64)
        self.add([Column(i, None, artificial_cost, none_used) for i in range(self.n_robots)])

    @property
    def n_rows(self) -> int:
        """Rows in the LP, the robots' among them."""
        return self.n_robots + len(self._rows)

    def column(self, robot: int, path: Path) -> Column:
        """The column of a path."""
        problem = self.resources.problem
        cost = problem.c_t * path.arrival + problem.c_h * path.handovers
        return Column(robot, path, float(cost), self.resources.used_by(path))

    def add(self, columns: list[Column]) -> int:
        """Adds columns that are not there yet, in one call; returns how many were new."""
        fresh = []
        for column in columns:
            path = column.path
            if path is not None:
                # Edges too: parallel ones give paths of the same states.
                key = (
                    column.robot,
                    path.vertices.tobytes(),
                    path.aps.tobytes(),
                    path.edges.tobytes(),
                )
                if key in self._keys:
                    continue
                self._keys.add(key)
            fresh.append(column)
        if not fresh:
            return 0
        starts, index = np.empty(len(fresh), np.int32), []
        filled = 0
        for k, column in enumerate(fresh):
            rows = self._row_of[column.used]
            entries = np.concatenate(([column.robot], rows[rows >= 0])).astype(np.int32)
            starts[k] = filled
            filled += len(entries)
            index.append(entries)
            self._remember(len(self.columns) + k, column.used)
        self._highs.addCols(
            len(fresh),
            np.array([c.cost for c in fresh]),
            np.zeros(len(fresh)),
            np.full(len(fresh), highspy.kHighsInf),
            filled,
            starts,
            np.concatenate(index),
            np.ones(filled),
        )
        self.columns += fresh
        self._upper += [np.inf] * len(fresh)
        return len(fresh)

    def _remember(self, column: int | NDArray[np.int64], used: NDArray[np.int64]) -> None:
        while self._n_used + len(used) > len(self._used):
            self._used = np.concatenate((self._used, np.empty_like(self._used)))
            self._user = np.concatenate((self._user, np.empty_like(self._user)))
        end = self._n_used + len(used)
        self._used[self._n_used : end] = used
        self._user[self._n_used : end] = column
        self._n_used = end

    def solve(self, *, complete: bool = True) -> LpSolution:
        """Solves the LP.

        Args:
            complete: whether to go on until no resource row is violated. If not, rows that are
                violated are added, but count from the next call on; `LpSolution.complete` tells.
        """
        lp = self.try_solve(complete=complete)
        if lp is None:
            raise PlannerError("the master LP has no solution although artificial paths are in it")
        return lp

    def try_solve(self, cutoff: float = np.inf, *, complete: bool = True) -> LpSolution | None:
        """As `solve`, but None if there is no solution, or none of a value below `cutoff`."""
        while True:
            if not self._run(cutoff):
                return None
            solution = self._highs.getSolution()
            x = np.asarray(solution.col_value, np.float64)
            dual = np.asarray(solution.row_dual, np.float64)
            value = float(self._highs.getInfo().objective_function_value)
            rows = np.array(self._rows, np.int64)
            violated = self._add_violated_rows(x)
            if not violated or not complete:
                break
        if value >= cutoff:
            return None  # HiGHS need not notice, when its basis was optimal already
        return LpSolution(
            value,
            x,
            dual[: self.n_robots].copy(),
            rows,
            dual[self.n_robots :].copy(),
            np.asarray(solution.col_dual, np.float64),
            complete=not violated,
        )

    def _run(self, cutoff: float) -> bool:
        """Runs HiGHS; False if the LP has no solution below the cutoff."""
        optimal = highspy.HighsModelStatus.kOptimal
        infeasible = (
            highspy.HighsModelStatus.kInfeasible,
            highspy.HighsModelStatus.kObjectiveBound,
        )
        self._highs.setOptionValue("objective_bound", cutoff)
        self._highs.run()
        self.lp_solves += 1
        status = self._highs.getModelStatus()
        if status not in (optimal, *infeasible):
            # A warm start can cycle after many changes; from scratch it does not.
            self._highs.clearSolver()
            self._highs.run()
            status = self._highs.getModelStatus()
            if status not in (optimal, *infeasible):
                raise PlannerError(f"HiGHS ended the master LP with {status}; please report this")
        return bool(status == optimal)

    def activity(self, x: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Resources and cuts that columns of x > 0 use, once for each, and that column's x."""
        user = self._user[: self._n_used]
        active = np.flatnonzero(x[user] > 1e-9)
        return self._used[active], x[user[active]]

    def _add_violated_rows(self, x: NDArray[np.float64]) -> bool:
        used, user = self._used[: self._n_used], self._user[: self._n_used]
        numbers, shares = self.activity(x)
        # Of millions of resources a few thousand are used: nothing here takes time for the others.
        np.add.at(self._activity, numbers, shares)
        over = self._activity[numbers] > self.capacity[numbers] + VIOLATED
        self._activity[numbers] = 0.0
        violated = np.unique(numbers[over])
        violated = violated[self._row_of[violated] < 0]
        if not len(violated):
            return False
        violated = self._without_twins(violated, used, user)
        first = len(self._rows)
        self._row_of[violated] = self.n_robots + first + np.arange(len(violated))
        self._rows += violated.tolist()
        entry_row = self._row_of[used] - self.n_robots - first
        mine = entry_row >= 0
        rows, cols = entry_row[mine], user[mine]
        order = np.lexsort((cols, rows))
        starts = np.searchsorted(rows[order], np.arange(len(violated))).astype(np.int32)
        self._highs.addRows(
            len(violated),
            np.full(len(violated), -highspy.kHighsInf),
            self.capacity[violated].astype(np.float64),
            len(order),
            starts,
            cols[order].astype(np.int32),
            np.ones(len(order)),
        )
        return True

    def _without_twins(
        self, rows: NDArray[np.int64], used: NDArray[np.int64], user: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Of rows that hold the same columns only the first: the others say nothing more yet.

        A robot crossing a one-lane passage uses vertices and edges in lockstep, so such twins are
        common, and the LP is the faster the less degenerate it is.
        """
        self._which[rows] = np.arange(len(rows))
        member = self._which[used]
        self._which[rows] = -1
        there = member >= 0
        while len(self._column_hash) < len(self.columns) + 1:
            more = self._hash_rng.integers(0, 1 << 62, len(self._column_hash), np.int64)
            self._column_hash = np.concatenate((self._column_hash, more))
        # Sums of random 62-bit words tell sets of columns apart; a clash only delays a row.
        key = np.zeros(len(rows), np.int64)
        np.add.at(key, member[there], self._column_hash[user[there]])
        capacity = self.capacity[rows]
        _, first = np.unique(np.stack((key, capacity)), axis=1, return_index=True)
        kept: NDArray[np.int64] = rows[np.sort(first)]
        return kept

    def add_cuts(
        self, capacity: NDArray[np.int32], members: list[NDArray[np.int64]]
    ) -> NDArray[np.int64]:
        """Makes cuts known: valid rows Σ x over members ≤ capacity that are no resource's.

        Like a resource's, a cut's row enters the LP when a solution violates it. A column added
        later says by the cut's number in `Column.used` that it is a member.

        Args:
            capacity: (k,) right-hand sides.
            members: columns with coefficient 1, per cut.

        Returns:
            (k,) their numbers, on from `resources.n`.
        """
        first = len(self.capacity)
        self.capacity = np.concatenate((self.capacity, capacity.astype(np.int32)))
        none = np.full(len(capacity), -1, np.int64)
        self._row_of = np.concatenate((self._row_of, none))
        self._which = np.concatenate((self._which, none))
        self._activity = np.concatenate((self._activity, np.zeros(len(capacity))))
        ids = first + np.arange(len(capacity))
        for k, columns in zip(ids.tolist(), members, strict=True):
            self._remember(columns, np.full(len(columns), k))
        return ids

    def allow(self, allowed: NDArray[np.bool_]) -> None:
        """Fixes the columns that are not allowed at 0 and frees the others."""
        upper = np.where(allowed, np.inf, 0.0)
        changed = np.flatnonzero(upper != np.array(self._upper)).astype(np.int32)
        if len(changed):
            self._highs.changeColsBounds(
                len(changed), changed, np.zeros(len(changed)), upper[changed]
            )
            self._upper = upper.tolist()

    def set_cost(self, column: int, cost: float) -> None:
        """Changes the cost of an artificial column."""
        self._highs.changeColCost(column, cost)

    def columns_of(self, robot: int) -> list[int]:
        """Indices of a robot's columns, the artificial one among them."""
        return [k for k, c in enumerate(self.columns) if c.robot == robot]

    def solve_integer_for(self, robot: int) -> int:
        """The MILP of section IV-C: this robot's columns binary, all others continuous.

        Exactly one of its columns is 1 in a solution, so the MILP is the best of one LP per column
        (section IV-D). A column whose LP cannot beat the best one found, by its reduced cost, is
        left out; the LPs start from one another's basis.

        Returns:
            The index of the column that is 1 in an optimal solution (of equals the first).
        """
        lp = self.solve()
        mine = np.array(self.columns_of(robot), np.int32)
        mine = mine[[self._upper[k] > 0 for k in mine]]
        order = mine[np.argsort(-lp.x[mine], kind="stable")]
        if lp.x[order[0]] > 1 - 1e-6:
            return int(order[0])  # the LP's optimum is integer for this robot: it is the MILP's
        reduced = lp.reduced_cost[order]
        basis = self._highs.getBasis()
        best, best_value = -1, np.inf
        for k, rc in zip(order.tolist(), reduced.tolist(), strict=True):
            if lp.value + rc > best_value - 1e-7:
                continue
            self._highs.changeColBounds(k, 1.0, 1.0)
            # None if it collides with paths already chosen, or cannot beat the best one.
            with_k = self.try_solve(cutoff=best_value)
            self._highs.changeColBounds(k, 0.0, highspy.kHighsInf)
            if with_k is not None and with_k.value < best_value - 1e-7:
                best, best_value = k, with_k.value
            # The LP's own basis stays dual feasible under any bound; rows new since are slack.
            new_rows = self.n_rows - len(basis.row_status)
            basis.row_status = [
                *basis.row_status,
                *[highspy.HighsBasisStatus.kBasic] * new_rows,
            ]
            self._highs.setBasis(basis)
        return best

    def keep_only(self, robot: int, column: int) -> None:
        """Deletes (fixes at 0) all other columns of a robot."""
        for k in self.columns_of(robot):
            if k != column:
                self._highs.changeColBounds(k, 0.0, 0.0)
                self._upper[k] = 0.0
