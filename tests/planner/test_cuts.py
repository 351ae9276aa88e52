"""Cuts hold for every plan, and cut off the fractional points they are made for."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
import pytest

from planner.cooperative import cooperative_astar
from planner.cuts import Cut, CutPool, arrival_conflict, moves_of, state_exclusion, wait_edge
from planner.exact import ExactParams, ExactSearch
from planner.expanded_graph import ExpandedGraph
from planner.master import Master
from planner.plan import Path
from planner.problem import Problem
from planner.resources import SCALE, Resources
from planner.search import INFINITE, Search
from tests.oracles.arcflow import solve_arcflow
from tests.oracles.tiny_problems import random_hall, tiny_problem
from tests.planner.examples import grid, path_of

FAMILIES = ("wait_edge", "arrival_conflict", "state_exclusion")
PLAIN = {"features": False, "max_robots": 2, "max_slots": 6}


def parts(problem: Problem) -> tuple[Resources, Search]:
    """What the tree search works on."""
    return Resources.of(problem), Search(ExpandedGraph.of(problem))


def motions(problem: Problem, robot: int) -> Iterator[tuple[int, ...]]:
    """All vertex sequences from start to goal within T, by slots, arrivals as §1.5 says."""
    goal = int(problem.goal[robot])
    if int(problem.start[robot]) == goal:
        yield (goal,)
        return
    nearby: dict[int, set[int]] = {v: {v} for v in range(problem.n_vertices)}
    for (u, v), oneway in zip(problem.edge_uv.tolist(), problem.edge_oneway, strict=True):
        nearby[u].add(v)
        if not oneway:
            nearby[v].add(u)
    grown: list[tuple[int, ...]] = [(int(problem.start[robot]),)]
    while grown:
        done = [path for path in grown if path[-1] == goal]
        yield from done
        grown = [
            (*path, v)
            for path in grown
            if len(path) <= problem.horizon
            for v in sorted(nearby[path[-1]])
        ]


def compatible(problem: Problem, one: tuple[int, ...], two: tuple[int, ...]) -> bool:
    """Whether two robots can both move so (§1.2, §1.3, §1.4); single edges only."""
    for t in range(1, problem.horizon + 1):
        places = []
        for path in (one, two):
            if t < len(path):
                places.append(path[t])
            elif problem.at_goal == "park":
                places.append(path[-1])
        if len(places) == 2 and places[0] == places[1]:
            return False
        both_move = t < len(one) and t < len(two) and one[t] != one[t - 1]
        if both_move and (one[t - 1], one[t]) == (two[t], two[t - 1]):
            return False
    return True


def two_robots(seed: int, at_goal: str) -> Problem | None:
    """A tiny problem of two robots that can both arrive, None if it is none."""
    problem = tiny_problem(seed, at_goal=at_goal, **PLAIN)
    _, search = parts(problem)
    if problem.n_robots < 2 or not all(search.can_arrive(i) for i in range(2)):
        return None
    return problem


def everything(problem: Problem) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Excesses of 0 for all states and arrivals of the paths there are."""
    stands, arrives = [], []
    for i in range(problem.n_robots):
        at = np.full((problem.horizon + 1, problem.n_vertices), INFINITE)
        when = np.full(problem.horizon + 1, INFINITE)
        for path in motions(problem, i):
            at[np.arange(len(path)), path] = 0
            when[len(path) - 1] = 0
        stands.append(at)
        arrives.append(when)
    return stands, arrives


@pytest.mark.parametrize("at_goal", ["leave", "park"])
def test_arrivals_exclude_each_other_exactly_when_no_two_paths_fit(at_goal: str) -> None:
    """The frontier of the sweep is that of all pairs of paths, tried one by one (§1.2–1.4)."""
    tried = 0
    for seed in range(40):
        problem = two_robots(seed, at_goal)
        if problem is None:
            continue
        tried += 1
        T = problem.horizon
        least = np.full(T + 1, T + 1)
        for one, two in product(motions(problem, 0), motions(problem, 1)):
            if len(two) - 1 < least[len(one) - 1] and compatible(problem, one, two):
                least[len(one) - 1] = len(two) - 1
        conflicts = arrival_conflict.PairConflicts(problem, *everything(problem), 0, [T] * 2)
        expected = np.minimum.accumulate(least)
        assert conflicts.frontier(0, 1).tolist() == expected.tolist()
        for b in range(T + 1):
            early = np.flatnonzero(expected <= b)
            assert conflicts.frontier(1, 0)[b] == (early[0] if len(early) else T + 1)
    assert tried > 15


