"""Step 3 of validation, when the paths in force change their APs: found anew from map and problem.

A handover of a path may be made at any instant of the slots its crossing takes but the first; of a
waiting robot, or where only a part of the crossing is left, of the slot that ends with the change.
The instant must be the one that leaves the fewest instants of this time below the threshold by the
radio map; of several that in the last slot (§1.6); then those from which the new AP covers all that
is left; then the earliest (docs/execution.md). A path that begins amid a crossing may find its
handover made: then the AP it has at the end serves already.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.validate_context import Bools, Context, Ints
from logs.validate_itinerary import Walk
from logs.validate_snr import MapValues

_CLOSE_DB = 1e-9


@dataclass(frozen=True)
class Serving:
    """The APs of one path, transition by transition; arrays (τ + 1,).

    Attributes:
        first: AP at the beginning of the slot in which the transition is made.
        step: instant (1 … steps) of that slot at which it changes, 0 if it does not.
        then: AP from there on.
        sure: False where an SNR of the map is the threshold, to all digits: then another instant
            is as good.
    """

    first: Ints
    step: Ints
    then: Ints
    sure: Bools


class PlannedServing:
    """The APs that the paths in force have for each robot at each instant."""

    def __init__(self, context: Context) -> None:
        self._context, self._map = context, MapValues(context)
        self._known: dict[int, tuple[Walk, Serving]] = {}
        self._begins: dict[int, int] = {}

    def begin(self, i: int, ap: int) -> None:
        """Robot i gets a new path; `ap` serves it then (−1: none)."""
        self._begins[i] = ap

    def of(self, i: int) -> Serving | None:
        """Of robot i's path; None if it has none."""
        walk = self._context.itinerary.walks[i]
        if walk is None:
            return None
        known = self._known.get(i)
        if known is None or known[0] is not walk:
            known = self._known[i] = walk, self._find(walk, self._begins.get(i, -1))
        return known[1]

    def _find(self, walk: Walk, now: int) -> Serving:
        first, then = walk.ap.copy(), walk.ap.copy()
        step, sure = np.zeros(len(first), np.int64), np.ones(len(first), np.bool_)
        edge_slots = self._context.inputs.problem.edge_slots
        for last in np.flatnonzero(np.diff(walk.ap)).tolist():
            edge, piece = int(walk.edge[last]), int(walk.piece[last])
            slots = int(edge_slots[edge]) if edge >= 0 else 1
            begin = last - piece
            if begin < 0 and walk.ap[last + 1] == now:  # made in the part that is over
                first[: last + 1] = then[: last + 1] = now
                continue
            whole = piece == slots - 1 and begin >= 0 and bool(
                (walk.ap[begin:last] == walk.ap[last]).all()
            )  # fmt: skip
            length = slots if whole else 1
            instant, is_sure = self._instant(walk, last, length, slots)
            row = last - length + 1 + (instant - 1) // self._context.steps
            step[row] = (instant - 1) % self._context.steps + 1
            then[row : last + 1] = walk.ap[last + 1]
            first[row + 1 : last + 1] = walk.ap[last + 1]
            sure[last - length + 1 : last + 1] &= is_sure
        return Serving(first, step, then, sure)

    def _instant(self, walk: Walk, last: int, length: int, slots: int) -> tuple[int, bool]:
        """The instant of a handover, counted from 1 on in its `length` slots; if it is sure."""
        steps, count = self._context.steps, length * self._context.steps
        passed = (int(walk.piece[last]) - length + 1) * steps
        share = (passed + np.arange(count + 1)) / (slots * steps)
        vertex, edge = (np.full(count + 1, c[last]) for c in (walk.vertex, walk.edge))
        threshold = self._context.inputs.radio_map.threshold_db
        old, new = (
            self._map.snr_db(vertex, edge, share, np.full(count + 1, ap)) - threshold
            for ap in walk.ap[last : last + 2].tolist()
        )
        before, after = (old < 0.0).tolist(), (new < 0.0).tolist()
        candidates = range(1, count + 1)
        chosen = min(
            candidates,
            key=lambda m: (
                sum(before[:m]) + sum(after[m:]),
                m <= count - steps,
                any(after[m:]),
                m,
            ),
        )
        close = np.abs(np.concatenate([old, new])) < _CLOSE_DB
        return chosen, not close.any()
