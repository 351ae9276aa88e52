"""Radio measurements as a table: `x,y,ap,snr_db` or `x,y,ap,rssi_dbm`, many rows per place.

The first line names the columns, in any order; further columns are passed over. Fields are parted
by commas or by semicolons; with semicolons a decimal comma is understood, too. Blank lines and
lines that begin with # are skipped. Lines in messages count from 1.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from worlds.errors import WorldError
from worlds.formats.json_file import SHOWN, file_error, listed_error, read_text
from worlds.part import nearest

WHAT = "a table of radio measurements"
MAX_ROWS = 1_000_000
SNR_RANGE_DB = (-25.0, 110.0)
RSSI_RANGE_DBM = (-150.0, 10.0)
"""What radios measure; values beyond are of another quantity or unit."""

_PLACES = {"x": "x", "x_m": "x", "y": "y", "y_m": "y", "ap": "ap", "ap_id": "ap"}
_VALUES = ("snr_db", "rssi_dbm")
_SHIFT_M = 5.0  # beyond the walls


@dataclass(frozen=True, eq=False)
class Survey:
    """Measurements, one row each.

    Attributes:
        ap_ids: (A,) of the world, in its order.
        xy_m: (n, 2) where [m].
        ap: (n,) int32, index into `ap_ids`.
        snr_db: (n,) what [dB].
    """

    ap_ids: tuple[str, ...]
    xy_m: NDArray[np.float64]
    ap: NDArray[np.int32]
    snr_db: NDArray[np.float64]

    def __len__(self) -> int:
        """Number of measurements."""
        return len(self.ap)


def read_survey(
    path: Path, ap_ids: Sequence[str], noise_dbm: float, size_m: tuple[float, float] | None = None
) -> Survey:
    """The measurements a file holds; see `parse_survey`."""
    return parse_survey(read_text(path, WHAT), str(path), ap_ids, noise_dbm, size_m)


def parse_survey(
    text: str,
    name: str,
    ap_ids: Sequence[str],
    noise_dbm: float,
    size_m: tuple[float, float] | None = None,
) -> Survey:
    """The measurements in a text.

    Args:
        text: of the file.
        name: what the file is called in messages.
        ap_ids: that the world knows.
        noise_dbm: what is taken from an RSSI to get the SNR [dBm].
        size_m: of the hall; places far outside are refused.

    Raises:
        WorldError: with the rows that are none, each with its line.
    """
    lines = text.splitlines()
    rows = [(number, line) for number, line in enumerate(lines, start=1) if _counts(line)]
    if not rows:
        raise file_error(name, "is empty; give a line with x,y,ap,snr_db and measurements below")
    if len(rows) > MAX_ROWS + 1:
        rule = f"has {len(rows) - 1} rows, at most {MAX_ROWS} are read"
        raise file_error(name, f"{rule}; thin them out")
    number, head = rows[0]
    separator = ";" if head.count(";") > head.count(",") else ","
    columns, is_rssi = _columns(_cells(head, separator, f"{name}:{number}"), f"{name}:{number}")
    wrong: list[tuple[str, str]] = []
    index = {ap: k for k, ap in enumerate(ap_ids)}
    found: list[tuple[float, float, int, float]] = []
    for number, line in rows[1:]:
        try:
            cells = _cells(line, separator, f"{name}:{number}")
            found.append(_row(cells, columns, is_rssi, separator, index, size_m))
        except WorldError:
            wrong.append((str(number), "is no line of a table; check its quotes"))
        except ValueError as error:
            wrong.append((str(number), str(error)))
    if wrong:
        shown = [(f"line {at}", why) for at, why in wrong]
        raise _located(name, shown)
    if not found:
        raise file_error(name, "has a heading, but no measurements")
    table = np.array([row[:2] for row in found], dtype=np.float64).reshape(-1, 2)
    ap = np.array([row[2] for row in found], dtype=np.int32)
    value = np.array([row[3] for row in found], dtype=np.float64)
    if is_rssi:
        value = value - noise_dbm
    for array in (table, ap, value):
        array.flags.writeable = False
    return Survey(tuple(ap_ids), table, ap, value)


def _located(name: str, found: list[tuple[str, str]]) -> WorldError:
    error = listed_error(name, found)
    lines = [line.replace(f"{name}: line ", f"{name}:", 1) for line in error.lines]
    if len(found) > SHOWN:
        lines[-1] = f"{name}: and {len(found) - SHOWN} more lines"
    return WorldError(list(error.faults), lines)


def _counts(line: str) -> bool:
    stripped = line.strip()
    return bool(stripped) and not stripped.startswith("#")


def _cells(line: str, separator: str, place: str) -> list[str]:
    try:
        rows: Iterator[list[str]] = csv.reader(
            io.StringIO(line), delimiter=separator, skipinitialspace=True, strict=True
        )
        return [cell.strip() for cell in next(rows)]
    except (csv.Error, StopIteration) as error:
        raise file_error(place, f"is no line of a table: {error}") from error


def _columns(head: list[str], place: str) -> tuple[dict[str, int], bool]:
    """Where each quantity stands, and whether the values are RSSIs."""
    names = [cell.lower() for cell in head]
    columns: dict[str, int] = {}
    for k, cell in enumerate(names):
        key = _PLACES.get(cell, cell if cell in _VALUES else "")
        if not key:
            continue
        if key in columns:
            raise file_error(place, f"the column {key} stands twice; keep one")
        columns[key] = k
    values = [key for key in _VALUES if key in columns]
    if len(values) == 2:
        raise file_error(place, "has both snr_db and rssi_dbm; keep the one that was measured")
    missing = [key for key in ("x", "y", "ap") if key not in columns]
    if not values:
        missing.append("snr_db or rssi_dbm")
    if missing:
        units = next((n for n in names if n in {"x_mm", "y_mm", "x_cm", "y_cm"}), "")
        if units:
            raise file_error(place, f"column {units}: give metres, in columns x and y")
        hints = [nearest(n, (*_PLACES, *_VALUES)) for n in names]
        hint = next((f"; in '{n}'{h}" for n, h in zip(names, hints, strict=True)
                     if h and n not in _PLACES and n not in _VALUES), "")  # fmt: skip
        said = f"there is no column {', '.join(missing)}"
        raise file_error(place, f"{said}; the first line must be like x,y,ap,snr_db{hint}")
    return columns, values == ["rssi_dbm"]


def _row(
    cells: list[str],
    columns: dict[str, int],
    is_rssi: bool,
    separator: str,
    index: dict[str, int],
    size_m: tuple[float, float] | None,
) -> tuple[float, float, int, float]:
    """x, y [m], AP and value of a line; ValueError with what is wrong."""
    last = max(columns.values())
    if len(cells) <= last:
        raise ValueError(f"has {len(cells)} fields, the heading asks for {last + 1}")
    name = cells[columns["ap"]]
    if name not in index:
        known = list(index)
        hint = nearest(name, known) or f" known are {', '.join(known[:8])}"
        raise ValueError(f"'{name}' is not an access point of the world;{hint}")
    x, y = (_number(cells[columns[key]], key, separator) for key in ("x", "y"))
    if size_m is not None:
        for key, value, size in (("x", x, size_m[0]), ("y", y, size_m[1])):
            if not -_SHIFT_M <= value <= size + _SHIFT_M:
                mm = 0 <= value / 1000 <= size and value >= 100
                hint = "; millimetres?" if mm else "; is its origin another one?"
                raise ValueError(f"{key} = {value:g} m is outside the hall of {size:g} m{hint}")
    key = "rssi_dbm" if is_rssi else "snr_db"
    value = _number(cells[columns[key]], key, separator)
    low, high = RSSI_RANGE_DBM if is_rssi else SNR_RANGE_DB
    if not low <= value <= high:
        if is_rssi:
            hint = "an RSSI is in dBm, mostly -100 to -30"
        else:
            hint = "an SNR is in dB, mostly 0 to 50; an RSSI belongs in a column rssi_dbm"
        raise ValueError(f"{key} = {value:g} is outside {low:g} to {high:g}; {hint}")
    return x, y, index[name], value


def _number(cell: str, key: str, separator: str) -> float:
    text = cell.replace(",", ".") if separator == ";" and cell.count(",") == 1 else cell
    try:
        value = float(text)
    except ValueError:
        value = math.nan
        if not cell:
            raise ValueError(f"{key} is missing") from None
        if cell.lower().strip("+-") not in {"nan", "inf", "infinity"}:
            raise ValueError(f"{key} = '{cell[:20]}' is not a number") from None
    if not math.isfinite(value):
        raise ValueError(f"{key} is {cell}; leave out rows without a measurement")
    return value
