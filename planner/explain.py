"""Why there is no plan, in the terms of the hall, and how much more would be enough.

Three reasons are told apart, each with its proof: a robot that cannot reach its goal in time even
alone; two robots that cannot get past each other; and a bottleneck, the places and APs in which the
robots together need more room than there is (phase 1, §1.12).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np

from planner import kernels
from planner.ap_room import prove_no_room
from planner.expanded_graph import ExpandedGraph
from planner.explanation import (
    AloneFault,
    Bottleneck,
    BottleneckPart,
    Explanation,
    PairFault,
)
from planner.least_room import Decider, Least, least_capacity, least_horizon
from planner.passing import NEVER, Passing
from planner.phase_one import InfeasibilityProof, prove_infeasible
from planner.plan import Plan
from planner.prices import place
from planner.problem import Problem
from planner.resources import SCALE, Resources
from planner.search import INFINITE, Search

MAX_PAIRS = 120
"""Pairs of robots that are tried for getting past each other."""

OnStep = Callable[[str], None]


def explain(
    problem: Problem,
    plan: Plan,
    *,
    seed: int = 0,
    iterations: int = 2000,
    stop: Callable[[], bool] = lambda: False,
    on_step: OnStep = lambda _text: None,
) -> Explanation:
    """Why a plan serves not all robots. Deterministic by seed and iterations unless stopped.

    Args:
        problem: what was asked.
        plan: the planner's answer to it.
        seed: of the random choices in searching for plans.
        iterations: neighbourhoods tried per candidate of horizon or capacity.
        stop: asked now and then; True ends the search for the least horizon and capacity.
        on_step: told what is being done.
    """
    if not plan.unserved and plan.status in {"optimal", "feasible"}:
        return Explanation("served", problem)
    graph = ExpandedGraph.of(problem)
    search, resources = Search(graph), Resources.of(problem)

    on_step("robots alone")
    alone = _alone(graph)
    on_step("pairs of robots")
    pairs = () if alone else _pairs(problem, plan)
    decider = Decider(seed=seed, iterations=iterations, stop=stop)
    bottleneck, proof = None, None
    if not alone:
        on_step("bottleneck")
        known = [(i, path) for i, path in enumerate(plan.paths) if path is not None]
        proof = prove_no_room(resources)
        if proof is None:
            proof = prove_infeasible(search, resources, known, stop=stop)
        if proof is not None:
            bottleneck = _bottleneck(resources, proof)
        elif not stop():
            decider.note_relaxed(problem)

    def decide(candidate: Problem) -> bool | None:
        aps, horizon = np.unique(candidate.ap_capacity), candidate.horizon
        on_step(f"is there a plan with {horizon} slots and AP capacity {', '.join(map(str, aps))}")
        return decider(candidate)

    status = "infeasible" if alone or pairs or proof is not None else plan.status
    if status != "infeasible":
        answer = decide(problem)
        status = {True: "feasible", False: "infeasible", None: "unknown"}[answer]
    if status == "feasible":
        return Explanation(status, problem)
    needs = [fault.least_slots for fault in alone] + [fault.least_slots for fault in pairs]
    return Explanation(
        status,
        problem,
        alone,
        pairs,
        bottleneck,
        _least_horizon(problem, status, needs, proof, resources, decide),
        _least_capacity(problem, status, needs, decide),
    )


# --- reasons --------------------------------------------------------------------------------------


def _alone(graph: ExpandedGraph) -> tuple[AloneFault, ...]:
    """The robots whose shortest way takes more than T slots, or that have none."""
    problem = graph.problem
    ptr, arc = graph.reversed_arcs
    slots = graph.arc_slots.astype(np.int64)
    faults = []
    for i, robot in enumerate(problem.robot_ids):
        start, goal = int(problem.start[i]), int(problem.goal[i])
        to_goal = kernels.distances(
            ptr, arc, graph.arc_from, slots, graph.nodes_at(goal), graph.n_nodes
        )
        least = int(to_goal[graph.nodes_at(start)].min(initial=INFINITE))
        if least <= problem.horizon:
            continue
        way = f"{robot}: from {place(problem, start)} to {place(problem, goal)}"
        if least < INFINITE:
            text = f"takes at least {least} slots even alone; the horizon is {problem.horizon}"
            faults.append(AloneFault(robot, least, f"{way} {text}"))
        elif goal in _reached(problem, start):
            text = "there is a way on the floor, but no APs that hand the robot on along it (§1.7)"
            faults.append(AloneFault(robot, None, f"{way} {text}"))
        else:
            text = "there is no way on the covered floor: they lie in parts that nothing joins"
            faults.append(AloneFault(robot, None, f"{way} {text}"))
    return tuple(faults)


def _reached(problem: Problem, start: int) -> set[int]:
    """The vertices reached from a start along edges, whatever APs cover them."""
    after: dict[int, list[int]] = {}
    for (u, v), oneway in zip(problem.edge_uv.tolist(), problem.edge_oneway.tolist(), strict=True):
        after.setdefault(u, []).append(v)
        if not oneway:
            after.setdefault(v, []).append(u)
    seen, front = {start}, [start]
    while front:
        front = sorted({w for v in front for w in after.get(v, ())} - seen)
        seen.update(front)
    return seen


def _pairs(problem: Problem, plan: Plan) -> tuple[PairFault, ...]:
    """Pairs that cannot get past each other in time; those with a robot left out come first."""
    passing = Passing(problem)
    if not passing.applies:
        return ()
    index = {robot: i for i, robot in enumerate(problem.robot_ids)}
    left_out = {index[robot] for robot in plan.unserved}
    named = {index[robot] for robot in plan.infeasible_robots}
    order = sorted(
        combinations(range(problem.n_robots), 2),
        key=lambda pair: (-len(left_out & set(pair)), -len(named & set(pair)), pair),
    )
    faults = []
    for i, j in order[:MAX_PAIRS]:
        least = passing.least_horizon(i, j)
        if 0 <= least <= problem.horizon:
            continue
        a, b = problem.robot_ids[i], problem.robot_ids[j]
        ways = " and ".join(
            f"{name} ({place(problem, int(problem.start[k]))} to "
            f"{place(problem, int(problem.goal[k]))})"
            for name, k in ((a, i), (b, j))
        )
        if least == NEVER:
            text = f"{ways} cannot get past each other, however long they take"
        else:
            text = f"{ways} need at least {least} slots to get past each other; "
            text += f"the horizon is {problem.horizon}"
        faults.append(PairFault((a, b), None if least == NEVER else least, text))
    return tuple(faults)


def _bottleneck(resources: Resources, proof: InfeasibilityProof) -> Bottleneck:
    """The proof's resources gathered by place."""
    problem = resources.problem
    weight = np.zeros(resources.n, np.int64)
    weight[proof.resources] = proof.penalty
    names: tuple[tuple[str, Callable[[int], str]], ...] = (
        ("position", lambda v: f"position {place(problem, v)}"),
        ("way", lambda e: "way " + "–".join(place(problem, v) for v in problem.edge_uv[e])),
        ("ap", lambda a: f"AP {problem.ap_ids[a]}"),
    )
    parts = []
    for (kind, name), table in zip(names, resources.shaped(weight), strict=True):
        for k in np.flatnonzero(table.any(axis=0)).tolist():
            capacity = int(problem.ap_capacity[k]) if kind == "ap" else 1
            share = int(table[:, k].sum()) * capacity / max(proof.room, 1)
            slots = _ranges(np.flatnonzero(table[:, k]).tolist())
            parts.append(BottleneckPart(kind, name(k), k, capacity, slots, share))
    parts.sort(key=lambda part: -part.share)
    robots = tuple(problem.robot_ids[i] for i in proof.robots)
    return Bottleneck(robots, proof.need / SCALE, proof.room / SCALE, tuple(parts))


