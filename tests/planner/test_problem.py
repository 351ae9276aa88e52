"""A `Problem` is right or refused with all its faults; a world's problem is its covered part."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.errors import PlannerError
from planner.problem import Problem, edge_cover_of_ends, objective_costs, problem_from_world
from planner.validation import MAX_PATH_COST
from tests.planner.examples import grid
from worlds.floor import Boxes, Floor
from worlds.radio_map import RadioMap
from worlds.world import AccessPoint, Costs, Hall, PlanOptions, Radio, World


def lines_of(**changes: object) -> tuple[str, ...]:
    """What is wrong with a 3 × 1 grid of two robots changed this way."""
    problem = changes.pop("problem", grid(3, 1, [(0, 2), (2, 0)]))
    with pytest.raises(PlannerError) as caught:
        dataclasses.replace(problem, **changes)
    assert str(caught.value) == "\n".join(caught.value.lines)
    return caught.value.lines


def test_sizes_are_properties():
    """N, V, E and A have names."""
    problem = grid(3, 2, [(0, 5), (1, 4)], n_aps=3)
    assert problem.n_robots == 2
    assert problem.n_vertices == 6
    assert problem.n_edges == 7
    assert problem.n_aps == 3


def test_arrays_are_read_only_copies():
    """Neither the problem nor the arrays it was made of can change under anyone's feet."""
    start = np.array([0, 1], np.int32)
    problem = grid(3, 1, [(0, 2), (1, 2)], start=start)
    start[0] = 2
    assert problem.start.tolist() == [0, 1]
    for field in dataclasses.fields(problem):
        value = getattr(problem, field.name)
        if isinstance(value, np.ndarray):
            assert not value.flags.writeable, field.name
    with pytest.raises(dataclasses.FrozenInstanceError):
        problem.horizon = 3


def test_lists_become_arrays_of_the_documented_types():
    """Lists and other integer types are taken where they hold the same numbers."""
    problem = grid(2, 1, [(0, 1)], start=[0], goal=np.array([1], np.uint8), ap_capacity=[1, 0])
    assert problem.start.dtype == problem.goal.dtype == problem.ap_capacity.dtype == np.int32
    assert problem.cover.dtype == problem.edge_handover.dtype == np.bool_


def test_equality_compares_contents():
    """Two problems are equal when all fields are, unknown SNRs included."""
    problem = grid(3, 1, [(0, 2)])
    assert problem == grid(3, 1, [(0, 2)])
    assert problem != grid(3, 1, [(0, 1)])
    assert problem != dataclasses.replace(problem, snr_db=np.ones((3, 2)))
    assert problem != "problem"


def test_all_faults_are_reported_at_once():
    """One error lists every fault with its place, value and remedy."""
    assert lines_of(
        at_goal="stay",
        ap_capacity=[-1, 2],
        ap_ids=("a", "a"),
        xy_m=[[0, 0], [np.inf, 0], [2, 0]],
        edge_slots=[0, 1],
        robot_ids=("", "r1"),
        start=[1, 1],
        goal=[0, 3],
    ) == (
        'at_goal: \'stay\': must be "leave" or "park" (§1.4)',
        "aps[1]: 'a': AP 0 has this id already; give each its own",
        "ap_capacity[0]: -1: must be 0 robots or more",
        "vertices[1].x: inf: must be a finite number [m]",
        "edges[0].slots: 0: must be 1 to 100000 slots",
        "robots[0].id: '': robot ids are non-empty text that UTF-8 can hold",
        "robots[1].start: 1: robot r1 and robot  have the same start; starts are distinct (§1.2), "
        "so move one of them",
        "robots[1].goal: 3: is no vertex: there are 3 vertices, counted from 0",
    )


