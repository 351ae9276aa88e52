"""What the rows of a study say together: means, intervals, differences to the baseline.

- A mean is over the replications of a cell that have the figure; its interval is Student's t at
  95 %. Of figures that are 0 or 1 in each run the mean is a share, and its interval Wilson's, which
  does not shrink to nothing when all runs agree.
- A difference to the baseline is paired: the same replication has the same seeds in both, so it is
  the mean of the differences, with the t-interval of these.
- `[kpi] common` leaves out of all means and differences the replications in which not all the
  levels it names succeeded, except for figures that speak of unsuccessful runs, too.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin.study_grid import Cell, Grid
from twin.study_kpi import Value, column
from twin.study_run import OK
from twin.study_spec import Reference
from twin.study_store import Row

CONFIDENCE = 0.95
SUMMARY_COLUMNS = (
    *("kpi", "runs", "n", "mean", "half_width_95", "low_95", "high_95"),
    *("baseline", "pairs", "difference", "difference_half_width_95"),
)


@dataclass(frozen=True)
class Estimate:
    """A mean and how sure it is.

    Attributes:
        n: how many values it is the mean of.
        mean: NaN without values.
        low, high: ends of the 95 % interval; NaN with fewer than two values.
    """

    n: int
    mean: float
    low: float
    high: float

    @property
    def half_width(self) -> float:
        """Half the length of the interval."""
        return (self.high - self.low) / 2

    @property
    def sure(self) -> bool:
        """Whether 0 lies outside the interval."""
        return self.low > 0 or self.high < 0


NOTHING = Estimate(0, math.nan, math.nan, math.nan)


def t_interval(values: Sequence[float]) -> Estimate:
    """Mean with Student's t-interval at 95 %."""
    n = len(values)
    if n == 0:
        return NOTHING
    mean = math.fsum(values) / n
    if n == 1:
        return Estimate(1, mean, math.nan, math.nan)
    from scipy.special import stdtrit

    spread = math.sqrt(math.fsum((v - mean) ** 2 for v in values) / (n - 1) / n)
    half = float(stdtrit(n - 1, (1 + CONFIDENCE) / 2)) * spread
    return Estimate(n, mean, mean - half, mean + half)


def wilson_interval(values: Sequence[float]) -> Estimate:
    """Share of ones with Wilson's interval at 95 % (Wilson 1927, doi:10.2307/2276774)."""
    n = len(values)
    if n == 0:
        return NOTHING
    share, z = math.fsum(values) / n, 1.959963984540054
    centre = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return Estimate(n, share, max(0.0, centre - half), min(1.0, centre + half))


def jackknife(pairs: Sequence[tuple[float, float]]) -> Estimate:
    """Ratio of sums less 1, with the t-interval of the jackknife over the pairs.

    The ratio of means, not the mean of ratios: a single instance without handovers does not turn
    it into nothing.
    """
    n = len(pairs)
    a, b = np.array(pairs, float).reshape(n, 2).T
    if n == 0 or b.sum() == 0:
        return NOTHING
    whole = float(a.sum() / b.sum() - 1)
    rest = b.sum() - b
    if n == 1 or (rest == 0).any():
        return Estimate(n, whole, math.nan, math.nan)
    from scipy.special import stdtrit

    without = (a.sum() - a) / rest - 1
    spread = math.sqrt((n - 1) / n * float(((without - without.mean()) ** 2).sum()))
    half = float(stdtrit(n - 1, (1 + CONFIDENCE) / 2)) * spread
    return Estimate(n, whole, whole - half, whole + half)


@dataclass(frozen=True)
class Entry:
    """One line of summary.csv.

    Attributes:
        cell: index of the cell.
        kpi: the figure.
        runs: rows of the cell so far.
        value: its mean.
        difference: to the baseline, paired; None if the cell has none.
    """

    cell: int
    kpi: str
    runs: int
    value: Estimate
    difference: Estimate | None


