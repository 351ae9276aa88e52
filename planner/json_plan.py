"""plan.json ⇄ `Plan` (1-semantics, "plan.json: the planner's own output")."""

from __future__ import annotations

import json
import math
from itertools import pairwise

import numpy as np

from planner.json_document import Document
from planner.json_prices import parse_prices, prices_values
from planner.plan import STATUSES, Path, Plan
from planner.problem import Problem
from planner.validation import Fault, Key

FORMAT = "mapp-plan/1"


def parse_plan(text: str, problem: Problem, name: str = "plan.json") -> Plan:
    """The plan a plan.json text holds for `problem`; `name` is what to call it in messages.

    Only the file's form is judged here; `planner.check` judges the plan.

    Raises:
        PlannerError: all faults at once, one line `name: $.paths[3].aps[1]: value: message`
            each, or the line and column where the text stops being JSON.
    """
    document = Document(text, name)
    top = document.mapping(
        document.root,
        (),
        ("format", "status", "cost", "lower_bound", "paths"),
        (
            *("gap", "handovers", "slots", "seconds", "solver", "unserved"),
            *("lp_value", "message", "infeasible_robots", "prices"),
        ),
    )
    if "format" in top:
        document.choice(top["format"], ("format",), (FORMAT,))
    status = document.choice(top.get("status", "unknown"), ("status",), STATUSES) or "unknown"
    solver = top.get("solver", {})
    if not isinstance(solver, dict):
        document.fault(("solver",), solver, "must be an object of numbers")
        solver = {}
    counters: dict[str, float] = {}
    for key, value in solver.items():
        number = math.nan if value is None else document.number(value, ("solver", key))
        if number is not None:
            counters[key] = value if isinstance(value, int) else number
    plan = Plan(
        status=status,
        robot_ids=problem.robot_ids,
        paths=_paths(document, top.get("paths", []), problem),
        cost=document.integer(top.get("cost", 0), ("cost",), -(2**53), 2**53) or 0,
        lower_bound=_number_or_none(document, top, "lower_bound"),
        infeasible_robots=_robots(document, top, "infeasible_robots", problem),
        message=document.string(top.get("message", ""), ("message",)) or "",
        lp_value=_number_or_none(document, top, "lp_value"),
        seconds=document.number(top.get("seconds", 0.0), ("seconds",)) or 0.0,
        solver=counters,
        prices=parse_prices(document, top["prices"], problem) if "prices" in top else None,
    )
    document.add(_contradictions(document, top, plan, problem))
    document.finish()
    return plan


def _number_or_none(document: Document, top: dict[str, object], name: str) -> float | None:
    value = top.get(name)
    return None if value is None else document.number(value, (name,))


def _robots(
    document: Document, top: dict[str, object], name: str, problem: Problem
) -> tuple[str, ...]:
    """The list of robot ids under `name`."""
    ids = document.array(top.get(name, []), (name,), "robot ids")
    return tuple(
        str(robot)
        for k, robot in enumerate(ids)
        if document.choice(robot, (name, k), problem.robot_ids, "the problem's robots")
    )


def _contradictions(
    document: Document, top: dict[str, object], plan: Plan, problem: Problem
) -> list[Fault]:
    """Totals that the file gives and its own paths deny."""
    faults = []
    depends: tuple[Key, ...] = (("paths",),)
    for name, actual in (("handovers", plan.handovers), ("slots", plan.slots)):
        if name in top:
            given = document.integer(top[name], (name,), 0, 2**53)
            if given is not None and given != actual:
                text = f"its paths have {actual}; correct one of the two"
                faults.append(Fault((name,), str(given), text, depends=depends))
    if "unserved" in top:
        given_ids = _robots(document, top, "unserved", problem)
        if given_ids != plan.unserved:
            text = f"robots without a path are {json.dumps(plan.unserved, ensure_ascii=False)}"
            text += ", in this order; correct the list or the paths"
            faults.append(Fault(("unserved",), json.dumps(given_ids), text, depends=depends))
    if "gap" in top:
        given_gap = _number_or_none(document, top, "gap")
        gap = plan.gap
        # A writer may round to four digits.
        same = (
            given_gap is None
            if gap is None
            else math.isclose(math.inf if given_gap is None else given_gap, gap, abs_tol=0.50001e-4)
        )
        if not same:
            text = f"cost and lower bound give {json.dumps(gap)} (§1.13); correct one of them"
            depends = (*depends, ("cost",), ("lower_bound",), ("status",), ("unserved",))
            faults.append(Fault(("gap",), json.dumps(given_gap), text, depends=depends))
    return faults


def _paths(document: Document, value: object, problem: Problem) -> tuple[Path | None, ...]:
    """One entry per robot of the problem, None for robots without a path."""
    index = {robot: i for i, robot in enumerate(problem.robot_ids)}
    joining = EdgeBetween(problem)
    paths: list[Path | None] = [None] * problem.n_robots
    last = -1
    for k, row in enumerate(document.array(value, ("paths",), "paths")):
        key: Key = ("paths", k)
        given = document.mapping(row, key, ("robot", "vertices", "aps"), ("edges",))
        robot = None
        if "robot" in given:
            robot = document.choice(
                given["robot"], (*key, "robot"), problem.robot_ids, "the problem's robots"
            )
        path = _path(document, given, key, joining)
        if robot is None or path is None:
            continue
        i = index[robot]
        if paths[i] is not None:
            document.fault((*key, "robot"), robot, "has a path already; keep one")
            continue
        if i < last:
            document.fault(
                (*key, "robot"), robot, "paths appear in the order of the problem's robots"
            )
        last = max(last, i)
        vertices, aps, edges = (np.array(column, np.int32) for column in path)
        paths[i] = Path(robot, vertices, aps, edges)
    return tuple(paths)


