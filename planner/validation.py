"""What makes a `Problem` a problem: every rule its arrays must keep, and all faults at once.

Faults are addressed as in problem.json (`("robots", 3, "start")`), so that a file's faults and
those of a `Problem` built from arrays read alike.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError

if TYPE_CHECKING:
    from planner.problem import Problem

Key = tuple[str | int, ...]

MAX_HORIZON = 100_000
"""Longest horizon and longest traversal time [slots]."""

MAX_PATH_COST = 2**27
"""T · (c_t + c_h) may not exceed this: costs and penalties then stay exact integers."""


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong with a problem or a plan.

    Attributes:
        key: where, as in the JSON file; () when it concerns the whole.
        value: what stands there, as text.
        message: the rule it breaks and the remedy.
        member: when `key` is a list, the member of it that is meant; None otherwise.
        depends: other places the fault was concluded from.
    """

    key: Key
    value: str
    message: str
    member: object = None
    depends: tuple[Key, ...] = ()

    def line(self, prefix: str = "") -> str:
        """`robots[3].start: 7: message`, after `prefix`."""
        return f"{prefix}{place(self.key, bool(prefix))}: {self.value}: {self.message}"


class InvalidProblem(PlannerError):  # noqa: N818 - it is a PlannerError, told apart by its faults
    """A `Problem` that breaks rules; `faults` are the lines with their places kept apart."""

    def __init__(self, faults: list[Fault]) -> None:
        self.faults = tuple(faults)
        super().__init__(*(fault.line() for fault in faults))


def place(key: Key, rooted: bool = False) -> str:
    """`vertices[3].aps[1]`, or `$.vertices[3].aps[1]` when rooted."""
    text = "$" if rooted else ""
    for step in key:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else step
    return text or "problem"


def shape_faults(problem: Problem) -> list[Fault]:
    """Arrays whose shapes contradict each other; nothing else can be checked before they agree."""
    V, E = len(problem.xy_m), len(problem.edge_uv)
    A, N = len(problem.ap_ids), len(problem.robot_ids)
    wanted: dict[str, tuple[int, ...]] = {
        "ap_capacity": (A,),
        "xy_m": (V, 2),
        "cover": (V, A),
        "snr_db": (V, A),
        "edge_uv": (E, 2),
        "edge_slots": (E,),
        "edge_oneway": (E,),
        "edge_cover": (E, A),
        "edge_handover": (E, A, A),
        "start": (N,),
        "goal": (N,),
    }
    return [
        Fault((name,), f"shape {found}", f"must be {shape} to fit the other arrays")
        for name, shape in wanted.items()
        for found in [getattr(problem, name).shape]
        if found != shape
    ]


def value_faults(problem: Problem) -> list[Fault]:
    """All values that break a rule, in the order of the file's parts."""
    return [
        *_scalar_faults(problem),
        *_ap_faults(problem),
        *_vertex_faults(problem),
        *_edge_faults(problem),
        *_robot_faults(problem),
    ]


def _scalar_faults(p: Problem) -> Iterator[Fault]:
    if not _encodable(p.name):
        yield Fault(("name",), repr(p.name), "must be text that UTF-8 can hold")
    if not 1 <= p.horizon <= MAX_HORIZON:
        yield Fault(("horizon",), str(p.horizon), f"must be 1 to {MAX_HORIZON} slots")
        return  # the costs below follow from it
    fixed = {"hp": (1, p.horizon), "tp": (p.horizon, 1), "snr": (1, 0)}
    if p.objective not in (*fixed, "costs"):
        yield Fault(
            ("objective",),
            repr(p.objective),
            'must be "hp", "tp" or "snr", or "costs" for costs of your own',
        )
    elif p.objective in fixed and (p.c_t, p.c_h) != fixed[p.objective]:
        c_t, c_h = fixed[p.objective]
        yield Fault(
            ("objective",),
            f"{p.objective} with c_t = {p.c_t}, c_h = {p.c_h}",
            f"it means c_t = {c_t}, c_h = {c_h} at this horizon (§1.10); "
            'use the objective "costs" for other numbers',
            depends=(("horizon",),),
        )
    for name in ("c_t", "c_h"):
        if getattr(p, name) < 0:
            yield Fault(("objective", name), str(getattr(p, name)), "must not be negative")
    if p.horizon * (p.c_t + p.c_h) > MAX_PATH_COST:
        yield Fault(
            ("objective",),
            f"c_t = {p.c_t}, c_h = {p.c_h}",
            f"a path of {p.horizon} slots could cost more than {MAX_PATH_COST}, beyond which sums "
            "are not exact; shorten the horizon or lower the costs",
            depends=(("horizon",),),
        )
    if p.at_goal not in {"leave", "park"}:
        yield Fault(("at_goal",), repr(p.at_goal), 'must be "leave" or "park" (§1.4)')


