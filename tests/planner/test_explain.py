"""Why there is no plan: every reason is proven, and what is said to be enough is."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from planner.explain import explain
from planner.explanation import Explanation
from planner.least_room import Decider, Least, least_capacity, least_horizon, with_horizon
from planner.passing import NEVER, Passing
from planner.plan import Plan
from planner.problem import Problem
from planner.solve import SolveParams, solve
from tests.oracles.arcflow import solve_arcflow
from tests.oracles.tiny_problems import tiny_problem
from tests.planner.examples import grid

POCKET = np.array([(0, 1), (1, 2), (2, 3), (3, 4), (2, 5)])
"""A corridor of five positions with a pocket beside the middle one."""
POCKET_XY = np.array([(0, 0), (2, 0), (4, 0), (6, 0), (8, 0), (4, 2)], float)


def pocket(errands: list[tuple[int, int]], horizon: int, **changes: object) -> Problem:
    """Errands in the corridor with a pocket."""
    fields = {"edge_uv": POCKET, "xy_m": POCKET_XY, "n_aps": 1, "at_goal": "park", **changes}
    return grid(6, 1, errands, horizon=horizon, **fields)


def answer(problem: Problem) -> Explanation:
    """The explanation of what the planner finds."""
    return explain(problem, solve(problem, SolveParams(iterations=50)), iterations=200)


def is_feasible(problem: Problem) -> bool:
    """By the oracle."""
    return solve_arcflow(problem).status == "optimal"


def first_feasible(values: range, change: object) -> int | None:
    """The first value for which the oracle finds a plan."""
    return next((x for x in values if is_feasible(change(x))), None)


def test_two_robots_in_a_dead_end_cannot_pass():
    """Two robots swap places in a lane for one: no horizon and no AP helps, and both are named."""
    problem = grid(5, 1, [(0, 4), (4, 0)], horizon=9, n_aps=1)
    found = answer(problem)
    assert found.status == "infeasible"
    assert [fault.robots for fault in found.pairs] == [("r0", "r1")]
    assert found.pairs[0].least_slots is None
    assert found.horizon.never
    text = "\n".join((*found.reasons(), *found.remedies()))
    assert "r0 ((0, 0) m to (4, 0) m) and r1 ((4, 0) m to (0, 0) m) cannot get past each" in text
    assert "no horizon is long enough: proven" in text


def test_robots_pass_at_a_pocket_if_the_horizon_allows():
    """With a pocket there is a least horizon; it is the oracle's, and no less is claimed."""
    least = first_feasible(range(4, 12), lambda T: pocket([(0, 4), (4, 0)], T))
    found = answer(pocket([(0, 4), (4, 0)], least - 1))
    assert found.pairs[0].least_slots == least
    assert found.horizon.exact
    assert found.horizon.upper == least
    assert f"need at least {least} slots to get past each other" in found.reasons()[0]
    assert answer(pocket([(0, 4), (4, 0)], least)).status != "infeasible"


def test_ap_for_one_robot_and_two_robots():
    """Capacity 1 for two robots that are both there in slot 0: the AP, the slot and 2 are named."""
    problem = grid(4, 2, [(0, 3), (4, 7)], n_aps=1, ap_capacity=[1])
    found = answer(problem)
    assert found.status == "infeasible"
    assert found.bottleneck.robots == ("r0", "r1")
    (part,) = found.bottleneck.parts
    assert (part.kind, part.name, part.capacity) == ("ap", "AP ap0", 1)
    assert part.share == 1.0
    assert found.bottleneck.need > found.bottleneck.room
    assert found.capacity == Least(2, 2, 2)
    assert "an AP capacity of 2 is enough, and none smaller (now 1)" in found.remedies()
    reason = found.reasons()[-1]
    assert reason.startswith("2 robots need 2 places where there are 1: AP ap0 (1 at once) in slot")


def test_more_slots_do_not_help_where_robots_start():
    """A bottleneck in slot 0 is there whatever the horizon is."""
    problem = grid(4, 2, [(0, 3), (4, 7)], n_aps=1, ap_capacity=[1], at_goal="park", horizon=4)
    found = answer(problem)
    start_only = all(part.slots == ((0, 0),) for part in found.bottleneck.parts)
    assert found.horizon.never == start_only
    assert found.horizon.upper is None


