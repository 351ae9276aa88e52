"""What the links of all robots do while a plan is executed: SNR, interruptions, outages, load.

Which AP serves at which instant is `twin.association`'s choice, as long as nothing disturbs it.
While an interruption by a handover lasts, a link is HANDOVER; else CONNECTED where the SNR, by rays
cast now, reaches the threshold, and OUTAGE below it; NONE where no AP serves. Data flow on
connected links only. What is measured at an instant holds until the next one.

**When the plan's AP does not serve.** A robot whose AP goes out has none from that instant on. What
it wishes for at an instant, unless an interruption lasts, is

1. the AP its plan has for it, if that works and its SNR reaches the threshold (and the threshold
   and the hysteresis, if the AP that serves now is good, too);
2. else, if it has no AP, or the SNR of its own is below the threshold and not by the map's word
   (outages that the map foresees belong to the plan), the working AP of the highest SNR that
   reaches the threshold and is better than its own by the hysteresis;
3. else nothing.

When it has wished for the same AP at all instants of `time_to_trigger_s`, it hands over at the next
instant: an unplanned handover, with the interruption of any other. At most one handover is made per
slot and robot (§1.7); a planned one is made if the AP that the plan has serves, and the next one
works. Capacities are not looked at (design page 5: log and count, do not gate).

In runs in which nothing can disturb the radio none of this is asked, and links are the plan's.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from logs.records import CONNECTED, HANDOVER, LINKS, NO_AP, OUTAGE
from twin.association import Instants, Prediction, associate, nanoseconds
from worlds.channel import data_rate_mbps
from worlds.link import LinkModel

if TYPE_CHECKING:
    from planner.problem import Problem
    from twin.bodies import Bodies
    from twin.disturbances import Disturbances
    from twin.motion import SlotMotion
    from twin.order import VisitOrder
    from worlds.world import World

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

_CONNECTED, _HANDOVER, _OUTAGE, _NO_AP = (
    LINKS.index(name) for name in (CONNECTED, HANDOVER, OUTAGE, NO_AP)
)
NO_SNR_DB = -1000.0
"""SNR, experienced and predicted, of a robot that no AP serves [dB]."""


@dataclass(frozen=True)
class Outage:
    """A time without connection.

    Attributes:
        begin_s, end_s: from the first sample below the threshold to the next that is not [s].
        lasted_s: the same without the interruptions by handovers in it [s].
        ap: that served when it began, −1 if none did.
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
        handover: (from, to, end [s]) if one begins; from −1 where no AP served.
        planned: the handover is the plan's.
        outage: the one that ends, if any.
        state: (AP, link, SNR [dB], rate [Mbit/s]) from now on; None if it stays as it was, or the
            slot that begins now will say.
    """

    t_s: float
    step: int
    handover: tuple[int, int, float] | None = None
    outage: Outage | None = None
    planned: bool = True
    state: tuple[int, int, float, float] | None = None


@dataclass(frozen=True)
class SlotRadio:
    """The radio of one slot: arrays (n bodies, steps instants), and what changes within it.

    Attributes:
        ap, link: int32; ap −1 is none, link indexes `LINKS`.
        deviates: (n,) bool, at the slot's beginning another AP than the plan's serves, or none.
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
    deviates: Bools
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


@dataclass(frozen=True)
class _Switch:
    """A handover within a slot: at which instant (1 … steps), from and to which AP."""

    step: int
    before: int
    after: int
    planned: bool


