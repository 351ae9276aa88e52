"""The checker finds every broken rule, and nothing in a good plan."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.check import Violation, check_plan
from planner.plan import Path, Plan
from planner.problem import Problem
from tests.oracles.tiny_problems import tiny_problems
from tests.planner.examples import grid, path_of, plan_of

LINE = [(0, 3)]


def rules(problem: Problem, plan: Plan) -> set[str]:
    """The rules the checker says are broken."""
    return {violation.rule for violation in check_plan(problem, plan)}


def only(problem: Problem, plan: Plan) -> Violation:
    """The one violation there must be."""
    found = check_plan(problem, plan)
    assert len(found) == 1, [str(violation) for violation in found]
    return found[0]


GOOD = {
    "moves, waits and a handover": (grid(4, 1, LINE), ["0a 1a 1a 2b 3b"]),
    "following": (grid(4, 1, [(0, 2), (1, 3)]), ["0a 1a 2a", "1a 2a 3a"]),
    "rotation of four": (
        grid(2, 2, [(0, 1), (1, 3), (3, 2), (2, 0)]),
        ["0a 1a", "1a 3a", "3a 2a", "2a 0a"],
    ),
    "a goal taken over after leaving": (grid(3, 1, [(1, 2), (0, 2)]), ["1a 2a", "0a 1a 2a"]),
    "through its own goal": (grid(3, 1, [(0, 1)]), ["0a 1a 2a 1a"]),
    "at its goal already": (grid(2, 1, [(0, 0)], at_goal="park"), ["0a"]),
    "an edge of three slots": (
        grid(2, 1, [(0, 1)], edge_slots=[3]),
        ["0a>0 0a>0 0a>0 1b"],
    ),
    "followed onto the vertex a slow edge was entered from": (
        grid(3, 1, [(1, 2), (0, 1)], edge_slots=[1, 3]),
        ["1a>1 1a>1 1a>1 2a", "0a 1a"],
    ),
    "two lanes": (
        grid(2, 1, [(0, 1), (1, 0)], edge_uv=[(0, 1), (1, 0)], edge_oneway=[True, True]),
        ["0a>0 1a", "1a>1 0a"],
    ),
    "against an edge with a handover pair as written from u to v": (
        grid(2, 1, [(1, 0)], edge_handover=[[[False, True], [False, False]]]),
        ["1b 0a"],
    ),
    "a place of the AP for each": (
        grid(4, 1, [(0, 1), (2, 3)], n_aps=2, ap_capacity=[1, 1]),
        ["0a 1a", "2b 3b"],
    ),
}


@pytest.mark.parametrize("name", GOOD)
def test_good_plan_has_no_violation(name):
    """What §1.1 to §1.7 allow is not complained about."""
    problem, states = GOOD[name]
    assert check_plan(problem, plan_of(problem, *states)) == []


PLANTED = {
    "starts elsewhere": (grid(4, 1, LINE), ["1a 2a 3a"], "§1.1", 0),
    "jumps": (grid(4, 1, LINE), ["0a 1a 3a"], "§1.1", 1),
    "moves without an edge": (grid(4, 1, LINE), ["0a>-1 1a 2a 3a"], "§1.1", 0),
    "crosses an edge of other vertices": (grid(4, 1, LINE), ["0a>2 1a 2a 3a"], "§1.1", 0),
    "crosses an edge and stays": (grid(4, 1, LINE), ["0a 1a>1 1a 2a 3a"], "§1.1", 1),
    "against a one-way edge": (
        grid(2, 1, [(1, 0)], edge_oneway=[True]),
        ["1a>0 0a"],
        "§1.1",
        0,
    ),
    "off a slow edge too early": (
        grid(3, 1, [(0, 2)], edge_slots=[3, 1]),
        ["0a>0 0a>0 1a 2a"],
        "§1.1",
        0,
    ),
    "arrives before its slow edge ends": (
        grid(2, 1, [(0, 1)], edge_slots=[3]),
        ["0a>0 1a"],
        "§1.1",
        0,
    ),
    "two robots at a vertex": (
        grid(3, 1, [(0, 1), (2, 1)]),
        ["0a 1a", "2a 1a"],
        "§1.2",
        1,
    ),
    "a swap": (grid(2, 1, [(0, 1), (1, 0)]), ["0a 1a", "1a 0a"], "§1.3", 0),
    "a second robot on a slow edge": (
        grid(3, 2, [(1, 2), (4, 2)], edge_slots=[1, 3, 1, 1, 1, 1, 1]),
        ["1a>1 1a>1 1a>1 2a", "4a 1a>1 1a>1 1a>1 2a"],
        "§1.3",
        1,
    ),
    "ends elsewhere": (grid(4, 1, LINE), ["0a 1a 2a"], "§1.4", 2),
    "arrives after the horizon": (grid(4, 1, LINE, horizon=2), ["0a 1a 2a 3a"], "§1.4", 3),
    "drives through a parked robot": (
        grid(3, 1, [(1, 1), (0, 2)], at_goal="park"),
        ["1a", "0a 1a 2a"],
        "§1.2",
        1,
    ),
    "a parked robot keeps its AP's place": (
        grid(3, 1, [(0, 0), (1, 2)], at_goal="park", ap_capacity=[1, 1]),
        ["0a", "1b 2a"],
        "§1.6",
        1,
    ),
    "leaves the goal it starts at": (grid(2, 1, [(0, 0)]), ["0a 1a 0a"], "§1.5", None),
    "an AP that does not cover the vertex": (
        grid(4, 1, LINE, cover=[[0], [0], [0, 1], [0]]),
        ["0a 0b 0a 1a 2a 3a"],
        "§1.6",
        1,
    ),
    "an AP that does not cover the start": (
        grid(2, 1, [(0, 1)], cover=[[0], [0, 1]], edge_handover=[[[False] * 2, [False] * 2]]),
        ["0b 0a 1a"],
        "§1.6",
        0,
    ),
    "an AP over its capacity in slot 0": (
        grid(4, 1, [(0, 0), (3, 3)], ap_capacity=[1, 1]),
        ["0a", "3a"],
        "§1.6",
        0,
    ),
    "an AP loaded by a robot amid a slow edge": (
        grid(4, 1, [(0, 1), (2, 3)], edge_slots=[3, 1, 1], ap_capacity=[1, 1]),
        ["0a>0 0a>0 0a>0 1b", "2b 3a"],
        "§1.6",
        1,
    ),
    "a handover amid a slow edge": (
        grid(2, 1, [(0, 1)], edge_slots=[3]),
        ["0a>0 0b>0 0b>0 1b"],
        "§1.6",
        1,
    ),
    "an edge its AP does not cover": (
        grid(2, 1, [(0, 1)], edge_cover=[[False, True]]),
        ["0a 1a"],
        "§1.7",
        0,
    ),
    "a handover the edge does not allow": (
        grid(2, 1, [(0, 1)], edge_handover=[[[False, False], [True, False]]]),
        ["0a 1b"],
        "§1.7",
        0,
    ),
    "a handover allowed the other way only": (
        grid(2, 1, [(1, 0)], edge_handover=[[[False, True], [False, False]]]),
        ["1a 0b"],
        "§1.7",
        0,
    ),
}


@pytest.mark.parametrize("name", PLANTED)
def test_planted_violation_is_found(name):
    """Each of §1.1 to §1.7, once broken, is named with its slot."""
    problem, states, rule, slot = PLANTED[name]
    found = check_plan(problem, plan_of(problem, *states))
    assert (rule, slot) in {(violation.rule, violation.slot) for violation in found}
    assert {violation.rule for violation in found} == {rule}


def test_violation_names_all_robots_concerned():
    """§1.2: three robots at one vertex are one violation with three names, in their order."""
    problem = grid(3, 2, [(0, 1), (2, 1), (4, 1)])
    violation = only(problem, plan_of(problem, "0a 1a", "2a 1a", "4a 1a"))
    assert violation.robots == ("r0", "r1", "r2")
    assert str(violation) == "§1.2, slot 1, robots r0, r1, r2: 3 robots stand at vertex 1"


def test_slow_edge_is_on_no_vertex():
    """§1.1: amid an edge a robot stands nowhere, so another may stand where it came from."""
    problem = grid(3, 1, [(1, 2), (0, 1)], edge_slots=[1, 2])
    assert check_plan(problem, plan_of(problem, "1a>1 1a>1 2a", "0a 1a")) == []


SIMPLE = grid(4, 1, [(0, 3), (1, 2)])
STATES = ("0a 1a 2a 3a", "1a 2a")


def simple(**changes: object) -> Plan:
    """A good plan of cost 4 with a bound of 4, changed in one way."""
    return plan_of(SIMPLE, *STATES, **{"lower_bound": 4.0, **changes})


ANSWERS = {
    "cost": (simple(cost=5), "§1.9"),
    "no bound": (simple(lower_bound=None), "§1.12"),
    "no such status": (simple(status="done"), "§1.12"),
    "optimal without bound": (simple(status="optimal", lower_bound=None), "§1.12"),
    "optimal beside a lower bound": (simple(status="optimal", lower_bound=2.9), "§1.13"),
    "bound above cost": (simple(lower_bound=4.5), "§1.13"),
    "bound not a number": (simple(lower_bound=float("nan")), "§1.13"),
    "master LP not a number": (simple(lp_value=float("inf")), "§1.14"),
    "master LP above cost": (simple(lp_value=4.5), "§1.14"),
    "unknown with a plan": (simple(status="unknown"), "§1.12"),
    "infeasible with a plan": (simple(status="infeasible", infeasible_robots=("r0",)), "§1.12"),
    "infeasible without a name": (
        plan_of(SIMPLE, None, STATES[1], status="infeasible"),
        "§1.12",
    ),
    "names infeasible robots": (simple(infeasible_robots=("r0",)), "§1.12"),
    "names strangers": (
        plan_of(SIMPLE, None, STATES[1], status="infeasible", infeasible_robots=("r7",)),
        "§1.12",
    ),
    "feasible with a robot unserved": (
        plan_of(SIMPLE, STATES[0], None, status="feasible"),
        "§1.12",
    ),
}


@pytest.mark.parametrize("name", ANSWERS)
def test_answer_that_contradicts_itself_is_found(name):
    """§1.9, §1.12, §1.13: cost, status and bounds must agree with the paths and each other."""
    plan, rule = ANSWERS[name]
    assert only(SIMPLE, plan).rule == rule


@pytest.mark.parametrize(
    "plan",
    [
        simple(),
        simple(status="optimal"),
        simple(status="optimal", lower_bound=3.1),
        simple(status="optimal", lower_bound=4.0000001, lp_value=4.0000001),
        plan_of(SIMPLE, STATES[0], None),
        plan_of(SIMPLE, STATES[0], None, lower_bound=None),
        plan_of(SIMPLE, None, None, status="infeasible", infeasible_robots=("r0", "r1")),
        plan_of(
            SIMPLE, None, None, status="infeasible", infeasible_robots=("r0",), lower_bound=9.0
        ),
    ],
)
def test_answer_that_agrees_with_itself_passes(plan):
    """§1.12, §1.13: what each status needs is enough; integer costs let a bound be rounded up."""
    assert check_plan(SIMPLE, plan) == []


def test_unserved_robots_are_named():
    """§1.12: a plan called optimal that leaves a robot out names it."""
    violation = only(SIMPLE, plan_of(SIMPLE, STATES[0], None, status="optimal", lower_bound=3.0))
    assert violation.robots == ("r1",)


def test_snr_plans_count_no_cost_for_handovers():
    """§1.10: under snr every vertex has one AP, handovers cost nothing, and are still checked."""
    problem = grid(
        3,
        1,
        [(0, 2)],
        objective="snr",
        c_t=1,
        c_h=0,
        snr_db=np.array([[20.0, 10.0], [10.0, 20.0], [15.0, 15.0]]),
    )
    assert check_plan(problem, plan_of(problem, "0a 1b 2a", cost=2)) == []
    assert rules(problem, plan_of(problem, "0a 1a 2a", cost=2)) == {"§1.6", "§1.7"}


MALFORMED = {
    "empty path": (([], [], []), {"§1.1"}),
    "vertex out of range": (([0, 9], [0, 0], [0]), {"§1.1"}),
    "negative vertex": (([-1, 1], [0, 0], [0]), {"§1.1"}),
    "AP out of range": (([0, 1], [0, 7], [0]), {"§1.6"}),
    "edge out of range": (([0, 1], [0, 0], [99]), {"§1.1"}),
    "edge below -1": (([0, 1], [0, 0], [-2]), {"§1.1"}),
    "too few APs": (([0, 1], [0], [0]), {"§1.6"}),
    "too many edges": (([0, 1], [0, 0], [0, 1, 2]), {"§1.1"}),
    "no edges": (([0, 1, 2, 3], [0, 0, 0, 0], []), {"§1.1"}),
}


@pytest.mark.parametrize("name", MALFORMED)
def test_malformed_path_is_a_violation_not_an_exception(name):
    """Indices that do not exist and lists of wrong length are said with the rule they break."""
    columns, wanted = MALFORMED[name]
    path = Path("r0", *(np.array(column, np.int32) for column in columns))
    good = path_of(SIMPLE, 1, STATES[1])
    plan = Plan("unknown", SIMPLE.robot_ids, (path, good), 0, None)
    assert rules(SIMPLE, plan) - {"§1.9"} == wanted


FIRST, SECOND = (path_of(SIMPLE, i, STATES[i]) for i in range(2))
STRANGER = dataclasses.replace(FIRST, robot="r9")
MISFITS = {
    "paths in another order": (("r0", "r1"), (SECOND, FIRST), "its path is listed as 1"),
    "a robot twice": (("r0", "r1"), (FIRST, FIRST), "has two paths"),
    "a stranger": (("r0", "r1"), (FIRST, STRANGER), "the problem has no such robot"),
    "too few robots": (("r0",), (FIRST, SECOND), "is a plan for ['r0'], not for"),
    "robots in another order": (("r1", "r0"), (FIRST, SECOND), "is a plan for ['r1', 'r0']"),
    "too few paths": (("r0", "r1"), (FIRST,), "has 1 entries for 2 robots"),
    "too many paths": (("r0", "r1"), (FIRST, SECOND, None), "has 3 entries for 2 robots"),
}


@pytest.mark.parametrize("name", MISFITS)
def test_plan_for_other_robots_is_found(name):
    """§1.12: one path per robot, under its name and in the robots' order."""
    ids, paths, message = MISFITS[name]
    found = check_plan(SIMPLE, Plan("unknown", ids, paths, 4, 4.0))
    assert any(v.rule == "§1.12" and message in v.message for v in found), found


@settings(deadline=None, max_examples=80)
@given(st.data())
def test_no_plan_makes_the_checker_fail(data):
    """Whatever a plan holds, the checker answers with violations."""
    problem = data.draw(tiny_problems())
    numbers = st.lists(st.integers(-3, 12), max_size=6)
    paths = data.draw(
        st.lists(
            st.none() | st.builds(Path, st.sampled_from([*problem.robot_ids, "x"]), *[numbers] * 3),
            max_size=5,
        )
    )
    plan = Plan(
        data.draw(st.sampled_from(["optimal", "feasible", "infeasible", "unknown", "?"])),
        data.draw(st.sampled_from([problem.robot_ids, ("x",), ()])),
        tuple(paths),
        data.draw(st.integers(-5, 99)),
        data.draw(st.none() | st.floats()),
    )
    assert all(isinstance(violation, Violation) for violation in check_plan(problem, plan))
