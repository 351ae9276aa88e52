"""What Foxglove is shown: the right things, in the right places, as its schemas want them."""

from __future__ import annotations

import dataclasses
import math
from itertools import combinations, pairwise

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from hypothesis import given, settings
from hypothesis import strategies as st

from logs.colors import HANDOVER_COLOR, OUTAGE_COLOR, ap_color, rgb
from logs.foxglove import (
    COVERAGE_HEIGHT_M,
    NO_POSITION_DB,
    Fleet,
    coverage_grid,
    log_line,
    plan_scene,
    robot_body,
    static_scene,
)
from logs.foxglove_pack import Places, Transforms
from logs.foxglove_parts import timestamp
from logs.foxglove_stamp import Stamped
from logs.foxglove_view import TOPICS, View
from logs.mcap_format import EPOCH_NS, time_ns
from logs.records import (
    CONNECTED,
    HANDOVER,
    LINKS,
    NO_AP,
    OUTAGE,
    Arrival,
    Handover,
    Incident,
    RunEnd,
    RunStart,
    Sample,
)
from tests.logs.sample_run import AP_M, COLUMNS, PITCH_M, RACK, ROBOTS, ROWS, sample_run


@pytest.fixture(scope="module")
def run():
    """The sample run."""
    return sample_run(10)


def sample(t_s=1.25, **changed) -> Sample:
    """r0 and lift 2 on the floor, turned, off the raster, served by ap0 and ap1."""
    base = Sample(
        t_s=t_s,
        slot=0,
        robot=(0, 2),
        x_m=(1.0, 3.14159),
        y_m=(0.0, 2.71828),
        heading_rad=(math.pi / 2, -3.0),
        ap=(0, 1),
        snr_db=(20.0, 20.0),
        map_snr_db=(20.0, 20.0),
        link=(LINKS.index(CONNECTED),) * 2,
        rate_mbps=(1.0, 1.0),
    )
    return dataclasses.replace(base, **changed)


def view_of(run, *records) -> dict[str, bytes]:
    """The last message of each topic after RunStart and these records."""
    view = View(**run.inputs)
    shown = {}
    for record in (run.records[0], *records):
        for source in (view.before(record), view.after(record)):
            shown |= {topic: data for topic, _, data in source}
    return shown


def entities(scene: SceneUpdate) -> dict[str, object]:
    """Entities by id, which must be unique on a topic."""
    found = {entity.id: entity for entity in scene.entities}
    assert len(found) == len(scene.entities)
    return found


def color(primitive) -> tuple[float, float, float]:
    """(r, g, b) of a protobuf colour."""
    return primitive.r, primitive.g, primitive.b


# --- moving things ------------------------------------------------------------------------------


def test_transforms_place_every_robot_on_the_raster(run):
    """World → hall, then world → robot for those on the floor, within half a raster step."""
    shown = sample()
    transforms = FrameTransforms.FromString(view_of(run, shown)["/tf"]).transforms
    assert [t.child_frame_id for t in transforms] == ["hall", "r0", "lift 2"]
    assert {t.parent_frame_id for t in transforms} == {"world"}
    assert {t.timestamp.ToNanoseconds() for t in transforms} == {time_ns(shown.t_s)}
    for k, transform in enumerate(transforms[1:]):
        x, y = transform.translation.x, transform.translation.y
        assert (x * 1024, y * 1024) == (round(x * 1024), round(y * 1024))
        assert abs(x - shown.x_m[k]) <= 1 / 2048
        assert abs(y - shown.y_m[k]) <= 1 / 2048
        assert transform.translation.z == 0
        turn = transform.rotation
        assert (turn.x, turn.y) == (0, 0)
        assert 2 * math.atan2(turn.z, turn.w) == pytest.approx(shown.heading_rad[k])
    still = transforms[0]
    assert (still.translation.x, still.translation.y, still.rotation.w) == (0, 0, 1)


def test_packed_messages_are_those_protobuf_would_write(run):
    """Parsed and written by protobuf, packed /tf and links hold the same, no unknown fields."""
    for topic in ("/tf", "/scene/links"):
        data = view_of(run, sample())[topic]
        message = TOPICS[topic].FromString(data)
        again = TOPICS[topic].FromString(message.SerializeToString())
        assert again == message
        message.DiscardUnknownFields()
        assert message == again
        assert message.ByteSize() <= len(data) <= message.ByteSize() + 40  # explicit zeros only


