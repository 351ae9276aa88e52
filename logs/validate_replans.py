"""Step 3 of validation, new plans: each told, with a cause that was there, and within the rules.

A plan that is adopted begins where the robots are, keeps to edges of G and the goals, and no two of
its paths meet (§1.1 to §1.4). Its figures are recounted.
"""

from __future__ import annotations

import numpy as np

from logs.mcap_format import time_ns
from logs.records import NewPath, Replan
from logs.validate_commit import CommitCheck
from logs.validate_context import STEP, Context
from logs.validate_disturbances import Truth
from logs.validate_incidents import IncidentCheck
from logs.validate_itinerary import Walk
from logs.validate_states import StateCheck
from worlds.events import longest_run_slots

RULE = "page5:replan"
_CAUSES = ("ap-outage", "blockage", "robot-failure", "slip", "recovery", "deadlock")


class ReplanCheck:
    """Gathers the new plans of a slot and checks them before its states."""

    def __init__(
        self,
        context: Context,
        incidents: IncidentCheck,
        truth: Truth,
        states: StateCheck,
        commits: CommitCheck,
    ) -> None:
        self._context, self._truth = context, truth
        self._incidents, self._states, self._commits = incidents, states, commits
        self._told: list[Replan] = []
        self._paths: dict[int, dict[int, NewPath]] = {}  # by number of the plan, by robot
        self._number = 0
        self._last: Replan | None = None
        self._deadlocks: list[int] = []

    def _find(self, found: object, expected: object, slot: int, robot: str = "") -> None:
        self._context.checks.find(STEP, RULE, found, expected, slot=slot, robot=robot)

    def add(self, replan: Replan) -> None:
        """A new plan was asked for."""
        self._told.append(replan)

    def add_path(self, path: NewPath) -> None:
        """A robot has a new path."""
        own = self._paths.setdefault(path.number, {})
        i = self._context.robot[path.robot]
        if i in own:
            self._find("a second new path", "one per plan", path.slot, path.robot)
        own[i] = path

    def begin_slot(self, slot: int) -> None:
        """All new plans of a slot have been told."""
        replans, self._told = self._told, []
        paths, self._paths = self._paths, {}
        self._context.checks.count(STEP, RULE, len(replans) + sum(map(len, paths.values())))
        for replan in replans:
            self._number += 1
            if replan.number != self._number:
                self._find(f"new plan {replan.number}", f"number {self._number}", slot)
            if replan.slot != slot or time_ns(replan.t_s) != self._context.t_ns(slot):
                self._find(f"a new plan at {replan.t_s} s", "one at its slot's beginning", slot)
            self._check_cause(replan)
            own = paths.pop(replan.number, {})
            self._last = replan
            if replan.adopted:
                self._adopt(replan, own)
            elif own or replan.robot or replan.without_path:
                self._find("paths of a plan that was not adopted", "none", slot)
        for number, own in paths.items():
            names = ", ".join(path.robot for path in own.values())
            self._find(f"paths of plan {number} without its record", "a Replan", slot, names)

    # --- causes ---------------------------------------------------------------------------------

    def _check_cause(self, replan: Replan) -> None:
        context, slot, world = self._context, replan.slot, self._context.inputs.world
        now_ns = time_ns(replan.t_s)
        if not world.run.replan or replan.cause not in _CAUSES:
            self._find(f"a new plan because of {replan.cause!r}", "none, or a known cause", slot)
            return
        since = slot - self._last.slot if self._last else world.run.replan_cooldown
        if since < world.run.replan_cooldown and replan.cause != "deadlock":
            found = f"a new plan {since} slots after the one before"
            self._find(found, f"{world.run.replan_cooldown} or more", slot)
        match replan.cause:
            case "ap-outage":
                ap = context.ap.get(replan.name, -1)
                before = now_ns - round(world.run.replan_after_s * 1e9)
                there = ap >= 0 and not self._truth.is_up(ap, now_ns)
                there = there and not self._truth.is_up(ap, max(before, context.t_ns(0)))
            case "blockage":
                there = replan.name in self._truth.standing(slot)
            case "robot-failure":
                i = context.robot.get(replan.name, -1)
                there = i >= 0 and self._truth.has_failed(i, slot)
            case "deadlock":
                there = True
                self._deadlocks.append(slot)
            case "recovery":
                walks = [context.itinerary.walks[i] for i in self._states.present]
                there = any(walk is not None and not walk.to_goal for walk in walks)
            case _:
                there = context.disturbed
        if not there:
            found = f"a new plan because of {replan.cause} {replan.name}"
            self._find(found, "a cause that is there", slot)

    # --- paths ----------------------------------------------------------------------------------

    def _adopt(self, replan: Replan, paths: dict[int, NewPath]) -> None:
        context, slot = self._context, replan.slot
        present = self._states.present
        for i in sorted(present ^ paths.keys()):
            found = "no new path" if i in present else "a new path, but not on the floor"
            self._find(found, "one for each robot on the floor", slot, context.name(i))
        visits = {i: self._states.expected_visit(i) for i in present}
        old = {i: (context.itinerary.walks[i], visits[i]) for i in present}
        amid = {i: place for i, place in self._states.where().items() if i in paths}
        for i in context.itinerary.adopt(slot, paths):
            name = context.name(i)
            context.checks.find(
                STEP, "§1.1", "a new path off the edges of G", "edges of G", slot=slot, robot=name
            )
        self._states.adopt()
        self._commits.adopt()
        for i, (vertex, edge, piece) in amid.items():
            walk = context.itinerary.walks[i]
            if walk is None:
                continue
            first = (int(walk.vertex[0]), int(walk.edge[0]) if piece else -1, int(walk.piece[0]))
            if first != (vertex, edge, piece):
                what = f"a new path from (vertex, edge, piece) {first}"
                self._find(what, f"{(vertex, edge, piece)}, where it is", slot, context.name(i))
            goal = int(context.inputs.problem.goal[i])
            if walk.to_goal and int(walk.vertex[-1]) != goal:
                found = f"a new path to vertex {int(walk.vertex[-1])}"
                self._find(found, f"its goal, {goal}", slot, context.name(i))
        for when, kind, place, robots in context.itinerary.shared():
            rule = "§1.2" if kind == "vertex" else "§1.3"
            names = ", ".join(context.name(i) for i in robots)
            found = f"new paths of {names} at {kind} {place}"
            context.checks.find(STEP, rule, found, "at most one", slot=when, robot=names)
        self._recount(replan, old)

    def _recount(self, replan: Replan, old: dict[int, tuple[Walk | None, int]]) -> None:
        """Who has another way, who has none, and what the ways cost (§1.9)."""
        problem = self._context.inputs.problem
        changed, without, before, after = [], [], 0, 0
        for i in sorted(old):
            walk, (former, visit) = self._context.itinerary.walks[i], old[i]
            if walk is None or former is None:
                continue
            if not walk.to_goal:
                without.append(i)
            if former.to_goal and visit >= former.last:
                continue  # it has arrived
            if _states(walk, 0) != _states(former, visit) or walk.to_goal != former.to_goal:
                changed.append(i)
            if walk.to_goal and former.to_goal:
                before += _cost(former, visit, problem.c_t, problem.c_h)
                after += _cost(walk, 0, problem.c_t, problem.c_h)
        found = (replan.robot, replan.without_path, replan.cost_before, replan.cost_after)
        expected = (tuple(changed), tuple(without), before, after)
        if found != expected:
            self._find(f"changed, without a path, costs {found}", expected, replan.slot)

    def finish(self) -> None:
        """A deadlock that led to a new plan is told, and one that did not ends the run."""
        for slot in self._deadlocks:
            if not self._incidents.has_told("deadlock", slot):
                self._find("a new plan because of a deadlock", "an incident that tells it", slot)
            self._incidents.expect_deadlock(slot)
        last = self._states.last_view
        if last is None or last.advances.any() or last.slot in self._deadlocks:
            return
        stuck = last.robot[~last.arrived].tolist()
        if not stuck:
            return
        whole = [i for i in stuck if not self._truth.has_failed(i, last.slot)]
        if last.slot + 1 >= longest_run_slots(self._context.inputs.world):
            self._incidents.allow("deadlock", last.slot, ())
        elif whole:
            self._incidents.expect_deadlock(last.slot)


def _states(walk: Walk, first: int) -> list[tuple[int, int]]:
    """Vertices and APs from a state on, each run of equal ones once."""
    pairs = list(zip(walk.vertex[first:].tolist(), walk.ap[first:].tolist(), strict=True))
    return [p for k, p in enumerate(pairs) if k == 0 or p != pairs[k - 1]]


def _cost(walk: Walk, first: int, c_t: int, c_h: int) -> int:
    handovers = int(np.count_nonzero(np.diff(walk.ap[first:])))
    return c_t * (walk.last - first) + c_h * handovers
