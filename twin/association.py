"""When robots change their APs: the instants of a run, and the association of a plan with them.

**Instants.** A slot is cut into `steps` parts (`samples_per_slot` − 1, at least 1); its instants
are 0 … steps, the last being the next slot's first. All that is measured at an instant holds until
the next one.

**Association.** The plan says which AP serves in each slot; the twin decides when within the slot
the change happens. A handover a → b between slots t and t + 1 takes place at one of the instants
1 … steps of slot t: up to there a serves, from there on b. So at a slot's first instant each robot
is served by the AP its plan has for that slot. The instant is the one at which, by the radio map,
the fewest instants of the crossing lie below the threshold; of several, the earliest from which b
covers all that is left. Waiting robots, both APs covering the place, so hand over at the first
instant after the slot's beginning; crossing ones as soon as b holds to the end of the edge. On an
edge of k slots the AP of the vertex left serves until the last slot (§1.6), unless an earlier
change saves instants below the threshold; its *load* is a's until arrival in any case.

With `edge_rule = "samples"` the map's samples of every edge in the plan are covered by a up to some
point and by b from there on; at as many instants per slot as samples per edge an undisturbed run
then has no outage. It can have one only if coverage alternates along an edge (a, b, a: §1.7 asks of
each sample that one of them covers it), or at instants between the map's samples. With "endpoints"
nothing is known of the middle of an edge, and outages there belong to the run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twin.errors import TwinError
from worlds.radio_map import kept_edges, kept_vertices

if TYPE_CHECKING:
    from planner.problem import Problem
    from twin.order import VisitOrder
    from worlds.floor import Floor
    from worlds.radio_map import RadioMap

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


def nanoseconds(t_s: float) -> int:
    """A time in whole nanoseconds, in which times are compared (and logged)."""
    return round(t_s * 1e9)


@dataclass(frozen=True)
class Instants:
    """The instants of a run.

    Attributes:
        slot_s: length of a slot [s].
        steps: parts a slot is cut into.
    """

    slot_s: float
    steps: int

    @classmethod
    def of(cls, slot_s: float, samples_per_slot: int) -> Instants:
        """Those of `samples_per_slot` samples, the slot's ends included; 1 and 2 are the same."""
        return cls(slot_s, max(1, samples_per_slot - 1))

    def t_s(self, slot: int, step: int = 0) -> float:
        """Simulated time of an instant [s]; the last of a slot is the first of the next."""
        if step == self.steps:
            slot, step = slot + 1, 0
        return slot * self.slot_s + step * self.slot_s / self.steps

    @property
    def fractions(self) -> Floats:
        """(steps,) the instants of a slot without its last, as fractions of the slot."""
        return np.arange(self.steps) / self.steps


class Prediction:
    """What the radio map says along the problem's edges and at its vertices."""

    def __init__(self, floor: Floor, radio_map: RadioMap, problem: Problem) -> None:
        """Find the problem's vertices and edges on the floor.

        Raises:
            TwinError: the problem was not made from this floor and map.
        """
        vertices, edges = kept_vertices(radio_map), kept_edges(floor, radio_map)
        same = (
            problem.ap_ids == radio_map.ap_ids
            and problem.robot_ids == floor.robot_ids
            and problem.n_vertices == len(vertices)
            and problem.n_edges == len(edges)
            and np.array_equal(problem.xy_m, floor.vertex_xy_m[vertices])
            and np.array_equal(vertices[problem.edge_uv], floor.edge_uv[edges])
        )
        if not same:
            raise TwinError(
                f"the problem ({problem.n_vertices} vertices, {problem.n_edges} edges, "
                f"{problem.n_aps} APs, {problem.n_robots} robots) is not that of this world "
                f"({len(vertices)}, {len(edges)}, {len(radio_map.ap_ids)}, "
                f"{len(floor.robot_ids)}); make it with problem_from_world"
            )
        self.threshold_db = radio_map.threshold_db
        self._floor, self._map = floor, radio_map
        self._vertices, self._edges = vertices, edges

    def snr_db(self, edge: Ints, fraction: Floats, vertex: Ints, ap: Ints) -> Floats:
        """(n, s) predicted SNR [dB].

        Args:
            edge: (n,), −1 for robots at a vertex.
            fraction: (n, s) of the way from the edge's u to its v.
            vertex: (n,) where robots at a vertex stand.
            ap: (n, s).
        """
        snr = self._map.snr_db[self._vertices[vertex][:, None], ap]
        on = np.flatnonzero(edge >= 0)
        snr[on] = self._map.snr_along(self._edges[edge[on]][:, None], fraction[on], ap[on])
        return snr

    def fading_db(self, edge: Ints, fraction: Floats, vertex: Ints, ap: Ints) -> Floats:
        """(n, s) shadow fading as a gain [dB]; arguments as above."""
        gain = self._map.fading_db[self._vertices[vertex][:, None], ap]
        on = np.flatnonzero(edge >= 0)
        gain[on] = self._map.fading_along(
            self._floor, self._edges[edge[on]][:, None], fraction[on], ap[on]
        )
        return gain


