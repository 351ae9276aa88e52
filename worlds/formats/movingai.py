"""MovingAI benchmark files: grid maps (.map) and scenarios (.scen).

The format is that of N. Sturtevant, "Benchmarks for Grid-Based Pathfinding", IEEE Transactions on
Computational Intelligence and AI in Games 4(2), 2012, DOI 10.1109/TCIAIG.2012.2197681. The cell
(0, 0) is the upper left one, x counts columns to the right, y counts rows downwards. How scenarios
become MAPF instances (the first K rows are K agents) is that of R. Stern et al., "Multi-Agent
Pathfinding: Definitions, Variants, and Benchmarks", SoCS 2019, DOI 10.1609/socs.v10i1.18510.

Positions in messages are the file's: lines count from 1, x and y from 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from worlds.errors import Fault, WorldError
from worlds.formats import PASSABLE

SYMBOLS = {
    ".": "ground",
    "G": "ground",
    "@": "out of bounds",
    "O": "out of bounds",
    "T": "trees",
    "S": "swamp",
    "W": "water",
}
"""All symbols of the format."""

MAX_CELLS = 4_000_000
"""A map of 2 000 × 2 000 cells; the largest of the benchmark has 1.5 million."""

MAX_BYTES = 64_000_000

SHOWN = 8
"""Faults of one kind that are listed; the others are counted."""

Cell = tuple[int, int]
"""(x, y): column and row, both from 0, from the upper left."""


@dataclass(frozen=True, eq=False)
class GridMap:
    """A map.

    Attributes:
        name: of its file, without folder.
        source: the file as messages call it.
        passable: (height, width) bool, read-only, [y, x].
    """

    name: str
    source: str
    passable: NDArray[np.bool_]

    @property
    def width(self) -> int:
        """Columns."""
        return int(self.passable.shape[1])

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.passable.shape[0])


@dataclass(frozen=True)
class ScenarioRow:
    """One agent's errand.

    Attributes:
        line: of the file, from 1.
        bucket: the benchmark's class of difficulty.
        map_name: the map it is for, without folder.
        width, height: of that map [cells].
        start, goal: cells.
        optimal_length: of a single agent's shortest path with diagonal moves [cells]; the planner
            moves along four directions, so it is a lower bound only.
    """

    line: int
    bucket: int
    map_name: str
    width: int
    height: int
    start: Cell
    goal: Cell
    optimal_length: float


@dataclass(frozen=True)
class Scenario:
    """A scenario: errands, in the file's order.

    Attributes:
        source: the file as messages call it.
        rows: all of them.
    """

    source: str
    rows: tuple[ScenarioRow, ...]


def read_map(path: Path, *, passable: str = PASSABLE) -> GridMap:
    """The map a file holds.

    Args:
        path: of the .map file.
        passable: symbols a robot may stand on; they may be outside `SYMBOLS`.

    Raises:
        WorldError: the file is none, is cut short, or holds a symbol that is not known.
    """
    return parse_map(_text_of(path, "a MovingAI map"), str(path), passable=passable)


def parse_map(text: str, name: str, *, passable: str = PASSABLE) -> GridMap:
    """`read_map` for a text; `name` stands for the file in messages."""
    if not passable:
        raise _error(name, None, "no symbol is passable; name at least one, such as '.'")
    lines = _lines(text)
    width, height = _header(lines, name)
    body = lines[4:]
    if len(body) < height:
        raise _error(
            name,
            len(lines),
            f"the map is cut short: it has {len(body)} rows, its header says height {height}; "
            "get the whole file",
        )
    if len(body) > height:
        raise _error(
            name,
            4 + height + 1,
            f"there are {len(body)} rows, the header says height {height}; "
            "remove what is too much, or mend the header",
        )
    for y, row in enumerate(body):
        if len(row) != width:
            short = "the map is cut short: " if y == height - 1 and len(row) < width else ""
            raise _error(
                name,
                5 + y,
                f"{short}row {y} has {len(row)} symbols, the header says width {width}; "
                "get the whole file, or mend the header",
            )
    known = frozenset(SYMBOLS) | frozenset(passable)
    if not set().union(*body) <= known:
        raise _unknown_symbols(body, known, passable, name)
    cells = np.array([list(row) for row in body]).reshape(height, width)
    free = np.isin(cells, list(passable))
    if not free.any():
        raise _error(
            name, None, f"no cell is passable; passable are {_quoted(passable)}, choose others"
        )
    free.flags.writeable = False
    return GridMap(_base(name), name, free)


def read_scenario(path: Path) -> Scenario:
    """The scenario a file holds; whether it fits a map is `errands`' to say.

    Raises:
        WorldError: the file is none, or rows of it are none, all of them at once.
    """
    return parse_scenario(_text_of(path, "a MovingAI scenario"), str(path))


def parse_scenario(text: str, name: str) -> Scenario:
    """`read_scenario` for a text; `name` stands for the file in messages."""
    lines = _lines(text)
    words = lines[0].split() if lines else []
    if len(words) != 2 or words[0] != "version" or words[1] not in {"1", "1.0"}:
        found = repr(lines[0][:40]) if lines else "nothing"
        raise _error(
            name, 1, f"a scenario begins with the line 'version 1', here is {found}; is it one?"
        )
    rows, wrong = [], []
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        try:
            rows.append(_row(line, number))
        except ValueError as error:
            wrong.append((number, str(error)))
    if wrong:
        raise _errors(name, wrong)
    if not rows:
        raise _error(name, 1, "the scenario has no rows, so no agents")
    return Scenario(name, tuple(rows))


def errands(
    grid: GridMap, scenario: Scenario, agents: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Starts and goals of the first agents of a scenario.

    Args:
        grid: the map.
        scenario: made for that map.
        agents: K, how many of its rows are used.

    Returns:
        Starts (K, 2) and goals (K, 2), int32, read-only, each cell as (x, y).

    Raises:
        WorldError: the scenario has fewer rows, is for another map, or one of the K errands starts
            or ends outside the map, on a blocked cell, or where another one does.
    """
    name = scenario.source
    if agents < 1:
        raise _error(name, None, f"{agents} agents: at least 1 is needed")
    if agents > len(scenario.rows):
        raise _error(
            name,
            None,
            f"{agents} agents are asked for, the scenario has {len(scenario.rows)} rows; "
            f"ask for at most {len(scenario.rows)}, or take another scenario",
        )
    rows = scenario.rows[:agents]
    for row in rows:
        if row.map_name != grid.name or (row.width, row.height) != (grid.width, grid.height):
            raise _error(
                name,
                row.line,
                f"is for the map {row.map_name} of {row.width} x {row.height} cells, "
                f"{grid.source} is {grid.name} of {grid.width} x {grid.height}; "
                "give the scenario made for this map",
            )
    wrong: list[tuple[int, str]] = []
    for end in ("start", "goal"):
        first: dict[Cell, int] = {}
        for row in rows:
            x, y = cell = row.start if end == "start" else row.goal
            if not (0 <= x < grid.width and 0 <= y < grid.height):
                size = f"the map has {grid.width} columns and {grid.height} rows"
                wrong.append((row.line, f"the {end} (x {x}, y {y}) is outside: {size}"))
            elif not grid.passable[y, x]:
                why = f"is blocked in {grid.source} (its row {y}, column {x})"
                wrong.append((row.line, f"the {end} (x {x}, y {y}) {why}; is it the same map?"))
            elif first.setdefault(cell, row.line) != row.line:
                taken = f"is that of line {first[cell]} already"
                rule = "agents need cells of their own; ask for fewer agents"
                wrong.append((row.line, f"the {end} (x {x}, y {y}) {taken}; {rule}"))
    if wrong:
        raise _errors(name, sorted(wrong))
    starts = np.array([row.start for row in rows], np.int32)
    goals = np.array([row.goal for row in rows], np.int32)
    starts.flags.writeable = goals.flags.writeable = False
    return starts, goals


