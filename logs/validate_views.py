"""Step 3 of validation: the states of a slot as columns, which all other checks look at."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from logs.records import ARRIVED, MOVING, WAITING, RobotState
from logs.validate_context import STEP, Context, Ints, SlotView
from logs.validate_serving import PlannedServing


class ViewBuilder:
    """Makes a `SlotView` of what is told of a slot, and of the view before."""

    def __init__(self, context: Context, serving: PlannedServing) -> None:
        self._context, self._serving = context, serving

    def of_states(
        self, slot: int, states: Iterable[tuple[int, RobotState]], before: SlotView | None
    ) -> SlotView:
        """The usable ones of the states (robot, state) of the robots on the floor, ascending."""
        context, problem = self._context, self._context.inputs.problem
        vertices, edges = problem.n_vertices, problem.n_edges
        rows: list[tuple[int, ...]] = []
        leaves = context.start.at_goal == "leave"
        for i, state in states:
            if not (
                0 <= state.vertex < vertices
                and 0 <= state.next_vertex < vertices
                and -1 <= state.edge < edges
            ):
                context.checks.find(
                    STEP,
                    "§1.1",
                    f"vertex {state.vertex}, edge {state.edge}, next vertex {state.next_vertex}",
                    f"indices below {vertices} vertices and {edges} edges",
                    slot=slot,
                    robot=state.robot,
                )
                continue
            ap = context.ap.get(state.ap, -1)
            moves = state.activity == MOVING
            arrived = state.activity == ARRIVED
            advances = moves or state.activity == WAITING or (arrived and leaves)
            rows.append((i, state.vertex, state.next_vertex, state.edge, moves, ap,
                         state.visit, advances, arrived))  # fmt: skip
        columns: Ints = np.array(rows, np.int64).reshape(-1, 9).T
        robot, vertex, next_vertex, edge = columns[:4]
        moving, ap = columns[4].astype(np.bool_), columns[5]
        slots = np.where(edge >= 0, np.append(problem.edge_slots, 1)[edge], 1)
        piece = self._pieces(before, robot, vertex, edge, slots)
        view = SlotView(
            slot=slot,
            robot=robot,
            vertex=vertex,
            next_vertex=next_vertex,
            edge=edge,
            piece=piece,
            slots=slots,
            moves=moving,
            visit=columns[6],
            advances=columns[7].astype(np.bool_),
            arrived=columns[8].astype(np.bool_),
            ap=ap,
            load_ap=self._load_ap(robot, columns[6], ap),
            start_m=np.empty((0, 2)),
            end_m=np.empty((0, 2)),
        )
        return view.placed(problem.xy_m)

    def at_the_end(
        self,
        slot: int,
        before: SlotView | None,
        there: Iterable[int],
        where: dict[int, tuple[int, int, int]],
        visit_of: Callable[[int], int],
    ) -> SlotView:
        """The run's last instant: without states, who parks stands where the last slot ended."""
        staying = sorted(there)
        stays = (
            np.flatnonzero(np.isin(before.robot, staying)) if before is not None else np.arange(0)
        )
        none = np.empty(0, np.int64)
        robot: Ints = before.robot[stays] if before is not None else none
        table = np.array([where[i] for i in robot.tolist()], np.int64).reshape(-1, 3)
        vertex, edge, piece = table.T
        problem = self._context.inputs.problem
        ends = np.append(problem.edge_uv, [[0, 0]], axis=0)[edge].sum(axis=1)
        ap = before.load_ap[stays] if before is not None else none
        visit = [visit_of(i) for i in robot.tolist()]
        return SlotView(
            slot=slot,
            robot=robot,
            vertex=vertex,
            next_vertex=np.where(edge >= 0, ends - vertex, vertex),
            edge=edge,
            piece=piece,
            slots=np.where(edge >= 0, np.append(problem.edge_slots, 1)[edge], 1),
            moves=np.zeros(len(stays), np.bool_),
            visit=np.array(visit, np.int64),
            advances=np.zeros(len(stays), np.bool_),
            arrived=np.zeros(len(stays), np.bool_),
            ap=ap,
            load_ap=ap,
            start_m=np.empty((0, 2)),
            end_m=np.empty((0, 2)),
        ).placed(self._context.inputs.problem.xy_m)

    def _pieces(
        self, before: SlotView | None, robot: Ints, vertex: Ints, edge: Ints, slots: Ints
    ) -> Ints:
        """(n,) which slot of its crossing each robot is in."""
        piece = np.zeros(len(robot), np.int64)
        if before is None:
            return piece
        here, there = in_both(robot, before.robot)
        gone_on = before.piece[there] + before.moves[there]
        goes_on = (
            (edge[here] >= 0)
            & (edge[here] == before.edge[there])
            & (vertex[here] == before.vertex[there])
            & (gone_on < slots[here])
            & (gone_on > 0)
        )
        piece[here[goes_on]] = gone_on[goes_on]
        return piece

    def _load_ap(self, robot: Ints, visit: Ints, ap: Ints) -> Ints:
        """(n,) AP each robot counts for: as its path has it (§1.6), if the path's AP serves it."""
        load_ap = ap.copy()
        for k, (i, row) in enumerate(zip(robot.tolist(), visit.tolist(), strict=True)):
            walk, serving = self._context.itinerary.walks[i], self._serving.of(i)
            if walk is not None and serving is not None:
                state = min(max(row, 0), walk.last)
                load_ap[k] = walk.ap[state] if serving.first[state] == ap[k] else ap[k]
        return load_ap


def in_both(a: Ints, b: Ints) -> tuple[Ints, Ints]:
    """Indices into two ascending lists of the elements they share."""
    _, in_a, in_b = np.intersect1d(a, b, assume_unique=True, return_indices=True)
    return in_a.astype(np.int64), in_b.astype(np.int64)