def by_protobuf(robots, x_m, y_m, headings, log_time) -> FrameTransforms:
    """What /tf is to say, made of objects."""
    told = FrameTransforms()
    for name, x, y, heading in zip(
        ("hall", *robots), (0.0, *x_m), (0.0, *y_m), (0.0, *headings), strict=True
    ):
        each = told.transforms.add(parent_frame_id="world", child_frame_id=name)
        each.timestamp.CopyFrom(timestamp(log_time))
        each.translation.x, each.translation.y = (round(c * 1024) / 1024 for c in (x, y))
        each.rotation.z, each.rotation.w = math.sin(heading / 2) + 0.0, math.cos(heading / 2)
    return told


names = st.lists(st.text("aé-9", min_size=1, max_size=70), min_size=1, max_size=6, unique=True)


@settings(max_examples=40, deadline=None)
@given(names, st.data())
def test_transforms_are_those_protobuf_would_make(robots, data):
    """Whoever comes and goes, however long the names, whether there are nanoseconds or not."""
    transforms = Transforms(tuple(robots))
    place = st.floats(-1000.0, 1000.0)
    for _ in range(4):
        there = sorted(data.draw(st.sets(st.integers(0, len(robots) - 1))))
        x, y, turn = (data.draw(st.tuples(*[place for _ in there])) for _ in range(3))
        now = EPOCH_NS + data.draw(st.sampled_from([0, 10**9, 127, 128, 999_999_999]))
        packed = transforms.pack(Places.of(tuple(there), x, y), turn, now)
        expected = by_protobuf([robots[i] for i in there], x, y, turn, now)
        assert FrameTransforms.FromString(packed) == expected


def link_lines(run, **changed) -> list[tuple]:
    """(from, to, colour) of each segment of the links."""
    scene = SceneUpdate.FromString(view_of(run, sample(**changed))["/scene/links"])
    found = []
    for entity in scene.entities:
        assert (entity.id, entity.frame_id) == ("links", "world")
        assert entity.timestamp.ToNanoseconds() == time_ns(sample(**changed).t_s)
        for line in entity.lines:
            assert line.type == LinePrimitive.LINE_LIST
            assert line.pose.orientation.w == 1
            assert len(line.points) == len(line.colors)
            ends = [(p.x, p.y, p.z) for p in line.points]
            colors = [color(c) for c in line.colors]
            assert colors[::2] == colors[1::2]
            found += zip(ends[::2], ends[1::2], colors[::2], strict=True)
    return found


def test_a_connected_robot_has_a_line_in_its_aps_colour(run):
    """From its antenna to the AP's."""
    lines = link_lines(run)
    antenna = run.world.hall.body.antenna_m
    assert [line[1] for line in lines] == list(AP_M)
    assert [line[2] for line in lines] == [ap_color(0), ap_color(1)]
    assert lines[0][0] == (1.0, 0.0, antenna)
    assert lines[1][0] == pytest.approx((3.14159, 2.71828, antenna), abs=1 / 2048)


def test_an_outage_is_red_and_bears_a_bar(run):
    """Red line and red bar over the robot: seen without telling colours apart."""
    lines = link_lines(run, link=(LINKS.index(OUTAGE), LINKS.index(CONNECTED)))
    assert [line[2] for line in lines] == [rgb(OUTAGE_COLOR)] * 2 + [ap_color(1)]
    bar, link = lines[0], lines[1]
    assert bar[0][:2] == bar[1][:2]
    assert bar[1][2] > bar[0][2]
    assert link[1] == AP_M[0]


def test_without_an_ap_only_the_bar_is_left(run):
    """No line leads anywhere."""
    lines = link_lines(run, ap=(-1, 1), link=(LINKS.index(NO_AP), LINKS.index(CONNECTED)))
    assert [line[2] for line in lines] == [rgb(OUTAGE_COLOR), ap_color(1)]


