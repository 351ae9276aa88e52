"""The rules of the house: who may import whom, and what stays out of memory until it is used."""

from __future__ import annotations

import ast
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MAY_IMPORT = {
    "worlds": set(),
    "planner": {"worlds"},
    "logs": {"worlds", "planner"},
    "twin": {"worlds", "planner", "logs"},
}
PACKAGES = tuple(MAY_IMPORT)
PLAIN_TYPES = {"worlds.world", "worlds.floor", "worlds.radio_map", "worlds.errors"}
HEAVY = {
    "matplotlib",
    "pybullet",
    "numba",
    "highspy",
    "scipy",
    "numpy",
    "pydantic",
    "simpy",
    "mcap",
}


@dataclass(frozen=True)
class Import:
    """`module` imports `target`; `at_start` when that happens as soon as it is imported itself."""

    module: str
    target: str
    at_start: bool
    line: int


@cache
def modules() -> dict[str, Path]:
    """Every module of the four packages by its dotted name."""
    found = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def imports() -> tuple[Import, ...]:
    """Every import statement of the four packages, `from x import y` as `x.y` if y is a module."""
    found = []
    for module, path in modules().items():
        tree = ast.parse(path.read_text(encoding="utf-8"), filename=str(path))
        lazy = {
            id(inner)
            for node in ast.walk(tree)
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) or _is_type_checking(node)
            for inner in ast.walk(node)
        }
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                targets = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path}:{node.lineno}: relative imports are not used here"
                base = node.module or ""
                names = [f"{base}.{alias.name}" for alias in node.names]
                targets = [name if name in modules() else base for name in names]
                if base == "mcap":  # `from mcap import writer` is an import of mcap.writer
                    targets = names
            else:
                continue
            found.extend(Import(module, t, id(node) not in lazy, node.lineno) for t in targets)
    return tuple(found)


def _is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


def importers(*roots: str) -> set[str]:
    """Modules that import one of `roots` or anything below it, at any depth of their code."""
    return {i.module for i in imports() for r in roots if f"{i.target}.".startswith(f"{r}.")}


def loaded_after(statement: str) -> set[str]:
    """Names in `sys.modules` after a fresh interpreter has run `statement`."""
    code = f"import sys; {statement}; print('\\n'.join(sys.modules))"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, timeout=60)
    return set(done.stdout.split())


def test_each_package_imports_only_those_below_it():
    """`worlds` imports none of the others, `planner` worlds, `logs` these two, `twin` all."""
    wrong = [
        f"{i.module}:{i.line} imports {i.target}"
        for i in imports()
        for package, other in [(i.module.split(".")[0], i.target.split(".")[0])]
        if other in PACKAGES and other != package and other not in MAY_IMPORT[package]
    ]
    assert wrong == []


def test_packages_never_import_tests_or_benchmarks():
    """What ships does not lean on what only checks or measures it."""
    assert importers("tests", "benchmarks") == set()


def test_planner_uses_only_plain_types_of_worlds():
    """The planner knows a world's data, never how it is read, drawn or ray-cast."""
    used = {
        i.target
        for i in imports()
        if i.module.split(".")[0] == "planner" and i.target.split(".")[0] == "worlds"
    }
    assert used <= PLAIN_TYPES


@pytest.mark.parametrize(
    ("library", "only"),
    [
        ("pybullet", {"worlds.scene"}),
        ("simpy", {"twin.twin"}),
        ("highspy", {"planner.master"}),
        ("mcap.writer", {"logs.mcap_writer"}),
    ],
)
def test_library_is_imported_in_one_file_only(library, only):
    """PyBullet, simpy's environment, the LP solver and MCAP's writer each sit behind one file."""
    assert importers(library) == only


def test_planner_imports_neither_physics_nor_events_nor_logs():
    """The planner is usable where pybullet, simpy and mcap are not even installed."""
    wrong = {m for m in importers("pybullet", "simpy", "mcap") if m.split(".")[0] == "planner"}
    assert wrong == set()
    assert loaded_after("import planner.solve").isdisjoint({"pybullet", "simpy", "mcap"})


def test_nothing_imports_the_command():
    """`twin/cli.py` is the end of the road: a library never calls its own command."""
    assert importers("twin.cli") == {"twin.__main__"}  # `python -m twin`


def test_only_the_command_uses_the_terminal_libraries():
    """Typer and rich are imported by the command's files alone."""
    wrong = {m for m in importers("typer", "rich") if not m.startswith("twin.cli")}
    assert wrong == set()


def test_no_module_imports_itself_in_a_circle():
    """The imports done at start-up form no circle, so any module can be imported first."""
    below: dict[str, set[str]] = {name: set() for name in modules()}
    for i in imports():
        if i.at_start and i.target in below and i.target != i.module:
            below[i.module].add(i.target)
    while below:
        leaves = {name for name, targets in below.items() if not targets & below.keys()}
        assert leaves, f"these import one another in a circle: {sorted(below)}"
        below = {name: targets for name, targets in below.items() if name not in leaves}


@pytest.mark.parametrize("package", PACKAGES)
def test_import_of_a_package_is_light(package):
    """`import twin` (and the others) loads none of the heavy libraries."""
    heavy = {name for name in loaded_after(f"import {package}") if name.split(".")[0] in HEAVY}
    assert heavy == set()


def test_help_of_the_command_is_light():
    """`twin --help` answers at once: the command loads a library only when a command needs it."""
    loaded = loaded_after("import twin.cli")
    heavy = {name for name in loaded if name.split(".")[0] in HEAVY - {"pydantic"}}
    assert heavy == set()


def test_every_module_says_what_it_is_for():
    """Each file begins with a docstring."""
    silent = [
        name
        for name, path in modules().items()
        if not ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
    ]
    assert silent == []