def test_horizon_too_short_names_the_least():
    """A robot that is too far: its shortest slots, the horizon, and the least that is enough."""
    found = answer(grid(6, 1, [(0, 5), (1, 2)], n_aps=1, horizon=4, at_goal="leave"))
    (fault,) = found.alone
    assert (fault.robot, fault.least_slots) == ("r0", 5)
    assert "from (0, 0) m to (5, 0) m takes at least 5 slots even alone; the horizon is 4" in (
        fault.text
    )
    assert found.horizon == Least(5, 5, 68)
    assert found.capacity.never


def test_goal_in_another_part_of_the_floor():
    """No way on the floor, and no chain of APs on it, are told apart; no horizon helps."""
    apart = grid(4, 1, [(0, 3)], n_aps=1, edge_uv=[(0, 1), (2, 3)])
    (fault,) = answer(apart).alone
    assert fault.least_slots is None
    assert "no way on the covered floor" in fault.text
    line = grid(4, 1, [(0, 3)], n_aps=2, cover=[[0], [0], [1], [1]])
    silent = dataclasses.replace(line, edge_handover=np.zeros_like(line.edge_handover))
    found = answer(silent)
    assert "no APs that hand the robot on" in found.alone[0].text
    assert found.horizon.never


def test_bottleneck_names_the_place_and_the_slots():
    """Two robots that must both cross one position at once: it is named in metres."""
    cross = np.array([(0, 1), (1, 2), (3, 1), (1, 4)])
    xy = np.array([(0, 2), (2, 2), (4, 2), (2, 0), (2, 4)], float)
    problem = grid(5, 1, [(0, 2), (3, 4)], n_aps=1, horizon=2, edge_uv=cross, xy_m=xy)
    found = answer(problem)
    (part,) = found.bottleneck.parts
    assert (part.kind, part.name, part.index) == ("position", "position (2, 2) m", 1)
    assert part.slots == ((1, 1),)
    assert found.horizon == Least(3, 3, 66)
    assert found.capacity.never
    assert "position (2, 2) m in slot 1 (robots r0, r1)" in found.reasons()[-1]
    assert "no AP capacity is enough at this horizon (now 2): proven" in found.remedies()


def test_served_plan_needs_no_explanation():
    """A plan for all robots is not explained away."""
    found = answer(grid(3, 1, [(0, 2)], n_aps=1))
    assert found.status == "served"
    assert found.horizon is None
    assert "nothing to explain" in found.reasons()[0]


def test_plan_that_was_only_not_found_is_said_to_exist():
    """`unknown` is no proof: where a plan turns up, the explanation says so."""
    problem = grid(3, 1, [(0, 2)], n_aps=1)
    nothing = Plan("unknown", problem.robot_ids, (None,), 0, None)
    found = explain(problem, nothing)
    assert found.status == "feasible"
    assert "a plan for all robots exists" in found.reasons()[0]


def test_undecided_is_told_honestly():
    """Given no time, nothing is claimed but what is proven already."""
    problem = pocket([(0, 4), (4, 0), (5, 3)], 6)
    nothing = Plan("unknown", problem.robot_ids, (None,) * 3, 0, None)
    found = explain(problem, nothing, stop=lambda: True)
    assert found.horizon.upper is None
    assert not found.horizon.never
    assert "no plan was found for any horizon" in found.remedies()[0]


def test_json_has_all_of_it():
    """`--json`: plain values, the sentences among them."""
    found = answer(grid(4, 2, [(0, 3), (4, 7)], n_aps=1, ap_capacity=[1]))
    values = json.loads(json.dumps(found.to_dict()))
    assert values["status"] == "infeasible"
    assert values["bottleneck"]["parts"][0]["name"] == "AP ap0"
    assert values["least_ap_capacity"]["upper"] == 2
    assert values["sentences"] == [*found.reasons(), *found.remedies()]


HOPELESS = [
    problem
    for seed in range(150)
    for problem in [tiny_problem(seed, max_robots=3, max_slots=4)]
    if problem.n_robots > 1 and solve_arcflow(problem).status == "infeasible"
][:14]


@pytest.mark.parametrize("problem", HOPELESS, ids=range(len(HOPELESS)))
def test_what_is_claimed_agrees_with_the_oracle(problem):
    """§1.12: reasons for infeasible problems; bounds on T and m that the oracle confirms."""
    found = answer(problem)
    assert found.status in {"infeasible", "unknown"}
    for fault in found.alone:
        assert fault.least_slots is None or fault.least_slots > problem.horizon
    least = first_feasible(range(1, 13), lambda T: with_horizon(problem, T))
    confirm(found.horizon, least, 12)
    n = problem.n_robots
    capacities = [np.full(problem.n_aps, m) for m in range(n + 1)]
    least = first_feasible(
        range(1, n + 1), lambda m: dataclasses.replace(problem, ap_capacity=capacities[m])
    )
    confirm(found.capacity, least, n)


