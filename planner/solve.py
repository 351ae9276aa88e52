"""`solve`: from a problem to a plan with a proof (§1.12–§1.15)."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from planner import warm_up
from planner.ap_room import no_room_in_words, prove_no_room
from planner.bounding import Bounding
from planner.companion import Companion
from planner.cooperative import cooperative_with_restarts
from planner.expanded_graph import ExpandedGraph
from planner.improve import LargeNeighbourhoodSearch
from planner.incumbent import Incumbent
from planner.parallel import n_threads
from planner.params import Method, Progress, SolveParams
from planner.pgcp import PgcpState, cooperative_pruning, pgcp
from planner.phase_one import prove_infeasible
from planner.plan import Path, Plan
from planner.problem import Problem
from planner.resources import Resources
from planner.search import Search
from planner.tidy import tidy

FIRST_NEIGHBOURHOODS = 750
"""Neighbourhoods tried before the bound is worked on."""

FIRST_SHARE = 0.25
"""Share of a time limit after which the first improvement ends."""

REPAIR_SHARE = 0.8
"""Share of a time limit after which robots left out are the tree search's affair."""

DECIDING_NODES = 300
"""Nodes of the tree search for robots that are left out, without a time limit."""

BATCH, BATCH_S = 100, 0.1
"""Neighbourhoods between two looks at the limits, fewer under a time limit if they take longer."""