@pytest.mark.parametrize(
    ("changes", "beginning"),
    [
        ({"horizon": 0, "c_h": 0}, "horizon: 0: must be 1 to"),
        ({"horizon": 1.5}, "horizon: 1.5: must be an integer"),
        ({"c_t": -1, "objective": "costs"}, "objective.c_t: -1: must not be negative"),
        ({"c_h": 9}, "objective: hp with c_t = 1, c_h = 9: it means c_t = 1, c_h = 8"),
        ({"objective": "best"}, "objective: 'best': must be"),
        (
            {"objective": "costs", "c_h": MAX_PATH_COST},
            f"objective: c_t = 1, c_h = {MAX_PATH_COST}: a path of 8 slots could cost more",
        ),
        ({"name": "\ud800"}, "name: '\\ud800': must be text"),
        ({"xy_m": np.zeros((3, 3))}, "xy_m: shape (3, 3): must be (3, 2)"),
        ({"cover": np.ones((2, 2), bool)}, "cover: shape (2, 2): must be (3, 2)"),
        ({"start": [0.5, 2]}, "start: list: must hold integers"),
        ({"start": [0, 2**31]}, "start: list: holds numbers beyond 32 bits"),
        ({"cover": np.ones((3, 2))}, "cover: ndarray: must hold booleans"),
        ({"cover": [[1, 1], [0, 0], [1, 1]]}, "cover: list: must hold booleans"),
        ({"edge_uv": [(0, 1), (1, 5)]}, "edges[1].v: 5: is no vertex"),
        ({"edge_uv": [(0, 1), (1, 1)]}, "edges[1].v: 1: an edge joins two different vertices"),
        ({"snr_db": [[np.inf, 0]] * 3}, "vertices[0].snr_db: inf: needs a finite SNR"),
        ({"at_goal": "park", "goal": [1, 1]}, "robots[1].goal: 1: robot r1 and robot r0 have"),
        ({"start": [-1, 2]}, "robots[0].start: -1: is no vertex"),
    ],
)
def test_fault_is_named_with_place_and_value(changes, beginning):
    """Each rule that arrays can break is told by its place in problem.json."""
    assert lines_of(**changes)[0].startswith(beginning)


def test_uncovered_vertex_is_refused():
    """§1.8: G holds only vertices that some AP covers."""
    lines = lines_of(cover=[[True, True], [False, False], [True, True]])
    assert "vertices[1].aps: []: no AP covers this vertex; leave it out" in lines[0]


def test_edges_claim_no_more_than_their_ends():
    """§1.7: A_e lies within A_u ∩ A_v, and a handover needs its APs at their ends."""
    problem = grid(3, 1, [(0, 2)], cover=[[0], [0, 1], [1]])
    lines = lines_of(problem=problem, edge_cover=[[True, False], [True, True]])
    assert [line.split(":")[0] for line in lines] == ["edges[1].aps"]
    assert "AP ap0 covers the edge but not its vertex 2" in lines[0]
    wrong = np.zeros((2, 2, 2), bool)
    wrong[0, 1, 0] = wrong[1, 1, 1] = True
    lines = lines_of(problem=problem, edge_handover=wrong)
    assert [line.split(": ")[:2] for line in lines] == [
        ["edges[0].handovers", "[1, 0]"],
        ["edges[1].handovers", "[1, 1]"],
    ]


def test_equal_goals_are_allowed_when_robots_leave():
    """§1.5: goals are pairwise distinct under park only."""
    assert grid(3, 1, [(0, 1), (2, 1)]).goal.tolist() == [1, 1]


def test_empty_problem_is_refused():
    """There is nothing to plan without robots, vertices or APs."""
    with pytest.raises(PlannerError) as caught:
        grid(0, 0, [], n_aps=0, xy_m=np.zeros((0, 2)))
    assert [line.split(":")[0] for line in caught.value.lines] == ["aps", "vertices", "robots"]


@pytest.mark.parametrize(
    ("objective", "costs"), [("hp", (1, 60)), ("tp", (60, 1)), ("snr", (1, 0))]
)
def test_costs_of_objectives(objective, costs):
    """§1.10: hp c_t = 1, c_h = T; tp c_t = T, c_h = 1; snr c_t = 1, c_h = 0."""
    assert objective_costs(objective, 60) == costs
    with pytest.raises(PlannerError):
        objective_costs("costs", 60)


def test_snr_objective_cuts_coverage_to_the_best_ap():
    """§1.10: A_v keeps the AP of highest SNR, ties the lowest index; edges follow."""
    problem = grid(
        4,
        1,
        [(0, 3)],
        n_aps=3,
        cover=[[0, 1], [0, 1, 2], [1, 2], [0, 1, 2]],
        objective="snr",
        c_h=0,
        snr_db=[[10, 12, 99], [15, 15, 15], [99, 11, 14], [3, 20, 20]],
    )
    assert [np.flatnonzero(row).tolist() for row in problem.cover] == [[1], [0], [2], [1]]
    assert not problem.edge_cover.any()
    assert np.argwhere(problem.edge_handover).tolist() == [[0, 1, 0], [1, 0, 2], [2, 2, 1]]
    assert np.nansum(problem.snr_db, axis=1).tolist() == [12, 15, 14, 20]
    assert np.isnan(problem.snr_db).sum() == 8
    assert dataclasses.replace(problem) == problem


