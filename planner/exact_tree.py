"""The tree of the exact search: nodes, their relaxations, plans found on the way."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from math import gcd

import numpy as np
from numpy.typing import NDArray

from planner.branching import Decision, Restriction, choose
from planner.cuts import CutPool
from planner.exact_cutting import Separation
from planner.exact_fixing import Fixing
from planner.exact_limits import Excluded, Limits
from planner.exact_pricing import Pricing
from planner.exact_rounding import rounded_plan
from planner.improve import LargeNeighbourhoodSearch
from planner.master import Column, LpSolution, Master
from planner.plan import Path
from planner.resources import BLOCKED, SCALE, Resources
from planner.search import INFINITE, Search

NEGATIVE = 16
"""A path prices out when its reduced cost is below minus this many penalty units."""

NEAR_SLOTS = 4
"""Pairs of robots are looked at at nodes whose bound is so near to the cutoff, in slots."""

ARTIFICIAL = 1e-6
"""Artificial paths count as used above this value."""


@dataclass(frozen=True)
class ExactParams:
    """What the tree search may spend and which means it uses.

    Attributes:
        nodes: most nodes to process; None for no limit.
        seed: of the neighbourhood search.
        cuts: families used, of "arrival_conflict", "state_exclusion" and "wait_edge".
        cut_rounds: most rounds of cuts at the root and at other nodes.
        neighbourhoods: tried on a rounded solution.
        round_every: nodes between two rounded solutions that are improved by neighbourhoods.
        propagations: times that pairs of robots are looked at at a node below the root; 0 for
            never, at the root neither.
    """

    nodes: int | None = None
    seed: int = 0
    cuts: tuple[str, ...] = ("arrival_conflict", "state_exclusion")
    cut_rounds: tuple[int, int] = (50, 5)
    neighbourhoods: int = 100
    round_every: int = 10
    propagations: int = 1


@dataclass(order=True)
class Node:
    """A subproblem: the plans that keep its decisions.

    Attributes:
        bound: proven lower bound on their cost [1/SCALE cost units].
        depth: minus the number of decisions, so that deeper nodes come first.
        number: in the order they were made.
        decisions: on the way from the root.
        excluded: by robot, (T+1, n+A) bits of the states that no plan of interest passes here.
    """

    bound: int
    depth: int
    number: int
    decisions: tuple[Decision, ...] = field(compare=False)
    excluded: Excluded = field(compare=False, default_factory=dict)


class ExactSearch:
    """The tree under way; what it knows stays valid whenever it is interrupted.

    Args:
        search, resources: of the problem.
        paths: the best plan known, None for robots without a path (then it is no plan).
        columns: further (robot, path) to start the master with.
        bound: a proven lower bound to start with [1/SCALE cost units].
        target: only plans cheaper than this are looked for; None for any.
        params: limits and means.
        stop: asked after every round of pricing; True ends the search.
        outside: asked after every round of pricing for a plan found elsewhere, None without one.
        on_node: called after every node.

    Attributes:
        paths: the best plan so far; `complete` tells whether it serves every robot.
        upper: its cost, None if there is none.
        bound: proven lower bound on every plan's cost [1/SCALE cost units]; never more than
            `upper` · SCALE.
        exhausted: the whole tree is closed: the best plan is optimal, or, if `upper` is None or
            not below `target`, no plan is cheaper than `target` (there is none, without a target).
        nodes, rounds: processed nodes and rounds of pricing.
        root_bound: of the root before cuts and after them [cost units].
    """

    def __init__(
        self,
        search: Search,
        resources: Resources,
        paths: Sequence[Path | None],
        *,
        columns: Iterable[tuple[int, Path]] = (),
        target: int | None = None,
        bound: int = 0,
        params: ExactParams | None = None,
        stop: Callable[[], bool] = lambda: False,
        outside: Callable[[], list[Path | None] | None] = lambda: None,
        on_node: Callable[[ExactSearch], None] = lambda _tree: None,
    ) -> None:
        problem = search.problem
        self.problem, self.search, self.resources = problem, search, resources
        self.params, self.stop, self.on_node = params or ExactParams(), stop, on_node
        self.outside = outside
        self.n = problem.n_robots
        self.unit = gcd(problem.c_t, problem.c_h) or 1
        self.paths: list[Path | None] = list(paths)
        self.upper: int | None = None
        self.target = target
        self.bound = max(bound, sum(search.least_cost(i) for i in range(self.n)) * SCALE)
        self.exhausted = False
        self.nodes = self.rounds = 0
        self.root_bound: tuple[float, float] = (0.0, 0.0)
        self.pool = CutPool(problem, resources.n)
        self.pricing = Pricing(search, resources, self.pool)
        self.fixing = Fixing(self.pricing, stop)
        self.separation = Separation(resources, self.pool, self.fixing, self.params.cuts, stop)
        self._start_cost = (problem.c_t + problem.c_h) * problem.horizon + 1.0
        self.master = Master(resources, self._start_cost)
        self.limits = Limits(self.pricing, resources, self.fixing, self.master, stop)
        if all(p is not None for p in paths):
            self.offer(list(paths))
        start = [(i, p) for i, p in enumerate(paths) if p is not None]
        self.add([*start, *columns])

    # -- columns and plans ---------------------------------------------------------------------

    def add(self, paths: Iterable[tuple[int, Path]]) -> int:
        """Adds paths as columns; returns how many were new."""
        columns = []
        for i, path in paths:
            column = self.master.column(i, path)
            member_of = self.pool.of(i, path)
            if len(member_of):
                column = Column(i, path, column.cost, np.concatenate((column.used, member_of)))
            columns.append(column)
        before = len(self.master.columns)
        added = self.master.add(columns)
        self.limits.add(self.master.columns[before:])
        return added

    def offer(self, paths: list[Path | None]) -> bool:
        """Takes a complete plan if it is cheaper than the best."""
        problem = self.problem
        cost = sum(problem.c_t * p.arrival + problem.c_h * p.handovers for p in paths if p)
        if None in paths or (self.upper is not None and cost >= self.upper):
            return False
        self.paths, self.upper = list(paths), cost
        return True

    def rounded(self, bound: int) -> int:
        """A bound in cost units, rounded up to what a plan can cost."""
        return -(-bound // (SCALE * self.unit)) * self.unit

    def closed(self, bound: int) -> bool:
        """Whether no plan at or above this bound is cheaper than the best one."""
        cutoff = self.cutoff
        return cutoff is not None and self.rounded(bound) >= cutoff

    @property
    def cutoff(self) -> int | None:
        """Only plans cheaper than this are of interest."""
        known = [c for c in (self.upper, self.target) if c is not None]
        return min(known, default=None)

    # -- the tree ------------------------------------------------------------------------------

    def run(self) -> None:
        """Searches until the best plan is proven optimal, infeasibility is, or a limit is met."""
        heap = [Node(self.bound, 0, 0, ())]
        made = 1
        while heap:
            self._raise_bound(heap[0].bound)
            if self.closed(heap[0].bound):
                break
            if self.stop() or (self.params.nodes is not None and self.nodes >= self.params.nodes):
                return
            node = heap[0]
            children = self._process(node)
            self.nodes += 1
            if children is None:
                # Interrupted: what is left of the node is open still, at its bound.
                heapq.heapreplace(heap, node)
                self._raise_bound(heap[0].bound)
                return
            heapq.heappop(heap)
            for decisions in children:
                known = dict(node.excluded)
                heapq.heappush(heap, Node(node.bound, -len(decisions), made, decisions, known))
                made += 1
            if heap:
                self._raise_bound(heap[0].bound)
            self.on_node(self)
        self.exhausted = True
        if self.cutoff is not None:
            self._raise_bound(self.cutoff * SCALE)

    def _raise_bound(self, bound: int) -> None:
        """Every open node has at least this bound: so has every plan below the cutoff."""
        cutoff = self.cutoff
        if cutoff is not None:
            bound = min(bound, cutoff * SCALE)
        self.bound = max(self.bound, bound)

    def _process(self, node: Node) -> list[tuple[Decision, ...]] | None:
        """Solves a node's relaxation; its children (none if it is closed), None if stopped.

        The node's bound is raised to what was proven.
        """
        self.limits.enter(node.excluded)
        restrictions = self.limits.restrictions(node.decisions)
        if not self._each_has_a_path(restrictions, node.decisions):
            return []
        root = not node.decisions
        rounds = self.params.cut_rounds[0 if root else 1]
        self._allow(node.decisions)
        first_value: float | None = None
        propagations = self.params.propagations
        while True:
            outcome = self._price_out(node, restrictions)
            if outcome is None:
                return None
            if isinstance(outcome, str):
                return []
            lp = outcome
            first_value = lp.value if first_value is None else first_value
            if self._artificial(lp) > ARTIFICIAL:
                proven = self._no_plan(restrictions, node.decisions)
                if proven is None:
                    return None
                if proven:
                    return []
                if self._raise_artificial_cost():
                    self._allow(node.decisions)
                    continue
                break
            if self.fixing.at is None:
                self._fix(node, lp)
            if self.stop():
                return None
            if rounds > 0 and self.separation.add_cuts(self.master, lp):
                rounds -= 1
                continue
            self._round(lp)
            if self.closed(node.bound):
                return []
            again = root and self._fix(node, lp)
            if self.stop():
                return None
            if not again and propagations > 0:
                again = self._propagate(node, lp, restrictions)
                propagations -= 0 if root else 1
            if again:
                # Fewer states, hence fewer paths, and more that exclude each other.
                if self.closed(node.bound):
                    return []
                restrictions = self.limits.restrictions(node.decisions)
                self._allow(node.decisions)
                continue
            break
        if root:
            self.root_bound = (first_value or 0.0, node.bound / SCALE)
        sides = choose(self.master.columns, lp.x, self.resources)
        if sides is None:
            # Integer: the plan itself was offered when it was rounded, so this is the optimum here,
            # or artificial paths are left that are no proof; then the node stays as it is.
            return [] if self._artificial(lp) <= ARTIFICIAL else None
        return [(*node.decisions, side) for side in sides]

    def _price_out(self, node: Node, restrictions: list[Restriction]) -> LpSolution | str | None:
        """Path generation at a node.

        Returns:
            The LP's solution when nothing prices out any more, "closed" when the bound closes the
            node, None when stopped.
        """
        while True:
            lp = self.master.solve(complete=False)
            new, bound, _ = self._price(lp, restrictions, scale=SCALE)
            node.bound = max(node.bound, bound)
            if self.closed(node.bound):
                return "closed"
            added = self.add(new)
            if self.stop():
                return None
            found = self.outside()
            if found is not None and self.offer(found):
                self.add([(i, p) for i, p in enumerate(found) if p is not None])
                if self.closed(node.bound):
                    return "closed"
            if lp.complete and (added == 0 or self._settled(node, lp)):
                return lp

    def _settled(self, node: Node, lp: LpSolution) -> bool:
        """Whether the bound already rounds up to what the LP's value does."""
        return self.rounded(node.bound) >= lp.value - 1e-6 and self._artificial(lp) <= ARTIFICIAL

    def _price(
        self, lp: LpSolution, restrictions: list[Restriction], *, scale: int
    ) -> tuple[list[tuple[int, Path]], int, int]:
        """Prices every robot with the LP's duals.

        Args:
            lp: of the master, or of the phase-1 master.
            restrictions: per robot.
            scale: SCALE, or 0 in phase 1.

        Returns:
            Paths of negative reduced cost, the Lagrangian bound, and Σ of the robots' least costs;
            when stopped, the paths so far and bounds of 0.
        """
        self.pricing.load(lp)
        use = self._use(lp)
        new: list[tuple[int, Path]] = []
        total = 0
        for i in range(self.n):
            if self.stop():
                return new, 0, 0
            limit = int(np.floor(lp.robot_dual[i] * SCALE)) - NEGATIVE
            if scale == 0:
                limit = min(SCALE, max(0, limit + NEGATIVE))
            cost, path = self.pricing.shortest(
                i, restrictions[i], scale=scale, limit=limit, use=use
            )
            total += cost
            if path is not None:
                new.append((i, path))
                use[np.arange(path.arrival + 1), path.vertices] += 1
        self.rounds += 1
        capacity = self.master.capacity[lp.rows].astype(np.int64)
        return new, total - int(lp.penalty() @ capacity), total

    def _use(self, lp: LpSolution) -> NDArray[np.int32]:
        """(T+1, V) int32: vertices of the paths with x ≥ 0.5; ties in pricing avoid them."""
        use = np.zeros((self.problem.horizon + 1, self.problem.n_vertices), np.int32)
        for k in np.flatnonzero(lp.x >= 0.5).tolist():
            if k < len(self.master.columns):
                path = self.master.columns[k].path
                if path is not None:
                    use[np.arange(path.arrival + 1), path.vertices] += 1
        return use

    # -- no plan at a node ---------------------------------------------------------------------

    def _artificial(self, lp: LpSolution) -> float:
        return float(lp.x[: self.n].max(initial=0.0))

    def _raise_artificial_cost(self) -> bool:
        """Makes artificial paths dearer; False if they are as dear as may be.

        A robot's dual is at most that, and must stay below what is `BLOCKED` in a search: a path
        that is left out for its penalties must cost more than the limit it is priced with.
        """
        dearer = 8 * self._start_cost
        if dearer * SCALE >= BLOCKED:
            return False
        self._start_cost = dearer
        for i in range(self.n):
            self.master.set_cost(i, self._start_cost)
        return True

    def _no_plan(
        self, restrictions: list[Restriction], decisions: tuple[Decision, ...]
    ) -> bool | None:
        """Phase 1 at a node: True if it is proven to hold no plan, None if stopped."""
        allowed = self.limits.allowed(decisions)
        master = Master(self.resources, artificial_cost=1.0)
        old = [c for c, ok in zip(self.master.columns, allowed, strict=True) if ok and c.path]
        master.add_cuts(
            np.array([cut.capacity for cut in self.pool.cuts], np.int32),
            [np.empty(0, np.int64)] * len(self.pool.cuts),
        )
        master.add([self._for_phase_one(c.robot, c.path) for c in old if c.path is not None])
        while True:
            lp = master.solve()
            if lp.value < 1e-7:
                return False
            new, bound, _ = self._price(lp, restrictions, scale=0)
            if bound > 0:
                return True
            if self.stop():
                return None
            self.add(new)
            if master.add([self._for_phase_one(i, path) for i, path in new]) == 0:
                return False

    def _for_phase_one(self, robot: int, path: Path) -> Column:
        used = np.concatenate((self.resources.used_by(path), self.pool.of(robot, path)))
        return Column(robot, path, 0.0, used)

    # -- states of interest --------------------------------------------------------------------

    def _fix(self, node: Node, lp: LpSolution) -> bool:
        """Excludes states that no plan of interest passes, at the root (see `Fixing`).

        Returns:
            Whether columns of the LP were excluded, or the bound has risen since the last time.
        """
        cutoff, last = self.cutoff, self.fixing.at
        if cutoff is None or last == (cutoff, node.bound) or not self.fixing.applies:
            return False
        rising = last is None or self.rounded(last[1]) < self.rounded(node.bound)
        self.fixing.at = (cutoff, node.bound)
        excluded = self.limits.fix(lp, (cutoff - self.unit) * SCALE)
        self.separation.forget_states()
        return excluded or rising

    def _propagate(self, node: Node, lp: LpSolution, kept: list[Restriction]) -> bool:
        """Excludes states that do not fit with any of another robot's (see `JointBound`).

        Returns:
            Whether columns of the LP were excluded, or the node is closed.
        """
        cutoff = self.cutoff
        if cutoff is None or self.fixing.at is None:
            return False
        most = (cutoff - self.unit) * SCALE
        if node.decisions:
            if most - node.bound > NEAR_SLOTS * max(self.problem.c_t, 1) * SCALE:
                return False
            bound, excluded = self.limits.propagate_here(lp, most, kept, node.excluded)
        else:
            bound, excluded = self.limits.propagate(lp, most, node.decisions)
            self.separation.forget_states()
        node.bound = max(node.bound, cutoff * SCALE if bound is None else bound)
        return excluded or self.closed(node.bound)

    def _allow(self, decisions: tuple[Decision, ...]) -> None:
        self.master.allow(self.limits.allowed(decisions))

    def _each_has_a_path(
        self, restrictions: list[Restriction], decisions: tuple[Decision, ...]
    ) -> bool:
        """False if the last decision leaves its robot no path at all."""
        if not decisions:
            return True
        i = decisions[-1].robot
        self.pricing.clear()
        _, path = self.pricing.shortest(i, restrictions[i], scale=SCALE, limit=INFINITE, use=None)
        return path is not None

    # -- plans from LP solutions ---------------------------------------------------------------

    def _round(self, lp: LpSolution) -> None:
        """Offers a plan made from an LP solution, now and then improved by neighbourhoods."""
        paths = rounded_plan(self.search, self.resources, self.master.columns, lp.x)
        if self.params.neighbourhoods and self.nodes % self.params.round_every == 0:
            improved = LargeNeighbourhoodSearch(
                self.search, self.resources, paths, seed=self.params.seed + self.nodes
            )
            improved.run(self.params.neighbourhoods)
            paths = improved.paths()
        if self.offer(paths):
            self.add([(i, p) for i, p in enumerate(paths) if p is not None])
