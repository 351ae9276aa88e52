"""Problems and plans for the tests of the twin: made by hand, or at random by simple rules."""

from __future__ import annotations

from collections import deque
from itertools import pairwise

import numpy as np

from planner.plan import Path, Plan
from planner.problem import Problem, edge_cover_of_ends


def make_problem(
    xy,
    edges,
    errands,
    *,
    cover=None,
    slots=None,
    capacity=99,
    horizon=60,
    at_goal="leave",
    oneway=None,
) -> Problem:
    """A problem on a drawn graph; one AP covers everything unless told otherwise.

    Args:
        xy: vertices [m].
        edges: pairs of vertices.
        errands: (start, goal) of each robot; robots are named r0, r1, ….
        cover: for each vertex, the APs that cover it.
        slots: of each edge, 1 if left out.
        capacity: of every AP.
        horizon: T.
        at_goal: "leave" or "park".
        oneway: for each edge, False if left out.
    """
    xy = np.array(xy, float)
    aps = 1 + max((a for row in cover for a in row), default=0) if cover else 1
    covers = np.zeros((len(xy), aps), bool)
    for v in range(len(xy)):
        covers[v, list(cover[v]) if cover else [0]] = True
    uv = np.array(edges, np.int32).reshape(-1, 2)
    edge_cover, handover = edge_cover_of_ends(covers, uv)
    n = len(errands)
    return Problem(
        name="by hand",
        horizon=horizon,
        objective="hp",
        c_t=1,
        c_h=horizon,
        at_goal=at_goal,
        ap_ids=tuple(f"ap{a}" for a in range(aps)),
        ap_capacity=np.full(aps, capacity, np.int32),
        xy_m=xy,
        cover=covers,
        snr_db=np.where(covers, 20.0, np.nan),
        edge_uv=uv,
        edge_slots=np.array(slots or [1] * len(uv), np.int32),
        edge_oneway=np.array(oneway or [False] * len(uv), bool),
        edge_cover=edge_cover,
        edge_handover=handover,
        robot_ids=tuple(f"r{i}" for i in range(n)),
        start=np.array([s for s, _ in errands], np.int32),
        goal=np.array([g for _, g in errands], np.int32),
    )


def walk(problem: Problem, robot: str, *places, aps=None) -> Path:
    """The path through `places` (vertices, one per slot while waiting or on edges of one slot).

    An edge of k slots is crossed by naming its end; the k states are filled in. `aps` are those of
    the places (all 0 if left out); on an edge that of the vertex left.
    """
    aps = aps or [0] * len(places)
    index = {}
    for e, (u, v) in enumerate(problem.edge_uv.tolist()):
        index[u, v] = index[v, u] = e
    vertices, served, edges = [places[0]], [aps[0]], []
    for before, after, a, b in zip(places, places[1:], aps, aps[1:], strict=False):
        e = -1 if before == after else index[before, after]
        k = 1 if e < 0 else int(problem.edge_slots[e])
        vertices += [before] * (k - 1) + [after]
        served += [a] * (k - 1) + [b]
        edges += [e] * k
    return Path(robot, np.array(vertices), np.array(served), np.array(edges, np.int32))


def make_plan(problem: Problem, *paths) -> Plan:
    """A plan of these paths, in the robots' order; None for a robot without one."""
    cost = sum(problem.c_t * p.arrival + problem.c_h * p.handovers for p in paths if p)
    status = "feasible" if None not in paths else "unknown"
    return Plan(status, problem.robot_ids, tuple(paths), cost, None)


def grid(columns: int, rows: int, pitch: float = 1.0):
    """(vertices, edges) of a grid, vertex numbers row by row."""
    xy = [(c * pitch, r * pitch) for r in range(rows) for c in range(columns)]
    edges = []
    for r in range(rows):
        for c in range(columns):
            v = r * columns + c
            edges += [(v, v + 1)] if c + 1 < columns else []
            edges += [(v, v + columns)] if r + 1 < rows else []
    return xy, edges