def test_snr_objective_needs_every_snr():
    """§1.10: the best AP of a vertex is not to be guessed."""
    lines = lines_of(objective="snr", c_h=0, snr_db=[[1, 2], [np.nan, 2], [1, 2]])
    assert len(lines) == 1
    assert lines[0].startswith("vertices[1].snr_db: unknown: needs a finite SNR [dB] of AP ap0")


def test_snr_is_kept_where_covered_only():
    """What problem.json cannot say, a problem does not hold: SNRs of APs that do not cover."""
    problem = grid(2, 1, [(0, 1)], cover=[[0], [0, 1]], snr_db=[[20.0, 5.0], [15.0, np.nan]])
    assert np.array_equal(problem.snr_db, [[20, np.nan], [15, np.nan]], equal_nan=True)


def test_coverage_by_ends_is_the_endpoints_rule():
    """§1.7 `endpoints`: A_e = A_u ∩ A_v, handovers are all pairs of different APs."""
    cover = np.array([[True, True, False], [False, True, True]])
    edge_cover, edge_handover = edge_cover_of_ends(cover, np.array([[0, 1]]))
    assert edge_cover.tolist() == [[False, True, False]]
    assert np.argwhere(edge_handover[0]).tolist() == [[0, 1], [0, 2], [1, 2]]


# From a world

SNR = [  # of "near" and "far" at the six vertices of the floor below
    [30, 0],
    [20, 9.9],
    [9, 9],
    [20, 20],
    [10, 30],
    [0, 30],
]