@dataclass(frozen=True)
class Association:
    """When each transition of a plan hands over; arrays over the rows of its visit order.

    Attributes:
        serves: (S,) int32, AP at the beginning of the transition.
        step: (S,) int32, instant (1 … steps) at which it changes, 0 if it does not.
        to: (S,) int32, AP from there on.
    """

    serves: Ints
    step: Ints
    to: Ints


def associate(
    problem: Problem,
    order: VisitOrder,
    prediction: Prediction,
    steps: int,
    serving: Ints | None = None,
) -> Association:
    """Choose the instant of every handover of a plan (see the head of this file).

    A route may begin amid a crossing at whose end it has another AP, and that one serves already:
    then the handover has been made. `serving` (N,) are the APs that serve as the plan begins.
    """
    serves, to = order.ap.copy(), order.ap.copy()
    step = np.zeros(len(serves), np.int32)
    changes = (order.robot[1:] == order.robot[:-1]) & (order.ap[1:] != order.ap[:-1])
    rows = np.flatnonzero(changes)
    edge, vertex, piece = order.edge[rows], order.vertex[rows], order.piece[rows]
    slots = np.append(problem.edge_slots, 1)[edge].astype(np.int32)
    # The whole crossing can be chosen from, unless the plan changes the AP more than once in it.
    before = np.concatenate([[0], np.cumsum(changes)])
    # A route may begin amid a crossing: then what is left of it is not a whole one.
    inside = rows - piece >= order.first_row[order.robot[rows]]
    first_piece = np.where(inside, rows - piece, rows)
    whole = (edge >= 0) & (piece == slots - 1) & inside & (before[rows] == before[first_piece])
    window = np.where(whole, slots, 1)
    from_u = vertex == np.append(problem.edge_uv[:, 0], -1)[edge]
    for length in np.unique(window).tolist():
        of = np.flatnonzero(window == length)
        first = piece[of] - length + 1  # piece with which the window begins
        instants = first[:, None] * steps + np.arange(length * steps + 1)
        fraction = instants / (slots[of, None] * steps)
        fraction = np.where(from_u[of, None], fraction, 1.0 - fraction)
        below_a, below_b = (
            prediction.snr_db(
                edge[of], fraction, vertex[of], np.broadcast_to(ap[:, None], fraction.shape)
            )
            < prediction.threshold_db
            for ap in (order.ap[rows[of]], order.ap[rows[of] + 1])
        )
        chosen = handover_instants(below_a, below_b, steps) - 1
        at_row = rows[of] - length + 1 + chosen // steps
        step[at_row] = chosen % steps + 1
        to[at_row] = order.ap[rows[of] + 1]
        for r, end in zip(at_row.tolist(), rows[of].tolist(), strict=True):
            serves[r + 1 : end + 1] = to[r + 1 : end + 1] = to[r]
    if serving is not None:
        for end in rows[~inside].tolist():
            now = serving[order.robot[end]]
            if now == order.ap[end + 1]:
                first = int(order.first_row[order.robot[end]])
                serves[first : end + 1] = to[first : end + 1] = now
                step[first : end + 1] = 0
    return Association(serves, step, to)


def handover_instants(below_a: Bools, below_b: Bools, steps: int) -> Ints:
    """The instant from which b serves instead of a, 1 … M, for each of H handovers.

    Args:
        below_a: (H, M + 1) bool, the map has AP a below the threshold at this instant.
        below_b: the same of AP b.
        steps: of a slot; M is a multiple.
    """
    passed_a, passed_b = np.cumsum(below_a, axis=1), np.cumsum(below_b, axis=1)
    left_b: NDArray[np.int64] = passed_b[:, -1:] - passed_b[:, :-1]
    lost = passed_a[:, :-1] + left_b
    early = np.arange(lost.shape[1]) < lost.shape[1] - steps
    # argmin takes the first of equals: the earliest.
    return np.asarray((lost * 4 + early * 2 + (left_b > 0)).argmin(axis=1) + 1, np.int32)
