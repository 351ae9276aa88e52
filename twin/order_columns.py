"""From routes to the columns of a visit order: walks, crossings, gates (see `twin.order`).

S is the number of states of all robots together, N that of robots.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twin.errors import TwinError

if TYPE_CHECKING:
    from planner.problem import Problem
    from twin.order import Route

Bools = NDArray[np.bool_]
Ints = NDArray[np.int32]


def walk(
    problem: Problem, name: str, i: int, path: Route | None, from_start: bool
) -> tuple[Ints, Ints, Ints]:
    """Vertices, APs and edges of robot i's path, each (τ+1,); TwinError for wrong indices."""
    if path is None:
        return np.empty(0, np.int32), np.empty(0, np.int32), np.empty(0, np.int32)
    vertex, ap = np.asarray(path.vertices, np.int32), np.asarray(path.aps, np.int32)
    edge = np.append(np.asarray(path.edges, np.int32), np.int32(-1))
    if not len(vertex) or len(ap) != len(vertex) or len(edge) != len(vertex):
        raise TwinError(
            f"robot {name}: {len(vertex)} vertices, {len(ap)} APs and {len(edge) - 1} edges; "
            "a path of τ slots has τ + 1, τ + 1 and τ"
        )
    limits = (
        ("vertex", vertex, 0, len(problem.xy_m)),
        ("AP", ap, 0, len(problem.ap_ids)),
        ("edge", edge, -1, len(problem.edge_uv)),
    )
    for what, column, low, high in limits:
        wrong = np.flatnonzero((column < low) | (column >= high))
        if len(wrong):
            raise TwinError(
                f"robot {name}, slot {wrong[0]}: {what} {column[wrong[0]]} does not exist; the "
                f"problem has {high} (0 … {high - 1})"
            )
    ends = [("start", 0, problem.start[i])] if from_start else []
    ends += [("goal", -1, problem.goal[i])] if path.to_goal else []
    for where, slot, wanted in ends:
        if vertex[slot] != wanted:
            raise TwinError(
                f"robot {name}: its path has vertex {vertex[slot]} at its {where}, the problem "
                f"{wanted}; run a plan with the problem it was made for"
            )
    return vertex, ap, edge


def pieces(robot: Ints, state: Ints, vertex: Ints, edge: Ints, offset: Ints) -> Ints:
    """(S,) which slot of its crossing each transition is, from 0; 0 for waits.

    Consecutive transitions on one edge with one vertex left are one crossing: a second one of
    the same edge starts from its other end. A route may begin with piece `offset` (N,) > 0.
    """
    n = len(robot)
    goes_on = np.zeros(n, np.bool_)
    goes_on[1:] = (
        (edge[1:] >= 0)
        & (edge[1:] == edge[:-1])
        & (vertex[1:] == vertex[:-1])
        & (robot[1:] == robot[:-1])
    )
    index = np.arange(n)
    begun = np.maximum.accumulate(np.where(goes_on, 0, index)) if n else index
    own = begun - state[begun] == index - state  # the crossing began within this robot's rows
    first = np.where((state[begun] == 0) & own & (edge >= 0), offset[robot], 0) if n else 0
    return (index - begun + first).astype(np.int32)


def crossings(
    problem: Problem,
    names: tuple[str, ...],
    robot: Ints,
    state: Ints,
    vertex: Ints,
    edge: Ints,
    piece: Ints,
) -> tuple[Ints, Bools]:
    """Where each transition leads, and which end a crossing; TwinError if it is not a walk."""
    n = len(robot)
    crosses = edge >= 0
    # Edge −1 is the last of these, which no vertex touches.
    uv = np.vstack([problem.edge_uv, [[-1, -1]]])[edge]
    slots = np.append(problem.edge_slots, 0)[edge]
    oneway = np.append(problem.edge_oneway, False)[edge]
    from_u = vertex == uv[:, 0]
    next_vertex = np.where(crosses, np.where(from_u, uv[:, 1], uv[:, 0]), vertex)
    last_piece = crosses & (piece == slots - 1)

    touches = from_u | (vertex == uv[:, 1])
    has_next = np.concatenate([robot[1:] == robot[:-1], [False]])[:n]
    after = np.where(has_next, np.append(vertex[1:], vertex[:1])[:n], -1)
    wrong = has_next & (
        (crosses & (~touches | (oneway & ~from_u) | (piece >= slots)))
        | (np.where(last_piece, next_vertex, vertex) != after)
    )
    # A crossing that is broken off: the next transition must be its next piece.
    follows = np.concatenate([piece[1:] == piece[:-1] + 1, [False]])[:n]
    wrong |= crosses & ~last_piece & ~follows
    for i in np.flatnonzero(wrong)[:1]:
        move = f"edge {edge[i]}" if crosses[i] else "a wait"
        raise TwinError(
            f"robot {names[robot[i]]}, slot {state[i]}: {move} does not lead from vertex "
            f"{vertex[i]} to vertex {after[i]} in this slot; run a plan with the problem it was "
            "made for"
        )
    return next_vertex.astype(np.int32), last_piece


def enter_gates(
    place: Ints,
    robot: Ints,
    begin: Ints,
    until: Ints,
    transition: Ints,
    before: Ints,
    left_after: Ints,
    first_row: Ints,
) -> None:
    """Enter the gates of visits into `before` and `left_after`, which are changed.

    Visit q of `robot[q]` to `place[q]` begins at state `begin[q]`, by transition `transition[q]`
    (−1: it stood there from the outset), and is left by the transition of state `until[q]`.
    """
    order = np.lexsort((robot, begin, place))
    prior, later = order[:-1], order[1:]
    ordered = (
        (place[prior] == place[later])
        & (robot[prior] != robot[later])
        & (transition[later] >= 0)
        # The plan leaves the place in time: not so only where two robots are there at once.
        & (until[prior] < begin[later])
    )
    prior, later = prior[ordered], later[ordered]
    row = first_row[robot[later]] + transition[later]
    before[row] = robot[prior]
    left_after[row] = until[prior]
