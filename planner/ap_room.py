"""Whether the APs have room for all robots where they start, and where they stay (§1.4, §1.6).

In slot 0 every robot is served at its origin, and under `park` in slot T at its destination, so in
these slots robots are assigned to APs as in a transport problem. Where that has no solution, Hall's
theorem names robots and the only APs that reach them, with fewer places: found in moments, however
many robots there are.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from planner.phase_one import InfeasibilityProof
from planner.problem import Problem
from planner.resources import SCALE, Resources


def prove_no_room(resources: Resources) -> InfeasibilityProof | None:
    """The proof that some robots outnumber the places of their APs in slot 0, or in slot T.

    Returns:
        Penalties of one on those APs in that slot: each robot needs a place, and there are fewer;
        None if there is room.
    """
    problem = resources.problem
    ends = [(0, problem.start)]
    if problem.at_goal == "park":
        ends.append((problem.horizon, problem.goal))
    for slot, vertex in ends:
        found = _violator(problem.cover[vertex], problem.ap_capacity)
        if found is not None:
            robots, aps = found
            rows = resources.first_ap + slot * problem.n_aps + np.array(aps, np.int64)
            room = int(problem.ap_capacity[aps].sum())
            penalty = np.full(len(rows), SCALE, np.int64)
            return InfeasibilityProof(
                tuple(robots), rows, penalty, len(robots) * SCALE, room * SCALE
            )
    return None


def no_room_in_words(problem: Problem, resources: Resources, proof: InfeasibilityProof) -> str:
    """Which slot, which APs, how many places."""
    slot, ap = np.divmod(proof.resources - resources.first_ap, problem.n_aps)
    names = ", ".join(problem.ap_ids[a] for a in ap.tolist())
    where = "where they start" if slot[0] == 0 else "where they stay"
    room = proof.room // SCALE
    return (
        f"{where}, in slot {slot[0]}, only {names} {'reach' if len(ap) > 1 else 'reaches'} them, "
        f"with {room} place{'s' * (room != 1)} for these {len(proof.robots)} robots"
    )


def _violator(
    cover: NDArray[np.bool_], capacity: NDArray[np.int32]
) -> tuple[list[int], list[int]] | None:
    """Robots and all APs that cover any of them, with fewer places; None if all find one.

    Args:
        cover: (N, A) which APs reach each robot.
        capacity: (A,) their places.
    """
    of = [np.flatnonzero(row).tolist() for row in cover]
    served: list[list[int]] = [[] for _ in capacity]  # robots by AP
    for robot in range(len(of)):
        # Breadth first over APs: `by[a]` is the robot that would take a place of a.
        by = dict.fromkeys(of[robot], robot)
        queue = deque(of[robot])
        while queue:
            a = queue.popleft()
            if len(served[a]) < capacity[a]:
                break
            for other in served[a]:
                for b in of[other]:
                    if b not in by:
                        by[b] = other
                        queue.append(b)
        else:
            aps = sorted(by)
            return sorted({robot, *(i for a in aps for i in served[a])}), aps
        while True:
            taker = by[a]
            served[a].append(taker)
            if taker == robot:
                break
            a = next(b for b in by if taker in served[b] and b != a)
            served[a].remove(taker)
    return None