def random_plan(problem: Problem, rng, *, wait: float = 0.15, tries: int = 60) -> Plan:
    """A plan without collisions (§1.1–§1.5): robots one after the other, around those before.

    Each walks a breadth-first shortest way in space and time with random choices among neighbours
    and random pauses; robots that find none within the horizon have no path. Capacities are not
    looked at, so APs may be overloaded.
    """
    T = problem.horizon
    at_vertex: set[tuple[int, int]] = {(int(v), 0) for v in problem.start}
    on_edge: set[tuple[int, int]] = set()
    around: list[list[tuple[int, int, int]]] = [[] for _ in range(problem.n_vertices)]
    for e, (u, v) in enumerate(problem.edge_uv.tolist()):
        around[u].append((e, v, int(problem.edge_slots[e])))
        if not problem.edge_oneway[e]:
            around[v].append((e, u, int(problem.edge_slots[e])))
    parks = problem.at_goal == "park"
    goals = {int(g) for g in problem.goal} if parks else set()

    paths: list[Path | None] = [None] * problem.n_robots
    for i in rng.permutation(problem.n_robots).tolist():
        start, goal = int(problem.start[i]), int(problem.goal[i])
        came: dict[tuple[int, int], tuple[tuple[int, int], int] | None] = {(start, 0): None}
        queue = deque([(start, 0)])
        found = None
        while queue:
            v, t = queue.popleft()
            if v == goal and (
                not parks or all((v, s) not in at_vertex for s in range(max(t, 1), T + 1))
            ):
                found = v, t
                break
            moves = [(-1, v, 1), *around[v]]
            order = rng.permutation(len(moves)) if rng.random() > wait else range(len(moves))
            for e, u, k in (moves[m] for m in order):
                if t + k > T or (u, t + k) in came or (u, t + k) in at_vertex:
                    continue
                if e >= 0 and any((e, s) in on_edge for s in range(t, t + k)):
                    continue
                if u != goal and u in goals:  # somebody may park there
                    continue
                came[u, t + k] = (v, t), e
                queue.append((u, t + k))
        if found is None:
            # It stays where it is for good; nobody may pass.
            at_vertex |= {(start, t) for t in range(T + 1)}
            continue
        steps = []
        while came[found] is not None:
            before, e = came[found]
            steps.append((before, found, e))
            found = before
        vertices, edges = [start], []
        for (v, t), (u, s), e in reversed(steps):
            vertices += [v] * (s - t - 1) + [u]
            edges += [e] * (s - t)
            at_vertex.add((u, s))
            if e >= 0:
                on_edge |= {(e, q) for q in range(t, s)}
        if parks:
            at_vertex |= {(goal, t) for t in range(len(vertices) - 1, T + 1)}
        aps = serve(problem, vertices, edges, rng)
        if aps is not None:
            paths[i] = Path(problem.robot_ids[i], np.array(vertices), np.array(aps),
                            np.array(edges, np.int32))  # fmt: skip
    return make_plan(problem, *paths)


def serve(problem: Problem, vertices, edges, rng=None):
    """APs along a walk with the fewest handovers that §1.6 and §1.7 allow, None if there are none.

    With `rng`, random ones among those allowed.
    """
    n, t = len(vertices), 0
    stops = [0]
    while t < n - 1:
        t += 1 if edges[t] < 0 else int(problem.edge_slots[edges[t]])
        stops.append(t)
    eye = np.eye(problem.n_aps, dtype=bool)
    best = [np.where(problem.cover[vertices[0]], 0.0, np.inf)]
    back = []
    for before, _ in pairwise(stops):
        v, e = vertices[before], edges[before]
        cost = np.full((problem.n_aps, problem.n_aps), np.inf)
        if e < 0:
            cost[np.outer(problem.cover[v], problem.cover[v])] = 1
            cost[eye & problem.cover[v]] = 0
        else:
            pairs = problem.edge_handover[e]
            cost[pairs if problem.edge_uv[e][0] == v else pairs.T] = 1
            cost[eye & problem.edge_cover[e]] = 0
        if rng is not None:
            cost += rng.random(cost.shape)
        total = best[-1][:, None] + cost
        back.append(total.argmin(axis=0))
        best.append(total.min(axis=0))
    if not np.isfinite(best[-1]).any():
        return None
    a = int(best[-1].argmin())
    aps = [0] * n
    aps[n - 1] = a
    for (before, after), choice in reversed(list(zip(pairwise(stops), back, strict=True))):
        a = int(choice[a])
        for s in range(before, after):
            aps[s] = a
    return aps
