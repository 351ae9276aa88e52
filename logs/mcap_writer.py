"""`RunLog` writes a run as one MCAP file that is complete on its own.

The file carries the run's inputs as attachments, its records as protobuf messages, and beside them
what Foxglove needs to show them. It is deterministic: the same inputs and records give the same
bytes (with the same zstd), and everywhere the same `ContentHash`. Log and publish time of a message
are `EPOCH` + its simulated time; no wall clock enters.
"""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set

from logs.errors import LogError
from logs.foxglove_view import View
from logs.layout import build_layout, dump_layout
from logs.mcap_format import (
    ATTACHMENTS,
    EPOCH,
    EPOCH_NS,
    FORMAT,
    HASH_METADATA,
    LAYOUT_NAME,
    PLAN_NAME,
    PROBLEM_NAME,
    RADIO_MAP_NAME,
    RUN_METADATA,
    VERSIONS_METADATA,
    WORLD_NAME,
    ContentHash,
    time_ns,
)
from logs.protobuf import encode, message_name, schema_data
from logs.records import RECORD_TYPES, Record, RunEnd, RunStart, Sample
from planner.plan import Plan
from planner.problem import Problem
from worlds.floor import Floor
from worlds.radio_map import RadioMap
from worlds.world import World

CHUNK_BYTES = 1024 * 1024

_PACKAGES = (
    "numpy",
    "highspy",
    "numba",
    "pybullet",
    "simpy",
    "mcap",
    "zstandard",
    "protobuf",
    "foxglove-schemas-protobuf",
)
"""Packages whose version can show in a run or its file."""


def layout_path(path: Path) -> Path:
    """Where the Foxglove layout of the log `path` lies: beside it."""
    return path.with_name(path.name.removesuffix(".mcap") + ".layout.json")


class RunLog:
    """A log being written; a context manager.

    Inside `with`, `write` takes the run's records: RunStart first, RunEnd last, times never
    decreasing. The file grows as `X.mcap.part` and gets its name when all is well; if anything
    fails, nothing is left and an older `X.mcap` is untouched. The Foxglove layout lies beside it as
    `X.layout.json`.
    """

    def __init__(
        self,
        path: Path,
        *,
        world: World,
        floor: Floor,
        radio_map: RadioMap,
        problem: Problem,
        plan: Plan,
        overwrite: bool = False,
    ) -> None:
        """Prepare; nothing is written before `with`.

        Raises:
            LogError: there is a log of that name and `overwrite` is not set, or the place is none
                for a file.
        """
        self.path = Path(path)
        self._layout_path = layout_path(self.path)
        with self._os_errors():
            for target in (self.path, self._layout_path):
                if target.is_dir():
                    raise LogError(f"{target}: is a folder; give the name of a file")
                if target.exists() and not overwrite:
                    raise LogError(
                        f"{target}: exists already; choose another name, or replace it with "
                        "--overwrite"
                    )
        self._inputs = (world, radio_map, problem, plan)
        self._view = View(world, floor, radio_map, problem, plan)
        self._layout = dump_layout(build_layout(world, problem, radio_map, plan.prices))
        self._robots, self._aps = problem.robot_ids, problem.ap_ids
        self._file: BinaryIO | None = None
        self._channels: dict[str, int] = {}
        self._sequences: dict[str, int] = {}
        self._hash = ContentHash()
        self._last: Record | None = None

    @property
    def _part(self) -> Path:
        return self.path.with_name(self.path.name + ".part")

    def __enter__(self) -> RunLog:
        """Open the file and write what is known before the run."""
        with self._os_errors():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self._part.open("wb")
        try:
            with self._os_errors():
                self._start(self._file)
        except BaseException:
            self._discard()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Finish the file and give it its name, or remove it if anything went wrong."""
        try:
            if kind is None:
                self._finish()
        finally:
            self._discard()

    def write(self, record: Record) -> None:
        """Write one record and the Foxglove messages that follow from it.

        Raises:
            LogError: the record does not fit the run, its time goes back, or the disk is full.
        """
        if self._file is None:
            raise LogError(f"{self.path}: the log is not open; write inside `with RunLog(…)`")
        refusal, topic = self._refusal(record), self._topic(record)
        if refusal or topic is None:
            reason = refusal or "its robot or AP is none of the problem's"
            raise LogError(f"{self.path}: {type(record).__name__} at t = {record.t_s} s: {reason}")
        data = encode(record)
        with self._os_errors():
            for message in self._view.before(record):
                self._message(*message)
            self._message(topic, time_ns(record.t_s), data)
            for message in self._view.after(record):
                self._message(*message)
        self._last = record

    # --- the file ---------------------------------------------------------------------------

    def _start(self, file: BinaryIO) -> None:
        """Header, metadata, attachments, schemas and channels, always in the same order."""
        self._writer = Writer(
            file,
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.ZSTD,
            enable_data_crcs=True,
        )
        self._writer.start(library=f"mapp-twin/{_version('mapp-twin')}")
        world, radio_map, problem, plan = self._inputs
        self._metadata(RUN_METADATA, _run_metadata(world))
        self._metadata(VERSIONS_METADATA, _versions())
        contents = _attachments(world, radio_map, problem, plan, self._layout)
        for name, media_type in ATTACHMENTS.items():
            self._hash.attachment(name, media_type, contents[name])
            self._writer.add_attachment(EPOCH_NS, EPOCH_NS, name, media_type, contents[name])

        for record_type in RECORD_TYPES:
            schema = self._writer.register_schema(
                message_name(record_type), "protobuf", schema_data(record_type)
            )
            topic = record_type.topic
            names = (
                [topic.format(robot=name) for name in self._robots]
                if "{robot}" in topic
                else [topic.format(ap=name) for name in self._aps]
            )
            for name in names if "{" in topic else [topic]:
                self._channel(name, schema)
        schemas: dict[str, int] = {}
        for topic, message_class in self._view.topics.items():
            full_name = message_class.DESCRIPTOR.full_name
            if full_name not in schemas:
                files = build_file_descriptor_set(message_class)
                schemas[full_name] = self._writer.register_schema(
                    full_name, "protobuf", files.SerializeToString(deterministic=True)
                )
            self._channel(topic, schemas[full_name])

    def _channel(self, topic: str, schema: int) -> None:
        if topic in self._channels:
            raise LogError(f"{self.path}: two robots or APs would share the topic {topic}")
        self._channels[topic] = self._writer.register_channel(topic, "protobuf", schema)
        self._sequences[topic] = 0

    def _metadata(self, name: str, values: dict[str, str]) -> None:
        self._hash.metadata(name, values)
        self._writer.add_metadata(name, values)

    def _message(self, topic: str, log_time: int, data: bytes) -> None:
        sequence = self._sequences[topic]
        self._sequences[topic] = sequence + 1
        self._hash.message(topic, log_time, data)
        self._writer.add_message(self._channels[topic], log_time, data, log_time, sequence)

    def _finish(self) -> None:
        if not isinstance(self._last, RunEnd):
            raise LogError(f"{self.path}: the run gave no RunEnd record; no log is kept")
        if self._file is None:
            raise LogError(f"{self.path}: the log is closed")
        with self._os_errors():
            self._writer.add_metadata(HASH_METADATA, {"sha256": self._hash.hexdigest()})
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.close()
            layout_part = self._layout_path.with_name(self._layout_path.name + ".part")
            try:
                layout_part.write_text(self._layout, encoding="utf-8")
                os.replace(self._part, self.path)
                os.replace(layout_part, self._layout_path)
            finally:
                layout_part.unlink(missing_ok=True)

    def _discard(self) -> None:
        """Close and remove the unfinished file, if there is one."""
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
            self._file = None
        with suppress(OSError):
            self._part.unlink(missing_ok=True)

    # --- what may be written ----------------------------------------------------------------

    def _refusal(self, record: Record) -> str | None:
        """Why a record may not come now, None if it may."""
        if not math.isfinite(record.t_s):
            return "its time is no number"
        if self._last is None:
            if not isinstance(record, RunStart):
                return "the first record of a log is RunStart"
            if (record.robots, record.aps) != (self._robots, self._aps):
                return "its robots and APs are not those of the problem, in its order"
        elif isinstance(record, RunStart) or isinstance(self._last, RunEnd):
            return "RunStart is the first record of a log and RunEnd its last"
        elif record.t_s < self._last.t_s:
            return f"comes after a record of t = {self._last.t_s} s; time only grows"
        if isinstance(record, Sample):
            return _sample_refusal(record, len(self._robots), len(self._aps))
        return None

    def _topic(self, record: Record) -> str | None:
        """The record's topic, None if it speaks of a robot or AP that the problem has not."""
        topic = record.topic
        if "{" in topic:
            topic = topic.format(
                robot=getattr(record, "robot", None), ap=getattr(record, "ap", None)
            )
        return topic if topic in self._channels else None

    @contextmanager
    def _os_errors(self) -> Iterator[None]:
        """Say in one sentence what the file system refused."""
        try:
            yield
        except OSError as error:
            raise LogError(
                f"{self.path}: cannot be written: {error.strerror or error}; choose another place"
            ) from error


