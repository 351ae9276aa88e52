"""The key `prices` of a plan.json ⇄ `Prices`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planner.json_document import Document
from planner.prices import Prices
from planner.problem import Problem
from planner.validation import Key

KEY: Key = ("prices",)


def parse_prices(document: Document, value: object, problem: Problem) -> Prices | None:
    """The prices at `$.prices`, None where they are unusable (a fault, then, in `document`)."""
    before = len(document.faults)
    given = document.mapping(
        value, KEY, ("vertices", "edges", "aps"), ("aps_by_slot", "bound", "advice")
    )
    vertex = _numbers(document, given, "vertices", problem.n_vertices)
    edge = _numbers(document, given, "edges", problem.n_edges)
    ap = _numbers(document, given, "aps", problem.n_aps)
    slots = problem.horizon + 1
    by_slot = np.zeros((slots, problem.n_aps))
    key: Key = (*KEY, "aps_by_slot")
    if "aps_by_slot" in given:
        rows = document.array(given["aps_by_slot"], key, "rows, one per slot")
        if rows and len(rows) != slots:
            document.fault(key, len(rows), f"must have {slots} rows, one per slot 0 … T")
        for t, row in enumerate(rows[:slots]):
            by_slot[t] = _row(document, row, (*key, t), problem.n_aps)
    elif ap.any():
        # Another writer may tell the sums alone; when they arise is unknown then.
        by_slot[0] = ap
    bound = document.number(given.get("bound", 0.0), (*KEY, "bound"))
    advice = document.string(given.get("advice", ""), (*KEY, "advice"))
    if len(document.faults) == before:
        for a, (said, summed) in enumerate(zip(ap, by_slot.sum(axis=0), strict=True)):
            if not math.isclose(said, summed, rel_tol=1e-6, abs_tol=1e-6):
                text = f"aps_by_slot sums up to {summed:.10g}; correct one of the two"
                document.fault((*KEY, "aps", a), float(said), text)
    if len(document.faults) > before or bound is None or advice is None:
        return None
    return Prices(vertex, edge, by_slot, bound, problem.c_t, advice)


def prices_values(prices: Prices) -> dict[str, object]:
    """The value of `$.prices`: in cost units, zeros and other integers without a point."""
    return {
        "vertices": _short(prices.vertex),
        "edges": _short(prices.edge),
        "aps": _short(prices.ap),
        "aps_by_slot": [_short(row) for row in prices.ap_by_slot],
        "bound": prices.bound,
        "advice": prices.advice,
    }


def _short(row: NDArray[np.float64]) -> list[float]:
    return [int(x) if x.is_integer() else x for x in row.tolist()]


def _numbers(
    document: Document, given: dict[str, object], name: str, count: int
) -> NDArray[np.float64]:
    return _row(document, given.get(name, [0.0] * count), (*KEY, name), count)


def _row(document: Document, value: object, key: Key, count: int) -> NDArray[np.float64]:
    """(count,) prices ≥ 0; zeros, and faults in `document`, for what is none."""
    row = np.zeros(count)
    values = document.array(value, key, "numbers")
    if isinstance(value, list) and len(values) != count:
        document.fault(key, len(values), f"must have {count} entries, as many as the problem has")
    for k, entry in enumerate(values[:count]):
        number = document.number(entry, (*key, k))
        if number is not None and number < 0:
            document.fault((*key, k), entry, "a price is never negative")
        row[k] = number or 0.0
    return row
