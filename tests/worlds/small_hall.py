"""A hall of 6 x 4 positions, and literal looks at the floor it resolves to."""

from __future__ import annotations

from typing import Any

import pytest

from worlds.errors import WorldError
from worlds.floor import Floor
from worlds.generate import resolve
from worlds.world import World

AP = {"id": "ap0", "position_m": (0.1, 0.1, 9.0)}


def make(hall: dict[str, Any] | None = None, **parts: Any) -> World:
    """A world of 6 x 4 positions, 1 m apart, with one AP and one robot unless told otherwise."""
    hall = {"size_m": (6, 4), "pitch_m": 1.0, **(hall or {})}
    if "robot" not in parts and "robots" not in parts:
        parts["robots"] = {"random": {"count": 1}}
    return World.model_validate({"name": "test", "hall": hall, "ap": [AP], **parts})


def errand(name: str, start: Any, goal: Any) -> dict[str, Any]:
    """A listed robot between two cells."""
    cell = lambda c: {"cell": c} if isinstance(c, tuple) else c  # noqa: E731
    return {"id": name, "start": cell(start), "goal": cell(goal)}


def picture(floor: Floor) -> list[str]:
    """Rows from the top; # where a robot cannot stand."""
    return ["".join("#" if v < 0 else "." for v in row) for row in floor.vertex_grid()[::-1]]


def neighbours(floor: Floor) -> dict[int, set[int]]:
    """Adjacency of the floor, both ways."""
    near: dict[int, set[int]] = {v: set() for v in range(len(floor.vertex_xy_m))}
    for u, v in floor.edge_uv.tolist():
        near[u].add(v)
        near[v].add(u)
    return near


def reachable(floor: Floor, start: int) -> set[int]:
    """All vertices one can drive to, by a literal search."""
    near, seen, todo = neighbours(floor), {start}, [start]
    while todo:
        for v in near[todo.pop()] - seen:
            seen.add(v)
            todo.append(v)
    return seen


def faults_of(world: World) -> dict[tuple[str | int, ...], str]:
    """What `resolve` says is wrong."""
    with pytest.raises(WorldError) as caught:
        resolve(world)
    return {f.key: f.message for f in caught.value.faults}
