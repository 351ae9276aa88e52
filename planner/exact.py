"""Branch-and-cut-and-price: the tree search that closes the gap between plan and bound.

After Lam, Le Bodic, Harabor, Stuckey ("Branch-and-cut-and-price for multi-agent path finding",
Computers & Operations Research 144, 2022, DOI 10.1016/j.cor.2022.105809) with the AP dimension,
cuts of our own (`planner.cuts`) and proofs in integers: at every node penalties p ≥ 0 on resources
and cuts give the bound Σ_i (least penalised cost of a path that the node allows) − Σ p · capacity,
all terms integers, so a node is closed by arithmetic without rounding. A node without any plan is
closed by the same argument with costs of 0 (Farkas; see `planner.phase_one`), never by an
artificial cost.

Costs are multiples of gcd(c_t, c_h), so bounds are rounded up to one. Nodes are taken by least
bound, then by greatest depth, then in the order they were made: no clock decides anything.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from math import gcd

import numpy as np
from numpy.typing import NDArray

from planner import kernels_exact
from planner.branching import Arrive, Decision, Restriction, choose, restrict
from planner.cooperative import Reservations
from planner.cuts import CutPool, arrival_conflict, state_exclusion, wait_edge
from planner.improve import LargeNeighbourhoodSearch
from planner.master import Column, LpSolution, Master
from planner.parallel import each
from planner.plan import Path
from planner.resources import BLOCKED, SCALE, Resources
from planner.search import INFINITE, NO_ARRIVAL_PENALTY, NOTHING_FORBIDDEN, Penalties, Search

NEGATIVE = 16
"""A path prices out when its reduced cost is below minus this many penalty units."""

STEP_SLOTS = 8
"""How far above the bound the first target is, in slots."""

MAX_STATES = 50_000_000
"""Robots times states of G' above which no states are excluded: it would take too much memory."""

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
    """

    nodes: int | None = None
    seed: int = 0
    cuts: tuple[str, ...] = ("arrival_conflict", "state_exclusion")
    cut_rounds: tuple[int, int] = (50, 5)
    neighbourhoods: int = 100
    round_every: int = 10


@dataclass(order=True)
class Node:
    """A subproblem: the plans that keep its decisions.

    Attributes:
        bound: proven lower bound on their cost [1/SCALE cost units].
        depth: minus the number of decisions, so that deeper nodes come first.
        number: in the order they were made.
        decisions: on the way from the root.
    """

    bound: int
    depth: int
    number: int
    decisions: tuple[Decision, ...] = field(compare=False)


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
        self.penalties = Penalties(resources)
        self.pool = CutPool(problem, resources.n)
        self.conflicts: arrival_conflict.PairConflicts | None = None
        self.exclusions: state_exclusion.StateExclusions | None = None
        self._places: list[list[tuple[int, NDArray[np.int64], int]]] = [[] for _ in range(self.n)]
        self.excluded: list[NDArray[np.bool_]] = [NOTHING_FORBIDDEN] * self.n
        self.window = [(0, problem.horizon)] * self.n
        self.room = INFINITE // 4
        self._excess: list[NDArray[np.int64]] = [np.empty((0, 0), np.int64)] * self.n
        self._arriving: list[NDArray[np.int64]] = [np.empty(0, np.int64)] * self.n
        self._fixed_at: tuple[int, int] | None = None
        self._start_cost = (problem.c_t + problem.c_h) * problem.horizon + 1.0
        self.master = Master(resources, self._start_cost)
        self._arrival = np.full(self.n, -1, np.int64)  # of every column; -1 for artificial ones
        self._robot = np.arange(self.n)
        self._not_fixed = np.ones(self.n, np.bool_)
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
        fresh = self.master.columns[before:]
        arrival = np.array([c.path.arrival for c in fresh if c.path is not None], np.int64)
        self._arrival = np.concatenate((self._arrival, arrival))
        self._robot = np.concatenate((self._robot, np.array([c.robot for c in fresh], np.int64)))
        ok = np.array([self._may_improve(c) for c in fresh], np.bool_)
        self._not_fixed = np.concatenate((self._not_fixed, ok))
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
                heapq.heappush(heap, Node(node.bound, -len(decisions), made, decisions))
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
        restrictions = self._restrictions(node.decisions)
        if not self._each_has_a_path(restrictions, node.decisions):
            return []
        root = not node.decisions
        rounds = self.params.cut_rounds[0 if root else 1]
        self._allow(node.decisions)
        first_value: float | None = None
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
                if self._raise_artificial_cost(lp):
                    self._allow(node.decisions)
                    continue
                break
            if self._fixed_at is None:
                self._fix(node, lp)
            if rounds > 0 and self._cut(lp):
                rounds -= 1
                continue
            self._round(lp)
            if self.closed(node.bound):
                return []
            if root and self._fix(node, lp):
                # Fewer states, hence fewer paths, and more that exclude each other.
                restrictions = self._restrictions(node.decisions)
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
        at_arrival = self._load(lp)
        use = self._use(lp)
        new: list[tuple[int, Path]] = []
        total = 0
        for i in range(self.n):
            if self.stop():
                return new, 0, 0
            limit = int(np.floor(lp.robot_dual[i] * SCALE)) - NEGATIVE
            if scale == 0:
                limit = min(SCALE, max(0, limit + NEGATIVE))
            cost, path = self._shortest(
                i, restrictions[i], at_arrival[i], scale=scale, limit=limit, use=use
            )
            total += cost
            if path is not None:
                new.append((i, path))
                use[np.arange(path.arrival + 1), path.vertices] += 1
        self.rounds += 1
        capacity = self.master.capacity[lp.rows].astype(np.int64)
        return new, total - int(lp.penalty() @ capacity), total

    def _shortest(
        self,
        i: int,
        kept: Restriction,
        at_arrival: NDArray[np.int64],
        *,
        scale: int,
        limit: int,
        use: NDArray[np.int32] | None,
    ) -> tuple[int, Path | None]:
        slots, moves = kept.moves[:, 0], kept.moves[:, 1]
        before = self.penalties.move[slots, moves]
        self.penalties.move[slots, moves] = BLOCKED
        for slot, vertices, amount in self._places[i]:
            self.penalties.vertex[slot, vertices] += amount
        try:
            return self.search.shortest(
                i,
                self.penalties,
                scale=scale,
                limit=limit,
                use=use,
                forbidden=kept.forbidden,
                earliest=kept.earliest,
                latest=kept.latest,
                at_arrival=at_arrival,
            )
        finally:
            self.penalties.move[slots, moves] = before
            for slot, vertices, amount in self._places[i]:
                self.penalties.vertex[slot, vertices] -= amount

    def _load(self, lp: LpSolution) -> list[NDArray[np.int64]]:
        """Writes the LP's duals into the penalties; those on arrivals are returned per robot."""
        penalty = lp.penalty()
        self._clear()
        is_cut = lp.rows >= self.resources.n
        self.penalties.set(lp.rows[~is_cut], penalty[~is_cut])
        at_arrival = [NO_ARRIVAL_PENALTY] * self.n
        for number, amount in zip(lp.rows[is_cut].tolist(), penalty[is_cut].tolist(), strict=True):
            if amount == 0:
                continue
            cut = self.pool.cuts[number - self.resources.n]
            for robot, slot in cut.arrivals:
                if not len(at_arrival[robot]):
                    at_arrival[robot] = np.zeros(self.problem.horizon + 1, np.int64)
                at_arrival[robot][: slot + 1] += amount
            for slot, move in cut.moves:
                self.penalties.move[slot, move] += amount
            for robot, slot, vertices in cut.places:
                self._places[robot].append((slot, np.array(vertices, np.int64), amount))
        return at_arrival

    def _clear(self) -> None:
        self.penalties.clear()
        self._places = [[] for _ in range(self.n)]

    def _use(self, lp: LpSolution) -> NDArray[np.int32]:
        """(T+1, V) int32: vertices of the paths with x ≥ 0.5; ties in pricing avoid them."""
        use = np.zeros((self.problem.horizon + 1, self.problem.n_vertices), np.int32)
        for k in np.flatnonzero(lp.x >= 0.5).tolist():
            if k < len(self.master.columns):
                path = self.master.columns[k].path
                if path is not None:
                    use[np.arange(path.arrival + 1), path.vertices] += 1
        return use

    # -- restrictions --------------------------------------------------------------------------

    def _restrictions(self, decisions: tuple[Decision, ...]) -> list[Restriction]:
        own: dict[int, list[Decision]] = {}
        for decision in decisions:
            own.setdefault(decision.robot, []).append(decision)
        T = self.problem.horizon
        return [
            restrict(i, own[i], self.search.graph, self.resources, self.excluded[i])
            if i in own
            else Restriction(0, T, self.excluded[i])
            for i in range(self.n)
        ]

    def _each_has_a_path(
        self, restrictions: list[Restriction], decisions: tuple[Decision, ...]
    ) -> bool:
        """False if the last decision leaves its robot no path at all."""
        if not decisions:
            return True
        i = decisions[-1].robot
        self._clear()
        _, path = self._shortest(
            i, restrictions[i], NO_ARRIVAL_PENALTY, scale=SCALE, limit=INFINITE, use=None
        )
        return path is not None

    def _allow(self, decisions: tuple[Decision, ...]) -> None:
        self.master.allow(self._allowed(decisions))

    def _allowed(self, decisions: tuple[Decision, ...]) -> NDArray[np.bool_]:
        """(columns,) which columns keep the decisions; artificial ones always do."""
        allowed = self._not_fixed.copy()
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

    def _fix(self, node: Node, lp: LpSolution) -> bool:
        """Reduced-cost fixing at the root: excludes states no better plan's path passes.

        With the penalties of this LP every plan costs at least L = Σ_i least_i − Σ p · capacity,
        and one whose path for robot i passes a state s at least L − least_i + (least cost through
        s). If that rounds up to the best plan's cost or more, s is of no interest.

        Returns:
            Whether columns of the LP were excluded.
        """
        cutoff = self.cutoff
        states = self.n * (self.problem.horizon + 1) * self.search.graph.n_nodes
        if cutoff is None or self._fixed_at == (cutoff, node.bound) or states > MAX_STATES:
            return False
        rising = self._fixed_at is None or self.rounded(self._fixed_at[1]) < self.rounded(
            node.bound
        )
        self._fixed_at = (cutoff, node.bound)
        graph, problem = self.search.graph, self.problem
        at_arrival = self._load(lp)
        through = list(each(lambda i: self._through(i, at_arrival[i]), range(self.n)))
        least = [int(t[1].min(initial=INFINITE)) for t in through]
        capacity = self.master.capacity[lp.rows].astype(np.int64)
        bound = sum(least) - int(lp.penalty() @ capacity)
        room = (cutoff - self.unit) * SCALE - bound
        self.room = room
        for i, (cost, arriving) in enumerate(through):
            out = cost > least[i] + room
            if self.excluded[i].shape[0]:
                out |= self.excluded[i][:, : graph.n_nodes]
            amid = np.zeros((problem.horizon + 1, problem.n_aps), np.bool_)
            self.excluded[i] = np.concatenate((out, amid), axis=1)
            when = np.flatnonzero(arriving <= least[i] + room)
            if len(when):
                self.window[i] = (int(when[0]), int(when[-1]))
            # The excesses are those of this LP; states excluded before stay excluded.
            self._excess[i] = self._by_vertex(np.where(out, INFINITE, cost - least[i]))
            self._arriving[i] = np.where(arriving < INFINITE, arriving - least[i], INFINITE)
        ok = [self._may_improve(c) for c in self.master.columns]
        before, self._not_fixed = self._not_fixed, np.array(ok, np.bool_)
        self.exclusions = None  # fewer states: more of them exclude each other
        return bool(np.any(before & ~self._not_fixed)) or rising

    def _through(
        self, i: int, at_arrival: NDArray[np.int64], latest: int | None = None
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        graph, problem, p = self.search.graph, self.problem, self.penalties
        last = int(self.search.latest[i])
        vertex = p.vertex.copy() if self._places[i] else p.vertex  # others read it at this time
        for slot, vertices, amount in self._places[i]:
            vertex[slot, vertices] += amount
        cost, arriving = kernels_exact.costs_through(
            problem.horizon,
            graph.arc_ptr,
            graph.arc_to,
            graph.arc_move,
            graph.arc_slots,
            graph.arc_cost,
            graph.node_vertex,
            graph.node_ap,
            graph.nodes_at(int(problem.start[i])),
            graph.nodes_at(int(problem.goal[i])),
            SCALE,
            vertex,
            p.move,
            p.ap,
            problem.at_goal == "park",
            last if latest is None else min(last, latest),
            at_arrival,
        )
        return cost, arriving

    def _may_improve(self, column: Column) -> bool:
        """Whether a column's states are all of interest."""
        path, excluded = column.path, self.excluded[column.robot]
        if path is None or not excluded.shape[0]:
            return True
        nodes = self.search.graph.node_of[path.vertices, path.aps]
        stands = np.ones(path.arrival + 1, bool)
        if np.any(self.problem.edge_slots > 1):
            stands[1:] = path.edges < 0  # a state amid an edge is none of G'
            stands[0] = True
        return not bool(np.any(excluded[np.arange(path.arrival + 1), nodes] & stands))

    # -- cuts ----------------------------------------------------------------------------------

    def _cut(self, lp: LpSolution) -> bool:
        """Adds cuts that the solution violates; False if there are none."""
        columns, found = self.master.columns, []
        if "wait_edge" in self.params.cuts:
            found += self.pool.add(list(wait_edge.separate(self.problem, columns, lp.x)))
        if "arrival_conflict" in self.params.cuts and not np.any(self.problem.edge_slots > 1):
            if self.conflicts is None:
                self.conflicts = self._pair_conflicts()
            more = arrival_conflict.separate(
                self.conflicts, columns, lp.x, self.resources, stop=self.stop
            )
            found += self.pool.add(list(more))
        if not found and "state_exclusion" in self.params.cuts and self._fixed_at is not None:
            if self.exclusions is None and not np.any(self.problem.edge_slots > 1):
                self.exclusions = state_exclusion.StateExclusions(
                    self.problem, self._excess, self._arriving, self.room
                )
            if self.exclusions is not None:
                others = state_exclusion.separate(
                    self.exclusions, columns, lp.x, self.resources, stop=self.stop
                )
                found += self.pool.add(list(others))
        if not found:
            return False
        numbers = self.resources.n + len(self.pool.cuts) - len(found)
        members: list[list[int]] = [[] for _ in found]
        for k, column in enumerate(columns):
            if column.path is not None:
                for c in self.pool.of(column.robot, column.path, since=numbers).tolist():
                    members[c - numbers].append(k)
        self.master.add_cuts(
            np.array([cut.capacity for cut in found], np.int32),
            [np.array(m, np.int64) for m in members],
        )
        return True

    def _by_vertex(self, cost: NDArray[np.int64]) -> NDArray[np.int64]:
        """(T+1, V) the least of a (T+1, n) array over each vertex's APs."""
        # Nodes are sorted by vertex; every vertex has one (§1.8).
        first = np.flatnonzero(np.diff(self.search.graph.node_vertex, prepend=-1))
        by_vertex: NDArray[np.int64] = np.minimum.reduceat(cost, first, axis=1)
        return by_vertex

    def _pair_conflicts(self) -> arrival_conflict.PairConflicts:
        """Where and when robots can be on paths of interest, by windows after the earliest."""
        problem, graph = self.problem, self.search.graph
        self._clear()
        excess, arrives, window, lasts = [], [], [], []
        for i in range(self.n):
            first = int(self.search.distances[i].slots[graph.nodes_at(int(problem.start[i]))].min())
            lasts.append(first + arrival_conflict.SLACK)
        through = each(lambda i: self._through(i, NO_ARRIVAL_PENALTY, lasts[i]), range(self.n))
        for i, (cost, arriving) in enumerate(through):
            last = lasts[i]
            within = self._by_vertex(cost) < INFINITE
            there = arriving < INFINITE
            known = len(self._arriving[i]) > 0
            excess.append(np.where(within, self._excess[i] if known else 0, INFINITE))
            arrives.append(np.where(there, self._arriving[i] if known else 0, INFINITE))
            window.append(problem.horizon if self.window[i][1] <= last else last)
        return arrival_conflict.PairConflicts(problem, excess, arrives, self.room, window)

    # -- no plan at a node ---------------------------------------------------------------------

    def _artificial(self, lp: LpSolution) -> float:
        return float(lp.x[: self.n].max(initial=0.0))

    def _raise_artificial_cost(self, lp: LpSolution) -> bool:
        """Makes artificial paths dearer; False if they are as dear as is of use."""
        if self._start_cost > 1e9:
            return False
        self._start_cost *= 8
        for i in range(self.n):
            self.master.set_cost(i, self._start_cost)
        return True

    def _no_plan(
        self, restrictions: list[Restriction], decisions: tuple[Decision, ...]
    ) -> bool | None:
        """Phase 1 at a node: True if it is proven to hold no plan, None if stopped."""
        allowed = self._allowed(decisions)
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

    # -- plans from LP solutions ---------------------------------------------------------------

    def _round(self, lp: LpSolution) -> None:
        """A plan from an LP solution: likely paths first, A* around them, then neighbourhoods."""
        columns = self.master.columns
        order = sorted(
            (k for k in np.flatnonzero(lp.x > 1e-6).tolist() if columns[k].path is not None),
            key=lambda k: (-round(float(lp.x[k]), 6), k),
        )
        taken = Reservations(self.resources)
        paths: list[Path | None] = [None] * self.n
        for k in order:
            column = columns[k]
            used = column.used[column.used < self.resources.n]
            room = taken.count[used] < self.resources.capacity[used]
            if paths[column.robot] is None and room.all():
                paths[column.robot] = column.path
                taken.add(used)
        for i in range(self.n):
            if paths[i] is None:
                _, path = self.search.shortest(i, taken.penalties)
                paths[i] = path
                if path is not None:
                    taken.add(self.resources.used_by(path))
        if self.params.neighbourhoods and self.nodes % self.params.round_every == 0:
            improved = LargeNeighbourhoodSearch(
                self.search, self.resources, paths, seed=self.params.seed + self.nodes
            )
            improved.run(self.params.neighbourhoods)
            paths = improved.paths()
        if self.offer(paths):
            self.add([(i, p) for i, p in enumerate(paths) if p is not None])


@dataclass(frozen=True)
class ExactResult:
    """What `solve_exact` knows.

    Attributes:
        paths: the best plan, or as given if none was found.
        upper: its cost, None if there is no complete plan.
        bound: proven lower bound on the cost of every plan [1/SCALE cost units].
        infeasible: proven that there is no plan.
        nodes, rounds, cuts, columns, rows: counts, over all stages; columns and rows of the last.
        lp_value: of the master at the root without cuts, None if not reached.
        root_bound: at the root with cuts, of the last stage [cost units].
    """

    paths: tuple[Path | None, ...]
    upper: int | None
    bound: int
    infeasible: bool
    nodes: int
    rounds: int
    cuts: int
    columns: int
    rows: int
    lp_value: float | None
    root_bound: float | None

    @property
    def optimal(self) -> bool:
        """Whether the plan is proven optimal."""
        return self.upper is not None and self.bound >= self.upper * SCALE


def solve_exact(
    search: Search,
    resources: Resources,
    paths: Sequence[Path | None],
    *,
    columns: Iterable[tuple[int, Path]] = (),
    bound: int = 0,
    params: ExactParams | None = None,
    stop: Callable[[], bool] = lambda: False,
    outside: Callable[[], list[Path | None] | None] = lambda: None,
    on_progress: Callable[[ExactResult], None] = lambda _result: None,
) -> ExactResult:
    """Searches until the best plan is proven optimal, or that there is none, or a limit is met.

    It goes by stages. A stage looks only for plans cheaper than a target a little above the bound:
    the less room between bound and target, the fewer paths are of interest, and the more of them
    exclude each other. A stage that finds none has raised the bound to its target.

    Args:
        search, resources: of the problem; every robot must reach its goal when alone.
        paths: the best plan known, None for robots without a path.
        columns: further (robot, path) to start with.
        bound: a proven lower bound to start with [1/SCALE cost units].
        params: limits and means.
        stop: asked after every round of pricing; True ends the search.
        outside: asked after every round of pricing for a plan found elsewhere, None without one.
        on_progress: called after every node with what is known by then.
    """
    params = params or ExactParams()
    problem = search.problem
    known = [(i, p) for i, p in enumerate(paths) if p is not None] + list(columns)
    best: list[Path | None] = list(paths)
    step = STEP_SLOTS * max(problem.c_t, 1)
    # More than any plan can cost: no target from here on.
    most = problem.n_robots * (problem.c_t + problem.c_h) * problem.horizon + 1
    nodes = rounds = cuts = 0
    lp_value: float | None = None

    def result(tree: ExactSearch, *, root: float | None, infeasible: bool = False) -> ExactResult:
        return ExactResult(
            tuple(tree.paths),
            tree.upper,
            tree.bound,
            infeasible,
            nodes + tree.nodes,
            rounds + tree.rounds,
            cuts + len(tree.pool.cuts),
            len(tree.master.columns),
            tree.master.n_rows,
            lp_value,
            root,
        )

    target: int | None = None
    first = True
    while True:
        tree = ExactSearch(
            search,
            resources,
            best,
            columns=known,
            target=target,
            bound=bound,
            params=replace(
                params,
                nodes=1 if first else None if params.nodes is None else params.nodes - nodes,
                cuts=() if first else params.cuts,
            ),
            stop=stop,
            outside=outside,
            on_node=lambda tree: on_progress(result(tree, root=tree.root_bound[1] or None)),
        )
        tree.run()
        if first:
            lp_value = tree.root_bound[0] or None
        best, bound = tree.paths, tree.bound
        known = [(c.robot, c.path) for c in tree.master.columns if c.path is not None]
        answer = result(
            tree,
            root=None if first else tree.root_bound[1] or None,
            infeasible=tree.exhausted and tree.cutoff is None,
        )
        on_progress(answer)
        out_of_nodes = params.nodes is not None and answer.nodes >= params.nodes
        if answer.optimal or answer.infeasible or stop() or out_of_nodes:
            return answer
        if not first and not tree.exhausted:
            return answer
        nodes, rounds, cuts = answer.nodes, answer.rounds, answer.cuts
        target = tree.rounded(bound) + step
        if target >= most or (tree.upper is not None and target >= tree.upper):
            target = None
        step = step if tree.upper is not None else 2 * step
        first = False