def test_a_handover_is_dashed_in_grey(run):
    """Several dashes with gaps from the robot to the new AP."""
    lines = link_lines(run, link=(LINKS.index(HANDOVER), LINKS.index(CONNECTED)))
    dashes = [line for line in lines if line[2] == rgb(HANDOVER_COLOR)]
    assert len(dashes) == len(lines) - 1 >= 4
    assert dashes[0][0] == (1.0, 0.0, run.world.hall.body.antenna_m)
    assert dashes[-1][1] == pytest.approx(AP_M[0], abs=1 / 1024)
    for one, following in pairwise(dashes):
        assert math.dist(one[1], following[0]) > 0.5 * math.dist(one[0], one[1])


def test_nobody_on_the_floor_shows_nobody(run):
    """§1.4 leave, after the last arrival: no link, no body, but still the frames of the hall."""
    nobody = Sample(9.0, 4, *[()] * 9)
    shown = view_of(run, sample(), nobody)
    assert not SceneUpdate.FromString(shown["/scene/links"]).entities[0].lines
    scene = SceneUpdate.FromString(shown["/scene/robots"])
    assert set(entities(scene)) == {"fleet"}
    assert [d.id for d in scene.deletions] == [f"robot/{name}" for name in ROBOTS]
    frames = FrameTransforms.FromString(shown["/tf"]).transforms
    assert [t.child_frame_id for t in frames] == ["hall"]


def test_bodies_move_with_their_frames(run):
    """Each in its own frame, locked to it, of the body's size, standing on the floor."""
    scene = Fleet(run.world, ROBOTS).scene((0, 2))
    found = entities(SceneUpdate.FromString(scene.at(EPOCH_NS)))
    assert set(found) == {"fleet", "robot/r0", "robot/lift 2"}
    assert found["fleet"].texts[0].text == "2 of 3 robots on the floor"
    body = run.world.hall.body
    for name in ("r0", "lift 2"):
        entity = found[f"robot/{name}"]
        assert (entity.frame_id, entity.frame_locked) == (name, True)
        assert entity.lifetime.ToNanoseconds() == 0
        cube = entity.cubes[0]
        assert (cube.size.x, cube.size.y, cube.size.z) == (
            body.length_m,
            body.width_m,
            body.height_m,
        )
        assert cube.pose.position.z == body.height_m / 2
        assert entity.cubes[1].pose.position.x > 0  # the nose is in front
        assert entity.texts[0].text == name
        assert entity.texts[0].billboard


# --- standing things ----------------------------------------------------------------------------


def test_the_hall_is_drawn_where_it_is(run):
    """Floor, obstacle, APs and stations at their places, with their names."""
    found = entities(static_scene(run.world, run.floor, run.problem))
    floor = found["floor"].cubes[0]
    assert (floor.size.x, floor.size.y) == run.world.hall.size_m
    assert floor.pose.position.z + floor.size.z / 2 == 0

    rack = found["obstacle/0"]
    cube = rack.cubes[0]
    assert (cube.pose.position.x, cube.pose.position.y, cube.pose.position.z) == (5, 3, 1)
    assert (cube.size.x, cube.size.y, cube.size.z) == (1.2, 1.2, 2.0)
    turn = 2 * math.atan2(cube.pose.orientation.z, cube.pose.orientation.w)
    assert turn == pytest.approx(math.pi / 2)
    assert rack.texts[0].text == "rack"
    assert {m.key: m.value for m in rack.metadata} == {"name": "rack"}

    for k, place in enumerate(AP_M):
        ap = found[f"ap/ap{k}"]
        position = ap.cubes[0].pose.position
        assert (position.x, position.y, position.z) == place
        assert color(ap.cubes[0].color) == ap_color(k)
        assert ap.texts[0].text == f"ap{k} (m = 3)"

    dock, gate = (found[f"station/{n}"].cylinders[0].pose.position for n in ("dock", "gate"))
    assert (dock.x, dock.y) == (11.0, 7.0)
    assert (gate.x, gate.y) == (1.0, 1.0)
    assert all(e.frame_id == "world" for e in found.values())


