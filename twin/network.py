"""What the links of all robots do while a plan is executed: SNR, interruptions, outages, load.

Which AP serves at which instant is `twin.association`'s choice. While an interruption by a
handover lasts, a link is HANDOVER; else CONNECTED where the SNR, by rays cast now, reaches the
threshold, and OUTAGE below it. Data flow on connected links only. What is measured at an instant
holds until the next one.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from logs.records import CONNECTED, HANDOVER, LINKS, OUTAGE
from twin.association import Instants, Prediction, associate, nanoseconds
from worlds.channel import data_rate_mbps
from worlds.link import LinkModel

if TYPE_CHECKING:
    from planner.problem import Problem
    from twin.motion import SlotMotion
    from twin.order import VisitOrder
    from worlds.scene import Scene
    from worlds.world import World

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

_CONNECTED, _HANDOVER, _OUTAGE = (LINKS.index(name) for name in (CONNECTED, HANDOVER, OUTAGE))


@dataclass(frozen=True)
class Outage:
    """A time without connection.

    Attributes:
        begin_s, end_s: from the first sample below the threshold to the next that is not [s].
        lasted_s: the same without the interruptions by handovers in it [s].
        ap: that served when it began.
        least_db: the lowest SNR in it.
    """

    begin_s: float
    end_s: float
    lasted_s: float
    ap: int
    least_db: float


@dataclass(frozen=True)
class Change:
    """What happens to one robot's link at an instant within a slot.

    Attributes:
        t_s: when [s].
        step: the slot's instant at or before `t_s`.
        handover: (from, to, end [s]) if one begins.
        outage: the one that ends, if any.
        state: (AP, link, SNR [dB], rate [Mbit/s]) from now on; None if it stays as it was, or the
            slot that begins now will say.
    """

    t_s: float
    step: int
    handover: tuple[int, int, float] | None = None
    outage: Outage | None = None
    state: tuple[int, int, float, float] | None = None


@dataclass(frozen=True)
class SlotRadio:
    """The radio of one slot: arrays (n bodies, steps instants), and what changes within it.

    Attributes:
        ap, link: int32; link indexes `LINKS`.
        snr_db, map_snr_db: float64, experienced and predicted [dB].
        rate_mbps: float64.
        changes: for a body's index, its changes in time order. Those at the slot's first instant
            only end an outage; those at its last only hand over.
    """

    ap: Ints
    link: Ints
    snr_db: Floats
    map_snr_db: Floats
    rate_mbps: Floats
    changes: dict[int, list[Change]] = field(default_factory=dict)


@dataclass
class _OpenOutage:
    begin_s: float
    ap: int
    least_db: float
    interruptions: list[tuple[float, float]]

    def close(self, end_s: float) -> Outage:
        spans = ((max(b, self.begin_s), min(e, end_s)) for b, e in self.interruptions)
        lost = sum(max(0.0, e - b) for b, e in spans)
        return Outage(self.begin_s, end_s, end_s - self.begin_s - lost, self.ap, self.least_db)


class Network:
    """The APs and the links of all robots while a plan is executed, slot by slot."""

    def __init__(
        self,
        world: World,
        prediction: Prediction,
        problem: Problem,
        order: VisitOrder,
        instants: Instants,
        scene: Scene,
    ) -> None:
        self._radio = world.radio
        self._interruption_s = world.run.interruption_s
        self._prediction = prediction
        self._order = order
        self._instants = instants
        self._scene = scene
        self._links = LinkModel(world)
        self._associations = associate(problem, order, prediction, instants.steps)
        n = problem.n_robots
        self._interruption = [(0.0, 0.0)] * n  # the last one of each robot: from, to [s]
        self._until_ns = np.zeros(n, np.int64)  # its end
        self._outages: dict[int, _OpenOutage] = {}

    def load(self, motion: SlotMotion, n_aps: int) -> NDArray[np.intp]:
        """(A,) robots each AP serves in a slot by the plan (§1.6)."""
        return np.bincount(self._order.ap[motion.row], minlength=n_aps)

    def slot(self, slot: int, motion: SlotMotion, advance: Bools) -> SlotRadio:
        """The links of one slot, in which the robots of `advance` (N,) make their transitions."""
        instants, association = self._instants, self._associations
        steps = np.arange(instants.steps)
        times_ns = np.array([nanoseconds(instants.t_s(slot, j)) for j in (*steps, len(steps))])
        step = np.where(advance[motion.robot], association.step[motion.row], 0)
        changed = (step > 0)[:, None] & (steps >= step[:, None])
        ap = np.where(changed, association.to[motion.row, None],
                      association.serves[motion.row, None])  # fmt: skip

        fraction = motion.fraction(instants.fractions)
        place = (motion.edge, fraction, motion.vertex, ap)
        predicted = self._prediction.snr_db(*place)
        fading = self._prediction.fading_db(*place)
        # In a scene in which nothing moves, one ray tells all of a robot that stands.
        moves = motion.begin != motion.end
        ask = moves[:, None] | (steps == 0) | (steps == step[:, None])
        snr = np.zeros(ap.shape)
        antenna = self._links.antenna_m(motion.xy_m(instants.fractions)[ask])
        snr[ask], _ = self._links.measure(self._scene, ap[ask], antenna, fading[ask])
        asked = np.maximum.accumulate(np.where(ask, steps, 0), axis=1)
        snr = np.take_along_axis(snr, asked, axis=1)

        below = snr < self._prediction.threshold_db
        end_ns = times_ns[step] + nanoseconds(self._interruption_s)
        until = np.where(changed, end_ns[:, None], self._until_ns[motion.robot, None])
        link = np.where(times_ns[:-1] < until, _HANDOVER, np.where(below, _OUTAGE, _CONNECTED))
        rate = np.where(link == _CONNECTED, data_rate_mbps(snr, self._radio), 0.0)
        radio = SlotRadio(ap.astype(np.int32), link.astype(np.int32), snr, predicted, rate)

        eventful = (
            (step > 0)
            | (self._until_ns[motion.robot] > times_ns[0])
            | (link != link[:, :1]).any(axis=1)
            | below.any(axis=1)
        )
        for i in self._outages:  # it may end at the slot's first instant
            eventful |= motion.robot == i
        for k in np.flatnonzero(eventful).tolist():
            i = int(motion.robot[k])
            changes = self._changes(slot, i, k, int(step[k]), int(association.to[motion.row[k]]),
                                    below[k], times_ns, radio)  # fmt: skip
            if changes:
                radio.changes[k] = changes
        return radio

    def _changes(
        self,
        slot: int,
        i: int,
        k: int,
        step: int,
        to: int,
        below: Bools,
        times_ns: NDArray[np.int64],
        radio: SlotRadio,
    ) -> list[Change]:
        """What happens to robot i, body k, in a slot; enters it into the state of the network."""
        steps, found = len(below), list[Change]()
        shown = (int(radio.ap[k, 0]), int(radio.link[k, 0]))
        for j in range(steps + 1):
            now = self._instants.t_s(slot, j)
            end_s, end_ns = self._interruption[i][1], int(self._until_ns[i])
            if j and times_ns[j - 1] < end_ns < times_ns[j]:
                # An interruption ends between two instants: what was measured last holds.
                link = _OUTAGE if below[j - 1] else _CONNECTED
                snr, ap = float(radio.snr_db[k, j - 1]), int(radio.ap[k, j - 1])
                rate = 0.0 if below[j - 1] else float(data_rate_mbps(snr, self._radio))
                found.append(Change(end_s, j - 1, state=(ap, link, snr, rate)))
                shown = (ap, link)
            handover = None
            if j and j == step:
                handover = (int(radio.ap[k, j - 1]), to, now + self._interruption_s)
                self._interrupt(i, now)
            if j == steps:
                if handover:
                    found.append(Change(now, j, handover))
                break
            outage = self._observe(i, now, bool(below[j]), radio, (k, j))
            state = None
            ap, link = int(radio.ap[k, j]), int(radio.link[k, j])
            if (ap, link) != shown:
                shown = (ap, link)
                state = (ap, link, float(radio.snr_db[k, j]), float(radio.rate_mbps[k, j]))
            if handover or outage or state:
                found.append(Change(now, j, handover, outage, state))
        return found

    def _interrupt(self, i: int, now: float) -> None:
        """A handover of robot i begins; it cuts an interruption that still lasts."""
        begin, end = self._interruption[i]
        self._interruption[i] = (now, now + self._interruption_s)
        self._until_ns[i] = nanoseconds(now) + nanoseconds(self._interruption_s)
        if i in self._outages:
            known = self._outages[i].interruptions
            if known and known[-1] == (begin, end):
                known[-1] = (begin, min(end, now))
            known.append(self._interruption[i])

    def _observe(
        self, i: int, now: float, below: bool, radio: SlotRadio, at: tuple[int, int]
    ) -> Outage | None:
        """Open or go on with an outage of robot i, or end the one there is."""
        if not below:
            return self.end_outage(i, now)
        snr = float(radio.snr_db[at])
        if i not in self._outages:
            self._outages[i] = _OpenOutage(now, int(radio.ap[at]), snr, [self._interruption[i]])
        self._outages[i].least_db = min(self._outages[i].least_db, snr)
        return None

    def end_outage(self, i: int, now: float) -> Outage | None:
        """End robot i's outage, because it has left or the run is over; None if it has none."""
        outage = self._outages.pop(i, None)
        return outage.close(now) if outage else None
