"""`Problem`: one MAPP instance as arrays (1-semantics §1.1–§1.11)."""

from __future__ import annotations

import operator
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.validation import Fault, InvalidProblem, as_array, shape_faults, value_faults

if TYPE_CHECKING:
    from worlds.floor import Floor
    from worlds.radio_map import RadioMap
    from worlds.world import World

_DTYPES: dict[str, type[np.generic]] = {
    "ap_capacity": np.int32,
    "xy_m": np.float64,
    "cover": np.bool_,
    "snr_db": np.float64,
    "edge_uv": np.int32,
    "edge_slots": np.int32,
    "edge_oneway": np.bool_,
    "edge_cover": np.bool_,
    "edge_handover": np.bool_,
    "start": np.int32,
    "goal": np.int32,
}


@dataclass(frozen=True, eq=False)
class Problem:
    """A MAPP instance: graph G with its coverage, robots, horizon, capacities and costs.

    Only covered vertices and edges are in it (§1.8). Under the `snr` objective `cover` is cut to
    the best AP of each vertex when the problem is made (§1.10), `edge_cover` and `edge_handover`
    with it. `snr_db` is kept where `cover` holds only, so that a problem equals what its
    problem.json says. Arrays are copied if need be and read-only.

    Attributes:
        name: free text.
        horizon: T [slots].
        objective: "hp", "tp", "snr" or "costs".
        c_t, c_h: integer cost of a slot and of a handover.
        at_goal: "leave" or "park" (§1.4).
        ap_ids: (A,) names.
        ap_capacity: (A,) int32, m per AP [robots].
        xy_m: (V, 2) float64.
        cover: (V, A) bool, A_v.
        snr_db: (V, A) float64, NaN where unknown.
        edge_uv: (E, 2) int32.
        edge_slots: (E,) int32, traversal time k.
        edge_oneway: (E,) bool, crossed from u to v only.
        edge_cover: (E, A) bool, A_e.
        edge_handover: (E, A, A) bool, [e, AP at u, AP at v] handovers allowed while crossing;
            the diagonal is False.
        robot_ids: (N,) names.
        start, goal: (N,) int32 vertices.

    Raises:
        PlannerError: with one line per fault, all faults at once.
    """

    name: str
    horizon: int
    objective: str
    c_t: int
    c_h: int
    at_goal: str
    ap_ids: tuple[str, ...]
    ap_capacity: NDArray[np.int32]
    xy_m: NDArray[np.float64]
    cover: NDArray[np.bool_]
    snr_db: NDArray[np.float64]
    edge_uv: NDArray[np.int32]
    edge_slots: NDArray[np.int32]
    edge_oneway: NDArray[np.bool_]
    edge_cover: NDArray[np.bool_]
    edge_handover: NDArray[np.bool_]
    robot_ids: tuple[str, ...]
    start: NDArray[np.int32]
    goal: NDArray[np.int32]

    def __post_init__(self) -> None:
        faults: list[Fault] = []
        for name in ("horizon", "c_t", "c_h"):
            try:
                self._set(name, operator.index(getattr(self, name)))
            except TypeError:
                faults.append(Fault((name,), repr(getattr(self, name)), "must be an integer"))
        for name in ("ap_ids", "robot_ids"):
            self._set(name, tuple(map(str, getattr(self, name))))
        for name, dtype in _DTYPES.items():
            self._set(name, as_array(getattr(self, name), dtype, name, faults))
        faults = faults or shape_faults(self) or value_faults(self)
        if faults:
            raise InvalidProblem(faults)
        cover = self.cover
        if self.objective == "snr":
            # argmax takes the first of equals: ties go to the lowest index.
            best = np.argmax(np.where(cover, self.snr_db, -np.inf), axis=1)
            cover = cover & (np.arange(self.n_aps) == best[:, None])
            at_u, at_v = cover[self.edge_uv[:, 0]], cover[self.edge_uv[:, 1]]
            self._freeze("cover", cover)
            self._freeze("edge_cover", self.edge_cover & at_u & at_v)
            self._freeze("edge_handover", self.edge_handover & at_u[:, :, None] & at_v[:, None, :])
        if not np.isnan(self.snr_db[~cover]).all():
            self._freeze("snr_db", np.where(cover, self.snr_db, np.nan))

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _freeze(self, name: str, array: NDArray[np.generic]) -> None:
        array.flags.writeable = False
        self._set(name, array)

    def __eq__(self, other: object) -> bool:
        """All fields equal, unknown SNRs to unknown SNRs."""
        if not isinstance(other, Problem):
            return NotImplemented
        for field in fields(self):
            mine, theirs = getattr(self, field.name), getattr(other, field.name)
            if isinstance(mine, np.ndarray):
                if not np.array_equal(mine, theirs, equal_nan=mine.dtype == np.float64):
                    return False
            elif mine != theirs:
                return False
        return True

    __hash__ = None  # type: ignore[assignment]  # arrays have no hash

    @property
    def n_robots(self) -> int:
        """N."""
        return len(self.robot_ids)

    @property
    def n_vertices(self) -> int:
        """V."""
        return len(self.xy_m)

    @property
    def n_edges(self) -> int:
        """E."""
        return len(self.edge_uv)

    @property
    def n_aps(self) -> int:
        """A."""
        return len(self.ap_ids)


