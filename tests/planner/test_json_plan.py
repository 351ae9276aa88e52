"""plan.json: round trips, edges that follow from vertices, and every fault of a file at once."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from planner.errors import PlannerError
from planner.json_files import dump_plan, parse_plan, read_plan
from planner.plan import Path, Plan
from tests.planner.examples import grid, plan_of

LINE = grid(4, 1, [(0, 3), (1, 2)])
PLAN = plan_of(
    LINE, "0a 1a 2b 3b", "1a 2a", lower_bound=10.25, lp_value=10.25, seconds=0.8,
    solver={"columns": 900, "seconds master": 0.25},
)  # fmt: skip


def plan_text(**changes: object) -> str:
    """The plan above as text with top-level keys changed; None removes one."""
    keys = {**json.loads(dump_plan(PLAN, LINE)), **changes}
    return json.dumps({key: value for key, value in keys.items() if value is not None})


def plan_faults(text: str) -> tuple[str, ...]:
    """The lines of the error that parsing a plan raises."""
    with pytest.raises(PlannerError) as caught:
        parse_plan(text, LINE, "p.json")
    return caught.value.lines


def test_plan_is_written_as_the_semantics_say():
    """The keys and their meaning are those of 1-semantics, one line per path."""
    text = dump_plan(PLAN, LINE)
    assert json.loads(text) == {
        "format": "mapp-plan/1",
        "status": "feasible",
        "cost": 12,
        "lower_bound": 10.25,
        "gap": 0.170732,
        "handovers": 1,
        "slots": 4,
        "seconds": 0.8,
        "solver": {"columns": 900, "seconds master": 0.25},
        "unserved": [],
        "lp_value": 10.25,
        "paths": [
            {"robot": "r0", "vertices": [0, 1, 2, 3], "aps": [0, 0, 1, 1]},
            {"robot": "r1", "vertices": [1, 2], "aps": [0, 0]},
        ],
    }
    assert text.count('\n  {"robot"') == 2


def test_plan_survives_its_file():
    """Dump, then parse, is the identity, for whole and partial plans."""
    partial = plan_of(LINE, None, "1a 1b 2b", lower_bound=7.5, message="limit reached")
    nothing = plan_of(LINE, None, None, status="infeasible", infeasible_robots=("r0", "r1"))
    for plan in (PLAN, partial, nothing, dataclasses.replace(PLAN, lower_bound=None)):
        for problem in (None, LINE):
            assert parse_plan(dump_plan(plan, problem), LINE) == plan
    assert json.loads(dump_plan(partial))["unserved"] == ["r0"]
    assert json.loads(dump_plan(partial))["gap"] is None


def test_infinite_numbers_are_not_written():
    """JSON knows neither NaN nor infinity: they become null."""
    odd = dataclasses.replace(
        PLAN, lower_bound=-np.inf, lp_value=np.nan, solver={"x": np.inf, "n": np.int64(3)}
    )
    keys = json.loads(dump_plan(odd), parse_constant=pytest.fail)
    assert (keys["lower_bound"], keys["lp_value"]) == (None, None)
    assert keys["solver"] == {"x": None, "n": 3}
    assert parse_plan(dump_plan(odd), LINE).lower_bound is None


def test_plan_says_edges_where_they_do_not_follow():
    """Slow and parallel edges are written; otherwise the key may be left out and is derived."""
    slow = grid(2, 1, [(0, 1)], edge_slots=[2])
    plan = plan_of(slow, "0a>0 0a>0 1a")
    text = dump_plan(plan, slow)
    assert json.loads(text)["paths"][0]["edges"] == [0, 0]
    assert parse_plan(text, slow) == plan

    twice = grid(2, 1, [(0, 1)], edge_uv=[(0, 1), (1, 0)], edge_oneway=[False, False])
    plan = plan_of(twice, "0a 0a>1 1a")
    text = dump_plan(plan, twice)
    assert json.loads(text)["paths"][0]["edges"] == [None, 1]
    assert parse_plan(text, twice) == plan

    lanes = dataclasses.replace(twice, edge_oneway=[True, True])
    plan = plan_of(lanes, "0a>0 1a")
    text = dump_plan(plan, lanes)
    assert "edges" not in json.loads(text)["paths"][0]
    assert parse_plan(text, lanes) == plan


def test_plan_without_needed_edges_is_refused():
    """A reader does not guess which of two edges, or how long on a slow one."""
    paths = [{"robot": "r0", "vertices": [0, 0, 1], "aps": [0, 0, 0]}]
    head = {"format": "mapp-plan/1", "status": "unknown", "cost": 2, "lower_bound": None}
    text = json.dumps({**head, "paths": paths})
    slow = grid(2, 1, [(0, 1)], edge_slots=[2])
    with pytest.raises(PlannerError, match=r"\$\.paths\[0\]\.edges: missing: .* edge 0 takes more"):
        parse_plan(text, slow)
    twice = grid(2, 1, [(0, 1)], edge_uv=[(0, 1), (1, 0)])
    with pytest.raises(PlannerError, match=r"in slot 1 it could be any of the edges \[0, 1\]"):
        parse_plan(text, twice)


def test_plan_with_broken_rules_is_readable():
    """Form is judged by the reader, rules by the checker: a jump and a far vertex are read."""
    paths = [{"robot": "r0", "vertices": [0, 2, 99], "aps": [0, 9, 0]}]
    text = plan_text(paths=paths, unserved=["r1"], slots=2, handovers=2, gap=None, status="unknown")
    plan = parse_plan(text, LINE)
    assert plan.paths == (Path("r0", np.array([0, 2, 99]), np.array([0, 9, 0]), [-1, -1]), None)


@pytest.mark.parametrize(
    ("changes", "beginning"),
    [
        ({"format": "x"}, '$.format: "x": must be "mapp-plan/1"'),
        ({"status": "feasable"}, '$.status: "feasable": must be "optimal", "feasible", "infeasi'),
        ({"cost": 12.5}, "$.cost: 12.5: must be an integer"),
        ({"costs": 12}, '$.costs: 12: unknown key; did you mean "cost"?'),
        ({"paths": None}, "$.paths: missing: this key must be given"),
        ({"handovers": 2}, "$.handovers: 2: its paths have 1; correct one of the two"),
        ({"slots": 5}, "$.slots: 5: its paths have 4; correct one of the two"),
        ({"gap": 0.5}, "$.gap: 0.5: cost and lower bound give 0.1707"),
        ({"unserved": ["r1"]}, '$.unserved: ["r1"]: robots without a path are []'),
        ({"unserved": ["r7"]}, '$.unserved[0]: "r7": must be one of the problem\'s robots'),
        ({"solver": {"columns": "many"}}, '$.solver.columns: "many": must be a finite number'),
        ({"solver": [1]}, "$.solver: [1]: must be an object of numbers"),
        ({"seconds": "long"}, '$.seconds: "long": must be a finite number'),
        ({"paths": [{"robot": "r0"}]}, "$.paths[0].vertices: missing: this key must be given"),
    ],
)
def test_fault_of_a_plan_is_told(changes, beginning):
    """Wrong types, and totals that the paths deny, are told with their place."""
    lines = plan_faults(plan_text(**changes))
    assert any(line.startswith(f"p.json: {beginning}") for line in lines), lines


@pytest.mark.parametrize(
    ("path", "beginning"),
    [
        ({"robot": "r9"}, '$.paths[0].robot: "r9": must be one of the problem\'s robots'),
        ({"robot": "r1"}, '$.paths[1].robot: "r1": has a path already; keep one'),
        ({"vertices": []}, "$.paths[0].vertices: []: a path has at least the state of slot 0"),
        ({"vertices": [0, -1]}, "$.paths[0].vertices[1]: -1: must be at least 0"),
        ({"vertices": [0, 2**31]}, "$.paths[0].vertices[1]: 2147483648: must be at most"),
        ({"aps": [0, 0]}, "$.paths[0].aps: [0, 0]: has 2 entries; must have 4, one per state"),
        ({"edges": [0, 1]}, "$.paths[0].edges: [0, 1]: has 2 entries; must have 3, one per slot"),
        ({"edges": [0, 1, 1.5]}, "$.paths[0].edges[2]: 1.5: must be an integer"),
    ],
)
def test_fault_of_a_path_is_told(path, beginning):
    """A path that cannot be made sense of is told with its place, and nothing that follows."""
    paths = json.loads(dump_plan(PLAN, LINE))["paths"]
    paths[0].update(path)
    lines = plan_faults(plan_text(paths=paths))
    assert [line.startswith(f"p.json: {beginning}") for line in lines] == [True], lines


def test_paths_come_in_the_order_of_robots():
    """1-semantics: paths appear in the robots' order."""
    paths = json.loads(dump_plan(PLAN, LINE))["paths"][::-1]
    assert plan_faults(plan_text(paths=paths)) == (
        'p.json: $.paths[1].robot: "r0": paths appear in the order of the problem\'s robots',
    )