class _Solver:
    """One call of `solve`: what is done, in which order."""

    def __init__(self, incumbent: Incumbent) -> None:
        self.incumbent = incumbent
        self.problem, self.params = incumbent.problem, incumbent.params
        since = time.perf_counter()
        self.graph = ExpandedGraph.of(self.problem)
        self.resources, self.search = Resources.of(self.problem), Search(self.graph)
        incumbent.lap("graph", since)
        incumbent.counts["expanded_vertices"] = self.graph.n_expanded_vertices
        incumbent.counts["expanded_edges"] = self.graph.n_expanded_edges
        self.bounding = Bounding(incumbent, self.search, self.resources, self._ask_companion)
        self.companion: Companion | None = None
        self.exhausted = False  # the tree search has proven that there is no plan

    def run(self) -> Plan:
        """The answer."""
        incumbent, method = self.incumbent, self.params.method
        robots = range(self.problem.n_robots)
        lost = [i for i in robots if not self.search.can_arrive(i)]
        if lost:
            text = "they cannot reach their goals in time even alone on the floor"
            return incumbent.plan(lost, text)
        crowded = prove_no_room(self.resources)
        if crowded is not None:
            text = no_room_in_words(self.problem, self.resources, crowded)
            return incumbent.plan(crowded.robots, text)
        self.bounding.robots_alone()
        if method == "pgcp":
            self._pgcp()
        else:
            self._cooperative()
            if method in ("auto", "exact"):
                self._auto()
                # It may save a handover.
                incumbent.replace(tidy(self.resources, incumbent.paths))
        if not incumbent.complete and method != "cooperative":
            return self._decide()
        return incumbent.plan(message="" if incumbent.complete else "some robots found no way")

    def _cooperative(self) -> None:
        since = time.perf_counter()
        self.incumbent.report("cooperative A*")
        self.incumbent.offer(
            cooperative_with_restarts(
                self.search,
                self.resources,
                restarts=self.params.restarts,
                rng=np.random.default_rng([self.params.seed, 1]),
                stop=self.incumbent.out_of_time,
            )
        )
        self.incumbent.lap("cooperative", since)
        self.incumbent.report("cooperative A*")

    def _auto(self) -> None:
        """A good plan first, then its bound, then better plans and bounds till the limit."""
        incumbent, params = self.incumbent, self.params
        neighbourhoods = LargeNeighbourhoodSearch(
            self.search, self.resources, incumbent.paths, seed=params.seed
        )
        first = min(params.iterations // 4, FIRST_NEIGHBOURHOODS)
        if params.time_limit is None:
            self._improve(neighbourhoods, first)
            state = self.bounding.run()
            self._improve(neighbourhoods, params.iterations - first)
            self._repair(state)
            asked = params.nodes is not None and self.bounding.fits
            if params.method == "exact" or asked:
                self._tree_search(params.nodes)
            elif not incumbent.complete and self.bounding.fits:
                # Robots that must make way for each other in turn are a matter for the tree.
                self._tree_search(DECIDING_NODES)
            return
        with Companion(
            self.search, self.resources, incumbent.paths, seed=params.seed + 1
        ) as companion:
            self.companion = companion
            self._improve(neighbourhoods, first, until=FIRST_SHARE)
            companion.offer(incumbent.paths)
            state = self.bounding.run()
            self._ask_companion()
            self._repair(state)
            if self.bounding.fits:
                self._tree_search(params.nodes)
            self._wait_for_companion()
        incumbent.count("neighbourhoods", companion.neighbourhoods)
        self.companion = None

    def _improve(
        self, neighbourhoods: LargeNeighbourhoodSearch, iterations: int, *, until: float = 1.0
    ) -> None:
        """Tries neighbourhoods up to a number, or up to a share of the time limit."""
        incumbent, since = self.incumbent, time.perf_counter()
        timed = self.params.time_limit is not None
        done, batch = 0, 1 if timed else BATCH
        while (
            done < iterations and not incumbent.good_enough() and not incumbent.out_of_time(until)
        ):
            began = time.perf_counter()
            batch = min(batch, iterations - done)
            neighbourhoods.run(batch)
            done += batch
            incumbent.offer(neighbourhoods.paths())
            self._ask_companion()
            incumbent.report("neighbourhood search")
            if timed:
                # Near the clock's limit small batches keep the promise; how many robots' paths
                # are tried in one call changes nothing else.
                quick = time.perf_counter() - began < BATCH_S
                batch = max(1, min(BATCH, 2 * batch if quick else batch // 2))
        incumbent.count("neighbourhoods", done)
        incumbent.lap("neighbourhood_search", since)

    def _repair(self, state: PgcpState | None) -> None:
        """Serves robots left out by the LP's columns.

        One-by-one repair does not get there where robots must plan for each other at once.
        """
        incumbent = self.incumbent
        if state is None or incumbent.complete or incumbent.out_of_time():
            return

        def hurry() -> bool:
            return incumbent.out_of_time(REPAIR_SHARE)

        def stop(_state: PgcpState) -> bool:
            return hurry() or self._ask_companion() is not None

        since = time.perf_counter()
        incumbent.offer(cooperative_pruning(state, stop=stop, hurry=hurry))
        incumbent.lap("cooperative_pruning", since)

    def _ask_companion(self) -> list[Path | None] | None:
        """Takes over the companion's plan if it is better; the plan, if it is complete then."""
        found = None if self.companion is None else self.companion.better()
        if found is not None:
            self.incumbent.offer(found)
        return self.incumbent.paths if found is not None and self.incumbent.complete else None

    def _wait_for_companion(self) -> None:
        """The time that is left belongs to the plan when nothing more can be done for the bound."""
        incumbent = self.incumbent
        while not (incumbent.good_enough() or incumbent.out_of_time() or self.exhausted):
            if n_threads() > 1:
                time.sleep(0.02)
            self._ask_companion()
            incumbent.report("neighbourhood search")

    def _tree_search(self, nodes: int | None) -> None:
        """Branch-and-cut-and-price, until the plan is good enough or a limit is met."""
        incumbent = self.incumbent
        if incumbent.good_enough() or incumbent.out_of_time():
            return
        from planner.exact import ExactParams, ExactResult, solve_exact

        since = time.perf_counter()

        def on_progress(result: ExactResult) -> None:
            incumbent.raise_bound(result.bound)
            incumbent.columns = result.columns
            if result.upper is not None:
                before = incumbent.cost
                incumbent.offer(list(result.paths))
                if self.companion is not None and incumbent.cost < before:
                    self.companion.offer(incumbent.paths)
            incumbent.report("tree search")

        result = solve_exact(
            self.search,
            self.resources,
            incumbent.paths,
            columns=self.bounding.columns,
            bound=incumbent.bound,
            params=ExactParams(nodes=nodes, seed=self.params.seed),
            stop=lambda: incumbent.out_of_time() or incumbent.good_enough(),
            outside=self._ask_companion,
            on_progress=on_progress,
        )
        on_progress(result)
        self.exhausted = result.infeasible
        incumbent.counts["nodes"] = result.nodes
        incumbent.counts["cuts"] = result.cuts
        incumbent.lap("tree_search", since)

    def _pgcp(self) -> None:
        incumbent = self.incumbent

        def stop(state: PgcpState) -> bool:
            incumbent.raise_bound(state.bound)
            incumbent.columns = len(state.master.columns)
            incumbent.report("PGCP")
            return incumbent.out_of_time()

        chosen, state = pgcp(self.problem, stop=stop, hurry=incumbent.out_of_time)
        incumbent.raise_bound(state.bound)
        incumbent.lp_value = state.lp_value
        incumbent.offer(chosen)
        if None in chosen:
            incumbent.offer(state.initial)  # it may leave fewer robots out
        self.bounding.count(state)
        self.bounding.price(state)
        for phase, seconds in state.seconds.items():
            incumbent.counts[f"seconds_{phase}"] = seconds
        incumbent.report("PGCP")

    def _decide(self) -> Plan:
        """Robots are left without a path: is there a proof that no plan exists?"""
        incumbent, since = self.incumbent, time.perf_counter()
        incumbent.report("proof of infeasibility")
        known = [(i, p) for i, p in enumerate(incumbent.paths) if p is not None]
        proof = prove_infeasible(self.search, self.resources, known, stop=incumbent.out_of_time)
        incumbent.lap("phase_one", since)
        if proof is not None:
            return incumbent.plan(
                proof.robots,
                f"together they need {proof.need / max(proof.room, 1):.4f} times the room that the "
                "bottleneck has",
            )
        if self.exhausted:
            return incumbent.plan(
                range(self.problem.n_robots),
                "all ways past one another were searched, and none brings every robot to its goal "
                "in time; allow a longer horizon, more AP capacity or fewer robots",
            )
        unserved = sum(p is None for p in incumbent.paths)
        return incumbent.plan(
            message=f"{unserved} robots found no way, and there is no proof that none exists; "
            "allow more iterations, a longer horizon or more AP capacity"
        )


def _solve_decoupled(
    problem: Problem,
    params: SolveParams,
    on_progress: Callable[[Progress], None] | None,
    stop: Callable[[], bool],
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
        stop=stop,
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

    A time limit does not include the compilation of the kernels, which happens once per machine.
    """
    params = params or SolveParams()
    if params.time_limit is not None and not warm_up.kernels_are_compiled():
        warm_up.compile_kernels()
    if params.method == "decoupled":
        return _solve_decoupled(problem, params, on_progress, stop)
    return _Solver(Incumbent(problem, params, on_progress, stop)).run()


__all__ = ["Method", "Progress", "SolveParams", "solve"]
