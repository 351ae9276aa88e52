"""One run of a study, from its world's text to its key figures; whatever happens is an outcome.

A task carries everything with it, and its outcome carries the log if that is to be kept: nothing
here reads or writes a disk that others see.
"""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections import OrderedDict
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.study_kpi import Answer, Value, values_of

if TYPE_CHECKING:
    from planner.plan import Plan
    from twin.instance import Instance
    from twin.pipeline import Execution
    from worlds.radio_map import RadioMap
    from worlds.world import World

OK = "ok"
STATUSES: dict[str, str] = {
    OK: "planned for every robot and, if executed, driven to the end",
    "infeasible": "proven: no plan exists within the horizon",
    "unserved": "the planner gave up with robots left, and without a proof",
    "failed": "the run in the twin did not end well",
    "invalid": "the validator has findings on the log",
    "broken": "the world or the problem cannot be used",
    "timeout": "stopped after the study's timeout_s",
    "crashed": "the process that ran it died",
    "defect": "a defect of this program",
}
"""How a run can end; all but `ok` count as no success."""

MAPS_KEPT = 4
"""Radio maps a worker remembers: the halls of a replication follow one another."""


@dataclass(frozen=True)
class Task:
    """A run with all that it needs.

    Attributes:
        id: of the run.
        world: its text, complete.
        seeds: values of its seeds by dotted path.
        planner: arguments of `SolveParams`.
        execute: run the plan in the twin, too.
        columns: key figures to tell.
        log: "all", "failed" or "none": whether the outcome carries the log.
        validate: check the log.
        timeout_s: after which the run is stopped.
        function: `module:name` of what is called with the task.
    """

    id: str
    world: str
    seeds: dict[str, object] = field(default_factory=dict)
    planner: dict[str, Any] = field(default_factory=dict)
    execute: bool = False
    columns: tuple[str, ...] = ()
    log: str = "none"
    validate: bool = False
    timeout_s: float = 600.0
    function: str = "twin.study_run:run_task"


@dataclass(frozen=True)
class Outcome:
    """What became of a run.

    Attributes:
        id: of the run.
        status: one of STATUSES.
        error: why, if it is not ok; one line.
        seconds: wall-clock time spent.
        values: key figures by column, None where there is none.
        log: content of run.mcap, if it is to be kept.
    """

    id: str
    status: str
    error: str = ""
    seconds: float = 0.0
    values: dict[str, Value] = field(default_factory=dict)
    log: bytes | None = None


def prepare() -> None:
    """Import what every run needs, so that no run pays for it."""
    for name in ("planner.problem", "planner.solve", "twin.pipeline", "worlds.errands"):
        import_module(name)
    for name in ("worlds.generate", "worlds.radio_map", "worlds.toml_file"):
        import_module(name)


def run_task(task: Task) -> Outcome:
    """Do one run; never raises for what lies in the run."""
    from planner.errors import PlannerError
    from worlds.errors import WorldError

    begin = time.perf_counter()
    try:
        status, error, values, log = _run(task)
    except (WorldError, PlannerError) as fault:
        status, error, values, log = "broken", "; ".join(fault.lines), {}, None
    except MemoryError:
        status, error, values, log = "broken", "out of memory", {}, None
    except Exception as fault:
        said = f"{type(fault).__name__} at {_innermost(fault)}: {fault}"
        status, error, values, log = "defect", said, {}, None
    seconds = time.perf_counter() - begin
    return Outcome(task.id, status, " ".join(error.split()), seconds, values, log)


def _run(task: Task) -> tuple[str, str, dict[str, Value], bytes | None]:
    from planner.solve import SolveParams
    from twin.pipeline import make_plan

    instance = _instance(task)
    options = {k: v for k, v in task.planner.items() if k != "time_limit_s"}
    params = SolveParams(
        seed=instance.world.plan.seed, time_limit=task.planner.get("time_limit_s"), **options
    )
    plan = make_plan(instance.problem, params)
    execution: Execution | None = None
    status, error, log = _verdict_on(plan), plan.message, None
    if status == OK:
        error = ""
        if task.execute:
            execution, status, error, log = _executed(task, instance, plan)
    answer = Answer(instance, plan, execution, status == OK)
    return status, error, values_of(task.columns, answer), log


def _verdict_on(plan: Plan) -> str:
    if plan.status == "infeasible":
        return "infeasible"
    return "unserved" if plan.unserved else OK


def _executed(
    task: Task, instance: Instance, plan: Plan
) -> tuple[Execution, str, str, bytes | None]:
    """The run in the twin: its figures, status, error, and the log if it is to be kept."""
    from twin.pipeline import execute

    with tempfile.TemporaryDirectory(prefix="mapp-run-") as folder:
        path = Path(folder) / "run.mcap"
        execution = execute(instance, plan, path)
        status, error = OK, ""
        if execution.end.verdict != "completed":
            status, error = "failed", execution.end.message
        elif task.validate:
            from logs.validate import validate

            report = validate(path)
            if not report.valid:
                first = report.findings[0]
                status, error = "invalid", f"{len(report.findings)} findings, first: {first}"
        keep = task.log == "all" or (task.log == "failed" and status != OK)
        return execution, status, error, path.read_bytes() if keep else None


_maps: OrderedDict[str, RadioMap] = OrderedDict()


def _instance(task: Task) -> Instance:
    """World to problem; the radio map of a hall that was met before is not cast again."""
    from twin.instance import survey
    from worlds.generate import resolve
    from worlds.toml_file import parse_world

    world = parse_world(task.world, "world", overrides=task.seeds)
    floor = resolve(world)
    key = radio_key(world)
    instance = survey(world, floor, radio_map=_maps.get(key))
    _maps[key] = instance.radio_map
    _maps.move_to_end(key)
    while len(_maps) > MAPS_KEPT:
        _maps.popitem(last=False)
    return instance


def radio_key(world: World) -> str:
    """Hash of what a world's radio map depends on: all but its robots, capacities and options."""
    from worlds.toml_file import dump_world
    from worlds.world import PlanOptions, Radio, RunOptions

    aps = tuple(ap.model_copy(update={"capacity": None}) for ap in world.ap)
    plain = Radio.model_fields["ap_capacity"].default
    same = {
        "name": "any",
        "story": "",
        "ap": aps,
        "radio": world.radio.model_copy(update={"ap_capacity": plain}),
        "robot": (),
        "robots": None,
        "plan": PlanOptions(),
        "run": RunOptions(),
    }
    return hashlib.sha256(dump_world(world.model_copy(update=same)).encode()).hexdigest()


def _innermost(fault: Exception) -> str:
    """`file.py:line` of where an exception comes from."""
    import traceback

    frames = traceback.extract_tb(fault.__traceback__)
    return f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "unknown place"
