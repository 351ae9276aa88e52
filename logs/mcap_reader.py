"""Reads a run's log back: typed records, the inputs it carries, and nothing that is not sound.

`read` walks the whole file once: every CRC that is stored (chunks, attachments, data section,
summary), every length, every record type. What is not right becomes one `LogError` that says what
to do; nothing is unpacked beyond a bound, so a forged file cannot fill the memory. The finer checks
(indexes, statistics, time order) are `logs.validate`'s.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Schema

from logs.container import (
    MAGIC,
    DamageError,
    Piece,
    attachment_crc,
    parse,
    parse_message,
    pieces,
    unpack_chunk,
)
from logs.errors import LogError
from logs.mapped import mapped
from logs.mcap_format import (
    FORMAT,
    HASH_METADATA,
    LAYOUT_NAME,
    PLAN_NAME,
    PROBLEM_NAME,
    RADIO_MAP_NAME,
    RUN_METADATA,
    WORLD_NAME,
    ContentHash,
)
from logs.protobuf import CODECS, PACKAGE, decode, field_layout, message_name, schema_data
from logs.records import Record, RunStart

if TYPE_CHECKING:
    from logs.tables import Table
    from planner.plan import Plan
    from planner.problem import Problem
    from worlds.floor import Floor
    from worlds.radio_map import RadioMap
    from worlds.world import World

T = TypeVar("T")
R = TypeVar("R", bound=Record)

MAX_UNPACKED_BYTES = 1 << 33
"""A log whose chunks unpack to more than this is refused (300 robots × 600 slots: 0.3 GB)."""

_KNOWN_FORMATS = (FORMAT,)


class Message(NamedTuple):
    """One message as it lies in the file.

    Attributes:
        topic: its channel's topic.
        schema: full name of its type, e.g. `mapp.Sample` or `foxglove.Log`.
        log_time_ns, publish_time_ns: nanoseconds since 1970.
        sequence: its number on the channel.
        data: the payload, protobuf.
    """

    topic: str
    schema: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: bytes


class RunFile:
    """A log that was found sound. Made by `read`; inputs are parsed when they are asked for.

    Attributes:
        path: of the file.
        library: what wrote it.
        metadata: name → key → value.
        attachments: name → bytes.
        topics: topic → full name of its message type, in the order of the file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.library = ""
        self.topics: Mapping[str, str] = {}
        metadata: dict[str, Mapping[str, str]] = {}
        attachments: dict[str, bytes] = {}
        walk = _Walk(path)
        for part in walk.parts(messages=False):
            if isinstance(part, Attachment):
                if part.name in attachments:
                    raise LogError(
                        f"{path}: has two attachments {part.name!r}; it was tampered with"
                    )
                attachments[part.name] = part.data
            elif not isinstance(part, Message):
                name, values = part
                if name in metadata:
                    raise LogError(
                        f"{path}: has two metadata records {name!r}; it was tampered with"
                    )
                metadata[name] = MappingProxyType(values)
        self.library = walk.library
        self.topics = MappingProxyType(walk.topics)
        self.metadata: Mapping[str, Mapping[str, str]] = MappingProxyType(metadata)
        self.attachments: Mapping[str, bytes] = MappingProxyType(attachments)
        self._check_origin()
        walk.check_schemas()

    def _check_origin(self) -> None:
        run = self.metadata.get(RUN_METADATA)
        if run is None:
            raise LogError(
                f"{self.path}: is an MCAP file, but not of a run (no metadata {RUN_METADATA!r}; "
                f"written by {self.library!r}); give a log written by `twin run`"
            )
        if run.get("format") not in _KNOWN_FORMATS:
            raise LogError(
                f"{self.path}: has format {run.get('format')!r}, this version reads "
                f"{', '.join(_KNOWN_FORMATS)}; use the version that wrote it ({self.library})"
            )
        if message_name(RunStart) not in self.topics.values():
            raise LogError(f"{self.path}: is damaged: none of its topics holds a run's records")

    @cached_property
    def records(self) -> tuple[Record, ...]:
        """All records in the order of the file. Long runs: see `iter_records`."""
        return tuple(self.iter_records())

    def of(self, record_type: type[R]) -> tuple[R, ...]:
        """All records of one type, in the order of the file."""
        return tuple(r for r in self.records if isinstance(r, record_type))

    def iter_records(self, types: Collection[type[Record]] | None = None) -> Iterator[Record]:
        """The records one by one, read from the file anew; only those of `types` if given."""
        wanted = {message_name(t) for t in types} if types is not None else set(CODECS)
        for message in self.iter_messages(wanted):
            try:
                yield decode(message.schema, message.data)
            except LogError as error:
                raise LogError(f"{self.path}: is damaged: {error}") from error

    def table(self, record_type: type[Record]) -> Table:
        """All records of one type as columns; see `logs.tables`."""
        from logs.tables import table

        return table(self, record_type)

    def iter_messages(self, schemas: Collection[str] | None = None) -> Iterator[Message]:
        """All messages, those for Foxglove included; only those of types `schemas` if given."""
        for part in _Walk(self.path).parts(messages=True, schemas=schemas):
            if isinstance(part, Message):
                yield part

    @cached_property
    def world(self) -> World:
        """The world of the run."""
        from worlds.toml_file import parse_world

        return self._input(WORLD_NAME, lambda data, name: parse_world(data.decode(), name))

    @cached_property
    def floor(self) -> Floor:
        """What the world resolves to, its drawn robots among the covered positions (§1.8)."""
        from worlds.errands import with_covered_robots
        from worlds.generate import resolve

        world, radio_map = self.world, self.radio_map
        return self._input(
            WORLD_NAME, lambda _, __: with_covered_robots(world, resolve(world), radio_map)
        )

    @cached_property
    def radio_map(self) -> RadioMap:
        """The radio map the plan was made with."""
        from worlds.radio_map import RadioMap

        return self._input(RADIO_MAP_NAME, lambda data, _: RadioMap.from_bytes(data))

    @cached_property
    def problem(self) -> Problem:
        """What the planner was asked."""
        from planner.json_files import parse_problem

        return self._input(PROBLEM_NAME, lambda data, name: parse_problem(data.decode(), name))

    @cached_property
    def plan(self) -> Plan:
        """What the planner answered, without the seconds it took."""
        from planner.json_files import parse_plan

        problem = self.problem
        return self._input(PLAN_NAME, lambda data, name: parse_plan(data.decode(), problem, name))

    @property
    def layout(self) -> str:
        """The Foxglove layout, as JSON text."""
        return self._input(LAYOUT_NAME, lambda data, _: data.decode())

    @property
    def stored_hash(self) -> str | None:
        """The content hash the writer noted; compare it with `canonical_hash(path)`."""
        return self.metadata.get(HASH_METADATA, {}).get("sha256")

    def _input(self, name: str, parser: Callable[[bytes, str], T]) -> T:
        data = self.attachments.get(name)
        if data is None:
            raise LogError(
                f"{self.path}: carries no {name}; it is not complete, run the world again"
            )
        place = f"{self.path}: {name}"
        try:
            return parser(data, place)
        except Exception as error:  # a forged attachment may provoke anything in its parser
            text = str(error) or type(error).__name__
            text = text if text.startswith(place) else f"{place}: cannot be used: {text}"
            raise LogError(text) from error


