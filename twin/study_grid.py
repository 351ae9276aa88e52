"""From a study file to its runs: every scenario, every combination of levels, every replication.

A *cell* is a scenario with one level of each factor; a *run* is a cell in one replication. All
cells of a replication draw from the same seeds (common random numbers), so they differ by what the
study varies and by nothing else.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from twin.instance import seed_overrides
from twin.study_kpi import PER_AP
from twin.study_spec import (
    BASE,
    PLANNER,
    SCENARIO,
    Factors,
    PlannerOptions,
    ScenarioOptions,
    Settings,
    Study,
    levels_of,
    text_of,
)
from worlds.errors import Fault, Key, WorldError
from worlds.overrides import BadPathError, value_at
from worlds.part import nearest
from worlds.toml_faults import faults_of
from worlds.toml_file import Source, dump_world, read_world
from worlds.world import World

MAX_RUNS = 1_000_000


@dataclass(frozen=True)
class Cell:
    """A scenario with one level of each factor.

    Attributes:
        scenario: its name.
        levels: factor → level as text, for every factor of the study.
        settings: what is set in the world, by dotted path.
        planner: what the planner may spend.
        world: complete text of the world; "" if it is broken.
        seeds: paths of the seeds that replications set.
        error: what is wrong with the world, "" if nothing.
        baseline: index of the cell this one is compared with, None for none or itself.
    """

    scenario: str
    levels: dict[str, str]
    settings: Settings
    planner: PlannerOptions
    world: str = ""
    seeds: tuple[str, ...] = ()
    error: str = ""
    baseline: int | None = None

    @property
    def key(self) -> tuple[str, ...]:
        """Scenario and levels: what tells a cell from the others."""
        return (self.scenario, *self.levels.values())

    def at(self, factor: str) -> str:
        """Its level of a factor, the scenario among them."""
        return self.scenario if factor == SCENARIO else self.levels[factor]

    def matches(self, where: Mapping[str, object]) -> bool:
        """Whether it has these levels."""
        return all(self.at(factor) == text_of(level) for factor, level in where.items())


@dataclass(frozen=True)
class Run:
    """A cell in one replication.

    Attributes:
        id: hash of all that decides its result.
        cell: index of the cell.
        replication: from 0.
        seed: of everything that is drawn.
    """

    id: str
    cell: int
    replication: int
    seed: int


@dataclass(frozen=True)
class Grid:
    """All that a study runs.

    Attributes:
        study: as its file says.
        factors: names of the factors, in the order of the file.
        cells: every scenario with every combination of levels.
        runs: replication by replication, so that runs in one hall follow one another.
    """

    study: Study
    factors: tuple[str, ...]
    cells: tuple[Cell, ...]
    runs: tuple[Run, ...] = field(default=())

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Names of the scenarios that are run."""
        return tuple(dict.fromkeys(cell.scenario for cell in self.cells))

    def levels(self, factor: str) -> tuple[str, ...]:
        """Levels of a factor that occur, in the order of the file."""
        return tuple(dict.fromkeys(cell.at(factor) for cell in self.cells))

    def other(self, cell: Cell, levels: Mapping[str, object]) -> int | None:
        """Index of the cell with these levels in place of a cell's own; None if there is none."""
        wanted = {SCENARIO: cell.scenario, **cell.levels}
        wanted |= {factor: text_of(level) for factor, level in levels.items()}
        key = (wanted[SCENARIO], *(wanted[f] for f in self.factors))
        return next((i for i, c in enumerate(self.cells) if c.key == key), None)


