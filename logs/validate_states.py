"""Step 3 of validation, slot by slot: where the states say the robots are, and whom they share.

Each robot has one state at the beginning of each slot, from which all else follows: its moves are
edges of G (§1.1), nobody shares a vertex (§1.2) or an edge (§1.3), the APs' loads are the counts of
those they serve (§1.6), robots arrive and leave as §1.4 says. And the states are those of the plan.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from logs.mcap_format import time_ns
from logs.records import ARRIVED, GONE, MOVING, NO_AP, WAITING, ApLoad, Arrival, RobotState
from logs.validate_context import STEP, Bools, Context, Ints, SlotView
from logs.validate_incidents import IncidentCheck

_STATE, _PLAN = "page5:state", "page5:plan"
NO_SNR_DB = -1000.0


class StateCheck:
    """Gathers the states of a slot's beginning and checks them together."""

    def __init__(self, context: Context, incidents: IncidentCheck) -> None:
        self._context = context
        self._incidents = incidents
        self._states: dict[int, RobotState] = {}
        self._loads: dict[int, ApLoad] = {}
        self._arrivals: dict[int, Arrival] = {}
        self._view: SlotView | None = None
        self.slot = 0
        """The slot whose states are being gathered."""

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
        slot, over = self.slot, self.slot > self._context.timetable.last
        self._check_presence(slot, over)
        self._check_arrivals(slot, over)
        if over:
            view = self._last_view(slot)
        else:
            view = self._view_of_states(slot)
            self._check_plan(view)
            self._check_moves(view)
            self._check_places(view)
            self._check_loads(view)
        self._states, self._loads, self._arrivals = {}, {}, {}
        self._view = view
        self.slot += 1
        return view

    def _check_presence(self, slot: int, over: bool) -> None:
        """Who has a state: all on the floor, and once those that have just left it (§1.4)."""
        context, table = self._context, self._context.timetable
        present = set() if over else set(table.on_floor(slot).tolist())
        leaves = context.start.at_goal == "leave"
        gone = set(np.flatnonzero(table.arrival == slot - 1).tolist()) if leaves and slot else set()
        context.checks.count(STEP, _STATE, len(present) + len(gone))
        for i in sorted(present | gone | self._states.keys()):
            state = self._states.get(i)
            if i in present and (state is None or state.activity == GONE):
                found = "no state" if state is None else "is gone"
                self._find(_STATE, found, "a state on the floor", slot, context.name(i))
            elif i in gone:
                self._check_gone(i, slot, state)
            elif i not in present and state is not None:
                found = f"a state ({state.activity}) at vertex {state.vertex}"
                self._find(_STATE, found, "none: it is not on the floor", slot, context.name(i))

    def _check_gone(self, i: int, slot: int, state: RobotState | None) -> None:
        goal = int(self._context.inputs.problem.goal[i])
        arrival = int(self._context.timetable.arrival[i])
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
        rows: list[tuple[int, int, int, int, bool, int]] = []
        for i, state in sorted(self._states.items()):
            if state.activity == GONE:
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
            rows.append((i, state.vertex, state.next_vertex, state.edge, moves, ap))
        columns: Ints = np.array(rows, np.int64).reshape(-1, 6).T
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
            ap=ap,
            load_ap=load_ap,
            start_m=np.empty((0, 2)),
            end_m=np.empty((0, 2)),
        )
        return view.placed(problem.xy_m)

    def _last_view(self, slot: int) -> SlotView:
        """The run's last instant: without states, who parks stands where the last slot ended."""
        park = self._context.start.at_goal == "park"
        before = self._view
        stays = np.arange(len(before.robot) if before is not None and park else 0)
        none = np.empty(0, np.int64)
        place = before.next_vertex[stays] if before is not None else none
        ap = before.load_ap[stays] if before is not None else none
        return SlotView(
            slot=slot,
            robot=before.robot[stays] if before is not None else none,
            vertex=place,
            next_vertex=place,
            edge=np.full(len(stays), -1, np.int64),
            piece=np.zeros(len(stays), np.int64),
            slots=np.ones(len(stays), np.int64),
            moves=np.zeros(len(stays), np.bool_),
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
        load_ap[here[goes_on]] = before.load_ap[there[goes_on]]
        return piece, load_ap

    def _check_plan(self, view: SlotView) -> None:
        """Nothing disturbs a run, so every state is the plan's (page 5: replayed slot for slot)."""
        context, table = self._context, self._context.timetable
        known = np.isin(view.robot, table.on_floor(view.slot))
        robot = view.robot[known]
        rows = table.rows(robot, view.slot)
        states = [self._states[i] for i in robot.tolist()]
        edge = table.edge[rows]
        uv = np.append(context.inputs.problem.edge_uv, [[-1, -1]], axis=0)[edge]
        vertex = table.vertex[rows]
        leads_to = np.where(edge < 0, vertex, uv.sum(axis=1) - vertex)
        arrived = view.slot >= table.arrival[robot]
        activity = np.where(arrived, ARRIVED, np.where(edge >= 0, MOVING, WAITING))

        def compare(
            what: str, found: list[int] | list[str], expected: np.ndarray[tuple[int], np.dtype]
        ) -> None:
            values = np.array(found) if found else expected[:0]
            context.each(_PLAN, view.slot, robot, values != expected, what, values, expected)

        compare("visit", [s.visit for s in states], np.minimum(view.slot, table.arrival[robot]))
        compare("vertex", [s.vertex for s in states], vertex)
        compare("edge", [s.edge for s in states], edge)
        compare("next vertex", [s.next_vertex for s in states], leads_to)
        compare("activity", [s.activity for s in states], activity)
        compare("waits for", [s.waits_for for s in states], np.full(len(robot), ""))

        served, planned = view.ap[known], table.ap[rows]
        # Amid a crossing of several slots the next AP may serve already; its end is in the plan.
        ahead = np.where(view.piece[known] > 0, (view.slots - view.piece)[known], 0)
        later = table.ap[rows + np.minimum(ahead, np.maximum(table.arrival[robot] - view.slot, 0))]
        names = np.array([*context.start.aps, "none"])
        context.each(
            _PLAN,
            view.slot,
            robot,
            (served != planned) & (served != later),
            "AP",
            names[served],
            names[planned],
        )

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
                found_load = f"{name} serves {load} robots"
                self._find("§1.6", found_load, f"at most {capacity}", view.slot)
                self._incidents.expect("overload", view.slot, (), name, float(load))

    def _check_arrivals(self, slot: int, over: bool) -> None:
        context = self._context
        due = set() if over else set(np.flatnonzero(context.timetable.arrival == slot).tolist())
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