def read(path: Path) -> RunFile:
    """Open a log, checking all of it.

    Raises:
        LogError: there is no such file, or it is not a whole and sound log of a run.
    """
    return RunFile(Path(path))


def iter_records(path: Path, types: Collection[type[Record]] | None = None) -> Iterator[Record]:
    """The records of a log one by one, only those of `types` if given; see `RunFile`."""
    return read(path).iter_records(types)


def canonical_hash(path: Path) -> str:
    """The `ContentHash` of an MCAP file, computed from its contents (any MCAP file)."""
    content = ContentHash()
    for part in _Walk(Path(path)).parts(messages=True):
        if isinstance(part, Message):
            content.message(part.topic, part.log_time_ns, part.data)
        elif isinstance(part, Attachment):
            content.attachment(part.name, part.media_type, part.data)
        else:
            content.metadata(*part)
    return content.hexdigest()


def data_pieces(path: Path) -> Iterator[Piece]:
    """The pieces of a file's data section, header and summary checked; what is in them is not.

    Raises:
        LogError: the file is damaged.
    """
    with _told(path):
        yield from _Walk(path).data_pieces(mapped(path))


Part = Message | Attachment | tuple[str, dict[str, str]]


class _Walk:
    """One pass over a file, checking what it passes.

    Attributes:
        library: what the header names.
        topics: topic → message type, filled on the way.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.library = ""
        self.topics: dict[str, str] = {}
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, tuple[str, str]] = {}
        self._unpacked = self._messages = 0
        self._statistics: Any = None  # the MCAP record, once it was met

    def parts(self, *, messages: bool, schemas: Collection[str] | None = None) -> Iterator[Part]:
        """Attachments, metadata and, if wanted, messages (of these types), in file order."""
        data = mapped(self.path)
        with _told(self.path):
            for piece in self.data_pieces(data):
                yield from self._part(piece, messages, schemas)
            counted = self._statistics
            if counted is not None and counted.message_count != self._messages:
                raise LogError(
                    f"is damaged: it has {self._messages} messages, its statistics count "
                    f"{counted.message_count}; run the world again"
                )

    def check_schemas(self) -> None:
        """Raise a LogError unless the record types in the file are those of this version."""
        for schema in self._schemas.values():
            if not schema.name.startswith(f"{PACKAGE}."):
                continue
            with _told(self.path):
                codec = CODECS.get(schema.name)
                if codec is None or schema.encoding != "protobuf":
                    raise LogError(
                        f"holds records of type {schema.name!r} ({schema.encoding}), unknown to "
                        f"this version; use the version that wrote it ({self.library})"
                    )
                expected = field_layout(schema.name, schema_data(codec.record_type))
                if field_layout(schema.name, schema.data) != expected:
                    raise LogError(
                        f"its {schema.name} records have other fields than this version's; use "
                        f"the version that wrote it ({self.library})"
                    )

    def data_pieces(self, data: memoryview) -> Iterator[Piece]:
        """Pieces of the data section; header, summary and footer are checked on the way."""
        if bytes(data[: len(MAGIC)]) != MAGIC:
            raise LogError(
                "is not an MCAP file (its first bytes are not that format's); give a log written "
                "by `twin run`"
            )
        if bytes(data[-len(MAGIC) :]) != MAGIC or len(data) < 2 * len(MAGIC):
            raise LogError("is cut off (it does not end as an MCAP file does); run the world again")
        body = data[: -len(MAGIC)]
        summary_at = None
        last = None
        for last in pieces(body, len(MAGIC)):
            if last.offset == len(MAGIC):
                if last.opcode != Opcode.HEADER:
                    raise LogError("is damaged: it does not begin with a header")
                self.library = parse(last).library
            elif last.opcode == Opcode.DATA_END:
                _check_crc("its data section", parse(last).data_section_crc, data[: last.offset])
                summary_at = last.end
            elif summary_at is None:
                yield last
            elif last.opcode == Opcode.STATISTICS:
                self._statistics = parse(last)
        if last is None or summary_at is None or last.opcode != Opcode.FOOTER:
            raise LogError("is damaged: it has no end of data or no footer; run the world again")
        # The CRC covers the summary and the footer up to the CRC itself, its last 4 bytes.
        _check_crc("its summary", parse(last).summary_crc, body[summary_at : len(body) - 4])

    def _part(
        self, piece: Piece, messages: bool, schemas: Collection[str] | None
    ) -> Iterator[Part]:
        match piece.opcode:
            case Opcode.CHUNK:
                chunk = parse(piece)
                self._unpacked += chunk.uncompressed_size
                if self._unpacked > MAX_UNPACKED_BYTES:
                    raise LogError(f"claims to unpack to more than {MAX_UNPACKED_BYTES} bytes")
                unpacked = unpack_chunk(chunk)
                _check_crc(f"the chunk at byte {piece.offset}", chunk.uncompressed_crc, unpacked)
                for inner in pieces(memoryview(unpacked), 0):
                    self._messages += inner.opcode == Opcode.MESSAGE
                    if inner.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                        self._define(inner)
                    elif inner.opcode == Opcode.MESSAGE and messages:
                        message = self._message(inner, schemas)
                        if message is not None:
                            yield message
            case Opcode.SCHEMA | Opcode.CHANNEL:
                self._define(piece)
            case Opcode.MESSAGE:  # written without chunks by another program
                self._messages += 1
                message = self._message(piece, schemas) if messages else None
                if message is not None:
                    yield message
            case Opcode.ATTACHMENT:
                attachment = parse(piece)
                stored, computed = attachment_crc(piece)
                if stored and stored != computed:
                    raise LogError(f"is damaged: CRC of its attachment {attachment.name!r}")
                yield attachment
            case Opcode.METADATA:
                metadata = parse(piece)
                yield metadata.name, metadata.metadata
            case _:
                pass

    def _define(self, piece: Piece) -> None:
        record: Any = parse(piece)
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            schema = self._schemas.get(record.schema_id)
            if schema is None and record.schema_id:  # 0 is "no schema", which other logs may have
                raise LogError(f"is damaged: topic {record.topic} has no schema")
            name = schema.name if schema else ""
            self._channels[record.id] = (record.topic, name)
            self.topics[record.topic] = name

    def _message(self, piece: Piece, schemas: Collection[str] | None) -> Message | None:
        """The message, None if its type is not asked for."""
        raw = parse_message(piece)
        if raw.channel not in self._channels:
            raise LogError(f"is damaged: a message belongs to no topic (channel {raw.channel})")
        topic, schema = self._channels[raw.channel]
        if schemas is not None and schema not in schemas:
            return None
        data = bytes(raw.data)
        return Message(topic, schema, raw.log_time, raw.publish_time, raw.sequence, data)


def _check_crc(what: str, stored: int, data: bytes | memoryview) -> None:
    """A stored CRC of 0 means that there is none."""
    if stored and stored != zlib.crc32(data):
        raise LogError(f"is damaged: the CRC of {what} does not agree; run the world again")


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Name the file in whatever went wrong inside."""
    try:
        yield
    except DamageError as error:
        raise LogError(f"{path}: is damaged, or no log of a run: {error}") from error
    except LogError as error:
        raise LogError(f"{path}: {error}") from error
    except MemoryError as error:
        raise LogError(f"{path}: needs more memory than there is") from error
