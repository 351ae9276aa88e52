"""Who goes first: the visit order of a plan, and group commit, the policy that keeps to it.

Pure functions; nothing here knows of time in seconds, of radio or of bodies.

**States.** A robot's progress is the index `at` of the state of its path that it is at or has left
last. The *transition* of state i leads to state i + 1: a wait, one slot's piece of a crossing, or,
from the last state under `leave`, driving off the floor. The plan makes it in slot i.

**Visits.** A *stay* is a run of states at one vertex; it is left by entering the next edge (page 5)
or by driving off. A *crossing* is the k states' transitions on an edge of k slots. The plan orders
the stays at each vertex and the crossings of each edge in time. A transition into a vertex (the
last piece of a crossing) has a *gate*: the robot j whose stay there comes just before must have
left it, or stand there now and advance in the same slot. So has a transition into an edge of k ≥ 2
slots, but strictly: the crossing just before must have ended (§1.3). An edge of one slot needs no
gate of its own. For k = 1 these are the rules of design page 5; for k ≥ 2 the vertex is asked for
in the last slot of the crossing, not at its entry, for a plan may enter a long edge while another
robot still stands at its end, and must be replayed as it is. A robot whose gate is shut by then
waits on the edge.

**Group commit.** C is the greatest set of ready robots all of whose gates are open given that all
of C advance (a greatest fixpoint): so robots follow each other, and rotate in closed circles, in
one slot.

**Planned waits** are transitions without a gate. Since no more than one transition is made in a
slot, none is made before the slot the plan has for it ("not before"). A robot that is late leaves
out those waits that change nothing but time (`catch_up`); one that changes the AP takes its slot.

**Replay.** Without delays every robot is at state t in slot t. Suppose so in slot t. A gate of a
transition made now names a stay the plan leaves in slot p ≤ t (strictly: a crossing that ends
before t); p < t has been left already, and p = t is being left in this slot by a robot that stands
there. So C is everybody. This needs nothing of the plan: where two stays overlap, which only a plan
with a collision has, there is no gate between them, and the collision is executed and reported, not
masked.

**Safety.** Let the plan be free of collisions (§1.2, §1.3), and robots be late as they may.
Vertices: stays begin in their order, each after the one before has ended or in the slot in which it
ends, so no two overlap. Edges of k ≥ 2 slots: by their strict gates. Edges of one slot: two robots
on one in the same slot would have to leave the same vertex together or to swap; to swap, each must
follow the other's stay, so that in the plan, too, each arrives when the other leaves: the plan
would swap them in one slot, which §1.3 forbids.

**Liveness.** Let m be the least state any unfinished robot is at, S those at it. Gates of S name
stays that the plan leaves in slots p ≤ m (crossings: p < m). A robot j that has not left it is at
some state ≤ p ≤ m; being unfinished, it is at ≥ m: so p = m, and j is in S and leaves now. Hence S
is self-supporting and within C, provided that all of S are ready. So in every slot in which those
the plan has earliest are ready, each of them advances: nobody waits in a circle, and when the last
delay is over the rest takes at most as many slots as there are transitions left.

**Strict order** is the action-dependency graph (W. Hönig et al., Persistent and robust execution of
MAPF schedules in warehouses, RA-L 2019, doi:10.1109/LRA.2019.2894217), without the clause "or stand
there now and advance in the same slot": for fleets without a common clock. Gates lead to
transitions planned no later than their own, so robots can wait in a circle only where all of it is
planned in one slot: a *rotation*. Plans with one are refused (`rotation`); all others are free of
deadlocks by the same argument as above.

**Routes.** A new plan begins in some slot, where robots stand, or amid a crossing (`Route.piece`).
A route that does not lead to the goal (`to_goal` is False) ends in a stay that is never left.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planner.plan import Path, Plan
from planner.problem import Problem
from twin.errors import TwinError
from twin.order_columns import crossings, enter_gates, pieces, walk

Bools = NDArray[np.bool_]
Ints = NDArray[np.int32]

_NEVER = np.iinfo(np.int32).max


@dataclass(frozen=True, eq=False)
class Route:
    """What a robot is to do from some slot on; arrays as in `planner.plan.Path`.

    Attributes:
        vertices, aps: (τ+1,) int32.
        edges: (τ,) int32, −1 while waiting.
        piece: slots of its first crossing that are done already, 0 if it begins at a vertex.
        to_goal: it ends at the robot's goal; else the robot stands at its end for good.
    """

    vertices: Ints
    aps: Ints
    edges: Ints
    piece: int = 0
    to_goal: bool = True

    @classmethod
    def of(cls, path: Path | None) -> Route | None:
        """A path of a plan as a route."""
        return None if path is None else cls(path.vertices, path.aps, path.edges)


@dataclass(frozen=True)
class VisitOrder:
    """A plan as columns over all states of all robots, with the gate of each transition.

    State i of robot r is row `first_row[r] + i`; a row's edge, piece and gate belong to the
    transition from that state. All arrays are read-only.

    Attributes:
        park: robots stay at their goals (§1.4).
        first_row: (N,) int32.
        arrival: (N,) int32, τ of each robot, −1 for robots without a path.
        robot, vertex, ap: (S,) int32.
        edge: (S,) int32, −1 where the transition is a wait or the last.
        piece: (S,) int32, which of the k slots of its crossing the transition is, from 0.
        next_vertex: (S,) int32, where the crossing leads; `vertex` where there is none.
        before: (S,) int32, the robot the gate names, −1 without a gate.
        left_after: (S,) int32, that robot has left once it is at a later state than this.
        strict: (S,) bool, the gate is shut in the slot in which it leaves.
        jump: (S,) int32, last state reached by leaving out waits that change nothing.
        begun: (S,) int32, crossings of its path begun before this state.
        to_goal: (N,) bool, the path leads to the goal (True for robots without a path).
    """

    park: bool
    first_row: Ints
    arrival: Ints
    robot: Ints
    vertex: Ints
    ap: Ints
    edge: Ints
    piece: Ints
    next_vertex: Ints
    before: Ints
    left_after: Ints
    strict: Bools
    jump: Ints
    begun: Ints
    to_goal: Bools

    def row(self, at: Ints) -> Ints:
        """(N,) row of each robot's state; of some row for robots that are not on the floor."""
        return np.asarray(np.minimum(self.first_row + at, len(self.robot) - 1), np.int32)

    def gone(self, at: Ints) -> Bools:
        """(N,) robots that are not on the floor: driven off, or without a path."""
        return np.asarray(at > self.arrival)

    def done(self, at: Ints) -> Bools:
        """(N,) robots with nothing left to do: gone, or parked."""
        done = at >= self.arrival if self.park else self.gone(at)
        return np.asarray(done & self.to_goal)

    def stuck(self, at: Ints) -> Bools:
        """(N,) robots at the end of a path that does not lead to their goal."""
        return np.asarray(~self.to_goal & (at >= self.arrival))


