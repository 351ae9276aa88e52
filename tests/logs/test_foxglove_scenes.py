"""Scenes that tell what goes on: ways ahead and behind, events, disturbances, coverage by AP."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from logs.colors import HANDOVER_COLOR, OUTAGE_COLOR, ap_color, rgb
from logs.foxglove import best_server_grid, coverage_grid, log_line
from logs.foxglove_marks import MAX_MARKS, SHOWN_S
from logs.foxglove_paths import AHEAD, TRAIL, Paths
from logs.foxglove_view import View
from logs.mcap_format import time_ns
from logs.mcap_reader import read
from logs.records import (
    GONE,
    Blockages,
    Disturbance,
    Handover,
    Incident,
    NewPath,
    Replan,
    RobotState,
    Sample,
)
from tests.logs.mcap_files import LONG, write
from tests.logs.sample_run import AP_M, sample_run

SCENES = ("/scene/paths", "/scene/disturbances", "/scene/events")


@pytest.fixture(scope="module")
def run():
    """The sample run."""
    return sample_run(10)


def shown(run, records) -> dict[str, SceneUpdate]:
    """The last scene of each topic after RunStart and these records."""
    view = View(**run.inputs)
    found = {}
    for record in (run.records[0], *records):
        for source in (view.before(record), view.after(record)):
            for topic, time, data in source:
                if topic.startswith("/scene/"):
                    found[topic] = SceneUpdate.FromString(data)
                    stamps = {e.timestamp.ToNanoseconds() for e in found[topic].entities}
                    assert stamps == {time}
    return found


def states(run, slot: int) -> list:
    """What the run records of the beginning of a slot, with its first sample."""
    found = [r for r in run.records if isinstance(r, RobotState) and r.slot == slot]
    sample = next(r for r in run.records if isinstance(r, Sample) and r.slot == slot)
    return [*(r for r in found if r.t_s <= sample.t_s), sample]


def segments(scene: SceneUpdate) -> list[tuple]:
    """(from, to, colour) of each line of the only entity."""
    (entity,) = scene.entities
    assert not scene.deletions
    found = []
    for line in entity.lines:
        points = [(p.x, p.y) for p in line.points]
        colors = [(c.r, c.g, c.b) for c in line.colors]
        assert len(points) == len(colors)
        found += zip(points[::2], points[1::2], colors[::2], strict=True)
    return found


def covered(run, lines, vertices) -> bool:
    """Whether lines lead over all these vertices, in any order."""
    places = run.problem.xy_m[list(vertices)]
    for x, y in places:
        hits = [
            min(ax, bx) - 1e-9 <= x <= max(ax, bx) + 1e-9
            and min(ay, by) - 1e-9 <= y <= max(ay, by) + 1e-9
            for (ax, ay), (bx, by), _ in lines
        ]
        if not any(hits):
            return False
    return True


# --- ways -----------------------------------------------------------------------------------------


def test_the_way_ahead_has_the_colours_of_the_aps_to_come(run):
    """At the start all of the path is ahead, and nothing behind."""
    lines = segments(shown(run, states(run, 0))["/scene/paths"])
    path = run.plan.paths[0]
    own = [line for line in lines if line[2] in {ap_color(0), ap_color(1)}]
    assert own == lines
    assert covered(run, lines, path.vertices)
    first = tuple(run.problem.xy_m[path.vertices[0]])
    (begin,) = (line for line in lines if line[0] == first and line[2] == ap_color(path.aps[0]))
    assert begin


def test_what_was_driven_is_behind(run):
    """In slot 5 of r0: five states in grey behind it, the rest ahead in colour."""
    lines = segments(shown(run, [*states(run, 4), *states(run, 5)])["/scene/paths"])
    path = run.plan.paths[0]
    here = tuple(run.problem.xy_m[path.vertices[5]])
    grey = [line for line in lines if line[2] not in {ap_color(0), ap_color(1)}]
    bright = [line for line in lines if line[2] in {ap_color(0), ap_color(1)}]
    assert any(line[1] == here for line in grey)
    assert covered(run, grey, path.vertices[:6])
    assert covered(run, bright, path.vertices[5:])


def test_a_robot_that_left_has_no_way(run):
    """After GONE nothing of it is drawn any more."""
    gone = [r for r in run.records if isinstance(r, RobotState) and r.activity == GONE]
    assert gone
    paths = Paths(run.problem, run.plan)
    for state in (r for r in run.records if isinstance(r, RobotState) and r.robot == "r0"):
        paths.state(state)
    assert paths.pack() == b""


def test_a_new_path_takes_the_place_of_what_was_ahead(run):
    """From its slot on the new way is ahead; what was driven stays behind."""
    path = run.plan.paths[0]
    here, back = int(path.vertices[2]), path.vertices[2::-1]
    edges = path.edges[1::-1]
    new = NewPath(
        4.0, 2, 1, "r0", tuple(map(int, back)), (0,) * len(back), tuple(map(int, edges)), 0, True
    )
    sample = dataclasses.replace(states(run, 2)[-1], t_s=4.0)
    told = [*states(run, 0), *states(run, 1), *states(run, 2)[:-1], new, sample]
    lines = segments(shown(run, told)["/scene/paths"])
    own = [line for line in lines if line[2] == ap_color(0)]
    assert covered(run, own, back)
    assert not covered(run, own, path.vertices[5:6])
    trail = [line for line in lines if line[2] not in {ap_color(0), ap_color(1)}]
    assert any(line[1] == tuple(run.problem.xy_m[here]) for line in trail)


def test_long_ways_are_cut(run):
    """No more than `AHEAD` states ahead and `TRAIL` behind, so that the log stays small."""
    ring = np.array([0, 1] * 100, np.int32)
    edge = int(np.flatnonzero((run.problem.edge_uv == [0, 1]).all(axis=1))[0])
    paths = Paths(run.problem, run.plan)
    state = next(r for r in run.records if isinstance(r, RobotState) and r.robot == "r0")
    paths.state(dataclasses.replace(state, visit=0))
    paths.new_path(
        NewPath(0.0, 0, 1, "r0", tuple(ring.tolist()), (0,) * 200, (edge,) * 199, 0, False)
    )
    paths.state(dataclasses.replace(state, visit=100))
    scene = SceneUpdate.FromString(paths.scene(paths.pack(), time_ns(0.0)))
    assert len(segments(scene)) == AHEAD + TRAIL


# --- marks ----------------------------------------------------------------------------------------


def texts(scene: SceneUpdate) -> list[str]:
    """What is written in the only entity of a scene."""
    (entity,) = scene.entities
    assert not scene.deletions
    return [text.text for text in entity.texts]


def at(run, t_s: float) -> Sample:
    """A sample then, everybody where the first sample has them."""
    return dataclasses.replace(states(run, 0)[-1], t_s=t_s)


def test_events_are_marked_where_they_happen_and_for_a_while(run):
    """A handover at its place, an outage at its robot, gone after `SHOWN_S`."""
    handover = Handover(0.5, 0, "r0", "ap0", "ap1", 3, 4, 3.25, 1.5, 0.57, planned=True)
    outage = Incident(0.5, 0, "outage", "r1", "", "ap1", 2.0, "for 2 s")
    told = [at(run, 0.0), handover, outage, at(run, 1.0)]
    scene = shown(run, told)["/scene/events"]
    assert texts(scene) == ["ap0 → ap1", "r1 outage"]
    first, second = (s.pose.position for s in scene.entities[0].spheres)
    assert (first.x, first.y) == (3.25, 1.5)
    sample = at(run, 0.0)
    assert (second.x, second.y) == (sample.x_m[1], sample.y_m[1])
    colors = [(s.color.r, s.color.g, s.color.b) for s in scene.entities[0].spheres]
    assert colors == [rgb(HANDOVER_COLOR), rgb(OUTAGE_COLOR)]
    later = shown(run, [*told, at(run, 0.6 + SHOWN_S)])["/scene/events"]
    assert texts(later) == []
    assert [e.id for e in later.entities] == ["events"]


def test_events_without_a_robot_are_marked_at_their_ap_or_above_the_hall(run):
    """An overload stands at its AP, a new plan above the hall; no more than `MAX_MARKS` in all."""
    overload = Incident(0.5, 0, "overload", "", "", "ap1", 4.0, "4 of 3")
    replan = Replan(0.5, 0, 1, "ap-outage", "ap1", True, (0,), (), 10, 12, "ap1 is out")
    scene = shown(run, [at(run, 0.0), overload, replan, at(run, 1.0)])["/scene/events"]
    assert texts(scene) == ["ap1 overload", "new plan (ap-outage ap1)"]
    place = scene.entities[0].spheres[0].pose.position
    assert (place.x, place.y, place.z) == AP_M[1]
    many = shown(run, [at(run, 0.0), *[overload] * 200, at(run, 1.0)])["/scene/events"]
    assert len(texts(many)) == MAX_MARKS


def test_blockages_are_boxes_where_they_are_now(run):
    """Each record tells all of them; one that tells none clears them."""
    one = Blockages(0.5, 0, ("fork-lift",), (3.0,), (2.0,), (1.0,), (0.5,), (2.5,), (1.2,), (2.0,))
    scene = shown(run, [at(run, 0.0), one, at(run, 0.5)])["/scene/disturbances"]
    (box,) = scene.entities[0].cubes
    assert (box.pose.position.x, box.pose.position.y, box.pose.position.z) == (3.0, 2.0, 1.0)
    assert (box.size.x, box.size.y, box.size.z) == (2.5, 1.2, 2.0)
    assert 2 * np.arctan2(box.pose.orientation.z, box.pose.orientation.w) == pytest.approx(0.5)
    assert texts(scene) == ["fork-lift"]
    none = Blockages(1.0, 0, (), (), (), (), (), (), (), ())
    after = shown(run, [at(run, 0.0), one, at(run, 0.5), none, at(run, 1.0)])
    assert texts(after["/scene/disturbances"]) == []


def test_what_is_out_failed_or_late_is_marked_as_long_as_it_is(run):
    """An AP that is out, a failed robot, a late one; over when the record says so."""

    def disturbance(kind, begins=True, robot="", ap="", until_s=-1.0):
        return Disturbance(0.5, 0, kind, "", robot, ap, begins, 1, until_s, kind)

    told = [
        at(run, 0.0),
        disturbance("ap-outage", ap="ap0"),
        disturbance("robot-failure", robot="r0"),
        disturbance("delay", robot="r1", until_s=2.0),
        at(run, 1.0),
    ]
    now = shown(run, told)["/scene/disturbances"]
    assert texts(now) == ["ap0: out", "r0: failed", "r1: late"]
    later = [*told, disturbance("ap-outage", begins=False, ap="ap0"), at(run, 2.0)]
    assert texts(shown(run, later)["/scene/disturbances"]) == ["r0: failed"]


def test_disturbances_and_new_plans_have_log_lines():
    """Who is concerned, and what is said of it."""
    out = Disturbance(2.0, 1, "ap-outage", "storm", "", "ap1", True, 0, 9.0, "ap1 serves nobody")
    line = log_line(out, time_ns(2.0))
    assert (line.name, line.message) == ("ap1", "ap-outage: ap1 serves nobody")
    replan = Replan(2.0, 1, 3, "blockage", "pallet", False, (), (), 0, 0, "no better way")
    assert log_line(replan, time_ns(2.0)).message == "replan 3 (blockage): no better way"


def test_a_seek_to_any_instant_shows_all_scenes(tmp_path):
    """Each scene that changes is one entity, told as a whole, and again every minute (page 6)."""
    log = read(write(tmp_path / "run.mcap", sample_run(LONG)))
    times = {topic: [] for topic in SCENES}
    for message in log.iter_messages({"foxglove.SceneUpdate"}):
        if message.topic in times:
            scene = SceneUpdate.FromString(message.data)
            assert [e.id for e in scene.entities] == [message.topic.removeprefix("/scene/")]
            assert not scene.deletions
            times[message.topic].append(message.log_time_ns)
    for topic in SCENES:
        assert times[topic][0] == time_ns(0.0), topic
        assert {time_ns(60.0), time_ns(120.0)} <= set(times[topic]), topic


# --- coverage by AP -------------------------------------------------------------------------------


def test_every_ap_has_its_own_coverage(run):
    """One grid per AP with its SNR, on a topic of its own."""
    topics = View(**run.inputs).topics
    assert {"/aps/ap0/coverage", "/aps/ap1/coverage", "/radio/best_server"} <= set(topics)
    grid = run.floor.vertex_grid()
    for k in range(2):
        cells = np.frombuffer(coverage_grid(run.floor, run.radio_map, k).data, "<f4")
        found = cells.reshape(grid.shape)[grid >= 0]
        np.testing.assert_allclose(found, run.radio_map.snr_db[:, k].astype("<f4"))


def test_the_best_server_has_its_colour_where_it_covers(run):
    """Colour and index of the AP of highest SNR (§1.10, snr); clear where none covers."""
    snr = run.radio_map.snr_db.copy()
    snr[7] = -50.0
    dark = dataclasses.replace(run.radio_map, snr_db=snr)
    message = best_server_grid(run.floor, dark)
    assert [f.name for f in message.fields] == ["red", "green", "blue", "alpha", "ap"]
    assert message.cell_stride == 5
    grid = run.floor.vertex_grid()
    cells = np.frombuffer(message.data, np.uint8).reshape(*grid.shape, 5)
    for vertex, (row, column) in zip(grid[grid >= 0], np.argwhere(grid >= 0).tolist(), strict=True):
        red, green, blue, alpha, ap = cells[row, column].tolist()
        if vertex == 7:
            assert (alpha, ap) == (0, 255)
        else:
            best = int(snr[vertex].argmax())
            assert ap == best
            assert (red, green, blue) == tuple(round(255 * c) for c in ap_color(best))
    assert cells[grid < 0, 3].max(initial=0) == 0
