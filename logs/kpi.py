"""Key figures of a run as a fold over its records: the only place where one is computed.

The twin folds the records it emits and the validator those it reads; both get the same figures
because both call this file. Time is accounted as follows, for each robot on its own:

- A `Sample` at s holds until the next `Sample` (or until the time at which figures are asked
  for): on [s, s') each robot in it has the link and the rate of that sample. The last sample of a
  run lies at its last instant and so holds for nothing. A robot is *on the floor* while a sample
  that lists it holds.
- An interruption is much shorter than the distance of two samples, so it is not read from the
  samples: a robot is *interrupted* on the union of [t_s, end_s) over its `Handover` records.
- Of an interval of length d [s] in which h [s] are interrupted, h counts as handover, d − h as the
  link the sample tells: connected if CONNECTED, outage if OUTAGE or NO_AP. Hence, for each robot,
  connected_s + handover_s + outage_s = time on the floor.
- A sample taken while a handover lasts (link HANDOVER) says nothing of what follows: the rest of
  its interval has the link and the rate of the `RobotState` logged at the end of the handover, and
  if there is none, the link its SNR gives against the threshold, and the sample's own rate.
- An outage lasts from one sample that shows it to the next that does not; its length is the
  outage time in between [s].
- Rates are a distribution over time: rate r for d − h, rate 0 for h. P10 is the least rate that
  at least 10 % of the time has at most.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from logs.distribution import Distribution
from logs.records import (
    CAUSES,
    CONNECTED,
    HANDOVER,
    HELD,
    LINKS,
    WAITING,
    ApKpi,
    ApLoad,
    Arrival,
    Disturbance,
    Handover,
    Incident,
    Kpi,
    Record,
    Replan,
    RobotKpi,
    RobotState,
    RunStart,
    Sample,
    Separation,
    Waits,
)
from planner.plan import Plan

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

NO_CLEARANCE_M = -1000.0
"""`Kpi.min_clearance_m` while fewer than two bodies were on the floor."""

PING_PONG_SLOTS = 2
"""A handover back to the AP left less than so many slots before is a ping-pong (3GPP TR 36.839,
5.2.1, counts by a minimum time of stay, too: 1 s, which is less than a slot here)."""

_CONNECTED, _HANDOVER = LINKS.index(CONNECTED), LINKS.index(HANDOVER)


def planned_figures(plan: Plan) -> list[tuple[str, int, int]]:
    """(robot, arrival slot, handovers) of each path of the plan: what `KpiFold` compares with."""
    return [(p.robot, p.arrival, p.handovers) for p in plan.paths if p is not None]


class KpiFold:
    """Key figures of the records added so far.

    Records are added in the order of their times, `RunStart` (given to the constructor) first.
    Memory is 20 bytes per robot and sample, the rest does not grow with time.
    """

    def __init__(self, start: RunStart, planned: Iterable[tuple[str, int, int]]) -> None:
        """Begin with the run's first record.

        Args:
            start: who takes part.
            planned: (robot, arrival slot, handovers) of every robot that has a path, see
                `planned_figures`. Robots without one count no travel slots.
        """
        n, m = len(start.robots), len(start.aps)
        self._start = start
        self._robot = {name: i for i, name in enumerate(start.robots)}
        self._ap = {name: a for a, name in enumerate(start.aps)}
        self._planned_travel = np.zeros(n, np.int64)
        self._planned_handovers = np.zeros(n, np.int64)
        self._has_path = np.zeros(n, np.bool_)
        for name, arrival, handovers in planned:
            i = self._robot[name]
            self._planned_travel[i], self._planned_handovers[i] = arrival, handovers
            self._has_path[i] = True

        # Counts.
        self._arrival = np.full(n, -1, np.int64)
        self._handovers = np.zeros(n, np.int64)
        self._waiting = np.zeros(n, np.int64)
        self._held = np.zeros(n, np.int64)
        self._held_by = np.zeros((len(CAUSES), n), np.int64)
        self._waits: dict[tuple[int, int], int] = {}  # robot, whom it waits for -> slots
        self._state_slot = np.full(n, -1, np.int64)  # last slot whose activity is counted
        self._unplanned = np.zeros(n, np.int64)
        self._ping_pongs = np.zeros(n, np.int64)
        self._last_handover: dict[int, Handover] = {}
        self._delays = self._replans = 0
        self._incidents = 0
        self._loads = [(0, 0, 0)] * m  # slots, robot-slots, those over capacity
        self._peak = [0] * m
        self._peak_of_all = (0, 0.0)  # load, share of that AP's capacity
        self._moves = np.zeros((2, m), np.int64)  # rows: handovers in, out
        self._clearance = np.inf
        self._map_error = (0.0, 0, 0.0)  # sum [dB], entries, largest [dB]

        # Time. The open sample: what holds since `_since`, entry k for robot `_open[k]`.
        self._since = start.t_s
        self._open: Ints = np.empty(0, np.int64)
        self._open_link: Ints = np.empty(0, np.int64)  # never HANDOVER, see `_open_hidden`
        self._open_rate: Floats = np.empty(0)
        self._open_hidden: NDArray[np.bool_] = np.empty(0, np.bool_)
        self._interrupted: dict[int, list[tuple[float, float]]] = {}
        self._connected = np.zeros(n)
        self._handover_time = np.zeros(n)
        self._outage = np.zeros(n)
        self._outage_now = np.zeros(n)
        self._outage_worst = np.zeros(n)
        self._delivered = np.zeros(n)
        self._rates = Distribution()
        self._history: list[tuple[NDArray[np.int32], Floats, Floats]] = []  # robot, rate, seconds

    def add(self, record: Record) -> None:
        """Add the next record; kinds that no figure depends on are passed over."""
        match record:
            case RobotState():
                self._add_state(record)
            case Sample():
                self._add_sample(record)
            case ApLoad():
                self._add_load(record)
            case Handover():
                self._add_handover(record)
            case Separation():
                if record.robot_a:
                    self._clearance = min(self._clearance, record.clearance_m)
            case Arrival():
                self._arrival[self._robot[record.robot]] = record.slot
            case Incident():
                self._incidents += 1
            case Disturbance():
                self._delays += record.kind == "delay"
            case Replan():
                self._replans += 1
            case _:
                pass

    def _add_state(self, state: RobotState) -> None:
        i = self._robot[state.robot]
        if state.slot > self._state_slot[i]:  # later ones of a slot tell a link, not an activity
            self._state_slot[i] = state.slot
            self._waiting[i] += state.activity == WAITING
            if state.activity == HELD:
                self._hold(i, state)
        if state.t_s > self._since and state.link != HANDOVER and self._open_hidden.any():
            shown = self._open_hidden & (self._open == i)
            self._open_link[shown] = LINKS.index(state.link)
            self._open_rate[shown] = state.rate_mbps
            self._open_hidden[shown] = False

    def _hold(self, i: int, state: RobotState) -> None:
        """Robot i is held in a slot."""
        self._held[i] += 1
        if state.cause in CAUSES:
            self._held_by[CAUSES.index(state.cause), i] += 1
        other = self._robot.get(state.waits_for)
        if other is not None:
            self._waits[i, other] = self._waits.get((i, other), 0) + 1

    def _add_sample(self, sample: Sample) -> None:
        self._close(sample.t_s)
        self._open = np.array(sample.robot, np.int64)
        self._open_rate = np.array(sample.rate_mbps, np.float64)
        snr = np.array(sample.snr_db, np.float64)
        link = np.array(sample.link, np.int64)
        self._open_hidden = link == _HANDOVER
        seen = np.where(snr >= self._start.threshold_db, _CONNECTED, LINKS.index("outage"))
        self._open_link = np.where(self._open_hidden, seen, link)

        served = np.array(sample.ap, np.int64) >= 0
        error = (np.array(sample.map_snr_db, np.float64) - snr)[served]
        if len(error):
            total, entries, largest = self._map_error
            self._map_error = (
                total + float(error.sum()),
                entries + len(error),
                max(largest, float(np.abs(error).max())),
            )

    def _close(self, until_s: float) -> None:
        """Account the time from the open sample to `until_s`; it stays open from there on."""
        whole = until_s - self._since
        if whole <= 0:
            return
        robots, connected = self._open, self._open_link == _CONNECTED
        if not self._interrupted:
            self._close_whole(whole, until_s)
            return
        interrupted = np.zeros(len(robots))
        for i in list(self._interrupted):
            interrupted[robots == i] = sum(
                max(0.0, min(end, until_s) - max(begin, self._since))
                for begin, end in self._interrupted[i]
            )
            self._interrupted[i] = [span for span in self._interrupted[i] if span[1] > until_s]
            if not self._interrupted[i]:
                del self._interrupted[i]
        interrupted = np.minimum(interrupted, whole)
        rest = whole - interrupted
        self._since = until_s
        if not len(robots):
            return

        self._connected[robots] += np.where(connected, rest, 0.0)
        self._outage[robots] += np.where(connected, 0.0, rest)
        self._handover_time[robots] += interrupted
        self._outage_now[robots] = np.where(connected, 0.0, self._outage_now[robots] + rest)
        self._outage_worst = np.maximum(self._outage_worst, self._outage_now)
        self._delivered[robots] += self._open_rate * rest

        halted = interrupted > 0
        columns = (
            np.concatenate([robots, robots[halted]]).astype(np.int32),
            np.concatenate([self._open_rate, np.zeros(int(halted.sum()))]),
            np.concatenate([rest, interrupted[halted]]),
        )
        self._history.append(columns)
        self._rates.add(columns[1], columns[2])

    def _close_whole(self, whole: float, until_s: float) -> None:
        """The same, if nobody is interrupted, which is the rule."""
        robots, self._since = self._open, until_s
        if not len(robots):
            return
        lost = self._open_link != _CONNECTED
        if lost.any():
            out, robots_in = robots[lost], robots[~lost]
            self._outage[out] += whole
            self._outage_now[out] += whole
            self._outage_worst[out] = np.maximum(self._outage_worst[out], self._outage_now[out])
        else:
            robots_in = robots
        self._connected[robots_in] += whole
        self._outage_now[robots_in] = 0.0
        self._delivered[robots] += self._open_rate * whole
        seconds = np.full(len(robots), whole)
        self._history.append((robots.astype(np.int32), self._open_rate.copy(), seconds))
        self._rates.add(self._open_rate, seconds)

    def _add_load(self, load: ApLoad) -> None:
        a = self._ap[load.ap]
        slots, robot_slots, over = self._loads[a]
        over += max(0, load.load - load.capacity)
        self._loads[a] = slots + 1, robot_slots + load.load, over
        self._peak[a] = max(self._peak[a], load.load)
        share = load.load / max(1, load.capacity)  # an AP switched off by capacity 0
        self._peak_of_all = max(self._peak_of_all, (load.load, share))

    def _add_handover(self, handover: Handover) -> None:
        i = self._robot[handover.robot]
        self._handovers[i] += 1
        self._unplanned[i] += not handover.planned
        last = self._last_handover.get(i)
        self._last_handover[i] = handover
        if last is not None and (last.from_ap, last.to_ap) == (handover.to_ap, handover.from_ap):
            soon = handover.t_s - last.t_s < PING_PONG_SLOTS * self._start.slot_s
            self._ping_pongs[i] += soon
        spans = self._interrupted.setdefault(i, [])
        begin = max([handover.t_s, *(end for _, end in spans)])  # never count a time twice
        if handover.end_s > begin:
            spans.append((begin, handover.end_s))
        for row, name in enumerate((handover.to_ap, handover.from_ap)):
            if name in self._ap:
                self._moves[row, self._ap[name]] += 1

    def _travel(self, slot: int) -> Ints:
        """(N,) slots until arrival, or until the end of `slot` for those still under way."""
        so_far = np.where(self._arrival >= 0, self._arrival, slot + 1)
        return np.where(self._has_path, so_far, 0)

    def current(self, t_s: float, slot: int) -> Kpi:
        """Figures up to the end of `slot`, which is `t_s`.

        - makespan_slots: slot of the last arrival [slots], 0 before the first.
        - travel_slots: Σ over robots with a path of the slot of arrival, or slot + 1 [slots].
        - held_slots: number of (robot, slot) whose first state in the slot is HELD.
        - peak_load: greatest load of any AP in any slot [robots]; peak_load_share: that load
          over that AP's capacity (at least 1); of several such APs the one with the largest.
        - held_by_…: the same by the cause told; unplanned_handovers: those the plan does not have,
          ping_pongs: see `PING_PONG_SLOTS`; delays, replans: number of their records.
        - overload_robot_slots: Σ over APs and slots of max(0, load − capacity).
        - delivered_mbit: Σ rate · (d − h), see the head of this file [Mbit].
        - map_error_mean_db: mean of predicted − experienced SNR over all entries with an AP of
          all samples; map_error_max_db: the largest absolute value [dB].
        """
        self._close(t_s)
        arrived = self._arrival >= 0
        total, entries, largest = self._map_error
        return Kpi(
            t_s=t_s,
            slot=slot,
            robots=len(self._robot),
            arrived=int(arrived.sum()),
            makespan_slots=int(max(self._arrival, default=0)) if arrived.any() else 0,
            travel_slots=int(self._travel(slot).sum()),
            planned_travel_slots=int(self._planned_travel.sum()),
            handovers=int(self._handovers.sum()),
            planned_handovers=int(self._planned_handovers.sum()),
            held_slots=int(self._held.sum()),
            connected_s=float(self._connected.sum()),
            handover_s=float(self._handover_time.sum()),
            outage_s=float(self._outage.sum()),
            worst_outage_s=float(self._outage_worst.max(initial=0.0)),
            peak_load=self._peak_of_all[0],
            peak_load_share=self._peak_of_all[1],
            overload_robot_slots=sum(over for _, _, over in self._loads),
            delivered_mbit=float(self._delivered.sum()),
            p10_rate_mbps=self._rates.percentile_10(),
            min_clearance_m=self._clearance if np.isfinite(self._clearance) else NO_CLEARANCE_M,
            map_error_mean_db=total / entries if entries else 0.0,
            map_error_max_db=largest,
            incidents=self._incidents,
            planned_makespan_slots=int(self._planned_travel.max(initial=0)),
            unplanned_handovers=int(self._unplanned.sum()),
            ping_pongs=int(self._ping_pongs.sum()),
            **_by_cause(self._held_by.sum(axis=1)),
            delays=self._delays,
            replans=self._replans,
        )

    def final(self, t_s: float, slot: int) -> list[RobotKpi | ApKpi]:
        """Figures of each robot, then of each AP, in the order of `RunStart`.

        `t_s` is the end of the run, `slot` its last slot. waiting_slots counts the slots whose
        first state is WAITING; mean_load is the mean over the AP's load records [robots].
        """
        self._close(t_s)
        travel = self._travel(slot)
        p10 = self._percentiles()
        floor_s = self._connected + self._handover_time + self._outage
        robots = [
            RobotKpi(
                t_s=t_s,
                robot=name,
                arrived=bool(self._arrival[i] >= 0),
                travel_slots=int(travel[i]),
                planned_travel_slots=int(self._planned_travel[i]),
                handovers=int(self._handovers[i]),
                planned_handovers=int(self._planned_handovers[i]),
                waiting_slots=int(self._waiting[i]),
                held_slots=int(self._held[i]),
                connected_s=float(self._connected[i]),
                handover_s=float(self._handover_time[i]),
                outage_s=float(self._outage[i]),
                worst_outage_s=float(self._outage_worst[i]),
                delivered_mbit=float(self._delivered[i]),
                p10_rate_mbps=p10[i],
                mean_rate_mbps=float(self._delivered[i] / floor_s[i]) if floor_s[i] > 0 else 0.0,
                unplanned_handovers=int(self._unplanned[i]),
                ping_pongs=int(self._ping_pongs[i]),
                **_by_cause(self._held_by[:, i]),
            )
            for name, i in self._robot.items()
        ]
        aps = [
            ApKpi(
                t_s=t_s,
                ap=name,
                mean_load=robot_slots / slots if slots else 0.0,
                peak_load=self._peak[a],
                capacity=self._start.ap_capacity[a],
                overload_robot_slots=over,
                handovers_in=int(self._moves[0, a]),
                handovers_out=int(self._moves[1, a]),
            )
            for (name, a), (slots, robot_slots, over) in zip(
                self._ap.items(), self._loads, strict=True
            )
        ]
        return [*robots, *aps]

    def waits(self, t_s: float) -> Waits:
        """Who was held by whom: number of slots whose first state says so, by robot and other."""
        pairs = sorted(self._waits)
        return Waits(
            t_s=t_s,
            robot=tuple(i for i, _ in pairs),
            other=tuple(j for _, j in pairs),
            slots=tuple(self._waits[pair] for pair in pairs),
        )

    def _percentiles(self) -> list[float]:
        """P10 of each robot's rate [Mbit/s]."""
        n = len(self._robot)
        if not self._history:
            return [0.0] * n
        robot, rate, seconds = (np.concatenate(part) for part in zip(*self._history, strict=True))
        order = np.argsort(robot, kind="stable")
        first = np.searchsorted(robot[order], np.arange(n + 1))
        found = []
        for i in range(n):
            own = order[first[i] : first[i + 1]]
            rates = Distribution()
            rates.add(rate[own], seconds[own])
            found.append(rates.percentile_10())
        return found


def _by_cause(counts: Ints) -> dict[str, int]:
    """The fields `held_by_…` of the figures from counts in the order of `CAUSES`."""
    return {
        f"held_by_{cause.replace('-', '_')}": int(n)
        for cause, n in zip(CAUSES, counts, strict=True)
    }
