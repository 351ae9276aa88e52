"""`RunLog` writes a run as one MCAP file that is complete on its own.

The file carries the run's inputs as attachments, its records as protobuf messages, and beside them
what Foxglove needs to show them. It is deterministic: the same inputs and records give the same
bytes (with the same zstd), and everywhere the same `ContentHash`. Log and publish time of a message
are `EPOCH` + its simulated time; no wall clock enters.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from mcap.writer import CompressionType, Writer

from logs.errors import LogError
from logs.layout import build_layout, busiest_robots, dump_layout
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
)
from logs.messages import MessageStream
from logs.records import Record, RunEnd
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
        with self._named():
            self._stream = MessageStream(world, floor, radio_map, problem, plan)
        self._layout = dump_layout(
            build_layout(world, problem, radio_map, plan.prices, busiest_robots(plan))
        )
        self._file: BinaryIO | None = None
        self._writer: Writer | None = None
        self._channels: dict[str, int] = {}
        self._sequences: dict[str, int] = {}
        self._hash = ContentHash()

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
        writer = self._writer
        if writer is None:
            raise LogError(f"{self.path}: the log is not open; write inside `with RunLog(…)`")
        try:
            for topic, log_time, data in self._stream.of(record):
                sequence = self._sequences[topic]
                self._sequences[topic] = sequence + 1
                self._hash.message(topic, log_time, data)
                writer.add_message(self._channels[topic], log_time, data, log_time, sequence)
        except OSError as error:
            raise self._unwritable(error) from error
        except LogError as error:
            raise LogError(f"{self.path}: {error}") from error

    # --- the file ---------------------------------------------------------------------------

    def _start(self, file: BinaryIO) -> None:
        """Header, metadata, attachments, schemas and channels, always in the same order."""
        self._writer = writer = Writer(
            file,
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.ZSTD,
            enable_data_crcs=True,
        )
        writer.start(library=f"mapp-twin/{_version('mapp-twin')}")
        world, radio_map, problem, plan = self._inputs
        metadata = {RUN_METADATA: run_metadata(world), VERSIONS_METADATA: _versions()}
        for name, values in metadata.items():
            self._hash.metadata(name, values)
            writer.add_metadata(name, values)
        contents = _attachments(world, radio_map, problem, plan, self._layout)
        for name, media_type in ATTACHMENTS.items():
            self._hash.attachment(name, media_type, contents[name])
            writer.add_attachment(EPOCH_NS, EPOCH_NS, name, media_type, contents[name])

        schemas: dict[str, int] = {}
        for topic, kind in self._stream.channels.items():
            if kind.name not in schemas:
                schemas[kind.name] = writer.register_schema(kind.name, "protobuf", kind.schema)
            schema = schemas[kind.name]
            self._channels[topic] = writer.register_channel(topic, "protobuf", schema)
            self._sequences[topic] = 0

    def _finish(self) -> None:
        if not isinstance(self._stream.last, RunEnd):
            raise LogError(f"{self.path}: the run gave no RunEnd record; no log is kept")
        if self._file is None or self._writer is None:
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
        self._writer = None
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
            self._file = None
        with suppress(OSError):
            self._part.unlink(missing_ok=True)

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Name the file in a refusal."""
        try:
            yield
        except LogError as error:
            raise LogError(f"{self.path}: {error}") from error

    @contextmanager
    def _os_errors(self) -> Iterator[None]:
        """Say in one sentence what the file system refused."""
        try:
            yield
        except OSError as error:
            raise self._unwritable(error) from error

    def _unwritable(self, error: OSError) -> LogError:
        reason = error.strerror or error
        return LogError(f"{self.path}: cannot be written: {reason}; choose another place")


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


def run_metadata(world: World) -> dict[str, str]:
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


@cache
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
