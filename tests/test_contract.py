"""Every rule of the semantics is held by a test that cites its number."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent
RULES = [f"§1.{number}" for number in range(1, 16)]


def functions_of(path: Path) -> Iterator[tuple[str, str]]:
    """Name and text of each test function of a file."""
    text = path.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
            yield f"{path.name}::{node.name}", ast.get_source_segment(text, node) or ""


@cache
def citations() -> dict[str, list[str]]:
    """For each rule, the tests that cite it; ranges such as §1.1–§1.5 cite nothing."""
    cited: dict[str, list[str]] = {rule: [] for rule in RULES}
    for path in sorted(TESTS.rglob("test_*.py")):
        if path == Path(__file__).resolve():
            continue
        for name, text in functions_of(path):
            single = re.sub(r"§1\.\d+\s*[–-]\s*(§?1?\.?\d+)", "", text)
            for rule in set(re.findall(r"§1\.\d+", single)) & cited.keys():
                cited[rule].append(name)
    return cited


@pytest.mark.parametrize("rule", RULES)
def test_rule_is_cited_by_a_test(rule):
    """No rule of the contract is without a test function that names it."""
    assert citations()[rule], f"no test cites {rule}"
