"""`twin export`: LIF, VDA 5050 orders and the plan's table, against the run they come from."""

from __future__ import annotations

import csv
import json
from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from logs.mcap_reader import RunFile, read
from tests.cli_tools import HALL, files_below, twin
from tests.worlds.lifs import RING, SCHEMAS, write_world
from worlds.formats.lif import parse_lif, read_lif
from worlds.toml_file import open_world, read_world

LIF_HALL = Path(__file__).resolve().parents[2] / "worlds/lif_hall.toml"
CROWD = HALL[: HALL.index("[[robot]]")].replace("pitch_m = 2.0", "pitch_m = 1.5")
CROWD += "[hall.body]\nlength_m = 0.6\nwidth_m = 0.5\n[robots.random]\ncount = 12\nseed = 3\n"
CROWD += '[plan]\nhorizon = 40\nat_goal = "park"\n'


@dataclass(frozen=True)
class Exported:
    """A run and what was exported of it."""

    run: RunFile
    folder: Path
    printed: Any

    @property
    def orders(self) -> dict[str, Any]:
        """The orders, by robot."""
        found = [json.loads(p.read_text()) for p in sorted(self.folder.glob("vda/*.order.json"))]
        return {order["serialNumber"]: order for order in found}

    @property
    def releases(self) -> list[Any]:
        """The lines of the release log."""
        lines = (self.folder / "vda/releases.jsonl").read_text().splitlines()
        return [json.loads(line) for line in lines]


