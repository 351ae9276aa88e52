"""What a study file says: which questions are asked of which world, and what is to be measured.

    study, source = read_study(Path("studies/fleet.toml"))

The keys are described in docs/studies.md. A fault is told with file and line, all at once, as with
worlds.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from twin.study_kpi import DEFAULT_COLUMNS, column_faults
from worlds.errors import Fault, Key
from worlds.part import Part, given, listed, nearest
from worlds.scalars import Name, Seed
from worlds.toml_file import Source, read_document

BASE = "base"
"""Scenario that stands for the world as its file has it."""
SCENARIO = "scenario"
"""The factor that the named scenarios are the levels of."""
PLANNER = "planner."
"""Paths that begin so lead into `[planner]`, all others into the world."""

Settings = dict[str, Any]
Factors = dict[str, Any]
"""A dotted path with a list of values, or any name with a table of named levels, each of which sets
several values: `{"CA*" = {"planner.method" = "cooperative", "planner.restarts" = 0}, …}`."""


class StudyOptions(Part):
    """`[study]`: what is run, how often."""

    name: str = Field(default="", description="title of the report; the file's name when left out")
    story: str = Field(default="", description="what is asked, for the reader of the report")
    world: str = Field(description="world file, relative to the study file")
    run: Literal["plan", "execute"] = Field(
        default="execute", description="plan only, or execute the plan in the twin, too"
    )
    replications: int = Field(
        default=1, ge=1, le=100_000, description="instances, the same ones for every scenario"
    )
    seed: Seed = Field(
        default=0, description="replication k is the instance of `twin run --seed` (seed + k)"
    )
    baseline: str | Settings | None = Field(
        default=None,
        description='a scenario\'s name, "base" for the world as it stands, or the levels that '
        'every cell is compared with: {"planner.method" = "auto"}',
    )
    timeout_s: float = Field(
        default=600.0, gt=0, le=1e7, description="after which a run is stopped and counts as failed"
    )


class PlannerOptions(Part):
    """`[planner]`: what the planner may spend (`planner.solve.SolveParams`)."""

    method: Literal["auto", "exact", "pgcp", "cooperative", "decoupled"] = Field(
        default="auto", description="how to plan"
    )
    restarts: int = Field(
        default=20, ge=0, description="further orders of cooperative A* while a robot finds no way"
    )
    iterations: int = Field(default=3000, ge=0, description="neighbourhoods tried")
    time_limit_s: float | None = Field(
        default=None, gt=0, description="give up after; none when left out"
    )
    gap: float = Field(default=0.0, ge=0, description="relative gap at which to stop")
    nodes: int | None = Field(default=None, ge=0, description="of the tree search, at most")


class ScenarioOptions(Part):
    """`[[scenario]]`: values that are set together, under a name."""

    name: Name = Field(description="in tables and figures")
    about: str = Field(default="", description="a sentence for the reader")
    set: Settings = Field(default_factory=dict, description="values by dotted path")
    factors: Factors = Field(
        default_factory=dict, description="levels in this scenario, instead of the study's"
    )


class Relative(Part):
    """`[kpi.relative.NAME]`: a key figure over that of another cell of the same replication."""

    kpi: str = Field(description="column that is divided")
    to: str | None = Field(default=None, description="column of the other run; `kpi` if left out")
    of: Settings = Field(description="levels that the other cell has instead")


class KpiOptions(Part):
    """`[kpi]`: what is measured, and over which runs means are taken."""

    columns: tuple[str, ...] = Field(default=(), description="of runs.csv; see docs/studies.md")
    common: dict[str, list[Any]] = Field(
        default_factory=dict,
        description="levels that must all have succeeded for a replication to count in a mean",
    )
    relative: dict[str, Relative] = Field(default_factory=dict)


class LogOptions(Part):
    """`[log]`: which runs leave their log."""

    mcap: Literal["all", "failed", "first", "none"] = Field(
        default="failed", description="of executed runs; first: of the first replication"
    )
    validate_logs: bool = Field(
        default=False, description="check every log; a finding makes the run invalid"
    )


class FigureOptions(Part):
    """`[[figure]]`: a figure of the report, before those that are drawn for every factor."""

    title: str
    kpi: str
    x: str = Field(description="factor along the axis")
    lines: tuple[str, ...] = Field(default=(), description="factors of which each level is a line")
    where: Settings = Field(default_factory=dict, description="levels of the cells shown")
    says: str = Field(default="", description="what to expect, and who says so")


class Reference(Part):
    """`[[reference]]`: a figure printed elsewhere, to stand beside what is measured here."""

    text: str = Field(description="what it is, and where it is printed")
    kpi: str
    where: Settings = Field(default_factory=dict, description="levels of the cells it speaks of")
    against: Settings | None = Field(
        default=None, description="levels of other cells: then the relative change is meant"
    )
    value: float | None = Field(default=None, description="the printed figure")
    says: str = Field(default="", description="what is printed where it is no figure")


class Quick(Part):
    """`[quick]`: what `--quick` replaces."""

    replications: int = Field(default=1, ge=1, le=100_000)
    scenarios: tuple[str, ...] = Field(default=(), description="only these; all when left out")
    factors: dict[str, list[Any]] = Field(
        default_factory=dict, description="levels instead of the study's; of named ones, the names"
    )
    set: Settings = Field(default_factory=dict)


class Study(Part):
    """A study file."""

    format: Literal["mapp-study/1"] = "mapp-study/1"
    study: StudyOptions
    set: Settings = Field(default_factory=dict, description="values in every run")
    planner: PlannerOptions = PlannerOptions()
    factors: Factors = Field(default_factory=dict)
    scenario: tuple[ScenarioOptions, ...] = ()
    kpi: KpiOptions = KpiOptions()
    log: LogOptions = LogOptions()
    figure: tuple[FigureOptions, ...] = ()
    reference: tuple[Reference, ...] = ()
    quick: Quick = Quick()

    @classmethod
    def faults_given(cls, data: Mapping[str, object]) -> list[Fault]:
        """Names that nothing has: scenarios, factors, columns."""
        faults = super().faults_given(data)
        names = [str(given(s, "name")) for s in listed(data, "scenario")]
        for i, name in enumerate(names):
            if name in names[:i]:
                rule = f"'{name}' is the name of scenario[{names.index(name)}] already"
                faults.append(Fault(("scenario", i, "name"), f"{rule}; give each its own"))
        baseline = given(given(data, "study"), "baseline")
        if isinstance(baseline, str) and baseline not in [*names, BASE]:
            faults.append(_unknown(("study", "baseline"), baseline, [*names, BASE], "scenario"))
        for i, wanted in enumerate(listed(given(data, "quick"), "scenarios")):
            if str(wanted) not in names:
                faults.append(_unknown(("quick", "scenarios", i), str(wanted), names, "scenario"))
        faults += _factor_faults(data)
        known = [*_factor_names(data), SCENARIO]
        for place, factor in _choices(data):
            if factor not in known:
                faults.append(_unknown(place, factor, known, "factor"))
        relatives = given(given(data, "kpi"), "relative")
        own = list(relatives) if isinstance(relatives, Mapping) else []
        faults += column_faults(_columns(data), own)
        return faults

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns asked for, or the usual ones of this kind of run."""
        return self.kpi.columns or DEFAULT_COLUMNS[self.study.run]

    @property
    def shown(self) -> tuple[str, ...]:
        """All key figures of the summary: columns and those relative to other cells."""
        return (*self.columns, *(name for name in self.kpi.relative if name not in self.columns))


