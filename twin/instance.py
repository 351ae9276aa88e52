"""The first half of the road: world → floor → radio map → robots with coverage → problem."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from planner.problem import Problem
    from worlds.floor import Floor
    from worlds.radio_map import RadioMap
    from worlds.world import World

OnStep = Callable[[str, float | None], None]
"""Told what is being done and which share of it is done (None: unknown)."""


def _silent(_text: str, _share: float | None) -> None:
    """Tell nobody."""


@dataclass(frozen=True)
class Instance:
    """A world with all that is computed from it before planning."""

    world: World
    floor: Floor
    radio_map: RadioMap
    problem: Problem


class Stopwatch:
    """Wall-clock seconds per phase; tells `on_step` what begins.

    Attributes:
        seconds: by phase, in the order in which they were begun.
        on_step: told what is being done; see `OnStep`.
    """

    def __init__(self, on_step: OnStep = _silent) -> None:
        self.seconds: dict[str, float] = {}
        self.on_step = on_step

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Time the body; phases of one name add up."""
        self.on_step(name, None)
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin

    def share(self, name: str) -> Callable[[int, int], None]:
        """A listener for (done, in all) that passes the share done on."""
        return lambda done, total: self.on_step(name, done / total if total else None)


def seed_overrides(world: World, seed: int) -> dict[str, object]:
    """The dotted paths that one `--seed` sets: another instance of the same family.

    Obstacles and errands are drawn anew where the world draws them; what it lists stays.
    """
    paths = ["radio.fading_seed", "plan.seed", "run.seed"]
    if world.obstacles is not None:
        paths.append("obstacles.random.seed")
    if world.robots is not None:
        paths.append("robots.random.seed")
    return dict.fromkeys(paths, seed)


def open_instance(
    path: Path,
    *,
    overrides: Mapping[str, object] | None = None,
    seed: int | None = None,
    watch: Stopwatch | None = None,
) -> Instance:
    """Read a world file and compute all that planning needs.

    Args:
        path: of the TOML file.
        overrides: values by dotted path that replace the file's.
        seed: replaces every seed of the world (`seed_overrides`); an override of one seed wins.
        watch: timed phases are noted here.

    Raises:
        WorldError, PlannerError: with every fault, located to its line where it has one.
    """
    watch = watch or Stopwatch()
    world, floor, chosen = _open(path, overrides, seed, watch)
    with _located(path, chosen):
        return survey(world, floor, watch=watch)


def open_radio(
    path: Path,
    *,
    overrides: Mapping[str, object] | None = None,
    seed: int | None = None,
    watch: Stopwatch | None = None,
) -> tuple[World, Floor, RadioMap]:
    """Read a world file and cast its rays; robots without coverage are no fault here.

    Args, Raises: as `open_instance`.
    """
    watch = watch or Stopwatch()
    world, floor, chosen = _open(path, overrides, seed, watch)
    with _located(path, chosen):
        return world, floor, _cast(world, floor, watch)


def _open(
    path: Path, overrides: Mapping[str, object] | None, seed: int | None, watch: Stopwatch
) -> tuple[World, Floor, dict[str, object]]:
    """World and floor, and all overrides, those that `seed` makes among them."""
    from worlds.toml_file import open_world, read_world

    with watch.phase("world"):
        chosen = dict(overrides or {})
        if seed is not None:
            chosen = seed_overrides(read_world(path, overrides=chosen), seed) | chosen
        return *open_world(path, overrides=chosen), chosen


@contextmanager
def _located(path: Path, overrides: Mapping[str, object]) -> Iterator[None]:
    """Name file and line in faults that show only after the file was read."""
    from planner.errors import PlannerError
    from worlds.errors import WorldError
    from worlds.toml_file import read_source

    try:
        yield
    except WorldError as error:
        raise read_source(path, overrides=overrides).error(error.faults) from None
    except PlannerError as error:
        raise PlannerError(*(f"{path}: {line}" for line in error.lines)) from None


def _cast(world: World, floor: Floor, watch: Stopwatch) -> RadioMap:
    from worlds.radio_map import build_radio_map

    with watch.phase("radio map"):
        return build_radio_map(world, floor, on_progress=watch.share("radio map"))


def survey(
    world: World,
    floor: Floor,
    *,
    radio_map: RadioMap | None = None,
    watch: Stopwatch | None = None,
) -> Instance:
    """Cast the rays of a world, put its robots where there is coverage, and pose the problem.

    A `radio_map` that was made for the same hall and radio before spares the rays.

    Raises:
        WorldError: an AP inside an obstacle, a hall without coverage, a robot without it.
        PlannerError: the problem is none the planner can be asked.
    """
    from planner.problem import problem_from_world
    from worlds.errands import with_covered_robots

    watch = watch or Stopwatch()
    radio_map = radio_map or _cast(world, floor, watch)
    with watch.phase("radio map"):
        _require_coverage(radio_map)
        # Random errands lie in G, so they are drawn anew now that coverage is known (§1.8).
        floor = with_covered_robots(world, floor, radio_map)
        problem = problem_from_world(world, floor, radio_map)
    return Instance(world, floor, radio_map, problem)


def _require_coverage(radio_map: RadioMap) -> None:
    """Refuse a hall in which no AP covers any position, once and not robot by robot."""
    from worlds.errors import Fault, WorldError

    if not radio_map.ap_ids:
        raise WorldError([Fault(("ap",), "no access point is enabled; enable or add one")])
    if not radio_map.covered.any():
        best = float(radio_map.snr_db.max())
        raise WorldError(
            [
                Fault(
                    ("radio", "threshold_db"),
                    f"{radio_map.threshold_db:g} dB is reached nowhere: the best SNR at any of "
                    f"the {len(radio_map.snr_db)} free positions is {best:.1f} dB; lower it, raise "
                    "tx_power_dbm, or move the access points",
                )
            ]
        )