def confirm(claim: Least, truth: int | None, searched: int) -> None:
    """What is claimed is true as far as the oracle searched."""
    if truth is None:
        assert claim.upper is None or claim.upper > searched
    else:
        assert not claim.never
        assert claim.lower <= truth
        assert claim.upper is None or claim.upper >= truth
        assert claim.upper is not None, "these are small enough to find a plan"


@pytest.mark.parametrize("at_goal", ["leave", "park"])
def test_pairs_need_what_the_oracle_says(at_goal):
    """Two robots with one AP everywhere: the least horizon of a pair is exact."""
    passing_pairs = 0
    for seed in range(40):
        problem = tiny_problem(seed, max_robots=2, features=False, at_goal=at_goal)
        if problem.n_robots < 2:
            continue
        one = np.ones((problem.n_vertices, 1), bool)
        edges = problem.n_edges
        problem = dataclasses.replace(
            problem,
            objective="costs",
            ap_ids=("ap0",),
            ap_capacity=np.array([2]),
            cover=one,
            snr_db=np.where(one, np.nan, np.nan),
            edge_cover=np.ones((edges, 1), bool),
            edge_handover=np.zeros((edges, 1, 1), bool),
        )
        claim = Passing(problem).least_horizon(0, 1)
        if claim == 0:
            continue
        truth = first_feasible(range(1, 11), lambda T, p=problem: with_horizon(p, T))
        assert max(claim, 1) == truth if truth is not None else claim == NEVER or claim > 10
        passing_pairs += 1
    assert passing_pairs >= 8


def test_pairs_say_nothing_about_edges_of_several_slots():
    """What is not modelled is not claimed."""
    slow = grid(3, 1, [(0, 2), (2, 0)], n_aps=1, edge_slots=np.array([2, 1]))
    assert Passing(slow).least_horizon(0, 1) == 0
    assert answer(slow).pairs == ()


def test_parallel_edges_let_robots_swap():
    """§1.3: an edge carries one robot, two edges carry two."""
    swap = grid(2, 1, [(0, 1), (1, 0)], n_aps=1)
    assert Passing(swap).least_horizon(0, 1) == NEVER
    double = grid(2, 1, [(0, 1), (1, 0)], n_aps=1, edge_uv=[(0, 1), (1, 0)])
    assert Passing(double).least_horizon(0, 1) == 1


def test_search_for_the_least_calls_each_candidate_once_and_is_right():
    """Whatever stays undecided, the range holds the truth; without that it is exact."""
    problem = grid(3, 1, [(0, 2)], n_aps=1)
    rng = np.random.default_rng(0)
    for _ in range(60):
        truth = int(rng.integers(2, 90))
        above = int(rng.integers(0, truth))
        share = float(rng.choice([0.0, 0.3]))
        dark = set(np.flatnonzero(rng.random(200) < share).tolist())
        asked: list[int] = []

        def decide(
            candidate: Problem, truth=truth, dark=dark, asked=asked, above=above
        ) -> bool | None:
            T = candidate.horizon
            assert above < T
            assert T not in asked
            asked.append(T)
            return None if T in dark else truth <= T

        found = least_horizon(problem, above, decide)
        assert found.lower <= truth
        assert found.upper is None or found.upper >= truth
        if not dark and truth <= found.tried:
            assert found.exact


def test_capacity_search_knows_that_n_is_no_limit():
    """With m = N an AP serves everybody: a proof there means that no capacity helps."""
    problem = grid(3, 2, [(0, 2), (3, 5)], n_aps=1)
    assert least_capacity(problem, 1, lambda _p: False) == Least(3, None, 2, never=True)
    assert least_capacity(problem, 1, lambda _p: None) == Least(2, None, 2)
    assert least_capacity(problem, 2, lambda _p: True).never
    assert least_capacity(problem, 0, lambda p: bool(p.ap_capacity[0] >= 2)) == Least(2, 2, 2)


def test_decider_is_deterministic():
    """§1.15: same seed and counts, same explanation."""
    problem = grid(4, 2, [(0, 3), (3, 0), (4, 7)], n_aps=1, ap_capacity=[2])
    assert Decider(iterations=100)(problem) == Decider(iterations=100)(problem)
    assert answer(problem).to_dict() == answer(problem).to_dict()
