"""A bound for fleets whose master does not fit in one LP: that of its groups, one after another.

A plan of all robots is a plan of every group of them, so for any partition of the robots into
groups the sum of lower bounds of the groups, each as if alone on the floor with all of its room, is
a lower bound. Robots that are in each other's way on their best paths go into one group; groups are
united, the likest first, up to a size that grows, so that the bound rises from level to level. The
work of a level grows with the number of robots, where that of one master for all grows much faster.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from planner.master import Master
from planner.pgcp import PgcpState, artificial_cost, generate_paths
from planner.plan import Path
from planner.pricing import best_paths
from planner.resources import Resources
from planner.search import INFINITE, Penalties, Search

SIZES = (15, 30, 60, 120)
"""Robots in a group at most, level by level."""

CROWD = 12
"""Resources that more robots than this want say little about who is in whose way."""


@dataclass
class GroupBounds:
    """What is proven of the groups so far.

    Attributes:
        bound: on the cost of every plan [1/SCALE cost units].
        rows, penalty: resources and penalties > 0 [1/SCALE], summed over the groups: room of one
            unit more in a resource takes no more than its penalty off the bound.
        columns: (robot, path) generated.
        groups: the partition.
        rounds: of pricing.
    """

    bound: int
    rows: NDArray[np.int64]
    penalty: NDArray[np.int64]
    columns: list[tuple[int, Path]]
    groups: list[tuple[int, ...]]
    rounds: int = 0


@dataclass
class _Group:
    robots: tuple[int, ...]
    bound: int
    rows: NDArray[np.int64]
    penalty: NDArray[np.int64]
    columns: list[tuple[int, Path]]


def group_bounds(
    search: Search,
    resources: Resources,
    paths: Callable[[], Sequence[Path | None]],
    *,
    sizes: Iterable[int] = SIZES,
    hurry: Callable[[], bool] = lambda: False,
) -> Iterator[GroupBounds]:
    """Bounds that rise, one after each group of robots.

    Args:
        search, resources: of the problem; every robot must reach its goal when alone.
        paths: the best plan by now.
        sizes: of the groups, level by level.
        hurry: asked every few robots; True ends it.
    """
    n = search.problem.n_robots
    nothing = np.empty(0, np.int64)
    penalties = Penalties(resources)
    use = np.zeros((search.problem.horizon + 1, search.problem.n_vertices), np.int32)
    groups: list[_Group] = []
    alone: list[Path] = []
    for i in range(n):
        if hurry():
            return
        limits = np.full(1, INFINITE)
        (cost,), (path,) = best_paths(search, [i], penalties, limits=limits, use=use)
        assert path is not None
        alone.append(path)
        groups.append(_Group((i,), int(cost), nothing, nothing, [(i, path)]))
    likeness = _likeness(resources, alone)
    rounds = 0
    for size in sizes:
        for members in _united([g.robots for g in groups], likeness, size):
            old = [g for g in groups if g.robots[0] in members]
            if len(old) < 2:
                continue
            united, done = _solve(search, resources, old, paths(), hurry)
            rounds += done
            groups = [g for g in groups if g.robots[0] not in members]
            groups.append(united)
            yield _summary(resources, groups, rounds)
            if hurry():
                return


def _likeness(resources: Resources, alone: Sequence[Path]) -> dict[tuple[int, int], float]:
    """How much pairs of robots want the same places in the same slots."""
    used = [resources.used_by(path) for path in alone]
    robot = np.repeat(np.arange(len(used)), [len(u) for u in used])
    index = np.concatenate(used)
    place = index < resources.first_ap
    robot, index = robot[place], index[place]
    order = np.lexsort((robot, index))
    robot, index = robot[order], index[order]
    likeness: dict[tuple[int, int], float] = {}
    bounds = np.flatnonzero(np.diff(index, prepend=-1, append=-1))
    for begin, end in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        if 2 <= end - begin <= CROWD:
            for pair in combinations(robot[begin:end].tolist(), 2):
                likeness[pair] = likeness.get(pair, 0.0) + 1.0
    return likeness


def _united(
    groups: Sequence[tuple[int, ...]], likeness: dict[tuple[int, int], float], size: int
) -> list[frozenset[int]]:
    """Unions of groups of at most `size` robots, the likest pairs of robots united first."""
    of = {i: k for k, group in enumerate(groups) for i in group}
    members = [set(group) for group in groups]
    changed = set()
    for i, j in sorted(likeness, key=lambda pair: (-likeness[pair], pair)):
        a, b = of[i], of[j]
        if a == b or len(members[a]) + len(members[b]) > size:
            continue
        members[a] |= members[b]
        for k in members[b]:
            of[k] = a
        members[b] = set()
        changed.add(a)
    return [frozenset(members[a]) for a in sorted(changed) if members[a]]


def _solve(
    search: Search,
    resources: Resources,
    parts: Sequence[_Group],
    paths: Sequence[Path | None],
    hurry: Callable[[], bool],
) -> tuple[_Group, int]:
    """Path generation for a group as if it were alone on the floor; rounds of pricing."""
    robots = tuple(sorted(i for part in parts for i in part.robots))
    place = {i: k for k, i in enumerate(robots)}
    problem = search.problem
    part = replace(
        problem,
        robot_ids=tuple(problem.robot_ids[i] for i in robots),
        start=problem.start[list(robots)],
        goal=problem.goal[list(robots)],
    )
    graph = replace(search.graph, problem=part)
    room = Resources(part, resources.capacity)
    alone = Search(graph, tuple(search.distances[i] for i in robots))
    state = PgcpState(graph, room, alone, Master(room, artificial_cost(part)))
    known = [(i, path) for i in robots if (path := paths[i]) is not None]
    for i, path in [*known, *(column for group in parts for column in group.columns)]:
        state.master.add([state.master.column(place[i], path)])
    generate_paths(
        state, range(len(robots)), stop=lambda _state: hurry(), complete=False, hurry=hurry
    )
    columns = [(robots[c.robot], c.path) for c in state.master.columns if c.path is not None]
    before = sum(group.bound for group in parts)
    if state.bound <= before:
        rows, penalty = _summed(resources, parts)
        return _Group(robots, before, rows, penalty, columns), state.iterations
    group = _Group(robots, state.bound, state.bound_rows, state.bound_penalty, columns)
    return group, state.iterations


def _summed(
    resources: Resources, groups: Sequence[_Group]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    dense = np.zeros(resources.n, np.int64)
    for group in groups:
        dense[group.rows] += group.penalty
    rows = np.flatnonzero(dense)
    return rows, dense[rows]


def _summary(resources: Resources, groups: Sequence[_Group], rounds: int) -> GroupBounds:
    return GroupBounds(
        sum(group.bound for group in groups),
        *_summed(resources, groups),
        [column for group in groups for column in group.columns],
        [group.robots for group in groups],
        rounds,
    )
