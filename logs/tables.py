"""Records of a log as tables: one numpy array per field, for figures and for one's own analysis.

    run = logs.read("run.mcap")
    loads = run.table(ApLoad)
    loads["load"][loads["ap"] == "ap0"].max()

One row per record, but for `Sample`: there one row per body and instant, its columns `robot`, `ap`
and `link` being indices into `Table.categories` (−1: none). Reading is one pass over the file, and
only the table is kept.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from logs.errors import LogError
from logs.records import LINKS, Record, RunStart, Sample

if TYPE_CHECKING:
    from logs.mcap_reader import RunFile

Column = NDArray[Any]

_DTYPES: Mapping[object, Any] = {float: np.float64, int: np.int32, bool: np.bool_, str: np.object_}
_SAMPLE_DTYPES: Mapping[str, Any] = {
    "slot": np.int32,
    "robot": np.int32,
    "ap": np.int32,
    "link": np.int8,
}


class Table(Mapping[str, Column]):
    """Columns of equal length, by name; read-only.

    Attributes:
        name: of the record type, e.g. `ApLoad`.
        categories: column → what its numbers stand for; columns not named hold values themselves.
    """

    def __init__(
        self,
        name: str,
        columns: Mapping[str, Column],
        categories: Mapping[str, tuple[str, ...]] | None = None,
    ) -> None:
        self.name = name
        self.categories: Mapping[str, tuple[str, ...]] = MappingProxyType(dict(categories or {}))
        for column in columns.values():
            column.flags.writeable = False
        self._columns = dict(columns)

    def __getitem__(self, name: str) -> Column:
        """The column of that name (rows,)."""
        try:
            return self._columns[name]
        except KeyError:
            known = ", ".join(self._columns)
            raise KeyError(f"{self.name} has no field {name!r}; it has {known}") from None

    def __iter__(self) -> Iterator[str]:
        """Names of the columns, in the order of the record's fields."""
        return iter(self._columns)

    def __len__(self) -> int:
        """Number of columns; see `rows`."""
        return len(self._columns)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self._columns.values()), ()))

    def to_numpy(self) -> Column:
        """(rows,) structured array with the columns as fields."""
        kinds = [(name, column.dtype) for name, column in self._columns.items()]
        out = np.empty(self.rows, dtype=kinds)
        for name, column in self._columns.items():
            out[name] = column
        return out

    def to_pandas(self) -> Any:
        """A pandas DataFrame, numbers that stand for names as categories.

        Raises:
            LogError: pandas is not installed.
        """
        try:
            import pandas as pd  # type: ignore[import-untyped,import-not-found,unused-ignore]
        except ImportError as error:
            raise LogError("pandas is not installed; `pip install pandas` for this") from error
        frame = {
            name: pd.Categorical.from_codes(column, list(self.categories[name]))
            if name in self.categories
            else column
            for name, column in self._columns.items()
        }
        return pd.DataFrame(frame)


def table(run: RunFile, record_type: type[Record]) -> Table:
    """All records of one type in a log.

    Raises:
        LogError: the log is damaged.
    """
    if record_type is Sample:
        return _samples(run)
    hints = get_type_hints(record_type)
    names = [field.name for field in fields(record_type)]
    values: list[list[object]] = [[] for _ in names]
    for record in run.iter_records((record_type,)):
        for column, name in zip(values, names, strict=True):
            column.append(getattr(record, name))
    columns = {
        name: _column(column, hints[name]) for name, column in zip(names, values, strict=True)
    }
    return Table(record_type.__name__, columns)


def _column(values: list[object], hint: object) -> Column:
    if hint in _DTYPES:
        return np.array(values, dtype=_DTYPES[hint])
    column = np.empty(len(values), dtype=object)  # of tuples
    column[:] = values
    return column


def _samples(run: RunFile) -> Table:
    names = [field.name for field in fields(Sample)]
    parts: dict[str, list[Column]] = {name: [] for name in names}
    start: RunStart | None = None
    for record in run.iter_records((RunStart, Sample)):
        if isinstance(record, RunStart):
            start = record
        elif isinstance(record, Sample):
            rows = len(record.robot)
            for name in names:
                value = getattr(record, name)
                dtype = _SAMPLE_DTYPES.get(name, np.float64)
                if isinstance(value, tuple):
                    parts[name].append(np.array(value, dtype))
                    if len(value) != rows:
                        raise LogError(f"{run.path}: columns of a sample are not equally long")
                else:
                    parts[name].append(np.full(rows, value, dtype))
    columns = {
        name: np.concatenate([np.empty(0, _SAMPLE_DTYPES.get(name, np.float64)), *arrays])
        for name, arrays in parts.items()
    }
    robots, aps = (start.robots, start.aps) if start is not None else ((), ())
    for name, top in (("robot", len(robots)), ("ap", len(aps)), ("link", len(LINKS))):
        least = -1 if name == "ap" else 0
        if ((columns[name] < least) | (columns[name] >= top)).any():
            raise LogError(f"{run.path}: a sample names a {name} that does not take part")
    return Table(Sample.__name__, columns, {"robot": robots, "ap": aps, "link": LINKS})
