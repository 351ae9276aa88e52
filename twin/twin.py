"""`run`: a plan executed in time, as a stream of records.

simpy processes are the clock, every robot and every AP. Time is kept in whole nanoseconds, so that
"at the same instant" has one meaning. The clock computes a slot at its beginning, for all robots at
once (nothing unforeseen happens within one: what goes wrong follows from the world alone, see
`twin.disturbances`); the processes bring it out when its time has come.

**Order of events.** Events are ordered by (time, phase, number of the robot or AP), never by which
process was created or scheduled first. At one instant:

0. `EVENTS`, within a slot: Disturbances that begin or are over.
1. `LINKS`: changes within a slot, robots in their order: Incident "outage" (one that ends now),
   Handover, RobotState. A handover at a slot's last instant belongs to the slot that ends.
2. `CLOSE`, where a slot ends: Incident "contact", "obstacle" and "caught" of the slot, Separation,
   Kpi.
3. `DECIDE`, where a slot begins: Disturbances that begin or are over, delays last; a Replan with
   its NewPaths; the policy decides who advances; Incident "unserved" at t = 0, "deadlock".
4. `STATES`, robots in their order: an outage that ends now, Arrival, RobotState.
5. `LOADS`, APs in their order: ApLoad, Incident "overload".
6. `CHECKS`: Incident "collision".
7. `SAMPLE`: Blockages, if they are not as told last; the Sample, of what holds from now on.

RunStart comes first of all. The run ends with the slot of the last arrival, or in which it is clear
that no further one will come, which is played to its end like every other: then come the contacts
and the Separation of that slot, the states of robots that leave (GONE), the last Sample (of what is
left on the floor), outages still open, the last Kpi, every RobotKpi, every ApKpi, Waits, RunEnd.
The same inputs give equal records in the same order.

**Who is on the floor.** A robot without a path is not: Incident "unserved" and no state. Under
`leave` a body is gone from the slot after its arrival: it has one state GONE then and is in no
sample; under `park` it stays, served and loaded, until the run's end (§1.4). A goal may be entered
in the slot in which a robot leaves it: the clearance of these two is not measured in that slot. A
Separation of −1000 m says that there were no two bodies to measure.

**Ends.** A run has failed if a robot has not arrived, or if there was a collision, a contact, or an
obstacle in the way; overloads, outages and robots caught by a blockage are figures. It always ends:
with the last arrival; when nobody can move, nothing is due that could change it, and one new plan
did not help either ("deadlock"); or after `run.max_slots` slots.

**Times.** Records of a slot's end (Separation, Kpi, contacts) name the slot that ends. An outage is
reported when it is over, `value` seconds long (interruptions by handovers not counted), `t_s` being
its end; the message has its beginning.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Iterable
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np
import simpy
from simpy.events import EventPriority

from logs.kpi import KpiFold, planned_figures
from logs.records import (
    BY_FAILURE,
    CAUSES,
    ApLoad,
    Arrival,
    Blockages,
    Incident,
    Record,
    RunEnd,
    RunStart,
)
from twin.association import Instants, Prediction, nanoseconds
from twin.bodies import Bodies
from twin.control import Control
from twin.disturbances import Disturbances
from twin.motion import Roads, nearness
from twin.network import Change, Network
from twin.order import (
    Commit,
    GroupCommit,
    Policy,
    StrictOrder,
    catch_up,
    order_of,
    refuse_rotation,
    rotation,
    visit_order,
)
from twin.replan import NewPlan, Situation, plan_anew
from twin.reports import (
    BLOCKAGE_COLUMNS,
    NO_BOXES,
    blockages,
    deadlock,
    delay,
    happening,
    new_paths,
    replan_record,
)
from twin.slot import Slot
from twin.watch import Watch
from worlds.errands import robot_height_m
from worlds.events import longest_run_slots
from worlds.scene import Scene

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from planner.plan import Plan
    from planner.problem import Problem
    from twin.order import VisitOrder
    from worlds.floor import Floor
    from worlds.radio_map import RadioMap
    from worlds.world import World

Process = Generator[simpy.Event, Any, None]

_FAILURES = ("collision", "contact", "obstacle")
POLICIES: dict[str, type[GroupCommit | StrictOrder]] = {"group": GroupCommit, "strict": StrictOrder}


class Phase(IntEnum):
    """What comes first at one instant; see the head of this file."""

    EVENTS = 0
    LINKS = 1
    CLOSE = 2
    DECIDE = 3
    STATES = 4
    LOADS = 5
    CHECKS = 6
    SAMPLE = 7


class Instant(simpy.Event):
    """A point in time that comes; like simpy's Timeout, but with a place among its equals."""

    def __init__(self, env: simpy.Environment, at_ns: int, priority: int) -> None:
        # As Timeout does: what `Event.__init__` would set, without the call.
        self.env = env
        self.callbacks = []
        self._ok = True
        self._value = None
        env.schedule(self, EventPriority(priority), at_ns - env.now)