def _path(
    document: Document, given: dict[str, object], key: Key, joining: EdgeBetween
) -> tuple[list[int], list[int], list[int]] | None:
    """Vertices, APs and edges, slot by slot; None where they are unusable."""
    before = len(document.faults)
    columns: dict[str, list[int]] = {}
    for name in ("vertices", "aps", "edges"):
        if name in given:
            columns[name] = [
                -1
                if entry is None and name == "edges"
                else document.integer(entry, (*key, name, t)) or 0
                for t, entry in enumerate(document.array(given[name], (*key, name), "indices"))
            ]
    if "vertices" not in columns or len(document.faults) > before:
        return None
    vertices, states = columns["vertices"], len(columns["vertices"])
    if not states:
        document.fault((*key, "vertices"), [], "a path has at least the state of slot 0")
        return None
    if "edges" not in columns:
        columns["edges"] = joining.derive(document, vertices, (*key, "edges"))
    for name, wanted in (("aps", states), ("edges", states - 1)):
        found = len(columns.get(name, []))
        if name in columns and found != wanted:
            why = "one per state" if name == "aps" else "one per slot until arrival"
            document.fault(
                (*key, name), columns[name], f"has {found} entries; must have {wanted}, {why}"
            )
    if "aps" not in columns or len(document.faults) > before:
        return None
    return vertices, columns["aps"], columns["edges"]


class EdgeBetween:
    """The edges by which one may cross from one vertex to another."""

    def __init__(self, problem: Problem) -> None:
        self.slow = np.flatnonzero(problem.edge_slots > 1).tolist()
        self.by_ends: dict[tuple[int, int], list[int]] = {}
        for e, (u, v) in enumerate(problem.edge_uv.tolist()):
            self.by_ends.setdefault((u, v), []).append(e)
            if not problem.edge_oneway[e]:
                self.by_ends.setdefault((v, u), []).append(e)

    def derive(self, document: Document, vertices: list[int], key: Key) -> list[int]:
        """The edges a path without `edges` crosses; -1 for a wait, and where no edge joins."""
        if self.slow and len(vertices) > 1:
            text = f"must be given, because edge {self.slow[0]} takes more than one slot"
            document.add([Fault(key, "missing", text)])
            return [-1] * (len(vertices) - 1)
        edges = []
        for t, (u, v) in enumerate(pairwise(vertices)):
            joining = [] if u == v else self.by_ends.get((u, v), [])
            if len(joining) > 1:
                text = f"must be given: in slot {t} it could be any of the edges {joining}"
                document.add([Fault(key, "missing", text)])
            edges.append(joining[0] if joining else -1)
        return edges

    def says(self, path: Path) -> bool:
        """The path's edges need not be written, because they follow from its vertices."""
        if self.slow:
            return False
        pairs = pairwise(path.vertices.tolist())
        options = [[-1] if u == v else self.by_ends.get((u, v), [-1]) for u, v in pairs]
        return [[e] for e in path.edges.tolist()] == options


def dump_plan(plan: Plan, problem: Problem | None = None) -> str:
    """The plan.json text of a plan: deterministic, one line per path.

    `parse_plan(dump_plan(p), problem) == p`. Without `problem` every path says its edges; with it
    they are left out where they follow from the vertices.
    """
    joining = None if problem is None else EdgeBetween(problem)
    gap = plan.gap
    head: dict[str, object] = {
        "format": FORMAT,
        "status": plan.status,
        "cost": int(plan.cost),
        "lower_bound": _finite(plan.lower_bound),
        "gap": None if gap is None else _finite(round(gap, 6)),
        "handovers": plan.handovers,
        "slots": plan.slots,
        "seconds": _finite(plan.seconds) or 0.0,
        "solver": {key: _finite(value) for key, value in plan.solver.items()},
        "unserved": list(plan.unserved),
    }
    if plan.lp_value is not None:
        head["lp_value"] = _finite(plan.lp_value)
    if plan.infeasible_robots:
        head["infeasible_robots"] = list(plan.infeasible_robots)
    if plan.message:
        head["message"] = plan.message
    rows = []
    for path in plan.paths:
        if path is None:
            continue
        row: dict[str, object] = {
            "robot": path.robot,
            "vertices": path.vertices.tolist(),
            "aps": path.aps.tolist(),
        }
        if joining is None or not joining.says(path):
            row["edges"] = [None if e < 0 else e for e in path.edges.tolist()]
        rows.append(row)
    lines = [f"{_json(key)}: {_json(value)}" for key, value in head.items()]
    if plan.prices is not None:
        lines.append(f'"prices": {_json(prices_values(plan.prices))}')
    lines.append('"paths": [' + ",".join(f"\n  {_json(row)}" for row in rows) + "]")
    return "{" + ",\n ".join(lines) + "}\n"


def _finite(value: float | None) -> float | None:
    """The number as JSON can say it: None for NaN and infinities, integers as integers."""
    if value is None or not math.isfinite(value):
        return None
    return int(value) if isinstance(value, (int, np.integer)) else float(value)


def _json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)
