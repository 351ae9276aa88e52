"""Step 3 of validation, SNRs: computed anew by rays in a fresh scene, and read from the radio map.

A ray for each place, the channel's formulas, and the fading of the radio map. Where nothing moves,
rays are cast in the end, each once per place; where something does, sample by sample, with all that
moves in its place.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from logs.validate_context import DECIBELS, STEP, Context, Floats, Ints, SlotView
from logs.validate_disturbances import DisturbanceCheck, Truth
from logs.validate_scene import Bodies
from worlds.link import LinkModel

if TYPE_CHECKING:
    from worlds.scene import Scene

RULE = "page5:snr"
NO_SNR_DB = -1000.0
"""SNR, experienced and predicted, of a robot that no AP serves [dB]."""
_ENTRIES_AT_ONCE = 100_000


class MapValues:
    """What the radio map says of places along the problem's edges and at its vertices."""

    def __init__(self, context: Context) -> None:
        self._map, self._floor = context.inputs.radio_map, context.inputs.floor
        self._vertex, self._edge = context.floor_vertex, context.floor_edge
        self._from = context.inputs.problem.edge_uv[:, 0].astype(np.int64)

    def snr_db(self, vertex: Ints, edge: Ints, share: Floats, ap: Ints) -> Floats:
        """(n,) SNR, linear between the map's samples of an edge [dB].

        Args:
            vertex: (n,) of the problem, left last.
            edge: (n,) of the problem, −1 at the vertex.
            share: (n,) of the way along the edge, from `vertex` on.
            ap: (n,).
        """
        table = self._map.edge_snr_db
        found = self._map.snr_db[self._vertex[vertex], ap]
        on, on_floor, from_u = self._along(vertex, edge, share)
        gaps = table.shape[1] - 1
        low = np.minimum((from_u * gaps).astype(np.int64), gaps - 1)
        part = from_u * gaps - low
        rows, k = table[on_floor, :, ap[on]], np.arange(len(on))
        found[on] = (1.0 - part) * rows[k, low] + part * rows[k, low + 1]
        return found

    def fading_db(self, vertex: Ints, edge: Ints, share: Floats, ap: Ints) -> Floats:
        """(n,) fading as a gain, linear along an edge [dB]; arguments as above."""
        found = self._map.fading_db[self._vertex[vertex], ap]
        on, on_floor, from_u = self._along(vertex, edge, share)
        u, v = self._floor.edge_uv[on_floor].T
        at_u, at_v = self._map.fading_db[u, ap[on]], self._map.fading_db[v, ap[on]]
        found[on] = (1.0 - from_u) * at_u + from_u * at_v
        return found

    def _along(self, vertex: Ints, edge: Ints, share: Floats) -> tuple[Ints, Ints, Floats]:
        """Which are on an edge, that edge of the floor, and the share of the way from its u."""
        on = np.flatnonzero(edge >= 0)
        ahead = self._from[edge[on]] == vertex[on]
        return on, self._edge[edge[on]], np.where(ahead, share[on], 1.0 - share[on])


