"""Step 3 of validation, slot by slot: where the states say the robots are, and whom they share.

Each robot has one state at the beginning of each slot, from which all else follows: its moves are
edges of G (§1.1), nobody shares a vertex (§1.2) or an edge (§1.3), the APs' loads are the counts of
those they serve (§1.6), robots arrive and leave as §1.4 says. And the states are those of the paths
in force: each robot's visits are a prefix of its path, none before its slot.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.mcap_format import time_ns
from logs.records import (
    ARRIVED,
    GONE,
    HELD,
    MOVING,
    NO_AP,
    WAITING,
    ApLoad,
    Arrival,
    RobotState,
)
from logs.validate_commit import CommitCheck
from logs.validate_context import STEP, Bools, Context, Ints, SlotView
from logs.validate_disturbances import Truth
from logs.validate_incidents import IncidentCheck
from logs.validate_moves import MoveCheck
from logs.validate_serving import PlannedServing
from logs.validate_snr import NO_SNR_DB
from logs.validate_views import ViewBuilder

_STATE, _PLAN = "page5:state", "page5:plan"


class StateCheck:
    """Gathers the states of a slot's beginning and checks them together."""

    def __init__(
        self,
        context: Context,
        incidents: IncidentCheck,
        truth: Truth,
        commits: CommitCheck,
        serving: PlannedServing,
    ) -> None:
        self._context = context
        self._incidents = incidents
        self._truth, self._commits, self._serving = truth, commits, serving
        self._moves, self._views = MoveCheck(context, incidents), ViewBuilder(context, serving)
        walks = context.itinerary.walks
        self.present = {i for i, walk in enumerate(walks) if walk is not None}
        """Robots that are on the floor in the slot that is being gathered."""
        self._left: dict[int, tuple[int, int]] = {}  # who leaves: last visit, its vertex
        self._home: set[int] = set()  # who has arrived
        self._fresh = False  # new paths begin in the slot that is being gathered
        self._states: dict[int, RobotState] = {}
        self._loads: dict[int, ApLoad] = {}
        self._arrivals: dict[int, Arrival] = {}
        self._view: SlotView | None = None
        self._played: SlotView | None = None
        self.slot = 0
        """The slot whose states are being gathered."""
        self.deviates: Bools = np.zeros(len(context.start.robots), np.bool_)
        """Robots that another AP serves than their path has."""

    def _find(
        self, rule: str, found: object, expected: object, slot: int | None, robot: str = ""
    ) -> None:
        self._context.checks.find(STEP, rule, found, expected, slot=slot, robot=robot)

    def add_state(self, state: RobotState) -> None:
        """A state: of the beginning of a slot, or of a link that changes within one."""
        context = self._context
        i = context.robot[state.robot]
        if time_ns(state.t_s) != context.t_ns(state.slot):
            self._within(state)
            return
        context.checks.count(STEP, _STATE)
        if state.slot != self.slot:
            self._find(_STATE, "a state out of turn", f"slot {self.slot}", state.slot, state.robot)
        elif i in self._states:
            self._find(_STATE, "a second state", "one state per slot", state.slot, state.robot)
        else:
            self._states[i] = state

    def _within(self, state: RobotState) -> None:
        """A state within a slot tells of the link only: the rest is as at the slot's beginning."""
        view = self._view
        self._context.checks.count(STEP, _STATE)
        inside = (
            view is not None
            and view.slot == state.slot
            and time_ns(state.t_s) > self._context.t_ns(state.slot)
            and time_ns(state.t_s) < self._context.t_ns(state.slot + 1)
        )
        k = (
            int(np.searchsorted(view.robot, self._context.robot[state.robot]))
            if view is not None
            else 0
        )
        if (
            view is None
            or not inside
            or k == len(view.robot)
            or view.robot[k] != self._context.robot[state.robot]
        ):
            self._find(_STATE, f"a state at {state.t_s} s", "in its slot", state.slot, state.robot)
            return
        found = (state.vertex, state.edge, state.next_vertex, state.activity == MOVING)
        expected = (
            int(view.vertex[k]),
            int(view.edge[k]),
            int(view.next_vertex[k]),
            bool(view.moves[k]),
        )
        if found != expected:
            self._find(
                _STATE,
                f"at {state.t_s} s vertex, edge, next vertex, moving: {found}",
                f"{expected} as at the slot's beginning",
                state.slot,
                state.robot,
            )

    def add_load(self, load: ApLoad) -> None:
        """An AP's load in a slot."""
        a = self._context.ap[load.ap]
        on_time = time_ns(load.t_s) == self._context.t_ns(load.slot)
        if load.slot != self.slot or not on_time or a in self._loads:
            self._find(
                "page5:load",
                f"a load of {load.ap} at {load.t_s} s, out of turn or told twice",
                "one load per AP and slot, at its beginning",
                load.slot,
            )
        else:
            self._loads[a] = load

    def add_arrival(self, arrival: Arrival) -> None:
        """A robot arrives."""
        i = self._context.robot[arrival.robot]
        on_time = time_ns(arrival.t_s) == self._context.t_ns(arrival.slot)
        if arrival.slot != self.slot or not on_time or i in self._arrivals:
            self._find(
                "page5:arrival",
                f"an arrival at {arrival.t_s} s, out of turn or told twice",
                "one arrival, at the beginning of its slot",
                arrival.slot,
                arrival.robot,
            )
        else:
            self._arrivals[i] = arrival

    def commit(self) -> SlotView:
        """All of a slot's beginning has been told: check it, and go on to the next slot."""
        slot, over = self.slot, self.slot > self._context.last
        self._check_presence(slot, over)
        if over:
            self._check_arrivals(slot, set())
            view = self._views.at_the_end(
                slot, self._view, self.present, self.where(), self.expected_visit
            )
        else:
            there = [
                (i, state)
                for i, state in sorted(self._states.items())
                if state.activity != GONE and i in self.present
            ]
            view = self._views.of_states(slot, there, self._view)
            self._check_plan(view)
            self._check_arrivals(slot, set(view.robot[view.arrived].tolist()) - self._home)
            self._moves.check_moves(view, self._view)
            self._moves.check_places(view)
            self._check_loads(view)
            self._commits.check(view, self._states)
            self._go_home(view)
            self._played = view
        self._states, self._loads, self._arrivals = {}, {}, {}
        self._view = view
        self.slot += 1
        return view

    @property
    def last_view(self) -> SlotView | None:
        """The last slot in which robots had states."""
        return self._played

    def adopt(self) -> None:
        """New paths begin in the slot that is being gathered."""
        self._fresh = True

    def busy(self) -> list[int]:
        """Robots on the floor in the slot that is being gathered that have not arrived before."""
        found = []
        for i in sorted(self.present - self._home):
            walk = self._context.itinerary.walks[i]
            expected = self.expected_visit(i)
            if walk is not None and not (walk.to_goal and expected >= walk.last):
                found.append(i)
        return found

    def expected_visit(self, i: int) -> int:
        """The state robot i is at by what it did before."""
        itinerary = self._context.itinerary
        if self._fresh or self._view is None:
            return 0 if self._fresh else itinerary.catch_up(i, 0, self.slot)
        place = int(np.searchsorted(self._view.robot, i))
        if place == len(self._view.robot) or self._view.robot[place] != i:
            return 0
        visit = int(self._view.visit[place] + self._view.advances[place])
        walk = itinerary.walks[i]
        return (
            visit if walk is None or visit > walk.last else itinerary.catch_up(i, visit, self.slot)
        )

    def where(self) -> dict[int, tuple[int, int, int]]:
        """Vertex, edge (−1: none) and piece of each robot as the slot being gathered begins."""
        found: dict[int, tuple[int, int, int]] = {}
        before = self._view
        if before is None:
            start = self._context.inputs.problem.start
            return {i: (int(start[i]), -1, 0) for i in self.present}
        gone_on = before.piece + before.moves
        amid = (before.edge >= 0) & (gone_on > 0) & (gone_on < before.slots)
        done = before.moves & (gone_on >= before.slots)
        vertex = np.where(done, before.next_vertex, before.vertex)
        columns = (vertex, np.where(amid, before.edge, -1), np.where(amid, gone_on, 0))
        for i, v, e, piece in zip(
            before.robot.tolist(), *(c.tolist() for c in columns), strict=True
        ):
            if i in self.present:
                found[i] = v, e, piece
        return found

    def _go_home(self, view: SlotView) -> None:
        """Who has arrived leaves the floor after this slot, or stays for good."""
        self._fresh = False
        self._left = {}
        for k in np.flatnonzero(view.arrived).tolist():
            i = int(view.robot[k])
            self._home.add(i)
            if self._context.start.at_goal == "leave":
                self.present.discard(i)
                self._left[i] = int(view.visit[k]), int(view.vertex[k])

    def _check_presence(self, slot: int, over: bool) -> None:
        """Who has a state: all on the floor, and once those that have just left it (§1.4)."""
        context = self._context
        present = set() if over else self.present
        context.checks.count(STEP, _STATE, len(present) + len(self._left))
        for i in sorted(present | self._left.keys() | self._states.keys()):
            state = self._states.get(i)
            if i in present and (state is None or state.activity == GONE):
                found = "no state" if state is None else "is gone"
                self._find(_STATE, found, "a state on the floor", slot, context.name(i))
            elif i in self._left:
                self._check_gone(i, slot, state)
            elif i not in present and state is not None:
                found = f"a state ({state.activity}) at vertex {state.vertex}"
                self._find(_STATE, found, "none: it is not on the floor", slot, context.name(i))

    def _check_gone(self, i: int, slot: int, state: RobotState | None) -> None:
        goal = int(self._context.inputs.problem.goal[i])
        arrival, _ = self._left[i]
        expected = (arrival, goal, -1, goal, GONE, "", "", NO_AP, NO_SNR_DB, 0.0)
        found = None
        if state is not None:
            found = (
                state.visit,
                state.vertex,
                state.edge,
                state.next_vertex,
                state.activity,
                state.waits_for,
                state.ap,
                state.link,
                state.snr_db,
                state.rate_mbps,
            )
        if found != expected:
            self._find("§1.4", f"after its arrival {found}", expected, slot, self._context.name(i))

    def _check_plan(self, view: SlotView) -> None:
        """Visits are a prefix of the path in force, and every state is the path's (page 5).

        In a run that nothing disturbs nobody is held, so it is the plan, slot for slot.
        """
        context, itinerary = self._context, self._context.itinerary
        problem = context.inputs.problem
        robots = [i for i in view.robot.tolist() if itinerary.walks[i] is not None]
        robot: Ints = np.array(robots, np.int64)
        known = np.isin(view.robot, robot)
        states = [self._states[i] for i in robots]
        rows = []
        for i, state in zip(robots, states, strict=True):
            walk = itinerary.walks[i]
            assert walk is not None
            visit = min(self.expected_visit(i), walk.last)
            edge, piece = int(walk.edge[visit]), int(walk.piece[visit])
            held = state.activity == HELD and context.disturbed
            on_edge = edge if edge >= 0 and (piece > 0 or not held) else -1
            vertex = int(walk.vertex[visit])
            leads_to = int(problem.edge_uv[on_edge].sum()) - vertex if on_edge >= 0 else vertex
            if visit == walk.last and walk.to_goal:
                activity = ARRIVED
            elif held or (visit == walk.last and not walk.to_goal):
                activity = HELD
            else:
                activity = MOVING if edge >= 0 else WAITING
            serving = self._serving.of(i)
            serves = int(walk.ap[visit] if serving is None else serving.first[visit])
            rows.append((visit, vertex, on_edge, leads_to, serves, activity))
        columns = list(zip(*rows, strict=True)) or [()] * 6

        def compare(what: str, found: list[int] | list[str], expected: Sequence[object]) -> None:
            values, wanted = np.array(found), np.array(expected)
            wrong = values != wanted if len(values) else np.zeros(0, np.bool_)
            context.each(_PLAN, view.slot, robot, wrong, what, values, wanted)

        compare("visit", [s.visit for s in states], columns[0])
        compare("vertex", [s.vertex for s in states], columns[1])
        compare("edge", [s.edge for s in states], columns[2])
        compare("next vertex", [s.next_vertex for s in states], columns[3])
        compare("activity", [s.activity for s in states], columns[5])
        if not context.disturbed:
            compare("waits for", [s.waits_for for s in states], [""] * len(states))
            compare("cause", [s.cause for s in states], [""] * len(states))

        # Where the radio is disturbed, `validate_handovers` follows who serves.
        served, planned = view.ap[known], np.array(columns[4], np.int64)
        off = served != planned
        wrong = off & (not self._truth.affects_radio)
        names = np.array([*context.start.aps, "none"])
        context.each(_PLAN, view.slot, robot, wrong, "AP", names[served], names[planned])
        self.deviates[robot] = off

    def _check_loads(self, view: SlotView) -> None:
        """Loads are counts of robots, and within capacity (§1.6)."""
        context = self._context
        counted = np.bincount(view.load_ap[view.load_ap >= 0], minlength=len(context.start.aps))
        for a, (name, capacity) in enumerate(
            zip(context.start.aps, context.start.ap_capacity, strict=True)
        ):
            load, told = int(counted[a]), self._loads.get(a)
            found = None if told is None else (told.load, told.capacity)
            context.checks.count(STEP, "page5:load")
            context.checks.count(STEP, "§1.6")
            if found != (load, capacity):
                self._find(
                    "page5:load", f"load, capacity of {name}: {found}", (load, capacity), view.slot
                )
            if load > capacity:
                if not context.disturbed:  # late robots may overload an AP: it is counted
                    found_load = f"{name} serves {load} robots"
                    self._find("§1.6", found_load, f"at most {capacity}", view.slot)
                self._incidents.expect("overload", view.slot, (), name, float(load))

    def _check_arrivals(self, slot: int, due: set[int]) -> None:
        context = self._context
        context.checks.count(STEP, "page5:arrival", len(due))
        for i in sorted(due | self._arrivals.keys()):
            told = self._arrivals.get(i)
            goal = int(context.inputs.problem.goal[i])
            expected = goal if i in due else None
            found = told.vertex if told else None
            if told:
                self._incidents.arrived(told.robot)
            if found != expected:
                self._find(
                    "page5:arrival",
                    "no arrival" if told is None else f"an arrival at vertex {found}",
                    "none" if expected is None else f"an arrival at vertex {expected}",
                    slot,
                    context.name(i),
                )
