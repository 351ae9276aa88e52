"""MCAP taken apart piece by piece, for validation: nothing in the file is believed unchecked.

A reader such as `mcap.reader` follows the indexes; this one walks the bytes, so that indexes can be
held against contents. Lengths and sizes are bounded by the bytes that are there.
Specification: https://mcap.dev/spec (version 0).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import Any, NamedTuple

import zstandard
from mcap import records as mcap_records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from logs.errors import LogError

MAGIC = b"\x89MCAP0\r\n"
MAX_CHUNK_BYTES = 1 << 28
"""Chunks that claim to unpack to more are refused (ours are 1 MiB)."""

_HEAD = struct.Struct("<BQ")  # opcode, length of the content
HEAD_BYTES = _HEAD.size
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_STEP_BYTES = 1 << 20

_PARSERS: dict[int, Any] = {
    Opcode.HEADER: mcap_records.Header,
    Opcode.FOOTER: mcap_records.Footer,
    Opcode.SCHEMA: mcap_records.Schema,
    Opcode.CHANNEL: mcap_records.Channel,
    Opcode.CHUNK: mcap_records.Chunk,
    Opcode.MESSAGE_INDEX: mcap_records.MessageIndex,
    Opcode.CHUNK_INDEX: mcap_records.ChunkIndex,
    Opcode.ATTACHMENT: mcap_records.Attachment,
    Opcode.ATTACHMENT_INDEX: mcap_records.AttachmentIndex,
    Opcode.STATISTICS: mcap_records.Statistics,
    Opcode.METADATA: mcap_records.Metadata,
    Opcode.METADATA_INDEX: mcap_records.MetadataIndex,
    Opcode.SUMMARY_OFFSET: mcap_records.SummaryOffset,
    Opcode.DATA_END: mcap_records.DataEnd,
}


class DamageError(LogError):
    """Bytes that cannot be taken apart; `offset` says where."""

    def __init__(self, offset: int, message: str) -> None:
        self.offset = offset
        super().__init__(message)


class Piece(NamedTuple):
    """One record of the MCAP format.

    Attributes:
        opcode: its kind.
        offset: of its first byte, in the file or in the unpacked chunk.
        content: what follows opcode and length.
    """

    opcode: int
    offset: int
    content: memoryview

    @property
    def end(self) -> int:
        """Offset of the byte behind it."""
        return self.offset + _HEAD.size + len(self.content)


class RawMessage(NamedTuple):
    """A message as it lies in a chunk; times are nanoseconds since the epoch of the log."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: memoryview


def pieces(data: memoryview, start: int) -> Iterator[Piece]:
    """The records from `start` on.

    Raises:
        DamageError: a record is longer than the bytes left.
    """
    offset = start
    while offset < len(data):
        if len(data) - offset < _HEAD.size:
            raise DamageError(offset, f"{len(data) - offset} stray bytes at byte {offset}")
        opcode, length = _HEAD.unpack_from(data, offset)
        left = len(data) - offset - _HEAD.size
        if length > left:
            raise DamageError(
                offset,
                f"a record of {length} bytes at byte {offset}, where {left} bytes are left",
            )
        begin = offset + _HEAD.size
        yield Piece(opcode, offset, data[begin : begin + length])
        offset = begin + length


def parse(piece: Piece) -> Any:
    """The piece as the record class of the `mcap` package; None for kinds it does not know.

    Raises:
        DamageError: the content does not have the form of its kind.
    """
    parser = _PARSERS.get(piece.opcode)
    if parser is None:
        return None
    stream = ReadDataStream(BytesIO(piece.content))
    try:
        record = parser.read(stream)
    except (McapError, struct.error, ValueError, OverflowError, MemoryError) as error:
        name = parser.__name__
        raise DamageError(
            piece.offset, f"a {name} record at byte {piece.offset} that does not parse: {error}"
        ) from error
    if stream.count != len(piece.content):
        raise DamageError(
            piece.offset,
            f"a {parser.__name__} record at byte {piece.offset} with "
            f"{len(piece.content) - stream.count} bytes too many",
        )
    return record


def parse_message(piece: Piece) -> RawMessage:
    """A message record, payload not decoded.

    Raises:
        DamageError: it is shorter than its head.
    """
    if len(piece.content) < _MESSAGE.size:
        raise DamageError(piece.offset, f"a message of {len(piece.content)} bytes, too short")
    channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(piece.content)
    payload = piece.content[_MESSAGE.size :]
    return RawMessage(channel, sequence, log_time, publish_time, payload)


def attachment_crc(piece: Piece) -> tuple[int, int]:
    """(stored, computed) CRC of an attachment record."""
    (stored,) = struct.unpack("<I", piece.content[-4:])
    return stored, zlib.crc32(piece.content[:-4])


def unpack_chunk(chunk: mcap_records.Chunk) -> bytes:
    """The records of a chunk, uncompressed.

    Raises:
        DamageError: compression unknown or broken, or another size than the chunk claims.
    """
    size = chunk.uncompressed_size
    if size > MAX_CHUNK_BYTES:
        raise DamageError(0, f"claims to unpack to {size} bytes")
    try:
        match chunk.compression:
            case "":
                unpacked = chunk.data
            case "zstd":
                unpacked = _unzstd(chunk.data, size)
            case unknown:
                raise DamageError(0, f"has compression {unknown!r}, a run's log has zstd")
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise DamageError(0, f"does not unpack: {error}") from error
    if len(unpacked) != size:
        raise DamageError(0, f"unpacks to {len(unpacked)} bytes or more instead of {size}")
    return unpacked


def _unzstd(data: bytes, size: int) -> bytes:
    """At most `size` + 1 bytes, whatever the frame itself claims."""
    parts, left = [], size + 1
    with zstandard.ZstdDecompressor().stream_reader(data) as reader:
        while left and (part := reader.read(min(left, _STEP_BYTES))):
            parts.append(part)
            left -= len(part)
    return b"".join(parts)