@pytest.fixture(scope="module", params=["lif hall", "crowd"])
def exported(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Exported:
    """The hall with one-way lanes of several slots, and a crowded grid whose robots park."""
    folder = tmp_path_factory.mktemp("export")
    world = LIF_HALL
    if request.param == "crowd":
        world = folder / "crowd.toml"
        world.write_text(CROWD)
    done = twin("run", world, "-o", folder / "run", "--json")
    assert done.code == 0, done.err
    log = folder / "run/run.mcap"
    options = ["--vda5050", folder / "vda", "--csv", folder / "plan.csv"]
    printed = twin("export", log, *options, "--lif", folder / "o.json", "--json")
    assert printed.code == 0, printed.err
    return Exported(read(log), folder, printed.json)


def way(run: RunFile, robot: str) -> list[tuple[int, int, int | None]]:
    """(vertex, slot of arrival, slot in which it leaves) of each stay, by the plan alone."""
    path = next(p for p in run.plan.paths if p is not None and p.robot == robot)
    vertices, edges = path.vertices.tolist(), [*path.edges.tolist(), -1]
    stays: list[tuple[int, int, int | None]] = []
    for t, (vertex, edge) in enumerate(zip(vertices, edges, strict=True)):
        if not stays or stays[-1][2] is not None:
            if stays and vertex == stays[-1][0]:
                continue  # still on the edge
            stays.append((vertex, t, None))
        if edge >= 0:
            stays[-1] = (*stays[-1][:2], t)
    if run.problem.at_goal == "leave":
        stays[-1] = (*stays[-1][:2], path.arrival)
    return stays


def names(run: RunFile) -> list[str]:
    """What the problem's vertices are called outside."""
    from worlds.radio_map import kept_vertices

    floor = run.floor
    kept = kept_vertices(run.radio_map).tolist()
    if floor.node_id:
        return [floor.node_id[v] for v in kept]
    return ["c{}r{}".format(*floor.vertex_cell[v].tolist()) for v in kept]


def test_orders_are_the_ways_of_the_robots(exported: Exported) -> None:
    """One order per robot; its nodes are the plan's stays, ids even and odd in turn."""
    run, orders = exported.run, exported.orders
    assert list(exported.printed["vda5050"].items())[1:2] == [("orders", len(orders))]
    assert set(orders) == set(run.plan.robot_ids)
    called = names(run)
    for robot, order in orders.items():
        stays = way(run, robot)
        assert [n["nodeId"] for n in order["nodes"]] == [called[v] for v, *_ in stays]
        assert [n["sequenceId"] for n in order["nodes"]] == list(range(0, 2 * len(stays), 2))
        assert [e["sequenceId"] for e in order["edges"]] == list(range(1, 2 * len(stays) - 1, 2))
        for edge, (a, b) in zip(order["edges"], pairwise(order["nodes"]), strict=True):
            assert edge["edgeId"] == f"{a['nodeId']}-{b['nodeId']}"
            assert edge["released"] == b["released"]
            # From the one node to the other in whole slots, no slower than allowed.
            slots = edge["length"] / edge["maximumSpeed"] / run.floor.slot_s
            assert slots == pytest.approx(round(slots))
        released = [n["released"] for n in order["nodes"]]
        assert released[0]
        assert released == sorted(released, reverse=True)  # a base, then a horizon


def test_orders_keep_the_schema(exported: Exported) -> None:
    """The schema of VDA 5050's main branch."""
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
    if not SCHEMAS.exists():
        pytest.skip("../shared/data is not here")
    schema = json.loads((SCHEMAS / "vda5050-order.schema").read_text())
    for order in exported.orders.values():
        jsonschema.Draft202012Validator(schema).validate(order)


def test_a_node_is_in_the_base_of_one_robot_at_a_time(exported: Exported) -> None:
    """From its release until its robot leaves it in the run, no other robot has it."""
    held: dict[str, list[tuple[int, int, str]]] = defaultdict(list)
    for line in exported.releases:
        stays = way(exported.run, line["robot"])
        for node in line["nodes"]:
            left = stays[node["sequenceId"] // 2][2]
            until = left if left is not None else 10**9
            held[node["nodeId"]].append((line["slot"], until, line["robot"]))
    shared = 0
    for spans in held.values():
        spans.sort()
        shared += len({robot for *_, robot in spans}) > 1
        for (_, end, one), (begin, _, other) in pairwise(spans):
            assert begin >= end or one == other, (spans, one, other)
    assert shared > 5  # robots do share nodes, so the above says something


def test_releases_are_complete_and_in_order(exported: Exported) -> None:
    """Each node of an order once, in its order, never more than three ahead of the robot."""
    of: dict[str, list[Any]] = defaultdict(list)
    for line in exported.releases:
        of[line["robot"]].append(line)
    assert [line["slot"] for line in exported.releases] == sorted(
        line["slot"] for line in exported.releases
    )
    for robot, order in exported.orders.items():
        lines = of[robot]
        ids = [node["sequenceId"] for line in lines for node in line["nodes"]]
        assert ids == [node["sequenceId"] for node in order["nodes"]]
        assert [line["orderUpdateId"] for line in lines] == list(range(len(lines)))
        assert {line["orderId"] for line in lines} == {order["orderId"]}
        first = [node["nodeId"] for node in lines[0]["nodes"]]
        assert first == [n["nodeId"] for n in order["nodes"] if n["released"]]
        stays = way(exported.run, robot)
        for line in lines:
            assert line["t_s"] == pytest.approx(line["slot"] * exported.run.floor.slot_s)
            at = max(k for k, stay in enumerate(stays) if stay[1] <= line["slot"])
            assert max(node["sequenceId"] for node in line["nodes"]) // 2 <= at + 3
            for node in line["nodes"]:  # released no later than the robot gets there
                assert line["slot"] <= stays[node["sequenceId"] // 2][1]


def test_the_table_is_the_plan(exported: Exported) -> None:
    """A row per robot and slot with node, place and AP; handovers are marked."""
    run = exported.run
    with (exported.folder / "plan.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    called, handovers = names(run), 0
    for path in run.plan.paths:
        assert path is not None
        mine = [row for row in rows if row["robot"] == path.robot]
        assert [int(row["slot"]) for row in mine] == list(range(path.arrival + 1))
        assert [row["node"] for row in mine] == [called[v] for v in path.vertices.tolist()]
        assert [row["ap"] for row in mine] == [run.problem.ap_ids[a] for a in path.aps.tolist()]
        assert [row["edge"] != "" for row in mine[:-1]] == [e >= 0 for e in path.edges.tolist()]
        handovers += sum(int(row["handover"]) for row in mine)
    assert handovers == run.plan.handovers


def test_lif_of_a_run_is_that_of_its_world(exported: Exported) -> None:
    """The log carries the tracks; read again they are the floor's edges, one by one."""
    lif = read_lif(exported.folder / "o.json")
    floor = exported.run.floor
    called = floor.node_id or tuple("c{}r{}".format(*c) for c in floor.vertex_cell.tolist())
    wanted = {(called[u], called[v]) for u, v in floor.edge_uv.tolist()}
    both = floor.edge_uv[~floor.edge_oneway].tolist()
    wanted |= {(called[v], called[u]) for u, v in both}
    assert {(e.start, e.end) for e in lif.edges} == wanted


def test_lif_through_a_world_is_the_same(tmp_path: Path) -> None:
    """LIF in, world, LIF out: nodes, edges, speeds and stations equal, offset or not."""
    path = write_world(tmp_path)
    done = twin("export", path, "--lif", tmp_path / "out.json", "--json")
    assert done.code == 0, done.err
    assert done.json["lif"]["stations"] == 2
    assert read_lif(tmp_path / "out.json") == parse_lif(json.dumps(RING), "ring")
    again = twin("export", path, "--lif", tmp_path / "out.json", "--overwrite")
    assert again.code == 0


def test_a_grid_as_lif_resolves_to_the_same_floor(tmp_path: Path) -> None:
    """The free positions and moves of a grid, exported and read as a graph: one floor."""
    (tmp_path / "hall.toml").write_text(HALL)
    assert twin("export", tmp_path / "hall.toml", "--lif", tmp_path / "hall.json").code == 0
    graph = '[hall.graph]\nlif = "hall.json"\n'
    text = HALL.replace("pitch_m = 2.0\nspeed_m_s = 1.0\n", "slot_s = 2.0\n" + graph)
    text = text.replace("cell = [0, 0]", 'node = "c0r0"').replace("cell = [5, 3]", 'node = "c5r3"')
    text = text.replace("cell = [5, 1]", 'node = "c5r1"').replace("cell = [0, 2]", 'node = "c0r2"')
    (tmp_path / "graph.toml").write_text(text)
    _, grid = open_world(tmp_path / "hall.toml")
    _, lanes = open_world(tmp_path / "graph.toml")
    assert lanes.vertex_xy_m.tolist() == grid.vertex_xy_m.tolist()
    assert lanes.edge_uv.tolist() == grid.edge_uv.tolist()
    assert lanes.edge_slots.tolist() == grid.edge_slots.tolist()
    assert not lanes.edge_oneway.any()
    assert (lanes.start.tolist(), lanes.goal.tolist()) == (grid.start.tolist(), grid.goal.tolist())


def test_imported_worlds_name_their_layout(tmp_path: Path, monkeypatch: Any) -> None:
    """`twin import` of a LIF file: a world that names it by a relative path, and runs."""
    monkeypatch.chdir(tmp_path)
    Path("plant").mkdir()
    Path("plant/ring.lif.json").write_text(json.dumps(RING))
    done = twin(
        "import", "plant/ring.lif.json", "-o", "worlds/ring.toml", "--robots", "2", "--json"
    )
    assert done.code == 0, done.err
    assert (done.json["lanes"], done.json["one_way"], done.json["stations"]) == (5, 4, 2)
    assert 'lif = "../plant/ring.lif.json"' in Path("worlds/ring.toml").read_text()
    world = read_world(Path("worlds/ring.toml"))
    assert world.hall.graph is not None
    assert world.name == "ring"
    assert twin("check", "worlds/ring.toml").code == 0
    assert not any("can touch" in hint for hint in done.json["hints"])
    wide = ["-o", "wide.toml", "--robots", "2", "--body", "4.5,3.0", "--json"]
    told = twin("import", "plant/ring.lif.json", *wide).json["hints"]
    assert any("robots of 4.5 m x 3 m can touch at 5 nodes" in hint for hint in told), told
    run = twin("run", "worlds/ring.toml", "-o", "out", "--json")
    assert run.code == 0, run.err


REFUSED = {
    "nothing asked": (["hall.toml"], "say what to write"),
    "orders of a world": (["hall.toml", "--vda5050", "v"], "orders and plans are those of a run"),
    "not there": (["no.toml", "--lif", "o.json"], "there is no such file"),
    "no log": (["no.mcap", "--csv", "o.csv"], "is not there"),
    "a picture": (["hall.png", "--lif", "o.json"], "is not a world or a log"),
    "wrong ending": (["hall.toml", "--lif", "o.txt"], "must end in .json or .lif"),
    "there already": (["hall.toml", "--lif", "mine.json"], "exists already"),
    "set on a run": (["no.mcap", "--csv", "o.csv", "--set", "a=1"], "--set: no.mcap is a run"),
    "pitch for LIF": (["import", "ring.json", "--pitch", "1"], "--pitch: not for a VDA LIF"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_exported_is_refused_in_words(
    tmp_path: Path, monkeypatch: Any, case: str
) -> None:
    """Exit code 2, one line, nothing written."""
    monkeypatch.chdir(tmp_path)
    Path("hall.toml").write_text(HALL)
    Path("mine.json").write_text("mine")
    Path("ring.json").write_text(json.dumps(RING))
    before = files_below(tmp_path)
    args, words = REFUSED[case]
    done = twin(*(args if args[0] == "import" else ["export", *args]))
    assert done.code == 2, done.out
    assert words.replace("VDA LIF", "VDMA LIF") in done.err
    assert len(done.err.strip().splitlines()) == 1, done.err
    assert files_below(tmp_path) == before


def test_a_folder_with_files_is_not_touched(exported: Exported) -> None:
    """Orders of two runs never mix unless told."""
    done = twin("export", exported.run.path, "--vda5050", exported.folder / "vda")
    assert done.code == 2
    assert "is not empty" in done.err
