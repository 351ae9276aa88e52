"""The whole road on lanes: random layouts with one-way lanes, executed, logged and validated."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from logs.mcap_reader import read
from logs.records import Incident
from logs.validate import validate
from tests.cli_tools import twin
from tests.twin.lanes import random_layout
from twin.instance import survey
from twin.pipeline import execute, make_plan
from worlds.check import check_world
from worlds.toml_file import dump_world, parse_world

LIF_HALL = Path(__file__).resolve().parents[2] / "worlds/lif_hall.toml"


@pytest.mark.parametrize("seed", range(4))
def test_a_layout_without_findings_has_no_contact(seed: int, tmp_path: Path) -> None:
    """Logs are valid; bodies touch only where `twin check` says so (W112 to W114)."""
    world = random_layout(seed)
    assert parse_world(dump_world(world)) == world
    from worlds.generate import resolve

    instance = survey(world, resolve(world))
    assert instance.problem.edge_oneway.any()
    assert instance.problem.edge_slots.max() > 1
    plan = make_plan(instance.problem)
    assert not plan.unserved
    log = tmp_path / "run.mcap"
    execute(instance, plan, log)
    report = validate(log)
    told = {f.code for f in check_world(world).findings} & {"W112", "W113", "W114"}
    contacts = [r for r in read(log).of(Incident) if r.kind == "contact"]
    assert {f.rule for f in report.findings} <= {"page5:bodies"}
    assert not contacts or told
    assert bool(report.findings) == bool(contacts)
    assert bool(told) is bool(seed % 2)


def test_the_lif_hall_is_sound() -> None:
    """The world that ships: no error, no lane conflict, a fleet of ten on one-way lanes."""
    from worlds.toml_file import read_world

    report = check_world(read_world(LIF_HALL))
    assert report.passed()
    assert report.floor is not None
    assert 30 <= len(report.floor.vertex_xy_m) <= 60
    assert len(report.floor.robot_ids) == 10
    assert report.floor.edge_oneway.sum() > 30
    lanes = {f"W{code}" for code in range(109, 117)}
    assert not lanes & {f.code for f in report.findings}


def test_a_radio_map_as_a_survey_fits_itself(tmp_path: Path) -> None:
    """`twin radio --csv` compared with a world 3 dB weaker: 3 dB on average, no deviation."""
    table = tmp_path / "map.csv"
    assert twin("radio", LIF_HALL, "--csv", table).code == 0
    with table.open(newline="") as file:
        assert len(list(csv.DictReader(file))) == 200
    done = twin("radio", LIF_HALL, "--compare", table, "--set", "radio.tx_power_dbm=9", "--json")
    assert done.code == 0, done.err
    assert done.json["all"]["mean_db"] == pytest.approx(3.0, abs=1e-5)
    assert done.json["all"]["std_db"] == pytest.approx(0.0, abs=1e-5)
    assert done.json["offsets_db"] == dict.fromkeys(
        ["", "southwest", "northwest", "southeast", "northeast"], 3.0
    )
    words = twin("radio", LIF_HALL, "--compare", table)
    assert "offset_db = 0.0" in words.out
    wrong = twin("radio", LIF_HALL, "--compare", table, "-o", tmp_path / "a.png")
    assert wrong.code == 2
    assert "--compare only compares" in wrong.err


def test_one_way_lanes_are_seen_in_foxglove(tmp_path: Path) -> None:
    """The graph is drawn with an arrow head per one-way lane; coverage covers the lanes only."""
    import struct

    from logs.foxglove import NO_POSITION_DB, coverage_grid, static_scene
    from worlds.generate import resolve

    world = random_layout(0)
    instance = survey(world, resolve(world))
    problem, floor = instance.problem, instance.floor
    scene = static_scene(world, floor, problem)
    (graph,) = (entity for entity in scene.entities if entity.id == "graph")
    lanes, heads = graph.lines
    assert len(lanes.indices) == 2 * len(problem.edge_uv)
    assert len(heads.points) == 4 * int(problem.edge_oneway.sum())
    first = int(np.flatnonzero(problem.edge_oneway)[0])
    u, v = (problem.xy_m[end] for end in problem.edge_uv[first])
    tail, tip = (np.array([p.x, p.y]) for p in (heads.points[0], heads.points[1]))
    assert (tip - tail) @ (v - u) > 0  # it points where the lane leads
    grid = coverage_grid(floor, instance.radio_map)
    cells = np.array(struct.unpack(f"<{floor.rows * floor.columns}f", grid.data))
    assert 0.01 < (cells > NO_POSITION_DB).mean() < 0.3
    assert grid.cell_size.x * grid.column_count == pytest.approx(world.hall.size_m[0], abs=0.5)
    assert (grid.pose.position.x, grid.pose.position.y) == pytest.approx((0.0, 0.0))
