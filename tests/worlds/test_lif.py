"""VDMA LIF: what is read, what is refused in words, and what is written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.worlds.lifs import RING, SCHEMAS, edge, layout, node, spoilt
from worlds.errors import WorldError
from worlds.formats.lif import Lif, LifStation, lif_text, parse_lif, read_lif
from worlds.hall import GraphEdge, GraphNode


def lines_of(text: str, **choice: str) -> list[str]:
    """The lines of the error a LIF text causes."""
    with pytest.raises(WorldError) as caught:
        parse_lif(text, "plant.lif", **choice)
    return list(caught.value.lines)


def written(lif: Lif) -> str:
    """A LIF file of a layout."""
    return lif_text(
        lif.nodes,
        lif.edges,
        lif.stations,
        layout=lif.layout,
        vehicle=lif.vehicle,
        project="test",
        timestamp="2024-01-01T00:00:00.00Z",
    )


def test_nodes_edges_and_stations_are_read() -> None:
    """Places, directions and speeds as in the file; a missing maxSpeed is no limit."""
    lif = parse_lif(json.dumps(RING), "plant.lif")
    assert (lif.layout, lif.vehicle, lif.remarks) == ("floor 1", "tug", ())
    assert [(n.id, n.at_m) for n in lif.nodes][4] == ("dock", (-3.0, 4.0))
    speeds = {(e.start, e.end): e.speed_m_s for e in lif.edges}
    assert speeds["a", "b"] == 2.0
    assert speeds["c", "d"] is None
    assert ("b", "a") not in speeds
    assert {("d", "dock"), ("dock", "d")} <= set(speeds)
    assert lif.stations[0] == LifStation("gate", ("dock", "d"))


def _duplicate_node(v: Any) -> None:
    layout(v)["nodes"].append(node("a", 9.0, 9.0))


def _duplicate_edge(v: Any) -> None:
    layout(v)["edges"].append({**edge("b", "a"), "edgeId": "a>b"})


def _set(*path: Any, to: Any) -> Any:
    def change(value: Any) -> None:
        for step in path[:-1]:
            value = value[step]
        if to is None:
            del value[path[-1]]
        else:
            value[path[-1]] = to

    return change


def _millimetres(v: Any) -> None:
    for n in layout(v)["nodes"]:
        n["nodePosition"] = {k: 1000 * c for k, c in n["nodePosition"].items()}


IN = ("layouts", 0)
PROPERTY = (*IN, "edges", 1, "vehicleTypeEdgeProperties", 0)
WRONG: dict[str, tuple[Any, str]] = {
    "dangling edge": (
        _set(*IN, "edges", 0, "endNodeId", to="bb"),
        "layouts[0].edges[0].endNodeId: 'bb' is not the id of a node; did you mean 'b'?",
    ),
    "node twice": (_duplicate_node, "layouts[0].nodes[5].nodeId: 'a' is the id of an earlier"),
    "edge twice": (_duplicate_edge, "layouts[0].edges[6].edgeId: 'a>b' is the id of an earlier"),
    "loop": (
        _set(*IN, "edges", 0, "endNodeId", to="a"),
        "layouts[0].edges[0].endNodeId: 'a>b' leads from 'a' to itself",
    ),
    "no length": (
        _set(*IN, "nodes", 1, "nodePosition", to={"x": 0.0, "y": 0.0}),
        "layouts[0].edges[0]: 'a>b' has no length: 'a' and 'b' are at the same place",
    ),
    "millimetres": (_millimetres, "layouts[0].nodes: a typical edge is 4000 m long"),
    "speed in mm/s": (_set(*PROPERTY, "maxSpeed", to=1500), "edges[1].vehicleTypeEdgeProperties"),
    "speed 0": (_set(*PROPERTY, "maxSpeed", to=0), "0 m/s: nobody can drive there"),
    "text for a number": (
        _set(*IN, "nodes", 2, "nodePosition", "x", to="6"),
        'layouts[0].nodes[2].nodePosition.x: "6" is not a number',
    ),
    "no position": (
        _set(*IN, "nodes", 2, "nodePosition", to=None),
        "layouts[0].nodes[2].nodePosition: is missing",
    ),
    "list for an object": (_set(*IN, "nodes", 2, to=[]), "layouts[0].nodes[2]: [] is not an obj"),
    "nobody's node": (
        _set(*IN, "nodes", 2, "vehicleTypeNodeProperties", to=[]),
        "layouts[0].nodes[2].vehicleTypeNodeProperties: is empty",
    ),
    "station nowhere": (
        _set(*IN, "stations", 1, "interactionNodeIds", to=["shop"]),
        "layouts[0].stations[1].interactionNodeIds[0]: 'shop' is not the id of a node of this",
    ),
    "station twice": (_set(*IN, "stations", 1, "stationId", to="gate"), "stations[1].stationId"),
    "no layouts": (_set("layouts", to=[]), "layouts: is empty"),
    "not LIF": (_set("layouts", to=None), "is not a LIF file: it has no layouts"),
    "version 7": (_set("metaInformation", "lifVersion", to="7.1"), "lifVersion '7.1' is not known"),
    "far away": (
        _set(*IN, "nodes", 0, "nodePosition", "x", to=1e9),
        "layouts[0].nodes[0].nodePosition: [1e+09, 0] is more than 1000 km",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_file_is_refused_with_its_place(case: str) -> None:
    """One line that names the file, the place in it and what is wrong."""
    change, words = WRONG[case]
    lines = lines_of(spoilt(change))
    assert len(lines) == 1, lines
    assert lines[0].startswith("plant.lif: ")
    assert words in lines[0]


NOT_JSON = {
    "empty": ("", "plant.lif: is empty"),
    "cut short": (json.dumps(RING)[:400], "plant.lif:1: is not valid JSON"),
    "NaN": (json.dumps(RING).replace("6.0", "NaN", 1), "plant.lif:1: NaN is no number"),
    "key twice": ('{"layouts": [], "layouts": []}', "the key 'layouts' stands twice"),
    "deep": ("[" * 100_000, "is nested too deeply"),
    "a list": ("[]", "is not a LIF file"),
    "long number": ('{"layouts": ' + "9" * 5000 + "}", "is not valid JSON"),
}


@pytest.mark.parametrize("case", NOT_JSON)
def test_what_is_no_json_is_refused(case: str) -> None:
    """With the line where there is one, and without a traceback."""
    text, words = NOT_JSON[case]
    assert words in lines_of(text)[0]


def test_all_faults_are_told_at_once_but_not_without_end() -> None:
    """Eight of them, and how many more."""
    lines = lines_of(spoilt(lambda v: layout(v)["nodes"].clear()))
    assert len(lines) == 9
    assert lines[-1].endswith("more faults")


def test_files_are_read_with_care(tmp_path: Path) -> None:
    """No such file, a folder, bytes that are no text."""
    for path, words in (
        (tmp_path / "no.json", "there is no such file"),
        (tmp_path, "is a directory"),
        (tmp_path / "b.json", ":2: byte 0xff is not UTF-8"),
    ):
        (tmp_path / "b.json").write_bytes(b"\n\xff")
        with pytest.raises(WorldError, match=words):
            read_lif(path)


def test_a_vehicle_type_is_chosen() -> None:
    """Of several one must be named; what another type may use is left out."""

    def two(v: Any) -> None:
        layout(v)["nodes"].append(node("yard", 9.0, 0.0, "truck"))
        layout(v)["edges"] += [edge("b", "yard", None, "truck"), edge("c", "yard", None, "tug")]

    text = spoilt(two)
    assert "is for 2 vehicle types; name one as vehicle: tug, truck" in lines_of(text)[0]
    assert "did you mean 'truck'" in lines_of(text, vehicle="trucks")[0]
    tug = parse_lif(text, "plant.lif", vehicle="tug")
    assert "yard" not in {n.id for n in tug.nodes}
    assert len(tug.edges) == 6
    assert tug.remarks == ("1 edge leads from or to a node that 'tug' may not use: left out",)


def test_a_layout_is_chosen() -> None:
    """Of several one must be named; edges to another layout are left out and told of."""

    def two(v: Any) -> None:
        upstairs = {"layoutId": "floor 2", "nodes": [node("lift", 6.0, 8.0)], "edges": []}
        v["layouts"].append({**upstairs, "stations": []})
        layout(v)["edges"].append(edge("c", "lift"))

    text = spoilt(two)
    assert "has 2 layouts; name one as layout: floor 1, floor 2" in lines_of(text)[0]
    assert "known are floor 1, floor 2" in lines_of(text, layout="cellar")[0]
    found = parse_lif(text, "plant.lif", layout="floor 1")
    assert found.remarks == ("1 edge leads to another layout: left out",)
    assert len(found.edges) == 6


REMARKS: dict[str, tuple[Any, str]] = {
    "trajectory": (
        _set(*PROPERTY, "trajectory", to={"knotVector": [], "controlPoints": []}),
        "1 edge has a trajectory: robots drive straight instead",
    ),
    "degrees": (_set(*PROPERTY, "vehicleOrientation", to=180.0), "angles up to 180 cannot be rad"),
    "degrees at a node": (
        _set(*IN, "nodes", 0, "vehicleTypeNodeProperties", 0, "theta", to=-90),
        "angles up to 90 cannot be radians",
    ),
    "loads": (
        _set(*PROPERTY, "loadRestriction", to={"unloaded": True, "loaded": False}),
        "1 edge has load restrictions: not heeded",
    ),
    "version 2": (_set("metaInformation", "lifVersion", to="2.0.0"), "LIF version 2.0.0, read as"),
    "parallel": (
        lambda v: layout(v)["edges"].append({**edge("a", "b", 9.0), "edgeId": "again"}),
        "1 edge leads where an earlier edge leads already: left out",
    ),
}


@pytest.mark.parametrize("case", REMARKS)
def test_what_is_taken_otherwise_is_told(case: str) -> None:
    """One remark, and the graph as without it."""
    change, words = REMARKS[case]
    lif = parse_lif(spoilt(change), "plant.lif")
    assert len(lif.remarks) == 1
    assert words in lif.remarks[0]
    assert lif.edges == parse_lif(json.dumps(RING), "plant.lif").edges


def test_unknown_keys_are_passed_over() -> None:
    """Version 2.0's `origins`, and whatever a vendor adds."""

    def more(v: Any) -> None:
        v["origins"] = [{"originId": "o"}]
        layout(v)["nodes"][0]["vendor"] = {"x": "y"}

    assert parse_lif(spoilt(more), "plant.lif") == parse_lif(json.dumps(RING), "plant.lif")