def expand(study: Study, source: Source, version: str) -> Grid:
    """All cells and runs of a study.

    Args:
        study: from `read_study`.
        source: places faults in the study file.
        version: of this program; part of what decides a result.

    Raises:
        WorldError: the world cannot be used as it is, or a value can be set in no cell, each with
            its line. A value that is wrong in some combinations only makes the runs of these fail.
    """
    path = Path(source.name).parent / study.study.world
    try:
        base = read_world(path)
    except WorldError as error:
        faults = [Fault(("study", "world"), line) for line in error.lines]
        raise source.error(faults) from None
    _check_aps(study, source, base)
    drafts = _drafts(study)
    factors = tuple(dict.fromkeys(f for d in drafts for f in d.levels))
    n_runs = len(drafts) * study.study.replications
    if n_runs > MAX_RUNS:
        rule = f"makes {n_runs} runs, more than {MAX_RUNS}; take fewer levels or replications"
        raise source.error([Fault(("factors",), rule)])
    judged = [_judge(draft, path, factors, base, study.planner) for draft in drafts]
    _refuse_hopeless(drafts, [faults for _, faults in judged], source)
    cells = [cell for cell, _ in judged]
    grid = Grid(study, factors, tuple(cells))
    cells = [_with_baseline(grid, cell) for cell in cells]
    runs = []
    for k in range(study.study.replications):
        seed = study.study.seed + k
        runs += [Run(_id(cell, study, seed, version), i, k, seed) for i, cell in enumerate(cells)]
    return Grid(study, factors, tuple(cells), tuple(runs))


@dataclass(frozen=True)
class _Draft:
    """A cell before its world was read; `places` says where in the study file each value stands."""

    scenario: str
    levels: dict[str, object]
    settings: Settings
    places: dict[str, Key]


def _drafts(study: Study) -> list[_Draft]:
    """Every combination, in the order of the file; the unchanged world first if it is needed."""
    scenarios = list(study.scenario) or [ScenarioOptions(name=BASE)]
    alone = study.study.baseline == BASE and study.scenario and BASE not in _names(study)
    bare = alone or (study.study.baseline == BASE and not study.scenario and study.factors)
    if not study.scenario and bare:
        # The world as it stands is a scenario of its own beside the combinations of levels.
        scenarios = [ScenarioOptions(name="varied")]
    drafts = []
    if bare:
        places: dict[str, Key] = {path: ("set", path) for path in study.set}
        drafts.append(_Draft(BASE, {}, dict(study.set), places))
    for s, scenario in enumerate(scenarios):
        given: Factors = study.factors | scenario.factors
        factors = {f: levels_of(f, v) for f, v in given.items() if f not in scenario.set}
        fixed: dict[str, Key] = {path: ("set", path) for path in study.set}
        fixed |= {path: ("scenario", s, "set", path) for path in scenario.set}
        for chosen in itertools.product(*factors.values()):
            levels = {f: scenario.set[f] for f in study.factors if f in scenario.set}
            settings, places = study.set | scenario.set, dict(fixed)
            for f, level in zip(factors, chosen, strict=True):
                levels[f] = level.value
                settings |= level.settings
                above = ("scenario", s, "factors") if f in scenario.factors else ("factors",)
                for path in level.settings:
                    named = (path,) if path != f else ()
                    places[path] = (*above, f, level.place, *named)
            drafts.append(_Draft(scenario.name, levels, settings, places))
    return drafts


def _names(study: Study) -> list[str]:
    return [scenario.name for scenario in study.scenario]


def _judge(
    draft: _Draft, path: Path, factors: Sequence[str], base: World, own: PlannerOptions
) -> tuple[Cell, list[tuple[str, Fault]]]:
    """The cell, and what is wrong with it: (path of the value at fault or "", fault)."""
    wrong: list[tuple[str, Fault]] = []
    settings = {p: v for p, v in draft.settings.items() if not p.startswith(PLANNER)}
    planner = _planner(own, draft.settings, wrong)
    world: World | None = None
    if not wrong:
        try:
            world = read_world(path, overrides=settings)
        except WorldError as error:
            wrong = [(_blamed(fault, settings), fault) for fault in error.faults]
    error_text = "; ".join(str(fault) for _, fault in wrong)
    levels = {f: _level(f, draft, planner, world or base) for f in factors}
    seeds = () if world is None else tuple(p for p in seed_overrides(world, 0) if p not in settings)
    text = "" if world is None else dump_world(world)
    cell = Cell(draft.scenario, levels, settings, planner, text, seeds, error_text)
    return cell, wrong


def _planner(
    own: PlannerOptions, settings: Settings, wrong: list[tuple[str, Fault]]
) -> PlannerOptions:
    """The planner's options of a cell, the study's `own` changed; faults are added to `wrong`."""
    chosen = {p[len(PLANNER) :]: v for p, v in settings.items() if p.startswith(PLANNER)}
    try:
        return PlannerOptions.model_validate(own.model_dump() | chosen)
    except ValidationError as error:
        wrong += [
            (f"{PLANNER}{fault.key[0]}", fault)
            for fault in faults_of(error, chosen, PlannerOptions)
        ]
        return own


