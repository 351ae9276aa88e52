"""Compilation ahead of time limits."""

from __future__ import annotations

import importlib
import pkgutil
import re
from pathlib import Path
from types import ModuleType

import planner
from planner import solve as planning
from planner import warm_up
from planner.solve import SolveParams
from tests.planner.examples import grid


def called_kernels() -> dict[str, object]:
    """Every compiled function that a module of the planner calls, by name."""
    called: dict[str, object] = {}
    for info in pkgutil.walk_packages(planner.__path__, "planner."):
        if info.name.split(".")[-1].startswith("kernels"):
            continue
        module = importlib.import_module(info.name)
        source = Path(str(module.__file__)).read_text(encoding="utf-8")
        for alias, value in vars(module).items():
            if isinstance(value, ModuleType) and value.__name__.startswith("planner.kernels"):
                for name in re.findall(rf"\b{alias}\.(\w+)\(", source):
                    if hasattr(getattr(value, name), "signatures"):
                        called[f"{value.__name__}.{name}"] = getattr(value, name)
    return called


def test_all_that_is_called_is_compiled():
    """After the warm-up no kernel is left to compile, and the next process knows it."""
    kernels = called_kernels()
    assert {name.split(".")[1] for name in kernels} == set(warm_up.MODULES)
    warm_up.compile_kernels()
    assert [name for name, kernel in kernels.items() if not kernel.signatures] == []
    assert warm_up.kernels_are_compiled()


def test_compilation_is_no_part_of_a_time_limit(monkeypatch):
    """Before a limit begins the kernels are compiled, if they never were; without one they wait."""
    told: list[str] = []
    monkeypatch.setattr(warm_up, "kernels_are_compiled", lambda: False)
    monkeypatch.setattr(warm_up, "compile_kernels", lambda: told.append("compiled"))
    problem = grid(3, 2, [(0, 5), (5, 0)])
    planning.solve(problem, SolveParams(iterations=5))
    assert told == []
    planning.solve(problem, SolveParams(iterations=5, time_limit=5.0))
    assert told == ["compiled"]
