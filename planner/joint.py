"""Pairs of robots looked at together: a bound, and states that fit with none of the other's.

Under penalties p a plan costs at least L = Σ_i least_i − Σ p · capacity, where least_i is the least
penalised cost of a path of robot i, whatever the others do. For disjoint pairs it costs at least

    L' = L + Σ_pairs (z_ij − least_i − least_j),

where z_ij is the least penalised cost of two paths of i and j that keep §1.2 and §1.3 towards each
other (AP capacities stay dualised). Proof: the two paths of a plan do, pair by pair, so its
penalised cost is at least Σ z + Σ least of the others; and its cost is at least its penalised cost
less Σ p · capacity. ∎

By the same argument a plan of interest, of cost at most C, passes a state s of robot i only if for
every other robot j the least cost of two such paths, the one through s, is at most
least_i + least_j + (C − L). Both come from the product of the two robots' graphs, layer by layer,
of which only what is within that limit is kept. (Compare the joint decision diagrams of Sharon,
Stern, Felner, Sturtevant: "Conflict-based search for optimal multi-agent pathfinding", Artificial
Intelligence 219, 2015, DOI 10.1016/j.artint.2014.11.006.) All terms are
integers; nothing is rounded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planner import kernels_joint
from planner.branching import Restriction
from planner.exact_pricing import Pricing
from planner.parallel import each
from planner.problem import Problem
from planner.resources import SCALE
from planner.search import INFINITE

MAX_STEPS = 1_000_000
"""A product is given up when more pairs of moves were looked at."""


@dataclass(frozen=True)
class Joint:
    """What a group of robots can do together, slot by slot.

    Attributes:
        layer: (T+3,) first state of each layer: slots 0 … T, and T+1 when all are gone.
        node, vertex: (S, k) int32, of each robot in each state, -1 where it is gone (parked ones
            have a vertex still).
        ptr: (S+1,) first arc of each state.
        head, cost: of the arcs.
        before, behind: (S,) int64 least cost from the origins, and to the end.
    """

    layer: NDArray[np.int64]
    node: NDArray[np.int32]
    vertex: NDArray[np.int32]
    ptr: NDArray[np.int64]
    head: NDArray[np.int64]
    cost: NDArray[np.int64]
    before: NDArray[np.int64]
    behind: NDArray[np.int64]

    @property
    def least(self) -> int:
        """z(group), INFINITE if there is nothing within the limit it was made with."""
        first = slice(0, int(self.layer[1]))
        return int((self.before[first] + self.behind[first]).min(initial=INFINITE))

    def slots(self) -> NDArray[np.int64]:
        """(S,) the layer of each state."""
        return np.repeat(np.arange(len(self.layer) - 1), np.diff(self.layer))

    def occupied(self, n_vertices: int) -> NDArray[np.int64]:
        """Places (slot · V + vertex) that its robots can be at, sorted."""
        slots = self.slots()
        there = self.vertex >= 0
        places = np.where(there, slots[:, None] * n_vertices + self.vertex, -1)
        return np.unique(places[there])


@dataclass(frozen=True)
class Propagation:
    """What looking at pairs has shown.

    Attributes:
        bound: of every plan that keeps the restrictions and is of interest [1/SCALE cost units].
        excluded: (T+1, n) bool of the robots looked at, states that none of these plans passes.
    """

    bound: int
    excluded: dict[int, NDArray[np.bool_]]


class JointBound:
    """Looks at robots in pairs, under the penalties of a pricing.

    Args:
        pricing: of the search; all edges must take one slot.
        stop: True ends it early.
    """

    def __init__(self, pricing: Pricing, stop: Callable[[], bool] = lambda: False) -> None:
        self.pricing, self.stop = pricing, stop
        self.problem = pricing.problem

    @cached_property
    def single(self) -> NDArray[np.bool_]:
        """`single_edges`, when it is needed."""
        return single_edges(self.problem)

    def propagate(
        self,
        kept: list[Restriction],
        room_above: int,
        capacity: int,
        pairs: list[tuple[int, int]] | None = None,
    ) -> Propagation | None:
        """States that do not fit with any of another robot's, and a bound from disjoint pairs.

        Args:
            kept: restriction per robot.
            room_above: what a plan of interest costs at most [1/SCALE cost units].
            capacity: Σ p · capacity of the penalties.
            pairs: of robots, to be looked at; None for all that can be at one place in one slot.

        Returns:
            None if a robot has no path, or no plan is of interest; when stopped, what is known.
        """
        problem, n = self.problem, self.problem.n_robots
        seen = sorted({i for pair in pairs for i in pair}) if pairs is not None else range(n)
        swept = list(each(lambda i: self._behind(i, kept[i]), range(n), self.stop))
        if len(swept) < n:
            return Propagation(0, {})
        least = [found[2] for found in swept]
        bound = sum(least) - capacity
        room = room_above - bound
        if room < 0:
            return None
        layered = list(
            each(lambda i: self._alone(i, kept[i], *swept[i][:2], least[i] + room), seen, self.stop)
        )
        if len(layered) < len(seen):
            return Propagation(0, {})
        alone = dict(zip(seen, layered, strict=True))
        excluded = {i: ~self._states(i, joint, 0) for i, joint in alone.items()}
        if pairs is None:
            places = {i: joint.occupied(problem.n_vertices) for i, joint in alone.items()}
            pairs = [
                (i, j)
                for i in range(n)
                for j in range(i + 1, n)
                if len(np.intersect1d(places[i], places[j], assume_unique=True))
            ]
        gains = []
        products = each(lambda ij: self.product(alone[ij[0]], alone[ij[1]], room), pairs, self.stop)
        for (i, j), joint in zip(pairs, products, strict=False):
            if joint is None:
                continue
            if not len(joint.before):
                return None
            gains.append((joint.least - least[i] - least[j], i, j))
            excluded[i] |= ~self._states(i, joint, 0)
            excluded[j] |= ~self._states(j, joint, 1)
        met: set[int] = set()
        for gain, i, j in sorted(gains, reverse=True):
            if gain > 0 and i not in met and j not in met:
                bound += gain
                met.update((i, j))
        return Propagation(bound, excluded)

    def _behind(
        self, i: int, kept: Restriction
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
        graph, p = self.pricing.search.graph, self.pricing.penalties
        behind, ending = self.pricing.behind(i, kept)
        start = graph.nodes_at(int(self.problem.start[i]))
        total = p.ap[0, graph.node_ap[start]] + behind[0, start]
        return behind, ending, int(total.min(initial=INFINITE))

    def _alone(
        self,
        i: int,
        kept: Restriction,
        behind: NDArray[np.int64],
        ending: NDArray[np.int64],
        limit: int,
    ) -> Joint:
        """A robot by itself, paths that cost at most `limit`."""
        graph, problem, p = self.pricing.search.graph, self.problem, self.pricing.penalties
        vertex, move, last = self.pricing.own_penalties(i, kept)
        layer, node, at, ptr, head, cost, before, rest = kernels_joint.robot_layers(
            graph.arc_ptr,
            graph.arc_to,
            graph.arc_move,
            graph.arc_cost,
            graph.node_vertex,
            graph.node_ap,
            graph.nodes_at(int(problem.start[i])),
            graph.nodes_at(int(problem.goal[i])),
            SCALE,
            vertex,
            move,
            p.ap,
            problem.at_goal == "park",
            behind,
            ending,
            last,
            limit,
        )
        return Joint(layer, node[:, None], at[:, None], ptr, head, cost, before, rest)

    def product(self, a: Joint, b: Joint, room: int) -> Joint | None:
        """Two groups together within `room` above their least costs; None if it is too large."""
        layer, of_a, of_b, ptr, head, cost, before, behind, steps = kernels_joint.product_layers(
            a.layer,
            a.vertex,
            a.ptr,
            a.head,
            a.cost,
            a.before,
            a.behind,
            b.layer,
            b.vertex,
            b.ptr,
            b.head,
            b.cost,
            b.before,
            b.behind,
            self.single,
            a.least + b.least + room,
            MAX_STEPS,
        )
        if steps < 0:
            return None
        node = np.concatenate((a.node[of_a], b.node[of_b]), axis=1)
        vertex = np.concatenate((a.vertex[of_a], b.vertex[of_b]), axis=1)
        return Joint(layer, node, vertex, ptr, head, cost, before, behind)

    def _states(self, i: int, joint: Joint, place: int) -> NDArray[np.bool_]:
        """(T+1, n) bool: states of G' that robot i, at that place of a group, can be in."""
        graph, T = self.pricing.search.graph, self.problem.horizon
        states = np.zeros((T + 2, graph.n_nodes), np.bool_)
        node = joint.node[:, place]
        there = node >= 0
        states[joint.slots()[there], node[there]] = True
        if self.problem.at_goal == "park":
            # Who is parked passes the goal's states, by the AP that it arrived with.
            goal = graph.nodes_at(int(self.problem.goal[i]))
            states[:, goal] = np.maximum.accumulate(states[:, goal], axis=0)
        return states[: T + 1]


def single_edges(problem: Problem) -> NDArray[np.bool_]:
    """(V, V) bool: one edge only joins the two vertices, so nobody can swap there (§1.3)."""
    V = problem.n_vertices
    pairs, times = np.unique(np.sort(problem.edge_uv, axis=1), axis=0, return_counts=True)
    u, v = pairs[times == 1].T
    single = np.zeros((V, V), np.bool_)
    single[u, v] = single[v, u] = True
    return single


__all__ = ["Joint", "JointBound", "Propagation", "single_edges"]
