"""What the links of all robots do while a plan is executed: SNR, interruptions, outages, load.

Which AP serves at which instant is `twin.association`'s choice, as long as nothing disturbs it.
While an interruption by a handover lasts, a link is HANDOVER; else CONNECTED where the SNR, by rays
cast now, reaches the threshold, and OUTAGE below it; NONE where no AP serves. Data flow on
connected links only; under `rate_sharing = "equal"` an AP's airtime is shared equally by all it
serves at the instant. What is measured at an instant holds until the next one.

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

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from logs.records import CONNECTED, HANDOVER, LINKS, NO_AP, OUTAGE
from twin.association import Instants, Prediction, associate, nanoseconds
from twin.link_changes import LinkChanges, Outage, SlotRadio, Switch
from twin.planned_links import PlannedLinks
from worlds.channel import data_rate_mbps
from worlds.link import LinkModel

if TYPE_CHECKING:
    from planner.problem import Problem
    from twin.bodies import Bodies
    from twin.disturbances import Disturbances
    from twin.motion import Roads, SlotMotion
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
        roads: Roads,
    ) -> None:
        self._radio, self._run = world.radio, world.run
        self._interruption_s = world.run.interruption_s
        self._wait_ns = nanoseconds(world.run.time_to_trigger_s)
        self._prediction, self._problem = prediction, problem
        self._instants = instants
        self._bodies = bodies
        self._disturbances = disturbances
        self._model = LinkModel(world)
        n = problem.n_robots
        self.serving: Ints = np.full(n, -1, np.int32)
        self.connected: Bools = np.ones(n, np.bool_)
        self._changes = LinkChanges(world, instants, n)
        self._wish = np.full(n, -1, np.int32)  # AP it wishes for
        self._wish_ns = np.zeros(n, np.int64)  # since when
        self.adopt(order, roads)
        there = np.flatnonzero(order.arrival >= 0)
        self.serving[there] = order.ap[order.first_row[there]]

    def adopt(self, order: VisitOrder, roads: Roads) -> None:
        """Serve by another plan, of which these are the ways, from the next slot on."""
        self._order = order
        self._associations = associate(
            self._problem, order, self._prediction, self._instants.steps, self.serving
        )
        self._planned = PlannedLinks(
            self._model, self._prediction, order, self._associations, roads, self._instants,
            self._bodies.scene,
        )  # fmt: skip

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
        steps = instants.steps
        times_ns = np.array([nanoseconds(instants.t_s(slot, j)) for j in range(steps + 1)])
        moves = advance[motion.robot]
        step = np.where(moves, association.step[motion.row], 0)
        to = association.to[motion.row]
        if self._disturbances.affects_radio:
            ap, snr, predicted, link, switches = self._live(slot, motion, step, to, times_ns)
        else:
            ap, snr, predicted = self._planned.of(motion, moves)
            switches = {
                k: Switch(int(step[k]), int(ap[k, step[k] - 1]), int(to[k]), True)
                for k in np.flatnonzero(step).tolist()
            }
            link = self._link(motion, snr, step, times_ns)
        below = snr < self._prediction.threshold_db
        rate = data_rate_mbps(snr, self._radio, self._served(ap))
        radio = SlotRadio(
            ap,
            link.astype(np.int32),
            snr,
            predicted,
            np.where(link == _CONNECTED, rate, 0.0),
            ap[:, 0] != association.serves[motion.row],
        )

        eventful = (
            (self._changes.until_ns[motion.robot] > times_ns[0])
            | (link != link[:, :1]).any(axis=1)
            | (ap != ap[:, :1]).any(axis=1)
            | below.any(axis=1)
        )
        eventful[list(switches)] = True
        for i in self._changes.outages:  # it may end at the slot's first instant
            eventful |= motion.robot == i
        for k in np.flatnonzero(eventful).tolist():
            seen = below[k, :1] if only_begin else below[k]
            changes = self._changes.of(
                slot, int(motion.robot[k]), k, switches.get(k), seen, times_ns, radio
            )
            if changes:
                radio.changes[k] = changes
        self.serving[motion.robot] = ap[:, -1]
        for k, switch in switches.items():
            if switch.step == steps:
                self.serving[motion.robot[k]] = switch.after
        if self._disturbances.affects_radio:  # else outages are those the plan knows of
            self.connected[motion.robot] = ((link == _CONNECTED) | (link == _HANDOVER)).any(axis=1)
        return radio

    def end_outage(self, i: int, now: float) -> Outage | None:
        """End robot i's outage, because it has left or the run is over; None if it has none."""
        return self._changes.end_outage(i, now)

    def _served(self, ap: Ints) -> NDArray[np.intp] | int:
        """(n, steps) robots that the AP of each one serves at the instant; 1 if they share none."""
        if self._radio.rate_sharing == "none":
            return 1
        steps = ap.shape[1]
        place = (ap + 1) * steps + np.arange(steps)  # who has no AP has no rate, either
        return np.asarray(np.bincount(place.ravel())[place])

    def _link(
        self, motion: SlotMotion, snr: Floats, step: NDArray[np.intp], times_ns: NDArray[np.int64]
    ) -> Ints:
        """(n, steps) links of a plan that is executed as it is."""
        link = np.where(snr < self._prediction.threshold_db, _OUTAGE, _CONNECTED)
        until = self._changes.until_ns[motion.robot]
        hands_over = step > 0
        if hands_over.any() or (until > times_ns[0]).any():
            steps = np.arange(snr.shape[1])
            changed = hands_over[:, None] & (steps >= step[:, None])
            end_ns = times_ns[step] + nanoseconds(self._interruption_s)
            interrupted = times_ns[:-1] < np.where(changed, end_ns[:, None], until[:, None])
            link = np.where(interrupted, _HANDOVER, link)
        return link

    # --- disturbed links ----------------------------------------------------------------------

    def _live(
        self,
        slot: int,
        motion: SlotMotion,
        step: NDArray[np.intp],
        to: Ints,
        times_ns: NDArray[np.int64],
    ) -> tuple[Ints, Floats, Floats, Ints, dict[int, Switch]]:
        """AP, SNR, the map's SNR and link at each instant, and handovers, instant by instant.

        Args:
            slot: which.
            motion: of the n bodies.
            step, to: (n,) instant and AP of the plan's handovers, 0 for none.
            times_ns: (steps + 1,) of the instants.
        """
        fractions, serves = self._instants.fractions, self._associations.serves[motion.row]
        changed = (step > 0)[:, None] & (np.arange(len(fractions)) >= step[:, None])
        planned = np.where(changed, to[:, None], serves[:, None]).astype(np.int32)
        xy = motion.xy_m(fractions)
        place = (motion.edge, motion.fraction(fractions), motion.vertex)
        n, steps = planned.shape
        robot = motion.robot
        serving = self.serving[robot].copy()
        ap, link = np.full((n, steps), -1, np.int32), np.zeros((n, steps), np.int32)
        snr, predicted = np.full((n, steps), NO_SNR_DB), np.full((n, steps), NO_SNR_DB)
        until = self._changes.until_ns[robot].copy()
        switches: dict[int, Switch] = {}
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
                    switches[k] = Switch(j, int(serving[k]), int(to[k]), True)
            for k, target in chosen.items():
                if k not in switches and up[target]:
                    switches[k] = Switch(j, int(serving[k]), target, False)
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
        antenna = self._model.antenna_m(xy)
        own = self._bodies.handle(body)
        return self._model.measure(self._bodies.scene, ap, antenna, fading, own)[0]

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