def read_study(
    path: Path, *, quick: bool = False, replications: int | None = None
) -> tuple[Study, Source]:
    """A study file, and what places faults found in it later.

    Args:
        path: of the TOML file.
        quick: with what its `[quick]` says in place of the rest.
        replications: instead of the file's.

    Raises:
        WorldError: with all problems of the file, each with its line.
    """
    study, source = read_document(path, Study)
    if quick:
        study = hastened(study)
    if replications is not None:
        options = study.study.model_copy(update={"replications": replications})
        study = study.model_copy(update={"study": options})
    return study, source


def hastened(study: Study) -> Study:
    """The study that `--quick` makes of it: fewer replications, levels or scenarios."""
    quick = study.quick

    def fewer(factors: Factors) -> Factors:
        found = dict(factors)
        for name in found.keys() & quick.factors.keys():
            chosen, own = quick.factors[name], found[name]
            named = isinstance(own, Mapping)
            found[name] = {k: own[k] for k in own if k in chosen} if named else chosen
        return found

    scenarios = tuple(
        s.model_copy(update={"factors": fewer(s.factors)})
        for s in study.scenario
        if not quick.scenarios or s.name in (*quick.scenarios, study.study.baseline)
    )
    replications = min(quick.replications, study.study.replications)
    return study.model_copy(
        update={
            "study": study.study.model_copy(update={"replications": replications}),
            "set": study.set | quick.set,
            "factors": fewer(study.factors),
            "scenario": scenarios,
        }
    )


