"""PGCP, path generation with cooperative pruning: Algorithm 1 of the paper, line by line.

Tatino, Pappas, Yuan: "Multi-Robot Association-Path Planning in Millimeter-Wave Industrial
Scenarios". Symbols as there: φ_i, π_et, γ_vt and λ_at are the duals of (1b), (1c), (1d) and (1e).

Where we add to the printed algorithm it is to prove what it finds: the Lagrangian bound (§1.13).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planner.cooperative import cooperative_astar
from planner.expanded_graph import ExpandedGraph
from planner.master import LpSolution, Master
from planner.plan import Path
from planner.pricing import best_paths
from planner.problem import Problem
from planner.resources import SCALE, Resources
from planner.search import Penalties, Search

NEGATIVE = -1e-6
"""A path prices out when its reduced cost is below this (in cost units)."""

PRICED_AT_ONCE = 8
"""Robots priced between two questions whether to hurry."""


@dataclass
class PgcpState:
    """PGCP under way; what its steps share.

    Attributes:
        graph, resources, search: G' and the means to search it.
        master: the restricted master, None before path generation.
        initial: paths of the cooperative A*.
        bound: best proven lower bound, in 1/SCALE cost units.
        bound_rows, bound_penalty: the resources and penalties > 0 [1/SCALE] that prove it.
        lp_value: value of the master at the end of path generation, None if not reached.
        iterations: rounds of pricing.
        seconds: per phase.
        lp_seconds: that the last LP took.
    """

    graph: ExpandedGraph
    resources: Resources
    search: Search
    master: Master
    initial: list[Path | None] = field(default_factory=list)
    bound: int = 0
    bound_rows: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    bound_penalty: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    lp_value: float | None = None
    iterations: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    lp_seconds: float = 0.0


def artificial_cost(problem: Problem) -> float:
    """More than any real path costs: every slot until T spent, a handover in each."""
    return float((problem.c_t + problem.c_h) * problem.horizon + 1)


def pgcp(
    problem: Problem,
    *,
    stop: Callable[[PgcpState], bool] = lambda _state: False,
    hurry: Callable[[], bool] = lambda: False,
) -> tuple[list[Path | None], PgcpState]:
    """Algorithm 1.

    Args:
        problem: the instance; every robot must reach its goal when alone on the floor.
        stop: asked after every round of pricing; True ends path generation early.
        hurry: asked every few robots; True ends it at once.

    Returns:
        One path per robot (None where the artificial path stayed), and the final state.
    """
    clock = time.perf_counter()
    # 1: construct the expanded graph G'
    graph = ExpandedGraph.of(problem)
    resources = Resources.of(problem)
    search = Search(graph)
    # 3: add artificial paths to Ŝ_i (the master starts with them)
    state = PgcpState(graph, resources, search, Master(resources, artificial_cost(problem)))
    robots = range(len(problem.robot_ids))
    clock = _lap(state, "graph", clock)

    # Initial solution
    # 2: find initial paths with cooperative A* and add them to Ŝ_i
    state.initial = cooperative_astar(search, resources, robots)
    state.master.add(
        [state.master.column(i, path) for i, path in enumerate(state.initial) if path is not None]
    )
    clock = _lap(state, "cooperative", clock)

    # Path generation, 4–13
    state.lp_value = generate_paths(state, robots, stop=stop, hurry=hurry)
    clock = _lap(state, "path_generation", clock)

    # Cooperative pruning, 14–24
    chosen = cooperative_pruning(state, stop=stop, hurry=hurry)
    _lap(state, "cooperative_pruning", clock)
    return chosen, state


def generate_paths(
    state: PgcpState,
    robots: Iterable[int],
    *,
    stop: Callable[[PgcpState], bool] = lambda _state: False,
    proves_bound: bool = True,
    complete: bool = True,
    hurry: Callable[[], bool] = lambda: False,
) -> float | None:
    """Lines 4–13: adds the best path of each robot until none has a negative reduced cost.

    Args:
        state: of PGCP.
        robots: those to price; the others have their path already.
        stop: asked after every round; True ends early.
        proves_bound: whether no column was deleted yet, so that the bound holds for the problem.
        complete: whether every LP is solved over all rows, as printed, before its duals are used;
            if not, rows and columns come in together: the same end in fewer LPs.
        hurry: asked every few robots; True leaves the round as it is.

    Returns:
        Value of the master LP when nothing prices out any more [cost units]; None if `stop` ended
        it before, since the value over fewer columns bounds nothing.
    """
    robots = list(robots)
    master, search = state.master, state.search
    penalties = Penalties(state.resources)
    previous = np.empty(0, np.int64)
    while True:
        # 5, 6: solve the master; add π, γ, λ to the edge costs of G'
        began = time.perf_counter()
        lp = master.solve(complete=complete)
        state.lp_seconds = time.perf_counter() - began
        penalty = lp.penalty()
        penalties.set(previous, np.int64(0))
        penalties.set(lp.rows, penalty)
        previous = lp.rows
        use = _used_by_likely_paths(state, lp)
        # 7–12: for each robot, the shortest path on G'; into Ŝ_i if its reduced cost is negative
        phi = np.floor(lp.robot_dual[robots] * SCALE).astype(np.int64)
        limits = phi + int(NEGATIVE * SCALE)
        new, total = [], 0
        for begin in range(0, len(robots), PRICED_AT_ONCE):
            if hurry():
                return None
            some = slice(begin, begin + PRICED_AT_ONCE)
            costs, paths = best_paths(search, robots[some], penalties, limits=limits[some], use=use)
            priced = zip(robots[some], paths, strict=True)
            new += [master.column(i, path) for i, path in priced if path is not None]
            total += int(costs.sum())
        state.iterations += 1
        if proves_bound:
            # For any penalties ≥ 0, Σ_i (least penalised cost) − Σ penalty · capacity is a lower
            # bound (Lagrange). All terms are integers, so there is no rounding in it.
            capacity = state.resources.capacity[lp.rows].astype(np.int64)
            bound = total - int(penalty @ capacity)
            if bound > state.bound:
                used = penalty > 0
                state.bound, state.bound_rows = bound, lp.rows[used]
                state.bound_penalty = penalty[used]
        # 13: until no new paths are added
        if master.add(new) == 0 and lp.complete:
            return lp.value
        if stop(state):
            return None


def cooperative_pruning(
    state: PgcpState,
    *,
    stop: Callable[[PgcpState], bool] = lambda _state: False,
    hurry: Callable[[], bool] = lambda: False,
) -> list[Path | None]:
    """Lines 14–24 and section IV-C: one robot after another is left with one path.

    A robot whose MILP picks its artificial path gets new paths priced, until one is picked or none
    prices out any more (or `stop` says so); in the latter case it stays without a path.
    """
    master = state.master
    n = master.n_robots
    chosen: list[Path | None] = [None] * n
    open_robots = set(range(n))
    for i in range(n):
        while True:
            # 16, 17: construct and solve the MILP with x_is binary
            best = master.solve_integer_for(i)
            if master.columns[best].path is not None:
                # 18, 19: delete the robot's other paths
                master.keep_only(i, best)
                chosen[i] = master.columns[best].path
                break
            # 21: repeat steps 8–11
            before = len(master.columns)
            generate_paths(state, sorted(open_robots), stop=stop, proves_bound=False, hurry=hurry)
            if len(master.columns) == before or stop(state):
                master.keep_only(i, best)
                break
        open_robots.discard(i)
    return chosen


def _used_by_likely_paths(state: PgcpState, lp: LpSolution) -> NDArray[np.int32]:
    """(T+1, V) int32: vertices of the paths with x ≥ 0.5; ties in pricing avoid them."""
    problem, first_edge = state.resources.problem, state.resources.first_edge
    numbers, _ = state.master.activity((lp.x >= 0.5).astype(np.float64))
    use = np.bincount(numbers[numbers < first_edge], minlength=first_edge)
    return use.reshape(problem.horizon + 1, problem.n_vertices).astype(np.int32)


def _lap(state: PgcpState, phase: str, since: float) -> float:
    now = time.perf_counter()
    state.seconds[phase] = now - since
    return now
