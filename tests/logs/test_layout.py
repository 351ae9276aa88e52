"""The Foxglove layout: every panel is in place and shows what the log holds."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from logs.foxglove_view import View
from logs.layout import (
    MAX_TABS,
    ROWS_PER_PANEL,
    build_layout,
    busiest_robots,
    dump_layout,
    message_path,
)
from logs.mcap_reader import read
from logs.mcap_writer import layout_path
from logs.protobuf import CODECS
from tests.logs.mcap_files import write
from tests.logs.sample_run import THRESHOLD_DB, sample_run

TESTED = Path(__file__).resolve().parents[3] / "shared/data/foxglove-layout-minimal.json"


def layout_of(run, **problem) -> dict:
    """The layout of the run, its problem changed."""
    changed = dataclasses.replace(run.problem, **problem)
    return build_layout(run.world, changed, run.radio_map)


def fleet(run, robots: int, aps: int) -> dict:
    """The layout for a fleet of another size (of the problem it uses these three only)."""
    problem = SimpleNamespace(
        robot_ids=tuple(f"r{i:03d}" for i in range(robots)),
        ap_ids=tuple(f"ap{k}" for k in range(aps)),
        ap_capacity=np.full(aps, 15, np.int32),
    )
    return build_layout(run.world, problem, run.radio_map)


def placed(tree, panels) -> list[str]:
    """Panels of a mosaic, those in tabs included."""
    if isinstance(tree, dict):
        assert tree["direction"] in {"row", "column"}
        assert 0 < tree["splitPercentage"] < 100
        return placed(tree["first"], panels) + placed(tree["second"], panels)
    inner = panels[tree].get("tabs", [])
    return [tree, *(name for tab in inner for name in placed(tab["layout"], panels))]


def paths(panels) -> list[str]:
    """Message paths of all panels, level lines left out."""
    found = []
    for name, panel in panels.items():
        found += [p["value"] for p in panel.get("paths", ())]
        found += [panel[key] for key in ("path", "topicPath") if key in panel]
        assert re.fullmatch(r"(3D|Plot|StateTransitions|Table|Gauge|RosOut|Tab)![a-z0-9]+", name)
    return [p for p in found if not p.isdigit()]


@pytest.mark.parametrize(("robots", "aps"), [(1, 1), (50, 4), (300, 16), (1000, 16)])
def test_every_panel_is_in_place_once(robots, aps):
    """Configured panels and those of the mosaic are the same, for small and large fleets."""
    layout = fleet(sample_run(10), robots, aps)
    panels = layout["configById"]
    assert sorted(placed(layout["layout"], panels)) == sorted(panels)


def test_paths_lead_to_fields_of_the_log(tmp_path):
    """Each message path names a topic of the log and a field of its type; scenes are topics."""
    run = sample_run(10)
    file = read(write(tmp_path / "run.mcap", run))
    panels = json.loads(file.layout)["configById"]
    fields = {n: {f.name for f in dataclasses.fields(c.record_type)} for n, c in CODECS.items()}
    for path in paths(panels):
        topic, _, field = path.replace('"', "").partition(".")
        assert not field or field in fields[file.topics[topic]]
    assert panels["3D!hall"]["topics"].keys() <= file.topics.keys()
    assert panels["RosOut!log"]["topicToRender"] in file.topics


def test_the_layout_lies_in_the_log_and_beside_it(tmp_path):
    """`<run>.layout.json` and the attachment are the same JSON, which is what is generated."""
    run = sample_run(10)
    path = write(tmp_path / "run.mcap", run)
    assert layout_path(path).name == "run.layout.json"
    assert layout_path(path).read_text(encoding="utf-8") == read(path).layout
    assert read(path).layout == dump_layout(layout_of(run))  # three robots: no tab of the busiest


def test_the_camera_sees_the_whole_hall():
    """Of halls of any form the nearest corner lies at nine tenths of the view."""
    run = sample_run(10)
    for size in ((12.0, 8.0), (100.0, 10.0), (8.0, 60.0), (40.0, 40.0)):
        hall = run.world.hall.model_copy(update={"size_m": size})
        world = run.world.model_copy(update={"hall": hall})
        panel = build_layout(world, run.problem, run.radio_map)["configById"]["3D!hall"]
        camera = panel["cameraState"]
        tilt = math.radians(camera["phi"])
        forward = np.array([0.0, math.sin(tilt), -math.cos(tilt)])
        up = np.array([0.0, math.cos(tilt), math.sin(tilt)])
        eye = np.array(camera["targetOffset"]) - camera["distance"] * forward
        half = math.tan(math.radians(camera["fovy"] / 2))
        seen = []
        for corner in ((0, 0), (size[0], 0), (0, size[1]), size):
            ray = np.array([*corner, 0.0]) - eye
            depth = ray @ forward
            assert camera["near"] < depth < camera["far"]
            seen.append((ray[0] / depth / half, ray @ up / depth / half))
        largest = np.abs(seen).max()
        assert largest == pytest.approx(0.9, abs=1e-3)


def test_coverage_colours_begin_at_the_threshold():
    """Dark is at or below it; the other end is the best SNR of the map."""
    run = sample_run(10)
    settings = layout_of(run)["configById"]["3D!hall"]["topics"]["/radio/coverage"]
    assert settings["colorField"] == "snr_db"
    assert settings["minValue"] == THRESHOLD_DB
    assert settings["maxValue"] == math.ceil(run.radio_map.snr_db.max())
    nothing = dataclasses.replace(
        run.radio_map, snr_db=np.full_like(run.radio_map.snr_db, -1000.0), threshold_db=12.0
    )
    panels = build_layout(run.world, run.problem, nothing)["configById"]
    settings = panels["3D!hall"]["topics"]["/radio/coverage"]
    assert (settings["minValue"], settings["maxValue"]) == (12.0, 13.0)


def test_loads_are_drawn_against_their_capacities():
    """A line per AP, and a level line per capacity there is."""
    run = sample_run(10)
    plot = layout_of(run, ap_capacity=np.array([3, 15], np.int32))["configById"]["Plot!load"]
    lines = [(p["value"], p["label"]) for p in plot["paths"]]
    assert lines == [
        ("/aps/ap0/load.load", "ap0"),
        ("/aps/ap1/load.load", "ap1"),
        ("3", "capacity 3"),
        ("15", "capacity 15"),
    ]
    assert plot["minYValue"] == 0
    assert plot["maxYValue"] > 15
    assert len({p["color"] for p in plot["paths"][:3]}) == 3


def test_a_small_fleet_has_one_panel_of_associations():
    """A row for every robot."""
    panels = fleet(sample_run(10), 25, 4)["configById"]
    assert "Tab!associations" not in panels
    rows = panels["StateTransitions!ap0"]["paths"]
    assert [p["value"] for p in rows] == [f"/robots/r{i:03d}/state.ap" for i in range(25)]


def test_a_large_fleet_is_cut_into_tabs():
    """Every robot in exactly one tab, as many as a screen shows in each, up to a bound."""
    for robots in (50, 300, 1000):
        panels = fleet(sample_run(10), robots, 16)["configById"]
        tabs = panels["Tab!associations"]["tabs"]
        rows = [p["label"] for tab in tabs for p in panels[tab["layout"]]["paths"]]
        shown = min(robots, MAX_TABS * ROWS_PER_PANEL)
        assert rows == [f"r{i:03d}" for i in range(shown)]
        assert len(tabs) == shown // ROWS_PER_PANEL
        assert tabs[1]["title"] == "r025 – r049"


def test_the_busiest_robots_come_first_in_a_large_fleet():
    """Those with the most planned handovers have a tab before the others."""
    run = sample_run(10)
    assert busiest_robots(run.plan) == ("r1", "r0")  # one handover each, r1 arrives later
    problem = SimpleNamespace(
        robot_ids=tuple(f"r{i:03d}" for i in range(60)),
        ap_ids=("ap0",),
        ap_capacity=np.array([15], np.int32),
    )
    panels = build_layout(run.world, problem, run.radio_map, None, ("r030", "r002"))["configById"]
    first, second = panels["Tab!associations"]["tabs"][:2]
    assert first["title"] == "most handovers"
    assert [p["label"] for p in panels[first["layout"]]["paths"]] == ["r030", "r002"]
    assert second["title"] == "r000 – r024"


def test_many_aps_are_cut_into_tabs():
    """Each AP in exactly one plot, as many lines in each as one can tell apart."""
    panels = fleet(sample_run(10), 50, 16)["configById"]
    tabs = panels["Tab!loads"]["tabs"]
    assert [tab["title"] for tab in tabs] == ["ap0 – ap7", "ap8 – ap15"]
    drawn = [
        p["label"] for tab in tabs for p in panels[tab["layout"]]["paths"] if p["value"] != "15"
    ]
    assert drawn == [f"ap{k}" for k in range(16)]


def test_what_moves_is_visible_and_what_hides_the_hall_is_not():
    """Of all scenes and grids some are switched on at first; every one has its settings."""
    run = sample_run(10)
    topics = layout_of(run)["configById"]["3D!hall"]["topics"]
    view = {t for t in View(**run.inputs).topics if t.startswith(("/scene", "/radio", "/aps"))}
    assert set(topics) == view
    hidden = {topic for topic, settings in topics.items() if not settings["visible"]}
    assert hidden == {"/scene/plan", "/radio/best_server", "/aps/ap0/coverage", "/aps/ap1/coverage"}


@pytest.mark.parametrize(
    ("topic", "path"),
    [
        ("/robots/r-0_a/state", "/robots/r-0_a/state.ap"),
        ("/robots/lift 2/state", '"/robots/lift 2/state".ap'),
        ('/robots/a"b\\c/state', '"/robots/a\\"b\\\\c/state".ap'),
        ("/robots/Zürich/state", '"/robots/Zürich/state".ap'),
    ],
)
def test_unusual_names_are_quoted(topic, path):
    """Foxglove's path grammar knows letters, digits, `_`, `-` and `/` without quotes."""
    assert message_path(topic, "ap") == path


def test_same_run_gives_the_same_text():
    """Byte for byte, and valid JSON."""
    run = sample_run(10)
    text = dump_layout(layout_of(run))
    assert text == dump_layout(layout_of(run))
    assert json.loads(text) == layout_of(run)


def test_it_has_the_form_of_a_layout_foxglove_has_imported():
    """Same top level, and the same settings in each kind of panel that both have."""
    if not TESTED.exists():
        pytest.skip(f"no tested layout at {TESTED}")
    tested, ours = json.loads(TESTED.read_text()), layout_of(sample_run(10))
    assert tested.keys() == ours.keys()
    kinds = {name.split("!")[0]: panel for name, panel in ours["configById"].items()}
    for name, panel in tested["configById"].items():
        assert panel.keys() <= kinds[name.split("!")[0]].keys() | {"minYValue", "maxYValue"}
    camera = ours["configById"]["3D!hall"]["cameraState"]
    assert camera.keys() == tested["configById"]["3D!factory"]["cameraState"].keys()
