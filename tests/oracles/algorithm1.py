"""The paper's Algorithm 1 (PGCP), literally: explicit G', all rows, general-purpose solvers.

Tatino, Pappas, Yuan, "Multi-Robot Association-Path Planning in Millimeter-Wave Industrial
Scenarios", IEEE Networking Letters 2020. Line numbers are those of the listing. It is the test
oracle for the master LP's value and the yardstick the planner's speed is measured by.

Where the listing leaves a choice: robots are taken in the problem's order; the artificial paths
cost more than all real paths together; steps 8 to 11 within the pruning price the robot at hand
with the master solved anew each time, until nothing is found.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import LinearConstraint, linprog, milp
from scipy.sparse import csc_array, csr_array

from planner.plan import Path, Plan
from planner.problem import Problem
from tests.oracles.expanded import (
    ExplicitGraph,
    Penalties,
    Weights,
    path_cost,
    penalties_of,
    row_capacities,
    rows_of,
    usage,
)

TOLERANCE = 1e-6
"""Reduced costs above minus this count as not negative."""


@dataclass(frozen=True)
class Algorithm1Result:
    """What Algorithm 1 found.

    Attributes:
        plan: after cooperative pruning, or the part of it there is.
        initial: the plan of cooperative A* alone (step 2), partial where it failed.
        lp_value: value of the master LP at the end of path generation.
        artificial_use: Σ of the artificial paths' variables in that LP; 0 if all are served.
        columns, rows, rounds: size of that LP, and iterations of path generation.
        seconds: wall-clock time by phase.
    """

    plan: Plan
    initial: Plan
    lp_value: float
    artificial_use: float
    columns: int
    rows: int
    rounds: int
    seconds: dict[str, float]


@dataclass(frozen=True)
class _Column:
    """One path s of Ŝ_i; the artificial one has no path and uses no row."""

    robot: int
    path: Path | None
    cost: float
    rows: np.ndarray


@dataclass
class _Master:
    """The restricted master problem: Ŝ_i for all robots, and its LP and MILPs."""

    problem: Problem
    columns: list[_Column] = field(default_factory=list)
    seen: set[tuple[object, ...]] = field(default_factory=set)

    def add(self, robot: int, path: Path | None, cost: float) -> bool:
        """Adds a path to Ŝ_i; False if it is there already."""
        key: tuple[object, ...] = (robot, None)
        rows = np.zeros(0, np.int64)
        if path is not None:
            key = (
                robot,
                *path.vertices.tolist(),
                "|",
                *path.aps.tolist(),
                "|",
                *path.edges.tolist(),
            )
            rows = np.flatnonzero(rows_of(self.problem, usage(self.problem, path)))
        if key in self.seen:
            return False
        self.seen.add(key)
        self.columns.append(_Column(robot, path, cost, rows))
        return True

    def _matrices(self) -> tuple[np.ndarray, csc_array, np.ndarray, csr_array]:
        """c, A_ub, b_ub (constraints 1c to 1e) and A_eq (1b)."""
        b_ub = row_capacities(self.problem)
        rows = np.concatenate([column.rows for column in self.columns])
        pointer = np.cumsum([0] + [len(column.rows) for column in self.columns])
        n = len(self.columns)
        A_ub = csc_array((np.ones(len(rows)), rows, pointer), shape=(len(b_ub), n))
        robots = [column.robot for column in self.columns]
        A_eq = csr_array((np.ones(n), (robots, range(n))), shape=(self.problem.n_robots, n))
        return np.array([column.cost for column in self.columns]), A_ub, b_ub, A_eq

    def solve_lp(self) -> tuple[float, np.ndarray, np.ndarray, Penalties]:
        """Value, x, φ, and (π, γ, λ) as penalties, that is with the sign turned to ≥ 0."""
        c, A_ub, b_ub, A_eq = self._matrices()
        one = np.ones(self.problem.n_robots)
        found = linprog(c, A_ub, b_ub, A_eq, one, bounds=(0, None), method="highs")
        assert found.status == 0, found.message
        penalties = penalties_of(self.problem, np.maximum(-found.ineqlin.marginals, 0.0))
        return float(found.fun), found.x, found.eqlin.marginals, penalties

    def solve_milp(self, robot: int) -> int:
        """The column robot i uses when its variables are binary and the others' continuous."""
        c, A_ub, b_ub, A_eq = self._matrices()
        found = milp(
            c,
            integrality=np.array([column.robot == robot for column in self.columns], int),
            constraints=[LinearConstraint(A_eq, 1, 1), LinearConstraint(A_ub, -np.inf, b_ub)],
        )
        assert found.status == 0, found.message
        mine = [k for k, column in enumerate(self.columns) if column.robot == robot]
        return max(mine, key=lambda k: found.x[k])

    def keep_only(self, chosen: int) -> None:
        """Deletes all other paths of the robot that uses column `chosen`."""
        robot = self.columns[chosen].robot
        self.columns = [
            column for k, column in enumerate(self.columns) if column.robot != robot or k == chosen
        ]