def _sample_refusal(sample: Sample, robots: int, aps: int) -> str | None:
    columns = (
        sample.x_m,
        sample.y_m,
        sample.heading_rad,
        sample.ap,
        sample.snr_db,
        sample.map_snr_db,
        sample.link,
        sample.rate_mbps,
    )
    n = len(sample.robot)
    if any(len(column) != n for column in columns):
        return "its columns are not equally long"
    if n and not (min(sample.robot) >= 0 and max(sample.robot) < robots):
        return f"a robot's index is not in 0 … {robots - 1}"
    if n and not (min(sample.ap) >= -1 and max(sample.ap) < aps):
        return f"an AP's index is not in −1 … {aps - 1}"
    return None


def _attachments(
    world: World, radio_map: RadioMap, problem: Problem, plan: Plan, layout: str
) -> dict[str, bytes]:
    """The run's inputs. Seconds spent planning are left out: they differ from run to run."""
    from planner.json_files import dump_plan, dump_problem
    from worlds.toml_file import dump_world

    counters = {name: n for name, n in plan.solver.items() if "second" not in name}
    return {
        WORLD_NAME: dump_world(world).encode(),
        RADIO_MAP_NAME: radio_map.to_bytes(),
        PROBLEM_NAME: dump_problem(problem).encode(),
        PLAN_NAME: dump_plan(replace(plan, seconds=0.0, solver=counters)).encode(),
        LAYOUT_NAME: layout.encode(),
    }


def _run_metadata(world: World) -> dict[str, str]:
    """Format, epoch, and every seed the run depends on."""
    seeds = {
        "seed.obstacles": world.obstacles.random.seed if world.obstacles else None,
        "seed.robots": world.robots.random.seed if world.robots else None,
        "seed.fading": world.radio.fading_seed if world.radio.shadow_fading else None,
        "seed.plan": world.plan.seed,
        "seed.run": world.run.seed,
    }
    return {
        "format": FORMAT,
        "world": world.name,
        "epoch": EPOCH,
        **{name: str(seed) for name, seed in seeds.items() if seed is not None},
    }


def _versions() -> dict[str, str]:
    own = {"mapp-twin": _version("mapp-twin"), "python": platform.python_version()}
    return own | {name: _version(name) for name in _PACKAGES}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