@pytest.mark.parametrize("at_goal", ["leave", "park"])
def test_states_exclude_each_other_exactly_when_no_two_paths_fit(at_goal: str) -> None:
    """The pairs of states found by the sweep are those of all pairs of paths, tried one by one."""
    for seed in range(25):
        problem = two_robots(seed, at_goal)
        if problem is None:
            continue
        T = problem.horizon
        exclusions = state_exclusion.StateExclusions(problem, *everything(problem), 0)
        places = [exclusions.places(i) for i in range(2)]
        expected = [np.zeros_like(exclusions.matrix(0, 1, t)) for t in range(T + 1)]
        for one, two in product(motions(problem, 0), motions(problem, 1)):
            if not compatible(problem, one, two):
                continue
            for t in range(T + 1):
                # In the slot of arrival a robot is at its goal, then it has arrived.
                states: list[list[int]] = [[], []]
                for i, path in enumerate((one, two)):
                    if t >= len(path) - 1:
                        states[i].append(int(places[i][t].max()) + 1)
                    if t < len(path):
                        states[i].append(int(places[i][t, path[t]]))
                for x, y in product(*states):
                    expected[t][x, y] = True
        for t in range(T + 1):
            assert np.array_equal(exclusions.matrix(0, 1, t), expected[t]), (seed, t)


def plans(problem: Problem, count: int, seed: int) -> Iterator[list[Path]]:
    """Complete plans: cooperative A* over random orders."""
    resources, search = parts(problem)
    rng = np.random.default_rng(seed)
    for _ in range(count):
        paths = cooperative_astar(search, resources, rng.permutation(problem.n_robots).tolist())
        if all(path is not None for path in paths):
            yield [path for path in paths if path is not None]


def cost_of(problem: Problem, paths: list[Path]) -> int:
    """Cost of a plan (§1.9)."""
    return sum(problem.c_t * p.arrival + problem.c_h * p.handovers for p in paths)


@pytest.mark.parametrize("at_goal", ["leave", "park"])
@pytest.mark.parametrize("seed", range(3))
def test_no_plan_below_the_target_violates_a_cut_or_loses_a_state(seed: int, at_goal: str) -> None:
    """Cuts and excluded states hold for every plan cheaper than the target they were made for."""
    problem = random_hall(seed, size=7, n=7, T=22, at_goal=at_goal)
    resources, search = parts(problem)
    known = list(plans(problem, 40, seed))
    if not known:
        pytest.skip("cooperative A* serves no order")
    target = max(cost_of(problem, plan) for plan in known) + 1
    tree = ExactSearch(
        search,
        resources,
        [None] * problem.n_robots,
        target=target,
        params=ExactParams(nodes=2, cuts=FAMILIES, cut_rounds=(6, 2), neighbourhoods=0),
    )
    tree.offer = lambda _paths: False  # type: ignore[method-assign]  # the target must stay
    tree.run()
    for plan in known:
        members = np.zeros(len(tree.pool.cuts), int)
        for i, path in enumerate(plan):
            members[tree.pool.of(i, path) - resources.n] += 1
            states = tree.fixing.states(tree.master.column(i, path))
            assert tree.fixing.keeps(states, tree.fixing.excluded[i])
        capacity = np.array([cut.capacity for cut in tree.pool.cuts], int)
        assert np.all(members <= capacity)


def weight(pool: CutPool, paths: list[tuple[int, Path, float]], cut: Cut) -> float:
    """Σ x over the members of a cut."""
    number = pool.first + pool.cuts.index(cut)
    return sum(x for i, path, x in paths if number in pool.of(i, path))


def half_through(problem: Problem, states: list[tuple[int, str]]) -> tuple[Master, np.ndarray]:
    """A master with these paths at one half each."""
    master = Master(Resources.of(problem), 100.0)
    master.add([master.column(i, path_of(problem, i, text)) for i, text in states])
    return master, np.array([0.0] * problem.n_robots + [0.5] * len(states))


