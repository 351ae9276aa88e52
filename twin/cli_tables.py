"""What the commands answer: as plain values for `--json`, as tables for people."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from rich.box import ROUNDED
from rich.console import Console
from rich.table import Table
from rich.text import Text

from logs.records import CAUSES
from twin.pipeline import count, describe_plan, names

if TYPE_CHECKING:
    from logs.findings import Report
    from logs.records import Kpi
    from planner.plan import Plan
    from planner.problem import Problem
    from twin.instance import Instance
    from twin.pipeline import Execution, Road

Json = dict[str, object]
Row = tuple[str, str]

FINDINGS_SHOWN = 20
FINDINGS_OF_A_RUN = 5
REPLANS_NAMED = 4
GOOD, BAD, PLAIN = "bold green", "bold red", ""


def per_cent(share: float, digits: int = 1) -> str:
    """0.5 → `50.0 %`."""
    return f"{100 * share:.{digits}f} %"


def number(value: int | float, unit: str = "") -> str:
    """1234567 → `1 234 567`, with a thin gap between thousands and a unit behind."""
    text = f"{value:,}" if isinstance(value, int) else f"{value:,.1f}"
    return text.replace(",", "\u202f") + (f" {unit}" if unit else "")


# --- plain values -------------------------------------------------------------------------------


def instance_values(instance: Instance) -> Json:
    """Size of what was planned for."""
    return {
        "world": instance.world.name,
        "free_positions": len(instance.floor.vertex_xy_m),
        "covered_positions": instance.problem.n_vertices,
        "slot_s": instance.floor.slot_s,
        **problem_values(instance.problem),
    }


def problem_values(problem: Problem) -> Json:
    """Size of a problem."""
    return {
        "robots": problem.n_robots,
        "aps": problem.n_aps,
        "vertices": problem.n_vertices,
        "edges": problem.n_edges,
        "horizon": problem.horizon,
        "objective": problem.objective,
        "c_t": problem.c_t,
        "c_h": problem.c_h,
        "at_goal": problem.at_goal,
    }


def plan_values(plan: Plan) -> Json:
    """The planner's answer without its paths."""
    served = len(plan.robot_ids) - len(plan.unserved)
    return {
        "status": plan.status,
        "cost": plan.cost,
        "lower_bound": plan.lower_bound,
        "gap": plan.gap,
        "lp_value": plan.lp_value,
        "handovers": plan.handovers,
        "slots": plan.slots,
        "served": served,
        "unserved": list(plan.unserved),
        "infeasible_robots": list(plan.infeasible_robots),
        "message": plan.message,
        "advice": plan.prices.advice if plan.prices else None,
        "seconds": plan.seconds,
        "solver": {k: v for k, v in plan.solver.items() if math.isfinite(v)},
    }


def execution_values(execution: Execution) -> Json:
    """Key figures of a run, of each robot and of each AP."""
    return {
        "verdict": execution.end.verdict,
        "message": execution.end.message,
        "kpi": asdict(execution.kpi),
        "incidents": execution.incidents,
        "replans": [asdict(replan) for replan in execution.replans],
        "robots": [asdict(robot) for robot in execution.robots],
        "aps": [asdict(ap) for ap in execution.aps],
    }


def road_values(road: Road) -> Json:
    """All of a run."""
    files = road.files
    return {
        "succeeded": road.succeeded,
        "summary": road.summary,
        "instance": instance_values(road.instance),
        "plan": plan_values(road.plan),
        "execution": execution_values(road.execution) if road.execution else None,
        "hints": list(road.hints),
        "validation": road.report.to_dict() if road.report else None,
        "files": {
            "log": str(files.log),
            "layout": str(files.layout),
            "picture": str(files.picture),
            "plan": str(files.plan),
        }
        if files
        else {},
        "seconds": {phase: round(s, 3) for phase, s in road.seconds.items()},
    }


# --- tables -------------------------------------------------------------------------------------


class Facts:
    """A table of facts in titled sections."""

    def __init__(self, title: str) -> None:
        self._table = Table(
            title=Text(title, style="bold"),
            title_justify="left",
            box=ROUNDED,
            show_header=False,
            border_style="dim",
            padding=(0, 1),
        )
        self._table.add_column(style="cyan", no_wrap=True)
        self._table.add_column(overflow="fold")

    def section(self, rows: Iterable[tuple[str, str | Text]]) -> None:
        """Add rows and a line below them; values are text, never markup."""
        for name, value in rows:
            self._table.add_row(name, value if isinstance(value, Text) else Text(value))
        self._table.add_section()

    def print(self, console: Console) -> None:
        """Show it."""
        console.print(self._table)


