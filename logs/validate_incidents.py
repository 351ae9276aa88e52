"""Step 3 of validation, incidents: each one recomputed is in the log, and none is invented."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable

from logs.mcap_format import time_ns
from logs.records import Incident, RunEnd
from logs.validate_context import STEP, Context

RULE = "page5:incident"
FAILURES = ("collision", "contact", "obstacle")
"""Kinds that make a run a failed one."""

Key = tuple[str, int, tuple[str, ...], str]
"""kind, when (slot; for an outage the time of its end [ns]), robots in order, AP."""

_TOLERANCE = 1e-6  # of values: metres, seconds; loads are whole numbers


class IncidentCheck:
    """Collects what the log tells and what the other checks have found to be so."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._told: dict[Key, float] = {}
        self._real: dict[Key, float] = {}
        self._either: set[Key] = set()
        self._slot: dict[Key, int] = {}
        self._arrived: set[str] = set()
        for name, path in zip(context.start.robots, context.inputs.plan.paths, strict=True):
            if path is None:
                self.expect("unserved", 0, (name,))

    def expect(
        self, kind: str, when: int, robots: tuple[str, ...], ap: str = "", value: float = 0.0
    ) -> None:
        """An incident of which the log should tell."""
        self._real[(kind, when, tuple(sorted(robots)), ap)] = value

    def allow(self, kind: str, when: int, robots: tuple[str, ...]) -> None:
        """An incident too near to the border to ask for it, or to hold it against the log."""
        self._either.add((kind, when, tuple(sorted(robots)), ""))

    def arrived(self, robot: str) -> None:
        """A robot has arrived."""
        self._arrived.add(robot)

    def add(self, incident: Incident) -> None:
        """An incident of the log."""
        kind, slot = incident.kind, incident.slot
        keys: list[Key]
        match kind:
            case "collision":  # of three at a place, two pairs are told: compare robot by robot
                keys = [(kind, slot, (name,), "") for name in (incident.robot, incident.other)]
            case "contact" | "caught":
                pair = sorted((incident.robot, incident.other))
                keys = [(kind, slot, (pair[0], pair[1]), "")]
            case "obstacle" | "unserved":
                keys = [(kind, slot, (incident.robot,), "")]
            case "overload":
                keys = [(kind, slot, (), incident.ap)]
            case "deadlock":
                keys = [(kind, slot, (), "")]
            case "outage":
                keys = [(kind, time_ns(incident.t_s), (incident.robot,), incident.ap)]
            case _:
                self._find(
                    f"an incident of unknown kind {kind!r}", "a kind of logs/records.py", slot
                )
                return
        for key in keys:
            if key in self._told and kind != "collision":
                self._find(f"{self._text(key)}, told twice", "once", slot)
            self._told[key] = incident.value
            self._slot[key] = slot

    def expect_deadlock(self, slot: int) -> None:
        """A deadlock of which the log should tell, however many robots are in its circle."""
        key: Key = ("deadlock", slot, (), "")
        self._real[key] = self._told.get(key, 0.0)

    def has_told(self, kind: str, slot: int) -> bool:
        """Whether the log tells of an incident of this kind in a slot."""
        return any(key[:2] == (kind, slot) for key in self._told)

    def finish(self, end: RunEnd | None) -> None:
        """Compare, and hold the verdict against what was found."""
        checks = self._context.checks
        checks.count(STEP, RULE, len(self._real) + len(self._told) + 1)
        for key, value in self._real.items():
            if key not in self._told:
                self._find("no incident", self._text(key), self._when(key), key)
            elif key[0] in {"contact", "overload", "outage"} and not math.isclose(
                self._told[key], value, rel_tol=0.0, abs_tol=_TOLERANCE
            ):
                found = f"{self._text(key)}: value {self._told[key]}"
                self._find(found, value, self._when(key), key)
        for key in self._told:
            if key not in self._real and key not in self._either:
                self._find(self._text(key), "no such incident", self._slot[key], key)
        if end is None:
            return
        kinds = Counter(key[0] for key in self._real)
        missing = [name for name in self._context.start.robots if name not in self._arrived]
        failed = bool(missing) or any(kinds[kind] for kind in FAILURES)
        told_failures = any(key[0] in FAILURES for key in self._told if key in self._either)
        verdict = "failed" if failed or told_failures else "completed"
        checks.same(STEP, "page5:verdict", "verdict", end.verdict, verdict, slot=end.slot)
        checks.same(
            STEP,
            "page5:verdict",
            "a reason given:",
            bool(end.message),
            verdict == "failed",
            slot=end.slot,
        )

    def _find(self, found: Hashable, expected: object, slot: int, key: Key | None = None) -> None:
        robot = ", ".join(key[2]) if key else ""
        self._context.checks.find(STEP, RULE, found, expected, slot=slot, robot=robot)

    def _when(self, key: Key) -> int:
        """The slot of a key."""
        if key[0] != "outage":
            return key[1]
        slot_ns = round(self._context.start.slot_s * 1e9)
        return (key[1] - self._context.t_ns(0)) // slot_ns

    def _text(self, key: Key) -> str:
        kind, when, robots, ap = key
        of = f" of {' and '.join(robots)}" if robots else ""
        at = f", AP {ap}" if ap else ""
        if kind == "outage":
            return f"outage{of} until {(when - self._context.t_ns(0)) / 1e9:.3f} s{at}"
        return f"{kind}{of} in slot {when}{at}"
