"""Instance families: each yields named problems of growing size, from seeds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from planner.problem import Problem

ROOT = Path(__file__).resolve().parents[1]
MOVINGAI = ROOT.parent / "shared" / "data" / "movingai"

WAREHOUSES = {50: (6, 2), 100: (10, 2), 200: (13, 4), 500: (20, 6)}
"""Racks across and along the floor, by robots."""


@dataclass(frozen=True)
class Case:
    """One instance.

    Attributes:
        family: registry name.
        size: what it is grouped by, e.g. "N=50 T=60 m=15".
        seed: of the family.
        build: makes the problem (not timed).
    """

    family: str
    size: str
    seed: int
    build: Callable[[], Problem]


def hall(n: int, horizon: int, m: int, seed: int, **overrides: object) -> Problem:
    """The paper's hall with other numbers."""
    from twin.instance import open_instance

    values: dict[str, object] = {
        "robots.random.count": n,
        "plan.horizon": horizon,
        "radio.ap_capacity": m,
        **overrides,
    }
    path = ROOT / "worlds" / "paper_hall.toml"
    return open_instance(path, overrides=values, seed=seed).problem


def growing_hall(n: int, seed: int) -> Problem:
    """A floor that grows with the fleet: 8 positions a robot, an AP per 12.5 robots' worth."""
    columns = round((8 * n) ** 0.5)
    size = 3.0 * (columns - 1)
    across = max(2, round((n / 12.5) ** 0.5))
    aps = [
        {
            "id": f"ap{i * across + j}",
            "position_m": [size * (2 * i + 1) / (2 * across), size * (2 * j + 1) / (2 * across), 5],
        }
        for i in range(across)
        for j in range(across)
    ]
    return hall(
        n,
        max(60, 3 * columns),
        15,
        seed,
        **{
            "hall.size_m": [size, size],
            "hall.positions": [columns, columns],
            "obstacles.random.share": 0.2,
            "ap": aps,
        },
    )


def warehouse(n: int, seed: int) -> Problem:
    """`worlds/warehouse_day.toml` on a floor that grows with the fleet.

    About one rack for every four robots and an AP for every eight to twelve, of 20 places each: 6
    APs for 50 robots, 42 for 500.
    """
    from twin.instance import open_instance

    columns, rows = WAREHOUSES[n]
    width, depth = 7.2 * columns + 4.8, 15.0 * rows + 6.0
    racks = [
        {
            "name": f"rack {i} {j}",
            "center_m": [6 + 7.2 * i, 10.5 + 15 * j],
            "size_m": [2.6, 11.6],
            "height_m": 3.0,
        }
        for i in range(columns)
        for j in range(rows)
    ]
    across = round(width / 24)
    aps = [
        {
            "id": f"ap{i}.{j}",
            "position_m": [
                width * (2 * i + 1) / (2 * across),
                min(max(15.0 * j + 3.0, 2.2), depth - 2.2),
                6.0,
            ],
        }
        for i in range(across)
        for j in range(rows + 1)
    ]
    values: dict[str, object] = {
        "hall.size_m": [width, depth],
        "obstacle": racks,
        "ap": aps,
        "event": [],
        "radio.ap_capacity": 20,
        "robots.random.count": n,
        "plan.horizon": round((width + depth) / 1.5) + 40,
    }
    path = ROOT / "worlds" / "warehouse_day.toml"
    return open_instance(path, overrides=values, seed=seed).problem


def movingai(name: str, agents: int) -> Problem:
    """A MovingAI scenario (its first `agents` rows); the files are not part of this project."""
    from planner.mapf import mapf_problem
    from worlds.formats.movingai import errands, read_map, read_scenario

    grid = read_map(MOVINGAI / f"{name}.map")
    scenario = read_scenario(MOVINGAI / f"{name}-random-1.scen")
    starts, goals = errands(grid, scenario, agents)
    return mapf_problem(name, grid.passable, starts, goals)


def paper_hall(smoke: bool, seeds: int) -> Iterator[Case]:
    """N, T and m of the paper."""
    grid = (
        [(10, 60, 15)]
        if smoke
        else [(n, t, m) for m in (15, 50) for t in (60, 90) for n in (10, 20, 30, 40, 50)]
    )
    for n, t, m in grid:
        for seed in range(1, seeds + 1):
            yield Case(
                "paper_hall",
                f"N={n} T={t} m={m}",
                seed,
                lambda n=n, t=t, m=m, seed=seed: hall(n, t, m, seed),  # type: ignore[misc]
            )


def park(smoke: bool, seeds: int) -> Iterator[Case]:
    """The paper's hall with robots that stay at their goals."""
    for n in (10,) if smoke else (10, 20, 30, 40):
        for seed in range(1, seeds + 1):
            yield Case(
                "park",
                f"N={n} T=90 m=50",
                seed,
                lambda n=n, seed=seed: hall(n, 90, 50, seed, **{"plan.at_goal": "park"}),  # type: ignore[misc]
            )


def growth(smoke: bool, seeds: int) -> Iterator[Case]:
    """Floors that grow with the fleet."""
    for n in (25,) if smoke else (50, 100, 200, 500):
        for seed in range(1, min(seeds, 3) + 1):
            yield Case("growth", f"N={n}", seed, lambda n=n, seed=seed: growing_hall(n, seed))  # type: ignore[misc]


def warehouses(smoke: bool, seeds: int) -> Iterator[Case]:
    """Warehouse floors that grow with the fleet."""
    for n in (50,) if smoke else WAREHOUSES:
        for seed in range(1, min(seeds, 3) + 1):
            yield Case("warehouse", f"N={n}", seed, lambda n=n, seed=seed: warehouse(n, seed))  # type: ignore[misc]


def movingai_maps(smoke: bool, _seeds: int) -> Iterator[Case]:
    """The scenarios with which design page 4 compares its peers; none where they are absent."""
    if not MOVINGAI.is_dir():
        return
    table = {
        "random-32-32-20": (20, 50, 60, 80, 100, 150),
        "empty-16-16": (80,),
        "room-32-32-4": (40,),
        "warehouse-10-20-10-2-1": (100,),
    }
    for name, counts in {"empty-16-16": (10,)}.items() if smoke else table.items():
        for k in counts:
            yield Case(name, f"K={k}", 1, lambda name=name, k=k: movingai(name, k))  # type: ignore[misc]


FAMILIES: dict[str, Callable[[bool, int], Iterator[Case]]] = {
    "paper_hall": paper_hall,
    "park": park,
    "growth": growth,
    "warehouse": warehouses,
    "movingai": movingai_maps,
}