def algorithm1(problem: Problem, *, prune: bool = True) -> Algorithm1Result:
    """Runs Algorithm 1; without `prune` it ends after path generation."""
    clock = _Clock()
    with clock("expanded graph"):
        graph = ExplicitGraph(problem)  # step 1
    master = _Master(problem)
    with clock("initial solution"):
        initial = cooperative_a_star(graph)  # step 2
        for i, path in enumerate(initial):
            if path is not None:
                master.add(i, path, path_cost(problem, path))
        dearest = problem.horizon * (problem.c_t + problem.c_h)
        artificial = float((problem.n_robots + 1) * dearest + 1)
        for i in range(problem.n_robots):
            master.add(i, None, artificial)  # step 3

    rounds, added, robots = 0, True, range(problem.n_robots)
    while added:  # steps 4 to 13
        added, rounds = False, rounds + 1
        with clock("master"):
            lp_value, x, phi, penalties = master.solve_lp()  # steps 5 and 6
        with clock("pricing"):
            weights = graph.weigh(penalties)
            least = [_price(graph, master, i, phi, weights) for i in robots]  # steps 7 to 12
        added = any(new for new, _ in least)
    # Nothing prices out but what the tolerance hides; the bound takes that off as well (§1.13).
    bound = lp_value + sum(min(reduced_cost, 0.0) for _, reduced_cost in least)
    use = sum(x[k] for k, column in enumerate(master.columns) if column.path is None)
    sizes = len(master.columns), len(row_capacities(problem)), rounds

    paths: list[Path | None] = [None] * problem.n_robots
    added = prune
    while added:  # steps 14 to the end
        added = False
        for i in robots:
            if paths[i] is not None:
                continue
            with clock("cooperative pruning"):
                chosen = master.solve_milp(i)
                paths[i] = master.columns[chosen].path
                if paths[i] is not None:
                    master.keep_only(chosen)
                    continue
                new = True
                while new:  # steps 8 to 11
                    _, _, phi, penalties = master.solve_lp()
                    new, _ = _price(graph, master, i, phi, graph.weigh(penalties))
                    added |= new
    if not prune:
        paths = list(initial)
    seconds = dict(clock.seconds)
    plan = _answer(graph, paths, bound, lp_value, seconds)
    first = _answer(graph, initial, bound, lp_value, seconds)
    return Algorithm1Result(plan, first, lp_value, float(use), *sizes, seconds)


def _price(
    graph: ExplicitGraph, master: _Master, robot: int, phi: np.ndarray, weights: Weights
) -> tuple[bool, float]:
    """Steps 8 to 11: whether a path was added, and the least reduced cost (0 without a path)."""
    weight, path = graph.shortest_path(robot, weights)
    if path is None:
        return False, 0.0
    reduced_cost = weight - float(phi[robot])
    if reduced_cost >= -TOLERANCE:
        return False, reduced_cost
    return master.add(robot, path, path_cost(graph.problem, path)), reduced_cost


def cooperative_a_star(graph: ExplicitGraph) -> list[Path | None]:
    """Robot by robot, the cheapest path that leaves alone what those before it have reserved."""
    problem = graph.problem
    capacity = penalties_of(problem, row_capacities(problem))
    taken = Penalties.none(problem)
    paths: list[Path | None] = []
    for i in range(problem.n_robots):
        full = Penalties(
            np.where(taken.vertex >= np.maximum(capacity.vertex, 1), np.inf, 0.0),
            np.where(taken.edge >= capacity.edge, np.inf, 0.0),
            np.where(taken.ap >= capacity.ap, np.inf, 0.0),
        )
        _, path = graph.shortest_path(i, graph.weigh(full))
        paths.append(path)
        if path is not None:
            used = usage(problem, path)
            taken.vertex += used.vertex
            taken.edge += used.edge
            taken.ap += used.ap
    return paths


def _answer(
    graph: ExplicitGraph,
    paths: list[Path | None],
    bound: float,
    lp_value: float,
    seconds: dict[str, float],
) -> Plan:
    """The paths as a plan with the status they deserve (§1.12)."""
    problem = graph.problem
    cost = sum(path_cost(problem, path) for path in paths if path is not None)
    free = graph.weigh(Penalties.none(problem))
    stuck = tuple(
        problem.robot_ids[i]
        for i, path in enumerate(paths)
        if path is None and graph.shortest_path(i, free)[1] is None
    )
    # An artificial path left over is no proof; that a robot alone has no path is one.
    status = "infeasible" if stuck else "unknown"
    if None not in paths:
        status = "optimal" if math.ceil(bound - TOLERANCE) >= cost else "feasible"
    return Plan(
        status=status,
        robot_ids=problem.robot_ids,
        paths=tuple(paths),
        cost=cost,
        lower_bound=min(bound, cost) if None not in paths else bound,
        infeasible_robots=stuck,
        lp_value=lp_value,
        seconds=sum(seconds.values()),
    )


class _Clock:
    """Wall-clock seconds by phase."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, phase: str) -> Iterator[None]:
        began = time.perf_counter()
        yield
        self.seconds[phase] = self.seconds.get(phase, 0.0) + time.perf_counter() - began
