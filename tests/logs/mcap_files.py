"""Logs of the sample run in files, sound and altered, for the tests of writer and reader."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from logs.mcap_writer import RunLog
from tests.logs.sample_run import SampleRun, sample_run

Change = Callable[[str, Any], Any]
LONG = 65  # slots of 2 s: 130 s


def write(path: Path, run: SampleRun, records=None, **changed) -> Path:
    """Write the run to `path`."""
    options = {k: changed.pop(k) for k in ("overwrite",) if k in changed}
    with RunLog(path, **(run.inputs | changed), **options) as log:
        for record in run.records if records is None else records:
            log.write(record)
    return path


@cache
def log_bytes(slots: int) -> bytes:
    """The bytes of the sample run's log."""
    with tempfile.TemporaryDirectory() as folder:
        return write(Path(folder) / "run.mcap", sample_run(slots)).read_bytes()


def copied(
    source: Path,
    target: Path,
    *,
    change: Change = lambda kind, item: item,
    compression=CompressionType.ZSTD,
) -> Path:
    """Write the log anew with the mcap package; `change` alters or (None) leaves out an item."""
    with source.open("rb") as old, target.open("wb") as new:
        reader = make_reader(old)
        writer = Writer(new, compression=compression, chunk_size=4096)
        writer.start(library=reader.get_header().library)
        for item in map(lambda m: change("metadata", m), reader.iter_metadata()):
            if item is not None:
                writer.add_metadata(item.name, item.metadata)
        schemas, channels = {}, {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            altered = change("schema", schema)
            key = (altered.name, altered.data)
            if key not in schemas:
                schemas[key] = writer.register_schema(altered.name, altered.encoding, altered.data)
            if channel.topic not in channels:
                channels[channel.topic] = writer.register_channel(
                    channel.topic, "protobuf", schemas[key]
                )
            item = change("message", message)
            if item is not None:
                writer.add_message(
                    channels[channel.topic],
                    item.log_time,
                    item.data,
                    item.publish_time,
                    item.sequence,
                )
        for attachment in reader.iter_attachments():
            item = change("attachment", attachment)
            if item is not None:
                writer.add_attachment(
                    item.create_time, item.log_time, item.name, item.media_type, item.data
                )
        writer.finish()
    return target


def only(kind: str, test: Callable[[Any], bool], alter: Callable[[Any], Any]) -> Change:
    """A change that applies `alter` to the items of one kind that pass `test`."""
    return lambda k, item: alter(item) if k == kind and test(item) else item