class Network:
    """The APs and the links of all robots while a plan is executed, slot by slot.

    Attributes:
        serving: (N,) int32, AP that serves each robot now, −1 for none.
        connected: (N,) bool, it was connected, or handing over, at some instant of the last slot.
    """

    def __init__(
        self,
        world: World,
        prediction: Prediction,
        problem: Problem,
        order: VisitOrder,
        instants: Instants,
        bodies: Bodies,
        disturbances: Disturbances,
    ) -> None:
        self._radio, self._run = world.radio, world.run
        self._interruption_s = world.run.interruption_s
        self._wait_ns = nanoseconds(world.run.time_to_trigger_s)
        self._prediction, self._problem = prediction, problem
        self._instants = instants
        self._bodies = bodies
        self._disturbances = disturbances
        self._links = LinkModel(world)
        n = problem.n_robots
        self.serving: Ints = np.full(n, -1, np.int32)
        self.connected: Bools = np.ones(n, np.bool_)
        self._interruption = [(0.0, 0.0)] * n  # the last one of each robot: from, to [s]
        self._until_ns = np.zeros(n, np.int64)  # its end
        self._wish = np.full(n, -1, np.int32)  # AP it wishes for
        self._wish_ns = np.zeros(n, np.int64)  # since when
        self._outages: dict[int, _OpenOutage] = {}
        self.adopt(order)
        there = np.flatnonzero(order.arrival >= 0)
        self.serving[there] = order.ap[order.first_row[there]]

    def adopt(self, order: VisitOrder) -> None:
        """Serve by another plan from the next slot on."""
        self._order = order
        self._associations = associate(self._problem, order, self._prediction, self._instants.steps)

    @property
    def pending(self) -> bool:
        """Whether some robot is about to change its AP without the plan."""
        return bool((self._wish >= 0).any())

    def load(self, motion: SlotMotion, radio: SlotRadio) -> NDArray[np.intp]:
        """(A,) robots each AP serves in a slot (§1.6): who crosses counts where it comes from."""
        ap = np.where(radio.deviates, radio.ap[:, 0], self._order.ap[motion.row])
        return np.bincount(ap[ap >= 0], minlength=self._problem.n_aps)

    def slot(
        self, slot: int, motion: SlotMotion, advance: Bools, *, only_begin: bool = False
    ) -> SlotRadio:
        """The links of one slot, in which the robots of `advance` (N,) make their transitions.

        With `only_begin` nothing happens after its first instant: the run ends there.
        """
        instants, association = self._instants, self._associations
        steps = np.arange(instants.steps)
        times_ns = np.array([nanoseconds(instants.t_s(slot, j)) for j in (*steps, len(steps))])
        step = np.where(advance[motion.robot], association.step[motion.row], 0)
        changed = (step > 0)[:, None] & (steps >= step[:, None])
        planned = np.where(changed, association.to[motion.row, None],
                           association.serves[motion.row, None]).astype(np.int32)  # fmt: skip
        to = association.to[motion.row]
        xy = motion.xy_m(instants.fractions)
        fraction = motion.fraction(instants.fractions)
        place = (motion.edge, fraction, motion.vertex)
        if self._disturbances.affects_radio:
            ap, snr, predicted, link, switches = self._live(
                slot, motion, planned, step, to, times_ns, xy, place
            )
        else:
            ap = planned
            snr, predicted = self._undisturbed(motion, ap, step, xy, place)
            switches = {
                k: _Switch(int(step[k]), int(ap[k, step[k] - 1]), int(to[k]), True)
                for k in np.flatnonzero(step).tolist()
            }
            end_ns = times_ns[step] + nanoseconds(self._interruption_s)
            until = np.where(changed, end_ns[:, None], self._until_ns[motion.robot, None])
            link = np.where(
                times_ns[:-1] < until,
                _HANDOVER,
                np.where(snr < self._prediction.threshold_db, _OUTAGE, _CONNECTED),
            )
        below = snr < self._prediction.threshold_db
        rate = np.where(link == _CONNECTED, data_rate_mbps(snr, self._radio), 0.0)
        radio = SlotRadio(
            ap,
            link.astype(np.int32),
            snr,
            predicted,
            rate,
            ap[:, 0] != association.serves[motion.row],
        )

        eventful = (
            (self._until_ns[motion.robot] > times_ns[0])
            | (link != link[:, :1]).any(axis=1)
            | (ap != ap[:, :1]).any(axis=1)
            | below.any(axis=1)
        )
        eventful[list(switches)] = True
        for i in self._outages:  # it may end at the slot's first instant
            eventful |= motion.robot == i
        for k in np.flatnonzero(eventful).tolist():
            seen = below[k, :1] if only_begin else below[k]
            changes = self._changes(
                slot, int(motion.robot[k]), k, switches.get(k), seen, times_ns, radio
            )
            if changes:
                radio.changes[k] = changes
        self.serving[motion.robot] = ap[:, -1]
        for k, switch in switches.items():
            if switch.step == len(steps):
                self.serving[motion.robot[k]] = switch.after
        if self._disturbances.affects_radio:  # else outages are those the plan knows of
            self.connected[motion.robot] = ((link == _CONNECTED) | (link == _HANDOVER)).any(axis=1)
        return radio

    def _undisturbed(
        self,
        motion: SlotMotion,
        ap: Ints,
        step: Ints,
        xy: Floats,
        place: tuple[Ints, Floats, Ints],
    ) -> tuple[Floats, Floats]:
        """(n, steps) SNR experienced and predicted, in a scene in which nothing moves [dB]."""
        steps = np.arange(ap.shape[1])
        predicted = self._prediction.snr_db(*place, ap)
        fading = self._prediction.fading_db(*place, ap)
        # One ray tells all of a robot that stands.
        moves = motion.begin != motion.end
        ask = moves[:, None] | (steps == 0) | (steps == step[:, None])
        snr = np.zeros(ap.shape)
        snr[ask], _ = self._links.measure(
            self._bodies.scene, ap[ask], self._links.antenna_m(xy[ask]), fading[ask]
        )
        asked = np.maximum.accumulate(np.where(ask, steps, 0), axis=1)
        return np.take_along_axis(snr, asked, axis=1), predicted

    # --- disturbed links ----------------------------------------------------------------------

    def _live(
        self,
        slot: int,
        motion: SlotMotion,
        planned: Ints,
        step: Ints,
        to: Ints,
        times_ns: NDArray[np.int64],
        xy: Floats,
        place: tuple[Ints, Floats, Ints],
    ) -> tuple[Ints, Floats, Floats, Ints, dict[int, _Switch]]:
        """AP, SNR, the map's SNR and link at each instant, and handovers, instant by instant.

        Args:
            slot: which.
            motion: of the n bodies.
            planned: (n, steps) AP of the plan.
            step, to: (n,) instant and AP of the plan's handovers, 0 for none.
            times_ns: (steps + 1,) of the instants.
            xy: (n, steps, 2) places [m].
            place: edge, fraction and vertex, see `Prediction`.
        """
        n, steps = planned.shape
        robot = motion.robot
        serving = self.serving[robot].copy()
        ap, link = np.full((n, steps), -1, np.int32), np.zeros((n, steps), np.int32)
        snr, predicted = np.full((n, steps), NO_SNR_DB), np.full((n, steps), NO_SNR_DB)
        until = self._until_ns[robot].copy()
        switches: dict[int, _Switch] = {}
        chosen: dict[int, int] = {}  # what unplanned handovers lead to at the next instant
        lasts_ns = nanoseconds(self._interruption_s)
        edge, fraction, vertex = place
        gone = np.ones(len(self._wish), np.bool_)
        gone[robot] = False
        self._wish[gone] = -1
        for j in range(steps + 1):
            up = self._disturbances.ap_up(slot, j)
            due = np.flatnonzero((step == j) & (j > 0))
            for k in due.tolist():
                # The AP that serves is the one the plan hands over from, and the next one works.
                if serving[k] == planned[k, j - 1] and up[to[k]] and k not in switches:
                    switches[k] = _Switch(j, int(serving[k]), int(to[k]), True)
            for k, target in chosen.items():
                if k not in switches and up[target]:
                    switches[k] = _Switch(j, int(serving[k]), target, False)
                    self._wish[robot[k]] = -1
            for k, switch in switches.items():
                if switch.step == j:
                    serving[k] = switch.after
                    until[k] = times_ns[j] + lasts_ns
            if j == steps:
                break
            lost = (serving >= 0) & ~up[serving]
            serving[lost] = -1
            served = np.flatnonzero(serving >= 0)
            self._bodies.place(slot, j, motion, xy[:, j])
            at = (edge[served], fraction[served, j : j + 1], vertex[served])
            mine = serving[served, None]
            predicted[served, j] = self._prediction.snr_db(*at, mine)[:, 0]
            fading = self._prediction.fading_db(*at, mine)[:, 0]
            snr[served, j] = self._measure(served, serving[served], xy[served, j], fading)
            ap[:, j] = serving
            below = snr[:, j] < self._prediction.threshold_db
            link[:, j] = np.where(below, _OUTAGE, _CONNECTED)
            link[times_ns[j] < until, j] = _HANDOVER
            link[serving < 0, j] = _NO_AP
            until[serving < 0] = np.minimum(until[serving < 0], times_ns[j])

            own = serving == planned[:, j]
            foreseen = own & (predicted[:, j] < self._prediction.threshold_db)
            asks = (~own | (below & ~foreseen)) & (link[:, j] != _HANDOVER)
            self._wish[robot[~asks]] = -1
            chosen = self._wishes(
                np.flatnonzero(asks), j, motion, planned[:, j], serving, snr[:, j], up,
                int(times_ns[j]), xy[:, j], place,
            )  # fmt: skip
        return ap, snr, predicted, link, switches

    def _measure(self, body: NDArray[np.intp], ap: Ints, xy: Floats, fading: Floats) -> Floats:
        """(m,) SNR of bodies from an AP each, the scene being as it is now [dB]."""
        antenna = self._links.antenna_m(xy)
        own = self._bodies.handle(body)
        return self._links.measure(self._bodies.scene, ap, antenna, fading, own)[0]

    def _wishes(
        self,
        asks: NDArray[np.intp],
        j: int,
        motion: SlotMotion,
        planned: Ints,
        serving: Ints,
        snr: Floats,
        up: Bools,
        now_ns: int,
        xy: Floats,
        place: tuple[Ints, Floats, Ints],
    ) -> dict[int, int]:
        """Bodies that hand over at the next instant without the plan, and to which AP."""
        found: dict[int, int] = {}
        if not len(asks):
            return found
        n_aps = self._problem.n_aps
        edge, fraction, vertex = place
        aps = np.arange(n_aps, dtype=np.int32)
        each = np.broadcast_to(aps, (len(asks), n_aps))
        share = np.broadcast_to(fraction[asks, j : j + 1], each.shape)
        fading = self._prediction.fading_db(edge[asks], share, vertex[asks], each)
        heard = self._measure(
            np.repeat(asks, n_aps), each.ravel(), np.repeat(xy[asks], n_aps, axis=0), fading.ravel()
        ).reshape(each.shape)
        heard = np.where(up, heard, NO_SNR_DB)
        for k, levels in zip(asks.tolist(), heard, strict=True):
            i = int(motion.robot[k])
            wish = self._choice(int(planned[k]), int(serving[k]), float(snr[k]), levels)
            if wish != self._wish[i]:
                self._wish[i], self._wish_ns[i] = wish, now_ns
            if wish >= 0 and now_ns - int(self._wish_ns[i]) >= self._wait_ns:
                found[k] = wish
        return found

    def _choice(self, planned: int, serving: int, snr: float, heard: Floats) -> int:
        """The AP a robot wishes for, −1 if none; see the head of this file."""
        threshold, gain = self._prediction.threshold_db, self._run.hysteresis_db
        good = serving >= 0 and snr >= threshold
        if planned != serving and heard[planned] >= threshold + (gain if good else 0.0):
            return planned
        if good:
            return -1
        enough = heard >= (max(threshold, snr + gain) if serving >= 0 else threshold)
        if serving >= 0:
            enough[serving] = False
        return int(np.where(enough, heard, -np.inf).argmax()) if enough.any() else -1

    def _changes(
        self,
        slot: int,
        i: int,
        k: int,
        switch: _Switch | None,
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
            if j and times_ns[j - 1] < end_ns < times_ns[j] and radio.ap[k, j - 1] >= 0:
                # An interruption ends between two instants: what was measured last holds.
                link = _OUTAGE if below[j - 1] else _CONNECTED
                snr, ap = float(radio.snr_db[k, j - 1]), int(radio.ap[k, j - 1])
                rate = 0.0 if below[j - 1] else float(data_rate_mbps(snr, self._radio))
                found.append(Change(end_s, j - 1, state=(ap, link, snr, rate)))
                shown = (ap, link)
            handover, planned = None, True
            if switch is not None and j == switch.step:
                handover = (switch.before, switch.after, now + self._interruption_s)
                planned = switch.planned
                self._interrupt(i, now)
            if j == steps:  # the slot is over, or the run
                if handover:
                    found.append(Change(now, j, handover, planned=planned))
                break
            if radio.ap[k, j] < 0:  # what an interruption was for is lost
                self._until_ns[i] = min(int(self._until_ns[i]), int(times_ns[j]))
            outage = self._observe(i, now, bool(below[j]), radio, (k, j))
            state = None
            ap, link = int(radio.ap[k, j]), int(radio.link[k, j])
            if (ap, link) != shown:
                shown = (ap, link)
                state = (ap, link, float(radio.snr_db[k, j]), float(radio.rate_mbps[k, j]))
            if handover or outage or state:
                found.append(Change(now, j, handover, outage, planned, state))
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