@dataclass(frozen=True)
class Commit:
    """What a policy decides for one slot.

    Attributes:
        advance: (N,) bool, robots that make their transition in this slot.
        waits_for: (N,) int32, the robot that must go first, −1 where it is not another robot
            that holds this one up.
        due: something is to come, such as the end of a delay, that can let robots advance later;
            if nothing is, and nobody advances, the run is stuck.
    """

    advance: Bools
    waits_for: Ints
    due: bool = False


class Policy(Protocol):
    """Decides in each slot which robots advance."""

    name: str

    def decide(self, order: VisitOrder, at: Ints, ready: Bools) -> Commit:
        """The robots of `ready` that advance; (N,) states `at` lie within the paths for them."""


class GroupCommit:
    """The execution policy of design page 5: the greatest fixpoint over the visit order."""

    name = "group-commit"

    def decide(self, order: VisitOrder, at: Ints, ready: Bools) -> Commit:
        """See `group_commit`."""
        return group_commit(order, at, ready)


def group_commit(order: VisitOrder, at: Ints, ready: Bools) -> Commit:
    """The greatest set of ready robots that can advance together; O(N).

    Args:
        order: of the plan.
        at: (N,) int32, state each robot is at.
        ready: (N,) bool, robots that have a transition and are able to make it.
    """
    if not ready.any():
        return Commit(np.zeros_like(ready), np.full(len(at), -1, np.int32))
    row = order.row(at)
    before = np.where(ready, order.before[row], -1)
    gate_at, left_after = at[before], order.left_after[row]  # of any robot where before is −1
    is_shut = (before >= 0) & (gate_at <= left_after)
    follows = is_shut & (gate_at == left_after) & ~order.strict[row]
    advance = ready & (~is_shut | follows)

    # Whoever follows a robot that is dropped is dropped. A stay has one immediate successor, so
    # the followers of a robot form a chain.
    follower = np.full(len(at), -1, np.int32)
    followers = np.flatnonzero(follows & advance)
    follower[before[followers]] = followers
    for i in followers[~advance[before[followers]]].tolist():
        dropped = i
        while dropped >= 0 and advance[dropped]:
            advance[dropped] = False
            dropped = int(follower[dropped])
    return Commit(advance, np.where(ready & ~advance, before, -1).astype(np.int32))


