"""Small random problems, and random halls like the paper's, built without a world.

`tiny_problems()` is a hypothesis strategy, `tiny_problem(seed)` the same family by seed, and
`random_hall(seed, ...)` a grid with obstacles and synthetic coverage up to the paper's size.
"""

from __future__ import annotations

from collections.abc import Callable
from zlib import crc32

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from planner.problem import Problem, edge_cover_of_ends, objective_costs

Draw = Callable[[int, int], int]
"""draw(low, high): an integer, both ends included; what makes a problem random."""

HALL_M = 60.0
"""Side of a hall of any size [m], as in the paper."""

SIGHT_M, SHADOW_M = 90.0, 18.0
"""Reach of an AP with and without line of sight [m]: what the paper's link budget gives, nearly."""


def tiny_problem(seed: int, **fixed: object) -> Problem:
    """A random problem of at most 12 vertices, 4 robots, 3 APs and 7 slots; see `build`."""
    rng = _rng(seed, "tiny")
    return build(lambda low, high: int(rng.integers(low, high + 1)), **fixed)  # type: ignore[arg-type]


@st.composite
def tiny_problems(draw: st.DrawFn, **fixed: object) -> Problem:
    """The family of `tiny_problem` as a strategy that shrinks towards small plain problems."""
    return build(lambda low, high: draw(st.integers(low, high)), **fixed)  # type: ignore[arg-type]


