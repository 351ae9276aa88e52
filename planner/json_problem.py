"""problem.json ⇄ `Problem` (1-semantics, "problem.json: the planner's own input")."""

from __future__ import annotations

import json

import numpy as np
from numpy.typing import NDArray

from planner.json_document import INT32_MAX, Document
from planner.problem import Problem, edge_cover_of_ends, objective_costs
from planner.validation import MAX_HORIZON, MAX_PATH_COST, InvalidProblem, Key

FORMAT = "mapp-problem/1"

MAX_ENTRIES = 2**30
"""V · A and E · A² may not exceed this: coverage and handovers are held as whole arrays."""


def parse_problem(text: str, name: str = "problem.json") -> Problem:
    """The problem a problem.json text describes; `name` is what to call it in messages.

    Raises:
        PlannerError: all faults at once, one line `name: $.vertices[3].aps[1]: value: message`
            each, or the line and column where the text stops being JSON.
    """
    document = Document(text, name)
    required = ("format", "horizon", "ap_capacity", "objective", "at_goal")
    lists = ("aps", "vertices", "edges", "robots")
    top = document.mapping(document.root, (), (*required, *lists), ("name",))
    if "format" in top:
        document.choice(top["format"], ("format",), (FORMAT,))
    horizon = document.integer(top.get("horizon", 1), ("horizon",), 1, MAX_HORIZON) or 1
    objective, c_t, c_h = _objective(document, top.get("objective", "hp"), horizon)
    aps = document.array(top.get("aps", []), ("aps",), "AP names")
    ap_ids = tuple(_id(document, ap, ("aps", k), k) for k, ap in enumerate(aps))
    vertices = _Vertices(document, top.get("vertices", []), len(ap_ids))
    edges = _Edges(document, top.get("edges", []), vertices.cover)
    robots = document.array(top.get("robots", []), ("robots",), "robots")
    robot_ids, start, goal = _robots(document, robots)
    try:
        problem = Problem(
            name=document.string(top.get("name", ""), ("name",)) or "",
            horizon=horizon,
            objective=objective,
            c_t=c_t,
            c_h=c_h,
            at_goal=document.choice(top.get("at_goal", "leave"), ("at_goal",), ("leave", "park"))
            or "leave",
            ap_ids=ap_ids,
            ap_capacity=_capacity(document, top.get("ap_capacity", 1), len(ap_ids)),
            xy_m=vertices.xy_m,
            cover=vertices.cover,
            snr_db=vertices.snr_db,
            edge_uv=edges.uv,
            edge_slots=edges.slots,
            edge_oneway=edges.oneway,
            edge_cover=edges.cover,
            edge_handover=edges.handover,
            robot_ids=robot_ids,
            start=start,
            goal=goal,
        )
    except InvalidProblem as error:
        document.add(error.faults)
    document.finish()
    return problem


def _objective(document: Document, value: object, horizon: int) -> tuple[str, int, int]:
    if isinstance(value, dict):
        costs = document.mapping(value, ("objective",), ("c_t", "c_h"))
        c_t, c_h = (
            document.integer(costs.get(name, 0), ("objective", name), 0, MAX_PATH_COST) or 0
            for name in ("c_t", "c_h")
        )
        return "costs", c_t, c_h
    if isinstance(value, str):
        chosen = document.choice(value, ("objective",), ("hp", "tp", "snr")) or "hp"
        return chosen, *objective_costs(chosen, horizon)
    document.fault(("objective",), value, 'must be "hp", "tp", "snr" or {"c_t": …, "c_h": …}')
    return "hp", *objective_costs("hp", horizon)


def _capacity(document: Document, value: object, n_aps: int) -> NDArray[np.int32]:
    key: Key = ("ap_capacity",)
    if not isinstance(value, list):
        return np.full(n_aps, document.integer(value, key) or 0, np.int32)
    if len(value) != n_aps and not document.is_faulty(("aps",)):
        document.fault(key, value, f"must be one integer, or a list of {n_aps}, one per AP")
    capacity = [document.integer(m, (*key, k)) or 0 for k, m in enumerate(value)]
    return np.resize(np.array([*capacity, 0], np.int32), n_aps)


