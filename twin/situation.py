"""What a new plan in the middle of a run begins from, and what it is (see `twin.replan`)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twin.order import Route, VisitOrder

if TYPE_CHECKING:
    from planner.problem import Problem

Bools = NDArray[np.bool_]
Ints = NDArray[np.int32]


@dataclass(frozen=True)
class Situation:
    """Where a run is at the beginning of a slot.

    Attributes:
        problem: of the run.
        order: in force.
        at: (N,) states.
        serving: (N,) AP that serves, −1 for none.
        connected: (N,) bool.
        failed: (N,) bool.
        released: (N,) crossings of its path each robot may begin.
        closed_vertex, closed_edge: (V,) and (E,) bool, what blockages block.
        out: (A,) bool, APs that do not work.
        as_planned: links are the plan's, so a new one must begin with the APs that serve.
    """

    problem: Problem
    order: VisitOrder
    at: Ints
    serving: Ints
    connected: Bools
    failed: Bools
    released: Ints
    closed_vertex: Bools
    closed_edge: Bools
    out: Bools
    as_planned: bool = False


@dataclass(frozen=True)
class NewPlan:
    """A plan from a slot on.

    Attributes:
        routes: of all robots, None for those not on the floor.
        changed: robots whose way or APs are new.
        without_path: robots that are not led to their goals.
        cost_before, cost_after: of the rest of the paths, over the robots led to their goals by
            both plans (§1.9).
    """

    routes: tuple[Route | None, ...]
    changed: tuple[int, ...]
    without_path: tuple[int, ...]
    cost_before: int
    cost_after: int


def remainder(s: Situation, i: int, until: int | None = None) -> Route:
    """What is left of robot i's path from where it is, up to state `until` (its last if None)."""
    order = s.order
    first, last = int(order.first_row[i]), int(order.arrival[i])
    at, end = int(s.at[i]), last if until is None else until
    rows = slice(first + at, first + end + 1)
    return Route(
        order.vertex[rows],
        order.ap[rows],
        order.edge[rows][:-1],
        int(order.piece[first + at]),
        bool(order.to_goal[i]) and end == last,
    )


def same_states(a: Route, b: Route) -> bool:
    """The same states, whatever the time spent in each."""
    return a.to_goal == b.to_goal and np.array_equal(_states(a), _states(b))


def _states(route: Route) -> NDArray[np.int64]:
    pairs = np.column_stack([route.vertices, route.aps]).astype(np.int64)
    kept: Bools = np.append(True, (pairs[1:] != pairs[:-1]).any(axis=1))
    return np.asarray(pairs[kept])


def collides(problem: Problem, routes: Iterable[Route | None]) -> bool:
    """Whether two routes use a vertex or an edge in the same slot (§1.2, §1.3).

    Robots that do not reach their goals stand at their ends for good, so do those that park.
    """
    at_vertex: dict[tuple[int, int], int] = {}
    on_edge: dict[tuple[int, int], int] = {}
    on_floor = [(i, r) for i, r in enumerate(routes) if r is not None]
    longest = max((len(r.edges) for _, r in on_floor), default=0)
    for i, route in on_floor:
        stays = not route.to_goal or problem.at_goal == "park"
        left, k = route.piece, 0
        for t in range(longest + 1 if stays else len(route.vertices)):
            state = min(t, len(route.edges))
            edge = int(route.edges[t]) if t < len(route.edges) else -1
            if left == 0 and at_vertex.setdefault((t, int(route.vertices[state])), i) != i:
                return True
            if edge >= 0:
                if on_edge.setdefault((t, edge), i) != i:
                    return True
                k = int(problem.edge_slots[edge])
                left = (left + 1) % k
    return False