def build(
    draw: Draw,
    *,
    max_robots: int = 4,
    max_slots: int = 7,
    features: bool = True,
    objective: str | None = None,
    at_goal: str | None = None,
) -> Problem:
    """A problem made of what `draw` gives; 0 always means the plain case.

    Holes in the grid, partial coverage, small capacities, starts that are goals, and, with
    `features`, edges of several slots, one-way edges, parallel edges, edges less covered than
    their ends, and restricted handovers.
    """
    columns, rows = draw(2, 4), draw(1, 3)
    cells = [(x, y) for y in range(rows) for x in range(columns)]
    n_holes = draw(0, max(0, len(cells) // 3))
    for _ in range(n_holes):
        if len(cells) > 2:
            cells.pop(draw(0, len(cells) - 1))
    index = {cell: k for k, cell in enumerate(cells)}
    n_aps = draw(1, 3)
    cover = np.ones((len(cells), n_aps), np.bool_)
    if n_aps > 1:
        for v in range(len(cells)):
            # One of 2^A - 1 non-empty sets of APs; 0 is all of them.
            chosen = 2**n_aps - 1 - draw(0, 2**n_aps - 2)
            cover[v] = [bool(chosen >> a & 1) for a in range(n_aps)]
    edge_uv = [
        (index[x, y], index[other])
        for x, y in cells
        for other in ((x + 1, y), (x, y + 1))
        if other in index
    ]
    if features and edge_uv and draw(0, 4) == 4:
        edge_uv.append(edge_uv[draw(0, len(edge_uv) - 1)][::-1])
    E = len(edge_uv)
    uv = np.array(edge_uv, np.int32).reshape(E, 2)
    edge_cover, edge_handover = edge_cover_of_ends(cover, uv)
    slots, oneway = np.ones(E, np.int32), np.zeros(E, np.bool_)
    if features and draw(0, 1):
        for e in range(E):
            kind = draw(0, 7)
            if kind == 5:
                slots[e] = draw(2, 3)
            elif kind == 6:
                oneway[e] = True
            elif kind == 7:
                edge_cover[e, draw(0, n_aps - 1)] = False
                edge_handover[e, draw(0, n_aps - 1)] = False
                edge_handover[e, :, draw(0, n_aps - 1)] = False
    N = draw(1, min(max_robots, len(cells)))
    T = max_slots - (draw(1, max_slots - 1) if draw(0, 2) == 2 else 0)
    at_goal = at_goal or ("leave", "park")[draw(0, 1)]
    starts = _distinct(draw, N, len(cells))
    goals = _distinct(draw, N, len(cells))
    if at_goal == "leave" and N > 1 and draw(0, 4) == 4:
        goals[0] = goals[-1]
    objective = objective or ("hp", "tp", "snr", "costs")[draw(0, 3)]
    c_t, c_h = (draw(0, 2), draw(0, 5)) if objective == "costs" else objective_costs(objective, T)
    capacity = [N - (draw(1, N) if draw(0, 2) == 2 else 0) for _ in range(n_aps)]
    snr = np.array([[10 + draw(0, 3) for _ in range(n_aps)] for _ in cells], float)
    return Problem(
        name="tiny",
        horizon=T,
        objective=objective,
        c_t=c_t,
        c_h=c_h,
        at_goal=at_goal,
        ap_ids=tuple(f"ap{a}" for a in range(n_aps)),
        ap_capacity=np.array(capacity, np.int32),
        xy_m=np.array(cells, float),
        cover=cover,
        snr_db=snr,
        edge_uv=uv,
        edge_slots=slots,
        edge_oneway=oneway,
        edge_cover=edge_cover,
        edge_handover=edge_handover,
        robot_ids=tuple(f"r{i}" for i in range(N)),
        start=np.array(starts, np.int32),
        goal=np.array(goals, np.int32),
    )


def _distinct(draw: Draw, count: int, below: int) -> list[int]:
    """`count` different numbers of 0 … below - 1, in any order."""
    left = list(range(below))
    return [left.pop(draw(0, len(left) - 1)) for _ in range(count)]


def random_hall(
    seed: int,
    size: int = 20,
    share: float = 0.3,
    n: int = 20,
    m: int = 15,
    T: int = 60,
    objective: str = "hp",
    at_goal: str = "leave",
    *,
    edge_rule: str = "endpoints",
    n_aps: int = 4,
) -> Problem:
    """A hall like the paper's: a square grid, obstacles, APs evenly spread, random errands.

    An AP covers a disc of `SIGHT_M` in sight and one of `SHADOW_M` out of it; an obstacle blocks
    it within the first third of the line from robot to AP (it is 2 m high, APs hang at 5 m, the
    antennas are at 0.5 m). On average about 2.9 of 4 APs cover a vertex, as the paper's sizes of G'
    say.

    Args:
        seed: of the draws; obstacles and robots have streams of their own.
        size: vertices per side; the hall is 60 m wide for every size.
        share: of the positions, that obstacles occupy.
        n: robots, with distinct starts and distinct goals in the largest connected component.
        m: capacity of every AP.
        T: horizon [slots].
        objective: "hp", "tp" or "snr".
        at_goal: "leave" or "park".
        edge_rule: "endpoints", or "samples" to look at three points within each edge (§1.7).
        n_aps: a square number.
    """
    pitch = HALL_M / size
    blocked = np.zeros(size * size, np.bool_)
    order = _rng(seed, "obstacles").permutation(size * size)
    blocked[order[: round(share * size * size)]] = True
    blocked = blocked.reshape(size, size)
    side = round(n_aps**0.5)
    line = (np.arange(side) + 0.5) * HALL_M / side
    ap_xy = np.array([(x, y) for y in line for x in line])

    cells = np.argwhere(~blocked.T)  # (column, row), row fastest
    xy = (cells + 0.5) * pitch
    snr = _snr_db(xy, ap_xy, blocked, pitch)
    keep = (snr >= 0).any(axis=1)
    cells, xy, snr = cells[keep], xy[keep], snr[keep]
    cover = snr >= 0
    index = np.full((size, size), -1, np.int32)
    index[tuple(cells.T)] = np.arange(len(cells))
    pairs = [
        (index[x, y], index[x + dx, y + dy])
        for x, y in cells
        for dx, dy in ((1, 0), (0, 1))
        if x + dx < size and y + dy < size and index[x + dx, y + dy] >= 0
    ]
    uv = np.array(pairs, np.int32).reshape(-1, 2)
    edge_cover, edge_handover = edge_cover_of_ends(cover, uv)
    if edge_rule == "samples":
        anywhere = np.ones(len(uv), np.bool_)
        for part in (0.25, 0.5, 0.75):
            at = (1 - part) * xy[uv[:, 0]] + part * xy[uv[:, 1]]
            here = _snr_db(at, ap_xy, blocked, pitch) >= 0
            edge_cover = edge_cover & here
            edge_handover = edge_handover & (here[:, :, None] | here[:, None, :])
            anywhere &= here.any(axis=1)
        uv = uv[anywhere]
        edge_cover, edge_handover = edge_cover[anywhere], edge_handover[anywhere]
    component = _largest_component(len(cells), uv)
    rng = _rng(seed, "robots")
    return Problem(
        name=f"hall {size}x{size}, {share:.0%} obstacles, seed {seed}",
        horizon=T,
        objective=objective,
        c_t=objective_costs(objective, T)[0],
        c_h=objective_costs(objective, T)[1],
        at_goal=at_goal,
        ap_ids=tuple(f"ap{a}" for a in range(n_aps)),
        ap_capacity=np.full(n_aps, m, np.int32),
        xy_m=xy,
        cover=cover,
        snr_db=snr + 10.0,
        edge_uv=uv,
        edge_slots=np.ones(len(uv), np.int32),
        edge_oneway=np.zeros(len(uv), np.bool_),
        edge_cover=edge_cover,
        edge_handover=edge_handover,
        robot_ids=tuple(f"r{i:02d}" for i in range(n)),
        start=rng.choice(component, n, replace=False),
        goal=rng.choice(component, n, replace=False),
    )


def _snr_db(
    xy: NDArray[np.float64],
    ap_xy: NDArray[np.float64],
    blocked: NDArray[np.bool_],
    pitch: float,
) -> NDArray[np.float64]:
    """(P, A) decibels above the threshold: 0 at the reach of an AP, in sight or out of it."""
    toward = ap_xy[None, :, :] - xy[:, None, :]
    distance = np.hypot(toward[..., 0], toward[..., 1])
    in_sight = np.ones(distance.shape, np.bool_)
    for part in np.linspace(0.0, 1 / 3, 12)[1:]:
        column, row = np.moveaxis((xy[:, None, :] + part * toward) // pitch, -1, 0).astype(int)
        # An obstacle is 0.4 pitches wide (1.2 m in the paper's hall), on its position.
        offset = np.abs((xy[:, None, :] + part * toward) / pitch % 1.0 - 0.5).max(axis=-1)
        in_sight &= ~(blocked[row, column] & (offset < 0.2))
    reach = np.where(in_sight, SIGHT_M, SHADOW_M)
    return 20.0 * np.log10(reach / np.maximum(distance, 1.0))


def _largest_component(n: int, uv: NDArray[np.int32]) -> NDArray[np.int64]:
    """Vertices of the largest connected component, the first of equals."""
    label = np.arange(n)
    changed = True
    while changed:
        before = label.copy()
        for u, v in (uv.T, uv.T[::-1]):
            np.minimum.at(label, u, label[v])
        changed = not np.array_equal(before, label)
    return np.flatnonzero(label == np.argmax(np.bincount(label)))


def _rng(seed: int, stream: str) -> np.random.Generator:
    return np.random.default_rng([seed, crc32(stream.encode()), 0])
