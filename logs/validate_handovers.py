"""Step 3 of validation, handovers: each change of the AP has its record, its place and its reason.

Which handovers there are follows from what was told before, instant by instant, by the rules of
docs/execution.md:

- A planned one is made at the instant that the radio map gives for it (`validate_serving`), if the
  AP that the path has until then serves, and the next one works.
- One that is not planned is made when a robot has wished for the same AP at all instants of
  `time_to_trigger_s`. It wishes unless an interruption lasts, or its path's AP serves it and is
  good or, by the map's word, is not: for its path's AP, if that reaches the threshold (and the
  hysteresis, if the one that serves is good, too); else, if it has none that is good, for the
  loudest that reaches the threshold and is better than its own by the hysteresis.

So from each sample those of the next instant are derived, with SNRs by rays cast anew, and compared
with what is told. An AP that is out serves nobody, and nobody else loses its AP.
"""

from __future__ import annotations

import numpy as np

from logs.mcap_format import time_ns
from logs.records import GONE, LINKS, RobotState, Sample
from logs.records import HANDOVER as INTERRUPTED
from logs.records import Handover as HandoverRecord
from logs.validate_context import DECIBELS, METRES, STEP, Bools, Context, Floats, Ints, SlotView
from logs.validate_disturbances import Truth
from logs.validate_serving import PlannedServing
from logs.validate_snr import SnrCheck

RULE = "page5:handover"
_INTERRUPTED_AT = LINKS.index(INTERRUPTED)
_SECONDS = 1e-6

Outcome = tuple[int, int, bool] | None
"""A handover from one AP (−1: none) to another, planned or not; or none."""