def test_wait_edge_cuts_off_who_waits_where_others_pass() -> None:
    """Half waits at vertex 1 while half comes and half goes: each row of (1c), (1d) holds."""
    problem = grid(3, 1, [(1, 2), (0, 1), (2, 0)], n_aps=1)
    # In slot 1: robot 0 waits at 1, robot 1 enters 1 over edge 0, robot 2 leaves it over edge 0.
    master, x = half_through(problem, [(0, "1a 1a 1a 2a"), (1, "0a 0a 1a"), (2, "2a 1a 0a")])
    resources = Resources.of(problem)
    activity = np.zeros(resources.n)
    for column, share in zip(master.columns, x, strict=True):
        activity[column.used] += share
    assert np.all(activity <= resources.capacity)
    (cut,) = wait_edge.separate(problem, master.columns, x)
    pool = CutPool(problem, resources.n)
    pool.add([cut])
    paths = [(c.robot, c.path, s) for c, s in zip(master.columns, x, strict=True) if c.path]
    assert weight(pool, paths, cut) == 1.5


# Two robots change ends of a passage with one bay at vertex 5, above vertex 2:
#         5
#   0 1 2 3 4     (the bay's edge joins 2 and 5)
BAY = {"edge_uv": np.array([(0, 1), (1, 2), (2, 3), (3, 4), (2, 5)])}


def passage(at_goal: str) -> Problem:
    """Robots 0 and 1 swap the ends of the passage above."""
    return grid(
        3,
        2,
        [(0, 4), (4, 0)],
        n_aps=1,
        horizon=12,
        c_h=0,
        objective="costs",
        at_goal=at_goal,
        **BAY,
    )


@pytest.mark.parametrize("family", ["arrival_conflict", "state_exclusion"])
@pytest.mark.parametrize("at_goal", ["leave", "park"])
def test_robots_do_not_pass_through_each_other_half_a_path_at_a_time(
    family: str, at_goal: str
) -> None:
    """Where two meet in a passage one gives way: the cuts raise the LP's bound to the optimum."""
    problem = passage(at_goal)
    resources, search = parts(problem)
    optimum = solve_arcflow(problem).cost
    bounds = []
    for cuts in ((), (family,)):
        tree = ExactSearch(
            search,
            resources,
            [None, None],
            target=optimum + 1,
            params=ExactParams(nodes=1, cuts=cuts, neighbourhoods=0, propagations=0),
        )
        tree.run()
        bounds.append(tree.bound / SCALE)
    assert bounds[0] <= optimum - 1.5
    assert bounds[1] == pytest.approx(optimum, abs=1e-4)


def test_moves_of_a_path_are_told_slot_by_slot() -> None:
    """Directions, waits, edges of several slots, and parking up to T as waiting."""
    problem = grid(3, 1, [(0, 2)], n_aps=1, horizon=6, at_goal="park", edge_slots=np.array([2, 1]))
    path = path_of(problem, 0, "0a 0a>0 0a>0 1a 2a")
    E = problem.n_edges
    wait = 2 * E
    assert moves_of(problem, path).tolist() == [wait + 0, 0, 0, 2, wait + 2, wait + 2]
    back = grid(3, 1, [(2, 0)], n_aps=1)
    assert moves_of(back, path_of(back, 0, "2a 1a 0a")).tolist() == [3, 1]


def test_a_cut_is_added_once() -> None:
    """The pool keeps one of equal cuts and numbers them on from the resources."""
    problem = grid(3, 1, [(0, 2)], n_aps=1)
    pool = CutPool(problem, 1000)
    cut = arrival_conflict.ArrivalConflictCut(((0, 3),))
    assert pool.add([cut, cut]) == [cut]
    assert pool.add([arrival_conflict.ArrivalConflictCut(((0, 3),))]) == []
    assert pool.of(0, path_of(problem, 0, "0a 1a 2a")).tolist() == [1000]
    assert pool.of(0, path_of(problem, 0, "0a 0a 0a 1a 2a")).tolist() == []


def test_edges_of_several_slots_are_refused_by_the_sweeps() -> None:
    """The sweeps know edges of one slot only, and say so."""
    problem = grid(3, 1, [(0, 2), (2, 0)], n_aps=1, edge_slots=np.array([2, 1]))
    with pytest.raises(ValueError, match="several slots"):
        arrival_conflict.PairConflicts(problem, [], [], 0, [])
    with pytest.raises(ValueError, match="several slots"):
        state_exclusion.StateExclusions(problem, [], [], 0)
