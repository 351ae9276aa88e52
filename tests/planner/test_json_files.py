"""problem.json: round trips, defaults, and every fault of a file at once."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.errors import PlannerError
from planner.json_files import dump_problem, parse_problem, read_problem
from tests.oracles.tiny_problems import random_hall, tiny_problem, tiny_problems
from tests.planner.examples import grid

# The example of 1-semantics, completed to two vertices and a second robot.
EXAMPLE = """
{"format": "mapp-problem/1", "name": "optional", "horizon": 60, "ap_capacity": 15,
 "objective": "hp", "at_goal": "leave",
 "aps": ["ap0", "ap1"],
 "vertices": [{"x": 0.0, "y": 0.0, "aps": [0, 1], "snr_db": [21.5, 14.0]},
              {"x": 3, "y": 0.5, "aps": [1, 0]},
              {"x": 6.0, "y": 0.0, "aps": [1]}],
 "edges": [{"u": 0, "v": 1, "aps": [0], "slots": 1, "handovers": [[0, 1]], "oneway": false},
           {"u": 2, "v": 1}],
 "robots": [{"id": "r00", "start": 0, "goal": 2}, {"id": "r01", "start": 1, "goal": 2}]}
"""


def changed(**changes: object) -> str:
    """The example as text with top-level keys changed; None removes one."""
    given_keys = {**json.loads(EXAMPLE), **changes}
    return json.dumps({key: value for key, value in given_keys.items() if value is not None})


def faults_of(text: str) -> tuple[str, ...]:
    """The lines of the error that parsing raises."""
    with pytest.raises(PlannerError) as caught:
        parse_problem(text, "hall.json")
    return caught.value.lines


def test_example_is_read_with_its_defaults():
    """What an edge leaves out means A_u ∩ A_v, 1 slot, both ways, all handovers of A_u × A_v."""
    problem = parse_problem(EXAMPLE)
    assert (problem.name, problem.horizon, problem.at_goal) == ("optional", 60, "leave")
    assert (problem.objective, problem.c_t, problem.c_h) == ("hp", 1, 60)
    assert problem.ap_ids == ("ap0", "ap1")
    assert problem.ap_capacity.tolist() == [15, 15]
    assert problem.xy_m.tolist() == [[0, 0], [3, 0.5], [6, 0]]
    assert problem.cover.tolist() == [[True, True], [True, True], [False, True]]
    assert problem.snr_db[0].tolist() == [21.5, 14.0]
    assert np.isnan(problem.snr_db[1:]).all()
    assert problem.edge_uv.tolist() == [[0, 1], [2, 1]]
    assert problem.edge_slots.tolist() == [1, 1]
    assert problem.edge_oneway.tolist() == [False, False]
    assert problem.edge_cover.tolist() == [[True, False], [False, True]]
    # The first edge lists its pairs; the second has all of {1} × {0, 1}, u being vertex 2.
    assert np.argwhere(problem.edge_handover).tolist() == [[0, 0, 1], [1, 1, 0]]
    assert problem.robot_ids == ("r00", "r01")
    assert problem.start.tolist() == [0, 1]
    assert problem.goal.tolist() == [2, 2]


def test_only_the_name_may_be_left_out():
    """Every other top-level key says something that must not be guessed."""
    assert parse_problem(changed(name=None)).name == ""
    for key in json.loads(EXAMPLE):
        if key != "name":
            assert faults_of(changed(**{key: None}))[0] == (
                f"hall.json: $.{key}: missing: this key must be given"
            )


def test_objectives_and_capacities():
    """§1.10: named objectives or integer costs; one capacity or one per AP (§1.6)."""
    problem = parse_problem(changed(objective={"c_t": 2, "c_h": 0}, ap_capacity=[0, 3]))
    assert (problem.objective, problem.c_t, problem.c_h) == ("costs", 2, 0)
    assert problem.ap_capacity.tolist() == [0, 3]
    assert parse_problem(changed(objective="tp")).c_t == 60


def test_snr_objective_of_a_file():
    """§1.10: snr needs the SNRs, then keeps the best AP of each vertex."""
    vertices = [
        {"x": 0, "y": 0, "aps": [0, 1], "snr_db": [14, 21.5]},
        {"x": 1, "y": 0, "aps": [1, 0], "snr_db": [17, 17]},
    ]
    robots = [{"id": "a", "start": 0, "goal": 1}]
    text = changed(objective="snr", vertices=vertices, edges=[{"u": 0, "v": 1}], robots=robots)
    problem = parse_problem(text)
    assert problem.cover.tolist() == [[False, True], [True, False]]
    assert parse_problem(dump_problem(problem)) == problem
    del vertices[1]["snr_db"]
    lines = faults_of(changed(objective="snr", vertices=vertices, edges=[], robots=robots))
    assert [line.split(": ")[1] for line in lines] == ["$.vertices[1].snr_db"] * 2


def test_syntax_error_has_line_and_column():
    """A text that is not JSON is located."""
    assert faults_of('{"format": "mapp-problem/1",\n "horizon": 60,\n "aps": [}') == (
        "hall.json:3:10: not JSON: Expecting value; mend it there",
    )
    assert faults_of("")[0].startswith("hall.json:1:1: not JSON: ")
    assert "the text ends early" in faults_of(EXAMPLE[:80])[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "hall.json: not usable: its brackets nest too deeply"),
        ("9" * 5000, "hall.json: not usable: Exceeds the limit"),
        ("[]", "hall.json: $: []: must be an object with the keys"),
        ("null", "hall.json: $: null: must be an object with the keys"),
        ('{"horizon": 1, "horizon": 2}', "hall.json: $.horizon: 2: this key is given twice"),
    ],
)
def test_strange_json_is_refused(text, message):
    """Whatever else JSON allows is a fault, not an exception of another kind."""
    assert faults_of(text)[0].startswith(message)


FAULTY = {
    "misspelt key": (
        {"robots": [{"id": "a", "start": 0, "gaol": 1}]},
        [
            '$.robots[0].gaol: 1: unknown key; did you mean "goal"?',
            "$.robots[0].goal: missing: this key must be given",
        ],
    ),
    "unknown key": (
        {"version": 3},
        ['$.version: 3: unknown key; known are "format", "horizon", "ap_capacity", "objective", '],
    ),
    "format": ({"format": "mapp-problem/2"}, ['$.format: "mapp-problem/2": must be "mapp-prob']),
    "float for integer": ({"horizon": 60.0}, ["$.horizon: 60.0: must be an integer; write 60"]),
    "boolean for integer": ({"horizon": True}, ["$.horizon: true: must be an integer"]),
    "text for integer": ({"horizon": "60"}, ['$.horizon: "60": must be an integer']),
    "horizon": ({"horizon": 0}, ["$.horizon: 0: must be at least 1"]),
    "horizon too long": ({"horizon": 10**6}, ["$.horizon: 1000000: must be at most 100000"]),
    "costs too high": (
        {"horizon": 100_000},
        ["$.objective: c_t = 1, c_h = 100000: a path of 100000 slots could cost more than"],
    ),
    "objective": ({"objective": "sn"}, ['$.objective: "sn": must be "hp", "tp" or "snr"; did yo']),
    "objective type": ({"objective": 1}, ['$.objective: 1: must be "hp", "tp", "snr" or {"c_t"']),
    "cost": (
        {"objective": {"c_t": -1, "c_v": 1}},
        [
            "$.objective.c_h: missing",
            "$.objective.c_t: -1: must be at least 0",
            '$.objective.c_v: 1: unknown key; did you mean "c_',
        ],
    ),
    "at_goal": ({"at_goal": "stay"}, ['$.at_goal: "stay": must be "leave" or "park"']),
    "equal goals under park": (
        {"at_goal": "park"},
        ["$.robots[1].goal: 2: robot r01 and robot r00 have the same goal; parked robots stay"],
    ),
    "capacity": ({"ap_capacity": -1}, ["$.ap_capacity: -1: must be at least 0"]),
    "capacities": ({"ap_capacity": [1, 2, 3]}, ["$.ap_capacity: [1, 2, 3]: must be one integer, "]),
    "capacity of one": ({"ap_capacity": [1, 2.5]}, ["$.ap_capacity[1]: 2.5: must be an integer"]),
    "AP names": (
        {"aps": ["a", "a"]},
        ["$.aps[1]: 'a': AP 0 has this id already; give each its own"],
    ),
    "AP type": ({"aps": ["a", 7]}, ["$.aps[1]: 7: must be text in double quotes"]),
    "no list": ({"edges": {}}, ["$.edges: {}: must be a list of edges"]),
    "no object": ({"edges": [[0, 1]]}, ["$.edges[0]: [0, 1]: must be an object with the keys"]),
    "vertex index": (
        {"edges": [{"u": 0, "v": 3}]},
        ["$.edges[0].v: 3: is no vertex: there are 3 vertices, counted from 0"],
    ),
    "loop": ({"edges": [{"u": 1, "v": 1}]}, ["$.edges[0].v: 1: an edge joins two different"]),
    "slots": ({"edges": [{"u": 0, "v": 1, "slots": 0}]}, ["$.edges[0].slots: 0: must be at lea"]),
    "oneway": (
        {"edges": [{"u": 0, "v": 1, "oneway": 1}]},
        ["$.edges[0].oneway: 1: must be true or false"],
    ),
    "edge APs": (
        {"edges": [{"u": 1, "v": 2, "aps": [1, 0]}]},
        ["$.edges[0].aps[1]: 0: AP ap0 covers the edge but not its vertex 2 (§1.7); add it there"],
    ),
    "edge AP index": (
        {"edges": [{"u": 0, "v": 1, "aps": [2]}]},
        ["$.edges[0].aps[0]: 2: is no AP: there are 2, counted from 0"],
    ),
    "handovers": (
        {"edges": [{"u": 1, "v": 2, "handovers": [[0, 1], [1, 0], [1, 1], [0], [0, 5]]}]},
        [
            "$.edges[0].handovers[1]: [1, 0]: a pair names two different APs; the first must cover "
            "vertex 1 (u), the second vertex 2 (v) (§1.7)",
            "$.edges[0].handovers[2]: [1, 1]: a pair names two",
            "$.edges[0].handovers[3]: [0]: must be a pair [AP at u, AP at v]",
            "$.edges[0].handovers[4][1]: 5: is no AP: there are 2, counted from 0",
        ],
    ),
    "robot": (
        {"robots": [{"id": "", "start": 9, "goal": "x"}, {"id": "b", "start": -1, "goal": 1}]},
        [
            '$.robots[0].goal: "x": must be an integer',
            "$.robots[0].id: '': robot ids are non-empty text",
            "$.robots[0].start: 9: is no vertex",
            "$.robots[1].start: -1: is no vertex",
        ],
    ),
    "same start": (
        {"robots": [{"id": "b", "start": 1, "goal": 2}, {"id": "b", "start": 1, "goal": 0}]},
        [
            "$.robots[1].id: 'b': robot 0 has this id already",
            "$.robots[1].start: 1: robot b and robot b have the same start; starts are distinct",
        ],
    ),
    "nobody": ({"robots": []}, ["$.robots: []: there must be at least one robot"]),
}


@pytest.mark.parametrize("name", FAULTY)
def test_fault_is_told_with_file_place_value_and_remedy(name):
    """Each line reads `file: $.place: value: message`."""
    changes, beginnings = FAULTY[name]
    lines = faults_of(changed(**changes))
    assert len(lines) == len(beginnings), lines
    for line, beginning in zip(lines, beginnings, strict=True):
        assert line.startswith(f"hall.json: {beginning}")


def test_faults_of_vertices():
    """Coordinates, APs and SNRs of a vertex are judged one by one."""
    vertices = [
        {"x": 0, "y": None, "aps": [0, 1, 0]},
        {"x": float("nan"), "y": 1e999, "aps": [0, "ap1", 2]},
        {"x": 0, "y": 0, "aps": []},
        {"x": 0, "y": 0, "aps": [0, 1], "snr_db": [1]},
        {"x": 0, "y": 0, "aps": [0, 1], "snr_db": [1, "2"]},
    ]
    lines = faults_of(changed(vertices=vertices))
    assert [line.removeprefix("hall.json: $.vertices") for line in lines] == [
        "[0].aps[2]: 0: this AP is listed twice; keep one",
        "[0].y: null: must be a finite number",
        '[1].aps[1]: "ap1": must be an integer',
        "[1].aps[2]: 2: is no AP: there are 2, counted from 0",
        "[1].x: NaN: must be a finite number",
        "[1].y: Infinity: must be a finite number",
        "[2].aps: []: no AP covers this vertex; leave it out, with its edges (§1.8)",
        '[3].snr_db: [1]: must have as many entries as "aps" beside it (2)',
        '[4].snr_db[1]: "2": must be a finite number',
    ]


def test_all_faults_of_a_file_come_at_once():
    """A file with a fault in every part is told all of them, in its own order."""
    lines = faults_of(
        changed(
            horizon="x",
            vertices=[{"x": 0, "y": 0, "aps": [0]}, {"x": 0, "y": 0, "aps": [7]}],
            edges=[{"u": 0, "v": 1}, {"u": 0, "v": 5}],
            robots=[{"id": "a", "start": 0, "goal": 1}, {"id": "a", "start": 0, "goal": 1}],
        )
    )
    assert [line.split(": ")[1] for line in lines] == [
        "$.horizon",
        "$.vertices[1].aps[0]",
        "$.edges[1].v",
        "$.robots[1].id",
        "$.robots[1].start",
    ]


def test_what_follows_from_a_fault_is_not_a_fault():
    """Without vertices or APs nothing that refers to them is called wrong as well."""
    assert [line.split(": ")[1] for line in faults_of(changed(vertices="none"))] == ["$.vertices"]
    assert [line.split(": ")[1] for line in faults_of(changed(aps=3, ap_capacity=[1, 1]))] == [
        "$.aps"
    ]
    robots = [{"id": "a", "goal": 1}, {"id": "b", "start": 0, "goal": 1}, {"start": 0, "goal": 1}]
    assert [line.split(": ")[1] for line in faults_of(changed(robots=robots))] == [
        "$.robots[0].start",
        "$.robots[2].id",
        "$.robots[2].start",
    ]


def test_too_large_arrays_are_refused_before_they_fill_the_memory():
    """Vertices × APs and edges × APs² are bounded, since both are held as whole arrays."""
    aps = [f"ap{a}" for a in range(50_000)]
    many = [{"x": 0, "y": 0, "aps": [0]}] * 30_000
    assert faults_of(changed(aps=aps, vertices=many)) == (
        'hall.json: $.vertices: "30000 vertices × 50000 APs": must be at most 1073741824 entries; '
        "split the problem",
        'hall.json: $.edges: "2 edges × 50000² APs": must be at most 1073741824 entries; '
        "split the problem",
    )


@settings(deadline=None, max_examples=100)
@given(tiny_problems())
def test_problem_survives_its_file(problem):
    """Dump, then parse, is the identity, handover pairs and cut coverage included."""
    text = dump_problem(problem)
    again = parse_problem(text)
    assert again == problem
    assert dump_problem(again) == text


def test_dump_of_a_hall_is_compact():
    """One line per vertex, edge and robot; keys that repeat a default are left out."""
    problem = random_hall(1, size=8, n=5)
    lines = dump_problem(problem).splitlines()
    rows = problem.n_vertices + problem.n_edges + problem.n_robots
    assert len(lines) == rows + 10
    assert lines.count('  {"u": 0, "v": 1},') == 1
    assert parse_problem("\n".join(lines)) == problem


def test_dump_writes_only_json():
    """An unknown SNR among known ones is null, and texts keep their letters."""
    snr = np.array([[20.0, np.nan], [np.nan, np.nan]])
    problem = grid(2, 1, [(0, 1)], name="Halle „Süd“", snr_db=snr)
    text = dump_problem(problem)
    assert "NaN" not in text
    assert '"snr_db": [20.0, null]' in text
    assert "Halle „Süd“" in text
    assert parse_problem(text) == problem


def test_problem_is_read_from_a_file(tmp_path):
    """Files are UTF-8, with or without a byte order mark; what cannot be read is said."""
    path = tmp_path / "hall.json"
    path.write_bytes(b"\xef\xbb\xbf" + EXAMPLE.encode())
    assert read_problem(path) == parse_problem(EXAMPLE)
    path.write_bytes(b'{"format": "\xff"}')
    with pytest.raises(PlannerError, match=r"^hall\.json: byte 12: not UTF-8"):
        read_problem(path)
    with pytest.raises(PlannerError, match="cannot be read: No such file"):
        read_problem(tmp_path / "none.json")
    with pytest.raises(PlannerError, match="cannot be read: Is a directory"):
        read_problem(tmp_path)


@settings(deadline=None, max_examples=150)
@given(st.data())
def test_any_damage_to_a_file_is_a_planner_error(data):
    """Whatever value is put anywhere, the file is either a problem or refused with a line."""
    root = json.loads(dump_problem(tiny_problem(3)))
    node, key = root, data.draw(st.sampled_from(sorted(root)))
    while isinstance(node[key], (dict, list)) and node[key] and data.draw(st.booleans()):
        node = node[key]
        keys = sorted(node) if isinstance(node, dict) else range(len(node))
        key = data.draw(st.sampled_from(keys))
    node[key] = data.draw(
        st.none()
        | st.booleans()
        | st.integers()
        | st.floats()
        | st.text(max_size=3)
        | st.just([])
        | st.just({})
        | st.lists(st.integers(-1, 3), max_size=3)
    )
    lines: tuple[str, ...] = ()
    try:
        problem = parse_problem(json.dumps(root))
        assert parse_problem(dump_problem(problem)) == problem
    except PlannerError as error:
        lines = error.lines
    assert all(line.startswith("problem.json: $") for line in lines)