def test_an_ap_that_is_off_is_grey(run):
    """It is in the world, not in the problem."""
    off = run.world.ap[0].model_copy(update={"id": "spare", "enabled": False})
    world = run.world.model_copy(update={"ap": (*run.world.ap, off)})
    found = entities(static_scene(world, run.floor, run.problem))["ap/spare"]
    assert found.texts[0].text == "spare (off)"
    assert len(set(color(found.cubes[0].color))) == 1


def test_the_graph_has_one_line_per_edge(run):
    """§1.8: the edges of G, from vertex to vertex by index."""
    line = entities(static_scene(run.world, run.floor, run.problem))["graph"].lines[0]
    assert line.type == LinePrimitive.LINE_LIST
    pairs = np.array(line.indices).reshape(-1, 2)
    np.testing.assert_array_equal(pairs, run.problem.edge_uv)
    places = np.array([(p.x, p.y) for p in line.points])
    np.testing.assert_array_equal(places, run.problem.xy_m)


def on_line(place, a, b) -> bool:
    """Whether a place lies between a and b."""
    return math.dist(a, place) + math.dist(place, b) == pytest.approx(math.dist(a, b))


def test_paths_are_coloured_by_the_serving_ap(run):
    """One entity per path; each line ends where the next AP takes over (§1.6)."""
    found = entities(plan_scene(run.problem, run.plan))
    assert set(found) == {"path/r0", "path/r1"}
    path = run.plan.paths[1]
    lines = found["path/r1"].lines
    assert [color(line.color) for line in lines] == [ap_color(1), ap_color(0)]
    drawn = [[(p.x, p.y) for p in line.points] for line in lines]
    assert drawn[0][-1] == drawn[1][0]
    visited = [tuple(run.problem.xy_m[v]) for v in path.vertices]
    moves = [p for k, p in enumerate(visited) if k == 0 or p != visited[k - 1]]
    corners = drawn[0] + drawn[1][1:]  # waits and places on a straight line are not drawn
    assert corners[0] == moves[0]
    assert corners[-1] == moves[-1]
    assert len(corners) < len(moves)
    ways = list(pairwise(corners))
    assert all(any(on_line(place, *way) for way in ways) for place in moves)
    assert set(corners) <= set(moves)
    ball = found["path/r1"].spheres[0].pose.position
    change = int(np.flatnonzero(np.diff(path.aps))[0]) + 1
    assert (ball.x, ball.y) == visited[change]


def test_coverage_is_the_best_snr_row_by_row(run):
    """One float32 per position of the grid, rows along y, the blocked one far below all colours."""
    grid = Grid.FromString(Stamped.of(coverage_grid(run.floor, run.radio_map)).at(EPOCH_NS))
    assert (grid.column_count, grid.cell_stride, grid.row_stride) == (COLUMNS, 4, 4 * COLUMNS)
    assert [(f.name, f.offset, f.type) for f in grid.fields] == [("snr_db", 0, 7)]
    cells = np.frombuffer(grid.data, "<f4").reshape(ROWS, COLUMNS)
    assert cells[RACK[1], RACK[0]] == NO_POSITION_DB
    for vertex, (column, row) in enumerate(run.floor.vertex_cell):
        expected = run.radio_map.snr_db[vertex].max()
        assert cells[row, column] == np.float32(expected)
    corner = grid.pose.position
    assert (corner.x, corner.y, corner.z) == (0.0, 0.0, COVERAGE_HEIGHT_M)
    assert (grid.cell_size.x, grid.cell_size.y) == (PITCH_M, PITCH_M)
    assert (grid.frame_id, grid.timestamp.ToNanoseconds()) == ("world", EPOCH_NS)


def test_the_grid_is_laid_from_the_first_position_even_if_it_is_blocked(run):
    """The origin follows from any vertex and its cell."""
    floor = dataclasses.replace(
        run.floor, vertex_xy_m=run.floor.vertex_xy_m[7:], vertex_cell=run.floor.vertex_cell[7:]
    )
    assert floor.origin_m == run.floor.origin_m == (1.0, 1.0)


