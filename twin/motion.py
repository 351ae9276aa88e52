"""Where the bodies are: poses along edges, and the true clearance between bodies in motion.

Within a slot every robot stands or moves straight at constant speed with constant heading; it turns
on the spot where two edges meet, between two slots. So the clearance of two bodies during a slot
is a minimum over one linear motion, found exactly here, not at samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from planner.problem import Problem
from twin.order import VisitOrder
from worlds.boxes import footprint_hits, swept
from worlds.floor import Boxes
from worlds.world import Body

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

ROUNDING_M = 1e-9
"""Clearances nearer to 0 than this are 0: bodies that touch do not overlap."""

_PAIRS_AT_ONCE = 20_000


@dataclass(frozen=True)
class SlotMotion:
    """What the n bodies on the floor do in one slot.

    Attributes:
        robot: (n,) int32, ascending.
        row: (n,) int32, their rows in the visit order.
        vertex: (n,) int32, stands at or left last.
        edge: (n,) int32, is on, −1 if standing at the vertex.
        begin, end: (n,) float64, where on the edge it is at the slot's beginning and end, as a
            fraction from the edge's u; 0 at vertices.
        u_m, v_m: (n, 2) float64, the edge's ends, or twice the vertex [m].
        heading_rad: (n,) float64.
        enters: (n,) int32, the vertex reached at the slot's end by moving, −1 if none.
        leaves: (n,) bool, drives off the floor in this slot (§1.4).
    """

    robot: Ints
    row: Ints
    vertex: Ints
    edge: Ints
    begin: Floats
    end: Floats
    u_m: Floats
    v_m: Floats
    heading_rad: Floats
    enters: Ints
    leaves: Bools

    def fraction(self, instants: Floats) -> Floats:
        """(n, s) fractions from u at each of (s,) fractions of the slot."""
        return self.begin[:, None] + instants * (self.end - self.begin)[:, None]

    def xy_m(self, instants: Floats) -> Floats:
        """(n, s, 2) positions at each of (s,) fractions of the slot [m]."""
        along = self.fraction(instants)[:, :, None]
        # The very sum of `worlds.link.edge_xy_m`, so that map and twin stand at equal places.
        return (1.0 - along) * self.u_m[:, None, :] + along * self.v_m[:, None, :]

    @cached_property
    def start_m(self) -> Floats:
        """(n, 2) positions at the slot's beginning [m]."""
        return self.xy_m(np.zeros(1))[:, 0]

    @cached_property
    def step_m(self) -> Floats:
        """(n, 2) displacement within the slot [m]."""
        return (self.end - self.begin)[:, None] * (self.v_m - self.u_m)