class StrictOrder:
    """A plain action-dependency graph: nobody moves to where another one still stands."""

    name = "strict"

    def decide(self, order: VisitOrder, at: Ints, ready: Bools) -> Commit:
        """Whose gates are open already."""
        if not ready.any():
            return Commit(np.zeros_like(ready), np.full(len(at), -1, np.int32))
        before = np.where(ready, order.before[order.row(at)], -1)
        shut = (before >= 0) & (at[before] <= order.left_after[order.row(at)])
        return Commit(ready & ~shut, np.where(ready & shut, before, -1).astype(np.int32))


def rotation(order: VisitOrder) -> tuple[int, tuple[int, ...]] | None:
    """The first slot in which robots move in a closed circle, and who; None if there is none.

    Each gate of a transition planned for slot t that opens by another transition of slot t is an
    arrow from robot to robot; a robot has one such arrow at most, so circles are found by walking.
    """
    state = np.arange(len(order.robot)) - order.first_row[order.robot]
    same = (order.before >= 0) & (order.left_after == state)
    rows = np.flatnonzero(same)
    for row in rows[np.argsort(state[rows], kind="stable")].tolist():
        slot, begin = int(state[row]), int(order.robot[row])
        circle, here = [begin], int(order.before[row])
        while here != begin and len(circle) <= len(order.arrival):
            at = int(order.first_row[here]) + slot
            if not same[at]:
                break
            circle.append(here)
            here = int(order.before[at])
        if here == begin:
            return slot, tuple(circle)
    return None


def refuse_rotation(order: VisitOrder, robot_ids: tuple[str, ...], first_slot: int = 0) -> None:
    """Refuse a plan that a strict order would never finish.

    Raises:
        TwinError: naming the robots and the slot.
    """
    found = rotation(order)
    if found is None:
        return
    slot, circle = found
    names = ", ".join(robot_ids[i] for i in circle)
    raise TwinError(
        f"the plan has a rotation in slot {slot + first_slot}: robots {names} move in a circle, "
        "each into the place the next one leaves; in strict order they would wait for each other "
        'for ever. Use run.policy = "group", or another plan (another plan.seed)'
    )


def catch_up(order: VisitOrder, at: Ints, slot: int) -> Ints:
    """(N,) states after late robots have left out the waits that change nothing but time."""
    late = (at < slot) & (at < order.arrival)
    if not late.any():
        return at
    return np.where(late, np.minimum(order.jump[order.row(at)], np.int32(slot)), at)


def visit_order(problem: Problem, plan: Plan) -> VisitOrder:
    """The visit order of a plan.

    Raises:
        TwinError: the paths are not walks in the problem's graph. (Whether they collide, overload
            APs or use what is not covered is for `planner.check` to say; such plans are executed.)
    """
    names = _robots(problem, plan)
    return order_of(problem, [Route.of(path) for path in plan.paths], names, from_start=True)


