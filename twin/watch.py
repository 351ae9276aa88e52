"""When to plan anew: causes, cool-down, and the watchdog's wait-for circle (design page 5).

A new plan is asked for

- "ap-outage": an AP has been out for `replan_after_s`, and somebody's path still uses it;
- "blockage": one stands on somebody's path, as far as one can see for good;
- "robot-failure": a failed robot stands on somebody's path;
- "slip": the estimated end of the run is `replan_slip` slots later than when the plan in force was
  made (or since it was last asked whether there is a better one);
- "recovery": robots without a path to their goals may have one again: an AP or a blockage is as it
  was before, or they are connected again, or, four cool-downs later, others are elsewhere;
- "deadlock": nobody can move, and nothing is due that could change it: once, then the run ends.

Between two new plans lie at least `replan_cooldown` slots, whatever the causes (but for deadlocks).
Each outage, blockage and failure is a cause once; what it does later to new paths they know of.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twin.association import nanoseconds

if TYPE_CHECKING:
    from planner.problem import Problem
    from twin.disturbances import Disturbances
    from twin.order import VisitOrder
    from worlds.world import World

Bools = NDArray[np.bool_]
Ints = NDArray[np.int32]

_RETRY = 4  # cool-downs until robots without a path are planned for again anyway


class Watch:
    """Looks for causes to plan anew.

    Attributes:
        number: new plans asked for so far.
    """

    def __init__(self, world: World, problem: Problem, disturbances: Disturbances) -> None:
        self._options = world.run
        self._problem, self._disturbances = problem, disturbances
        self._slot_s = world.hall.grid_slot_s
        self.number = 0
        self._last = -(10**9)  # slot of the last new plan asked for
        self._known: set[tuple[str, str, int]] = set()
        self._end = -1  # expected slot of the last arrival when last asked
        self._seen: tuple[object, ...] = ()

    def cause(
        self,
        slot: int,
        order: VisitOrder,
        at: Ints,
        connected: Bools,
        failed: Bools,
    ) -> tuple[str, str] | None:
        """Why to plan anew now, and the name of what is to blame; None if there is no need."""
        if not self._options.replan:
            return None
        end = self.expected_end(slot, order, at, failed)
        if self._end < 0:
            self._end = end
        if slot - self._last < self._options.replan_cooldown:
            return None
        lost = ~order.to_goal & ~order.gone(at) & ~failed
        found = (
            self._outage(slot, order, at)
            or self._blockage(slot, order, at)
            or self._failure(order, at, failed)
        )
        if found:
            return found
        if lost.any():
            if self._state(slot, lost, connected) != self._seen:
                return "recovery", ""
            if slot - self._last >= _RETRY * max(1, self._options.replan_cooldown):
                return "recovery", ""
        on_way = order.to_goal & ~order.done(at) & ~order.gone(at) & ~failed
        if on_way.any() and end - self._end >= self._options.replan_slip:
            return "slip", ""
        return None

    def asked(
        self, slot: int, order: VisitOrder, at: Ints, connected: Bools, failed: Bools
    ) -> None:
        """A new plan has been asked for; `order` is the one in force from now on."""
        self.number += 1
        self._last = slot
        self._end = self.expected_end(slot, order, at, failed)
        lost = ~order.to_goal & ~order.gone(at) & ~failed
        self._seen = self._state(slot, lost, connected)
        for a, since_ns in self._disturbances.out_since(slot).items():
            self._known.add(("ap", self._problem.ap_ids[a], since_ns))
        for k in self._disturbances.standing(slot):
            self._known.add(("blockage", self._disturbances.blockages[k].name, 0))
        for i in np.flatnonzero(failed).tolist():
            self._known.add(("robot", self._problem.robot_ids[i], 0))

    def is_due(self, slot: int, order: VisitOrder, at: Ints, failed: Bools) -> bool:
        """Whether robots without a path will be planned for again when the cool-down is over."""
        lost = ~order.to_goal & ~order.gone(at) & ~failed
        waits = slot - self._last < self._options.replan_cooldown
        return self._options.replan and waits and bool(lost.any())

    def expected_end(self, slot: int, order: VisitOrder, at: Ints, failed: Bools) -> int:
        """Slot of the last arrival if nothing else happens, over robots led to their goals."""
        on_way = ~order.gone(at) & order.to_goal & ~failed
        left = np.where(on_way, order.arrival - at, 0)
        return slot + int(left.max(initial=0))

    def _state(self, slot: int, lost: Bools, connected: Bools) -> tuple[object, ...]:
        """What decides whether robots without a path can have one."""
        up = tuple(self._disturbances.ap_up(slot).tolist())
        there = tuple(self._disturbances.standing(slot))
        return up, there, tuple(np.flatnonzero(lost & connected).tolist())

    def _ahead(self, order: VisitOrder, at: Ints) -> NDArray[np.intp]:
        """Rows of states still to come, of robots on the floor."""
        state = np.arange(len(order.robot)) - order.first_row[order.robot]
        on_floor = ~order.gone(at)
        return np.flatnonzero((state > at[order.robot]) & on_floor[order.robot])

    def _outage(self, slot: int, order: VisitOrder, at: Ints) -> tuple[str, str] | None:
        now_ns = nanoseconds(slot * self._slot_s)
        for a, since_ns in self._disturbances.out_since(slot).items():
            name = self._problem.ap_ids[a]
            lasts_s = (now_ns - since_ns) * 1e-9
            if ("ap", name, since_ns) in self._known or lasts_s < self._options.replan_after_s:
                continue
            if (order.ap[self._ahead(order, at)] == a).any():
                return "ap-outage", name
        return None

    def _blockage(self, slot: int, order: VisitOrder, at: Ints) -> tuple[str, str] | None:
        names = [self._disturbances.blockages[k].name for k in self._disturbances.standing(slot)]
        new = [name for name in names if ("blockage", name, 0) not in self._known]
        if not new:
            return None
        vertex, edge = self._disturbances.blocked_for_good(slot)
        rows = self._ahead(order, at)
        onward = order.edge[rows - 1]
        hit = vertex[order.vertex[rows]] | (edge[onward] & (onward >= 0))
        return ("blockage", new[0]) if hit.any() else None

    def _failure(self, order: VisitOrder, at: Ints, failed: Bools) -> tuple[str, str] | None:
        for i in np.flatnonzero(failed & ~order.gone(at)).tolist():
            name = self._problem.robot_ids[i]
            if ("robot", name, 0) in self._known:
                continue
            rows = self._ahead(order, at)
            rows = rows[order.robot[rows] != i]
            if (order.vertex[rows] == order.vertex[order.row(at)[i]]).any():
                return "robot-failure", name
        return None


def circle(waits_for: Ints) -> list[int]:
    """Robots that wait for each other in a circle, from the lowest on; empty if none do."""
    for begin in np.flatnonzero(waits_for >= 0).tolist():
        seen, here = [begin], int(waits_for[begin])
        while here >= 0 and here != begin and len(seen) <= len(waits_for):
            seen.append(here)
            here = int(waits_for[here])
        if here == begin:
            return seen
    return []
