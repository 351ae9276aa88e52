"""Step 3 of validation, slot by slot: where the states say the robots are, and whom they share.

Each robot has one state at the beginning of each slot, from which all else follows: its moves are
edges of G (§1.1), nobody shares a vertex (§1.2) or an edge (§1.3), the APs' loads are the counts of
those they serve (§1.6), robots arrive and leave as §1.4 says. And the states are those of the paths
in force: each robot's visits are a prefix of its path, none before its slot.
"""

from __future__ import annotations

from collections import defaultdict
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

_STATE, _PLAN = "page5:state", "page5:plan"
NO_SNR_DB = -1000.0


class StateCheck:
    """Gathers the states of a slot's beginning and checks them together."""

    def __init__(
        self, context: Context, incidents: IncidentCheck, truth: Truth, commits: CommitCheck
    ) -> None:
        self._context = context
        self._incidents = incidents
        self._truth, self._commits = truth, commits
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
        self.unplanned: Bools = np.zeros(len(context.start.robots), np.bool_)
        """Robots whose last handover was not planned."""
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
            view = self._last_view(slot)
        else:
            view = self._view_of_states(slot)
            self._check_plan(view)
            self._check_arrivals(slot, set(view.robot[view.arrived].tolist()) - self._home)
            self._check_moves(view)
            self._check_places(view)
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

    def _view_of_states(self, slot: int) -> SlotView:
        """The usable states of the robots on the floor, as columns."""
        context, problem = self._context, self._context.inputs.problem
        vertices, edges = problem.n_vertices, problem.n_edges
        rows: list[tuple[int, ...]] = []
        leaves = context.start.at_goal == "leave"
        for i, state in sorted(self._states.items()):
            if state.activity == GONE or i not in self.present:
                continue
            if not (
                0 <= state.vertex < vertices
                and 0 <= state.next_vertex < vertices
                and -1 <= state.edge < edges
            ):
                self._find(
                    "§1.1",
                    f"vertex {state.vertex}, edge {state.edge}, next vertex {state.next_vertex}",
                    f"indices below {vertices} vertices and {edges} edges",
                    slot,
                    state.robot,
                )
                continue
            ap = context.ap.get(state.ap, -1)
            moves = state.activity == MOVING
            arrived = state.activity == ARRIVED
            advances = moves or state.activity == WAITING or (arrived and leaves)
            rows.append((i, state.vertex, state.next_vertex, state.edge, moves, ap,
                         state.visit, advances, arrived))  # fmt: skip
        columns: Ints = np.array(rows, np.int64).reshape(-1, 9).T
        robot, vertex, next_vertex, edge = columns[:4]
        moving, ap = columns[4].astype(np.bool_), columns[5]
        slots = np.where(edge >= 0, np.append(problem.edge_slots, 1)[edge], 1)
        piece, load_ap = self._pieces(robot, vertex, edge, slots, ap)
        view = SlotView(
            slot=slot,
            robot=robot,
            vertex=vertex,
            next_vertex=next_vertex,
            edge=edge,
            piece=piece,
            slots=slots,
            moves=moving,
            visit=columns[6],
            advances=columns[7].astype(np.bool_),
            arrived=columns[8].astype(np.bool_),
            ap=ap,
            load_ap=load_ap,
            start_m=np.empty((0, 2)),
            end_m=np.empty((0, 2)),
        )
        return view.placed(problem.xy_m)

    def _last_view(self, slot: int) -> SlotView:
        """The run's last instant: without states, who parks stands where the last slot ended."""
        before = self._view
        there = sorted(self.present)
        stays = np.flatnonzero(np.isin(before.robot, there)) if before is not None else np.arange(0)
        none = np.empty(0, np.int64)
        where = self.where()
        robot: Ints = before.robot[stays] if before is not None else none
        table = np.array([where[i] for i in robot.tolist()], np.int64).reshape(-1, 3)
        vertex, edge, piece = table.T
        problem = self._context.inputs.problem
        ends = np.append(problem.edge_uv, [[0, 0]], axis=0)[edge].sum(axis=1)
        ap = before.load_ap[stays] if before is not None else none
        visit = [self.expected_visit(i) for i in robot.tolist()]
        return SlotView(
            slot=slot,
            robot=robot,
            vertex=vertex,
            next_vertex=np.where(edge >= 0, ends - vertex, vertex),
            edge=edge,
            piece=piece,
            slots=np.where(edge >= 0, np.append(problem.edge_slots, 1)[edge], 1),
            moves=np.zeros(len(stays), np.bool_),
            visit=np.array(visit, np.int64),
            advances=np.zeros(len(stays), np.bool_),
            arrived=np.zeros(len(stays), np.bool_),
            ap=ap,
            load_ap=ap,
            start_m=np.empty((0, 2)),
            end_m=np.empty((0, 2)),
        ).placed(self._context.inputs.problem.xy_m)

    def _pieces(
        self, robot: Ints, vertex: Ints, edge: Ints, slots: Ints, ap: Ints
    ) -> tuple[Ints, Ints]:
        """Which slot of its crossing each robot is in, and the AP it counts for (§1.6)."""
        piece, load_ap = np.zeros(len(robot), np.int64), ap.copy()
        if self._view is None:
            return piece, load_ap
        before = self._view
        here, there = _common(robot, before.robot)
        gone_on = before.piece[there] + before.moves[there]
        goes_on = (
            (edge[here] >= 0)
            & (edge[here] == before.edge[there])
            & (vertex[here] == before.vertex[there])
            & (gone_on < slots[here])
            & (gone_on > 0)
        )
        piece[here[goes_on]] = gone_on[goes_on]
        at, then = here[goes_on], there[goes_on]
        load_ap[at] = np.where(
            self.unplanned[robot[at]] | (ap[at] < 0), ap[at], before.load_ap[then]
        )
        return piece, load_ap

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
        visits, rows = [], []
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
            later = visit + (int(problem.edge_slots[edge]) - piece if piece > 0 else 0)
            visits.append(visit)
            rows.append((visit, vertex, on_edge, leads_to, int(walk.ap[visit]),
                         int(walk.ap[min(later, walk.last)]), activity))  # fmt: skip
        columns = list(zip(*rows, strict=True)) or [()] * 7

        def compare(what: str, found: list[int] | list[str], expected: Sequence[object]) -> None:
            values, wanted = np.array(found), np.array(expected)
            wrong = values != wanted if len(values) else np.zeros(0, np.bool_)
            context.each(_PLAN, view.slot, robot, wrong, what, values, wanted)

        compare("visit", [s.visit for s in states], columns[0])
        compare("vertex", [s.vertex for s in states], columns[1])
        compare("edge", [s.edge for s in states], columns[2])
        compare("next vertex", [s.next_vertex for s in states], columns[3])
        compare("activity", [s.activity for s in states], columns[6])
        if not context.disturbed:
            compare("waits for", [s.waits_for for s in states], [""] * len(states))
            compare("cause", [s.cause for s in states], [""] * len(states))

        # Amid a crossing of several slots the next AP may serve already; its end is in the plan.
        # Where the radio is disturbed, `validate_radio` follows who serves.
        served = view.ap[known]
        planned, ahead = (np.array(columns[k], np.int64) for k in (4, 5))
        wrong = (served != planned) & (served != ahead)
        wrong &= not self._truth.affects_radio
        names = np.array([*context.start.aps, "none"])
        context.each(_PLAN, view.slot, robot, wrong, "AP", names[served], names[planned])
        self.deviates[robot] = (served != planned) & (served != ahead)

    def _check_moves(self, view: SlotView) -> None:
        """Every move is along an edge of G, from where the robot was (§1.1)."""
        context = self._context
        problem = context.inputs.problem
        crosses = view.edge >= 0
        uv = np.append(problem.edge_uv, [[-1, -1]], axis=0)[view.edge]
        ahead = (view.vertex == uv[:, 0]) & (view.next_vertex == uv[:, 1])
        back = (view.vertex == uv[:, 1]) & (view.next_vertex == uv[:, 0])
        back &= ~np.append(problem.edge_oneway, False)[view.edge]
        fine = np.where(crosses, ahead | back, view.vertex == view.next_vertex)
        self._each_move(view, view.robot, ~fine, view.next_vertex, view.vertex)

        before = self._view
        if before is None:
            start = problem.start[view.robot].astype(np.int64)
            self._each_move(view, view.robot, view.vertex != start, view.vertex, start)
            return
        here, there = _common(view.robot, before.robot)
        gone_on = before.piece[there] + before.moves[there]
        amid = (before.edge[there] >= 0) & (gone_on > 0) & (gone_on < before.slots[there])
        done = before.moves[there] & (gone_on >= before.slots[there])
        expected = np.where(done, before.next_vertex[there], before.vertex[there])
        jumped = view.vertex[here] != expected
        jumped |= amid & (view.edge[here] != before.edge[there])
        self._each_move(view, view.robot[here], jumped, view.vertex[here], expected)

    def _each_move(
        self, view: SlotView, robots: Ints, wrong: Bools, found: Ints, expected: Ints
    ) -> None:
        what = "off the edges of G: at vertex"
        self._context.each("§1.1", view.slot, robots, wrong, what, found, expected)

    def _check_places(self, view: SlotView) -> None:
        """Nobody shares a vertex or an edge."""
        stands, crosses = view.piece == 0, view.edge >= 0
        for rule, place, at, here in (
            ("§1.2", "vertex", view.vertex, stands),
            ("§1.3", "edge", view.edge, crosses),
        ):
            self._context.checks.count(STEP, rule, int(here.sum()))
            robots, where = view.robot[here], at[here]
            if len(np.unique(where)) == len(where):
                continue
            groups: dict[int, list[str]] = defaultdict(list)
            for i, v in zip(robots.tolist(), where.tolist(), strict=True):
                groups[v].append(self._context.name(i))
            for v, names in groups.items():
                if len(names) > 1:
                    found = f"{len(names)} robots on {place} {v}"
                    self._find(rule, found, "at most one", view.slot, ", ".join(names))
                    for name in names:
                        self._incidents.expect("collision", view.slot, (name,))

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


def _common(a: Ints, b: Ints) -> tuple[Ints, Ints]:
    """Indices into two ascending lists of the elements they share."""
    _, in_a, in_b = np.intersect1d(a, b, assume_unique=True, return_indices=True)
    return in_a.astype(np.int64), in_b.astype(np.int64)