def _ap_faults(p: Problem) -> Iterator[Fault]:
    if not p.ap_ids:
        yield Fault(("aps",), "[]", "there must be at least one AP to connect to")
    yield from _name_faults(p.ap_ids, [("aps", k) for k in range(len(p.ap_ids))], "AP")
    for k in np.flatnonzero(p.ap_capacity < 0):
        yield Fault(
            ("ap_capacity", int(k)),
            str(p.ap_capacity[k]),
            "must be 0 robots or more",
            depends=(("ap_capacity",),),
        )


def _vertex_faults(p: Problem) -> Iterator[Fault]:
    if not len(p.xy_m):
        yield Fault(("vertices",), "[]", "there must be at least one vertex")
    for k, axis in np.argwhere(~np.isfinite(p.xy_m)):
        yield Fault(
            ("vertices", int(k), "xy"[axis]), str(p.xy_m[k, axis]), "must be a finite number [m]"
        )
    for k in np.flatnonzero(~p.cover.any(axis=1)):
        yield Fault(
            ("vertices", int(k), "aps"),
            "[]",
            "no AP covers this vertex; leave it out, with its edges (§1.8)",
            depends=(("aps",),),
        )
    bad = p.cover & np.isinf(p.snr_db)
    if p.objective == "snr":
        bad |= p.cover & np.isnan(p.snr_db)
    for k, a in np.argwhere(bad):
        yield Fault(
            ("vertices", int(k), "snr_db"),
            "unknown" if np.isnan(p.snr_db[k, a]) else str(p.snr_db[k, a]),
            f"needs a finite SNR [dB] of AP {p.ap_ids[a]}"
            + (', because the objective is "snr" (§1.10)' if p.objective == "snr" else ""),
            depends=(("vertices", int(k), "aps"),),
        )


def _edge_faults(p: Problem) -> Iterator[Fault]:
    V = len(p.xy_m)
    outside = (p.edge_uv < 0) | (p.edge_uv >= V)
    for e, end in np.argwhere(outside):
        yield Fault(
            ("edges", int(e), "uv"[end]),
            str(p.edge_uv[e, end]),
            _range_message("vertex", "vertices", V),
            depends=(("vertices", "count"),),
        )
    inside = np.logical_not(np.any(outside, axis=1)).reshape(-1)
    for e in np.flatnonzero(inside & (p.edge_uv[:, 0] == p.edge_uv[:, 1])):
        yield Fault(
            ("edges", int(e), "v"),
            str(p.edge_uv[e, 1]),
            "an edge joins two different vertices; waiting needs no edge (§1.1)",
            depends=(("edges", int(e), "u"),),
        )
    for e in np.flatnonzero((p.edge_slots < 1) | (p.edge_slots > MAX_HORIZON)):
        yield Fault(
            ("edges", int(e), "slots"), str(p.edge_slots[e]), f"must be 1 to {MAX_HORIZON} slots"
        )
    uv = np.where(inside[:, None], p.edge_uv, 0)
    if not V:
        return
    at_u, at_v = p.cover[uv[:, 0]], p.cover[uv[:, 1]]
    for e, a in np.argwhere(inside[:, None] & p.edge_cover & ~(at_u & at_v)):
        end = int(uv[e, 0] if not at_u[e, a] else uv[e, 1])
        yield Fault(
            ("edges", int(e), "aps"),
            str(a),
            f"AP {p.ap_ids[a]} covers the edge but not its vertex {end} (§1.7); "
            "add it there or remove it here",
            member=int(a),
            depends=tuple(("vertices", int(end), "aps") for end in uv[e]),
        )
    allowed = at_u[:, :, None] & at_v[:, None, :]
    every_ap = np.arange(len(p.ap_ids))
    allowed[:, every_ap, every_ap] = False
    for e, a, b in np.argwhere(inside[:, None, None] & p.edge_handover & ~allowed):
        yield Fault(
            ("edges", int(e), "handovers"),
            f"[{a}, {b}]",
            "a pair names two different APs; the first must cover vertex "
            f"{uv[e, 0]} (u), the second vertex {uv[e, 1]} (v) (§1.7)",
            member=[int(a), int(b)],
            depends=tuple(("vertices", int(end), "aps") for end in uv[e]),
        )


