"""Step 3 of validation, the radio: who serves whom, and how well.

Handovers are followed record by record, so each change of the AP has its record and each record its
change. SNRs are computed anew: a ray in a fresh scene for each place, the channel's formulas, and
the fading of the radio map; where something moves, with all that moves in its place at that sample.
Link and rate follow from SNR and interruptions.

An AP that is out serves nobody, and nobody else loses its AP. A handover that is not in the plan
needs its reason: at the sample before, the new AP reached the threshold, and the old one was lost,
or below the threshold and worse by the hysteresis, or not the plan's.
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
from logs.validate_context import (
    DECIBELS,
    METRES,
    STEP,
    Bools,
    Context,
    Floats,
    Ints,
    SlotView,
)
from logs.validate_disturbances import DisturbanceCheck, Truth
from logs.validate_incidents import IncidentCheck
from logs.validate_scene import Bodies
from worlds.channel import data_rate_mbps
from worlds.link import LinkModel

if TYPE_CHECKING:
    from worlds.scene import Scene

_HANDOVER, _SNR, _LINK, _RATE = "page5:handover", "page5:snr", "page5:link", "page5:rate"
_CONNECTED_AT, _HANDOVER_AT, _OUTAGE_AT, _NO_AP_AT = (
    LINKS.index(n) for n in (CONNECTED, HANDOVER, OUTAGE, NO_AP)
)
_NO_SNR_DB = -1000.0
_ENTRIES_AT_ONCE = 100_000
_SECONDS = 1e-6
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
    ) -> None:
        n = len(context.start.robots)
        self._context, self._truth = context, truth
        self._bodies = Bodies(context, scene, truth, disturbances)
        self.unplanned: Bools = np.zeros(n, np.bool_)
        """Robots whose last handover was not planned."""
        self._place: Floats = np.full((n, 3), np.nan)  # x, y and fading at the last sample
        self._incidents = incidents
        self._scene = scene
        self._links = LinkModel(context.inputs.world)
        problem = context.inputs.problem
        # The last AP is none, which covers nothing; the last edge is none, too.
        self._cover = np.pad(problem.cover, ((0, 0), (0, 1)))
        self._edge_cover = np.pad(problem.edge_cover, ((0, 1), (0, 1)))
        self._ap = np.full(n, -1, np.int64)  # that serves now: at first the plan's
        for i, walk in enumerate(context.itinerary.walks):
            if walk is not None:
                self._ap[i] = walk.ap[0]
        self._until_ns = np.zeros(n, np.int64)  # end of the last interruption
        self._spans: dict[int, list[tuple[float, float]]] = {}  # interruptions that may matter
        self._shown = np.full((n, 2), -1, np.int64)  # AP and link of the last state
        self._stated_ns = np.full(n, -1, np.int64)  # its time
        self._stated = np.zeros((n, 2))  # its SNR and rate
        self._sampled = np.full((n, 2), np.nan)  # SNR and time [s] of the last sample
        self._handovers: dict[int, Handover] = {}  # of the slot, by robot
        self._outages: dict[int, tuple[float, int]] = {}  # beginning [s] and AP
        self._queue: list[tuple[int, Ints, Ints, Floats]] = []
        self._queued = 0

    def _find(self, rule: str, found: object, expected: object, slot: int, robot: str = "") -> None:
        self._context.checks.find(STEP, rule, found, expected, slot=slot, robot=robot)

    def _ap_name(self, ap: int) -> str:
        return self._context.start.aps[ap] if ap >= 0 else "none"

    # --- handovers ----------------------------------------------------------------------------

    def add_handover(self, handover: Handover, view: SlotView | None) -> None:
        """A change of the AP."""
        context, start = self._context, self._context.start
        i = context.robot[handover.robot]
        slot, robot, now = handover.slot, handover.robot, time_ns(handover.t_s)
        context.checks.count(STEP, _HANDOVER)
        if i in self._handovers:
            self._find("§1.7", "a second handover in a slot", "at most one", slot, robot)
        self._handovers[i] = handover
        before, after = context.ap.get(handover.from_ap, -1), context.ap.get(handover.to_ap, -1)
        if before != self._ap[i] or after < 0 or after == before:
            self._find(
                _HANDOVER,
                f"a handover from {handover.from_ap!r} to {handover.to_ap!r}",
                f"from {self._ap_name(int(self._ap[i]))}, which serves it, to another AP",
                slot,
                robot,
            )
        self._ap[i] = after
        lasts = handover.end_s - handover.t_s
        if not abs(lasts - start.interruption_s) <= _SECONDS:
            self._find(_HANDOVER, f"lasts {lasts} s", f"{start.interruption_s} s", slot, robot)
        self.unplanned[i] = not handover.planned
        if not self._truth.is_up(after, now):
            self._find(_HANDOVER, f"to {handover.to_ap}, which is out", "an AP that works", slot,
                       robot)  # fmt: skip
        self._check_reason(handover, i, before, after, view)
        begins, ends = context.t_ns(slot), context.t_ns(slot + 1)
        if not begins < now <= ends or view is None or view.slot != slot:
            self._find(_HANDOVER, f"at {handover.t_s} s", "within its slot", slot, robot)
        else:
            self._check_place(handover, i, view, (now - begins) / (ends - begins))
        self._until_ns[i] = time_ns(handover.end_s)
        spans = self._spans.get(i, []) if i in self._outages else self._spans.get(i, [])[-1:]
        if spans:  # a new handover cuts one that still lasts
            spans[-1] = (spans[-1][0], min(spans[-1][1], handover.t_s))
        self._spans[i] = [*spans, (handover.t_s, handover.end_s)]

    def _check_reason(
        self, handover: Handover, i: int, before: int, after: int, view: SlotView | None
    ) -> None:
        """A planned handover is in the path, another one has its reason."""
        slot, robot = handover.slot, handover.robot
        walk = self._context.itinerary.walks[i]
        k = int(np.searchsorted(view.robot, i)) if view is not None else 0
        if walk is None or view is None or k == len(view.robot) or view.robot[k] != i:
            return  # `_check_place` finds it
        visit = min(int(view.visit[k]), walk.last)
        # On an edge of several slots the change may come before the last of them (§1.6).
        left = int(view.slots[k] - view.piece[k]) if view.edge[k] >= 0 else 1
        end = min(visit + left, walk.last)
        if handover.planned:
            planned = (int(walk.ap[visit]), int(walk.ap[end]))
            if (before, after) != planned or not view.advances[k]:
                found = f"a planned handover {handover.from_ap} to {handover.to_ap}"
                expected = f"{self._ap_name(planned[0])} to {self._ap_name(planned[1])} by its path"
                self._find(_HANDOVER, found, expected, slot, robot)
            return
        if not self._truth.affects_radio:
            self._find(_HANDOVER, "an unplanned handover", "planned ones only", slot, robot)
            return
        place, fading = self._place[i, None, :2], self._place[i, 2:]
        heard = {a: float(self._bodies.snr_db([i], np.array([a]), place, fading)[0])
                 for a in {before, after} if a >= 0}  # fmt: skip
        threshold = self._context.start.threshold_db
        gain = self._context.inputs.world.run.hysteresis_db
        old = heard.get(before, _NO_SNR_DB)
        to_plan = after in {int(walk.ap[visit]), int(walk.ap[end])}
        good = before >= 0 and old >= threshold
        need = threshold + (gain if good else 0.0)
        if not to_plan and before >= 0:
            need = max(threshold, old + gain)
        if heard[after] < need - DECIBELS or (good and not to_plan):
            found = f"an unplanned handover to {handover.to_ap} of {heard[after]:.3f} dB"
            expected = f"{need:.3f} dB or more, and a reason to leave {old:.3f} dB"
            self._find(_HANDOVER, found, expected, slot, robot)

    def _check_place(self, handover: Handover, i: int, view: SlotView, share: float) -> None:
        place = np.flatnonzero(view.robot == i)
        if not len(place):
            self._find(
                _HANDOVER, "a handover", "none: not on the floor", handover.slot, handover.robot
            )
            return
        k = int(place[0])
        found = (handover.vertex, handover.next_vertex)
        expected = (int(view.vertex[k]), int(view.next_vertex[k]))
        x, y = ((1.0 - share) * view.start_m[k] + share * view.end_m[k]).tolist()
        off = np.hypot(handover.x_m - x, handover.y_m - y)
        if found != expected or not off <= METRES:
            self._find(
                _HANDOVER,
                f"between vertices {found} at ({handover.x_m:.6f}, {handover.y_m:.6f}) m",
                f"{expected} at ({x:.6f}, {y:.6f}) m",
                handover.slot,
                handover.robot,
            )

    # --- states and samples -------------------------------------------------------------------

    def add_state(self, state: RobotState) -> None:
        """A robot's link at the beginning of a slot, or when it changes."""
        if state.activity == GONE:
            return
        context = self._context
        i = context.robot[state.robot]
        ap, link = context.ap.get(state.ap, -1), LINKS.index(state.link)
        now = time_ns(state.t_s)
        context.checks.count(STEP, _LINK)
        if not self._truth.is_up(ap, self._sample_ns(state)):  # APs go out at sample instants
            found = f"at {state.t_s} s served by {state.ap}, which is out"
            self._find(_HANDOVER, found, "by none, or by another AP", state.slot, state.robot)
        if ap < 0 and self._may_lose(i, now):
            self._ap[i] = -1
        if ap != self._ap[i]:
            self._find(
                _HANDOVER,
                f"at {state.t_s} s its state is served by {state.ap or 'none'}",
                f"{self._ap_name(int(self._ap[i]))}, no handover having been told",
                state.slot,
                state.robot,
            )
            self._ap[i] = ap
        if now < self._until_ns[i] and link != _HANDOVER_AT and ap >= 0:
            self._find(_LINK, f"{state.link} at {state.t_s} s", HANDOVER, state.slot, state.robot)
        self._shown[i] = ap, link
        self._stated_ns[i] = now
        self._stated[i] = state.snr_db, state.rate_mbps
        if now != self._sample_ns(state):  # at a sample, the sample itself is compared
            if now == self._until_ns[i]:
                self._check_after_handover(i, state, link)
            else:
                found = f"a state at {state.t_s} s, where nothing changes"
                self._find(_LINK, found, "states where a link changes", state.slot, state.robot)

    def _may_lose(self, i: int, now_ns: int) -> bool:
        """Whether the AP that serves robot i is out at a time."""
        return bool(self._ap[i] >= 0 and not self._truth.is_up(int(self._ap[i]), now_ns))

    def _sample_ns(self, state: RobotState) -> int:
        """The sample instant at or before a state [ns]."""
        context = self._context
        begin = context.t_ns(state.slot)
        part = context.start.slot_s * 1e9 / context.steps
        step = int((time_ns(state.t_s) - begin + 1) // part)
        return context.t_ns(state.slot, step)

    def _check_after_handover(self, i: int, state: RobotState, link: int) -> None:
        """A handover that ends between two samples: what was measured last holds again."""
        snr = self._sampled[i, 0]
        good = snr >= self._context.start.threshold_db
        expected = _CONNECTED_AT if good else _OUTAGE_AT
        rate = float(data_rate_mbps(snr, self._context.inputs.world.radio)) if good else 0.0
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

        out = np.array(
            [not self._truth.is_up(a, now) for a in range(len(context.start.aps))] + [False]
        )
        self._ap[robot[out[self._ap[robot]]]] = -1
        wrong = ap != self._ap[robot]
        context.each(
            _HANDOVER,
            slot,
            robot,
            wrong,
            f"{when} served, without a handover, by",
            names[ap],
            names[self._ap[robot]],
        )
        self._ap[robot[wrong]] = ap[wrong]
        if not self._truth.affects_radio:
            some = np.full(len(ap), "exactly one AP")
            context.each("§1.6", slot, robot, ap < 0, f"{when} served by", names[ap], some)

        self._until_ns[robot[ap < 0]] = np.minimum(self._until_ns[robot[ap < 0]], now)
        left_ns = self._until_ns[robot] - now
        measured = np.where(snr < threshold, _OUTAGE_AT, _CONNECTED_AT)
        measured[ap < 0] = _NO_AP_AT
        expected = np.where(left_ns > 0, _HANDOVER_AT, measured)
        wrong = link != expected
        wrong &= (np.abs(left_ns) > _ROUNDING_NS) | ((link != measured) & (link != _HANDOVER_AT))
        words = np.array(LINKS)
        context.each(_LINK, slot, robot, wrong, when, words[link], words[expected])
        flows = link == _CONNECTED_AT
        expected_rate = np.where(flows, data_rate_mbps(snr, context.inputs.world.radio), 0.0)
        off = ~(np.abs(rate - expected_rate) <= DECIBELS * np.maximum(1.0, expected_rate))
        context.each(_RATE, slot, robot, off, f"{when} rate [Mbit/s]", rate, expected_rate)

        shown = (self._shown[robot] != np.column_stack([ap, link])).any(axis=1)
        shown &= slot <= context.last  # at the run's last instant there are no states
        context.each(
            _LINK,
            slot,
            robot,
            shown,
            f"{when} the last state says AP, link",
            self._shown[robot],
            np.column_stack([ap, link]),
        )
        same_time = self._stated_ns[robot] == now
        told, real = self._stated[robot], np.column_stack([snr, rate])
        unequal = same_time & ~(np.abs(told - real) <= DECIBELS).all(axis=1)
        context.each(_LINK, slot, robot, unequal, f"{when} state says SNR, rate", told, real)

        self._sampled[robot, 0] = snr
        self._check_prediction(slot, view, there, step, ap, predicted, snr)
        nothing = (ap < 0) & ((snr != _NO_SNR_DB) | (predicted != _NO_SNR_DB))
        silent = np.full(len(ap), _NO_SNR_DB)
        context.each(_SNR, slot, robot, nothing, f"{when} without an AP, SNR [dB]", snr, silent)
        xy = np.column_stack([sample.x_m, sample.y_m])[here].reshape(-1, 2)
        fading = self._fading(view, there, step, ap)
        served = ap >= 0
        entries = np.column_stack([xy, fading, snr])[served]
        heading = np.array(sample.heading_rad, np.float64)[here]
        self._place[robot] = np.column_stack([xy, fading])
        if self._bodies.needed:
            self._bodies.place(robot, xy, heading)
            self._compare_now(slot, robot[served], ap[served], entries)
        elif len(entries):
            self._queue.append((slot, robot[served], ap[served], entries))
        self._queued += len(entries)
        if self._queued > _ENTRIES_AT_ONCE:
            self.flush()
        self._follow_outages(sample.t_s, robot, ap, snr < threshold)

    def _share_from_u(self, view: SlotView, there: Ints, step: int) -> tuple[Ints, Floats]:
        """Edge of the floor (−1 at a vertex) and share of the way from its u."""
        context = self._context
        edge = view.edge[there]
        share = view.fraction(step, context.steps)[there]
        from_u = context.inputs.problem.edge_uv[edge, 0] == view.vertex[there]
        on_floor = np.where(edge >= 0, context.floor_edge[edge], -1)
        return on_floor, np.where(from_u, share, 1.0 - share)

    def _fading(self, view: SlotView, there: Ints, step: int, ap: Ints) -> Floats:
        """(n,) fading of the radio map, linear along an edge [dB]."""
        radio_map, floor = self._context.inputs.radio_map, self._context.inputs.floor
        vertex = self._context.floor_vertex[view.vertex[there]]
        fading = radio_map.fading_db[vertex, ap]
        edge, share = self._share_from_u(view, there, step)
        on = edge >= 0
        u, v = floor.edge_uv[edge[on]].T
        at_u, at_v = radio_map.fading_db[u, ap[on]], radio_map.fading_db[v, ap[on]]
        fading[on] = (1.0 - share[on]) * at_u + share[on] * at_v
        return fading

    def _check_prediction(
        self,
        slot: int,
        view: SlotView,
        there: Ints,
        step: int,
        ap: Ints,
        predicted: Floats,
        snr: Floats,
    ) -> None:
        """`map_snr_db` is what the radio map says of the place, linear between its samples."""
        radio_map = self._context.inputs.radio_map
        expected = radio_map.snr_db[self._context.floor_vertex[view.vertex[there]], ap]
        edge, share = self._share_from_u(view, there, step)
        on = np.flatnonzero(edge >= 0)
        gaps = radio_map.edge_snr_db.shape[1] - 1
        low = np.minimum((share[on] * gaps).astype(np.int64), gaps - 1)
        part = share[on] * gaps - low
        rows = radio_map.edge_snr_db[edge[on], :, ap[on]]
        k = np.arange(len(on))
        expected[on] = (1.0 - part) * rows[k, low] + part * rows[k, low + 1]
        off = ~(np.abs(predicted - expected) <= DECIBELS) & (ap >= 0)
        what = "SNR of the radio map [dB]"
        self._context.each(_SNR, slot, view.robot[there], off, what, predicted, expected)

    def _compare_now(self, slot: int, robot: Ints, ap: Ints, entries: Floats) -> None:
        """SNRs of a sample, with all that moves in its place."""
        snr = self._bodies.snr_db(robot.tolist(), ap, entries[:, :2], entries[:, 2])
        off = ~(np.abs(snr - entries[:, 3]) <= DECIBELS)
        what = "SNR by a ray cast anew [dB]:"
        self._context.each(_SNR, slot, robot, off, what, entries[:, 3], snr)

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
        name, ap_name = self._context.name(i), self._ap_name(ap) if ap >= 0 else ""
        self._incidents.expect("outage", time_ns(now), (name,), ap_name, now - begin - lost)

    # --- a slot is over -----------------------------------------------------------------------

    def close(self, view: SlotView, deviates: Bools) -> None:
        """Served by APs that cover vertex (§1.6) and crossing (§1.7), handovers allowed (§1.7)."""
        context, problem = self._context, self._context.inputs.problem
        cover, edge_cover = self._cover, self._edge_cover
        names = np.array([*context.start.aps, "none"])
        # Where the radio is disturbed, APs that the plan does not have need not cover by the map.
        strange = deviates[view.robot] | self.unplanned[view.robot]
        if self._truth.affects_radio:  # who has to stay keeps the AP it has found
            walks = [context.itinerary.walks[i] for i in view.robot.tolist()]
            strange |= np.array([w is not None and not w.to_goal for w in walks], np.bool_)
        stands = (view.piece == 0) & ~strange
        wrong = stands & ~cover[view.vertex, view.ap]
        what = "at a vertex served by"
        expected = np.full(len(stands), "an AP that covers the vertex")
        context.each("§1.6", view.slot, view.robot, wrong, what, names[view.ap], expected)

        after = self._ap[view.robot]
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
        self._handovers.clear()

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
        checks.count(STEP, _SNR, len(snr))
        for k in np.flatnonzero(wrong).tolist():
            checks.find(
                STEP,
                _SNR,
                f"{snr[k]} dB from {self._ap_name(int(ap[k]))} at ({x[k]:.3f}, {y[k]:.3f}) m",
                f"{expected[k]} dB by a ray cast anew",
                slot=int(slots[k]),
                robot=self._context.name(int(robot[k])),
            )

    def finish(self, end_s: float) -> None:
        """The run is over."""
        for i in list(self._outages):
            self._end_outage(i, end_s)
        self.flush()