def _level(factor: str, draft: _Draft, planner: PlannerOptions, world: World) -> str:
    """A cell's level of a factor, as text; where it varies nothing, what the world says."""
    for known in (draft.levels, draft.settings):
        if factor in known:
            return text_of(known[factor])
    try:
        if factor.startswith(PLANNER):
            return text_of(value_at(planner, factor[len(PLANNER) :]))
        value: Any = value_at(world, factor)
        return text_of(value.model_dump() if hasattr(value, "model_dump") else value)
    except (BadPathError, TypeError):
        return ""


def _blamed(fault: Fault, settings: Settings) -> str:
    """Path of the setting that a fault of the world speaks of, "" if of none."""
    words = {str(step) for step in fault.key}
    for path in settings:
        if fault.key == (path,):
            return path
    best = ""
    for path in settings:
        steps = [step for step in path.replace('"', "").split(".")]
        named = [s for s in steps if s in words]
        # An element of a list is named by its id in the path and by its index in the fault.
        if steps[0] in words and named and (steps[-1] in words or len(named) == len(steps)):
            best = path if len(path) > len(best) else best
    return best


def _refuse_hopeless(
    drafts: Sequence[_Draft], wrong: Sequence[list[tuple[str, Fault]]], source: Source
) -> None:
    """Refuse values that are wrong in every cell that has them, with their lines."""
    blamed: dict[Key, list[bool]] = {}
    words: dict[Key, Fault] = {}
    for draft, faults in zip(drafts, wrong, strict=True):
        for path, place in draft.places.items():
            mine = [fault for p, fault in faults if p == path]
            blamed.setdefault(place, []).append(bool(mine))
            if mine:
                words.setdefault(place, Fault(place, mine[0].message))
    hopeless: dict[tuple[Key, str], Fault] = {}  # a misspelt path is told once, not per level
    for place, found in blamed.items():
        if all(found):
            hopeless.setdefault((place[:-1], words[place].message), words[place])
    if hopeless:
        raise source.error(list(hopeless.values()))
    if all(wrong):
        # No single value is at fault, and yet nothing can be run.
        fault = wrong[0][0][1]
        raise source.error([Fault(("study", "world"), f"is broken in every scenario: {fault}")])


def _with_baseline(grid: Grid, cell: Cell) -> Cell:
    """A cell that knows what it is compared with."""
    baseline = grid.study.study.baseline
    if baseline is None:
        return cell
    if isinstance(baseline, str):
        other = grid.other(cell, {SCENARIO: baseline})
        if other is None:  # the world as it stands has its own levels
            own = [i for i, c in enumerate(grid.cells) if c.scenario == baseline]
            other = own[0] if len(own) == 1 else None
    else:
        other = grid.other(cell, baseline)
    if other is None or grid.cells[other].key == cell.key:
        return cell
    return replace(cell, baseline=other)


def _id(cell: Cell, study: Study, seed: int, version: str) -> str:
    """Twelve hexadecimal digits that differ whenever a result could."""
    decisive = {
        "version": version,
        "world": cell.world or cell.error,
        "seeds": {path: seed for path in cell.seeds},
        "seed": seed,
        "planner": cell.planner.model_dump(),
        "run": study.study.run,
        "timeout_s": study.study.timeout_s,
        "validate": study.log.validate_logs,
        "name": cell.key,
    }
    text = json.dumps(decisive, sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _check_aps(study: Study, source: Source, world: World) -> None:
    """Columns of one AP name one that the world has."""
    known = [ap.id for ap in world.ap]
    faults = []
    for i, name in enumerate(study.kpi.columns):
        kind, dot, ap = name.partition(".")
        if dot and kind in PER_AP and ap not in known:
            hint = nearest(ap, known) or f" known are {', '.join(known)}"
            faults.append(Fault(("kpi", "columns", i), f"no ap has the id '{ap}';{hint}"))
    if faults:
        raise source.error(faults)
