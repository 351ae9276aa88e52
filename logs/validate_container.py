"""Step 1 of validation: the MCAP file itself, byte by byte.

CRCs (chunks, data section, summary, attachments), indexes and statistics against what is there,
every payload decodes by the schema in the file, times only grow, every frame that is used exists.
Rules: `container:` and one of structure, crc, index, statistics, schema, payload, time, frame.
"""

from __future__ import annotations

import zlib
from array import array
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from mcap import records as mcap_records
from mcap.opcode import Opcode

from logs.container import (
    HEAD_BYTES,
    MAGIC,
    DamageError,
    Piece,
    RawMessage,
    attachment_crc,
    parse,
    parse_message,
    pieces,
    unpack_chunk,
)
from logs.errors import LogError
from logs.findings import Checks
from logs.mcap_format import ContentHash
from logs.validate_payloads import Payloads

STEP = 1


@dataclass
class Contents:
    """What a container holds, as far as it could be read.

    Attributes:
        header: its profile and the library that wrote it.
        schemas, channels: by id.
        attachments, metadata: in the order of the file.
        chunks: the chunks that unpack, in the order of the file.
        unpacked: whether all of them do.
        counts: messages of each channel.
        span: first and last log time of any message.
        attachment_indexes, metadata_indexes, chunk_indexes: what the summary should say of them.
    """

    header: mcap_records.Header
    schemas: dict[int, mcap_records.Schema] = field(default_factory=dict)
    channels: dict[int, mcap_records.Channel] = field(default_factory=dict)
    attachments: list[mcap_records.Attachment] = field(default_factory=list)
    metadata: list[mcap_records.Metadata] = field(default_factory=list)
    chunks: list[Piece] = field(default_factory=list)
    unpacked: bool = True
    counts: Counter[int] = field(default_factory=Counter)
    span: tuple[int, int] = (0, 0)
    chunk_indexes: list[mcap_records.ChunkIndex] = field(default_factory=list)
    attachment_indexes: list[mcap_records.AttachmentIndex] = field(default_factory=list)
    metadata_indexes: list[mcap_records.MetadataIndex] = field(default_factory=list)

    def messages(self) -> Iterator[tuple[mcap_records.Channel, str, RawMessage]]:
        """(channel, schema name, message) of all messages with a known channel, in file order."""
        for piece in self.chunks:
            unpacked = memoryview(unpack_chunk(parse(piece)))
            for inner in pieces(unpacked, 0):
                if inner.opcode == Opcode.MESSAGE:
                    message = parse_message(inner)
                    channel = self.channels.get(message.channel)
                    schema = self.schemas.get(channel.schema_id) if channel else None
                    if channel and schema:
                        yield channel, schema.name, message


class _Pieces:
    """Where the pieces of a file are: a few bytes each, a long log has a million of them."""

    def __init__(self, data: memoryview) -> None:
        self._data = data
        self._opcodes = bytearray()
        self._offsets = array("Q")
        self._ends = array("Q")

    def append(self, piece: Piece) -> None:
        """The next piece."""
        self._opcodes.append(piece.opcode)
        self._offsets.append(piece.offset)
        self._ends.append(piece.end)

    def __len__(self) -> int:
        return len(self._opcodes)

    def __getitem__(self, number: int) -> Piece:
        offset, end = self._offsets[number], self._ends[number]
        return Piece(self._opcodes[number], offset, self._data[offset + HEAD_BYTES : end])

    def between(self, first: int, behind: int) -> list[Piece]:
        """The pieces from `first` to the one before `behind`."""
        return [self[number] for number in range(first, behind)]

    def opcode(self, number: int) -> int:
        """The kind of one of them."""
        return self._opcodes[number]


