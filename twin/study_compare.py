"""Two studies side by side: what changed from one to the other, variant by variant.

Runs with the same seed are pairs (the same hall, the same errands), so differences are paired; two
studies that share no seed are compared by Welch's interval, which is wider.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from twin.errors import TwinError
from twin.study_kpi import column
from twin.study_run import OK
from twin.study_store import RUNS, Row, read_rows
from twin.study_summary import CONFIDENCE, NOTHING, Estimate, t_interval, wilson_interval


@dataclass(frozen=True)
class Change:
    """One key figure of one variant in both studies.

    Attributes:
        cell: scenario and levels.
        kpi: the figure.
        a, b: its mean in each.
        difference: b less a, with its interval.
        pairs: how many runs with the same seed it is over; 0 if there are none and Welch's
            interval is given.
    """

    cell: tuple[str, ...]
    kpi: str
    a: Estimate
    b: Estimate
    difference: Estimate
    pairs: int


@dataclass(frozen=True)
class Comparison:
    """All that two studies have in common, and what they do not.

    Attributes:
        factors: names of the levels in `Change.cell`, behind the scenario.
        changes: per variant and figure.
        turned: runs of the same variant and seed that succeeded in one study only.
        only_a, only_b: variants that only one of them has.
        kpis_left_out: figures that only one of them has.
    """

    factors: tuple[str, ...]
    changes: tuple[Change, ...]
    turned: tuple[tuple[Row, Row], ...]
    only_a: tuple[tuple[str, ...], ...]
    only_b: tuple[tuple[str, ...], ...]
    kpis_left_out: tuple[str, ...]


def compare(a: Path, b: Path) -> Comparison:
    """Compare the runs.csv of two folders.

    Raises:
        TwinError: one of them holds no study, or they vary different things.
    """
    (head_a, rows_a), (head_b, rows_b) = read_rows(a / RUNS), read_rows(b / RUNS)
    if set(head_a.factors) != set(head_b.factors):
        odd = ", ".join(sorted(set(head_a.factors) ^ set(head_b.factors)))
        raise TwinError(
            f"{a} and {b} vary different things: only one of them has the factors {odd}; compare "
            "studies with the same factors"
        )
    factors = head_a.factors
    cells_a, cells_b = _by_cell(rows_a, factors), _by_cell(rows_b, factors)
    kpis = [k for k in head_a.kpis if k in head_b.kpis]
    changes = []
    turned = []
    for cell, mine in cells_a.items():
        theirs = cells_b.get(cell)
        if theirs is None:
            continue
        changes += [_change(cell, kpi, mine, theirs) for kpi in kpis]
        for seed, row in mine.items():
            other = theirs.get(seed)
            if other is not None and (row.status == OK) != (other.status == OK):
                turned.append((row, other))
    return Comparison(
        factors,
        tuple(changes),
        tuple(turned),
        tuple(cell for cell in cells_a if cell not in cells_b),
        tuple(cell for cell in cells_b if cell not in cells_a),
        tuple(k for k in (*head_a.kpis, *head_b.kpis) if k not in kpis),
    )


Cells = dict[tuple[str, ...], dict[int, Row]]


def _by_cell(rows: Sequence[Row], factors: Sequence[str]) -> Cells:
    """Rows by variant and seed."""
    found: Cells = {}
    for row in rows:
        cell = (row.scenario, *(row.levels[f] for f in factors))
        found.setdefault(cell, {})[row.seed] = row
    return found


def _change(cell: tuple[str, ...], kpi: str, a: dict[int, Row], b: dict[int, Row]) -> Change:
    mine = {seed: float(v) for seed, row in a.items() if (v := row.values.get(kpi)) is not None}
    theirs = {seed: float(v) for seed, row in b.items() if (v := row.values.get(kpi)) is not None}
    estimate = wilson_interval if column(kpi).share else t_interval
    seeds = [seed for seed in mine if seed in theirs]
    if a.keys() & b.keys():
        difference = t_interval([theirs[seed] - mine[seed] for seed in seeds])
    else:
        difference = welch([*mine.values()], [*theirs.values()])
    return Change(
        cell, kpi, estimate([*mine.values()]), estimate([*theirs.values()]), difference, len(seeds)
    )


def welch(a: Sequence[float], b: Sequence[float]) -> Estimate:
    """Mean of b less mean of a, with Welch's interval at 95 % (doi:10.1093/biomet/34.1-2.28)."""
    if not a or not b:
        return NOTHING
    mean_a, mean_b = math.fsum(a) / len(a), math.fsum(b) / len(b)
    mean, n = mean_b - mean_a, len(a) + len(b)
    if min(len(a), len(b)) < 2:
        return Estimate(n, mean, math.nan, math.nan)
    u = math.fsum((v - mean_a) ** 2 for v in a) / (len(a) - 1) / len(a)
    v = math.fsum((w - mean_b) ** 2 for w in b) / (len(b) - 1) / len(b)
    if u + v == 0:
        return Estimate(n, mean, mean, mean)
    from scipy.special import stdtrit

    share = u / (u + v)
    freedom = 1 / (share**2 / (len(a) - 1) + (1 - share) ** 2 / (len(b) - 1))
    half = float(stdtrit(freedom, (1 + CONFIDENCE) / 2)) * math.sqrt(u + v)
    return Estimate(n, mean, mean - half, mean + half)