def verdict(text: str, good: bool) -> Text:
    """Green or red."""
    return Text(text, style=GOOD if good else BAD)


def problem_rows(problem: Problem) -> list[Row]:
    """What the planner was asked."""
    expanded = number((problem.horizon + 1) * int(problem.cover.sum()))
    goal = "leave the floor" if problem.at_goal == "leave" else "stay"
    return [
        (
            "problem",
            f"{problem.n_robots} robots, {problem.n_aps} access points, {problem.n_vertices} "
            f"positions, {problem.n_edges} edges",
        ),
        ("horizon", f"{problem.horizon} slots, {expanded} states in the expanded graph"),
        (
            "objective",
            f"{problem.objective} (a slot costs {problem.c_t}, a handover {problem.c_h}); "
            f"robots at their goals {goal}",
        ),
    ]


def plan_rows(plan: Plan) -> list[tuple[str, str | Text]]:
    """The planner's answer."""
    served = len(plan.robot_ids) - len(plan.unserved)
    rows: list[tuple[str, str | Text]] = [
        ("plan", verdict(plan.status, plan.status in {"optimal", "feasible"})),
    ]
    if plan.message:
        rows.append(("reason", plan.message))
    if plan.infeasible_robots:
        rows.append(("cannot be served", names(plan.infeasible_robots)))
    elif plan.unserved:
        rows.append(("without a path", names(plan.unserved)))
    if plan.status == "infeasible":
        return rows
    rows.append(("cost", f"{plan.cost}" + ("" if not plan.unserved else f" for {served} robots")))
    if plan.lower_bound is not None:
        rows.append(("lower bound", f"{plan.lower_bound:.10g}"))
    if plan.gap is not None:
        rows.append(("gap", per_cent(plan.gap, 2)))
    rows += [
        ("handovers", f"{plan.handovers}"),
        ("slots", f"{plan.slots} until arrival, all robots together"),
    ]
    return rows


def execution_rows(execution: Execution, slot_s: float) -> list[tuple[str, str | Text]]:
    """Key figures of a run."""
    kpi = execution.kpi
    seconds = kpi.connected_s + kpi.handover_s + kpi.outage_s
    share = kpi.connected_s / seconds if seconds else 0.0
    rows: list[tuple[str, str | Text]] = [
        ("run", verdict(execution.end.verdict, execution.end.verdict == "completed")),
    ]
    if execution.end.message:
        rows.append(("reason", execution.end.message))
    rows += [
        (
            "arrived",
            f"{kpi.arrived} of {kpi.robots} robots, the last in slot {kpi.makespan_slots} "
            f"({kpi.planned_makespan_slots} planned; after "
            f"{number(kpi.makespan_slots * slot_s, 's')})",
        ),
        (
            "travel",
            f"{kpi.travel_slots} robot-slots ({kpi.planned_travel_slots} planned), "
            f"{kpi.held_slots} held against the plan{_held_by(kpi)}",
        ),
        ("handovers", f"{kpi.handovers} ({kpi.planned_handovers} planned){_unplanned(kpi)}"),
        (
            "connection",
            f"{per_cent(share, 2)} of {number(seconds, 'robot-seconds')}; handovers "
            f"{number(kpi.handover_s, 's')}, outage {number(kpi.outage_s, 's')} "
            f"(longest {number(kpi.worst_outage_s, 's')})",
        ),
        (
            "data",
            f"{number(kpi.delivered_mbit / 1000, 'Gbit')} delivered, 90 % of the time at least "
            f"{number(kpi.p10_rate_mbps, 'Mbit/s')}",
        ),
        (
            "AP load",
            f"peak {kpi.peak_load} robots ({per_cent(kpi.peak_load_share, 0)} of that AP's "
            f"capacity), {kpi.overload_robot_slots} robot-slots over capacity",
        ),
    ]
    if kpi.delays or kpi.replans:
        adopted = sum(replan.adopted for replan in execution.replans)
        said = f"{count(kpi.delays, 'delay')}, {count(kpi.replans, 'new plan')} asked for"
        causes = ", ".join(f"slot {r.slot}: {r.cause} {r.name}".rstrip() for r in
                           execution.replans[:REPLANS_NAMED])  # fmt: skip
        said += f", {adopted} adopted ({causes}{', …' if kpi.replans > REPLANS_NAMED else ''})" * (
            kpi.replans > 0
        )
        rows.append(("disturbed", said))
    if kpi.min_clearance_m > -1000:
        rows.append(("clearance", f"least {kpi.min_clearance_m:.2f} m between two robots"))
    if execution.incidents:
        said = ", ".join(f"{count} × {kind}" for kind, count in execution.incidents.items())
        rows.append(("incidents", verdict(said, False)))
    return rows


