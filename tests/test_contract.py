"""Every rule of the semantics is held by a test that cites its number."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent
RULES = [f"§1.{number}" for number in range(1, 16)]


@cache
def citations() -> dict[str, list[str]]:
    """For each rule, the test files that cite it; ranges such as §1.1–§1.5 cite nothing."""
    cited: dict[str, list[str]] = {rule: [] for rule in RULES}
    for path in sorted(TESTS.rglob("test_*.py")):
        if path == Path(__file__).resolve():
            continue
        text = re.sub(r"§1\.\d+\s*[–-]\s*(§?1?\.?\d+)", "", path.read_text(encoding="utf-8"))
        for rule in set(re.findall(r"§1\.\d+", text)) & cited.keys():
            cited[rule].append(path.name)
    return cited


@pytest.mark.parametrize("rule", RULES)
def test_rule_is_cited_by_a_test(rule):
    """No rule of the contract is without a test that names it."""
    assert citations()[rule], f"no test cites {rule}"