def run(
    world: World,
    floor: Floor,
    radio_map: RadioMap,
    problem: Problem,
    plan: Plan,
    *,
    emit: Callable[[Record], None],
    on_slot: Callable[[int, int], None] | None = None,
    policy: Policy | None = None,
) -> None:
    """Execute a plan and emit the records of it in time order.

    Args:
        world: the world the plan is made for; what goes wrong in the run is in it
            (`twin.disturbances.declare` adds to that).
        floor: what it resolves to.
        radio_map: of the same.
        problem: made from these three (`problem_from_world`).
        plan: walks in the problem's graph; whether they keep its rules is not asked: a plan that
            breaks one is executed as it is, and the twin reports what comes of it.
        emit: takes each record.
        on_slot: told (slots done, slots of the plan) after each slot.
        policy: decides in each slot who advances; that of `run.policy` if not given.

    Raises:
        TwinError: the inputs do not belong together, or the policy cannot execute the plan.
    """
    with Scene.of(world, floor) as scene:
        _Run(world, floor, radio_map, problem, plan, scene, emit, on_slot, policy).play()


class _Run:
    """A run being made: the state that goes from slot to slot, and the processes."""

    def __init__(
        self,
        world: World,
        floor: Floor,
        radio_map: RadioMap,
        problem: Problem,
        plan: Plan,
        scene: Scene,
        emit: Callable[[Record], None],
        on_slot: Callable[[int, int], None] | None,
        policy: Policy | None,
    ) -> None:
        self._world, self._problem, self._body = world, problem, world.hall.body
        self._boxes = floor.boxes
        prediction = Prediction(floor, radio_map, problem)
        self._order = order = visit_order(problem, plan)
        self._base = 0  # slot in which the order in force begins
        self._instants = Instants.of(floor.slot_s, world.run.samples_per_slot)
        self._roads = Roads(problem, order, floor.boxes, self._body, robot_height_m(world))
        self._heading = np.zeros(problem.n_robots)
        self._disturbances = Disturbances(world, problem, self._instants)
        self._bodies = Bodies(world, scene, self._disturbances)
        self._network = Network(
            world, prediction, problem, order, self._instants, self._bodies, self._disturbances
        )
        self._policy = policy or POLICIES[world.run.policy]()
        if isinstance(self._policy, StrictOrder):
            refuse_rotation(order, problem.robot_ids)
        self._control = Control(world, problem, self._disturbances, self._policy)
        self._watch = Watch(world, problem, self._disturbances)
        self._longest = longest_run_slots(world)
        self._emit_on, self._on_slot = emit, on_slot

        self._env = simpy.Environment()
        self._places = max(problem.n_robots, problem.n_aps, 1)  # in a phase
        self._at = np.zeros(problem.n_robots, np.int32)  # state each robot is at
        self._last_visit = order.arrival.copy()
        self._arrived = [False] * problem.n_robots
        self._incidents: Counter[str] = Counter()
        self._rescued = False  # a new plan was asked for in the deadlock there is
        self._ended = ""  # why the run ends before everybody has arrived
        self._told: Blockages | None = None  # blockages as told last
        self._over = False  # the last slot has been played
        self._slot: Slot
        self._load: list[int]
        self._next_ns: int  # beginning of the next slot

        self._start = RunStart(
            t_s=0.0,
            world=world.name,
            slot_s=floor.slot_s,
            horizon=problem.horizon,
            samples_per_slot=world.run.samples_per_slot,
            interruption_s=world.run.interruption_s,
            threshold_db=radio_map.threshold_db,
            policy=self._policy.name,
            at_goal=problem.at_goal,
            seed=world.run.seed,
            robots=problem.robot_ids,
            aps=problem.ap_ids,
            ap_capacity=tuple(problem.ap_capacity.tolist()),
        )
        self._kpi = KpiFold(self._start, planned_figures(plan))

    def play(self) -> None:
        """Run from RunStart to RunEnd."""
        self._emit_on(self._start)
        clock = self._env.process(self._clock())
        for i in np.flatnonzero(self._order.arrival >= 0).tolist():
            self._env.process(self._robot(i))
        for a in range(self._problem.n_aps):
            self._env.process(self._ap(a))
        self._env.run(until=clock)

    # --- processes --------------------------------------------------------------------------

    def _until(self, t_s: float, phase: Phase, number: int = 0) -> Instant:
        """The event of a phase at a time, for the robot or AP of that number."""
        return Instant(self._env, nanoseconds(t_s), phase * self._places + number)

    def _until_next_slot(self, phase: Phase, number: int) -> Instant:
        return Instant(self._env, self._next_ns, phase * self._places + number)

    def _clock(self) -> Process:
        """Slot after slot: decide, check, sample, close; then the end."""
        t_s = self._instants.t_s
        number, is_last = 0, False
        while not is_last:
            yield self._until(t_s(number), Phase.DECIDE)
            slot = self._begin(number)
            is_last = bool(self._ended) or self._all_home(slot)
            yield self._until(t_s(number), Phase.CHECKS)
            self._report(slot.collisions())
            for step in range(self._instants.steps):
                if step and self._disturbances.happenings(number, step):
                    yield self._until(t_s(number, step), Phase.EVENTS)
                    self._happen(number, step)
                yield self._until(t_s(number, step), Phase.SAMPLE)
                self._tell_blockages(number, step)
                self._emit(slot.sample(step))
            number += 1
            yield self._until(t_s(number), Phase.CLOSE)
            self._close(slot)
            if not is_last:
                self._emit(self._kpi.current(slot.end_s, slot.number))
            if self._on_slot:
                expected = self._base + int(self._order.arrival.max(initial=0)) + 1
                self._on_slot(number, max(expected, number))
        self._over = True
        yield self._until(t_s(number), Phase.DECIDE)
        self._begin(number)
        yield self._until(t_s(number), Phase.SAMPLE)
        self._end(slot, self._slot)

    def _all_home(self, slot: Slot) -> bool:
        """Whether everybody on the floor stands at its goal for good, or has left."""
        order = slot.order
        return bool((order.gone(slot.at) | slot.arrived | order.done(slot.at)).all())

    def _robot(self, i: int) -> Process:
        """One robot: its state in every slot, and what happens to its link in between."""
        yield self._until(0.0, Phase.STATES, i)
        while True:
            slot = self._slot
            k = slot.body[i]
            if k < 0:
                self._end_outage(i, slot)
                self._emit(slot.state(i))
                return
            changes = slot.radio.changes.get(k, [])
            if changes and changes[0].step == 0 and changes[0].outage:
                self._change(i, changes[0])
                changes = changes[1:]
            if self._over:
                return
            if not self._arrived[i] and slot.arrived[i]:
                self._arrived[i] = True
                robot, goal = self._problem.robot_ids[i], int(self._problem.goal[i])
                self._emit(Arrival(slot.begin_s, slot.number, robot, goal))
            self._emit(slot.state(i))
            for change in changes:
                yield self._until(change.t_s, Phase.LINKS, i)
                self._change(i, change)
            yield self._until_next_slot(Phase.STATES, i)

    def _ap(self, a: int) -> Process:
        """One AP: its load in every slot."""
        ap, capacity = self._problem.ap_ids[a], int(self._problem.ap_capacity[a])
        yield self._until(0.0, Phase.LOADS, a)
        while not self._over:
            slot, load = self._slot, self._load[a]
            self._emit(ApLoad(slot.begin_s, slot.number, ap, load, capacity))
            self._report(slot.overload(ap, load, capacity))
            yield self._until_next_slot(Phase.LOADS, a)

    # --- a slot -----------------------------------------------------------------------------

    def _begin(self, number: int) -> Slot:
        """Decide who advances and compute the slot; nobody advances once the run is over."""
        n = self._problem.n_robots
        if number:
            before = self._slot
            self._heading[before.motion.robot] = before.motion.heading_rad
            self._at = self._at + before.commit.advance
        if self._over:
            commit = Commit(np.zeros(n, np.bool_), np.full(n, -1, np.int32))
            cause = np.full(n, -1, np.int32)
        else:
            self._happen(number, 0)
            self._at = catch_up(self._order, self._at, number - self._base)
            commit, cause = self._decide(number)
        order = self._order
        on_floor = order.arrival >= 0
        self._last_visit = np.where(on_floor, order.arrival, self._last_visit).astype(np.int32)
        motion = self._roads.motion(self._at, commit.advance)
        radio = self._network.slot(number, motion, commit.advance, only_begin=self._over)
        slot = Slot(
            self._problem, order, self._instants, number, self._at, commit, cause,
            self._last_visit, motion, radio,
        )  # fmt: skip
        self._load = self._network.load(motion, radio).tolist()
        self._slot, self._next_ns = slot, nanoseconds(slot.end_s)
        if number == 0:
            self._report(slot.unserved())
        return slot

    def _decide(self, slot: int) -> tuple[Commit, NDArray[np.int32]]:
        """Delays, a new plan if there is a cause, the policy's word, the watchdog's."""
        control, watch, network = self._control, self._watch, self._network
        for i, slots, name in control.begin_delays(slot, self._order, self._at):
            robot = self._problem.robot_ids[i]
            self._emit(delay(self._instants, slot, robot, slots, name))
        control.note_failures(slot)
        control.release(self._order, self._at, network.connected)
        cause = watch.cause(slot, self._order, self._at, network.connected, control.failed)
        if cause:
            self._replan(slot, *cause)
            control.release(self._order, self._at, network.connected)
        commit, why, unfinished = control.decide(slot, self._order, self._at)
        if unfinished.any() and not commit.advance.any() and not self._due(slot, commit):
            # They would stand like this for ever.
            failed = control.failed | (why == CAUSES.index(BY_FAILURE))
            if (unfinished & ~failed).any():
                self._report([deadlock(self._problem, self._instants, slot, commit, why)])
                if self._world.run.replan and not self._rescued:
                    self._rescued = True
                    self._replan(slot, "deadlock", "")
                    control.release(self._order, self._at, network.connected)
                    commit, why, unfinished = control.decide(slot, self._order, self._at)
                if not commit.advance.any():
                    self._ended = self._nobody_moves(commit)
            else:
                self._ended = "only robots that have failed are left"
        elif commit.advance.any():
            self._rescued = False
        if slot + 1 >= self._longest and not self._ended:
            self._ended = f"the limit of {self._longest} slots (run.max_slots) is reached"
        return commit, why

    def _due(self, slot: int, commit: Commit) -> bool:
        """Whether something is to come that can let robots advance later."""
        late = self._control.late_until > slot + 1
        on_way = ~self._order.done(self._at) & ~self._order.gone(self._at)
        return (
            commit.due
            or bool((late & on_way).any())
            or bool((self._control.late_until == slot + 1).any())
            or self._disturbances.is_changing(slot)
            or self._network.pending
            or self._watch.is_due(slot, self._order, self._at, self._control.failed)
        )

    def _nobody_moves(self, commit: Commit) -> str:
        names = self._problem.robot_ids
        pairs = enumerate(commit.waits_for.tolist())
        waits = [f"{names[i]} waits for {names[j]}" for i, j in pairs if j >= 0]
        return "; ".join(["nobody can move", *waits[:5]])

    def _replan(self, slot: int, cause: str, name: str) -> None:
        """Ask for a new plan, and adopt it if there is one that is worth it."""
        network, control = self._network, self._control
        closed = self._disturbances.blocked_for_good(slot)
        out = ~self._disturbances.ap_up(slot)
        at, order = self._at, self._order
        new = plan_anew(
            Situation(
                self._problem, order, at, network.serving, network.connected, control.failed,
                control.released, *closed, out,
            ),
            seed=self._world.run.seed,
            iterations=self._world.run.replan_iterations,
        )  # fmt: skip
        refused = ""
        if new is not None and cause in {"slip", "recovery"} and not _is_better(new, order):
            new, refused = None, "no better than the one in force"
        if new is not None:
            fresh = order_of(self._problem, list(new.routes))
            if isinstance(self._policy, StrictOrder) and rotation(fresh) is not None:
                new, refused = None, "it has a rotation, which strict order refuses"
        if new is not None:
            self._adopt(slot, fresh)
        self._watch.asked(slot, self._order, self._at, network.connected, control.failed)
        number = self._watch.number
        record = replan_record(self._instants, slot, number, cause, name, new, refused)
        self._emit(record)
        if new is not None:
            for path in new_paths(self._problem, self._instants, slot, number, new):
                self._emit(path)

    def _adopt(self, slot: int, order: VisitOrder) -> None:
        """Execute another plan from this slot on."""
        self._order, self._base = order, slot
        self._at = np.zeros_like(self._at)
        self._roads = Roads(
            self._problem, order, self._boxes, self._body, robot_height_m(self._world),
            self._heading.copy(),
        )  # fmt: skip
        self._network.adopt(order)
        self._control.adopt(order)

    def _close(self, slot: Slot) -> None:
        """What the bodies came near to, or touched, during the slot that ends."""
        near = nearness(slot.motion, self._body)
        self._report(slot.contacts(near))
        self._report(slot.obstructed(self._roads.obstacle(slot.motion, slot.at), self._boxes.name))
        if self._disturbances.blockages:
            self._report(slot.caught(self._touched(slot)))
        self._emit(slot.separation(near))

    def _touched(self, slot: Slot) -> dict[int, str]:
        """Bodies that touch a blockage at some instant of the slot, and its name."""
        found: dict[int, str] = {}
        for step in range(self._instants.steps):
            boxes = self._disturbances.boxes(slot.number, step)
            if len(boxes):
                places = slot.motion.xy_m(np.array([step / self._instants.steps]))[:, 0]
                hit = self._disturbances.touched(boxes, places, slot.motion.heading_rad)
                for k in np.flatnonzero(hit >= 0).tolist():
                    found.setdefault(k, boxes.name[hit[k]])
        return found

    def _happen(self, slot: int, step: int) -> None:
        """Tell what begins or is over at an instant."""
        for what in self._disturbances.happenings(slot, step):
            self._emit(happening(self._world, self._instants, slot, step, what))

    def _tell_blockages(self, slot: int, step: int) -> None:
        """Tell where blockages are, unless nothing has changed since it was told last."""
        if not self._disturbances.blockages:
            return
        now = blockages(self._instants, slot, step, self._disturbances.boxes(slot, step))
        before = self._told or blockages(self._instants, 0, 0, NO_BOXES)
        if any(getattr(now, name) != getattr(before, name) for name in BLOCKAGE_COLUMNS):
            self._emit(now)
            self._told = now

    def _change(self, i: int, change: Change) -> None:
        """What happens to robot i's link within the slot."""
        if change.outage:
            self._report([self._slot.outage(i, change.outage)])
        for record in (self._slot.handover(i, change), self._slot.changed_state(i, change)):
            if record:
                self._emit(record)

    def _end_outage(self, i: int, slot: Slot) -> None:
        """Report an outage that lasts until its robot leaves, or the run is over."""
        outage = self._network.end_outage(i, slot.begin_s)
        if outage:
            self._report([slot.outage(i, outage)])

    def _end(self, last: Slot, after: Slot) -> None:
        """What comes after the last slot, at the instant at which it ends."""
        self._tell_blockages(after.number, 0)
        self._emit(after.sample(0))
        for i in range(self._problem.n_robots):
            self._end_outage(i, after)
        self._emit(self._kpi.current(last.end_s, last.number))
        for figures in self._kpi.final(last.end_s, last.number):
            self._emit(figures)
        self._emit(self._kpi.waits(last.end_s))
        self._emit(RunEnd(last.end_s, last.number, *self._verdict()))

    def _verdict(self) -> tuple[str, str]:
        """Whether the run is "completed" or "failed", and why."""
        names, reasons = self._problem.robot_ids, []
        missing = [name for name, there in zip(names, self._arrived, strict=True) if not there]
        if missing:
            some = ", ".join(missing[:5]) + (", …" if len(missing) > 5 else "")
            reasons.append(f"{len(missing)} of {len(names)} robots have not arrived: {some}")
        if self._ended:
            reasons.append(self._ended)
        counts = [(kind, self._incidents[kind]) for kind in _FAILURES]
        reasons += [f"{count} x {kind}" for kind, count in counts if count]
        return ("failed" if reasons else "completed"), "; ".join(reasons)

    # --- records ----------------------------------------------------------------------------

    def _emit(self, record: Record) -> None:
        self._kpi.add(record)
        self._emit_on(record)

    def _report(self, incidents: Iterable[Incident]) -> None:
        for incident in incidents:
            self._incidents[incident.kind] += 1
            self._emit(incident)


def _is_better(new: NewPlan, order: VisitOrder) -> bool:
    """Whether a new plan leads more robots to their goals, or as many for less."""
    stranded = int((~order.to_goal).sum())
    if len(new.without_path) != stranded:
        return len(new.without_path) < stranded
    return new.cost_after < new.cost_before
