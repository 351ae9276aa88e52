"""What Foxglove is shown and when: follows the records and says which messages go beside them.

Rules (docs of the log, "what Foxglove needs"): every message tells its topic's whole picture, since
a seek delivers the last one of each topic only; statics come again every `REPEAT_S`; transforms
come before scenes of the same instant; a robot that has left the floor is in no transform and no
scene any more. A scene that changes is one entity that replaces the one before it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from logs.errors import LogError
from logs.foxglove import (
    ap_positions,
    best_server_grid,
    congestion_grid,
    coverage_grid,
    log_line,
    plan_scene,
    robot_body,
    robots_scene,
    stamp,
    static_scene,
)
from logs.foxglove_marks import Marks
from logs.foxglove_pack import Links, Places, Transforms, snap
from logs.foxglove_parts import HALL_FRAME, WORLD_FRAME
from logs.foxglove_paths import Paths
from logs.mcap_format import time_ns
from logs.records import NewPath, Record, RobotState, RunEnd, RunStart, Sample
from planner.plan import Plan
from planner.problem import Problem
from worlds.floor import Floor
from worlds.radio_map import RadioMap
from worlds.world import World

REPEAT_S = 60.0
"""Statics are written again this often [s]."""
AP_COVERAGE = "/aps/{ap}/coverage"
"""Topic of the coverage by one AP."""

TOPICS: dict[str, Any] = {
    "/tf": FrameTransforms,
    "/scene/static": SceneUpdate,
    "/scene/plan": SceneUpdate,
    "/radio/coverage": Grid,
    "/radio/best_server": Grid,
    AP_COVERAGE: Grid,
    "/radio/congestion": Grid,
    "/scene/robots": SceneUpdate,
    "/scene/links": SceneUpdate,
    "/scene/paths": SceneUpdate,
    "/scene/disturbances": SceneUpdate,
    "/scene/events": SceneUpdate,
    "/log": Log,
}
"""Topic → message class, in the order in which messages of one instant are written.

