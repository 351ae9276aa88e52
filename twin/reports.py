"""Records of what goes wrong and what is done about it: disturbances, new plans, deadlocks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from logs.records import CAUSES, Blockages, Disturbance, Incident, NewPath, Replan
from twin.watch import circle
from worlds.events import event_name
from worlds.floor import Boxes

if TYPE_CHECKING:
    from planner.problem import Problem
    from twin.association import Instants
    from twin.disturbances import Happening
    from twin.order import Commit
    from twin.replan import NewPlan
    from worlds.world import World

BLOCKAGE_COLUMNS = (
    "name",
    "x_m",
    "y_m",
    "z_m",
    "yaw_rad",
    "length_m",
    "width_m",
    "height_m",
)
NO_BOXES = Boxes((), np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
NOT_FORESEEN_S = -1.0

_SAID = {
    ("ap-outage", True): "AP {who} is out",
    ("ap-outage", False): "AP {who} works again",
    ("blockage", True): "{who} is in the way",
    ("blockage", False): "{who} is gone",
    ("robot-failure", True): "robot {who} has failed",
}


def happening(
    world: World, instants: Instants, slot: int, step: int, what: Happening
) -> Disturbance:
    """An event of the world that begins or is over."""
    event, name = world.event[what.event], event_name(world, what.event)
    who = event.ap or event.robot or name
    until = NOT_FORESEEN_S if event.to_s is None else event.to_s
    return Disturbance(
        t_s=instants.t_s(slot, step),
        slot=slot,
        kind=event.kind,
        name=name,
        robot=event.robot or "",
        ap=event.ap or "",
        begins=what.begins,
        slots=0,
        until_s=until,
        message=_SAID[event.kind, what.begins].format(who=who),
    )


def delay(instants: Instants, slot: int, robot: str, slots: int, name: str) -> Disturbance:
    """A robot is late from this slot on."""
    return Disturbance(
        t_s=instants.t_s(slot),
        slot=slot,
        kind="delay",
        name=name,
        robot=robot,
        ap="",
        begins=True,
        slots=slots,
        until_s=instants.t_s(slot + slots),
        message=f"robot {robot} stands still for {slots} slot{'s' if slots > 1 else ''}",
    )


def blockages(instants: Instants, slot: int, step: int, boxes: Boxes) -> Blockages:
    """Where all blockages are at an instant."""
    x, y, z = boxes.center_m.T.tolist() or ((), (), ())
    length, width, height = (2.0 * boxes.half_m).T.tolist() or ((), (), ())
    return Blockages(
        t_s=instants.t_s(slot, step),
        slot=slot,
        name=boxes.name,
        x_m=tuple(x),
        y_m=tuple(y),
        z_m=tuple(z),
        yaw_rad=tuple(boxes.yaw_rad.tolist()),
        length_m=tuple(length),
        width_m=tuple(width),
        height_m=tuple(height),
    )


def replan_record(
    instants: Instants,
    slot: int,
    number: int,
    cause: str,
    name: str,
    new: NewPlan | None,
    refused: str,
) -> Replan:
    """What was asked for, and what came of it."""
    if new is None:
        message = f"no new plan: {refused or 'none was found in which more can move'}"
        return Replan(instants.t_s(slot), slot, number, cause, name, False, (), (), 0, 0, message)
    left = len(new.without_path)
    message = f"new paths for {len(new.changed)} robots, cost {new.cost_before} → {new.cost_after}"
    message += f"; {left} stay without a path to their goals" if left else ""
    return Replan(
        t_s=instants.t_s(slot),
        slot=slot,
        number=number,
        cause=cause,
        name=name,
        adopted=True,
        robot=new.changed,
        without_path=new.without_path,
        cost_before=new.cost_before,
        cost_after=new.cost_after,
        message=message,
    )


def new_paths(
    problem: Problem, instants: Instants, slot: int, number: int, new: NewPlan
) -> Iterator[NewPath]:
    """The paths of a new plan, robots in their order."""
    for robot, route in zip(problem.robot_ids, new.routes, strict=True):
        if route is not None:
            yield NewPath(
                t_s=instants.t_s(slot),
                slot=slot,
                number=number,
                robot=robot,
                vertices=tuple(route.vertices.tolist()),
                aps=tuple(route.aps.tolist()),
                edges=tuple(route.edges.tolist()),
                piece=route.piece,
                to_goal=route.to_goal,
            )


def deadlock(
    problem: Problem, instants: Instants, slot: int, commit: Commit, cause: NDArray[np.int32]
) -> Incident:
    """Nobody can move, and nothing is due: who waits for whom, or why else."""
    names, ring = problem.robot_ids, circle(commit.waits_for)
    if ring:
        chain = " waits for ".join(names[i] for i in [*ring, ring[0]])
        text = f"nobody can move: {chain}"
        first, second = names[ring[0]], names[ring[1 % len(ring)]]
    else:
        why = [f"{names[i]}: {CAUSES[cause[i]]}" for i in np.flatnonzero(cause >= 0)[:5].tolist()]
        text = "; ".join(["nobody can move, and nothing is due that could change it", *why])
        first = second = ""
    return Incident(instants.t_s(slot), slot, "deadlock", first, second, "", float(len(ring)), text)