def test_every_timestamp_is_that_of_the_message(run):
    """Entities and deletions alike, whenever the scene is written again."""
    scene = Fleet(run.world, ROBOTS).scene((1,))
    for t_s in (0.0, 60.5):
        again = SceneUpdate.FromString(scene.at(time_ns(t_s)))
        stamps = {p.timestamp.ToNanoseconds() for p in (*again.entities, *again.deletions)}
        assert stamps == {time_ns(t_s)}
        assert len(again.deletions) == 2


def test_a_stamped_message_is_what_protobuf_would_write(run):
    """Byte for byte: scenes, grids, and the bodies of all robots, which are packed from a model."""
    scene = SceneUpdate(entities=[robot_body(run.world, name) for name in ROBOTS])
    scene.deletions.add(id="robot/x")
    grid = coverage_grid(run.floor, run.radio_map)
    for log_time in (EPOCH_NS, time_ns(0.7), time_ns(61.000001)):
        for message in (scene, grid):
            stamped = Stamped.of(message).at(log_time)
            again = type(message).FromString(stamped)
            parts = [*again.entities, *again.deletions] if message is scene else [again]
            assert {part.timestamp.ToNanoseconds() for part in parts} == {log_time}
            assert again.SerializeToString(deterministic=True) == stamped
        told = SceneUpdate.FromString(Fleet(run.world, ROBOTS).scene(range(3)).at(log_time))
        assert told.SerializeToString(deterministic=True) == (
            Fleet(run.world, ROBOTS).scene(range(3)).at(log_time)
        )
        for body in told.entities:
            body.ClearField("timestamp")
        assert list(told.entities[1:]) == list(scene.entities)


def test_ap_colours_differ_and_none_is_the_outage_red():
    """Up to 18 APs have different colours, all far from the red of an outage."""
    colors = [ap_color(k) for k in range(18)]
    assert min(math.dist(a, b) for a, b in combinations(colors, 2)) > 0.1
    assert min(math.dist(c, rgb(OUTAGE_COLOR)) for c in colors) > 0.3
    assert all(0 <= part <= 1 for c in colors for part in c)


# --- log lines ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("record", "level", "name", "words"),
    [
        (
            Handover(2.0, 1, "r0", "ap0", "ap1", 3, 4, 1.0, 1.0, 2.07, planned=True),
            Log.INFO,
            "r0",
            "handover ap0 → ap1 at vertex 3 → 4, 70 ms",
        ),
        (
            Handover(2.0, 1, "r0", "ap0", "ap1", 3, 3, 1.0, 1.0, 3.0, planned=False),
            Log.WARNING,
            "r0",
            "handover ap0 → ap1 at vertex 3, 1000 ms, not in the plan",
        ),
        (Arrival(2.0, 1, "r1", 7), Log.INFO, "r1", "arrived at vertex 7 in slot 1"),
        (
            Incident(2.0, 1, "outage", "r1", "", "ap1", 2.0, "for 2 s"),
            Log.WARNING,
            "r1",
            "outage: for 2 s",
        ),
        (
            Incident(2.0, 1, "overload", "", "", "ap1", 4.0, "4 of 3"),
            Log.WARNING,
            "ap1",
            "overload: 4 of 3",
        ),
        (
            Incident(2.0, 1, "collision", "r0", "r1", "", 0.0, "at vertex 5"),
            Log.ERROR,
            "r0",
            "collision: at vertex 5",
        ),
        (RunEnd(2.0, 10, "completed", ""), Log.INFO, "run", "completed in slot 10"),
        (RunEnd(2.0, 10, "failed", "stuck"), Log.ERROR, "run", "failed in slot 10: stuck"),
    ],
)
def test_log_lines_tell_what_happened(record, level, name, words):
    """Name of the robot or AP, the level that fits, one sentence."""
    line = log_line(record, time_ns(record.t_s))
    assert (line.level, line.name, line.message) == (level, name, words)
    assert line.timestamp == timestamp(time_ns(2.0))


def test_a_run_begins_with_a_line_and_states_have_none(run):
    """Only events are told, or the panel would scroll by."""
    start = log_line(run.records[0], EPOCH_NS)
    assert isinstance(run.records[0], RunStart)
    assert start.message == "sample hall: 3 robots, 2 APs"
    assert log_line(sample(), EPOCH_NS) is None