def _lines(text: str) -> list[str]:
    """Lines without their ends; empty ones at the end of the text are dropped."""
    lines = [line.removesuffix("\r") for line in text.split("\n")]
    while lines and not lines[-1]:
        lines.pop()
    return lines


def _header(lines: list[str], name: str) -> tuple[int, int]:
    """(width, height) of the four lines a map begins with."""
    wanted = ("type octile", "height H", "width W", "map")
    values: dict[str, int] = {}
    for number, form in enumerate(wanted, start=1):
        words = lines[number - 1].split() if number <= len(lines) else []
        key = form.split()[0]
        good = bool(words) and words[0] == key and len(words) == len(form.split())
        if good and key in {"height", "width"}:
            good = words[1].isascii() and words[1].isdigit() and len(words[1]) < 8
            values[key] = int(words[1]) if good else 0
            good = values[key] > 0
        elif good and key == "type":
            good = words[1] == "octile"
        if not good:
            found = repr(lines[number - 1][:40]) if number <= len(lines) else "the end of the file"
            whole = " / ".join(wanted)
            raise _error(
                name,
                number,
                f"wrong header: expected '{form}', found {found}; a MovingAI map begins {whole}",
            )
    if values["width"] * values["height"] > MAX_CELLS:
        raise _error(
            name, 2, f"{values['width']} x {values['height']} cells are more than {MAX_CELLS}"
        )
    return values["width"], values["height"]