def _ranges(slots: list[int]) -> tuple[tuple[int, int], ...]:
    """[3, 4, 5, 9] as ((3, 5), (9, 9))."""
    ranges: list[tuple[int, int]] = []
    for t in slots:
        if ranges and ranges[-1][1] == t - 1:
            ranges[-1] = (ranges[-1][0], t)
        else:
            ranges.append((t, t))
    return tuple(ranges)


# --- remedies -------------------------------------------------------------------------------------


def _least_horizon(
    problem: Problem,
    status: str,
    needs: list[int | None],
    proof: InfeasibilityProof | None,
    resources: Resources,
    decide: Callable[[Problem], bool | None],
) -> Least:
    T = problem.horizon
    needed = [slots for slots in needs if slots is not None]
    above = max([T if status == "infeasible" else 0, *(slots - 1 for slots in needed)])
    # A bottleneck in slot 0 is one of where the robots start: time does not heal it.
    at_start = proof is not None and bool((_slot_of(resources, proof.resources) == 0).all())
    if None in needs or at_start:
        return Least(above + 1, None, above, never=True)
    return least_horizon(problem, above, decide, undecided=() if status == "infeasible" else (T,))


def _slot_of(resources: Resources, index: np.ndarray) -> np.ndarray:
    """The slots of resources."""
    problem = resources.problem
    V, E, A = problem.n_vertices, problem.n_edges, problem.n_aps
    vertex, edge = resources.first_edge, resources.first_ap
    return np.where(
        index < vertex,
        index // V,
        np.where(index < edge, (index - vertex) // max(E, 1), (index - edge) // A),
    )


def _least_capacity(
    problem: Problem,
    status: str,
    needs: list[int | None],
    decide: Callable[[Problem], bool | None],
) -> Least:
    n = problem.n_robots
    if needs:  # these reasons leave the APs' capacities out of account
        return Least(n + 1, None, n, never=True)
    least, most = int(problem.ap_capacity.min()), int(problem.ap_capacity.max())
    if status == "infeasible":
        return least_capacity(problem, least, decide)
    return least_capacity(problem, 0, decide, undecided=(least,) if least == most else ())
