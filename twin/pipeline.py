"""The road from a world to a validated log, as library functions.

    world → floor → radio map → problem → plan → run → log → validation → picture

`travel` goes all the way and answers with a `Road`; `survey` and `make_plan` stop on the way. The
`twin` command prints what they return. Nothing here writes to the terminal.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from logs.records import ApKpi, Incident, Kpi, Record, Replan, RobotKpi, RunEnd
from twin.instance import Instance, Stopwatch
from twin.outputs import RunFiles, check_run_folder, staged

if TYPE_CHECKING:
    from logs.findings import Report
    from planner.plan import Plan
    from planner.problem import Problem
    from planner.solve import SolveParams

ROBOTS_NAMED = 12
"""Robots a sentence names before it counts the others."""


@dataclass(frozen=True)
class Execution:
    """What the records of a run say about it as a whole.

    Attributes:
        kpi: key figures at its end.
        robots, aps: those of each robot and AP.
        end: its verdict.
        incidents: how many of each kind.
        replans: new plans that were asked for.
    """

    kpi: Kpi
    robots: tuple[RobotKpi, ...]
    aps: tuple[ApKpi, ...]
    end: RunEnd
    incidents: dict[str, int]
    replans: tuple[Replan, ...] = ()


@dataclass(frozen=True)
class Road:
    """The whole road, or as far as it went.

    Attributes:
        instance: what was planned for.
        plan: the planner's answer.
        execution: None if the plan is not one for every robot: then nothing is run or written.
        report: the validator's findings on the log.
        files: what was written.
        seconds: wall-clock time of each phase.
        hints: what the user might change, and why.
    """

    instance: Instance
    plan: Plan
    execution: Execution | None = None
    report: Report | None = None
    files: RunFiles | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    hints: tuple[str, ...] = ()

    @property
    def valid(self) -> bool:
        """The log was validated without a finding."""
        return self.report is not None and self.report.valid

    @property
    def succeeded(self) -> bool:
        """Planned for every robot, executed to the end, and the log is valid."""
        return (
            self.execution is not None and self.execution.end.verdict == "completed" and self.valid
        )

    @property
    def summary(self) -> str:
        """The outcome in one line of words."""
        if self.execution is None:
            return f"{describe_plan(self.plan)}; nothing was run"
        incidents = self.execution.incidents
        collisions = sum(incidents.get(kind, 0) for kind in ("collision", "contact", "obstacle"))
        parts = [
            describe_plan(self.plan),
            count(self.execution.kpi.handovers, "handover"),
            count(collisions, "collision"),
            count(incidents.get("overload", 0), "overload"),
        ]
        if self.execution.kpi.outage_s > 0:
            parts.append(f"{self.execution.kpi.outage_s:.1f} s without connection")
        if self.execution.end.verdict != "completed":
            parts.append(f"run failed: {self.execution.end.message}")
        if self.report is not None:
            findings = count(len(self.report.findings), "finding")
            parts.append("log validated" if self.valid else f"log NOT valid: {findings}")
        return ", ".join(parts)


def count(number: int, noun: str) -> str:
    """`no collision`, `1 collision`, `7 collisions`."""
    return f"{number or 'no'} {noun}{'s' if number > 1 else ''}"


def names(ids: Iterable[str], most: int = ROBOTS_NAMED) -> str:
    """The first few names and how many more there are."""
    every = list(ids)
    more = f" and {len(every) - most} more" if len(every) > most else ""
    return ", ".join(every[:most]) + more


def describe_plan(plan: Plan) -> str:
    """What the planner answered, in words (§1.12)."""
    if plan.status == "infeasible":
        named = f" (robots {names(plan.infeasible_robots)})" if plan.infeasible_robots else ""
        return f"proven: no plan exists within the horizon{named}"
    if plan.unserved:
        without = f"{len(plan.unserved)} of {len(plan.robot_ids)} robots have no path"
        return (
            "no plan found within the limits, and no proof that there is none: "
            f"{without} ({', '.join(plan.unserved)})"
        )
    if plan.status == "optimal":
        return f"plan cost {plan.cost}, proven optimal"
    if plan.gap is None:
        return f"plan cost {plan.cost}, no bound proven"
    return f"plan cost {plan.cost}, proven within {per_cent_at_most(plan.gap)} of optimal"


def per_cent_at_most(share: float) -> str:
    """A share in per cent, rounded up so that the words never promise more than is proven."""
    return f"{math.ceil(1000 * share - 1e-9) / 10:.1f} %"


def make_plan(
    problem: Problem,
    params: SolveParams | None = None,
    *,
    watch: Stopwatch | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Plan:
    """Ask the planner, passing its progress on; `stop` ends it with the best answer so far."""
    from planner.solve import Progress, solve

    watch = watch or Stopwatch()
    robots = problem.n_robots

    def on_progress(progress: Progress) -> None:
        found = f"{progress.served} of {robots} robots, cost {progress.cost}"
        bound = f"bound {progress.bound:.0f}"
        if progress.served == robots and progress.bound > 0:
            bound += f", gap {per_cent_at_most(progress.cost / progress.bound - 1)}"
        columns = f", {progress.columns} columns" if progress.columns else ""
        watch.on_step(f"plan: {progress.phase}, {found}, {bound}{columns}", None)

    with watch.phase("plan"):
        return solve(problem, params, on_progress, stop)


def travel(
    instance: Instance,
    folder: Path,
    *,
    params: SolveParams | None = None,
    overwrite: bool = False,
    watch: Stopwatch | None = None,
) -> Road:
    """Plan an instance, execute the plan, log, validate and draw it.

    Files appear in `folder` all together at the end. A plan that leaves a robot without a path is
    not executed, and nothing is written: half a fleet standing on its origins is another problem
    than the one that was asked.

    Args:
        instance: what to plan for.
        folder: where the files of the run shall lie.
        params: for the planner.
        overwrite: replace the files of an earlier run in `folder`.
        watch: timed phases are noted here.

    Raises:
        TwinError: `folder` cannot take a run (`twin.outputs.check_run_folder`).
    """
    watch = watch or Stopwatch()
    files = RunFiles(folder)
    check_run_folder(files, overwrite=overwrite)
    plan = make_plan(instance.problem, params, watch=watch)
    if plan.status == "infeasible" or plan.unserved:
        why = "`twin plan` with --explain says why, and what would be enough"
        return Road(instance, plan, seconds=watch.seconds, hints=(why,))
    with staged(folder) as stage:
        written = RunFiles(stage)
        with watch.phase("run"):
            execution = execute(instance, plan, written.log, watch=watch)
        with watch.phase("validation"):
            from logs.validate import validate

            report = validate(written.log)
        with watch.phase("picture"):
            from logs.figures import draw_run
            from logs.mcap_reader import read
            from planner.json_files import dump_plan

            draw_run(read(written.log), written.picture)
            written.plan.write_text(dump_plan(plan), encoding="utf-8")
    all_hints = (*hints(instance, plan), *advice(plan))
    return Road(instance, plan, execution, report, files, watch.seconds, all_hints)


def crossings_with_holes(instance: Instance, plan: Plan) -> tuple[int, int]:
    """Crossings of edges in a plan, and how many of them meet a hole in coverage half-way.

    A crossing meets one where neither the AP before it nor the one after it reaches some sample of
    its edge. The rule `edge_rule = "samples"` rules that out, `"endpoints"` does not (§1.7).
    """
    from worlds.radio_map import kept_edges

    radio_map = instance.radio_map
    edges = kept_edges(instance.floor, radio_map)
    reached = radio_map.edge_snr_db[edges] >= radio_map.threshold_db
    crossings = holes = 0
    for path in plan.paths:
        for slot, edge in enumerate(path.edges.tolist() if path is not None else []):
            # An edge of k slots is one crossing: it ends where the robot stands somewhere else.
            if edge < 0 or path is None or path.vertices[slot] == path.vertices[slot + 1]:
                continue
            before, after = path.aps[slot], path.aps[slot + 1]
            crossings += 1
            holes += not (reached[edge, :, before] | reached[edge, :, after]).all()
    return crossings, holes


def hints(instance: Instance, plan: Plan) -> tuple[str, ...]:
    """What the user might change about a run, and why."""
    crossings, holes = crossings_with_holes(instance, plan)
    if not holes:
        return ()
    share = f"{holes} of {crossings} crossings ({100 * holes / crossings:.0f} %)"
    return (
        f"{share} meet a hole in coverage in the middle of an edge; "
        "--set radio.edge_rule=samples plans around them",
    )


def advice(plan: Plan) -> tuple[str, ...]:
    """Where room is short, if it is short at all (§1.13)."""
    prices = plan.prices
    return () if prices is None or prices.total <= 0 else (prices.advice,)


def execute(
    instance: Instance, plan: Plan, log: Path, *, watch: Stopwatch | None = None
) -> Execution:
    """Run the twin on a plan and write its log.

    Returns:
        What the records say about the run as a whole.
    """
    from logs.mcap_writer import RunLog
    from twin.twin import run

    watch = watch or Stopwatch()
    world, floor = instance.world, instance.floor
    radio_map, problem = instance.radio_map, instance.problem
    tally = Tally()
    with RunLog(
        log, world=world, floor=floor, radio_map=radio_map, problem=problem, plan=plan
    ) as run_log:

        def emit(record: Record) -> None:
            run_log.write(record)
            tally.add(record)

        run(world, floor, radio_map, problem, plan, emit=emit, on_slot=watch.share("run"))
    return tally.result()


class Tally:
    """Keeps the records that speak of a run as a whole."""

    def __init__(self) -> None:
        self._kpi: Kpi | None = None
        self._end: RunEnd | None = None
        self._robots: list[RobotKpi] = []
        self._aps: list[ApKpi] = []
        self._incidents: Counter[str] = Counter()
        self._replans: list[Replan] = []

    def add(self, record: Record) -> None:
        """Take note of one record."""
        match record:
            case Kpi():
                self._kpi = record
            case RobotKpi():
                self._robots.append(record)
            case ApKpi():
                self._aps.append(record)
            case Incident():
                self._incidents[record.kind] += 1
            case Replan():
                self._replans.append(record)
            case RunEnd():
                self._end = record
            case _:
                pass

    @property
    def complete(self) -> bool:
        """Whether the run has ended."""
        return self._kpi is not None and self._end is not None

    def result(self) -> Execution:
        """All of it, once the run has ended."""
        if self._kpi is None or self._end is None:
            raise RuntimeError("the run has not ended: its last records are missing")
        return Execution(
            self._kpi,
            tuple(self._robots),
            tuple(self._aps),
            self._end,
            dict(sorted(self._incidents.items())),
            tuple(self._replans),
        )
