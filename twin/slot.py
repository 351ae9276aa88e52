"""One slot of a run, computed for all robots, and the records that tell it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from logs.records import (
    ARRIVED,
    CAUSES,
    GONE,
    HELD,
    LINKS,
    MOVING,
    NO_AP,
    WAITING,
    Handover,
    Incident,
    RobotState,
    Sample,
    Separation,
)
from twin.clearance import Nearness

if TYPE_CHECKING:
    from planner.problem import Problem
    from twin.association import Instants
    from twin.link_changes import Change, Outage, SlotRadio
    from twin.motion import SlotMotion
    from twin.order import Commit, VisitOrder

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

NO_SNR_DB = -1000.0
NO_CLEARANCE_M = -1000.0


Doing = tuple[int, int, int, int, str, str]
"""What holds of a robot for a whole slot: visit, vertex, edge, next vertex, activity, waits for."""


@dataclass(frozen=True)
class Slot:
    """A slot of a run.

    Attributes:
        problem, order, instants: of the run.
        number: t.
        at: (N,) int32, state of each robot at its beginning.
        commit: who advances.
        cause: (N,) why robots do not that would, index into `CAUSES`, −1 if for no such cause.
        last_visit: (N,) index of the last state of each robot's path, also of those gone.
        motion: of the n bodies on the floor.
        radio: their links.
    """

    problem: Problem
    order: VisitOrder
    instants: Instants
    number: int
    at: Ints
    commit: Commit
    cause: Ints
    last_visit: Ints
    motion: SlotMotion
    radio: SlotRadio

    @property
    def begin_s(self) -> float:
        """When it begins [s]."""
        return self.instants.t_s(self.number)

    @property
    def end_s(self) -> float:
        """When it ends and the next begins [s]."""
        return self.instants.t_s(self.number + 1)

    @cached_property
    def body(self) -> list[int]:
        """Of each robot, its index among the bodies of the motion, −1 if not on the floor."""
        body = np.full(self.problem.n_robots, -1)
        body[self.motion.robot] = np.arange(len(self.motion.robot))
        found: list[int] = body.tolist()
        return found

    @cached_property
    def _doing(self) -> list[Doing]:
        """Of each body."""
        motion, names = self.motion, self.problem.robot_ids
        state, crosses = self.at[motion.robot], motion.edge >= 0
        following = np.where(crosses, self.order.next_vertex[motion.row], motion.vertex)
        activity = np.where(crosses, MOVING, WAITING)
        activity = np.where(self.commit.advance[motion.robot], activity, HELD)
        activity = np.where(self.arrived[motion.robot], ARRIVED, activity)
        columns = (state, motion.vertex, motion.edge, following, activity)
        waits_for = [names[j] if j >= 0 else "" for j in self.commit.waits_for[motion.robot]]
        return list(zip(*(column.tolist() for column in columns), waits_for, strict=True))

    @cached_property
    def arrived(self) -> NDArray[np.bool_]:
        """(N,) bool, robots at their goals for good."""
        return np.asarray((self.at == self.order.arrival) & self.order.to_goal)

    @cached_property
    def at_goal(self) -> list[bool]:
        """Whether each robot is, by index."""
        found: list[bool] = self.arrived.tolist()
        return found

    @cached_property
    def _first(self) -> list[tuple[int, int, float, float]]:
        """(AP, link, SNR, rate) of each body at the slot's beginning."""
        radio = self.radio
        columns = (radio.ap, radio.link, radio.snr_db, radio.rate_mbps)
        return list(zip(*(column[:, 0].tolist() for column in columns), strict=True))

    @cached_property
    def _xy_m(self) -> Floats:
        """(n, steps, 2) where the bodies are at each instant but the last."""
        return self.motion.xy_m(self.instants.fractions)

    @cached_property
    def _robots(self) -> tuple[int, ...]:
        """Index of each body's robot."""
        return tuple(self.motion.robot.tolist())

    @cached_property
    def _headings(self) -> tuple[float, ...]:
        """Heading of each body [rad]."""
        return tuple(self.motion.heading_rad.tolist())

    # --- records of all bodies --------------------------------------------------------------

    def sample(self, step: int) -> Sample:
        """All bodies at an instant of the slot."""
        radio = self.radio
        return Sample(
            t_s=self.instants.t_s(self.number, step),
            slot=self.number,
            robot=self._robots,
            x_m=tuple(self._xy_m[:, step, 0].tolist()),
            y_m=tuple(self._xy_m[:, step, 1].tolist()),
            heading_rad=self._headings,
            ap=tuple(radio.ap[:, step].tolist()),
            snr_db=tuple(radio.snr_db[:, step].tolist()),
            map_snr_db=tuple(radio.map_snr_db[:, step].tolist()),
            link=tuple(radio.link[:, step].tolist()),
            rate_mbps=tuple(radio.rate_mbps[:, step].tolist()),
        )

    def separation(self, near: Nearness) -> Separation:
        """The least clearance of the slot, told at its end."""
        if near.clearance_m is None:
            return Separation(self.end_s, self.number, NO_CLEARANCE_M, "", "")
        a, b = self._names(*near.pair)
        return Separation(self.end_s, self.number, near.clearance_m, a, b)

    # --- records of one robot ---------------------------------------------------------------

    def state(self, i: int) -> RobotState:
        """Robot i at the slot's beginning; GONE if it is not on the floor any more."""
        k = self.body[i]
        if k >= 0:
            return self._state(i, self.begin_s, *self._first[k])
        last, goal = int(self.last_visit[i]), int(self.problem.goal[i])
        doing = (last, goal, -1, goal, GONE, "")
        robot = self.problem.robot_ids[i]
        return RobotState(self.begin_s, self.number, robot, *doing, "", NO_AP, NO_SNR_DB, 0.0)

    def changed_state(self, i: int, change: Change) -> RobotState | None:
        """Robot i from a change within the slot on, None if its state says nothing new."""
        return None if change.state is None else self._state(i, change.t_s, *change.state)

    def _state(
        self, i: int, t_s: float, ap: int, link: int, snr_db: float, rate_mbps: float
    ) -> RobotState:
        problem, doing = self.problem, self._doing[self.body[i]]
        return RobotState(
            t_s,
            self.number,
            problem.robot_ids[i],
            *doing,
            problem.ap_ids[ap] if ap >= 0 else "",
            LINKS[link],
            snr_db,
            rate_mbps,
            CAUSES[self.cause[i]] if doing[4] == HELD and self.cause[i] >= 0 else "",
        )

    def handover(self, i: int, change: Change) -> Handover | None:
        """The handover that begins with a change, if one does."""
        if change.handover is None:
            return None
        before, after, end_s = change.handover
        k = self.body[i]
        share = np.array([change.step / self.instants.steps])
        x, y = self.motion.xy_m(share)[k, 0].tolist()
        _, vertex, _, next_vertex, _, _ = self._doing[k]
        return Handover(
            t_s=change.t_s,
            slot=self.number,
            robot=self.problem.robot_ids[i],
            from_ap=self.problem.ap_ids[before] if before >= 0 else "",
            to_ap=self.problem.ap_ids[after],
            vertex=vertex,
            next_vertex=next_vertex,
            x_m=x,
            y_m=y,
            end_s=end_s,
            planned=change.planned,
        )

    # --- incidents --------------------------------------------------------------------------

    def _names(self, *bodies: int) -> tuple[str, ...]:
        return tuple(self.problem.robot_ids[self.motion.robot[k]] for k in bodies)

    def outage(self, i: int, outage: Outage) -> Incident:
        """An outage of robot i that is over."""
        robot = self.problem.robot_ids[i]
        ap = self.problem.ap_ids[outage.ap] if outage.ap >= 0 else ""
        level = f", {outage.least_db:.1f} dB at the least" if outage.least_db > NO_SNR_DB else ""
        text = (
            f"robot {robot} was without connection from {outage.begin_s:.3f} s to "
            f"{outage.end_s:.3f} s, first served by {ap or 'no AP'}{level}"
        )
        return Incident(outage.end_s, self.number, "outage", robot, "", ap, outage.lasted_s, text)

    def unserved(self) -> list[Incident]:
        """Robots for which the plan has no path."""
        names = [self.problem.robot_ids[i] for i in np.flatnonzero(self.order.arrival < 0)]
        text = "the plan has no path for robot {}; it is not on the floor"
        return [
            Incident(self.begin_s, self.number, "unserved", name, "", "", 0.0, text.format(name))
            for name in names
        ]

    def overload(self, ap: str, load: int, capacity: int) -> list[Incident]:
        """More robots served than the AP has places (§1.6)."""
        if load <= capacity:
            return []
        text = f"AP {ap} serves {load} robots in slot {self.number}, {capacity} at most (§1.6)"
        return [Incident(self.begin_s, self.number, "overload", "", "", ap, float(load), text)]

    def collisions(self) -> list[Incident]:
        """Two robots standing at one vertex (§1.2) or on one edge (§1.3) in this slot."""
        motion, found = self.motion, []
        at_vertex = (motion.begin == 0.0) | (motion.begin == 1.0)
        for kind, there, place, rule in (
            ("vertex", at_vertex, motion.vertex, "§1.2"),
            ("edge", motion.edge >= 0, motion.edge, "§1.3"),
        ):
            bodies = np.flatnonzero(there)
            bodies = bodies[np.argsort(place[bodies], kind="stable")]
            for k in np.flatnonzero(np.diff(place[bodies]) == 0):
                a, b = self._names(*bodies[k : k + 2].tolist())
                text = (
                    f"robots {a} and {b} are on {kind} {place[bodies[k]]} in slot {self.number} "
                    f"({rule})"
                )
                found.append(Incident(self.begin_s, self.number, "collision", a, b, "", 0.0, text))
        return found

    def contacts(self, near: Nearness) -> list[Incident]:
        """Bodies that overlap at some time of the slot, told at its end; `value` is negative."""
        found = []
        for first, second, clearance in near.overlaps:
            a, b = self._names(first, second)
            text = (
                f"the bodies of robots {a} and {b} overlap by {-clearance:.3f} m in slot "
                f"{self.number}"
            )
            found.append(Incident(self.end_s, self.number, "contact", a, b, "", clearance, text))
        return found

    def obstructed(self, box: Ints, box_names: tuple[str, ...]) -> list[Incident]:
        """Bodies that touch an obstacle in the slot, told at its end.

        Args:
            box: (n,) the obstacle each body touches, −1 for none.
            box_names: of all obstacles.
        """
        found = []
        for k in np.flatnonzero(box >= 0):
            (robot,) = self._names(int(k))
            text = f"robot {robot} touches obstacle {box_names[box[k]]} in slot {self.number}"
            found.append(Incident(self.end_s, self.number, "obstacle", robot, "", "", 0.0, text))
        return found

    def caught(self, touched: dict[int, str]) -> list[Incident]:
        """Bodies that touch a blockage in the slot, told at its end.

        Args:
            touched: the blockage's name by the body's index.
        """
        found = []
        for k, name in sorted(touched.items()):
            (robot,) = self._names(k)
            text = f"robot {robot} stands in the way of {name}, and touches it, in slot"
            found.append(
                Incident(
                    self.end_s,
                    self.number,
                    "caught",
                    robot,
                    name,
                    "",
                    0.0,
                    f"{text} {self.number}",
                )
            )
        return found
