"""Branching decisions of the exact search, and how pricing keeps them.

Every decision restricts one robot, and comes with its complement: a path either keeps the one or
the other, so every plan is in exactly one of the two subproblems.

- `Arrive`: the robot arrives in slot `latest` at the latest | in slot `latest` + 1 at the earliest.
  A path has one arrival slot.
- `Occupy`: the robot's path uses a resource (a vertex, an edge or an AP in a slot, parking
  included) | it does not.

Two different paths of a robot differ in a resource they use: in the first slot in which they part,
they stand at different vertices, have different APs, enter different edges, or one has arrived. So
decisions of these kinds tell all paths apart, and a tree that branches on whatever is fractional
in an LP solution is finite.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planner.expanded_graph import ExpandedGraph
from planner.master import Column
from planner.resources import Resources

EPS = 1e-6


@dataclass(frozen=True)
class Arrive:
    """The robot arrives in `latest` at the latest, or, if not `early`, after it."""

    robot: int
    latest: int
    early: bool

    def keeps(self, column: Column) -> bool:
        """Whether a column's path is on this side; other robots' always are."""
        if column.robot != self.robot or column.path is None:
            return True
        return (column.path.arrival <= self.latest) == self.early


@dataclass(frozen=True)
class Occupy:
    """The robot's path uses the resource, or, if not `uses`, does not."""

    robot: int
    resource: int
    uses: bool

    def keeps(self, column: Column) -> bool:
        """Whether a column's path is on this side; other robots' always are."""
        if column.robot != self.robot or column.path is None:
            return True
        return bool(np.any(column.used == self.resource)) == self.uses


Decision = Arrive | Occupy


def complement(decision: Decision) -> Decision:
    """The other side."""
    if isinstance(decision, Arrive):
        return Arrive(decision.robot, decision.latest, not decision.early)
    return Occupy(decision.robot, decision.resource, not decision.uses)


@dataclass
class Restriction:
    """What pricing must keep to for one robot: exactly the paths that its decisions allow.

    Attributes:
        earliest, latest: of the arrival slot.
        forbidden: (T+1, n+A) bool as `Search.shortest` takes it, or shape (0, 0).
        moves: (k, 2) int64, (slot, move) that are blocked.
    """

    earliest: int
    latest: int
    forbidden: NDArray[np.bool_]
    moves: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 2), np.int64))


def restrict(
    robot: int,
    decisions: list[Decision],
    graph: ExpandedGraph,
    resources: Resources,
    excluded: NDArray[np.bool_],
) -> Restriction:
    """The restriction that a robot's decisions amount to.

    Args:
        robot: its index; `decisions` are all its own.
        decisions: in any order.
        graph, resources: of the problem.
        excluded: states excluded anyway, as `Restriction.forbidden`.
    """
    problem = graph.problem
    T, n = problem.horizon, graph.n_nodes
    result = Restriction(0, T, excluded)
    if any(isinstance(d, Occupy) for d in decisions):
        result.forbidden = np.zeros((T + 1, n + problem.n_aps), np.bool_)
        if excluded.shape[0]:
            result.forbidden |= excluded
    moves: list[NDArray[np.int64]] = []
    for decision in decisions:
        if isinstance(decision, Arrive):
            if decision.early:
                result.latest = min(result.latest, decision.latest)
            else:
                result.earliest = max(result.earliest, decision.latest + 1)
        else:
            _restrict_use(robot, decision, graph, resources, result, moves)
    if moves:
        result.moves = np.concatenate(moves)
    return result