def order_of(
    problem: Problem,
    routes: list[Route | None],
    names: tuple[str, ...] | None = None,
    *,
    from_start: bool = False,
) -> VisitOrder:
    """The visit order of routes, one per robot of the problem, None for those not on the floor.

    Args:
        problem: whose graph the routes are in.
        routes: what each robot does.
        names: of the robots in messages.
        from_start: the routes begin at the robots' origins.

    Raises:
        TwinError: as `visit_order`.
    """
    names = names or problem.robot_ids
    paths = [
        walk(problem, name, i, route, from_start)
        for i, (name, route) in enumerate(zip(names, routes, strict=True))
    ]
    lengths = np.array([len(v) for v, _, _ in paths], np.int32)
    first_row = np.concatenate([[0], np.cumsum(lengths)])[:-1].astype(np.int32)
    vertex, ap, edge = (
        np.concatenate([np.empty(0, np.int32), *column]) for column in zip(*paths, strict=True)
    )
    robot = np.repeat(np.arange(len(paths), dtype=np.int32), lengths)
    state = np.arange(len(robot), dtype=np.int32) - np.repeat(first_row, lengths)
    offset = np.array([0 if r is None else r.piece for r in routes], np.int32)
    to_goal = np.array([r is None or r.to_goal for r in routes], np.bool_)
    piece = pieces(robot, state, vertex, edge, offset)
    next_vertex, last_piece = crossings(problem, names, robot, state, vertex, edge, piece)

    park = problem.at_goal == "park"
    is_final = state == np.repeat(lengths - 1, lengths)
    before, left_after = np.full(len(robot), -1, np.int32), np.zeros(len(robot), np.int32)

    on_vertex = piece == 0
    ends = is_final | (on_vertex & (edge >= 0))
    starts = on_vertex & np.concatenate([[True], is_final[:-1] | last_piece[:-1]])[: len(robot)]
    stays = is_final & (park | ~to_goal[robot])
    until = np.where(stays, _NEVER, state)[ends]
    enter_gates(vertex[starts], robot[starts], state[starts], until, state[starts] - 1, before,
           left_after, first_row)  # fmt: skip
    gated_by_vertex = before >= 0

    amid = (state == 0) & (piece > 0)  # a route that begins on an edge
    enters = (on_vertex & (edge >= 0) & ~last_piece) | amid
    leaves = last_piece & (piece > 0)
    enter_gates(edge[enters], robot[enters], state[enters], state[leaves],
           np.where(amid, -1, state)[enters], before, left_after, first_row)  # fmt: skip
    strict = (before >= 0) & ~gated_by_vertex

    # A wait that keeps the AP can be left out; the final state has none to leave out.
    idle = (edge < 0) & ~is_final
    idle[:-1] &= ap[1:] == ap[:-1]
    stop = np.flatnonzero(~idle)
    jump = stop[np.searchsorted(stop, np.arange(len(robot)))] - first_row[robot]

    entered = on_vertex & (edge >= 0)
    count = np.cumsum(entered) - entered
    begun = count - count[first_row[robot]] + (offset > 0)[robot]

    strict.flags.writeable = to_goal.flags.writeable = False
    return VisitOrder(
        park=park,
        first_row=_frozen(first_row),
        arrival=_frozen(lengths - 1),
        robot=_frozen(robot),
        vertex=_frozen(vertex),
        ap=_frozen(ap),
        edge=_frozen(edge),
        piece=_frozen(piece),
        next_vertex=_frozen(next_vertex),
        before=_frozen(before),
        left_after=_frozen(left_after),
        strict=strict,
        jump=_frozen(jump),
        begun=_frozen(begun),
        to_goal=to_goal,
    )


def _frozen(column: NDArray[np.integer]) -> Ints:
    """The column as read-only int32."""
    array = np.array(column, np.int32)
    array.flags.writeable = False
    return array


def _robots(problem: Problem, plan: Plan) -> tuple[str, ...]:
    """The robots' ids, the same in both; TwinError otherwise."""
    if plan.robot_ids != problem.robot_ids or len(plan.paths) != len(problem.robot_ids):
        raise TwinError(
            f"the plan is for robots {_some(plan.robot_ids)}, the problem has "
            f"{_some(problem.robot_ids)}; run a plan with the problem it was made for"
        )
    return problem.robot_ids


def _some(names: tuple[str, ...]) -> str:
    """A few of the names, and how many there are."""
    return f"{', '.join(names[:3])}{', …' if len(names) > 3 else ''} ({len(names)} in all)"
