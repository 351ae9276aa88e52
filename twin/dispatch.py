"""What robots are to do, slot by slot: delays, new plans, the policy's word, and when to give up.

A plan is in force from a slot on, until there is another one: its visit order, the ways it leads
over, and the state of it that each robot is at.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from logs.records import BY_FAILURE, CAUSES
from twin.control import Control
from twin.motion import Roads
from twin.order import Commit, StrictOrder, catch_up, order_of, rotation
from twin.replan import NewPlan, Situation, plan_anew
from twin.reports import deadlock, delay, new_paths, replan_record
from twin.watch import Watch
from worlds.errands import robot_height_m
from worlds.events import longest_run_slots

if TYPE_CHECKING:
    from logs.records import Record
    from planner.problem import Problem
    from twin.association import Instants
    from twin.disturbances import Disturbances
    from twin.motion import SlotMotion
    from twin.network import Network
    from twin.order import Policy, VisitOrder
    from worlds.floor import Boxes
    from worlds.world import World

Ints = NDArray[np.int32]


class Dispatch:
    """Decides in each slot who advances, by the plan in force.

    Attributes:
        order: the visit order in force.
        base: slot in which it begins.
        roads: its ways.
        at: (N,) int32, state of it that each robot is at.
        ended: why the run ends before everybody has arrived, "" if it does not.
    """

    def __init__(
        self,
        world: World,
        problem: Problem,
        boxes: Boxes,
        order: VisitOrder,
        instants: Instants,
        disturbances: Disturbances,
        policy: Policy,
        emit: Callable[[Record], None],
    ) -> None:
        """Begin with a plan.

        Args:
            world, problem, instants, disturbances: of the run.
            boxes: the obstacles.
            order: the plan's.
            policy: says which robots that are ready advance.
            emit: takes records of what is decided.
        """
        self._world, self._problem, self._boxes = world, problem, boxes
        self._instants, self._disturbances = instants, disturbances
        self._policy, self._emit = policy, emit
        self.order, self.base = order, 0
        self.roads = Roads(problem, order, boxes, world.hall.body, robot_height_m(world))
        self.at: Ints = np.zeros(problem.n_robots, np.int32)
        self.ended = ""
        self._heading = np.zeros(problem.n_robots)
        self._control = Control(world, problem, disturbances, policy)
        self._watch = Watch(world, problem, disturbances)
        self._longest = longest_run_slots(world)
        self._rescued = False  # a new plan was asked for in the deadlock there is

    def note(self, motion: SlotMotion, commit: Commit) -> None:
        """A slot is over: who advanced is at his next state, and heads where he drove."""
        self._heading[motion.robot] = motion.heading_rad
        self.at = self.at + commit.advance

    def nobody(self) -> tuple[Commit, Ints]:
        """What `decide` would say if the run is over."""
        n = self._problem.n_robots
        commit = Commit(np.zeros(n, np.bool_), np.full(n, -1, np.int32))
        return commit, np.full(n, -1, np.int32)

    def decide(self, slot: int, network: Network) -> tuple[Commit, Ints]:
        """Delays, a new plan if there is a cause, the policy's word, the watchdog's.

        Args:
            slot: that begins.
            network: as it is at its beginning; serves by a new plan if there is one.

        Returns:
            Who advances; (N,) int32 index into `CAUSES` of why others do not, −1 for none.
        """
        control, watch = self._control, self._watch
        self.at = catch_up(self.order, self.at, slot - self.base)
        for i, slots, name in control.begin_delays(slot, self.order, self.at):
            robot = self._problem.robot_ids[i]
            self._emit(delay(self._instants, slot, robot, slots, name))
        control.note_failures(slot)
        control.release(self.order, self.at, network.connected)
        cause = watch.cause(slot, self.order, self.at, network.connected, control.failed)
        if cause:
            self._replan(slot, network, *cause)
            control.release(self.order, self.at, network.connected)
        commit, why, unfinished = control.decide(slot, self.order, self.at)
        if unfinished.any() and not commit.advance.any() and not self._due(slot, network, commit):
            # They would stand like this for ever.
            failed = control.failed | (why == CAUSES.index(BY_FAILURE))
            if (unfinished & ~failed).any():
                self._emit(deadlock(self._problem, self._instants, slot, commit, why))
                if self._world.run.replan and not self._rescued:
                    self._rescued = True
                    self._replan(slot, network, "deadlock", "")
                    control.release(self.order, self.at, network.connected)
                    commit, why, unfinished = control.decide(slot, self.order, self.at)
                if not commit.advance.any():
                    self.ended = self._nobody_moves(commit)
            else:
                self.ended = "only robots that have failed are left"
        elif commit.advance.any():
            self._rescued = False
        if slot + 1 >= self._longest and not self.ended:
            self.ended = f"the limit of {self._longest} slots (run.max_slots) is reached"
        return commit, why

    def _due(self, slot: int, network: Network, commit: Commit) -> bool:
        """Whether something is to come that can let robots advance later."""
        order, at = self.order, self.at
        # The end of a delay helps nobody who has failed, or has no further way.
        held = order.stuck(at)
        if len(order.robot):
            held |= self._control.failed & (order.piece[order.row(at)] == 0)
        late = (self._control.late_until > slot) & ~order.done(at) & ~order.gone(at) & ~held
        return (
            commit.due
            or bool(late.any())
            or self._disturbances.is_changing(slot)
            or network.pending
            or self._watch.is_due(slot, self.order, self.at, self._control.failed)
        )

    def _nobody_moves(self, commit: Commit) -> str:
        names = self._problem.robot_ids
        pairs = enumerate(commit.waits_for.tolist())
        waits = [f"{names[i]} waits for {names[j]}" for i, j in pairs if j >= 0]
        return "; ".join(["nobody can move", *waits[:5]])

    def _replan(self, slot: int, network: Network, cause: str, name: str) -> None:
        """Ask for a new plan, and adopt it if there is one that is worth it."""
        control = self._control
        closed = self._disturbances.blocked_for_good(slot)
        out = ~self._disturbances.ap_up(slot)
        at, order = self.at, self.order
        new = plan_anew(
            Situation(
                self._problem, order, at, network.serving, network.connected, control.failed,
                control.released, *closed, out, not self._disturbances.affects_radio,
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
            self._adopt(slot, network, fresh)
        self._watch.asked(slot, self.order, self.at, network.connected, control.failed)
        number = self._watch.number
        record = replan_record(self._instants, slot, number, cause, name, new, refused)
        self._emit(record)
        if new is not None:
            for path in new_paths(self._problem, self._instants, slot, number, new):
                self._emit(path)

    def _adopt(self, slot: int, network: Network, order: VisitOrder) -> None:
        """Execute another plan from this slot on."""
        self.order, self.base = order, slot
        self.at = np.zeros_like(self.at)
        self.roads = Roads(
            self._problem, order, self._boxes, self._world.hall.body,
            robot_height_m(self._world), self._heading.copy(),
        )  # fmt: skip
        network.adopt(order, self.roads)
        self._control.adopt(order)


def _is_better(new: NewPlan, order: VisitOrder) -> bool:
    """Whether a new plan leads more robots to their goals, or as many for less."""
    stranded = int((~order.to_goal).sum())
    if len(new.without_path) != stranded:
        return len(new.without_path) < stranded
    return new.cost_after < new.cost_before