class HandoverCheck:
    """Follows which AP serves each robot, and why that changes.

    Attributes:
        ap: (N,) that serves now, −1 for none; at first the plan's.
        unplanned: (N,) bool, robots whose last handover was not planned.
        until_ns: (N,) end of the last interruption.
    """

    def __init__(
        self, context: Context, truth: Truth, snr: SnrCheck, serving: PlannedServing
    ) -> None:
        n = len(context.start.robots)
        self._context, self._truth, self._snr = context, truth, snr
        self._planned = serving
        self.ap: Ints = np.full(n, -1, np.int64)
        for i, walk in enumerate(context.itinerary.walks):
            if walk is not None:
                self.ap[i] = walk.ap[0]
        self.unplanned: Bools = np.zeros(n, np.bool_)
        self.until_ns: Ints = np.zeros(n, np.int64)
        self._made: dict[int, tuple[int, Outcome]] = {}  # instant and handover of the slot
        self._due: dict[int, set[Outcome]] = {}  # what may happen at the instant `_due_at`
        self._due_at = (0, 0)
        self._serving: tuple[int, tuple[Ints, Ints, Ints, Bools]] | None = None
        # What each robot may wish for, and since when: at the earliest, at the latest [ns].
        self._wishes: dict[int, dict[int, tuple[int, int]]] = {}

    def _find(self, rule: str, found: object, expected: object, slot: int, robot: str = "") -> None:
        self._context.checks.find(STEP, rule, found, expected, slot=slot, robot=robot)

    def name(self, ap: int) -> str:
        """An AP's id, or "none"."""
        return self._context.start.aps[ap] if ap >= 0 else "none"

    # --- what is told -------------------------------------------------------------------------

    def add(self, handover: HandoverRecord, view: SlotView | None) -> None:
        """A change of the AP."""
        context = self._context
        i, slot, robot = context.robot[handover.robot], handover.slot, handover.robot
        now = time_ns(handover.t_s)
        context.checks.count(STEP, RULE)
        if i in self._made:
            self._find("§1.7", "a second handover in a slot", "at most one", slot, robot)
        before, after = context.ap.get(handover.from_ap, -1), context.ap.get(handover.to_ap, -1)
        if before != self.ap[i] or after < 0 or after == before:
            expected = f"from {self.name(int(self.ap[i]))}, which serves it, to another AP"
            found = f"a handover from {handover.from_ap!r} to {handover.to_ap!r}"
            self._find(RULE, found, expected, slot, robot)
        self.ap[i] = after
        lasts = handover.end_s - handover.t_s
        if not abs(lasts - context.start.interruption_s) <= _SECONDS:
            expected = f"{context.start.interruption_s} s"
            self._find(RULE, f"lasts {lasts} s", expected, slot, robot)
        self.unplanned[i] = not handover.planned
        if not handover.planned:
            self._wishes.pop(i, None)
            if not self._truth.affects_radio:
                self._find(RULE, "an unplanned handover", "planned ones only", slot, robot)
        if not self._truth.is_up(after, now):
            self._find(RULE, f"to {handover.to_ap}, which is out", "an AP that works", slot, robot)
        self.until_ns[i] = time_ns(handover.end_s)
        begins, ends = context.t_ns(slot), context.t_ns(slot + 1)
        step = round((now - begins) / (ends - begins) * context.steps)
        self._made[i] = step, (before, after, handover.planned)
        on_time = 1 <= step <= context.steps and now == context.t_ns(slot, step)
        if not on_time or view is None or view.slot != slot:
            self._find(RULE, f"at {handover.t_s} s", "an instant of its slot", slot, robot)
            return
        self._check_place(handover, i, view, step / context.steps)
        if self._due_at == (slot, step):
            self._check_reason(i, slot, step)

    def _check_reason(self, i: int, slot: int, step: int) -> None:
        """The handover of robot i, or that it made none, is what was due at an instant."""
        context = self._context
        at, made = self._made.get(i, (-1, None))
        told: Outcome = made if at == step else None
        due = self._due.pop(i, {None})
        if told in due:
            return
        found = f"at instant {step} {self._words(told)}"
        expected = " or ".join(sorted(self._words(outcome) for outcome in due))
        self._find(RULE, found, expected, slot, context.name(i))

    def _words(self, outcome: Outcome) -> str:
        if outcome is None:
            return "no handover"
        before, after, planned = outcome
        kind = "a planned" if planned else "an unplanned"
        return f"{kind} handover from {self.name(before)} to {self.name(after)}"

    def _check_place(self, handover: HandoverRecord, i: int, view: SlotView, share: float) -> None:
        """Where the robot is at that instant."""
        place = np.flatnonzero(view.robot == i)
        slot, robot = handover.slot, handover.robot
        if not len(place):
            self._find(RULE, "a handover", "none: not on the floor", slot, robot)
            return
        k = int(place[0])
        found = (handover.vertex, handover.next_vertex)
        expected = (int(view.vertex[k]), int(view.next_vertex[k]))
        x, y = ((1.0 - share) * view.start_m[k] + share * view.end_m[k]).tolist()
        off = np.hypot(handover.x_m - x, handover.y_m - y)
        if found != expected or not off <= METRES:
            self._find(
                RULE,
                f"between vertices {found} at ({handover.x_m:.6f}, {handover.y_m:.6f}) m",
                f"{expected} at ({x:.6f}, {y:.6f}) m",
                slot,
                robot,
            )

    def add_state(self, state: RobotState, sample_ns: int) -> None:
        """A state names the AP that serves; `sample_ns` is the sample instant at or before it."""
        if state.activity == GONE:
            return
        i, ap = self._context.robot[state.robot], self._context.ap.get(state.ap, -1)
        slot, robot = state.slot, state.robot
        if not self._truth.is_up(ap, sample_ns):  # APs go out at sample instants
            found = f"at {state.t_s} s served by {state.ap}, which is out"
            self._find(RULE, found, "by none, or by another AP", slot, robot)
        own, now = int(self.ap[i]), time_ns(state.t_s)
        if ap < 0 and own >= 0 and not self._truth.is_up(own, now):
            self.ap[i] = -1
        if ap != self.ap[i]:
            found = f"at {state.t_s} s its state is served by {state.ap or 'none'}"
            expected = f"{self.name(int(self.ap[i]))}, no handover having been told"
            self._find(RULE, found, expected, slot, robot)
            self.ap[i] = ap

    def add_sample(self, sample: Sample, robot: Ints, ap: Ints, step: int) -> None:
        """The APs (n,) that serve robots (n,) at a sample; what was due by then has happened."""
        context, slot, now = self._context, sample.slot, time_ns(sample.t_s)
        if step:
            self._settle(slot, step)
        out = [not self._truth.is_up(a, now) for a in range(len(context.start.aps))]
        self.ap[robot[np.array([*out, False])[self.ap[robot]]]] = -1
        wrong = ap != self.ap[robot]
        names = np.array([*context.start.aps, "none"])
        what = f"at {sample.t_s} s served, without a handover, by"
        context.each(RULE, slot, robot, wrong, what, names[ap], names[self.ap[robot]])
        self.ap[robot[wrong]] = ap[wrong]
        self.until_ns[robot[ap < 0]] = np.minimum(self.until_ns[robot[ap < 0]], now)

    def close(self, slot: int) -> None:
        """All handovers of a slot have been told."""
        self._settle(slot, self._context.steps)
        self._made.clear()
        self._due.clear()

    def _settle(self, slot: int, step: int) -> None:
        """Whoever was to hand over at an instant has done so."""
        if self._due_at == (slot, step):
            for i in sorted(self._due):
                self._check_reason(i, slot, step)
        self._due.clear()

    # --- what is due --------------------------------------------------------------------------

    def look(
        self, view: SlotView, there: Ints, step: int, sample: tuple[Ints, Floats, Floats, Ints],
        xy_m: Floats, share: Floats,
    ) -> None:  # fmt: skip
        """Derive from a sample what happens at the instant after it.

        Args:
            view: of the slot.
            there: (n,) places in it of the sample's robots.
            step: the sample's instant of the slot.
            sample: (n,) of it: AP, SNR, SNR of the map [dB], link.
            xy_m: (n, 2) where the robots are.
            share: (n,) of the way along their edges.
        """
        context, slot = self._context, view.slot
        ap = sample[0]
        robot, now, then = view.robot[there], context.t_ns(slot, step), step + 1
        first, change, after, sure = (column[there] for column in self._of_paths(view))
        changed = (change > 0) & (step >= change)
        planned = np.where(changed, after, first)
        up = np.array(
            [self._truth.is_up(a, context.t_ns(slot, then)) for a in range(len(context.start.aps))]
        )
        self._due, self._due_at = {}, (slot, then)
        wishes = self._wish(view, there, planned, sample, xy_m, share, now)
        context.checks.count(STEP, RULE, len(robot))
        open_ = (change == then) | ((change > 0) & ~sure) | np.isin(robot, list(wishes))
        for k in np.flatnonzero(open_).tolist():
            i, serving = int(robot[k]), int(ap[k])
            if i in self._made:
                continue
            due: set[Outcome] = set()
            if change[k] and serving == first[k] and up[after[k]]:
                if change[k] == then:
                    due = {(serving, int(after[k]), True)}
                if not sure[k]:  # now, or at another instant of the slot
                    due |= {(serving, int(after[k]), True), None}
            if not due or None in due:
                due |= {
                    (serving, wish, False) if wish is not None and up[wish] else None
                    for wish in wishes.get(i, {None})
                }
            if due != {None}:
                self._due[i] = due

    def _of_paths(self, view: SlotView) -> tuple[Ints, Ints, Ints, Bools]:
        """Of each robot of the view: AP as the slot begins, instant of a change, AP then, sure."""
        if self._serving is None or self._serving[0] != view.slot:
            n = len(view.robot)
            first, step, then = np.full(n, -1), np.zeros(n, np.int64), np.full(n, -1)
            sure = np.ones(n, np.bool_)
            for k, (i, visit) in enumerate(
                zip(view.robot.tolist(), view.visit.tolist(), strict=True)
            ):
                own = self._planned.of(i)
                if own is None:
                    first[k] = self.ap[i]  # a forged path: nothing is asked of it
                    continue
                row = min(max(visit, 0), len(own.first) - 1)
                first[k], then[k], sure[k] = own.first[row], own.then[row], own.sure[row]
                step[k] = own.step[row] if view.advances[k] else 0
            self._serving = view.slot, (first, step, then, sure)
        return self._serving[1]

    def _wish(
        self,
        view: SlotView,
        there: Ints,
        planned: Ints,
        sample: tuple[Ints, Floats, Floats, Ints],
        xy_m: Floats,
        share: Floats,
        now: int,
    ) -> dict[int, set[int | None]]:
        """APs that robots may have wished for long enough, None where that may be none."""
        if not self._truth.affects_radio:
            return {}
        ap, snr, predicted, link = sample
        robot, threshold = view.robot[there], self._context.start.threshold_db
        own = ap == planned
        foreseen = own & (predicted < threshold)
        asks = (~own | ((snr < threshold) & ~foreseen)) & (link != _INTERRUPTED_AT)
        chosen = np.flatnonzero(asks)
        before, self._wishes = self._wishes, {}
        if not len(chosen):
            return {}
        heard = self._heard_db(view, there[chosen], xy_m[chosen], share[chosen])
        heard[:, [not self._truth.is_up(a, now) for a in range(heard.shape[1])]] = -np.inf
        wait = round(self._context.inputs.world.run.time_to_trigger_s * 1e9)
        found: dict[int, set[int | None]] = {}
        for k, levels in zip(chosen.tolist(), heard, strict=True):
            i = int(robot[k])
            options = self._choices(int(planned[k]), int(ap[k]), float(snr[k]), levels)
            held = before.get(i, {})
            wishes = self._wishes[i] = {
                a: (held[a][0], held[a][1] if len(held) == 1 else now) if a in held else (now, now)
                for a in options
            }
            ripe: set[int | None] = set()
            for a, (earliest, latest) in wishes.items():
                if a >= 0 and now - earliest >= wait:
                    ripe.add(a)
                if a < 0 or now - latest < wait:
                    ripe.add(None)
            if ripe != {None}:
                found[i] = ripe
        return found

    def _heard_db(self, view: SlotView, there: Ints, xy_m: Floats, share: Floats) -> Floats:
        """(n, A) SNR from each AP to robots of the view, by rays cast anew [dB]."""
        aps = len(self._context.start.aps)
        vertex, edge = (np.repeat(c[there], aps) for c in (view.vertex, view.edge))
        each = np.tile(np.arange(aps), len(there))
        fading = self._snr.map.fading_db(vertex, edge, np.repeat(share, aps), each)
        return self._snr.heard_db(view.robot[there], xy_m, fading.reshape(len(there), aps))

    def _choices(self, planned: int, serving: int, snr: float, heard: Floats) -> set[int]:
        """The AP a robot wishes for, −1 for none; several where rounding decides."""
        threshold = self._context.start.threshold_db
        gain = self._context.inputs.world.run.hysteresis_db
        good = serving >= 0 and snr >= threshold
        found: set[int] = set()
        if planned != serving and planned >= 0:
            spare = heard[planned] - threshold - (gain if good else 0.0)
            if spare >= -DECIBELS:
                found.add(planned)
            if spare >= DECIBELS:
                return found
        if good:
            return found | {-1}
        need = threshold if serving < 0 else max(threshold, snr + gain)
        others = [a for a in range(len(heard)) if a != serving]
        sure = max((float(heard[a]) for a in others if heard[a] >= need + DECIBELS), default=None)
        least = need if sure is None else sure
        found |= {a for a in others if heard[a] >= least - DECIBELS}
        return found if sure is not None else found | {-1}
