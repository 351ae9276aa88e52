"""Planning anew in the middle of a run: from where the robots are to a new visit order.

At the beginning of a slot the robots on the floor fall into four kinds:

- *free*: connected and whole; they get new paths, by cooperative A* and neighbourhood search, from
  where they stand (or from the end of the edge they are on, reached in the slots it still takes);
- *bound*: without connection, but not at the end of what was released to them, or amid a crossing
  though failed: they cannot be told otherwise, so they keep that remainder, and its vertices are
  theirs alone; free robots that stand there leave first. So do free robots for which the search
  finds no way: what was released may lead them to where there is one;
- *fixed*: failed, or at the end of what was released, without connection or a way: they stay, and
  their vertices belong to the closed floor;
- *done*: parked, or in their last slot.

What stands in the way is closed, APs that are out have capacity 0, those who stay use up their
places. Costs are those of the run's problem (c_h stays what T made it there). All limits are
counts, so the same situation gives the same plan.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twin.order import Route
from twin.serving import has_begun, keep_serving
from twin.situation import NewPlan, Situation, collides, remainder, same_states

if TYPE_CHECKING:
    from planner.plan import Path
    from planner.problem import Problem

Bools = NDArray[np.bool_]
Ints = NDArray[np.int32]

__all__ = ["NewPlan", "Situation", "plan_anew"]

ROUNDS = 6
"""Times the search is asked again with robots that found no way left standing."""
RESTARTS = 5
"""Further orders cooperative A* tries in each."""


def plan_anew(s: Situation, *, seed: int, iterations: int) -> NewPlan | None:
    """A plan for what is left to do, None if the search finds none that is better than waiting.

    Args:
        s: where the run is.
        seed: of the search's random choices.
        iterations: neighbourhoods tried to better its first plan.
    """
    try:
        return _Replanning(s, seed, iterations).run()
    except _NoPlanError:
        return None


class _NoPlanError(Exception):
    """The situation leaves nothing to plan, or nothing safe was found."""


class _Replanning:
    """One call of `plan_anew`."""

    def __init__(self, s: Situation, seed: int, iterations: int) -> None:
        self.s, self.seed, self.iterations = s, seed, iterations
        order, problem = s.order, s.problem
        on_floor = ~order.gone(s.at)
        self.row = order.row(s.at)
        piece = np.where(on_floor, order.piece[self.row], 0)
        self.amid = piece > 0
        self.done = on_floor & (order.done(s.at) | ((s.at == order.arrival) & order.to_goal))
        able = on_floor & ~self.done
        self.free = able & s.connected & ~s.failed & (s.serving >= 0)
        self.ends = {i: self._released_end(i) for i in np.flatnonzero(able & ~self.free).tolist()}
        fixed = [i for i, end in self.ends.items() if end == s.at[i]]
        self.fixed = {i: int(order.vertex[self.row[i]]) for i in fixed}
        self.ends = {i: end for i, end in self.ends.items() if i not in self.fixed}
        self.parked = [
            int(order.vertex[self.row[i]]) for i in np.flatnonzero(self.done) if order.park
        ]
        self.horizon = problem.horizon

    def _released_end(self, i: int) -> int:
        """The state that robot i, which cannot be told otherwise, still drives to."""
        s, order = self.s, self.s.order
        first, at, last = int(order.first_row[i]), int(s.at[i]), int(order.arrival[i])
        rows = np.arange(first + at, first + last + 1)
        begun = order.begun[rows]
        limit = begun[0] if s.failed[i] else max(int(s.released[i]), int(begun[0]))
        allowed = int(np.flatnonzero(begun <= limit)[-1])
        end = at + allowed
        while end > at and order.edge[first + end - 1] < 0 and order.piece[first + end] == 0:
            end -= 1  # waits at the end add nothing
        return end

    # --- the road -----------------------------------------------------------------------------

    def run(self) -> NewPlan:
        paths: dict[int, Path] = {}
        free = np.flatnonzero(self.free).tolist()
        for _ in range(ROUNDS):
            self._cut_bound()
            if not free:
                raise _NoPlanError  # it would change nothing
            paths, lost = self._search(list(free))
            if not lost:
                break
            for i in lost:
                free.remove(i)
                # It keeps what is released to it (the end of its edge at least): that may lead it
                # to where there is a way.
                self.ends[i] = max(self._released_end(i), int(self.s.at[i]) + self._left(i))
                if self.ends[i] == self.s.at[i]:
                    self.fixed[i] = int(self.s.order.vertex[self.row[i]])
                    del self.ends[i]
        else:
            raise _NoPlanError
        return self._assemble(paths)

    def _left(self, i: int) -> int:
        """Slots robot i still takes for the crossing it is in, 0 if it is in none."""
        row = int(self.row[i])
        if not self.amid[i]:
            return 0
        slots = int(self.s.problem.edge_slots[self.s.order.edge[row]])
        return slots - int(self.s.order.piece[row])

    def _cut_bound(self) -> None:
        """Bound robots end before vertices that somebody stands on for good, or that are closed."""
        order, at = self.s.order, self.s.at
        again = True
        while again:
            again = False
            for i, end in list(self.ends.items()):
                first, here = int(order.first_row[i]), int(at[i])
                taken = set(self.fixed.values()) | set(self.parked)
                ends = {
                    int(order.vertex[order.first_row[k] + e]): e
                    for k, e in self.ends.items()
                    if k != i
                }
                cut = here
                for state in range(here, end):
                    row = first + state
                    if order.edge[row] < 0:
                        cut = state + 1 if order.piece[row] == 0 else cut
                        continue
                    target, edge = int(order.next_vertex[row]), int(order.edge[row])
                    shut = target in taken or ends.get(target, end + 1) <= state
                    shut |= bool(self.s.closed_vertex[target] or self.s.closed_edge[edge])
                    if shut:
                        break
                    if order.piece[row + 1] == 0:
                        cut = state + 1
                if cut == end:
                    continue
                if self.amid[i] and cut == here:
                    raise _NoPlanError  # it is stuck on its edge
                while cut > here and order.edge[first + cut - 1] < 0:
                    cut -= 1
                again = True
                if cut == here:
                    del self.ends[i]
                    self.fixed[i] = int(order.vertex[first + here])
                else:
                    self.ends[i] = cut

    def _reserved(self) -> Bools:
        """(V,) vertices that no free robot may enter."""
        order, problem = self.s.order, self.s.problem
        closed = self.s.closed_vertex.copy()
        closed[list(self.fixed.values())] = True
        closed[self.parked] = True
        for i, end in self.ends.items():
            first, at = int(order.first_row[i]), int(self.s.at[i])
            closed[order.vertex[first + at + int(self.amid[i]) : first + end + 1]] = True
            closed[order.vertex[first + end]] = True
        assert len(closed) == problem.n_vertices
        return closed

    def _search(self, planned: list[int]) -> tuple[dict[int, Path], list[int]]:
        """Paths of robots in the problem of this moment, and those that found none."""
        from planner.cooperative import cooperative_with_restarts
        from planner.expanded_graph import ExpandedGraph
        from planner.improve import LargeNeighbourhoodSearch
        from planner.resources import Resources
        from planner.search import Search

        problem, edges = self._problem(planned)
        search, resources = Search(ExpandedGraph.of(problem)), Resources.of(problem)
        lost = [i for k, i in enumerate(planned) if not search.can_arrive(k)]
        if lost:
            return {}, lost
        # Not `solve`: where robots exceed the APs' places it proves that no plan serves them all,
        # and names all that share these places; here only those left over must stay behind.
        rng = np.random.default_rng([self.seed, 1])
        found = cooperative_with_restarts(search, resources, restarts=RESTARTS, rng=rng)
        lost = [i for i, path in zip(planned, found, strict=True) if path is None]
        if lost:
            return {}, lost
        if self.iterations and len(planned) > 1:
            better = LargeNeighbourhoodSearch(search, resources, found, seed=self.seed)
            better.run(self.iterations)
            found = better.paths()
        paths: dict[int, Path] = {}
        for i, path in zip(planned, found, strict=True):
            assert path is not None
            paths[i] = path
            if self.amid[i] and path.arrival and path.edges[0] < 0:
                lost.append(i)  # it cannot wait in the middle of its edge by plan
        self.edges = edges
        return paths, lost

    # --- the problem --------------------------------------------------------------------------

    def _problem(self, planned: list[int]) -> tuple[Problem, Ints]:
        """The problem of this moment, and for each of its edges the run's edge."""
        s, run = self.s, self.s.problem
        closed = self._reserved()
        u, v = run.edge_uv.T
        shut = s.closed_edge | (closed[u] & closed[v])
        shut[s.order.edge[self.row[self.amid]]] = True
        shut |= run.edge_oneway & closed[v]
        kept = np.flatnonzero(~shut)
        flip = closed[v[kept]]  # then only the way out of v is left: written as v → u
        uv = np.where(flip[:, None], run.edge_uv[kept][:, ::-1], run.edge_uv[kept])
        handover = run.edge_handover[kept]
        handover = np.where(flip[:, None, None], handover.transpose(0, 2, 1), handover)
        oneway = run.edge_oneway[kept] | closed[u[kept]] | closed[v[kept]]
        columns = {
            "xy_m": run.xy_m,
            "cover": run.cover,
            "snr_db": run.snr_db,
            "edge_uv": uv,
            "edge_slots": run.edge_slots[kept],
            "edge_oneway": oneway,
            "edge_cover": run.edge_cover[kept],
            "edge_handover": handover,
        }
        start = s.order.vertex[self.row[planned]].copy()
        edges = kept.astype(np.int32)
        for n, i in enumerate(planned):
            if self.amid[i] and not s.closed_edge[s.order.edge[self.row[i]]]:
                start[n] = len(columns["xy_m"])
                edges = self._add_amid(columns, edges, i)
        return replace(
            run,
            objective="costs",
            **columns,
            ap_capacity=self._capacity(planned, start, columns["cover"]),
            robot_ids=tuple(run.robot_ids[i] for i in planned),
            start=start,
            goal=run.goal[planned],
        ), edges

    def _add_amid(self, columns: dict[str, NDArray[np.generic]], edges: Ints, i: int) -> Ints:
        """A vertex of its own for a robot amid a crossing, from which it can only drive on."""
        run, order, row = self.s.problem, self.s.order, int(self.row[i])
        edge, vertex, to = int(order.edge[row]), int(order.vertex[row]), int(order.next_vertex[row])
        serves = np.zeros((1, run.n_aps), np.bool_)
        serves[0, order.ap[row]] = True
        handover = run.edge_handover[edge]
        handover = handover if run.edge_uv[edge, 0] == vertex else handover.T
        share = int(order.piece[row]) / int(run.edge_slots[edge])
        leads = (handover & serves[0][:, None]), run.edge_cover[edge] & serves[0]
        now = int(self.s.serving[i])
        if now >= 0 and handover[order.ap[row], now]:  # the handover of this crossing is made
            leads = np.outer(serves[0], np.arange(run.n_aps) == now), np.zeros_like(serves[0])
        own = {
            "xy_m": ((1.0 - share) * run.xy_m[vertex] + share * run.xy_m[to])[None],
            "cover": serves,
            "snr_db": np.where(serves, run.snr_db[vertex], np.nan),
            "edge_uv": np.array([[len(columns["xy_m"]), to]], np.int32),
            "edge_slots": np.array([self._left(i)], np.int32),
            "edge_oneway": np.array([True]),
            "edge_cover": leads[1][None],
            "edge_handover": leads[0][None],
        }
        for name, value in own.items():
            columns[name] = np.concatenate([columns[name], value])
        return np.append(edges, np.int32(edge))

    def _capacity(self, planned: list[int], start: Ints, cover: NDArray[np.generic]) -> Ints:
        """(A,) places left for free robots."""
        s = self.s
        left = s.problem.ap_capacity.astype(np.int64)
        others = [i for i in np.flatnonzero(~s.order.gone(s.at)).tolist() if i not in planned]
        served = s.serving[others]
        left -= np.bincount(served[served >= 0], minlength=len(left))
        left = np.where(s.out, 0, np.maximum(left, 0))
        # Who is somewhere only one AP reaches is served by it, whatever its load.
        reach = cover[start].astype(np.bool_) & ~s.out
        alone = reach[reach.sum(axis=1) == 1].sum(axis=0)
        return np.where(s.out, 0, np.maximum(left, alone)).astype(np.int32)

    # --- the answer ---------------------------------------------------------------------------

    def _assemble(self, paths: dict[int, Path]) -> NewPlan:
        s = self.s
        routes: list[Route | None] = [None] * s.problem.n_robots
        for i in np.flatnonzero(self.done).tolist():
            routes[i] = remainder(s, i, int(s.at[i]))
        for i, vertex in self.fixed.items():
            routes[i] = Route(
                np.array([vertex], np.int32),
                np.array([self._ap_of_fixed(i)], np.int32),
                np.empty(0, np.int32),
                0,
                False,
            )
        own = {i: self._route(i, path) for i, path in paths.items()}
        places = self._capacity(list(own), *self._where(own))
        own = keep_serving(s.problem, own, s.serving, places, s.out)
        for i, route in (own | self._bound(own)).items():
            routes[i] = route
        if collides(s.problem, routes) or (s.as_planned and self._changes_silently(routes)):
            raise _NoPlanError
        return self._told(tuple(routes))

    def _changes_silently(self, routes: list[Route | None]) -> bool:
        """Whether a robot would be served by another AP without a handover."""
        pairs = zip(routes, self.s.serving.tolist(), strict=True)
        return any(
            route is not None and route.aps[0] != ap and not has_begun(route, ap)
            for route, ap in pairs
        )

    def _ap_of_fixed(self, i: int) -> int:
        """AP a robot that stays shall have: its own, its path's, or any, so that it covers it."""
        cover = self.s.problem.cover[self.fixed[i]]
        for a in (int(self.s.serving[i]), int(self.s.order.ap[self.row[i]])):
            if a >= 0 and cover[a]:
                return a
        return int(cover.argmax())

    def _where(self, own: dict[int, Route]) -> tuple[Ints, Bools]:
        """Where free robots are, and what covers it."""
        return np.array([r.vertices[0] for r in own.values()], np.int32), self.s.problem.cover

    def _route(self, i: int, path: Path) -> Route:
        """A path of this moment's problem in the terms of the run's."""
        edges = np.where(path.edges >= 0, self.edges[path.edges], -1).astype(np.int32)
        vertices = path.vertices.copy()
        if not self.amid[i]:
            return Route(vertices, path.aps, edges)
        row = int(self.row[i])
        vertices[: self._left(i)] = self.s.order.vertex[row]
        return Route(vertices, path.aps, edges, int(self.s.order.piece[row]))

    def _bound(self, own: dict[int, Route]) -> dict[int, Route]:
        """Remainders of bound robots, put off until the free ones have left their vertices."""
        s, order = self.s, self.s.order
        if not self.ends:
            return {}
        leaves: dict[int, int] = {}  # vertex -> slot in which the free robot that is there leaves
        for route in own.values():
            if not route.piece:
                moves = np.flatnonzero(route.edges >= 0)
                leaves[int(route.vertices[0])] = int(moves[0]) if len(moves) else len(route.edges)
        begin = min(int(s.at[i]) for i in self.ends)
        late = 0
        for i, end in self.ends.items():
            first = int(order.first_row[i])
            for state in range(int(s.at[i]) + 1, end + 1):
                vertex = int(order.vertex[first + state])
                if vertex in leaves and order.piece[first + state] == 0:
                    late = max(late, leaves[vertex] + 1 - (state - begin))
        found = {}
        for i, end in self.ends.items():
            left = remainder(s, i, end)
            wait = int(s.at[i]) - begin + late
            if self.amid[i]:  # it cannot wait where it is: it waits at the end of its edge
                at_end = self._left(i)
                head, tail = left.vertices[: at_end + 1], left.vertices[at_end + 1 :]
                vertices = np.concatenate([head, np.repeat(head[-1:], wait), tail])
                aps = np.concatenate(
                    [left.aps[: at_end + 1], np.repeat(left.aps[at_end : at_end + 1], wait),
                     left.aps[at_end + 1 :]]
                )  # fmt: skip
                edges = np.concatenate(
                    [left.edges[:at_end], np.full(wait, -1, np.int32), left.edges[at_end:]]
                )
            else:
                vertices = np.concatenate([np.repeat(left.vertices[:1], wait), left.vertices])
                aps = np.concatenate([np.repeat(left.aps[:1], wait), left.aps])
                edges = np.concatenate([np.full(wait, -1, np.int32), left.edges])
            found[i] = Route(vertices, aps, edges, left.piece, left.to_goal)
        return found

    def _told(self, routes: tuple[Route | None, ...]) -> NewPlan:
        s, problem = self.s, self.s.problem
        changed, before, after = [], 0, 0
        for i, route in enumerate(routes):
            if route is None or self.done[i]:
                continue
            old = remainder(s, i)
            if not same_states(old, route):
                changed.append(i)
            if old.to_goal and route.to_goal:
                for cost, r in ((0, old), (1, route)):
                    value = problem.c_t * len(r.edges)
                    value += problem.c_h * int(np.count_nonzero(np.diff(r.aps)))
                    before, after = (before, after + value) if cost else (before + value, after)
        without = [i for i, r in enumerate(routes) if r is not None and not r.to_goal]
        return NewPlan(routes, tuple(changed), tuple(without), before, after)
