"""Step 3 of validation, who advances: each robot that does may, each that does not has its reason.

For each robot on the floor the reasons that can hold it are derived anew: it has failed, it is
late, it has no further path, a blockage is where it would go, what was released to it is used up,
another robot must go first (design page 5). The first of these that holds must be the one told;
where none does, it advances. Under group commit nobody waits in a circle: then all of it could have
advanced, and the set of those that do is the greatest one.
"""

from __future__ import annotations

import numpy as np

from logs.records import (
    BY_BLOCKAGE,
    BY_CONNECTION,
    BY_DELAY,
    BY_FAILURE,
    BY_NO_PATH,
    BY_ROBOT,
    CONNECTED,
    HANDOVER,
    HELD,
    LINKS,
    RobotState,
    Sample,
)
from logs.validate_context import STEP, Context, SlotView
from logs.validate_disturbances import DisturbanceCheck, Truth

RULE = "page5:commit"
_RULES = {
    BY_FAILURE: "page5:failure",
    BY_DELAY: "page5:delay",
    BY_NO_PATH: "page5:no-path",
    BY_BLOCKAGE: "page5:blockage",
    BY_CONNECTION: "page5:release",
    BY_ROBOT: RULE,
}
_FINE = (LINKS.index(CONNECTED), LINKS.index(HANDOVER))


class CommitCheck:
    """Checks, slot by slot, who advances and who does not."""

    def __init__(self, context: Context, truth: Truth, disturbances: DisturbanceCheck) -> None:
        self._context, self._truth, self._told = context, truth, disturbances
        self._strict = context.inputs.world.run.policy == "strict"
        self._horizon = context.inputs.world.run.release_horizon
        n = len(context.start.robots)
        self._released = np.zeros(n, np.int64)
        self._linked = np.ones(n, np.bool_)  # in some sample of the slot before
        self._linked_now = np.zeros(n, np.bool_)
        self._sampled_now = np.zeros(n, np.bool_)

    def add_sample(self, sample: Sample) -> None:
        """Links of a sample."""
        robot = np.array(sample.robot, np.int64)
        self._sampled_now[robot] = True
        self._linked_now[robot[np.isin(sample.link, _FINE)]] = True

    def adopt(self) -> None:
        """New paths are in force: what is released without connection is what they have."""
        itinerary = self._context.itinerary
        for i, walk in enumerate(itinerary.walks):
            if walk is not None:
                whole = itinerary.begun(i, walk.last)
                self._released[i] = self._horizon if walk.to_goal else whole

    def begin_slot(self) -> None:
        """The samples of the slot before are complete."""
        if not self._truth.affects_radio:
            return
        self._linked[self._sampled_now] = self._linked_now[self._sampled_now]
        self._linked_now[:] = self._sampled_now[:] = False

    def check(self, view: SlotView, states: dict[int, RobotState]) -> None:
        """Who advances in a slot, and the reasons of those who do not."""
        context, itinerary = self._context, self._context.itinerary
        busy = {
            i: k
            for k, i in enumerate(view.robot.tolist())
            if not view.arrived[k] and itinerary.walks[i] is not None
        }
        for i, k in busy.items():
            if self._linked[i]:
                self._released[i] = itinerary.begun(i, int(view.visit[k])) + self._horizon
        context.checks.count(STEP, RULE, len(busy))
        if not context.disturbed:
            return  # every state is the plan's, which `validate_states` has compared
        at = dict(zip(view.robot.tolist(), range(len(view.robot)), strict=True))
        waits: dict[int, int] = {}
        for i, k in busy.items():
            state = states[i]
            reason, other = self._reason(i, k, view, at)
            held = state.activity == HELD
            found = (state.cause, state.waits_for) if held else None
            if reason is None and not held:
                continue
            if held and reason is not None:
                expected = (reason, context.name(other) if other >= 0 else "")
                if found != expected:
                    self._find(_RULES[reason], i, f"held by {found}", expected, view.slot)
                if other >= 0:
                    waits[i] = other
            elif held:
                self._find(RULE, i, f"held by {found}", "to advance: nothing is in its way",
                           view.slot)  # fmt: skip
            else:
                name = f" by {context.name(other)}" if other >= 0 else ""
                self._find(_RULES[str(reason)], i, f"is {state.activity}", f"held: {reason}{name}",
                           view.slot)  # fmt: skip
        if not self._strict:
            self._check_circles(waits, view.slot)

    def _find(self, rule: str, i: int, found: str, expected: object, slot: int) -> None:
        name = self._context.name(i)
        self._context.checks.find(STEP, rule, found, expected, slot=slot, robot=name)

    def _reason(self, i: int, k: int, view: SlotView, at: dict[int, int]) -> tuple[str | None, int]:
        """The first reason that holds robot i (of the view's place k), and who is before it."""
        itinerary, slot = self._context.itinerary, view.slot
        walk = itinerary.walks[i]
        assert walk is not None
        visit = int(view.visit[k])
        edge, piece = int(walk.edge[visit]), int(walk.piece[visit])
        if piece == 0 and self._truth.has_failed(i, slot):
            return BY_FAILURE, -1
        if self._told.late_until.get(i, 0) > slot:
            return BY_DELAY, -1
        if visit >= walk.last and not walk.to_goal:
            return BY_NO_PATH, -1
        if edge >= 0 and self._truth.has_blockages and self._is_shut(i, visit, slot):
            return BY_BLOCKAGE, -1
        if edge >= 0 and piece == 0 and itinerary.begun(i, visit) >= self._released[i]:
            return BY_CONNECTION, -1
        gate = itinerary.gate(i, visit)
        if gate is None or gate.robot not in at:
            return None, -1
        other = at[gate.robot]
        other_visit = int(view.visit[other])
        if other_visit > gate.until:
            return None, -1
        leaves = other_visit == gate.until and bool(view.advances[other])
        follows = leaves and gate.at_once and not self._strict
        return (None, -1) if follows else (BY_ROBOT, gate.robot)

    def _is_shut(self, i: int, visit: int, slot: int) -> bool:
        """Whether a blockage is where the transition of a state leads, then or soon after."""
        itinerary = self._context.itinerary
        walk = itinerary.walks[i]
        assert walk is not None
        edge, piece = int(walk.edge[visit]), int(walk.piece[visit])
        left = int(self._context.inputs.problem.edge_slots[edge]) - piece
        to = itinerary.next_vertex(i, visit)
        on_edge = range(left) if piece == 0 else range(1)
        at_end = (left - 1, left) if piece == 0 or left == 1 else ()
        return any(self._truth.shut(slot + ahead)[1][edge] for ahead in on_edge) or any(
            self._truth.shut(slot + ahead)[0][to] for ahead in at_end
        )

    def _check_circles(self, waits: dict[int, int], slot: int) -> None:
        """Under group commit nobody waits in a circle."""
        for begin in sorted(waits):
            seen, here = [begin], waits[begin]
            while here in waits and here not in seen:
                seen.append(here)
                here = waits[here]
            if here == begin and begin == min(seen):
                names = " for ".join(self._context.name(i) for i in [*seen, begin])
                self._context.checks.find(
                    STEP, RULE, f"waiting in a circle: {names}", "all of them advance", slot=slot
                )