class Roads:
    """The ways a plan uses: headings, and which of them lead through an obstacle."""

    def __init__(
        self,
        problem: Problem,
        order: VisitOrder,
        boxes: Boxes,
        body: Body,
        height_m: float,
        heading_rad: Floats | None = None,
    ) -> None:
        """Lay the ways of a plan out.

        Args:
            problem, order: whose.
            boxes: the obstacles.
            body: of every robot.
            height_m: of its highest point [m].
            heading_rad: (N,) headings the robots have before it; in a run's first plan they head
                along their first move from the outset.
        """
        self._order, self._before = order, heading_rad
        self._xy = problem.xy_m
        # Edge −1, that of robots at vertices, is the last of these.
        uv = np.vstack([problem.edge_uv, [[-1, -1]]])
        self._slots = np.append(problem.edge_slots, 1)
        self._u, self._v = self._xy[uv[:, 0]], self._xy[uv[:, 1]]
        self._from_u = (order.edge >= 0) & (order.vertex == uv[order.edge, 0])
        self.heading_rad = _headings(order, self._xy, heading_rad)
        self._hit = self._hits(boxes, body, height_m)

    def motion(self, at: Ints, advance: Bools) -> SlotMotion:
        """The slot's motion: robots of `advance` make their transitions, the others stand.

        Args:
            at: (N,) states of all robots.
            advance: (N,) bool.
        """
        order = self._order
        robot = np.flatnonzero(~order.gone(at)).astype(np.int32)
        row = order.row(at)[robot]
        moves = advance[robot] & (order.edge[row] >= 0)
        piece, vertex = order.piece[row], order.vertex[row]
        on_edge = moves | (piece > 0)
        edge = np.where(on_edge, order.edge[row], -1).astype(np.int32)
        begin, end = piece / self._slots[edge], (piece + moves) / self._slots[edge]
        back = on_edge & ~self._from_u[row]
        is_last_piece = moves & (piece + 1 == self._slots[edge])
        u, v = (np.where(on_edge[:, None], w[edge], self._xy[vertex]) for w in (self._u, self._v))
        return SlotMotion(
            robot=robot,
            row=row,
            vertex=vertex,
            edge=edge,
            begin=np.where(back, 1.0 - begin, begin),
            end=np.where(back, 1.0 - end, end),
            u_m=u,
            v_m=v,
            heading_rad=self._heading_of(row, moves, at[robot]),
            enters=np.where(is_last_piece, order.next_vertex[row], -1).astype(np.int32),
            leaves=advance[robot] & (at[robot] == order.arrival[robot]),
        )

    def obstacle(self, motion: SlotMotion, at: Ints) -> Ints:
        """(n,) int32, the box each body of the motion touches within the slot, −1 if none."""
        order = self._order
        held = (order.edge[motion.row] >= 0) & (motion.begin == motion.end) & (at[motion.robot] > 0)
        # Who is held still stands where the transition before has put it.
        return np.asarray(self._hit[motion.row - held], np.int32)

    def _heading_of(self, row: Ints, moves: Bools, at: Ints) -> Floats:
        """A robot held before an edge has not turned yet."""
        order = self._order
        held = (order.edge[row] >= 0) & ~moves & (order.piece[row] == 0)
        heading = self.heading_rad[row - (held & (at > 0))]
        if self._before is not None:
            heading = np.where(held & (at == 0), self._before[order.robot[row]], heading)
        return np.asarray(heading, np.float64)

    def _hits(self, boxes: Boxes, body: Body, height_m: float) -> Ints:
        """(S,) the box touched by the body in each row's transition, −1 if none.

        A crossing sweeps a strip, a wait covers the body's own rectangle. Rows that sweep the same
        are tested once.
        """
        order = self._order
        if not len(order.robot) or not len(boxes):
            return np.full(len(order.robot), -1, np.int32)
        crosses = order.edge >= 0
        slots = self._slots[order.edge]
        # From which end a strip is driven does not matter.
        piece = np.where(self._from_u | ~crosses, order.piece, slots - 1 - order.piece)
        kinds = np.column_stack(
            [
                crosses,
                np.where(crosses, order.edge, order.vertex),
                np.where(crosses, piece, self.heading_rad),
            ]
        )
        _, first, kind = np.unique(kinds, axis=0, return_index=True, return_inverse=True)
        vertex, edge, strip = order.vertex[first], order.edge[first], crosses[first]
        u, v = self._u[edge], self._v[edge]
        low, high = (((piece + end) / slots)[first, None] for end in (0, 1))
        center, half, yaw = swept(
            (1.0 - low) * u + low * v, (1.0 - high) * u + high * v, body.length_m, body.width_m
        )
        hit = footprint_hits(
            boxes,
            np.where(strip[:, None], center, self._xy[vertex]),
            np.where(strip[:, None], half, _half_m(body)),
            np.where(strip, yaw, self.heading_rad[first]),
            body_height_m=height_m,
        )
        return np.asarray(hit[kind.ravel()], np.int32)


def _half_m(body: Body) -> Floats:
    """(2,) half extents of the body along and across its heading [m]."""
    return np.array([body.length_m / 2, body.width_m / 2])


def _headings(order: VisitOrder, xy_m: Floats, before: Floats | None) -> Floats:
    """(S,) heading of each row [rad].

    A robot heads along its edge and keeps that while it waits. Before its first move it heads as
    it did `before` (N,), or, where that is None, as in that move; one that never moves heads along
    x (0) then.
    """
    rows = len(order.robot)
    if not rows:
        return np.zeros(0)
    index = np.arange(rows)
    crosses = order.edge >= 0
    last = np.maximum.accumulate(np.where(crosses, index, -1))
    own = (last >= 0) & (order.robot[last] == order.robot)
    moves = np.flatnonzero(crosses)
    upcoming = np.append(moves, -1)[np.searchsorted(moves, index)]
    own_next = (upcoming >= 0) & (order.robot[upcoming] == order.robot)
    source = np.where(own, last, np.where(own_next, upcoming, -1))
    way = xy_m[order.next_vertex] - xy_m[order.vertex]
    heading = np.arctan2(way[:, 1], way[:, 0])
    found = np.where(source >= 0, heading[source], 0.0)
    if before is not None:
        found = np.where(own, found, before[order.robot])
    return np.asarray(found, np.float64)