IDS = st.text(st.characters(min_codepoint=32, exclude_categories=("Cs", "Cc")), min_size=1)
COORDINATE = st.floats(-500, 500, allow_subnormal=False)


@st.composite
def layouts(draw: st.DrawFn) -> Lif:
    """Layouts of up to eight nodes, some edges between them, some stations."""
    ids = draw(st.lists(IDS, min_size=2, max_size=8, unique=True))
    places = draw(st.lists(st.tuples(st.integers(-40, 40), COORDINATE), min_size=len(ids),
                           max_size=len(ids), unique_by=lambda p: p[0]))  # fmt: skip
    nodes = tuple(
        GraphNode(id=i, at_m=(float(x), y / 10)) for i, (x, y) in zip(ids, places, strict=True)
    )
    pairs = draw(
        st.lists(
            st.tuples(st.sampled_from(ids), st.sampled_from(ids)).filter(lambda p: p[0] != p[1]),
            unique=True,
            max_size=12,
        )
    )
    speeds = st.none() | st.floats(0.01, 20.0)
    edges = tuple(
        GraphEdge(id=f"e{k}", start=a, end=b, speed_m_s=draw(speeds))
        for k, (a, b) in enumerate(pairs)
    )
    names = draw(st.lists(IDS, max_size=3, unique=True))
    stations = tuple(
        LifStation(name, tuple(draw(st.lists(st.sampled_from(ids), min_size=1, max_size=3))))
        for name in names
    )
    return Lif(draw(IDS), draw(IDS), nodes, edges, stations)