def _held_by(kpi: Kpi) -> str:
    """Why robots were held, in brackets."""
    held = {cause: getattr(kpi, f"held_by_{cause.replace('-', '_')}") for cause in CAUSES}
    said = ", ".join(f"{cause} {slots}" for cause, slots in held.items() if slots)
    return f" ({said})" if said else ""


def _unplanned(kpi: Kpi) -> str:
    """What handovers were not the plan's."""
    if not kpi.unplanned_handovers:
        return ""
    back = f", {kpi.ping_pongs} of them back at once" if kpi.ping_pongs else ""
    return f", {kpi.unplanned_handovers} of them not in the plan{back}"


def report_rows(report: Report, most: int = FINDINGS_SHOWN) -> list[tuple[str, str | Text]]:
    """A validator's answer, with its first findings."""
    checked = number(sum(report.checked.values()))
    text = "valid" if report.valid else f"NOT valid: {count(len(report.findings), 'finding')}"
    rows: list[tuple[str, str | Text]] = [
        ("validation", Text.assemble(verdict(text, report.valid), f", {checked} facts checked")),
    ]
    rows += [("finding", str(finding)) for finding in report.findings[:most]]
    if len(report.findings) > most:
        rows.append(("", f"… and {len(report.findings) - most} more, see `twin validate --json`"))
    rows += [("not checked", text) for text in report.skipped]
    return rows


def seconds_row(seconds: dict[str, float]) -> Row:
    """Time per phase and in all."""
    parts = [f"{phase} {s:.1f}" for phase, s in seconds.items()]
    return ("seconds", ", ".join(parts) + f"; in all {sum(seconds.values()):.1f}")


def print_road(console: Console, road: Road) -> None:
    """The table a run ends with, and its outcome in one line."""
    problem = road.instance.problem
    facts = Facts(road.instance.world.name)
    free = len(road.instance.floor.vertex_xy_m)
    covered = (
        f"{problem.n_vertices} of {free} free positions ({per_cent(problem.n_vertices / free)})"
    )
    facts.section([*problem_rows(problem), ("coverage", covered)])
    facts.section(plan_rows(road.plan))
    if road.execution is not None:
        rows = execution_rows(road.execution, road.instance.floor.slot_s)
        facts.section([*rows, *(("hint", hint) for hint in road.hints)])
    else:
        facts.section(("hint", hint) for hint in road.hints)
    if road.report is not None:
        facts.section(report_rows(road.report, FINDINGS_OF_A_RUN))
    facts.section([seconds_row(road.seconds)])
    if road.files is not None:
        facts.section(
            [
                ("log", str(road.files.log)),
                ("layout", f"{road.files.layout} (for Foxglove)"),
                ("picture", str(road.files.picture)),
                ("plan file", str(road.files.plan)),
            ]
        )
    facts.print(console)
    console.print(Text(road.summary, style=GOOD if road.succeeded else BAD), soft_wrap=True)


def print_plan(
    console: Console, problem: Problem, plan: Plan, seconds: dict[str, float], file: Path | None
) -> None:
    """What `twin plan` ends with."""
    facts = Facts(problem.name or "problem")
    facts.section(problem_rows(problem))
    told = plan.prices is not None and not plan.unserved
    advice = [("advice", plan.prices.advice)] if told and plan.prices else []
    facts.section([*plan_rows(plan), *advice])
    facts.section([seconds_row(seconds)])
    if file is not None:
        facts.section([("plan file", str(file))])
    facts.print(console)
    complete = plan.status in {"optimal", "feasible"} and not plan.unserved
    console.print(verdict(describe_plan(plan), complete), soft_wrap=True)


def print_report(console: Console, report: Report) -> None:
    """What a validation found."""
    facts = Facts(report.path)
    facts.section(
        (f"{step['step']}  {step['name']}", f"{number(int(str(step['checked'])))} facts checked")
        for step in _steps(report)
    )
    facts.section(report_rows(report))
    facts.print(console)


def _steps(report: Report) -> list[dict[str, object]]:
    """Number, name and count of facts of each step."""
    return [{"step": s, "name": n, "checked": report.checked[s]} for s, n in report.steps.items()]