def objective_costs(objective: str, horizon: int) -> tuple[int, int]:
    """(c_t, c_h) of the objectives "hp", "tp" and "snr" (§1.10).

    Raises:
        PlannerError: for any other objective.
    """
    costs = {"hp": (1, horizon), "tp": (horizon, 1), "snr": (1, 0)}
    if objective not in costs:
        raise PlannerError(f'objective: {objective!r}: must be "hp", "tp" or "snr"')
    return costs[objective]


def edge_cover_of_ends(
    cover: NDArray[np.bool_], edge_uv: NDArray[np.int32]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """A_e and the handovers where nothing is known of an edge but its ends (§1.7 `endpoints`).

    Args:
        cover: (V, A) bool, A_v.
        edge_uv: (E, 2) int32.

    Returns:
        (E, A) bool, A_u ∩ A_v, and (E, A, A) bool, all pairs of A_u × A_v of different APs.
    """
    at_u, at_v = cover[edge_uv[:, 0]], cover[edge_uv[:, 1]]
    handover = at_u[:, :, None] & at_v[:, None, :]
    every_ap = np.arange(cover.shape[1])
    handover[:, every_ap, every_ap] = False
    return at_u & at_v, handover


def problem_from_world(world: World, floor: Floor, radio_map: RadioMap) -> Problem:
    """The problem a world poses: its floor, cut to what is covered (§1.8), and its robots.

    Vertex k of the problem is floor vertex `kept_vertices(radio_map)[k]`, edge k is floor edge
    `kept_edges(floor, radio_map)[k]`, with the same orientation.

    Raises:
        PlannerError: naming robots that start or end where no AP reaches, or a world without
            any coverage, and whatever else the problem lacks.
    """
    from worlds.radio_map import kept_edges, kept_vertices

    vertices, edges = kept_vertices(radio_map), kept_edges(floor, radio_map)
    radio = f"radio.threshold_db ({radio_map.threshold_db:g} dB)"
    if not len(radio_map.ap_ids):
        raise PlannerError(f"{world.name}: no AP is enabled: add one, or enable one with [[ap]]")
    if not len(vertices):
        best = np.max(radio_map.snr_db, initial=-np.inf)
        raise PlannerError(
            f"{world.name}: no AP covers any of the {len(floor.vertex_xy_m)} free positions "
            f"(the best SNR is {best:.1f} dB): lower {radio}, raise tx_power_dbm, or move the APs"
        )
    new_index = np.full(len(floor.vertex_xy_m), -1, np.int32)
    new_index[vertices] = np.arange(len(vertices), dtype=np.int32)

    faults = []
    for end, at in (("start", floor.start), ("goal", floor.goal)):
        for robot in np.flatnonzero(new_index[at] < 0):
            v = at[robot]
            x, y = floor.vertex_xy_m[v]
            ap = int(np.argmax(radio_map.snr_db[v]))
            faults.append(
                f"{world.name}: robot {floor.robot_ids[robot]}: its {end}, {floor.vertex_name(v)} "
                f"at ({x:g}, {y:g}) m, is covered by no AP (the best, {radio_map.ap_ids[ap]}, "
                f"gives {radio_map.snr_db[v, ap]:.1f} dB): move the {end}, add an AP near it, "
                f"or lower {radio}"
            )
    if faults:
        raise PlannerError(*faults)

    plan = world.plan
    by_id = {ap.id: ap for ap in world.ap}
    own = [by_id[ap_id].capacity for ap_id in radio_map.ap_ids]
    objective: str = "costs"
    if isinstance(plan.objective, str):
        objective = plan.objective
        c_t, c_h = objective_costs(objective, plan.horizon)
    else:
        c_t, c_h = plan.objective.c_t, plan.objective.c_h
    try:
        return Problem(
            name=world.name,
            horizon=plan.horizon,
            objective=objective,
            c_t=c_t,
            c_h=c_h,
            at_goal=plan.at_goal,
            ap_ids=radio_map.ap_ids,
            ap_capacity=np.array(
                [world.radio.ap_capacity if m is None else m for m in own], np.int32
            ),
            xy_m=floor.vertex_xy_m[vertices],
            cover=radio_map.covered[vertices],
            snr_db=radio_map.snr_db[vertices],
            edge_uv=new_index[floor.edge_uv[edges]],
            edge_slots=floor.edge_slots[edges],
            edge_oneway=floor.edge_oneway[edges],
            edge_cover=radio_map.edge_covered[edges],
            edge_handover=radio_map.edge_handover(floor)[edges],
            robot_ids=floor.robot_ids,
            start=new_index[floor.start],
            goal=new_index[floor.goal],
        )
    except InvalidProblem as error:
        raise PlannerError(*(f"{world.name}: {line}" for line in error.lines)) from error