def text_of(value: object) -> str:
    """A level as it stands in tables: text without quotes, all else as in TOML."""
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return " ".join(text.split()) if "\n" in text else text


def _unknown(key: Key, word: str, known: list[str], kind: str) -> Fault:
    hint = nearest(word, known) or f" known are {', '.join(known) or 'none'}"
    return Fault(key, f"'{word}' is no {kind} of this study;{hint}")


@dataclass(frozen=True)
class Level:
    """One level of a factor: what it is called, and what it sets.

    Attributes:
        value: a value of the factor's path, or the name of the level.
        settings: by dotted path.
        place: of its value behind the key of the factor.
    """

    value: object
    settings: Settings
    place: str | int


def levels_of(factor: str, given_levels: Any) -> list[Level]:
    """The levels of a factor."""
    if isinstance(given_levels, Mapping):
        return [Level(name, dict(settings), name) for name, settings in given_levels.items()]
    return [Level(value, {factor: value}, i) for i, value in enumerate(given_levels)]


def _factor_faults(data: Mapping[str, object]) -> list[Fault]:
    """Factors without levels, and levels that set nothing."""
    tables: list[tuple[Key, object]] = [(("factors",), given(data, "factors"))]
    for i, part in enumerate(listed(data, "scenario")):
        tables.append((("scenario", i, "factors"), given(part, "factors")))
    faults = []
    for place, table in tables:
        for name, levels in table.items() if isinstance(table, Mapping) else ():
            key = (*place, str(name))
            if isinstance(levels, Mapping):
                wrong = [str(k) for k, v in levels.items() if not isinstance(v, Mapping) or not v]
                rule = "is a named level and must be a table of values: {"
                faults += [Fault((*key, k), rule + '"plan.horizon" = 90}') for k in wrong]
            elif not isinstance(levels, list | tuple):
                rule = "must be a list of values, or a table of named levels"
                faults.append(Fault(key, f"{rule}; write [{text_of(levels)}] for a single one"))
            if isinstance(levels, Mapping | list | tuple) and not levels:
                faults.append(Fault(key, "has no levels; give at least one"))
    return faults


def _factor_names(data: Mapping[str, object]) -> list[str]:
    tables = [given(data, "factors"), *(given(s, "factors") for s in listed(data, "scenario"))]
    return list(dict.fromkeys(name for t in tables if isinstance(t, Mapping) for name in t))


def _choices(data: Mapping[str, object]) -> Iterable[tuple[Key, str]]:
    """Every place that speaks of a factor, and the factor it names."""
    places: list[tuple[Key, object]] = [
        (("study", "baseline"), given(given(data, "study"), "baseline")),
        (("kpi", "common"), given(given(data, "kpi"), "common")),
        (("quick", "factors"), given(given(data, "quick"), "factors")),
    ]
    relatives = given(given(data, "kpi"), "relative")
    if isinstance(relatives, Mapping):
        places += [(("kpi", "relative", k, "of"), given(r, "of")) for k, r in relatives.items()]
    for section in ("figure", "reference"):
        for i, part in enumerate(listed(data, section)):
            places += [((section, i, k), given(part, k)) for k in ("where", "against", "lines")]
            if isinstance(x := given(part, "x"), str):
                yield (section, i, "x"), x
    for place, chosen in places:
        if isinstance(chosen, Mapping):
            yield from (((*place, str(name)), str(name)) for name in chosen)
        elif isinstance(chosen, list | tuple):
            yield from (((*place, i), str(name)) for i, name in enumerate(chosen))


def _columns(data: Mapping[str, object]) -> Iterable[tuple[Key, str, bool]]:
    """Every place that names a column, the name, and whether it must be one of runs.csv."""
    kpi = given(data, "kpi")
    for i, name in enumerate(listed(kpi, "columns")):
        yield ("kpi", "columns", i), str(name), True
    relatives = given(kpi, "relative")
    for key, part in relatives.items() if isinstance(relatives, Mapping) else ():
        for end in ("kpi", "to"):
            if isinstance(name := given(part, end), str):
                yield ("kpi", "relative", key, end), name, True
    for section in ("figure", "reference"):
        for i, part in enumerate(listed(data, section)):
            if isinstance(name := given(part, "kpi"), str):
                yield (section, i, "kpi"), name, False