def _restrict_use(
    robot: int,
    decision: Occupy,
    graph: ExpandedGraph,
    resources: Resources,
    result: Restriction,
    moves: list[NDArray[np.int64]],
) -> None:
    problem = graph.problem
    V, E, n = problem.n_vertices, problem.n_edges, graph.n_nodes
    parks = problem.at_goal == "park"
    r = decision.resource
    if resources.first_edge <= r < resources.first_ap:
        t, e = divmod(r - resources.first_edge, E)
        both = np.array([2 * e, 2 * e + 1])
        if decision.uses:
            both = np.delete(np.arange(2 * E + V), both)
            result.earliest = max(result.earliest, t + 1)  # who has arrived crosses no edge
        moves.append(np.stack((np.full(len(both), t), both), axis=1))
        return
    here = np.zeros(n + problem.n_aps, np.bool_)
    if r < resources.first_edge:
        t, v = divmod(r, V)
        here[graph.nodes_at(v)] = True
        may_be_parked = parks and v == int(problem.goal[robot])
    else:
        t, a = divmod(r - resources.first_ap, problem.n_aps)
        here[:n] = graph.node_ap == a
        here[n + a] = True
        may_be_parked = parks
    if decision.uses:
        result.forbidden[t] |= ~here
        if not may_be_parked:
            result.earliest = max(result.earliest, t)
    else:
        result.forbidden[t] |= here


def choose(
    columns: list[Column], x: NDArray[np.float64], resources: Resources
) -> tuple[Decision, Decision] | None:
    """What to branch on at a fractional solution: an arrival slot, else a resource.

    Of arrival slots the one is taken whose two sides both have much weight and differ much in
    slots; of resources the one used most nearly half, in the earliest slot.

    Args:
        columns: of the master.
        x: their values.
        resources: of the problem.

    Returns:
        The decision that is likelier by x, and its complement; None if no robot has two paths.
    """
    mine: dict[int, list[int]] = {}
    for k in np.flatnonzero(x > EPS).tolist():
        if columns[k].path is not None:
            mine.setdefault(columns[k].robot, []).append(k)
    best: tuple[float, Decision] | None = None
    for i in sorted(mine):
        arrival = np.array([columns[k].path.arrival for k in mine[i]])  # type: ignore[union-attr]
        weight = x[mine[i]]
        for latest in np.unique(arrival)[:-1].tolist():
            early = float(weight[arrival <= latest].sum())
            late = float(weight.sum()) - early
            if min(early, late) < EPS:
                continue
            mean_late = float(arrival[arrival > latest] @ weight[arrival > latest]) / late
            mean_early = float(arrival[arrival <= latest] @ weight[arrival <= latest]) / early
            score = min(early, late) * (mean_late - mean_early) ** 0.5
            if best is None or score > best[0] + EPS:
                best = score, Arrive(i, latest, early >= late)
    if best is None:
        best = _most_divided_resource(columns, x, mine, resources)
    return None if best is None else (best[1], complement(best[1]))


def _most_divided_resource(
    columns: list[Column],
    x: NDArray[np.float64],
    mine: dict[int, list[int]],
    resources: Resources,
) -> tuple[float, Decision] | None:
    best: tuple[float, Decision] | None = None
    for i in sorted(mine):
        if len(mine[i]) < 2:
            continue
        used = np.concatenate([columns[k].used for k in mine[i]])
        weight = np.concatenate([np.full(len(columns[k].used), x[k]) for k in mine[i]])
        known = used < resources.n  # cuts are numbered on from the resources
        numbers, place = np.unique(used[known], return_inverse=True)
        share = np.bincount(place, weights=weight[known])
        whole = float(x[mine[i]].sum())
        divided = np.minimum(share, whole - share)
        if not len(divided) or divided.max() < EPS:
            continue
        top = np.flatnonzero(divided > divided.max() - EPS)
        slots = np.array([_slot(int(numbers[k]), resources) for k in top])
        k = int(top[np.argmin(slots)])
        if best is None or divided[k] > best[0] + EPS:
            best = float(divided[k]), Occupy(i, int(numbers[k]), bool(share[k] >= whole / 2))
    return best


def _slot(resource: int, resources: Resources) -> int:
    problem = resources.problem
    if resource < resources.first_edge:
        return resource // problem.n_vertices
    if resource < resources.first_ap:
        return (resource - resources.first_edge) // problem.n_edges
    return (resource - resources.first_ap) // problem.n_aps
