"""Step 4 of validation: key figures folded anew from the records equal those that are stored."""

from __future__ import annotations

import math
from dataclasses import fields

from logs.findings import Checks
from logs.kpi import KpiFold, planned_figures
from logs.mcap_format import time_ns
from logs.records import ApKpi, Kpi, Record, RobotKpi, Waits
from logs.validate_context import Context

STEP = 4
_RULE = "page5:kpi"
_RELATIVE = 1e-9


class KpiCheck:
    """Folds the records of a run and compares wherever the log has a figure."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._checks: Checks = context.checks
        self._fold = KpiFold(context.start, planned_figures(context.inputs.plan))
        self._slot = 0  # of the next Kpi
        self._final: dict[str, RobotKpi | ApKpi] | None = None
        self._met: set[str] = set()
        self._waits = 0

    def add(self, record: Record) -> None:
        """The next record."""
        match record:
            case Kpi():
                self._check_time(record)
                self._compare(record, self._fold.current(record.t_s, record.slot), record.slot)
            case RobotKpi() | ApKpi():
                self._check_final(record)
            case Waits():
                real = self._fold.waits(record.t_s)
                self._checks.same(STEP, _RULE, "who waits for whom", record, real)
                self._waits += 1
            case _:
                self._fold.add(record)

    def _check_time(self, kpi: Kpi) -> None:
        """One per slot, at its end."""
        self._checks.count(STEP, _RULE)
        on_time = time_ns(kpi.t_s) == self._context.t_ns(kpi.slot + 1)
        if kpi.slot != self._slot or not on_time:
            self._checks.find(
                STEP,
                _RULE,
                f"Kpi of slot {kpi.slot} at {kpi.t_s} s",
                f"slot {self._slot}, at its end",
                slot=kpi.slot,
            )
        self._slot = kpi.slot + 1

    def _check_final(self, told: RobotKpi | ApKpi) -> None:
        last = self._context.last
        if self._final is None:
            figures = self._fold.final(told.t_s, last)
            self._final = {figure.topic + _name(figure): figure for figure in figures}
        name = told.topic + _name(told)
        if name in self._met:
            self._checks.find(STEP, _RULE, f"{type(told).__name__} told twice", "once")
        self._met.add(name)
        self._compare(told, self._final[name], None)

    def _compare(
        self, told: Kpi | RobotKpi | ApKpi, real: Kpi | RobotKpi | ApKpi, slot: int | None
    ) -> None:
        robot = told.robot if isinstance(told, RobotKpi) else ""
        of = f"{type(told).__name__} of {told.ap}" if isinstance(told, ApKpi) else "Kpi"
        for field in fields(told):
            found, expected = getattr(told, field.name), getattr(real, field.name)
            self._checks.count(STEP, _RULE)
            same = (
                math.isclose(found, expected, rel_tol=_RELATIVE, abs_tol=_RELATIVE)
                if isinstance(expected, float)
                else found == expected
            )
            if not same:
                self._checks.find(
                    STEP, _RULE, f"{of}.{field.name} = {found}", expected, slot=slot, robot=robot
                )

    def finish(self) -> None:
        """Every slot has its figures, and every robot and AP at the end."""
        last = self._context.last
        self._checks.same(STEP, _RULE, "slots with a Kpi:", self._slot, last + 1)
        self._checks.same(STEP, _RULE, "Waits records:", self._waits, 1)
        start = self._context.start
        expected = len(start.robots) + len(start.aps)
        self._checks.same(STEP, _RULE, "robots and APs with figures:", len(self._met), expected)


def _name(figure: RobotKpi | ApKpi) -> str:
    return figure.robot if isinstance(figure, RobotKpi) else figure.ap
