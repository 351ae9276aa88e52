"""Forges logs: rewrites a log with some of its contents changed and all else made to fit.

The forged file is sound as a container (CRCs, indexes, content hash), so that what a validator
finds in it is the change itself. `flip` and `cut` damage the container instead.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from mcap.writer import CompressionType, Writer

from logs.container import MAGIC
from logs.findings import Checks, Report
from logs.mcap_format import HASH_METADATA, ContentHash, time_ns
from logs.protobuf import CODECS, decode, encode
from logs.records import Record
from logs.validate_container import ContainerWalk, Contents

Records = Record | Iterable[Record] | None
EditRecord = Callable[[Record], Records]
EditBytes = Callable[[str, bytes], bytes | None]


def contents(path: Path) -> Contents:
    """What lies in a sound log."""
    walk = ContainerWalk(memoryview(path.read_bytes()), str(path), Checks())
    walk.run()
    return walk.contents


def records(path: Path) -> list[Record]:
    """All records of a log."""
    return [
        decode(schema, bytes(message.data))
        for _, schema, message in contents(path).messages()
        if schema in CODECS
    ]


def forge(
    source: Path,
    target: Path,
    *,
    record: EditRecord = lambda record: record,
    attachment: EditBytes = lambda name, data: data,
    message: EditBytes = lambda topic, data: data,
    metadata: Callable[[str, dict[str, str]], dict[str, str] | None] = lambda name, values: values,
    shift_ns: Callable[[Record], int] = lambda record: 0,
    fresh_hash: bool = True,
) -> Path:
    """Write `source` anew as `target`.

    Args:
        source: a sound log.
        target: the forged one.
        record: gives what stands in a record's place: one record, several, or none (None).
        attachment: gives an attachment's new bytes, by name; None leaves it out.
        message: the same for Foxglove messages, by topic.
        metadata: the same for metadata records, by name.
        shift_ns: added to the log time of a record [ns].
        fresh_hash: whether the content hash is made to fit.
    """
    old = contents(source)
    content = ContentHash()
    with target.open("wb") as file:
        writer = Writer(
            file, chunk_size=8192, compression=CompressionType.ZSTD, enable_data_crcs=True
        )
        writer.start(library=old.header.library)
        for item in old.metadata:
            values = metadata(item.name, dict(item.metadata))
            if item.name != HASH_METADATA and values is not None:
                content.metadata(item.name, values)
                writer.add_metadata(item.name, values)
        for part in old.attachments:
            data = attachment(part.name, part.data)
            if data is not None:
                content.attachment(part.name, part.media_type, data)
                writer.add_attachment(
                    part.create_time, part.log_time, part.name, part.media_type, data
                )
        schemas = {
            number: writer.register_schema(schema.name, schema.encoding, schema.data)
            for number, schema in old.schemas.items()
        }
        channels = {
            channel.topic: writer.register_channel(
                channel.topic, channel.message_encoding, schemas[channel.schema_id]
            )
            for channel in old.channels.values()
        }

        def add(topic: str, time: int, payload: bytes) -> None:
            content.message(topic, time, payload)
            writer.add_message(channels[topic], time, payload, time)

        for channel, schema, item in old.messages():
            payload = bytes(item.data)
            if schema in CODECS:
                for new in _several(record(decode(schema, payload))):
                    fields = {name: getattr(new, name, "") for name in ("robot", "ap")}
                    topic = new.topic.format(**fields) if "{" in new.topic else new.topic
                    add(topic, time_ns(new.t_s) + shift_ns(new), encode(new))
            else:
                edited = message(channel.topic, payload)
                if edited is not None:
                    add(channel.topic, item.log_time, edited)
        stored = {entry.name: entry.metadata for entry in old.metadata}[HASH_METADATA]
        writer.add_metadata(
            HASH_METADATA, {"sha256": content.hexdigest()} if fresh_hash else stored
        )
        writer.finish()
    return target


def _several(new: Records) -> list[Record]:
    if new is None:
        return []
    return [new] if isinstance(new, Record) else list(new)


def flip(source: Path, target: Path, byte: int, bit: int = 0) -> Path:
    """Copy a file with one bit flipped."""
    data = bytearray(source.read_bytes())
    data[byte] ^= 1 << bit
    target.write_bytes(data)
    return target


def cut(source: Path, target: Path, size: int) -> Path:
    """Copy the first `size` bytes of a file."""
    target.write_bytes(source.read_bytes()[:size])
    return target


def largest_chunk(path: Path) -> int:
    """A byte in the middle of the largest chunk of a log."""
    chunk = max(contents(path).chunks, key=lambda piece: len(piece.content))
    assert chunk.offset > len(MAGIC)
    return chunk.offset + len(chunk.content) // 2


def edited(name: str, change: Callable[[bytes], bytes | None]):
    """Changes one attachment."""
    return lambda other, data: change(data) if other == name else data


def rules(report: Report, step: int | None = None) -> set[str]:
    """The rules with findings."""
    return {f.rule for f in report.findings if step in {None, f.step}}
