"""Links in a run in which nothing can disturb the radio: measured many slots ahead.

Where nothing moves but robots that block nobody, what a robot experiences in a transition of its
plan is known before it makes it: place, AP and instant of each sample are the plan's, the scene is
what it is. So the samples of the next transitions of all robots are taken together, each at its own
place by a ray of its own. A robot that does not make its transition stands; it is measured where it
does when it first does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from twin.association import Association, Instants, Prediction
    from twin.motion import Roads, SlotMotion
    from twin.order import VisitOrder
    from worlds.link import LinkModel
    from worlds.scene import Scene

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Columns = tuple[Ints, Floats, Floats]
"""AP, SNR experienced and SNR predicted [dB], each (n, steps)."""

AHEAD = 32
"""Transitions of a robot that are measured together."""


@dataclass(frozen=True, slots=True)
class _Store:
    """What is known of each robot: of `length` states from one on.

    Attributes:
        first: (N,) the first of these states, a negative number if nothing is known.
        columns: (N, length, steps) each.
    """

    first: NDArray[np.int64]
    columns: Columns

    @classmethod
    def empty(cls, robots: int, length: int, steps: int) -> _Store:
        """Nothing is known yet."""
        shape = (robots, length, steps)
        columns = (np.zeros(shape, np.int32), np.zeros(shape), np.zeros(shape))
        return cls(np.full(robots, -length, np.int64), columns)


class PlannedLinks:
    """AP and SNR of robots that execute a plan undisturbed."""

    def __init__(
        self,
        model: LinkModel,
        prediction: Prediction,
        order: VisitOrder,
        association: Association,
        roads: Roads,
        instants: Instants,
        scene: Scene,
    ) -> None:
        self._model, self._prediction = model, prediction
        self._order, self._association, self._roads = order, association, roads
        self._fractions, self._scene = instants.fractions, scene
        robots, steps = len(order.arrival), instants.steps
        self._moving = _Store.empty(robots, AHEAD, steps)
        self._standing = _Store.empty(robots, 1, steps)

    def of(self, motion: SlotMotion, advances: Bools) -> Columns:
        """The links of a slot's n bodies, of which those of `advances` make their transitions."""
        state = motion.row - self._order.first_row[motion.robot]
        if advances.all():
            return self._from(self._moving, motion.robot, state)
        shape = (len(state), len(self._fractions))
        found = (np.empty(shape, np.int32), np.empty(shape), np.empty(shape))
        for store, of in ((self._moving, advances), (self._standing, ~advances)):
            part = self._from(store, motion.robot[of], state[of])
            found[0][of], found[1][of], found[2][of] = part
        return found

    def _from(self, store: _Store, robot: Ints, state: Ints) -> Columns:
        """What is known of robots in these states; measured now if it is not."""
        length = store.columns[0].shape[1]
        at = state - store.first[robot]
        unknown = (at < 0) | (at >= length)
        if unknown.any():
            self._fill(store, robot[unknown], state[unknown])
            at = state - store.first[robot]
        ap, snr, predicted = store.columns
        return ap[robot, at], snr[robot, at], predicted[robot, at]

    def _fill(self, store: _Store, robot: Ints, state: Ints) -> None:
        """Measure robots in these states and as many later ones as there is room for."""
        length = store.columns[0].shape[1]
        store.first[robot] = state
        left = np.minimum(self._order.arrival[robot] - state + 1, length)
        each = np.repeat(np.arange(len(robot)), left)
        ahead = np.arange(len(each)) - np.repeat(np.cumsum(left) - left, left)
        row = self._order.first_row[robot[each]] + state[each] + ahead
        measured = self._measure(
            robot[each],
            row.astype(np.int32),
            (state[each] + ahead).astype(np.int32),
            np.full(len(each), store is self._moving),
        )
        at = robot[each], ahead
        store.columns[0][at], store.columns[1][at], store.columns[2][at] = measured

    def _measure(self, robot: Ints, row: Ints, at: Ints, advances: Bools) -> Columns:
        """The links of transitions, each from one row of the visit order."""
        motion, association = self._roads.along(robot, row, at, advances), self._association
        steps = np.arange(len(self._fractions))
        step = np.where(advances, association.step[row], 0)
        changed = (step > 0)[:, None] & (steps >= step[:, None])
        ap = np.where(changed, association.to[row, None], association.serves[row, None])
        ap = ap.astype(np.int32)
        place = (motion.edge, motion.fraction(self._fractions), motion.vertex)
        predicted = self._prediction.snr_db(*place, ap)
        fading = self._prediction.fading_db(*place, ap)
        # One ray tells all of a robot that stands.
        moves = motion.begin != motion.end
        ask = moves[:, None] | (steps == 0) | (steps == step[:, None])
        antenna = self._model.antenna_m(motion.xy_m(self._fractions)[ask])
        snr = np.zeros(ap.shape)
        snr[ask] = self._snr_db(ap[ask], antenna, fading[ask])
        asked = np.maximum.accumulate(np.where(ask, steps, 0), axis=1)
        return ap, np.take_along_axis(snr, asked, axis=1), predicted

    def _snr_db(self, ap: Ints, antenna_m: Floats, fading_db: Floats) -> Floats:
        """(m,) SNR from an AP each; one ray to each place tells it for all robots that pass."""
        if not len(ap):
            return np.zeros(0)
        order = np.lexsort((antenna_m[:, 1], antenna_m[:, 0], ap))
        links = np.column_stack([ap, antenna_m[:, :2]])[order]
        new = np.append(True, (links[1:] != links[:-1]).any(axis=1))
        ray = np.empty(len(ap), np.intp)
        ray[order] = np.cumsum(new) - 1
        asked = order[new]
        sight = self._model.look(self._scene, ap[asked], antenna_m[asked])
        return self._model.snr_db(ap, antenna_m, sight.free[ray], fading_db, sight.blockage_db[ray])
