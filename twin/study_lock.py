"""study.lock.toml: everything a study was resolved to, and the versions that ran it."""

from __future__ import annotations

import platform
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as installed
from typing import Any

from twin.study_grid import Grid

LIBRARIES = ("numpy", "scipy", "numba", "highspy", "pybullet", "simpy", "mcap", "pydantic")


@cache
def version() -> str:
    """Version of this program; "source" where it is not installed."""
    try:
        return installed("mapp-twin")
    except PackageNotFoundError:
        return "source"


def versions() -> dict[str, str]:
    """Of the program, the interpreter and the libraries a result may depend on."""
    found = {"mapp-twin": version(), "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = installed(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found | {"platform": platform.platform(), "byteorder": sys.byteorder}


def lock_text(grid: Grid) -> bytes:
    """The lock file: the study with its defaults, seeds, versions, and every cell with its world.

    Worlds are complete (files they name are taken in) and given once each; a cell names its own.
    """
    import tomli_w

    study = grid.study
    worlds: dict[str, str] = {}
    cells: list[dict[str, Any]] = []
    for cell in grid.cells:
        name = worlds.setdefault(cell.world, f"world{len(worlds)}") if cell.world else ""
        entry: dict[str, Any] = {"scenario": cell.scenario, "levels": cell.levels, "world": name}
        entry["planner"] = _without_none(cell.planner.model_dump())
        if cell.error:
            entry["error"] = cell.error
        if cell.baseline is not None:
            entry["baseline"] = cell.baseline
        cells.append(entry)
    seeds = list(dict.fromkeys(run.seed for run in grid.runs))
    document = {
        "format": "mapp-study-lock/1",
        "versions": versions(),
        "seeds": {"replication": seeds, "paths": sorted({p for c in grid.cells for p in c.seeds})},
        "study": _without_none(study.model_dump(exclude={"format", "quick"})),
        "cell": cells,
        "world": {name: text for text, name in worlds.items()},
    }
    return tomli_w.dumps(document, multiline_strings=True).encode()


def _without_none(value: Any) -> Any:
    """TOML has no null: what is not given is left out; tuples are arrays."""
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    if isinstance(value, list | tuple):
        return [_without_none(v) for v in value]
    return value
