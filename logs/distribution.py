"""A weighted distribution that grows and can be asked for its 10th percentile at any time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_SHARE = 0.1  # of P10
_ROUNDING = 1e-9  # relative; so that sums in another order give the same percentile
_RECENT = 1 << 14  # values that are sorted anew at each question


class Distribution:
    """Values with weights, e.g. rates and the seconds spent at them.

    P10 is the least value such that the values up to it hold at least 10 % of the total weight.
    Most values rest in a sorted part with its running sum; only those added last are sorted at a
    question. So a question costs O(log n), not O(n), which matters to a figure asked in every slot.
    """

    def __init__(self) -> None:
        self._settled = self._recent = (np.empty(0), np.empty(0))  # values ascending, weights
        self._settled_sum = np.empty(0)
        self._new: list[tuple[Floats, Floats]] = []

    def add(self, values: Floats, weights: Floats) -> None:
        """Add `values` (n,) with `weights` (n,); those of weight 0 count for nothing."""
        some = weights > 0
        self._new.append((values[some], weights[some]))

    def percentile_10(self) -> float:
        """P10 of all that was added, 0 if nothing was."""
        self._sort()
        (settled, _), (recent, weights) = self._settled, self._recent
        above, recent_sum = self._settled_sum, np.cumsum(weights)
        total = sum(float(s[-1]) for s in (above, recent_sum) if len(s))
        if not total:
            return 0.0
        least = (_SHARE - _ROUNDING) * total
        # The first recent value that reaches it together with the settled ones up to that value...
        k, end = 0, len(recent)
        while k < end:
            middle = (k + end) // 2
            i = int(np.searchsorted(settled, recent[middle], side="right"))
            if recent_sum[middle] + (above[i - 1] if i else 0.0) < least:
                k = middle + 1
            else:
                end = middle
        # ... unless a settled one before it does, with the k recent values below.
        i = int(np.searchsorted(above, least - (recent_sum[k - 1] if k else 0.0)))
        candidates = [float(a[j]) for a, j in ((recent, k), (settled, i)) if j < len(a)]
        return min(candidates)

    def _sort(self) -> None:
        """Take in what is new."""
        if not self._new:
            return
        values, weights = (
            np.concatenate(column) for column in zip(self._recent, *self._new, strict=True)
        )
        self._new.clear()
        order = np.argsort(values, kind="stable")
        self._recent = values[order], weights[order]
        if len(order) > _RECENT:
            place = np.searchsorted(self._settled[0], self._recent[0])
            self._settled = (
                np.insert(self._settled[0], place, self._recent[0]),
                np.insert(self._settled[1], place, self._recent[1]),
            )
            self._settled_sum = np.cumsum(self._settled[1])
            self._recent = np.empty(0), np.empty(0)