# --- clearance --------------------------------------------------------------------------------


def clearance_m(
    apart_m: Floats,
    step_m: Floats,
    half_a_m: Floats,
    yaw_a: Floats,
    half_b_m: Floats,
    yaw_b: Floats,
) -> Floats:
    """The least clearance of two rectangles while one moves past the other.

    Where they stay apart, their least distance; where they overlap at some time, minus the greatest
    depth of it, i.e. of the shortest displacement that would part them (so always by the separating
    axis theorem: S. Gottschalk et al., OBBTree, SIGGRAPH 1996, doi:10.1145/237170.237244).

    Args:
        apart_m: (P, 2), centre of a minus centre of b at the beginning [m].
        step_m: (P, 2), displacement of a relative to b [m].
        half_a_m: (P, 2) or (2,), half extents of a along and across its heading [m].
        yaw_a: (P,), heading of a [rad].
        half_b_m: the same of b.
        yaw_b: the same of b.

    Returns:
        (P,) float64 [m].
    """
    half_a, half_b = (np.broadcast_to(h, apart_m.shape) for h in (half_a_m, half_b_m))
    turn = yaw_a - yaw_b
    apart_b, step_b = _rotated(apart_m, -yaw_b), _rotated(step_m, -yaw_b)
    apart_a, step_a = _rotated(-apart_m, -yaw_a), _rotated(-step_m, -yaw_a)
    # Disjoint convex polygons are nearest at a corner of one of them: its path past the other.
    distance = np.minimum(
        _corner_distance(apart_b, step_b, half_a, turn, half_b),
        _corner_distance(apart_a, step_a, half_b, -turn, half_a),
    )
    overlap = _least_separation(apart_b, step_b, half_a, turn, half_b)
    clearance = np.where(overlap < 0, overlap, distance)
    return np.where(np.abs(clearance) < ROUNDING_M, 0.0, clearance)


def _rotated(vector: Floats, angle: Floats) -> Floats:
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = vector[:, 0], vector[:, 1]
    return np.column_stack([cos * x - sin * y, sin * x + cos * y])


def _corner_distance(
    center: Floats, step: Floats, half: Floats, turn: Floats, box: Floats
) -> Floats:
    """(P,) least distance from the four corners of a moving rectangle to a box [m].

    All in the frame of the box, which has half extents `box` (P, 2). The distance is convex in
    time; its minimum lies at an end of the motion, where a corner's path meets the line through a
    side, or where it is nearest to a corner of the box.
    """
    signs = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    along, across = half[:, :1] * signs[:, 0], half[:, 1:] * signs[:, 1]
    corner = center[:, None, :] + np.stack(
        [cos * along - sin * across, sin * along + cos * across], axis=2
    )  # (P, 4, 2)
    way = step[:, None, :]
    sides = box[:, None, None, :] * np.array([1.0, -1.0])[:, None]  # (P, 1, 2, 2): ±half by axis
    with np.errstate(divide="ignore", invalid="ignore"):
        meets = (sides - corner[:, :, None, :]) / way[:, :, None, :]  # (P, 4, 2, 2)
        to_corners = box[:, None, None, :] * signs - corner[:, :, None, :]  # (P, 4, 4, 2)
        nearest = (to_corners * way[:, :, None, :]).sum(axis=3) / (way**2).sum(axis=2)[:, :, None]
    times = np.concatenate([meets.reshape(*meets.shape[:2], 4), nearest], axis=2)
    ends = np.broadcast_to([0.0, 1.0], (*times.shape[:2], 2))
    times = np.concatenate([np.nan_to_num(times).clip(0.0, 1.0), ends], axis=2)
    x = np.abs(corner[:, :, :1] + times * way[:, :, :1]) - box[:, None, :1]
    y = np.abs(corner[:, :, 1:] + times * way[:, :, 1:]) - box[:, None, 1:]
    return np.asarray(np.hypot(x.clip(0.0), y.clip(0.0)).min(axis=(1, 2)))


_LINES = np.array(list(combinations(range(8), 2)))


