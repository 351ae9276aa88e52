"""The key figures a study can have as columns, and where each of them comes from.

What a run's records say is computed by `logs.kpi` alone; here its results are only picked, and put
in relation to the number of robots. What only a plan says is told by the plan.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from logs.records import Kpi
from worlds.errors import Fault, Key

if TYPE_CHECKING:
    from planner.plan import Plan
    from twin.instance import Instance
    from twin.pipeline import Execution

Value = float | int | None

_NOT_FIGURES = {"t_s", "slot"}
FROM_RUN = tuple(f.name for f in dataclasses.fields(Kpi) if f.name not in _NOT_FIGURES)
"""Fields of the record `Kpi`, each a column of executed runs under its own name."""


@dataclass(frozen=True)
class Answer:
    """What one run has to say.

    Attributes:
        instance: what was planned for.
        plan: the planner's answer.
        execution: None if only planned, or if there was no plan to execute.
        ok: whether the run succeeded.
    """

    instance: Instance
    plan: Plan
    execution: Execution | None
    ok: bool

    @property
    def robots(self) -> int:
        """How many are to be served."""
        return max(1, len(self.plan.robot_ids))


@dataclass(frozen=True)
class Column:
    """A key figure.

    Attributes:
        label: for figures and tables, with its unit.
        value: of one answer; None where it has none.
        of_all: it says something of runs without success, too, so these are in its mean.
        share: it is 0 or 1 in each run, so its mean is a share of runs.
        executed: it needs a run in the twin.
    """

    label: str
    value: Callable[[Answer], Value]
    of_all: bool = False
    share: bool = False
    executed: bool = False


def _planned_load(answer: Answer) -> tuple[int, float]:
    """Greatest load of any AP in any slot by the plan (§1.6), and the greatest share used."""
    import numpy as np

    problem = answer.instance.problem
    load = np.zeros((problem.horizon + 1, problem.n_aps), np.int64)
    for path in answer.plan.paths:
        if path is None:
            continue
        np.add.at(load, (np.arange(path.arrival + 1), path.aps), 1)
        if problem.at_goal == "park":
            load[path.arrival + 1 :, path.aps[-1]] += 1
    share = load / np.maximum(problem.ap_capacity, 1)
    return int(load.max(initial=0)), float(share.max(initial=0.0))


def _kpi(answer: Answer, name: str) -> Value:
    if answer.execution is None:
        return None
    found: float | int = getattr(answer.execution.kpi, name)
    return None if name == "min_clearance_m" and found <= -1000 else found


def _handovers(answer: Answer) -> int:
    run = answer.execution
    return answer.plan.handovers if run is None else run.kpi.handovers


def _slots(answer: Answer) -> int:
    run = answer.execution
    return answer.plan.slots if run is None else run.kpi.travel_slots


def _connected_share(answer: Answer) -> Value:
    run = answer.execution
    if run is None:
        return None
    total = run.kpi.connected_s + run.kpi.handover_s + run.kpi.outage_s
    return run.kpi.connected_s / total if total else None


def _ratio(answer: Answer) -> Value:
    value = answer.plan.lp_value
    return answer.plan.cost / value if value else None


def _makespan(answer: Answer) -> Value:
    if answer.execution is not None:
        return answer.execution.kpi.makespan_slots
    return max((p.arrival for p in answer.plan.paths if p is not None), default=0)


def _missions_per_hour(answer: Answer) -> Value:
    """Robots over the time until the last has arrived: what a batch after batch would give."""
    slots = _makespan(answer)
    arrived = answer.robots if answer.execution is None else answer.execution.kpi.arrived
    return arrived / (slots * answer.instance.floor.slot_s) * 3600 if slots else None


def _solver(name: str) -> Callable[[Answer], Value]:
    return lambda answer: answer.plan.solver.get(name)


def _covered_twice(answer: Answer) -> float:
    """Share of free positions that the loss of any one AP leaves covered."""
    count = answer.instance.radio_map.coverage_count
    return float((count >= 2).mean()) if len(count) else 0.0


def _covered(answer: Answer) -> float:
    return answer.instance.problem.n_vertices / max(1, len(answer.instance.floor.vertex_xy_m))


def _price_total(answer: Answer) -> Value:
    prices = answer.plan.prices
    return None if prices is None else prices.total


COLUMNS: dict[str, Column] = {
    "success": Column("share of runs that succeed", lambda a: int(a.ok), of_all=True, share=True),
    "served": Column(
        "share of robots with a path",
        lambda a: 1 - len(a.plan.unserved) / a.robots,
        of_all=True,
    ),
    "unserved_robots": Column("robots without a path", lambda a: len(a.plan.unserved), of_all=True),
    "optimal": Column(
        "share of runs proven optimal",
        lambda a: int(a.plan.status == "optimal"),
        of_all=True,
        share=True,
    ),
    "infeasible": Column(
        "share of runs proven infeasible",
        lambda a: int(a.plan.status == "infeasible"),
        of_all=True,
        share=True,
    ),
    "cost": Column("cost of the plan", lambda a: a.plan.cost),
    "lower_bound": Column("proven lower bound", lambda a: a.plan.lower_bound, of_all=True),
    "gap": Column("gap (cost − bound) / bound", lambda a: a.plan.gap),
    "lp_value": Column("value of the master LP", lambda a: a.plan.lp_value, of_all=True),
    "solution_ratio": Column("solution ratio, cost / master LP", _ratio),
    "handovers": Column("handovers", _handovers),
    "handovers_per_robot": Column("handovers per robot", lambda a: _handovers(a) / a.robots),
    "slots": Column("slots until arrival, all robots", _slots),
    "slots_per_robot": Column("slots until arrival per robot", lambda a: _slots(a) / a.robots),
    "makespan_slots": Column("slot of the last arrival", _makespan),
    "missions_per_hour": Column("robots at their goals per hour", _missions_per_hour),
    "ap_peak": Column("peak load of an AP, planned [robots]", lambda a: _planned_load(a)[0]),
    "ap_peak_share": Column(
        "peak load of an AP, planned, over its capacity", lambda a: _planned_load(a)[1]
    ),
    "plan_seconds": Column("seconds per plan", lambda a: a.plan.seconds, of_all=True),
    "lp_columns": Column("paths generated", _solver("columns"), of_all=True),
    "lp_rows": Column("rows of the master", _solver("rows"), of_all=True),
    "lp_iterations": Column("rounds of pricing", _solver("iterations"), of_all=True),
    "expanded_vertices": Column("vertices of G'", _solver("expanded_vertices"), of_all=True),
    "expanded_edges": Column("edges of G'", _solver("expanded_edges"), of_all=True),
    "covered": Column("share of free positions covered", _covered, of_all=True),
    "covered_twice": Column(
        "share of free positions covered by two APs", _covered_twice, of_all=True
    ),
    "price_total": Column("all prices of room together", _price_total, of_all=True),
    "connected_share": Column("share of the time with connection", _connected_share, executed=True),
    "outage_s_per_robot": Column(
        "seconds without connection per robot",
        lambda a: None if a.execution is None else a.execution.kpi.outage_s / a.robots,
        executed=True,
    ),
}


def _add_run_columns() -> None:
    for name in FROM_RUN:
        if name not in COLUMNS:
            unit = {"_s": " [s]", "_m": " [m]", "_db": " [dB]", "_mbps": " [Mbit/s]"}
            ending = next((u for end, u in unit.items() if name.endswith(end)), "")
            label = name.replace("_", " ") + ending

            def value(answer: Answer, name: str = name) -> Value:
                return _kpi(answer, name)

            COLUMNS[name] = Column(label, value, executed=True)


_add_run_columns()

PER_AP: dict[str, str] = {
    "ap_price": "price of one more place on {} [cost units]",
    "ap_peak": "peak load of {}, planned [robots]",
}
"""Columns of one AP, written `ap_price.ap0`."""

DEFAULT_COLUMNS: dict[str, tuple[str, ...]] = {
    "plan": (
        "success",
        "served",
        "cost",
        "gap",
        "handovers_per_robot",
        "slots_per_robot",
        "ap_peak",
        "plan_seconds",
    ),
    "execute": (
        "success",
        "served",
        "cost",
        "gap",
        "handovers_per_robot",
        "slots_per_robot",
        "outage_s",
        "peak_load",
    ),
}


def column(name: str) -> Column:
    """The column of a name that `column_faults` accepts; for others a plain one under its name."""
    kind, dot, ap = name.partition(".")
    if dot and kind in PER_AP:
        return Column(
            PER_AP[kind].format(ap), lambda a: _of_ap(a, kind, ap), of_all=kind != "ap_peak"
        )
    return COLUMNS.get(name, Column(name.replace("_", " "), lambda _a: None))


def _of_ap(answer: Answer, kind: str, ap: str) -> Value:
    problem, prices = answer.instance.problem, answer.plan.prices
    if ap not in problem.ap_ids:
        return None  # switched off in this scenario
    a = problem.ap_ids.index(ap)
    if kind == "ap_price":
        return None if prices is None else float(prices.ap[a])
    import numpy as np

    load = np.zeros(problem.horizon + 1, np.int64)
    for path in answer.plan.paths:
        if path is not None:
            load[: path.arrival + 1] += path.aps == a
            if problem.at_goal == "park" and path.aps[-1] == a:
                load[path.arrival + 1 :] += 1
    return int(load.max(initial=0))


def values_of(columns: Sequence[str], answer: Answer) -> dict[str, Value]:
    """The figures of one answer by column; None where there is none.

    A plan that serves not all robots has figures only where they speak of such plans, too: the
    cost of half a fleet compares with nothing.
    """
    found: dict[str, Value] = {}
    whole = not answer.plan.unserved and answer.plan.status != "infeasible"
    for name in columns:
        entry = column(name)
        value = entry.value(answer) if whole or entry.of_all else None
        found[name] = value if value is None or math.isfinite(value) else None
    return found


def column_faults(
    named: Iterable[tuple[Key, str, bool]], relative: Sequence[str] = ()
) -> list[Fault]:
    """Names of columns that do not exist.

    Args:
        named: place, name, and whether it must be a column of runs.csv.
        relative: names of figures that the study itself makes of others.
    """
    from worlds.part import nearest  # pydantic: not needed in the processes that run

    faults = []
    for key, name, of_runs in named:
        known = [*COLUMNS, *([] if of_runs else relative)]
        kind, dot, ap = name.partition(".")
        if name in known or (dot and ap and kind in PER_AP):
            continue
        if dot and kind in PER_AP:
            hint = f" write the id of an access point behind it, as in {kind}.ap0"
        else:
            hint = nearest(name, [*known, *PER_AP]) or " docs/studies.md lists them all"
        faults.append(Fault(key, f"'{name}' is no key figure;{hint}"))
    return faults