def _row(line: str, number: int) -> ScenarioRow:
    """One row; ValueError says what is wrong with it."""
    # Fields are separated by tabs, and names of maps may hold spaces; some files use spaces only.
    fields = [f.strip() for f in line.split("\t")] if "\t" in line else line.split()
    if len(fields) != 9:
        raise ValueError(
            f"has {len(fields)} fields instead of 9 (bucket, map, width, height, start x, start y, "
            "goal x, goal y, optimal length)"
        )
    names = ("bucket", "width", "height", "start x", "start y", "goal x", "goal y")
    numbers = []
    for what, text in zip(names, (fields[0], *fields[2:8]), strict=True):
        if not (text.isascii() and text.isdigit() and len(text) < 10):
            raise ValueError(f"{what}: {text[:40]!r} is not a whole number, 0 or more")
        numbers.append(int(text))
    try:
        length = float(fields[8])
    except ValueError:
        length = math.nan
    if not (math.isfinite(length) and length >= 0):
        raise ValueError(f"optimal length: {fields[8][:40]!r} is not a number, 0 or more")
    bucket, width, height, sx, sy, gx, gy = numbers
    return ScenarioRow(number, bucket, _base(fields[1]), width, height, (sx, sy), (gx, gy), length)


def _unknown_symbols(
    body: list[str], known: frozenset[str], passable: str, name: str
) -> WorldError:
    blocked = "".join(s for s in SYMBOLS if s not in passable)
    rule = f"passable are {_quoted(passable)}, blocked {_quoted(blocked)}"
    wrong = [
        (5 + y, f"row {y}, column {x}: unknown symbol {symbol!r}; {rule}")
        for y, row in enumerate(body)
        for x, symbol in enumerate(row)
        if symbol not in known
    ]
    return _errors(name, wrong)


def _quoted(symbols: str) -> str:
    return " ".join(dict.fromkeys(symbols))


def _base(name: str) -> str:
    """A file's name without its folder, whichever way the slashes lean."""
    return name.replace("\\", "/").rsplit("/", 1)[-1]


def _error(name: str, line: int | None, message: str) -> WorldError:
    place = name if line is None else f"{name}:{line}"
    return WorldError([Fault((), message)], [f"{place}: {message}"])


def _errors(name: str, wrong: list[tuple[int, str]]) -> WorldError:
    """Several lines of one file, the first `SHOWN` of them in words."""
    lines = [f"{name}:{line}: {message}" for line, message in wrong[:SHOWN]]
    if len(wrong) > SHOWN:
        lines.append(f"{name}: and {len(wrong) - SHOWN} more of this kind")
    return WorldError([Fault((), message) for _, message in wrong], lines)


def _text_of(path: Path, what: str) -> str:
    name = str(path)
    try:
        if not path.exists():
            raise _error(name, None, "there is no such file; check the path")
        if not path.is_file():
            raise _error(name, None, f"is not a regular file; give {what}")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise _error(name, None, f"has {size / 1e6:.0f} MB, too much for {what}")
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise _error(name, None, f"is not text, so it is not {what}") from error
    except (OSError, ValueError) as error:
        if isinstance(error, WorldError):
            raise
        why = error.strerror if isinstance(error, OSError) else str(error)
        raise _error(name, None, f"cannot be read: {why}; check its rights") from error