def floor_of(start: list[int], goal: list[int]) -> Floor:
    """Six positions in two rows of three, the last edge a slow lane."""
    nothing = np.zeros((0, 3))
    edges = [(0, 1), (1, 2), (3, 4), (4, 5), (0, 3), (1, 4), (2, 5), (3, 4)]
    return Floor(
        pitch_m=2.0,
        slot_s=2.0,
        columns=3,
        rows=2,
        boxes=Boxes((), nothing, nothing, np.zeros(0)),
        vertex_xy_m=np.array([(1.0 + 2 * (v % 3), 1.0 + 2 * (v // 3)) for v in range(6)]),
        vertex_cell=np.array([(v % 3, v // 3) for v in range(6)], np.int32),
        edge_uv=np.array(edges, np.int32),
        edge_slots=np.array([1] * 7 + [3], np.int32),
        edge_oneway=np.array([False] * 7 + [True]),
        robot_ids=tuple(f"agv {i}" for i in range(len(start))),
        start=np.array(start, np.int32),
        goal=np.array(goal, np.int32),
    )


def map_of(floor: Floor, snr: list[list[float]], *, edge_rule: str = "samples") -> RadioMap:
    """A radio map whose edges have the SNR of their ends, and 12 dB in the middle.

    In the middle of edge 4, between 0 and 3, only "near" is heard.
    """
    at = np.array(snr, float)
    middle = np.full((len(floor.edge_uv), at.shape[1]), 12.0)
    middle[4, 1] = 0.0
    edges = np.stack([at[floor.edge_uv[:, 0]], middle, at[floor.edge_uv[:, 1]]], axis=1)
    return RadioMap(
        ap_ids=("near", "far"),
        threshold_db=10.0,
        edge_rule=edge_rule,
        snr_db=at,
        los=np.ones(at.shape, bool),
        blocker=np.full(at.shape, -1, np.int32),
        edge_snr_db=edges,
        fading_db=np.zeros(at.shape),
    )


def world_of(**plan: object) -> World:
    """A world with an AP of its own capacity, one of the default and one switched off."""
    return World(
        name="shed",
        hall=Hall(size_m=(6.0, 4.0), pitch_m=2.0, slot_s=2.0),
        ap=(
            AccessPoint(id="off", position_m=(3.0, 2.0, 4.0), enabled=False, capacity=9),
            AccessPoint(id="near", position_m=(0.5, 0.5, 4.0), capacity=0),
            AccessPoint(id="far", position_m=(5.5, 3.5, 4.0)),
        ),
        radio=Radio(ap_capacity=7),
        plan=PlanOptions(**plan),
    )


def test_world_is_cut_to_what_is_covered():
    """§1.8: uncovered vertices and edges are left out, the rest keeps its order and orientation."""
    floor = floor_of([0, 3], [5, 4])
    problem = problem_from_world(world_of(horizon=20), floor, map_of(floor, SNR))
    assert problem.name == "shed"
    assert (problem.horizon, problem.objective, problem.c_t, problem.c_h) == (20, "hp", 1, 20)
    assert problem.ap_ids == ("near", "far")
    assert problem.ap_capacity.tolist() == [0, 7]
    assert problem.xy_m.tolist() == [[1, 1], [3, 1], [1, 3], [3, 3], [5, 3]]
    assert problem.edge_uv.tolist() == [[0, 1], [2, 3], [3, 4], [0, 2], [1, 3], [2, 3]]
    assert problem.edge_slots.tolist() == [1, 1, 1, 1, 1, 3]
    assert problem.edge_oneway.tolist() == [False] * 5 + [True]
    assert problem.start.tolist() == [0, 2]
    assert problem.goal.tolist() == [4, 3]
    assert problem.robot_ids == ("agv 0", "agv 1")


def test_world_edges_know_their_samples():
    """§1.7: A_e and the handovers of an edge are those of its sample points."""
    floor = floor_of([0], [5])
    problem = problem_from_world(world_of(), floor, map_of(floor, SNR))
    by_ends = problem_from_world(world_of(), floor, map_of(floor, SNR, edge_rule="endpoints"))
    for given in (problem, by_ends):
        assert given.edge_cover[[0, 1, 2]].tolist() == [[True, False], [True, True], [False, True]]
        assert given.edge_handover[0].tolist() == [[False, False], [False, False]]
        assert given.edge_handover[1].tolist() == [[False, True], [True, False]]
    # Between 0 (near only) and 3 (both) one can change to "far" only where "near" fills the gap.
    assert problem.edge_handover[3].tolist() == [[False, True], [False, False]]
    assert problem.edge_cover[3].tolist() == [True, False]


@pytest.mark.parametrize(
    ("objective", "expected"),
    [("tp", ("tp", 60, 1)), ("snr", ("snr", 1, 0)), (Costs(c_t=2, c_h=3), ("costs", 2, 3))],
)
def test_world_objective_becomes_costs(objective, expected):
    """§1.10: named objectives and integer costs of one's own."""
    floor = floor_of([0], [5])
    world = world_of(objective=objective, horizon=60, at_goal="park")
    problem = problem_from_world(world, floor, map_of(floor, SNR))
    assert (problem.objective, problem.c_t, problem.c_h) == expected
    assert problem.at_goal == "park"


def test_robots_out_of_coverage_are_all_named():
    """A start or goal that no AP reaches is said with robot, place, best SNR and remedy."""
    floor = floor_of([0, 2], [2, 5])
    with pytest.raises(PlannerError) as caught:
        problem_from_world(world_of(), floor, map_of(floor, SNR))
    assert caught.value.lines == (
        "shed: robot agv 1: its start, cell [2, 0] at (5, 1) m, is covered by no AP (the best, "
        "near, gives 9.0 dB): move the start, add an AP near it, or lower radio.threshold_db "
        "(10 dB)",
        "shed: robot agv 0: its goal, cell [2, 0] at (5, 1) m, is covered by no AP (the best, "
        "near, gives 9.0 dB): move the goal, add an AP near it, or lower radio.threshold_db "
        "(10 dB)",
    )


def test_world_without_coverage_is_refused():
    """§1.8: with no AP anywhere there is no G."""
    floor = floor_of([0], [5])
    with pytest.raises(PlannerError, match=r"no AP covers any of the 6 free positions \(the best"):
        problem_from_world(world_of(), floor, map_of(floor, [[9.0, 1.0]] * 6))


def test_world_whose_problem_breaks_a_rule_names_itself():
    """§1.5: the faults of the problem are told with the world's name."""
    floor = floor_of([0, 1], [5, 5])
    with pytest.raises(PlannerError, match=r"^shed: robots\[1\].goal: 4: robot agv 1 and robot"):
        problem_from_world(world_of(at_goal="park"), floor, map_of(floor, SNR))


def test_problem_is_not_hashable():
    """Arrays have no hash; a problem used as a key fails loudly."""
    with pytest.raises(TypeError):
        hash(grid(2, 1, [(0, 1)]))
    assert isinstance(grid(2, 1, [(0, 1)]), Problem)