class Results:
    """The rows of a study, by cell and replication."""

    def __init__(self, grid: Grid, rows: Sequence[Row]) -> None:
        self.grid = grid
        self.rows = tuple(rows)
        index = {cell.key: i for i, cell in enumerate(grid.cells)}
        self._row: dict[tuple[int, int], Row] = {
            (index[row.cell], row.replication): row for row in rows if row.cell in index
        }
        self._relative = grid.study.kpi.relative
        common = grid.study.kpi.common
        self._partners = [self._common_partners(cell, common) for cell in grid.cells]

    def _common_partners(self, cell: Cell, common: Mapping[str, Sequence[object]]) -> list[int]:
        """Cells that must have succeeded for one of this cell's rows to count."""
        partners = []
        for factor, levels in common.items():
            found = [self.grid.other(cell, {factor: level}) for level in levels]
            partners += [i for i in found if i is not None]
        return partners

    def row(self, cell: int, replication: int) -> Row | None:
        """A cell's row of a replication, if it is there."""
        return self._row.get((cell, replication))

    def replications(self) -> range:
        """All replications of the study."""
        return range(self.grid.study.study.replications)

    def value(self, cell: int, replication: int, kpi: str) -> Value:
        """A figure that counts: None if it is not there, or left out by `[kpi] common`."""
        row = self._row.get((cell, replication))
        if row is None:
            return None
        if not column(kpi).of_all and not all(
            (partner := self._row.get((i, replication))) is not None and partner.status == OK
            for i in self._partners[cell]
        ):
            return None
        if kpi not in self._relative:
            figure = row.values.get(kpi)
            # Sums of seconds differ in their last digits; that is no spread between runs.
            return float(f"{figure:.12g}") if isinstance(figure, float) else figure
        wanted = self._relative[kpi]
        other = self.grid.other(self.grid.cells[cell], wanted.of)
        partner = None if other is None else self._row.get((other, replication))
        above = row.values.get(wanted.kpi)
        below = None if partner is None else partner.values.get(wanted.to or wanted.kpi)
        return None if above is None or not below else above / below

    def values(self, cell: int, kpi: str) -> list[float]:
        """All figures of a cell that count."""
        found = (self.value(cell, k, kpi) for k in self.replications())
        return [float(v) for v in found if v is not None]

    def estimate(self, cells: Sequence[int], kpi: str) -> Estimate:
        """Mean over all runs of some cells, with its interval.

        Over several cells the replications are what is independent: the interval is that of the
        means of each replication.
        """
        share = column(kpi).share
        if len(cells) == 1:
            values = self.values(cells[0], kpi)
            return wilson_interval(values) if share else t_interval(values)
        every: list[float] = []
        means = []
        for k in self.replications():
            found = [float(v) for c in cells if (v := self.value(c, k, kpi)) is not None]
            every += found
            means += [math.fsum(found) / len(found)] if found else []
        if not every:
            return NOTHING
        pooled = t_interval(means)
        mean = math.fsum(every) / len(every)
        low, high = mean - pooled.half_width, mean + pooled.half_width
        if share:
            low, high = max(0.0, low), min(1.0, high)
        return Estimate(len(every), mean, low, high)

    def difference(self, cell: int, other: int, kpi: str) -> Estimate:
        """Mean of a cell's figure less another's in the same replication."""
        found = []
        for k in self.replications():
            mine, theirs = self.value(cell, k, kpi), self.value(other, k, kpi)
            if mine is not None and theirs is not None:
                found.append(float(mine) - float(theirs))
        return t_interval(found)

    def summary(self) -> list[Entry]:
        """Every cell and figure."""
        entries = []
        for i, cell in enumerate(self.grid.cells):
            runs = sum((i, k) in self._row for k in self.replications())
            for kpi in self.grid.study.shown:
                base = cell.baseline
                difference = None if base is None else self.difference(i, base, kpi)
                entries.append(Entry(i, kpi, runs, self.estimate([i], kpi), difference))
        return entries

    def reference(self, reference: Reference) -> Estimate:
        """What is measured here for a figure printed elsewhere."""
        cells = [i for i, c in enumerate(self.grid.cells) if c.matches(reference.where)]
        if reference.against is None:
            return self.estimate(cells, reference.kpi)
        by_replication = []
        for k in self.replications():
            pairs = []
            for i in cells:
                other = self.grid.other(self.grid.cells[i], reference.against)
                mine = self.value(i, k, reference.kpi)
                theirs = None if other is None else self.value(other, k, reference.kpi)
                if mine is not None and theirs is not None:
                    pairs.append((float(mine), float(theirs)))
            if pairs:
                a, b = zip(*pairs, strict=True)
                by_replication.append((math.fsum(a), math.fsum(b)))
        return jackknife(by_replication)

    def statuses(self) -> dict[str, int]:
        """How many runs ended how."""
        found: dict[str, int] = {}
        for row in self.rows:
            found[row.status] = found.get(row.status, 0) + 1
        return dict(sorted(found.items(), key=lambda item: (item[0] != OK, item[0])))


def summary_csv(results: Results) -> bytes:
    """summary.csv: one line per cell and figure."""
    grid = results.grid
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["scenario", *grid.factors, *SUMMARY_COLUMNS])
    for entry in results.summary():
        cell, value = grid.cells[entry.cell], entry.value
        fields: list[object] = [*cell.key, entry.kpi, entry.runs, value.n]
        fields += [shown(v) for v in (value.mean, value.half_width, value.low, value.high)]
        if entry.difference is None or cell.baseline is None:
            fields += ["", "", "", ""]
        else:
            base, d = grid.cells[cell.baseline], entry.difference
            fields += [cell_name(base, cell), d.n, shown(d.mean), shown(d.half_width)]
        writer.writerow(fields)
    return text.getvalue().encode()


def shown(value: float, digits: Callable[[float], str] = "{:.9g}".format) -> str:
    """A number for a table; nothing for NaN."""
    return "" if math.isnan(value) else digits(value)


def cell_name(cell: Cell, beside: Cell | None = None) -> str:
    """Scenario and levels in words; only what differs from the cell it stands beside."""
    parts = [] if beside is not None and beside.scenario == cell.scenario else [cell.scenario]
    for factor, level in cell.levels.items():
        if beside is None or beside.levels[factor] != level:
            parts.append(f"{factor} = {level}")
    return ", ".join(parts)
