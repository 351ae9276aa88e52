"""What happens to the link of each robot within a slot: handovers, interruptions, outages.

An interruption by a handover lasts as long as the world says, a new handover cuts it. An outage
lasts from the first sample below the threshold to the next that is not; what is told of it is told
when it is over.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from logs.records import CONNECTED, LINKS, OUTAGE
from twin.association import Instants, nanoseconds
from worlds.channel import data_rate_mbps

if TYPE_CHECKING:
    from worlds.world import World

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

_CONNECTED, _OUTAGE = LINKS.index(CONNECTED), LINKS.index(OUTAGE)


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
class OpenOutage:
    """An outage that is not over."""

    begin_s: float
    ap: int
    least_db: float
    interruptions: list[tuple[float, float]]

    def close(self, end_s: float) -> Outage:
        """It is over."""
        spans = ((max(b, self.begin_s), min(e, end_s)) for b, e in self.interruptions)
        lost = sum(max(0.0, e - b) for b, e in spans)
        return Outage(self.begin_s, end_s, end_s - self.begin_s - lost, self.ap, self.least_db)


@dataclass(frozen=True)
class Switch:
    """A handover within a slot: at which instant (1 … steps), from and to which AP."""

    step: int
    before: int
    after: int
    planned: bool


class LinkChanges:
    """Follows interruptions and outages of all robots from slot to slot.

    Attributes:
        until_ns: (N,) int64, end of the last interruption of each robot [ns].
        outages: those there are, by robot.
    """

    def __init__(self, world: World, instants: Instants, robots: int) -> None:
        self._radio, self._interruption_s = world.radio, world.run.interruption_s
        self._instants = instants
        self._interruption = [(0.0, 0.0)] * robots  # the last one of each robot: from, to [s]
        self.until_ns = np.zeros(robots, np.int64)
        self.outages: dict[int, OpenOutage] = {}

    def of(
        self,
        slot: int,
        i: int,
        k: int,
        switch: Switch | None,
        below: Bools,
        times_ns: NDArray[np.int64],
        radio: SlotRadio,
    ) -> list[Change]:
        """What happens to robot i, body k, in a slot; enters it into the state of the network."""
        steps, found = len(below), list[Change]()
        shown = (int(radio.ap[k, 0]), int(radio.link[k, 0]))
        for j in range(steps + 1):
            now = self._instants.t_s(slot, j)
            end_s, end_ns = self._interruption[i][1], int(self.until_ns[i])
            if j and times_ns[j - 1] < end_ns < times_ns[j] and radio.ap[k, j - 1] >= 0:
                # An interruption ends between two instants: what was measured last holds.
                link = _OUTAGE if below[j - 1] else _CONNECTED
                snr, ap = float(radio.snr_db[k, j - 1]), int(radio.ap[k, j - 1])
                served = int(np.count_nonzero(radio.ap[:, j - 1] == ap))
                rate = 0.0 if below[j - 1] else float(data_rate_mbps(snr, self._radio, served))
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
                self.until_ns[i] = min(int(self.until_ns[i]), int(times_ns[j]))
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
        self.until_ns[i] = nanoseconds(now) + nanoseconds(self._interruption_s)
        if i in self.outages:
            known = self.outages[i].interruptions
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
        if i not in self.outages:
            self.outages[i] = OpenOutage(now, int(radio.ap[at]), snr, [self._interruption[i]])
        self.outages[i].least_db = min(self.outages[i].least_db, snr)
        return None

    def end_outage(self, i: int, now: float) -> Outage | None:
        """End robot i's outage, because it has left or the run is over; None if it has none."""
        outage = self.outages.pop(i, None)
        return outage.close(now) if outage else None