class SnrCheck:
    """Compares SNRs told with those computed anew."""

    def __init__(
        self, context: Context, scene: Scene, truth: Truth, disturbances: DisturbanceCheck
    ) -> None:
        self._context, self._scene = context, scene
        self.map = MapValues(context)
        self._bodies = Bodies(context, scene, truth, disturbances)
        self._links = LinkModel(context.inputs.world)
        self._queue: list[tuple[int, Ints, Ints, Floats]] = []
        self._queued = 0

    def place(self, robot: Ints, xy_m: Floats, heading_rad: Floats) -> None:
        """Put into the scene what is there at a sample; (n,), (n, 2) [m], (n,) [rad]."""
        if self._bodies.needed:
            self._bodies.place(robot, xy_m, heading_rad)

    def heard_db(self, robot: Ints, xy_m: Floats, fading_db: Floats) -> Floats:
        """(n, A) SNR from every AP to robots (n,) at (n, 2) with fading (n, A), as placed [dB]."""
        n, aps = fading_db.shape
        ap = np.tile(np.arange(aps), n)
        who = np.repeat(robot, aps).tolist()
        snr = self._bodies.snr_db(who, ap, np.repeat(xy_m, aps, axis=0), fading_db.ravel())
        return np.asarray(snr.reshape(n, aps))

    def check(
        self,
        view: SlotView,
        there: Ints,
        share: Floats,
        ap: Ints,
        xy_m: Floats,
        snr_db: Floats,
        predicted_db: Floats,
        when: str,
    ) -> None:
        """Compare the SNRs of a sample's n robots, experienced and predicted.

        Args:
            view: of the slot.
            there: (n,) their places in the view.
            share: (n,) of the way along their edges.
            ap: (n,) that serves, −1 for none.
            xy_m: (n, 2).
            snr_db, predicted_db: (n,) as told.
            when: the sample, in messages.
        """
        context, slot, robot = self._context, view.slot, view.robot[there]
        nothing = (ap < 0) & ((snr_db != NO_SNR_DB) | (predicted_db != NO_SNR_DB))
        silent = np.full(len(ap), NO_SNR_DB)
        context.each(RULE, slot, robot, nothing, f"{when} without an AP, SNR [dB]", snr_db, silent)
        place = (view.vertex[there], view.edge[there], share, ap)
        expected = self.map.snr_db(*place)
        off = ~(np.abs(predicted_db - expected) <= DECIBELS) & (ap >= 0)
        what = "SNR of the radio map [dB]"
        context.each(RULE, slot, robot, off, what, predicted_db, expected)
        served = ap >= 0
        entries = np.column_stack([xy_m, self.map.fading_db(*place), snr_db])[served]
        if self._bodies.needed:
            self._compare_now(slot, robot[served], ap[served], entries)
        elif len(entries):
            self._queue.append((slot, robot[served], ap[served], entries))
        self._queued += len(entries)
        if self._queued > _ENTRIES_AT_ONCE:
            self.flush()

    def _compare_now(self, slot: int, robot: Ints, ap: Ints, entries: Floats) -> None:
        """SNRs of a sample, with all that moves in its place."""
        snr = self._bodies.snr_db(robot.tolist(), ap, entries[:, :2], entries[:, 2])
        off = ~(np.abs(snr - entries[:, 3]) <= DECIBELS)
        what = "SNR by a ray cast anew [dB]:"
        self._context.each(RULE, slot, robot, off, what, entries[:, 3], snr)

    def flush(self) -> None:
        """Cast the rays of all queued entries, one per place and AP, and compare SNRs."""
        if not self._queue:
            return
        slots = np.repeat(
            [slot for slot, *_ in self._queue], [len(r) for _, r, _, _ in self._queue]
        )
        robot = np.concatenate([r for _, r, _, _ in self._queue])
        ap = np.concatenate([a for _, _, a, _ in self._queue])
        x, y, fading, snr = np.concatenate([e for *_, e in self._queue]).T
        self._queue, self._queued = [], 0
        order = np.lexsort((y, x, ap))
        columns = np.column_stack([ap, x, y])[order]
        first = np.append(True, (columns[1:] != columns[:-1]).any(axis=1))
        place = np.empty(len(order), np.int64)
        place[order] = np.cumsum(first) - 1
        chosen = order[first]
        antenna = self._links.antenna_m(np.column_stack([x, y]))
        sight = self._links.look(self._scene, ap[chosen], antenna[chosen])
        expected = self._links.snr_db(
            ap, antenna, sight.free[place], fading, sight.blockage_db[place]
        )
        wrong = ~(np.abs(snr - expected) <= DECIBELS)
        checks = self._context.checks
        checks.count(STEP, RULE, len(snr))
        for k in np.flatnonzero(wrong).tolist():
            name = self._context.start.aps[ap[k]]
            checks.find(
                STEP,
                RULE,
                f"{snr[k]} dB from {name} at ({x[k]:.3f}, {y[k]:.3f}) m",
                f"{expected[k]} dB by a ray cast anew",
                slot=int(slots[k]),
                robot=self._context.name(int(robot[k])),
            )