class _Vertices:
    """The vertices as arrays; unusable values are reported and stand as 0 or "not covered"."""

    def __init__(self, document: Document, value: object, n_aps: int) -> None:
        rows = document.array(value, ("vertices",), "vertices")
        if len(rows) * n_aps > MAX_ENTRIES:
            _too_many(document, ("vertices",), f"{len(rows)} vertices × {n_aps} APs")
            rows = []
        self.xy_m = np.zeros((len(rows), 2))
        self.cover = np.zeros((len(rows), n_aps), np.bool_)
        self.snr_db = np.full((len(rows), n_aps), np.nan)
        for k, row in enumerate(rows):
            key: Key = ("vertices", k)
            vertex = document.mapping(row, key, ("x", "y", "aps"), ("snr_db",))
            for axis, name in enumerate("xy"):
                if name in vertex:
                    self.xy_m[k, axis] = document.number(vertex[name], (*key, name)) or 0.0
            aps = _aps(document, vertex.get("aps", []), (*key, "aps"), n_aps)
            self.cover[k, [ap for ap in aps if ap is not None]] = True
            if "snr_db" in vertex:
                self._snr(document, vertex["snr_db"], (*key, "snr_db"), k, aps)

    def _snr(
        self, document: Document, value: object, key: Key, k: int, aps: list[int | None]
    ) -> None:
        snrs = document.array(value, key, "numbers [dB]")
        if isinstance(value, list) and len(snrs) != len(aps):
            document.fault(key, value, f'must have as many entries as "aps" beside it ({len(aps)})')
            return
        for position, (ap, snr) in enumerate(zip(aps, snrs, strict=False)):
            if snr is not None:  # null: not known
                number = document.number(snr, (*key, position))
                if ap is not None and number is not None:
                    self.snr_db[k, ap] = number


class _Edges:
    """The edges as arrays; unusable values are reported and stand as a default."""

    def __init__(self, document: Document, value: object, vertex_cover: NDArray[np.bool_]) -> None:
        rows = document.array(value, ("edges",), "edges")
        n_vertices, n_aps = vertex_cover.shape
        if len(rows) * n_aps**2 > MAX_ENTRIES:
            _too_many(document, ("edges",), f"{len(rows)} edges × {n_aps}² APs")
            rows = []
        objects = [
            document.mapping(row, ("edges", e), ("u", "v"), ("aps", "slots", "handovers", "oneway"))
            for e, row in enumerate(rows)
        ]
        self.uv = np.zeros((len(rows), 2), np.int32)
        self.slots = np.ones(len(rows), np.int32)
        self.oneway = np.zeros(len(rows), np.bool_)
        for e, edge in enumerate(objects):
            self.uv[e] = [_vertex_index(document, edge, ("edges", e), name, 0) for name in "uv"]
            if "slots" in edge:
                key = ("edges", e, "slots")
                self.slots[e] = document.integer(edge["slots"], key, 1, MAX_HORIZON) or 1
            if "oneway" in edge:
                self.oneway[e] = bool(document.boolean(edge["oneway"], ("edges", e, "oneway")))
        self.cover = np.zeros((len(rows), n_aps), np.bool_)
        self.handover = np.zeros((len(rows), n_aps, n_aps), np.bool_)
        inside = np.all((self.uv >= 0) & (self.uv < n_vertices), axis=1)
        self.cover[inside], self.handover[inside] = edge_cover_of_ends(
            vertex_cover, self.uv[inside]
        )
        for e, edge in enumerate(objects):
            if "aps" in edge:
                aps = _aps(document, edge["aps"], ("edges", e, "aps"), n_aps)
                self.cover[e] = False
                self.cover[e, [ap for ap in aps if ap is not None]] = True
            if "handovers" in edge:
                self.handover[e] = False
                for a, b in _pairs(document, edge["handovers"], ("edges", e, "handovers"), n_aps):
                    self.handover[e, a, b] = True


def _id(document: Document, value: object, key: Key, index: int) -> str:
    """An id as given, or one that clashes with no other where it is unusable."""
    text = document.string(value, key)
    return f"\0{index}" if text is None else text


def _vertex_index(
    document: Document, row: dict[str, object], key: Key, name: str, index: int
) -> int:
    """A vertex as given, whether it exists or not; where it is unusable, one that does not."""
    low = -INT32_MAX
    vertex = document.integer(row[name], (*key, name), low) if name in row else None
    return -1 - index if vertex is None else vertex


def _too_many(document: Document, key: Key, what: str) -> None:
    document.fault(key, what, f"must be at most {MAX_ENTRIES} entries; split the problem")


def _aps(document: Document, value: object, key: Key, n_aps: int) -> list[int | None]:
    """AP indices as listed, None where one is unusable."""
    aps = [
        document.index(ap, (*key, position), "AP", n_aps, ("aps",))
        for position, ap in enumerate(document.array(value, key, "AP indices"))
    ]
    for position, ap in enumerate(aps):
        if ap is not None and ap in aps[:position]:
            document.fault((*key, position), ap, "this AP is listed twice; keep one")
            aps[position] = None
    return aps


