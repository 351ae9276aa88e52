"""What Foxglove is shown and when: follows the records and says which messages go beside them.

Rules (docs of the log, "what Foxglove needs"): every message tells its topic's whole picture, since
a seek delivers the last one of each topic only; statics come again every `REPEAT_S`; transforms
come before scenes of the same instant; a robot that has left the floor is in no transform and no
scene any more. A scene that changes is one entity that replaces the one before it.
"""

from __future__ import annotations

from typing import Any

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from logs.errors import LogError
from logs.foxglove import (
    Fleet,
    ap_positions,
    best_server_grid,
    congestion_grid,
    coverage_grid,
    log_line,
    plan_scene,
    static_scene,
)
from logs.foxglove_marks import Marks
from logs.foxglove_pack import Links, Places, Transforms
from logs.foxglove_parts import HALL_FRAME, WORLD_FRAME
from logs.foxglove_paths import Paths
from logs.foxglove_stamp import Stamped, packed
from logs.mcap_format import time_ns
from logs.records import (
    ApLoad,
    Kpi,
    NewPath,
    Record,
    RobotState,
    RunEnd,
    RunStart,
    Sample,
    Separation,
)
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
        self.topics: dict[str, Any] = {}
        for topic, message_class in TOPICS.items():
            if topic == AP_COVERAGE:
                self.topics |= {topic.format(ap=ap): message_class for ap in problem.ap_ids}
            elif topic != "/radio/congestion" or plan.prices is not None:
                self.topics[topic] = message_class
        statics: dict[str, Any] = {
            "/scene/static": static_scene(world, floor, problem),
            "/scene/plan": plan_scene(problem, plan),
            "/radio/coverage": coverage_grid(floor, radio_map),
            "/radio/best_server": best_server_grid(floor, radio_map),
        }
        for k, ap in enumerate(problem.ap_ids):
            statics[AP_COVERAGE.format(ap=ap)] = coverage_grid(floor, radio_map, k)
        if plan.prices is not None:
            congestion = congestion_grid(floor, radio_map, problem, plan.prices)
            statics["/radio/congestion"] = congestion
        self._statics = {topic: Stamped.of(message) for topic, message in statics.items()}
        aps = ap_positions(world, problem.ap_ids)
        self._fleet = Fleet(world, problem.robot_ids)
        self._transforms = Transforms(problem.robot_ids)
        self._links = Links(aps, world.hall.body.antenna_m)
        self._paths = Paths(problem, plan)
        self._marks = Marks(world, dict(zip(problem.ap_ids, aps, strict=True)), problem.robot_ids)
        self._on_floor: tuple[int, ...] | None = None
        self._robots = Stamped(())
        self._link_lines: bytes | None = None
        self._path_lines: bytes | None = None
        self._shown: dict[str, Stamped] = {}  # scenes of marks
        self._mark_bytes: dict[str, bytes] = {}  # their bytes at time 0
        self._slot = -1
        self._next_ns: int | None = None  # of the statics

    def before(self, record: Record) -> list[Out]:
        """Messages due between the last record and this one."""
        out: list[Out] = []
        if self._next_ns is not None:
            now = time_ns(record.t_s)
            while self._next_ns < now:
                out += self._repeat(self._next_ns)
        return out

    def after(self, record: Record) -> list[Out]:
        """Messages that show this record."""
        match record:
            case RobotState():
                self._paths.state(record)
                return []
            case Sample():
                self._marks.add(record)
                return self._sample(record, time_ns(record.t_s))
            case ApLoad() | Separation() | Kpi():
                return []
            case _:
                return self._told(record, time_ns(record.t_s))

    def _told(self, record: Record, now: int) -> list[Out]:
        """Messages that show a record that does not come in every slot."""
        self._marks.add(record)
        out: list[Out] = []
        line = log_line(record, now)
        if line is not None:
            out.append(("/log", now, packed(line)))
        match record:
            case RunStart():
                nobody = Places.of((), (), ())
                out.append(("/tf", now, self._transforms.pack(nobody, (), now)))
                out += self._repeat(now)
            case NewPath():
                self._paths.new_path(record)
            case RunEnd():
                out += self._mark_scenes(record.t_s, now)
            case _:
                pass
        return out

    def _repeat(self, now: int) -> list[Out]:
        """Everything that stands still, and the scenes as they were last."""
        out = [(topic, now, message.at(now)) for topic, message in self._statics.items()]
        if self._on_floor is not None:
            out.append(("/scene/robots", now, self._robots.at(now)))
        if self._link_lines is not None:
            out.append(("/scene/links", now, self._links.scene(self._link_lines, now)))
        if self._path_lines is not None:
            out.append(("/scene/paths", now, self._paths.scene(self._path_lines, now)))
        out += [(topic, now, scene.at(now)) for topic, scene in self._shown.items()]
        self._next_ns = now + round(REPEAT_S * 1e9)
        return out

    def _sample(self, sample: Sample, now: int) -> list[Out]:
        places = Places.of(sample.robot, sample.x_m, sample.y_m)
        out = [("/tf", now, self._transforms.pack(places, sample.heading_rad, now))]
        lines = self._links.pack(places, sample.ap, sample.link)
        moved, self._link_lines = lines != self._link_lines, lines
        changed = sample.robot != self._on_floor
        if changed:
            self._robots = self._fleet.scene(sample.robot)
            self._on_floor = sample.robot
        advanced = False
        if sample.slot != self._slot:  # all states of the slot have been told
            self._slot = sample.slot
            ways = self._paths.pack()
            advanced, self._path_lines = ways != self._path_lines, ways
        if self._next_ns is not None and self._next_ns <= now:
            self._update_marks(sample.t_s)
            return out + self._repeat(now)
        if changed:
            out.append(("/scene/robots", now, self._robots.at(now)))
        if moved:
            out.append(("/scene/links", now, self._links.scene(lines, now)))
        if advanced and self._path_lines is not None:
            out.append(("/scene/paths", now, self._paths.scene(self._path_lines, now)))
        return out + self._mark_scenes(sample.t_s, now)

    def _mark_scenes(self, t_s: float, now: int) -> list[Out]:
        """The scenes of marks that are not as they were."""
        return [(topic, now, self._shown[topic].at(now)) for topic in self._update_marks(t_s)]

    def _update_marks(self, t_s: float) -> list[str]:
        """Which of these scenes have changed."""
        scenes = {
            "/scene/disturbances": self._marks.disturbances(t_s),
            "/scene/events": self._marks.events(t_s),
        }
        changed = []
        for topic, scene in scenes.items():
            if self._shown.get(topic) is scene:
                continue
            self._shown[topic] = scene
            data = scene.at(0)
            if self._mark_bytes.get(topic) != data:  # it may look as before all the same
                self._mark_bytes[topic] = data
                changed.append(topic)
        return changed
