"""What a validation finds: findings as data, counts of what was checked, JSON and JUnit XML."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from xml.etree import ElementTree

STEPS: Mapping[int, str] = {
    1: "container",
    2: "plan against problem",
    3: "run against plan and world",
    4: "key figures",
    5: "the run made again",
}
"""Step 5 (`twin.rerun`) is done when it is asked for, the others always."""

KEPT = 20
"""Findings listed of one rule; of the rest only the number, so that a broken file stays legible."""

_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd]")  # characters XML 1.0 cannot carry


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is not as it should be.

    Attributes:
        step: 1 to 5, see `STEPS`.
        rule: the rule that is broken: a paragraph of the semantics ("§1.6"), an invariant
            ("page5:load"), a part of the container ("container:crc"), or "reader" when the
            check itself could not go on.
        slot: where in time, None if nowhere in particular.
        robot: whose, "" if nobody's.
        found: what the file says.
        expected: what it should say.
    """

    step: int
    rule: str
    slot: int | None
    robot: str
    found: str
    expected: str

    def __str__(self) -> str:
        """`§1.6 slot 7 robot r03: found, expected ...`."""
        place = "" if self.slot is None else f" slot {self.slot}"
        place += f" robot {self.robot}" if self.robot else ""
        return f"{self.rule}{place}: {self.found}; expected {self.expected}"


@dataclass(frozen=True)
class Report:
    """The answer of a validation.

    Attributes:
        path: the file.
        findings: in the order of steps, then as met.
        rules: (step, rule) -> number of facts held against that rule.
        skipped: what could not be checked, and why.
        seconds: wall-clock time spent.
    """

    path: str
    findings: tuple[Finding, ...]
    rules: Mapping[tuple[int, str], int]
    skipped: tuple[str, ...]
    seconds: float

    @property
    def valid(self) -> bool:
        """Whether all was checked and nothing found."""
        return not self.findings and not self.skipped

    @property
    def steps(self) -> dict[int, str]:
        """Number and name of the steps that were asked for."""
        again = any(step == 5 for step, _ in self.rules)
        return {step: name for step, name in STEPS.items() if step < 5 or again}

    @property
    def checked(self) -> dict[int, int]:
        """Facts checked per step."""
        counts = dict.fromkeys(self.steps, 0)
        for (step, _), number in self.rules.items():
            counts[step] += number
        return counts

    def to_dict(self) -> dict[str, object]:
        """The report as plain values, for JSON."""
        return {
            "path": self.path,
            "valid": self.valid,
            "steps": [
                {"step": step, "name": name, "checked": self.checked[step]}
                for step, name in self.steps.items()
            ],
            "rules": [
                {"step": step, "rule": rule, "checked": number}
                for (step, rule), number in sorted(self.rules.items())
            ],
            "findings": [asdict(finding) for finding in self.findings],
            "skipped": list(self.skipped),
            "seconds": round(self.seconds, 3),
        }

    def to_junit_xml(self) -> str:
        """The report as JUnit XML: one test suite per step, one test case per rule."""
        root = ElementTree.Element("testsuites", name="validate", time=f"{self.seconds:.3f}")
        for step, name in self.steps.items():
            cases = {rule: 0 for s, rule in sorted(self.rules) if s == step}
            mine = [finding for finding in self.findings if finding.step == step]
            cases.update({f.rule: 0 for f in mine})
            failed = {f.rule for f in mine}
            suite = ElementTree.SubElement(
                root,
                "testsuite",
                name=f"{step} {name}",
                tests=str(len(cases)),
                failures=str(len(failed)),
            )
            for rule in cases:
                case = ElementTree.SubElement(
                    suite, "testcase", classname=f"validate.step{step}", name=rule
                )
                own = [str(f) for f in mine if f.rule == rule]
                if own:
                    text = _NOT_XML.sub("?", "\n".join(own))
                    failure = ElementTree.SubElement(
                        case, "failure", message=text.splitlines()[0], type=rule
                    )
                    failure.text = text
        ElementTree.indent(root)
        return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


class Checks:
    """Collects findings, the first `KEPT` of each rule, and counts what was checked."""

    def __init__(self) -> None:
        self.rules: Counter[tuple[int, str]] = Counter()
        self.skipped: list[str] = []
        self._met: Counter[tuple[int, str]] = Counter()
        self._findings: list[Finding] = []

    def skip(self, what: str) -> None:
        """Note once what cannot be checked, and why."""
        if what not in self.skipped:
            self.skipped.append(what)

    def count(self, step: int, rule: str, facts: int = 1) -> None:
        """Note that `facts` facts are being held against `rule`."""
        self.rules[step, rule] += facts

    def find(
        self,
        step: int,
        rule: str,
        found: object,
        expected: object,
        *,
        slot: int | None = None,
        robot: str = "",
    ) -> None:
        """Note a finding."""
        self._met[step, rule] += 1
        if self._met[step, rule] <= KEPT:
            self._findings.append(Finding(step, rule, slot, robot, str(found), str(expected)))

    def same(
        self,
        step: int,
        rule: str,
        what: str,
        found: object,
        expected: object,
        *,
        slot: int | None = None,
        robot: str = "",
    ) -> None:
        """Count a fact and note a finding unless the two are equal."""
        self.count(step, rule)
        if found != expected:
            self.find(step, rule, f"{what} {found}", expected, slot=slot, robot=robot)

    def total(self, step: int) -> int:
        """Number of findings of a step, those not kept included."""
        return sum(number for (s, _), number in self._met.items() if s == step)

    def findings(self) -> tuple[Finding, ...]:
        """All that are kept, in the order of steps, then a line on each rule that has more."""
        rest = [
            Finding(step, rule, None, "", f"{number - KEPT} more findings of this rule", "none")
            for (step, rule), number in self._met.items()
            if number > KEPT
        ]
        return tuple(sorted([*self._findings, *rest], key=lambda finding: finding.step))
