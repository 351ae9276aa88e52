"""Two robots on an empty floor: can they get past each other, and by when?

All places the two can be in at once are followed slot by slot as one (V, V) table. The radio is
left out and so is every other robot, so "they cannot" is a proof, by exhaustion, about the problem
itself; it also holds where the relaxed master has a solution because two half robots pass each
other in a lane for one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.problem import Problem

NEVER = -1
MAX_CELLS = 4_000_000
"""Tables larger than this (V² of more than 2000 vertices) are not followed."""

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


class Passing:
    """The moves two robots can make; answers for one pair after another.

    Attributes:
        applies: edges take one slot each and the table fits; else nothing can be said of any pair.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        V = problem.n_vertices
        self.applies = V * V <= MAX_CELLS and bool((problem.edge_slots == 1).all())
        if not self.applies:
            return
        # An edge that no AP lets anyone cross is none (§1.7).
        usable = problem.edge_cover.any(axis=1) | problem.edge_handover.any(axis=(1, 2))
        before: list[list[int]] = [[v] for v in range(V)]  # waiting is always possible
        self._lanes: dict[tuple[int, int], int] = {}
        for e in np.flatnonzero(usable).tolist():
            u, v = problem.edge_uv[e].tolist()
            oneway = bool(problem.edge_oneway[e])
            for a, b in ((u, v),) if oneway else ((u, v), (v, u)):
                before[b].append(a)
                self._lanes[a, b] = self._lanes.get((a, b), 0) + 1
        self._before = _table(before)
        # Swaps need a second edge: with one in each direction that is the same edge, they are
        # impossible (§1.3). (Two one-way edges, one each way, are two edges.)
        both = [
            (u, v)
            for u, v in {tuple(sorted(pair)) for pair in self._lanes}
            if self._only_one_edge(u, v)
        ]
        pairs = sorted(both + [(v, u) for u, v in both])
        self._swap = np.array(pairs, np.int64).reshape(-1, 2)
        self._alone: dict[int, Ints] = {}

    def _only_one_edge(self, u: int, v: int) -> bool:
        uv = self.problem.edge_uv
        joins = ((uv[:, 0] == u) & (uv[:, 1] == v)) | ((uv[:, 0] == v) & (uv[:, 1] == u))
        return int(joins.sum()) == 1 and (u, v) in self._lanes and (v, u) in self._lanes

    def least_horizon(self, i: int, j: int) -> int:
        """The least T at which robots i and j can both be served if nothing else mattered.

        Returns:
            A lower bound on T that is exact for the two of them where every place has every AP;
            `NEVER` if no T is enough; 0 if nothing can be said.
        """
        problem = self.problem
        if not self.applies:
            return 0
        park = problem.at_goal == "park"
        start, goal = problem.start.tolist(), problem.goal.tolist()
        stays = [start[k] == goal[k] for k in (i, j)]
        if any(stays) and not park:
            return 0  # it leaves in slot 1 and meets nobody (§1.5)
        to_i, to_j = self._slots_to(goal[i]), self._slots_to(goal[j])
        if to_i[start[i]] < 0 or to_j[start[j]] < 0:
            return NEVER
        before_i, before_j = (self._before[:, :1] if stay else self._before for stay in stays)
        table = np.zeros((problem.n_vertices,) * 2, np.bool_)
        table[start[i], start[j]] = True
        best, t = NEVER, 0
        while True:
            found = t if park and table[goal[i], goal[j]] else NEVER
            if not park:
                # The first to arrive leaves the floor, and the way is free for the other.
                rests = (
                    *to_j[table[goal[i]] & (to_j >= 0)].tolist(),
                    *to_i[table[:, goal[j]] & (to_i >= 0)].tolist(),
                )
                found = t + min(rests) if rests else NEVER
            if found >= 0 and (best < 0 or found < best):
                best = found
            if 0 <= best <= t + 1:
                return best
            after = self._step(table, before_i, before_j)
            if np.array_equal(after, table):
                return best  # they can wait, so the table only grows: now it is complete
            table, t = after, t + 1

    def _step(self, table: Bools, before_i: Ints, before_j: Ints) -> Bools:
        """Where the two can be a slot later."""
        moved = table[before_i[:, 0]]
        for column in before_i.T[1:]:
            moved |= table[column]
        turned = np.ascontiguousarray(moved.T)
        after = turned[before_j[:, 0]]
        for column in before_j.T[1:]:
            after |= turned[column]
        out = np.ascontiguousarray(after.T)
        if len(self._swap):
            v, u = self._swap.T
            p, q = before_i[v][:, :, None], before_j[u][:, None, :]
            swap = (p == u[:, None, None]) & (q == v[:, None, None])
            out[v, u] = (table[p, q] & ~swap).any(axis=(1, 2))
        np.fill_diagonal(out, False)  # §1.2
        return out

    def _slots_to(self, goal: int) -> Ints:
        """(V,) least slots from each vertex to a goal, -1 where there is no way."""
        if goal not in self._alone:
            slots = np.full(self.problem.n_vertices, -1, np.int64)
            front, t = [goal], 0
            while front:
                slots[front] = t
                near = np.unique(self._before[front])
                front, t = near[slots[near] < 0].tolist(), t + 1
            self._alone[goal] = slots
        return self._alone[goal]


def _table(rows: list[list[int]]) -> Ints:
    """(V, K) rows of one length, the first entry repeated where there are fewer."""
    width = max(map(len, rows))
    return np.array([row + row[:1] * (width - len(row)) for row in rows], np.int64)
