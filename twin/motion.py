"""Where the bodies are: poses along edges, slot by slot.

Within a slot every robot stands or moves straight at constant speed with constant heading; it turns
on the spot where two edges meet, between two slots.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

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
        robot = np.flatnonzero(~self._order.gone(at)).astype(np.int32)
        return self.along(robot, self._order.row(at)[robot], at[robot], advance[robot])

    def along(self, robot: Ints, row: Ints, at: Ints, advances: Bools) -> SlotMotion:
        """What n robots do in a slot in which they are at these rows of the visit order.

        Args:
            robot: (n,) whose.
            row: (n,) of the states they are at.
            at: (n,) these states.
            advances: (n,) bool, they make their transitions.
        """
        order = self._order
        moves = advances & (order.edge[row] >= 0)
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
            heading_rad=self._heading_of(row, moves, at),
            enters=np.where(is_last_piece, order.next_vertex[row], -1).astype(np.int32),
            leaves=advances & (at == order.arrival[robot]),
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
            np.where(strip[:, None], half, half_m(body)),
            np.where(strip, yaw, self.heading_rad[first]),
            body_height_m=height_m,
        )
        return np.asarray(hit[kind.ravel()], np.int32)


def half_m(body: Body) -> Floats:
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
