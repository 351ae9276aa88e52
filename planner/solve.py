"""`solve`: from a problem to a plan with a proof (§1.12–§1.15)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from planner.companion import Companion
from planner.cooperative import cooperative_with_restarts
from planner.expanded_graph import ExpandedGraph
from planner.improve import LargeNeighbourhoodSearch
from planner.least_prices import least_penalties
from planner.master import Master
from planner.parallel import n_threads
from planner.pgcp import (
    PgcpState,
    artificial_cost,
    cooperative_pruning,
    generate_paths,
    pgcp,
)
from planner.phase_one import prove_infeasible
from planner.plan import Path, Plan
from planner.prices import Prices, prices_of
from planner.problem import Problem
from planner.resources import SCALE, Resources
from planner.search import Search
from planner.tidy import tidy

FIRST_NEIGHBOURHOODS = 750
"""Neighbourhoods tried before the bound is worked on."""

FIRST_SHARE, BOUND_SHARE = 0.25, 0.6
"""Shares of a time limit after which the first improvement, then path generation end."""

REPAIR_SHARE = 0.8
"""Share of a time limit after which robots left out are the tree search's affair."""

DECIDING_NODES = 300
"""Nodes of the tree search for robots that are left out, without a time limit."""

Method = Literal["auto", "exact", "pgcp", "cooperative", "decoupled"]


@dataclass(frozen=True)
class SolveParams:
    """What `solve` may spend and how.

    Attributes:
        method: "auto" (cooperative A*, neighbourhood search, path generation for the bound; with a
            time limit a tree search for the rest of it), "exact" (the same, and the tree search
            until the plan is proven optimal or `nodes` are processed),
            "pgcp" (the paper's Algorithm 1), "cooperative" (cooperative A* with restarts),
            "decoupled" (shortest motions first, then the best APs for them: a baseline).
        seed: of all random choices.
        restarts: further orders tried by cooperative A* while a robot finds no way.
        iterations: neighbourhoods tried.
        time_limit: seconds after which the best answer so far is returned; None for no limit.
        gap: relative gap at which to stop.
        nodes: most nodes of the tree search; None for no limit.
    """

    method: Method = "auto"
    seed: int = 0
    restarts: int = 20
    iterations: int = 3000
    time_limit: float | None = None
    gap: float = 0.0
    nodes: int | None = None

    def __post_init__(self) -> None:
        if self.method not in get_args(Method):
            raise ValueError(f"method must be one of {get_args(Method)}, got {self.method!r}")
        for name in ("seed", "restarts", "iterations", "gap"):
            value = getattr(self, name)
            if not value >= 0:  # NaN neither
                raise ValueError(f"{name} must not be negative, got {value}")
        if self.time_limit is not None and not self.time_limit > 0:
            raise ValueError(f"time_limit must be positive, got {self.time_limit}")


@dataclass(frozen=True)
class Progress:
    """How far the planner is.

    Attributes:
        phase: what it is doing.
        served: robots with a path in the best plan.
        cost: of the best plan so far.
        bound: proven lower bound so far [cost units].
        columns: paths generated.
        seconds: since the start.
    """

    phase: str
    served: int
    cost: int
    bound: float
    columns: int
    seconds: float


