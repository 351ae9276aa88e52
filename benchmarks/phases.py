"""What is timed on a case. A phase takes a problem and returns figures; the caller adds seconds."""

from __future__ import annotations

import time
from collections.abc import Callable

from planner.check import check_plan
from planner.expanded_graph import ExpandedGraph
from planner.master import Master
from planner.pgcp import PgcpState, artificial_cost, generate_paths
from planner.plan import Plan
from planner.problem import Problem
from planner.resources import Resources
from planner.search import Search, static_distances
from planner.solve import Progress, SolveParams, solve

Figures = dict[str, float | int | str | None]


def plan_figures(problem: Problem, plan: Plan, seconds_to: dict[str, float]) -> Figures:
    """Outcome of a plan; it must pass the independent checker."""
    wrong = check_plan(problem, plan)
    if wrong:
        raise AssertionError(f"{problem.name}: the plan breaks {wrong[0].rule}: {wrong[0].message}")
    served = len(plan.robot_ids) - len(plan.unserved)
    return {
        "status": plan.status,
        "cost": plan.cost if not plan.unserved else None,
        "bound": plan.lower_bound,
        "lp_value": plan.lp_value,
        "gap": plan.gap,
        "served_share": served / len(plan.robot_ids),
        "handovers": plan.handovers,
        "slots": plan.slots,
        "columns": plan.solver.get("columns"),
        "rows": plan.solver.get("rows"),
        **seconds_to,
    }


def _solving(
    method: str, time_limit: float | None, gap: float = 0.0
) -> Callable[[Problem], Figures]:
    def phase(problem: Problem) -> Figures:
        began = time.perf_counter()
        reached: dict[str, float] = {}

        def watch(progress: Progress) -> None:
            now = time.perf_counter() - began
            if progress.served < problem.n_robots:
                return
            reached.setdefault("seconds_to_plan", now)
            for share in (0.02, 0.01):
                if progress.cost <= (1 + share) * progress.bound:
                    reached.setdefault(f"seconds_to_{share:.0%}", now)

        params = SolveParams(method=method, time_limit=time_limit, gap=gap)  # type: ignore[arg-type]
        return plan_figures(problem, solve(problem, params, watch), reached)

    return phase


def distances(problem: Problem) -> Figures:
    """Static distances to every goal: the A* heuristic."""
    graph = ExpandedGraph.of(problem)
    static_distances(graph)
    return {"expanded_vertices": graph.n_expanded_vertices}


def path_generation(problem: Problem) -> Figures:
    """Lines 1 to 13 of Algorithm 1: from cooperative A* to the LP's optimum."""
    from planner.cooperative import cooperative_astar

    graph = ExpandedGraph.of(problem)
    resources, search = Resources.of(problem), Search(graph)
    state = PgcpState(graph, resources, search, Master(resources, artificial_cost(problem)))
    paths = cooperative_astar(search, resources, range(problem.n_robots))
    state.master.add([state.master.column(i, p) for i, p in enumerate(paths) if p is not None])
    value = generate_paths(state, range(problem.n_robots), complete=False)
    return {
        "lp_value": value,
        "columns": len(state.master.columns),
        "rows": state.master.n_rows,
        "rounds": state.iterations,
    }


def yardstick(problem: Problem) -> Figures:
    """The same by the literal Algorithm 1 of the tests: explicit G', all rows, scipy."""
    from tests.oracles.algorithm1 import algorithm1

    result = algorithm1(problem, prune=False)
    return {"lp_value": result.lp_value, "columns": result.columns, "rounds": result.rounds}


PHASES: dict[str, Callable[[Problem], Figures]] = {
    "distances": distances,
    "path_generation": path_generation,
    "yardstick": yardstick,
    "cooperative": _solving("cooperative", None),
    "pgcp": _solving("pgcp", 120.0),
    "decide": _solving("auto", 10.0, 0.02),
    "auto": _solving("auto", 10.0),
    "auto60": _solving("auto", 60.0),
    "decoupled": _solving("decoupled", 30.0),
}
