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
    ApLoad,
    Arrival,
    Blockages,
    Incident,
    Record,
    RunEnd,
    RunStart,
)
from twin.association import Instants, Prediction, nanoseconds
from twin.bodies import Bodies, touched_blockages
from twin.clearance import nearness
from twin.dispatch import Dispatch
from twin.disturbances import Disturbances
from twin.link_changes import Change
from twin.network import Network
from twin.order import (
    GroupCommit,
    Policy,
    StrictOrder,
    refuse_rotation,
    visit_order,
)
from twin.reports import (
    BLOCKAGE_COLUMNS,
    NO_BOXES,
    blockages,
    happening,
)
from twin.slot import Slot
from worlds.scene import Scene

if TYPE_CHECKING:
    from planner.plan import Plan
    from planner.problem import Problem
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

    def __init__(self, env: simpy.Environment, at_ns: int, priority: EventPriority) -> None:
        # As Timeout does: what `Event.__init__` would set, without the call.
        self.env = env
        self.callbacks = []
        self._ok = True
        self._value = None
        env.schedule(self, priority, at_ns - env.now)


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
        self._world, self._problem, self._boxes = world, problem, floor.boxes
        prediction = Prediction(floor, radio_map, problem)
        order = visit_order(problem, plan)
        self._instants = Instants.of(floor.slot_s, world.run.samples_per_slot)
        self._disturbances = Disturbances(world, problem, self._instants)
        policy = policy or POLICIES[world.run.policy]()
        if isinstance(policy, StrictOrder):
            refuse_rotation(order, problem.robot_ids)
        self._dispatch = Dispatch(
            world, problem, floor.boxes, order, self._instants, self._disturbances, policy,
            self._emit,
        )  # fmt: skip
        self._network = Network(
            world, prediction, problem, order, self._instants,
            Bodies(world, scene, self._disturbances), self._disturbances, self._dispatch.roads,
        )  # fmt: skip
        self._emit_on, self._on_slot = emit, on_slot

        self._env = simpy.Environment()
        self._places = max(problem.n_robots, problem.n_aps, 1)  # in a phase
        self._last_visit = order.arrival.copy()
        self._arrived = [False] * problem.n_robots
        self._incidents: Counter[str] = Counter()
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
            policy=policy.name,
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
        for i in np.flatnonzero(self._dispatch.order.arrival >= 0).tolist():
            self._env.process(self._robot(i))
        for a in range(self._problem.n_aps):
            self._env.process(self._ap(a))
        self._env.run(until=clock)

    # --- processes --------------------------------------------------------------------------

    def _until(self, t_s: float, phase: Phase, number: int = 0) -> Instant:
        """The event of a phase at a time, for the robot or AP of that number."""
        return Instant(self._env, nanoseconds(t_s), self._priority(phase, number))

    def _priority(self, phase: Phase, number: int) -> EventPriority:
        """Its place among the events of one instant."""
        return EventPriority(phase * self._places + number)

    def _clock(self) -> Process:
        """Slot after slot: decide, check, sample, close; then the end."""
        t_s = self._instants.t_s
        number, is_last = 0, False
        while not is_last:
            yield self._until(t_s(number), Phase.DECIDE)
            slot = self._begin(number)
            is_last = bool(self._dispatch.ended) or self._all_home(slot)
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
                plan = self._dispatch
                expected = plan.base + int(plan.order.arrival.max(initial=0)) + 1
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
        priority = self._priority(Phase.STATES, i)
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
            if not self._arrived[i] and slot.at_goal[i]:
                self._arrived[i] = True
                robot, goal = self._problem.robot_ids[i], int(self._problem.goal[i])
                self._emit(Arrival(slot.begin_s, slot.number, robot, goal))
            self._emit(slot.state(i))
            for change in changes:
                yield self._until(change.t_s, Phase.LINKS, i)
                self._change(i, change)
            yield Instant(self._env, self._next_ns, priority)

    def _ap(self, a: int) -> Process:
        """One AP: its load in every slot."""
        ap, capacity = self._problem.ap_ids[a], int(self._problem.ap_capacity[a])
        yield self._until(0.0, Phase.LOADS, a)
        priority = self._priority(Phase.LOADS, a)
        while not self._over:
            slot, load = self._slot, self._load[a]
            self._emit(ApLoad(slot.begin_s, slot.number, ap, load, capacity))
            self._report(slot.overload(ap, load, capacity))
            yield Instant(self._env, self._next_ns, priority)

    # --- a slot -----------------------------------------------------------------------------

    def _begin(self, number: int) -> Slot:
        """Decide who advances and compute the slot; nobody advances once the run is over."""
        dispatch = self._dispatch
        if number:
            dispatch.note(self._slot.motion, self._slot.commit)
        if self._over:
            commit, cause = dispatch.nobody()
        else:
            self._happen(number, 0)
            commit, cause = dispatch.decide(number, self._network)
        order, at = dispatch.order, dispatch.at
        on_floor = order.arrival >= 0
        self._last_visit = np.where(on_floor, order.arrival, self._last_visit).astype(np.int32)
        motion = dispatch.roads.motion(at, commit.advance)
        radio = self._network.slot(number, motion, commit.advance, only_begin=self._over)
        slot = Slot(
            self._problem, order, self._instants, number, at, commit, cause,
            self._last_visit, motion, radio,
        )  # fmt: skip
        self._load = self._network.load(motion, radio).tolist()
        self._slot, self._next_ns = slot, nanoseconds(slot.end_s)
        if number == 0:
            self._report(slot.unserved())
        return slot

    def _close(self, slot: Slot) -> None:
        """What the bodies came near to, or touched, during the slot that ends."""
        near = nearness(slot.motion, self._world.hall.body)
        self._report(slot.contacts(near))
        hit = self._dispatch.roads.obstacle(slot.motion, slot.at)
        self._report(slot.obstructed(hit, self._boxes.name))
        if self._disturbances.blockages:
            touched = touched_blockages(
                self._disturbances, slot.number, self._instants.fractions, slot.motion
            )
            self._report(slot.caught(touched))
        self._emit(slot.separation(near))

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
        if self._dispatch.ended:
            reasons.append(self._dispatch.ended)
        counts = [(kind, self._incidents[kind]) for kind in _FAILURES]
        reasons += [f"{count} x {kind}" for kind, count in counts if count]
        return ("failed" if reasons else "completed"), "; ".join(reasons)

    # --- records ----------------------------------------------------------------------------

    def _emit(self, record: Record) -> None:
        if isinstance(record, Incident):
            self._incidents[record.kind] += 1
        self._kpi.add(record)
        self._emit_on(record)

    def _report(self, incidents: Iterable[Incident]) -> None:
        for incident in incidents:
            self._emit(incident)