def _least_separation(
    center: Floats, step: Floats, half: Floats, turn: Floats, box: Floats
) -> Floats:
    """(P,) least over time of the greatest gap along the four axes of two rectangles [m].

    Negative values are depths of overlap. The gap along an axis is the greater of two linear
    functions of time; the greatest of all eight is convex and has its minimum at an end of the
    motion or where two of them are equal.
    """
    cos, sin = np.cos(turn), np.sin(turn)
    one, zero = np.ones_like(turn), np.zeros_like(turn)
    axes = np.stack([one, zero, zero, one, cos, sin, -sin, cos], axis=1).reshape(-1, 4, 2)
    c, s = np.abs(cos), np.abs(sin)
    reach = np.column_stack(
        [
            box[:, 0] + c * half[:, 0] + s * half[:, 1],
            box[:, 1] + s * half[:, 0] + c * half[:, 1],
            half[:, 0] + c * box[:, 0] + s * box[:, 1],
            half[:, 1] + s * box[:, 0] + c * box[:, 1],
        ]
    )
    begin = np.einsum("pad,pd->pa", axes, center)
    rate = np.einsum("pad,pd->pa", axes, step)
    begin = np.concatenate([begin - reach, -begin - reach], axis=1)  # (P, 8)
    rate = np.concatenate([rate, -rate], axis=1)
    i, j = _LINES.T
    with np.errstate(divide="ignore", invalid="ignore"):
        times = (begin[:, j] - begin[:, i]) / (rate[:, i] - rate[:, j])
    times = np.column_stack([np.nan_to_num(times).clip(0.0, 1.0), zero, one])
    gaps = begin[:, :, None] + rate[:, :, None] * times[:, None, :]
    return np.asarray(gaps.max(axis=1).min(axis=1))


@dataclass(frozen=True)
class Nearness:
    """The least clearance of any two bodies in a slot, and all pairs that overlap.

    Attributes:
        clearance_m: the least one, None where no two bodies are to be measured.
        pair: indices (into the motion) of the two, the lowest of several equal ones.
        overlaps: (index, index, clearance) of each pair whose bodies overlap at some time.
    """

    clearance_m: float | None
    pair: tuple[int, int]
    overlaps: tuple[tuple[int, int, float], ...]


def nearness(motion: SlotMotion, body: Body) -> Nearness:
    """The least clearance within a slot between any two bodies.

    Not measured is a robot that drives off the floor in this slot against the one that moves into
    its vertex: §1.4 lets the vertex be entered in the slot after the arrival, so the one is on its
    way out while the other comes.

    The distance of the centres bounds the clearance from both sides (circles around and within
    the bodies); only pairs that can be the nearest, or overlap, are measured exactly.
    """
    start, step = motion.start_m, motion.step_m
    middle = start + step / 2
    square = (middle[:, None, 0] - middle[:, 0]) ** 2 + (middle[:, None, 1] - middle[:, 1]) ** 2
    np.fill_diagonal(square, np.inf)
    for leaver in np.flatnonzero(motion.leaves):
        follower = motion.enters == motion.vertex[leaver]
        square[leaver, follower] = square[follower, leaver] = np.inf
    half_m = _half_m(body)
    around, within = float(np.hypot(*half_m)), float(half_m.min())
    closest = float(np.sqrt(square.min(initial=np.inf)))
    if closest == np.inf:
        return Nearness(None, (-1, -1), ())
    # Two centres come no nearer than they are at half time less the way of both from there.
    reach = float(np.hypot(step[:, 0], step[:, 1]).max())
    limit = max(closest - 2 * within, 0.0) + 2 * around + ROUNDING_M
    a, b = np.nonzero(square <= (limit + reach) ** 2)
    a, b = a[a < b], b[a < b]
    apart, way = start[a] - start[b], step[a] - step[b]
    speed = (way**2).sum(axis=1)
    nearest = -(apart * way).sum(axis=1) / np.where(speed > 0, speed, 1.0)
    center = np.hypot(*(apart + nearest.clip(0.0, 1.0)[:, None] * way).T)
    limit = max(float(center.min()) - 2 * within, 0.0) + 2 * around + ROUNDING_M
    near = np.flatnonzero(center <= limit)
    a, b = a[near], b[near]
    found = np.empty(len(a))
    heading = motion.heading_rad
    for first in range(0, len(a), _PAIRS_AT_ONCE):
        i, j = (k[first : first + _PAIRS_AT_ONCE] for k in (a, b))
        found[first : first + len(i)] = clearance_m(
            start[i] - start[j], step[i] - step[j], half_m, heading[i], half_m, heading[j]
        )
    k = int(found.argmin())
    overlaps = tuple((int(a[q]), int(b[q]), float(found[q])) for q in np.flatnonzero(found < 0))
    return Nearness(float(found[k]), (int(a[k]), int(b[k])), overlaps)