@settings(max_examples=60, deadline=None)
@given(layouts())
def test_written_and_read_again_is_the_same(lif: Lif) -> None:
    """LIF out, LIF in: graph, directions, speeds and stations, to the last bit; and again."""
    text = written(lif)
    found = parse_lif(text, "out.lif")
    assert found == lif
    assert written(found) == text


def test_written_files_keep_the_schema() -> None:
    """The published schema of LIF 1.0."""
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
    if not SCHEMAS.exists():
        pytest.skip("../shared/data is not here")
    schema = json.loads((SCHEMAS / "LIF.schema").read_text())
    lif = parse_lif(json.dumps(RING), "plant.lif")
    jsonschema.Draft7Validator(schema).validate(RING)
    jsonschema.Draft7Validator(schema).validate(json.loads(written(lif)))


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**20), 10**20) | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=3,
)


def _places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every place in a JSON value."""
    found = [path] if path else []
    if isinstance(value, dict | list):
        steps = value.items() if isinstance(value, dict) else enumerate(value)
        for key, inner in steps:
            found += _places(inner, (*path, key))
    return found


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(_places(RING)), JUNK)
def test_no_value_anywhere_makes_it_stumble(place: tuple[Any, ...], junk: Any) -> None:
    """Whatever stands in whatever place: a layout, or a WorldError that names the file."""
    text = json.dumps(json.loads(spoilt(_set(*place, to=[junk]))))
    text = text.replace(json.dumps([junk]), json.dumps(junk), 1)
    lines: tuple[str, ...] = ()
    try:
        parse_lif(text, "plant.lif")
    except WorldError as error:
        lines = error.lines
    assert all(line.startswith("plant.lif") for line in lines)
