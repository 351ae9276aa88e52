"""Messages of a log from any instant on, for playing it back.

Which chunk holds messages of which topic is noted once; a seek then unpacks only the chunks in
which some topic was told of last.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from logs.container import Piece, parse, parse_message, pieces, unpack_chunk
from logs.errors import LogError
from logs.mcap_reader import Message, RunFile, data_pieces
from logs.messages import MessageType


@dataclass(frozen=True, slots=True)
class _Chunk:
    """A chunk, when its messages are from and to [ns], and of which channels they are."""

    piece: Piece
    begin_ns: int
    end_ns: int
    channels: frozenset[int]


class Playback:
    """A sound log, ready to be played.

    Attributes:
        run: the log.
        channels: topic → type, in the order of the log.
        span_ns: log times of its first and last message.
    """

    def __init__(self, path: Path) -> None:
        """Open a log.

        Raises:
            LogError: it is not a whole and sound log of a run, or holds no messages.
        """
        self.run = RunFile(path)  # checks all of it
        self._chunks: list[_Chunk] = []
        self._topics: dict[int, tuple[str, str]] = {}
        self.channels: Mapping[str, MessageType] = self._read(path)
        if not self._chunks:
            raise LogError(f"{path}: holds no messages; run the world again")
        self.span_ns = (
            min(chunk.begin_ns for chunk in self._chunks),
            max(chunk.end_ns for chunk in self._chunks),
        )

    def since(self, t_ns: int) -> Iterator[Message]:
        """All messages from a log time on, in their order."""
        for chunk in self._chunks:
            if chunk.end_ns >= t_ns:
                for message, _ in self._messages(chunk):
                    if message.log_time_ns >= t_ns:
                        yield message

    def last_before(self, t_ns: int) -> list[Message]:
        """The last message of each topic that has one before a log time, in their order."""
        found: dict[int, Message] = {}
        for chunk in reversed(self._chunks):
            if chunk.begin_ns >= t_ns or chunk.channels <= found.keys():
                continue
            found |= {
                channel: message
                for message, channel in self._messages(chunk)
                if message.log_time_ns < t_ns and channel not in found
            }
        order = {topic: k for k, topic in enumerate(self.channels)}
        return sorted(found.values(), key=lambda m: (m.log_time_ns, order[m.topic]))

    def _read(self, path: Path) -> dict[str, MessageType]:
        schemas: dict[int, Schema] = {}
        channels: dict[str, MessageType] = {}

        def define(piece: Piece) -> None:
            record = parse(piece)
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                schema = schemas[record.schema_id]
                self._topics[record.id] = (record.topic, schema.name)
                channels[record.topic] = MessageType(schema.name, schema.data)

        for piece in data_pieces(path):
            if piece.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                define(piece)
            elif piece.opcode == Opcode.CHUNK:
                chunk, ids = parse(piece), set()
                for inner in pieces(memoryview(unpack_chunk(chunk)), 0):
                    if inner.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                        define(inner)
                    elif inner.opcode == Opcode.MESSAGE:
                        ids.add(parse_message(inner).channel)
                if ids:
                    span = (chunk.message_start_time, chunk.message_end_time)
                    self._chunks.append(_Chunk(piece, *span, frozenset(ids)))
        return channels

    def _messages(self, chunk: _Chunk) -> Iterator[tuple[Message, int]]:
        """The messages of a chunk with their channels."""
        for inner in pieces(memoryview(unpack_chunk(parse(chunk.piece))), 0):
            if inner.opcode != Opcode.MESSAGE:
                continue
            raw = parse_message(inner)
            topic, schema = self._topics[raw.channel]
            data = bytes(raw.data)
            times = (raw.log_time, raw.publish_time)
            yield Message(topic, schema, *times, raw.sequence, data), raw.channel
