"""What robots compete for: places in vertices, edges and APs, slot by slot (§1.2, §1.3, §1.6).

Every resource has one index: vertex v in slot t, edge e in slot t, AP a in slot t, in this order.
Penalties on resources are int64 in units of 1/`SCALE` of a cost unit, so that sums of them are
exact and a Lagrangian bound made from them is proven, not merely computed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.plan import Path
from planner.problem import Problem

SCALE = 1 << 24
"""Penalty units per cost unit."""

BLOCKED = np.int64(1) << 52
"""A penalty of at least this much means: not to be used at all."""


@dataclass(frozen=True)
class Resources:
    """Index arithmetic for the resources of a problem.

    Attributes:
        capacity: (R,) int32, robots each resource holds; vertices in slot 0 are free by input.
    """

    problem: Problem
    capacity: NDArray[np.int32]

    @classmethod
    def of(cls, problem: Problem) -> Resources:
        """Lays out the indices."""
        T = problem.horizon
        V, E = len(problem.xy_m), len(problem.edge_uv)
        capacity = np.concatenate(
            (
                np.ones((T + 1) * V, np.int32),
                np.ones(T * E, np.int32),
                np.tile(problem.ap_capacity.astype(np.int32), T + 1),
            )
        )
        capacity.flags.writeable = False
        return cls(problem, capacity)

    @property
    def n(self) -> int:
        """Number of resources."""
        return len(self.capacity)

    @property
    def first_edge(self) -> int:
        """Index of edge 0 in slot 0."""
        return (self.problem.horizon + 1) * len(self.problem.xy_m)

    @property
    def first_ap(self) -> int:
        """Index of AP 0 in slot 0."""
        return self.first_edge + self.problem.horizon * len(self.problem.edge_uv)

    def used_by(self, path: Path) -> NDArray[np.int64]:
        """Resources a path uses, each once; parking at the goal included (§1.4)."""
        problem = self.problem
        T, V = problem.horizon, len(problem.xy_m)
        E, A = len(problem.edge_uv), len(problem.ap_ids)
        tau = path.arrival
        t = np.arange(tau + 1)
        vertices, aps = path.vertices.astype(np.int64), path.aps.astype(np.int64)
        edges = path.edges.astype(np.int64)
        # On an edge of k slots the robot is on no vertex in its slots 2 … k.
        standing = np.ones(tau + 1, bool)
        if np.any(problem.edge_slots > 1):
            standing[~stands(problem, path)] = False
        standing[0] = False  # slot 0 holds by input (§1.2)
        crossing = edges >= 0
        parts = [
            t[standing] * V + vertices[standing],
            self.first_edge + t[:-1][crossing] * E + edges[crossing],
            self.first_ap + t * A + aps,
        ]
        if problem.at_goal == "park" and tau < T:
            rest = np.arange(tau + 1, T + 1)
            parts += [rest * V + vertices[-1], self.first_ap + rest * A + aps[-1]]
        return np.concatenate(parts)

    def shaped(
        self, penalty: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Views of a (R,) array as vertex (T+1, V), edge (T, E) and AP (T+1, A) penalties."""
        problem = self.problem
        T, V = problem.horizon, len(problem.xy_m)
        E, A = len(problem.edge_uv), len(problem.ap_ids)
        return (
            penalty[: self.first_edge].reshape(T + 1, V),
            penalty[self.first_edge : self.first_ap].reshape(T, E),
            penalty[self.first_ap :].reshape(T + 1, A),
        )


def stands(problem: Problem, path: Path) -> NDArray[np.bool_]:
    """(τ+1,) bool: the robot stands at its vertex in that slot, that is, is not amid an edge."""
    standing = np.ones(path.arrival + 1, bool)
    t = 0
    while t < path.arrival:
        edge = int(path.edges[t])
        k = int(problem.edge_slots[edge]) if edge >= 0 else 1
        standing[t + 1 : t + k] = False
        t += k
    return standing