def test_gap_of_another_writer_may_be_rounded():
    """§1.13: four digits of a gap are enough to agree with cost and bound."""
    assert parse_plan(plan_text(gap=0.1707), LINE) == PLAN
    assert "$.gap: 0.1706" in plan_faults(plan_text(gap=0.1706))[0]


def test_plan_is_read_from_a_file(tmp_path):
    """The file's name is in the message."""
    path = tmp_path / "plan.json"
    path.write_text(dump_plan(PLAN), encoding="utf-8")
    assert read_plan(path, LINE) == PLAN
    path.write_text("{", encoding="utf-8")
    with pytest.raises(PlannerError, match=r"^plan\.json:1:2: not JSON"):
        read_plan(path, LINE)


def test_path_takes_integers_only():
    """What is no row of integers is refused with the robot's name."""
    for wrong in (["x"], [[0, 1]], [2**40], None):
        with pytest.raises(PlannerError, match="path of robot r0: vertices: "):
            Path("r0", wrong, [0], [])
    path = Path("r0", [0, 1], [0, 0], [0])
    assert path.vertices.dtype == np.int32
    assert not path.vertices.flags.writeable
    assert path != Path("r1", [0, 1], [0, 0], [0])


def test_plan_compares_by_content():
    """Two plans with the same paths are equal."""
    again = Plan(**{f.name: getattr(PLAN, f.name) for f in dataclasses.fields(PLAN)})
    assert again == PLAN
    assert dataclasses.replace(PLAN, cost=1) != PLAN
