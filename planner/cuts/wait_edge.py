"""Wait-edge cuts (Lam, Le Bodic, Harabor, Stuckey, IJCAI 2019, DOI 10.24963/ijcai.2019/179).

For an edge e = {u, v} of one slot, one of its ends w and a slot t:

    (e from u to v in t) + (e from v to u in t) + (waiting, or parking, at w from t to t+1) ≤ 1.

Proof: two robots on e in t break §1.3. Of a robot on e and one that waits at w, the former is at w
in t (if it leaves w) or in t+1 (if it goes there), and so is the latter: both break §1.2, or in
slot 0 the origins are not distinct. No path has two of the moves, having one per slot. ∎

It dominates the edge row of (1c) for that e and t.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.cuts import moves_of
from planner.master import Column
from planner.problem import Problem


@dataclass(frozen=True)
class WaitEdgeCut:
    """The row above; `moves` are (slot, move) as `Cut` says."""

    moves: tuple[tuple[int, int], ...]
    capacity: int = 1
    arrivals: tuple[tuple[int, int], ...] = ()
    places: tuple[tuple[int, int, tuple[int, ...]], ...] = ()


def separate(
    problem: Problem, columns: list[Column], x: NDArray[np.float64], *, least: float = 0.01
) -> list[WaitEdgeCut]:
    """All wait-edge cuts that a solution violates by at least `least`, by slot and edge."""
    E = problem.n_edges
    weight: dict[tuple[int, int], float] = {}
    for k in np.flatnonzero(x > 1e-9).tolist():
        path = columns[k].path
        if path is None:
            continue
        for place in enumerate(moves_of(problem, path).tolist()):
            weight[place] = weight.get(place, 0.0) + float(x[k])
    crossings = {(t, move >> 1) for t, move in weight if move < 2 * E}
    found = []
    for t, e in sorted(crossings):
        if problem.edge_slots[e] != 1:
            continue
        there, back = (t, 2 * e), (t, 2 * e + 1)
        on_edge = weight.get(there, 0.0) + weight.get(back, 0.0)
        for w in problem.edge_uv[e].tolist():
            wait = (t, 2 * E + w)
            if on_edge + weight.get(wait, 0.0) > 1.0 + least:
                found.append(WaitEdgeCut((there, back, wait)))
    return found