class ContainerWalk:
    """Walks the data section of a file, holding every part against the others.

    Attributes:
        contents: what was found on the way.
        summary: the pieces behind the data section.
    """

    def __init__(self, data: memoryview, name: str, checks: Checks) -> None:
        """Begin a walk.

        Raises:
            LogError: it is no MCAP file at all, or nothing of it can be read.
        """
        if bytes(data[: len(MAGIC)]) != MAGIC:
            raise LogError(
                f"{name} is not an MCAP file (it does not begin with that format's magic bytes); "
                "give a log written by `twin run`"
            )
        self._data = data
        self._checks = checks
        self._payloads = Payloads(checks)
        self._last_time = 0
        self._hash = ContentHash()
        self._damage: DamageError | None = None
        body = data[: -len(MAGIC)] if bytes(data[-len(MAGIC) :]) == MAGIC else data
        self._pieces = _Pieces(body)
        try:
            for piece in pieces(body, len(MAGIC)):
                self._pieces.append(piece)
        except DamageError as error:
            self._damage = error
        header = self._parse(self._pieces[0]) if len(self._pieces) else None
        if not isinstance(header, mcap_records.Header):
            raise LogError(
                f"{name} ends, or is damaged, before its header; nothing of it can be read. "
                "Run again, or take the log from a backup"
            )
        self.contents = Contents(header)
        self.summary: list[Piece] = []

    def run(self, tell: Callable[[float], None] = lambda share: None) -> bool:
        """Walk the data section, telling which share is done; False if the file is not whole."""
        whole = bytes(self._data[-len(MAGIC) :]) == MAGIC and self._damage is None
        self._checks.count(STEP, "container:structure")
        if not whole:
            reason = f": {self._damage}" if self._damage else ""
            self._find("structure", f"the file is cut off or damaged{reason}", "a whole file")
        at = 1
        while at < len(self._pieces):
            piece = self._pieces[at]
            at += 1
            match piece.opcode:
                case Opcode.CHUNK:
                    behind = at
                    while (
                        behind < len(self._pieces)
                        and self._pieces.opcode(behind) == Opcode.MESSAGE_INDEX
                    ):
                        behind += 1
                    self._chunk(piece, self._pieces.between(at, behind))
                    at = behind
                    tell(piece.end / len(self._data))
                case Opcode.SCHEMA | Opcode.CHANNEL:
                    self._definition(self._parse(piece))
                case Opcode.ATTACHMENT:
                    self._attachment(piece)
                case Opcode.METADATA:
                    self._metadata(piece)
                case Opcode.DATA_END:
                    self._data_end(piece)
                    self.summary = self._pieces.between(at, len(self._pieces))
                    return whole
                case _:
                    self._misplaced(piece, "the data section")
        self._find("structure", "the data section has no end", "a DataEnd record")
        return False

    @property
    def sha256(self) -> str:
        """Content hash of what was walked so far."""
        return self._hash.hexdigest()

    def _find(self, part: str, found: object, expected: object) -> None:
        self._checks.find(STEP, f"container:{part}", found, expected)

    def _same(self, part: str, what: str, found: object, expected: object) -> None:
        self._checks.same(STEP, f"container:{part}", what, found, expected)

    def _parse(self, piece: Piece) -> Any:
        """The record, or None (and a finding) if it does not parse."""
        self._checks.count(STEP, "container:structure")
        try:
            return parse(piece)
        except DamageError as error:
            self._find("structure", error, "a record of the form its kind has")
            return None

    def _misplaced(self, piece: Piece, where: str) -> None:
        self._find(
            "structure",
            f"record of kind 0x{piece.opcode:02x} at byte {piece.offset}",
            f"none of that kind in {where}",
        )

    def _crc(self, what: str, stored: int, computed: int) -> None:
        self._same("crc", f"CRC of {what}", f"0x{stored:08x}", f"0x{computed:08x}")

    def _definition(self, record: Any) -> None:
        """A schema or channel: new, or the same as before."""
        known: dict[int, Any]
        match record:
            case None:
                return
            case mcap_records.Schema():
                known = self.contents.schemas
            case _:
                known = self.contents.channels
                self._checks.count(STEP, "container:schema")
                if record.schema_id not in self.contents.schemas:
                    self._find(
                        "schema",
                        f"channel {record.topic} has schema {record.schema_id}",
                        "a schema defined before it",
                    )
        if record.id not in known:
            known[record.id] = record
            if isinstance(record, mcap_records.Schema):
                self._payloads.add_schema(record)
        elif known[record.id] != record:
            self._find("schema", f"{type(record).__name__} {record.id} defined anew", "once")

    def _chunk(self, piece: Piece, index_pieces: list[Piece]) -> None:
        chunk = self._parse(piece)
        if chunk is None:
            self.contents.unpacked = False
            return
        where = f"the chunk at byte {piece.offset}"
        self._checks.count(STEP, "container:crc")
        try:
            unpacked = unpack_chunk(chunk)
        except DamageError as error:
            self._find("crc", f"{where} {error}", "a chunk that unpacks")
            self.contents.unpacked = False
            return
        self._crc(where, chunk.uncompressed_crc, zlib.crc32(unpacked))

        index: dict[int, list[tuple[int, int]]] = defaultdict(list)
        try:
            for inner in pieces(memoryview(unpacked), 0):
                match inner.opcode:
                    case Opcode.MESSAGE:
                        message = parse_message(inner)
                        index[message.channel].append((message.log_time, inner.offset))
                        self._message(message)
                    case Opcode.SCHEMA | Opcode.CHANNEL:
                        self._definition(self._parse(inner))
                    case _:
                        self._misplaced(inner, where)
        except DamageError as error:
            self._find("structure", f"in {where}: {error}", "whole records")
            self.contents.unpacked = False
            return
        self.contents.chunks.append(piece)

        times = [time for entries in index.values() for time, _ in entries]
        span = (min(times, default=0), max(times, default=0))
        claimed = (chunk.message_start_time, chunk.message_end_time)
        self._same("index", f"times of {where}", claimed, span)
        offsets: dict[int, int] = {}
        for index_piece in index_pieces:
            record = self._parse(index_piece)
            if record is not None:
                offsets[record.channel_id] = index_piece.offset
                self._same(
                    "index",
                    f"index of channel {record.channel_id} in {where}",
                    sorted(record.records),
                    sorted(index.get(record.channel_id, [])),
                )
        self._same("index", f"channels indexed in {where}", sorted(offsets), sorted(index))
        end = index_pieces[-1].end if index_pieces else piece.end
        self.contents.chunk_indexes.append(
            mcap_records.ChunkIndex(
                chunk_length=piece.end - piece.offset,
                chunk_start_offset=piece.offset,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=span[1],
                message_index_length=end - piece.end,
                message_index_offsets=offsets,
                message_start_time=span[0],
                uncompressed_size=len(unpacked),
            )
        )

    def _message(self, message: RawMessage) -> None:
        self._checks.count(STEP, "container:time")
        contents = self.contents
        if message.log_time < self._last_time:
            self._find(
                "time",
                f"a message of {message.log_time} ns behind one of {self._last_time} ns",
                "times that only grow",
            )
        if message.publish_time != message.log_time:
            self._find("time", f"publish time {message.publish_time} ns", message.log_time)
        self._last_time = max(self._last_time, message.log_time)
        if contents.counts:
            first, last = contents.span
            contents.span = (min(first, message.log_time), max(last, message.log_time))
        else:
            contents.span = (message.log_time, message.log_time)
        contents.counts[message.channel] += 1
        channel = contents.channels.get(message.channel)
        if channel is None:
            self._find("schema", f"a message on channel {message.channel}", "a channel defined")
        else:
            self._hash.message(channel.topic, message.log_time, bytes(message.data))
            self._payloads.add_message(channel.topic, channel.schema_id, message)

    def _attachment(self, piece: Piece) -> None:
        attachment = self._parse(piece)
        if attachment is None:
            return
        self._crc(f"attachment {attachment.name!r}", *attachment_crc(piece))
        self.contents.attachments.append(attachment)
        self._hash.attachment(attachment.name, attachment.media_type, attachment.data)
        self.contents.attachment_indexes.append(
            mcap_records.AttachmentIndex(
                offset=piece.offset,
                length=piece.end - piece.offset,
                log_time=attachment.log_time,
                create_time=attachment.create_time,
                data_size=len(attachment.data),
                name=attachment.name,
                media_type=attachment.media_type,
            )
        )

    def _metadata(self, piece: Piece) -> None:
        metadata = self._parse(piece)
        if metadata is not None:
            self.contents.metadata.append(metadata)
            self._hash.metadata(metadata.name, metadata.metadata)
            self.contents.metadata_indexes.append(
                mcap_records.MetadataIndex(piece.offset, piece.end - piece.offset, metadata.name)
            )

    def _data_end(self, piece: Piece) -> None:
        record = self._parse(piece)
        if record is not None:
            computed = zlib.crc32(self._data[: piece.offset])
            self._crc("the data section", record.data_section_crc, computed)
