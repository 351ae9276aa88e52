"""The decoupled baseline: first the shortest motions, then the best APs for them.

What a user without joint planning would do, and the yardstick for what it gains. Motions minimise
the sum of the arrival slots as if radio reached everywhere without limit (cooperative A* with
restarts, then large neighbourhood search); they stay as they are, and get the APs with the fewest
handovers that the capacities allow (`planner.assignment`, proven best unless a limit says so).

The floor is G all the same (§1.8), without the edges that no association can cross: not even a user
of two separate tools would send robots where the radio map is blank.

Where the motions leave no room at the APs the answer is "unknown", and says where capacity is
missing: that proves nothing about other motions.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planner.assignment import Assignment, assign
from planner.cooperative import cooperative_with_restarts
from planner.expanded_graph import ExpandedGraph
from planner.improve import LargeNeighbourhoodSearch
from planner.plan import Path, Plan
from planner.problem import Problem
from planner.resources import Resources
from planner.search import Search

BATCH = 100
"""Neighbourhoods between two looks at the clock."""

SHOWN = 5
"""Overloads and robots that a message lists."""

OnPhase = Callable[[str, int, int], None]
"""Told the phase, how many robots have a path, and their cost."""


@dataclass(frozen=True)
class Motions:
    """Collision-free motions.

    Attributes:
        paths: per robot; their APs mean nothing.
        slots: sum of the arrival slots of those there are.
        bound: no motions of all robots have a smaller sum.
    """

    paths: tuple[Path | None, ...]
    slots: int
    bound: int


def decoupled(
    problem: Problem,
    *,
    seed: int = 0,
    restarts: int = 20,
    iterations: int = 3000,
    max_nodes: int = 100_000,
    time_limit: float | None = None,
    stop: Callable[[], bool] = lambda: False,
    on_phase: OnPhase = lambda _phase, _served, _cost: None,
) -> Plan:
    """Plans motions first and APs after.

    Args:
        problem: the instance.
        seed: of the random choices.
        restarts: further orders tried by cooperative A* while a robot finds no way.
        iterations: neighbourhoods tried to shorten the motions.
        max_nodes: of the branch and bound over AP assignments.
        time_limit: seconds; half of it at most goes into the motions.
        stop: asked now and then; True ends the motions, and leaves a moment for the APs.
        on_phase: told how far it is.

    Returns:
        "feasible" with the bound Σ_i (least cost of robot i alone) of the joint problem, "optimal"
        where the cost meets it; "infeasible" if a robot cannot arrive even alone; "unknown" with a
        message where motions or APs are missing. `solver` holds `motion_slots`, `motion_bound`,
        `assignment_handovers` and `assignment_bound`: by how much each half may fall short of its
        own optimum.
    """
    begin = time.perf_counter()
    alone = Search(ExpandedGraph.of(problem))
    robots = range(problem.n_robots)
    lost = tuple(problem.robot_ids[i] for i in robots if not alone.can_arrive(i))
    if lost:
        return Plan(
            status="infeasible",
            robot_ids=problem.robot_ids,
            paths=(None,) * problem.n_robots,
            cost=0,
            lower_bound=None,
            infeasible_robots=lost,
            message="they cannot reach their goals in time even alone on the floor",
            seconds=time.perf_counter() - begin,
        )
    bound = sum(alone.least_cost(i) for i in robots)

    def half_time() -> bool:
        late = time_limit is not None and time.perf_counter() - begin >= time_limit / 2
        return late or stop()

    motions = shortest_motions(
        problem,
        seed=seed,
        restarts=restarts,
        iterations=iterations,
        stop=half_time,
        on_phase=on_phase,
    )
    middle = time.perf_counter()
    on_phase("AP assignment", sum(p is not None for p in motions.paths), motions.slots)
    left = None if time_limit is None else max(time_limit - (middle - begin), 0.01)
    if stop():
        left = 0.01 if left is None else min(left, 0.01)
    assignment = assign(problem, motions.paths, max_nodes=max_nodes, time_limit=left)
    paths = tuple(
        None if motion is None or aps is None else replace(motion, aps=aps)
        for motion, aps in zip(motions.paths, assignment.aps, strict=True)
    )
    cost = sum(problem.c_t * p.arrival + problem.c_h * p.handovers for p in paths if p is not None)
    on_phase("AP assignment", sum(p is not None for p in paths), cost)
    complete = all(p is not None for p in paths)
    end = time.perf_counter()
    return Plan(
        status="unknown" if not complete else "optimal" if cost <= bound else "feasible",
        robot_ids=problem.robot_ids,
        paths=paths,
        cost=cost,
        lower_bound=float(bound),
        message=_message(problem, motions, assignment),
        seconds=end - begin,
        solver={
            "motion_slots": motions.slots,
            "motion_bound": motions.bound,
            "assignment_handovers": assignment.handovers,
            "assignment_bound": assignment.bound,
            "seconds_motions": middle - begin,
            "seconds_assignment": end - middle,
        },
    )


def shortest_motions(
    problem: Problem,
    *,
    seed: int,
    restarts: int,
    iterations: int,
    stop: Callable[[], bool] = lambda: False,
    on_phase: OnPhase = lambda _phase, _served, _cost: None,
) -> Motions:
    """Collision-free motions with a small sum of arrival slots, APs disregarded.

    Args:
        problem: the instance; its costs, APs and capacities do not matter.
        seed, restarts, iterations: as `decoupled`.
        stop: asked now and then; True ends it.
        on_phase: told how far it is.

    Returns:
        Paths with the edges' indices of `problem`.
    """
    bare, edge_of = without_radio(problem)
    graph = ExpandedGraph.of(bare)
    search, resources = Search(graph), Resources.of(bare)
    n = bare.n_robots
    bound = sum(search.least_cost(i) for i in range(n))
    on_phase("motions", 0, 0)
    paths = cooperative_with_restarts(
        search,
        resources,
        restarts=restarts,
        rng=np.random.default_rng([seed, 1]),
        stop=stop,
    )
    neighbourhoods = LargeNeighbourhoodSearch(search, resources, paths, seed=seed)
    done = 0
    while done < iterations and neighbourhoods.cost > bound and not stop():
        batch = min(BATCH, iterations - done)
        neighbourhoods.run(batch)
        done += batch
        paths = neighbourhoods.paths()
        served = [p for p in paths if p is not None]
        on_phase("motions", len(served), sum(p.arrival for p in served))
    return Motions(
        tuple(None if p is None else replace(p, edges=_renamed(p, edge_of)) for p in paths),
        sum(p.arrival for p in paths if p is not None),
        bound,
    )


def without_radio(problem: Problem) -> tuple[Problem, NDArray[np.int32]]:
    """The problem with one AP that covers everything and serves everybody, cost = slots.

    Returns:
        That problem, and the edge of `problem` that each of its edges is: those that no
        association can cross are not in it.
    """
    crossable = problem.edge_cover.any(axis=1) | problem.edge_handover.any(axis=(1, 2))
    kept = np.flatnonzero(crossable).astype(np.int32)
    V = problem.n_vertices
    bare = replace(
        problem,
        objective="costs",
        c_t=1,
        c_h=0,
        ap_ids=("everywhere",),
        ap_capacity=np.array([problem.n_robots], np.int32),
        cover=np.ones((V, 1), np.bool_),
        snr_db=np.full((V, 1), np.nan),
        edge_uv=problem.edge_uv[kept],
        edge_slots=problem.edge_slots[kept],
        edge_oneway=problem.edge_oneway[kept],
        edge_cover=np.ones((len(kept), 1), np.bool_),
        edge_handover=np.zeros((len(kept), 1, 1), np.bool_),
    )
    return bare, kept


def _renamed(path: Path, edge_of: NDArray[np.int32]) -> NDArray[np.int32]:
    """Its edges as the full problem counts them."""
    crossing = path.edges >= 0
    edges = np.full(len(path.edges), -1, np.int32)
    edges[crossing] = edge_of[path.edges[crossing]]
    return edges


def _message(problem: Problem, motions: Motions, assignment: Assignment) -> str:
    """What is missing, or how good both halves are; empty if nothing is to be said."""
    parts = []
    lost = [problem.robot_ids[i] for i, p in enumerate(motions.paths) if p is None]
    if lost:
        parts.append(f"{_listed(lost)} found no way around the others; allow more iterations")
    if assignment.stuck:
        where = [
            f"{problem.robot_ids[i]} after slot {t} at vertex {motions.paths[i].vertices[t]}"  # type: ignore[union-attr]
            for i, t in assignment.stuck
        ]
        parts.append(f"no AP can follow on their shortest ways: {_listed(where)}")
    if assignment.overloads:
        where = []
        for o in assignment.overloads:
            slots = f"slot {o.first}" if o.first == o.last else f"slots {o.first} to {o.last}"
            most = "" if o.first == o.last else "up to "
            ap, m = problem.ap_ids[o.ap], int(problem.ap_capacity[o.ap])
            where.append(f"{ap} ({most}{o.load} robots for {m} places) in {slots}")
        parts.append(
            "the shortest motions leave no AP assignment within capacity, "
            f"however it is done: places are missing at {_listed(where)}"
        )
    served = sum(a is not None for a in assignment.aps)
    placeless = len(motions.paths) - len(lost) - len(assignment.stuck) - served
    if placeless and not assignment.overloads:
        parts.append(f"{placeless} robots got no AP within the limit of the search")
    if parts:
        return "; ".join(parts) + "; joint planning (method auto) may find a way"
    if assignment.bound < assignment.handovers:
        return (
            f"the AP assignment may not be the best for these motions: {assignment.handovers} "
            f"handovers, proven is that {assignment.bound} are needed"
        )
    return ""


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + more