`View.topics` has one topic per AP for `AP_COVERAGE`; `/radio/congestion` is there only if the plan
has prices.
"""

Out = tuple[str, int, bytes]
"""(topic, log time [ns], bytes of the message)."""


class View:
    """Follows a run record by record."""

    def __init__(
        self, world: World, floor: Floor, radio_map: RadioMap, problem: Problem, plan: Plan
    ) -> None:
        """Prepare what never changes.

        Raises:
            LogError: a robot bears the name of a fixed frame.
        """
        for name in problem.robot_ids:
            if name in {WORLD_FRAME, HALL_FRAME}:
                raise LogError(
                    f"robot {name!r}: that is the name of a fixed frame of the log; call the robot"
                    " something else"
                )
        self._world = world
        self.topics: dict[str, Any] = {}
        for topic, message_class in TOPICS.items():
            if topic == AP_COVERAGE:
                self.topics |= {topic.format(ap=ap): message_class for ap in problem.ap_ids}
            elif topic != "/radio/congestion" or plan.prices is not None:
                self.topics[topic] = message_class
        self._statics = [
            ("/scene/static", static_scene(world, floor, problem)),
            ("/scene/plan", plan_scene(problem, plan)),
            ("/radio/coverage", coverage_grid(floor, radio_map)),
            ("/radio/best_server", best_server_grid(floor, radio_map)),
            *(
                (AP_COVERAGE.format(ap=ap), coverage_grid(floor, radio_map, k))
                for k, ap in enumerate(problem.ap_ids)
            ),
        ]
        if plan.prices is not None:
            congestion = congestion_grid(floor, radio_map, problem, plan.prices)
            self._statics.append(("/radio/congestion", congestion))
        aps = ap_positions(world, problem.ap_ids)
        self._bodies = [robot_body(world, name) for name in problem.robot_ids]
        self._fleet = SceneUpdate()
        self._transforms = Transforms(problem.robot_ids)
        self._links = Links(aps, world.hall.body.antenna_m)
        self._paths = Paths(problem, plan)
        self._marks = Marks(world, dict(zip(problem.ap_ids, aps, strict=True)), problem.robot_ids)
        self._on_floor: tuple[int, ...] | None = None
        self._link_lines: bytes | None = None
        self._path_lines: bytes | None = None
        self._shown: dict[str, bytes] = {}  # scenes of marks, without a time
        self._slot = -1
        self._next_ns: int | None = None  # of the statics

    def before(self, record: Record) -> Iterator[Out]:
        """Messages due between the last record and this one."""
        now = time_ns(record.t_s)
        while self._next_ns is not None and self._next_ns < now:
            yield from self._repeat(self._next_ns)

    def after(self, record: Record) -> Iterator[Out]:
        """Messages that show this record."""
        now = time_ns(record.t_s)
        self._marks.add(record)
        line = log_line(record, now)
        if line is not None:
            yield "/log", now, line.SerializeToString(deterministic=True)
        match record:
            case RunStart():
                yield "/tf", now, self._transforms.pack(Places((), (), ()), (), now)
                self._next_ns = now
                yield from self._repeat(now)
            case Sample():
                yield from self._sample(record, now)
            case RobotState():
                self._paths.state(record)
            case NewPath():
                self._paths.new_path(record)
            case RunEnd():
                yield from self._mark_scenes(record.t_s, now)
            case _:
                pass

    def _repeat(self, now: int) -> Iterator[Out]:
        """Everything that stands still, and the scenes as they were last."""
        for topic, message in self._statics:
            yield topic, now, stamp(message, now)
        if self._on_floor is not None:
            yield "/scene/robots", now, stamp(self._fleet, now)
        if self._link_lines is not None:
            yield "/scene/links", now, self._links.scene(self._link_lines, now)
        if self._path_lines is not None:
            yield "/scene/paths", now, self._paths.scene(self._path_lines, now)
        for topic, data in self._shown.items():
            yield topic, now, stamp(SceneUpdate.FromString(data), now)
        self._next_ns = now + round(REPEAT_S * 1e9)

    def _sample(self, sample: Sample, now: int) -> Iterator[Out]:
        places = Places(sample.robot, [snap(x) for x in sample.x_m], [snap(y) for y in sample.y_m])
        yield "/tf", now, self._transforms.pack(places, sample.heading_rad, now)
        lines = self._links.pack(places, sample.ap, sample.link)
        moved, self._link_lines = lines != self._link_lines, lines
        changed = sample.robot != self._on_floor
        if changed:
            self._fleet = robots_scene(self._world, self._bodies, sample.robot)
            self._on_floor = sample.robot
        if sample.slot != self._slot:  # all states of the slot have been told
            self._slot = sample.slot
            ways = self._paths.pack()
            advanced, self._path_lines = ways != self._path_lines, ways
        else:
            advanced = False
        if self._next_ns is not None and self._next_ns <= now:
            self._update_marks(sample.t_s)
            yield from self._repeat(now)
            return
        if changed:
            yield "/scene/robots", now, stamp(self._fleet, now)
        if moved:
            yield "/scene/links", now, self._links.scene(lines, now)
        if advanced and self._path_lines is not None:
            yield "/scene/paths", now, self._paths.scene(self._path_lines, now)
        yield from self._mark_scenes(sample.t_s, now)

    def _mark_scenes(self, t_s: float, now: int) -> Iterator[Out]:
        """The scenes of marks that are not as they were."""
        for topic in self._update_marks(t_s):
            yield topic, now, stamp(SceneUpdate.FromString(self._shown[topic]), now)

    def _update_marks(self, t_s: float) -> list[str]:
        """Which of these scenes have changed."""
        scenes = {
            "/scene/disturbances": self._marks.disturbances(t_s),
            "/scene/events": self._marks.events(t_s),
        }
        changed = []
        for topic, scene in scenes.items():
            data = scene.SerializeToString(deterministic=True)
            if self._shown.get(topic) != data:
                self._shown[topic] = data
                changed.append(topic)
        return changed