class _Solver:
    """One call of `solve`: the incumbent, the bound, the clock."""

    def __init__(
        self,
        problem: Problem,
        params: SolveParams,
        on_progress: Callable[[Progress], None] | None,
        stop: Callable[[], bool],
    ) -> None:
        self.problem, self.params, self.on_progress = problem, params, on_progress
        self.told_to_stop = stop
        self.started = time.perf_counter()
        self.n = len(problem.robot_ids)
        self.paths: list[Path | None] = [None] * self.n
        self.cost = 0
        self.bound = 0  # [1/SCALE]
        self.priced: PgcpState | None = None
        self.alone = 0  # what the robots cost, each alone on the floor
        self.columns = 0
        self.lp_value: float | None = None
        self.counts: dict[str, float] = {}
        self.companion: Companion | None = None
        self.exhausted = False  # the tree search has proven that there is no plan

    # -- bookkeeping ---------------------------------------------------------------------------

    def elapsed(self) -> float:
        return time.perf_counter() - self.started

    def out_of_time(self, share: float = 1.0) -> bool:
        limit = self.params.time_limit
        if self.told_to_stop():
            return True
        return limit is not None and self.elapsed() >= share * limit

    def rounded_bound(self) -> int:
        """Costs are integers, so the bound may be rounded up (§1.13)."""
        return -(-self.bound // SCALE)

    def good_enough(self) -> bool:
        if any(p is None for p in self.paths):
            return False
        return self.cost - self.rounded_bound() <= self.params.gap * max(self.rounded_bound(), 0)

    def cost_of(self, paths: list[Path | None]) -> int:
        """Cost of the paths there are (§1.9)."""
        problem = self.problem
        return sum(problem.c_t * p.arrival + problem.c_h * p.handovers for p in paths if p)

    def offer(self, paths: list[Path | None]) -> None:
        """Takes a plan if it serves more robots, or as many for less."""
        cost = self.cost_of(paths)
        served, best = sum(p is not None for p in paths), sum(p is not None for p in self.paths)
        if served > best or (served == best and cost < self.cost):
            self.paths, self.cost = list(paths), cost

    def raise_bound(self, state: PgcpState) -> None:
        """Takes over the bound of path generation if it is higher."""
        self.bound = max(self.bound, state.bound)

    def prices(self) -> Prices | None:
        """The prices that prove the bound of path generation, None if there was none."""
        state = self.priced
        if state is None:
            return None
        since = time.perf_counter()
        alone = self.alone * SCALE  # proven by no penalties at all
        if alone >= state.bound:
            nothing = np.empty(0, np.int64)
            proof = nothing, nothing, alone
        else:
            proof = least_penalties(state, stop=self.out_of_time)
        prices = prices_of(state.resources, *proof)
        self.lap("prices", since)
        return prices

    def report(self, phase: str) -> None:
        if self.on_progress is not None:
            served = sum(p is not None for p in self.paths)
            bound = self.bound / SCALE
            self.on_progress(
                Progress(phase, served, self.cost, bound, self.columns, self.elapsed())
            )

    def lap(self, phase: str, since: float) -> None:
        key = f"seconds_{phase}"
        self.counts[key] = self.counts.get(key, 0.0) + time.perf_counter() - since

    def plan(self, infeasible: tuple[int, ...] = (), message: str = "") -> Plan:
        complete = all(p is not None for p in self.paths)
        bound = self.rounded_bound()
        if infeasible:
            status = "infeasible"
        elif not complete:
            status = "unknown"
        else:
            status = "optimal" if self.cost <= bound else "feasible"
        prices = None if infeasible else self.prices()
        return Plan(
            status=status,
            robot_ids=self.problem.robot_ids,
            paths=tuple(self.paths),
            cost=self.cost,
            lower_bound=None if infeasible else float(bound),
            infeasible_robots=tuple(self.problem.robot_ids[i] for i in infeasible),
            message=message,
            lp_value=self.lp_value,
            seconds=self.elapsed(),
            solver=self.counts,
            prices=prices,
        )

    # -- the road ------------------------------------------------------------------------------

    def run(self) -> Plan:
        since = time.perf_counter()
        graph = ExpandedGraph.of(self.problem)
        resources, search = Resources.of(self.problem), Search(graph)
        self.lap("graph", since)
        self.counts["expanded_vertices"] = graph.n_expanded_vertices
        self.counts["expanded_edges"] = graph.n_expanded_edges
        lost = tuple(i for i in range(self.n) if not search.can_arrive(i))
        if lost:
            return self.plan(lost, "they cannot reach their goals in time even alone on the floor")
        self.alone = sum(search.least_cost(i) for i in range(self.n))
        self.bound = self.alone * SCALE
        if self.params.method == "pgcp":
            self.run_pgcp()
        else:
            self.run_cooperative(search, resources)
            if self.params.method in ("auto", "exact"):
                self.run_auto(graph, search, resources)
                self.paths = tidy(resources, self.paths)
                self.cost = self.cost_of(self.paths)  # it may have saved a handover
        if any(p is None for p in self.paths) and self.params.method != "cooperative":
            return self.decide(search, resources)
        return self.plan(message="" if all(self.paths) else "some robots found no way")

    def run_cooperative(self, search: Search, resources: Resources) -> None:
        since = time.perf_counter()
        self.report("cooperative A*")
        self.offer(
            cooperative_with_restarts(
                search,
                resources,
                restarts=self.params.restarts,
                rng=np.random.default_rng([self.params.seed, 1]),
                stop=self.out_of_time,
            )
        )
        self.lap("cooperative", since)
        self.report("cooperative A*")

    def run_auto(self, graph: ExpandedGraph, search: Search, resources: Resources) -> None:
        """A good plan first, then its bound, then better plans and bounds till the limit."""
        neighbourhoods = LargeNeighbourhoodSearch(
            search, resources, self.paths, seed=self.params.seed
        )
        first = min(self.params.iterations // 4, FIRST_NEIGHBOURHOODS)
        self.improve(neighbourhoods, first, until=FIRST_SHARE)
        if self.params.time_limit is None:
            state = self.generate(graph, search, resources)
            self.improve(neighbourhoods, self.params.iterations - first)
            self.repair(state)
            if self.params.method == "exact":
                self.run_exact(search, resources, self.params.nodes)
            elif not all(self.paths):
                # Robots that must make way for each other in turn are a matter for the tree.
                self.run_exact(search, resources, DECIDING_NODES)
            return
        with Companion(search, resources, self.paths, seed=self.params.seed + 1) as companion:
            self.companion = companion
            state = self.generate(graph, search, resources)
            self.ask_companion()
            self.repair(state)
            self.run_exact(search, resources, self.params.nodes)
            self.wait_for_companion()
            self.counts["neighbourhoods"] += companion.neighbourhoods
            self.companion = None

    def generate(self, graph: ExpandedGraph, search: Search, resources: Resources) -> PgcpState:
        """Path generation for the bound, with the best plan's paths to begin with."""
        since = time.perf_counter()
        state = PgcpState(
            graph, resources, search, Master(resources, artificial_cost(self.problem))
        )
        state.master.add(
            [state.master.column(i, p) for i, p in enumerate(self.paths) if p is not None]
        )

        def stop(state: PgcpState) -> bool:
            self.raise_bound(state)
            self.columns = len(state.master.columns)
            self.ask_companion()
            self.report("path generation")
            return self.out_of_time(BOUND_SHARE) or self.good_enough()

        self.lp_value = generate_paths(state, range(self.n), stop=stop, complete=False)
        stop(state)
        self.count(state)
        self.lap("path_generation", since)
        return state

    def repair(self, state: PgcpState) -> None:
        """Serves robots left out by the LP's columns.

        One-by-one repair does not get there where robots must plan for each other at once.
        """
        if all(self.paths) or self.out_of_time():
            return

        def stop(_state: PgcpState) -> bool:
            return self.out_of_time(REPAIR_SHARE) or self.ask_companion() is not None

        since = time.perf_counter()
        self.offer(cooperative_pruning(state, stop=stop))
        self.lap("cooperative_pruning", since)

    def ask_companion(self) -> list[Path | None] | None:
        """Takes over the companion's plan if it is better; the plan, if it is complete then."""
        found = None if self.companion is None else self.companion.better()
        if found is not None:
            self.offer(found)
        return self.paths if found is not None and all(self.paths) else None

    def wait_for_companion(self) -> None:
        """The time that is left belongs to the plan when nothing more can be done for the bound."""
        while not (self.good_enough() or self.out_of_time() or self.exhausted):
            if n_threads() > 1:
                time.sleep(0.02)
            self.ask_companion()
            self.report("neighbourhood search")

    def run_exact(self, search: Search, resources: Resources, nodes: int | None) -> None:
        """The tree search, until the plan is good enough or a limit is met."""
        if self.good_enough() or self.out_of_time():
            return
        from planner.exact import ExactParams, ExactResult, solve_exact

        since = time.perf_counter()

        def on_progress(result: ExactResult) -> None:
            self.bound = max(self.bound, result.bound)
            self.columns = result.columns
            if result.upper is not None:
                before = self.cost
                self.offer(list(result.paths))
                if self.companion is not None and self.cost < before:
                    self.companion.offer(self.paths)
            self.report("tree search")

        state = self.priced
        known = [] if state is None else state.master.columns
        result = solve_exact(
            search,
            resources,
            self.paths,
            columns=[(c.robot, c.path) for c in known if c.path is not None],
            bound=self.bound,
            params=ExactParams(nodes=nodes, seed=self.params.seed),
            stop=lambda: self.out_of_time() or self.good_enough(),
            outside=self.ask_companion,
            on_progress=on_progress,
        )
        on_progress(result)
        self.exhausted = result.infeasible
        self.counts["nodes"] = result.nodes
        self.counts["cuts"] = result.cuts
        self.lap("tree_search", since)

    def improve(
        self, neighbourhoods: LargeNeighbourhoodSearch, iterations: int, *, until: float = 1.0
    ) -> None:
        """Tries neighbourhoods up to a number, or up to a share of the time limit."""
        since = time.perf_counter()
        done, batch = 0, 100 if self.params.time_limit is None else 1
        while done < iterations and not self.good_enough() and not self.out_of_time(until):
            began = time.perf_counter()
            batch = min(batch, iterations - done)
            neighbourhoods.run(batch)
            done += batch
            self.offer(neighbourhoods.paths())
            self.report("neighbourhood search")
            if self.params.time_limit is not None:
                # Near the clock's limit small batches keep the promise; how many robots' paths
                # are tried in one call changes nothing else.
                spent = time.perf_counter() - began
                batch = max(1, min(100, 2 * batch if spent < 0.1 else batch // 2))
        self.counts["neighbourhoods"] = self.counts.get("neighbourhoods", 0) + done
        self.lap("neighbourhood_search", since)

    def run_pgcp(self) -> None:
        def stop(state: PgcpState) -> bool:
            self.raise_bound(state)
            self.columns = len(state.master.columns)
            self.report("PGCP")
            return self.out_of_time()

        chosen, state = pgcp(self.problem, stop=stop)
        self.raise_bound(state)
        self.lp_value = state.lp_value
        self.offer(chosen)
        if None in chosen:
            self.offer(state.initial)  # it may leave fewer robots out
        self.count(state)
        for phase, seconds in state.seconds.items():
            self.counts[f"seconds_{phase}"] = seconds
        self.report("PGCP")

    def count(self, state: PgcpState) -> None:
        self.priced = state
        self.columns = len(state.master.columns)
        self.counts["columns"] = len(state.master.columns)
        self.counts["rows"] = state.master.n_rows
        self.counts["iterations"] = state.iterations
        self.counts["lp_solves"] = state.master.lp_solves

    def decide(self, search: Search, resources: Resources) -> Plan:
        """Robots are left without a path: is there a proof that no plan exists?"""
        since = time.perf_counter()
        self.report("proof of infeasibility")
        known = [(i, p) for i, p in enumerate(self.paths) if p is not None]
        proof = prove_infeasible(search, resources, known, stop=self.out_of_time)
        self.lap("phase_one", since)
        if proof is not None:
            return self.plan(
                proof.robots,
                f"together they need {proof.need / max(proof.room, 1):.4f} times the room that the "
                "bottleneck has",
            )
        if self.exhausted:
            return self.plan(
                tuple(range(self.n)),
                "each alone and all with shares of paths they fit, but branching found no plan",
            )
        unserved = sum(p is None for p in self.paths)
        return self.plan(
            message=f"{unserved} robots found no way, and there is no proof that none exists; "
            "allow more iterations, a longer horizon or more AP capacity"
        )


def _solve_decoupled(
    problem: Problem, params: SolveParams, on_progress: Callable[[Progress], None] | None
) -> Plan:
    """The decoupled baseline with the limits of `params`."""
    from planner.decoupled import decoupled

    begin = time.perf_counter()

    def on_phase(phase: str, served: int, cost: int) -> None:
        if on_progress is not None:
            on_progress(Progress(phase, served, cost, 0.0, 0, time.perf_counter() - begin))

    return decoupled(
        problem,
        seed=params.seed,
        restarts=params.restarts,
        iterations=params.iterations,
        time_limit=params.time_limit,
        on_phase=on_phase,
    )


def solve(
    problem: Problem,
    params: SolveParams | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Plan:
    """Plans the fleet.

    Args:
        problem: the instance.
        params: limits and method; the defaults if None.
        on_progress: called now and then with how far it is.
        stop: asked now and then; True ends the search with the best answer so far.

    Returns:
        A plan of status optimal, feasible, infeasible or unknown (§1.12); never a plan that breaks
        a rule, never a bound that is not proven. Same input and counts, same plan (§1.15).
    """
    if params is not None and params.method == "decoupled":
        return _solve_decoupled(problem, params, on_progress)
    return _Solver(problem, params or SolveParams(), on_progress, stop).run()
