"""Step 3 of validation, the radio: what links do, how fast they are, and who covers whom.

SNRs are computed anew (`validate_snr`), handovers followed from reason to record
(`validate_handovers`). Link and rate follow from SNR and interruptions, and outages from links.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from logs.mcap_format import time_ns
from logs.records import (
    CONNECTED,
    GONE,
    HANDOVER,
    LINKS,
    NO_AP,
    OUTAGE,
    Handover,
    RobotState,
    Sample,
)
from logs.validate_context import DECIBELS, STEP, Bools, Context, Ints, SlotView
from logs.validate_disturbances import DisturbanceCheck, Truth
from logs.validate_handovers import HandoverCheck
from logs.validate_incidents import IncidentCheck
from logs.validate_serving import PlannedServing
from logs.validate_snr import SnrCheck
from worlds.channel import data_rate_mbps

if TYPE_CHECKING:
    from worlds.scene import Scene

_LINK, _RATE = "page5:link", "page5:rate"
_CONNECTED_AT, _HANDOVER_AT, _OUTAGE_AT, _NO_AP_AT = (
    LINKS.index(n) for n in (CONNECTED, HANDOVER, OUTAGE, NO_AP)
)
_ROUNDING_NS = 2  # a handover that ends with a sample may end on either side of it


class RadioCheck:
    """Follows every robot's link from record to record."""

    def __init__(
        self,
        context: Context,
        incidents: IncidentCheck,
        scene: Scene,
        truth: Truth,
        disturbances: DisturbanceCheck,
        serving: PlannedServing,
    ) -> None:
        n = len(context.start.robots)
        self._context, self._truth = context, truth
        self._snr = SnrCheck(context, scene, truth, disturbances)
        self._handovers = HandoverCheck(context, truth, self._snr, serving)
        self._incidents = incidents
        problem = context.inputs.problem
        # The last AP is none, which covers nothing; the last edge is none, too.
        self._cover = np.pad(problem.cover, ((0, 0), (0, 1)))
        self._edge_cover = np.pad(problem.edge_cover, ((0, 1), (0, 1)))
        self._spans: dict[int, list[tuple[float, float]]] = {}  # interruptions that may matter
        self._shown = np.full((n, 2), -1, np.int64)  # AP and link of the last state
        self._stated_ns = np.full(n, -1, np.int64)  # its time
        self._stated = np.zeros((n, 2))  # its SNR and rate
        self._sampled = np.full(n, np.nan)  # SNR of the last sample
        self._sharing = np.ones(n)  # robots that were served by the same AP at it
        self._outages: dict[int, tuple[float, int]] = {}  # beginning [s] and AP

    def _find(self, rule: str, found: object, expected: object, slot: int, robot: str = "") -> None:
        self._context.checks.find(STEP, rule, found, expected, slot=slot, robot=robot)

    def serving(self, i: int) -> int:
        """The AP that serves robot i now, −1 for none."""
        return int(self._handovers.ap[i])

    # --- records ------------------------------------------------------------------------------

    def add_handover(self, handover: Handover, view: SlotView | None) -> None:
        """A change of the AP."""
        self._handovers.add(handover, view)
        i = self._context.robot[handover.robot]
        spans = self._spans.get(i, []) if i in self._outages else self._spans.get(i, [])[-1:]
        if spans:  # a new handover cuts one that still lasts
            spans[-1] = (spans[-1][0], min(spans[-1][1], handover.t_s))
        self._spans[i] = [*spans, (handover.t_s, handover.end_s)]

    def add_state(self, state: RobotState) -> None:
        """A robot's link at the beginning of a slot, or when it changes."""
        if state.activity == GONE:
            return
        context = self._context
        i = context.robot[state.robot]
        ap, link = context.ap.get(state.ap, -1), LINKS.index(state.link)
        now, sample_ns = time_ns(state.t_s), self._sample_ns(state)
        context.checks.count(STEP, _LINK)
        self._handovers.add_state(state, sample_ns)
        until = self._handovers.until_ns[i]
        if now < until and link != _HANDOVER_AT and ap >= 0:
            self._find(_LINK, f"{state.link} at {state.t_s} s", HANDOVER, state.slot, state.robot)
        self._shown[i] = ap, link
        self._stated_ns[i] = now
        self._stated[i] = state.snr_db, state.rate_mbps
        if now != sample_ns:  # at a sample, the sample itself is compared
            if now == until:
                self._check_after_handover(i, state, link)
            else:
                found = f"a state at {state.t_s} s, where nothing changes"
                self._find(_LINK, found, "states where a link changes", state.slot, state.robot)

    def _sample_ns(self, state: RobotState) -> int:
        """The sample instant at or before a state [ns]."""
        context = self._context
        begin = context.t_ns(state.slot)
        part = context.start.slot_s * 1e9 / context.steps
        step = int((time_ns(state.t_s) - begin + 1) // part)
        return context.t_ns(state.slot, step)

    def _check_after_handover(self, i: int, state: RobotState, link: int) -> None:
        """A handover that ends between two samples: what was measured last holds again."""
        snr = self._sampled[i]
        good = snr >= self._context.start.threshold_db
        expected = _CONNECTED_AT if good else _OUTAGE_AT
        radio = self._context.inputs.world.radio
        rate = float(data_rate_mbps(snr, radio, self._sharing[i])) if good else 0.0
        told = (state.link, state.snr_db, state.rate_mbps)
        if (
            link != expected
            or not abs(state.snr_db - snr) <= DECIBELS
            or not abs(state.rate_mbps - rate) <= DECIBELS * max(1.0, rate)
        ):
            self._find(
                _LINK,
                f"link, SNR, rate after a handover: {told}",
                (LINKS[expected], float(snr), rate),
                state.slot,
                state.robot,
            )

    def add_sample(self, sample: Sample, view: SlotView, step: int) -> None:
        """All links at one instant."""
        context, slot, now = self._context, sample.slot, time_ns(sample.t_s)
        threshold = context.start.threshold_db
        _, here, there = np.intersect1d(sample.robot, view.robot, return_indices=True)
        robot: Ints = np.array(sample.robot, np.int64)[here]
        ap: Ints = np.array(sample.ap, np.int64)[here]
        snr, predicted, rate = (
            np.array(column, np.float64)[here]
            for column in (sample.snr_db, sample.map_snr_db, sample.rate_mbps)
        )
        link: Ints = np.array(sample.link, np.int64)[here]
        when = f"at {sample.t_s} s"
        names = np.array([*context.start.aps, "none"])
        self._handovers.add_sample(sample, robot, ap, step)
        if not self._truth.affects_radio:
            some = np.full(len(ap), "exactly one AP")
            context.each("§1.6", slot, robot, ap < 0, f"{when} served by", names[ap], some)

        left_ns = self._handovers.until_ns[robot] - now
        measured = np.where(snr < threshold, _OUTAGE_AT, _CONNECTED_AT)
        measured[ap < 0] = _NO_AP_AT
        expected = np.where(left_ns > 0, _HANDOVER_AT, measured)
        wrong = link != expected
        wrong &= (np.abs(left_ns) > _ROUNDING_NS) | ((link != measured) & (link != _HANDOVER_AT))
        words = np.array(LINKS)
        context.each(_LINK, slot, robot, wrong, when, words[link], words[expected])
        flows = link == _CONNECTED_AT
        # As many places in the sample have this AP; who has none shares with nobody.
        every = np.array(sample.ap, np.int64)
        sharing = np.maximum((ap[:, None] == every[None, every >= 0]).sum(axis=1), 1)
        alone = data_rate_mbps(snr, context.inputs.world.radio, sharing)
        expected_rate = np.where(flows, alone, 0.0)
        off = ~(np.abs(rate - expected_rate) <= DECIBELS * np.maximum(1.0, expected_rate))
        context.each(_RATE, slot, robot, off, f"{when} rate [Mbit/s]", rate, expected_rate)

        pair = np.column_stack([ap, link])
        shown = (self._shown[robot] != pair).any(axis=1)
        shown &= slot <= context.last  # at the run's last instant there are no states
        what = f"{when} the last state says AP, link"
        context.each(_LINK, slot, robot, shown, what, self._shown[robot], pair)
        same_time = self._stated_ns[robot] == now
        told, real = self._stated[robot], np.column_stack([snr, rate])
        unequal = same_time & ~(np.abs(told - real) <= DECIBELS).all(axis=1)
        context.each(_LINK, slot, robot, unequal, f"{when} state says SNR, rate", told, real)

        self._sampled[robot], self._sharing[robot] = snr, sharing
        xy = np.column_stack([sample.x_m, sample.y_m])[here].reshape(-1, 2)
        share = view.fraction(step, context.steps)[there]
        self._snr.place(robot, xy, np.array(sample.heading_rad, np.float64)[here])
        self._snr.check(view, there, share, ap, xy, snr, predicted, when)
        if slot <= context.last:
            columns = (ap, snr, predicted, link)
            self._handovers.look(view, there, step, columns, xy, share)
        self._follow_outages(sample.t_s, robot, ap, snr < threshold)

    # --- outages ------------------------------------------------------------------------------

    def _follow_outages(self, now: float, robot: Ints, ap: Ints, below: Bools) -> None:
        for i in np.setdiff1d(list(self._outages), robot).tolist():
            self._end_outage(i, now)
        if self._outages:
            for i in robot[~below].tolist():
                if i in self._outages:
                    self._end_outage(i, now)
        for i, a in zip(robot[below].tolist(), ap[below].tolist(), strict=True):
            self._outages.setdefault(i, (now, a))

    def _end_outage(self, i: int, now: float) -> None:
        begin, ap = self._outages.pop(i)
        lost = sum(
            max(0.0, min(end, now) - max(start, begin)) for start, end in self._spans.get(i, ())
        )
        name, ap_name = self._context.name(i), self._handovers.name(ap) if ap >= 0 else ""
        self._incidents.expect("outage", time_ns(now), (name,), ap_name, now - begin - lost)

    # --- a slot is over -----------------------------------------------------------------------

    def close(self, view: SlotView, deviates: Bools) -> None:
        """Served by APs that cover vertex (§1.6) and crossing (§1.7), handovers allowed (§1.7)."""
        context, problem = self._context, self._context.inputs.problem
        cover, edge_cover = self._cover, self._edge_cover
        names = np.array([*context.start.aps, "none"])
        # Where the radio is disturbed, APs that the plan does not have need not cover by the map.
        strange = deviates[view.robot] | self._handovers.unplanned[view.robot]
        if self._truth.affects_radio:  # who has to stay keeps the AP it has found
            walks = [context.itinerary.walks[i] for i in view.robot.tolist()]
            strange |= np.array([w is not None and not w.to_goal for w in walks], np.bool_)
        stands = (view.piece == 0) & ~strange
        wrong = stands & ~cover[view.vertex, view.ap]
        what = "at a vertex served by"
        expected = np.full(len(stands), "an AP that covers the vertex")
        context.each("§1.6", view.slot, view.robot, wrong, what, names[view.ap], expected)

        self._handovers.close(view.slot)
        after = self._handovers.ap[view.robot]
        kept = after == view.load_ap
        done = view.moves & (view.piece == view.slots - 1)
        stays = done & kept & ~edge_cover[view.edge, after]
        u = np.append(problem.edge_uv[:, 0], -1)[view.edge]
        at_u = np.where(u == view.vertex, view.load_ap, after)
        at_v = np.where(u == view.vertex, after, view.load_ap)
        allowed = np.ones(len(view.robot), np.bool_)
        served = (at_u >= 0) & (at_v >= 0) & (view.edge >= 0)
        allowed[served] = problem.edge_handover[view.edge[served], at_u[served], at_v[served]]
        crossing = done & ~kept & ~allowed
        waiting = (view.edge < 0) & ~kept & ~cover[view.vertex, after]
        pair = np.column_stack([names[view.load_ap], names[after]])
        expected = np.full(len(stands), "APs that cover edge or vertex as this needs")
        strange |= (after < 0) | (view.load_ap < 0) | (after != self._due(view, after))
        wrong = (stays | crossing | waiting) & ~strange
        context.each("§1.7", view.slot, view.robot, wrong, "from AP to AP", pair, expected)

    def _due(self, view: SlotView, after: Ints) -> Ints:
        """(n,) AP each robot's path has at the slot's end; `after` if nothing disturbs."""
        if not self._truth.affects_radio:
            return after
        walks = [self._context.itinerary.walks[i] for i in view.robot.tolist()]
        then = (view.visit + view.advances).tolist()
        return np.array(
            [
                a if walk is None else int(walk.ap[min(k, walk.last)])
                for walk, k, a in zip(walks, then, after.tolist(), strict=True)
            ],
            np.int64,
        )

    def finish(self, end_s: float) -> None:
        """The run is over."""
        for i in list(self._outages):
            self._end_outage(i, end_s)
        self._snr.flush()