def _pairs(document: Document, value: object, key: Key, n_aps: int) -> list[tuple[int, int]]:
    pairs = []
    for position, row in enumerate(document.array(value, key, "pairs [AP at u, AP at v]")):
        if not isinstance(row, list) or len(row) != 2:
            document.fault((*key, position), row, "must be a pair [AP at u, AP at v]")
            continue
        a, b = (
            document.index(ap, (*key, position, n), "AP", n_aps, ("aps",))
            for n, ap in enumerate(row)
        )
        if a is not None and b is not None:
            pairs.append((a, b))
    return pairs


def _robots(
    document: Document, rows: list[object]
) -> tuple[tuple[str, ...], NDArray[np.int32], NDArray[np.int32]]:
    """Ids, starts and goals."""
    ids, start, goal = [], [], []
    for i, row in enumerate(rows):
        key: Key = ("robots", i)
        robot = document.mapping(row, key, ("id", "start", "goal"))
        ids.append(_id(document, robot.get("id", f"\0{i}"), (*key, "id"), i))
        start.append(_vertex_index(document, robot, key, "start", i))
        goal.append(_vertex_index(document, robot, key, "goal", i))
    return tuple(ids), np.array(start, np.int32), np.array(goal, np.int32)


def dump_problem(problem: Problem) -> str:
    """The problem.json text of a problem: deterministic, one line per vertex, edge and robot.

    `parse_problem(dump_problem(p)) == p`. Keys that may be left out are, where they would repeat
    the default.
    """
    objective: object = problem.objective
    if objective == "costs":
        objective = {"c_t": problem.c_t, "c_h": problem.c_h}
    capacity = problem.ap_capacity.tolist()
    head = {
        "format": FORMAT,
        **({"name": problem.name} if problem.name else {}),
        "horizon": problem.horizon,
        "ap_capacity": capacity[0] if len(set(capacity)) == 1 else capacity,
        "objective": objective,
        "at_goal": problem.at_goal,
        "aps": list(problem.ap_ids),
    }
    cover, handover = edge_cover_of_ends(problem.cover, problem.edge_uv)
    vertices = [_vertex(problem, v) for v in range(problem.n_vertices)]
    as_ends = (problem.edge_cover == cover).all(axis=1)
    all_pairs = (problem.edge_handover == handover).all(axis=(1, 2))
    edges = [
        _edge(problem, e, whole=whole, free=free)
        for e, (whole, free) in enumerate(zip(as_ends.tolist(), all_pairs.tolist(), strict=True))
    ]
    robots = [
        {"id": name, "start": start, "goal": goal}
        for name, start, goal in zip(
            problem.robot_ids, problem.start.tolist(), problem.goal.tolist(), strict=True
        )
    ]
    lines = [f"{_json(key)}: {_json(value)}" for key, value in head.items()]
    for key, rows in (("vertices", vertices), ("edges", edges), ("robots", robots)):
        lines.append(f"{_json(key)}: [" + ",".join(f"\n  {_json(row)}" for row in rows) + "]")
    return "{" + ",\n ".join(lines) + "}\n"


def _vertex(problem: Problem, v: int) -> dict[str, object]:
    aps = np.flatnonzero(problem.cover[v])
    snr = problem.snr_db[v, aps]
    x, y = problem.xy_m[v].tolist()
    vertex: dict[str, object] = {"x": x, "y": y, "aps": aps.tolist()}
    if not np.isnan(snr).all():
        vertex["snr_db"] = [None if np.isnan(s) else s for s in snr.tolist()]
    return vertex


def _edge(problem: Problem, e: int, *, whole: bool, free: bool) -> dict[str, object]:
    """An edge; `whole`: the APs of both ends cover it, `free`: all handovers are allowed."""
    u, v = problem.edge_uv[e].tolist()
    edge: dict[str, object] = {"u": u, "v": v}
    if not whole:
        edge["aps"] = np.flatnonzero(problem.edge_cover[e]).tolist()
    if problem.edge_slots[e] != 1:
        edge["slots"] = int(problem.edge_slots[e])
    if not free:
        edge["handovers"] = np.argwhere(problem.edge_handover[e]).tolist()
    if problem.edge_oneway[e]:
        edge["oneway"] = True
    return edge


_ENCODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False)


def _json(value: object) -> str:
    return _ENCODER.encode(value)