def _robot_faults(p: Problem) -> Iterator[Fault]:
    V, N = len(p.xy_m), len(p.robot_ids)
    if not N:
        yield Fault(("robots",), "[]", "there must be at least one robot")
    yield from _name_faults(p.robot_ids, [("robots", k, "id") for k in range(N)], "robot")
    for name, vertices in (("start", p.start), ("goal", p.goal)):
        for robot in np.flatnonzero((vertices < 0) | (vertices >= V)):
            yield Fault(
                ("robots", int(robot), name),
                str(vertices[robot]),
                _range_message("vertex", "vertices", V),
                depends=(("vertices", "count"),),
            )
        if name == "goal" and p.at_goal != "park":
            continue
        rule = "starts are distinct (§1.2)" if name == "start" else "parked robots stay (§1.5)"
        first: dict[int, int] = {}
        for i, v in enumerate(vertices.tolist()):
            j = first.setdefault(v, i)
            key: Key = ("robots", i, name)
            if j != i and 0 <= v < V:
                yield Fault(
                    key,
                    str(v),
                    f"robot {p.robot_ids[i]} and robot {p.robot_ids[j]} have the same {name}; "
                    f"{rule}, so move one of them",
                    depends=(("robots", j, name), ("at_goal",) if name == "goal" else key),
                )


def _name_faults(names: tuple[str, ...], keys: list[Key], what: str) -> Iterator[Fault]:
    first: dict[str, int] = {}
    for k, (name, key) in enumerate(zip(names, keys, strict=True)):
        if not name or not _encodable(name):
            yield Fault(key, repr(name), f"{what} ids are non-empty text that UTF-8 can hold")
        elif first.setdefault(name, k) != k:
            yield Fault(
                key,
                repr(name),
                f"{what} {first[name]} has this id already; give each its own",
                depends=(keys[first[name]],),
            )


def _range_message(what: str, many: str, count: int) -> str:
    return f"is no {what}: there are {count} {many}, counted from 0"


def _encodable(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def as_array(
    value: object, dtype: type[np.generic], name: str, faults: list[Fault]
) -> NDArray[np.generic]:
    """`value` as a read-only array of `dtype` that nobody else can write to.

    Values that `dtype` cannot hold exactly (fractions, numbers beyond int32) become a fault and
    an empty array is returned.
    """
    try:
        given = np.asarray(value)
        if given.size == 0:
            given = given.astype(dtype)
        if dtype is np.bool_ and given.dtype != np.bool_:
            raise TypeError("must hold booleans")
        if dtype is np.int32 and given.dtype.kind not in "iu":
            raise TypeError("must hold integers")
        if dtype is np.int32 and given.size and (given.min() < -(2**31) or given.max() >= 2**31):
            raise TypeError("holds numbers beyond 32 bits")
        if dtype is np.float64 and given.dtype.kind not in "iuf":
            raise TypeError("must hold numbers")
        frozen = given.dtype == dtype and not given.flags.writeable and given.base is None
        array = given if frozen else np.array(given, dtype=dtype, order="C")
    except (TypeError, ValueError, OverflowError) as error:
        faults.append(Fault((name,), type(value).__name__, str(error)))
        return np.zeros(0, dtype)
    array.flags.writeable = False
    return array
