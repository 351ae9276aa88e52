"""Validation of the container: damage of every kind is found, and never a traceback."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.opcode import Opcode

from logs.container import pieces
from logs.errors import LogError
from logs.findings import Checks
from logs.records import (
    Record,
    RunStart,
    Separation,
)
from logs.validate import validate
from logs.validate_container import ContainerWalk
from tests.logs.good_logs import log_of
from tests.logs.tamper import cut, flip, forge, largest_chunk, rules


def test_bit_flip_in_a_chunk_is_found(tmp_path):
    """CRCs find a single bit; the file still gets a report."""
    log = log_of()
    report = validate(flip(log, tmp_path / "f.mcap", largest_chunk(log)))
    assert "container:crc" in rules(report, 1)


def test_every_bit_flip_is_found(tmp_path):
    """Wherever a bit flips, the container is found unsound or is refused, and nothing raises."""
    data = log_of().read_bytes()
    rng = np.random.default_rng(7)
    for byte in sorted(rng.choice(len(data), 60, replace=False).tolist()):
        forged = bytearray(data)
        forged[byte] ^= 1 << int(rng.integers(8))
        checks = Checks()
        try:
            walk = ContainerWalk(memoryview(forged), "f.mcap", checks)
        except LogError:
            continue
        if walk.run():
            from logs.validate_summary import check_summary

            check_summary(memoryview(forged), walk.summary, walk.contents, checks)
        assert checks.total(1) > 0, byte


@pytest.mark.parametrize("share", [0.02, 0.6, 0.999])
def test_truncated_file_is_found(tmp_path, share):
    """A file that is cut off gets findings as far as it can be read."""
    size = log_of().stat().st_size
    report = validate(cut(log_of(), tmp_path / "f.mcap", int(size * share)))
    assert "container:structure" in rules(report, 1)
    assert report.skipped
    assert "reader" not in rules(report)


@pytest.mark.parametrize("byte", [0, 7, 8, 9, 17])
def test_damaged_head_never_raises_anything_else(tmp_path, byte):
    """Damage to the first bytes is refused with one sentence, or found."""
    forged, message = flip(log_of(), tmp_path / "f.mcap", byte, 3), ""
    try:
        assert not validate(forged).valid
    except LogError as error:
        message = str(error)
    assert not message or str(tmp_path) in message


def test_time_that_goes_back_is_found(tmp_path):
    """Times only grow, and a record lies at its own time."""

    def back(record: Record) -> int:
        return -3_000_000_000 if isinstance(record, Separation) and record.slot == 5 else 0

    report = validate(forge(log_of(), tmp_path / "f.mcap", shift_ns=back))
    assert rules(report, 1) == {"container:time"}


def test_wrong_hash_is_found(tmp_path):
    """A change anywhere changes the content hash."""

    def change(record: Record) -> Record:
        return replace(record, policy="other") if isinstance(record, RunStart) else record

    report = validate(forge(log_of(), tmp_path / "f.mcap", record=change, fresh_hash=False))
    assert rules(report, 1) == {"container:hash"}


def test_payload_that_does_not_decode_is_found(tmp_path):
    """Every payload decodes by its schema."""
    report = validate(
        forge(
            log_of(),
            tmp_path / "f.mcap",
            message=lambda topic, data: b"\xff\xff\xff" if topic == "/radio/coverage" else data,
        )
    )
    assert rules(report) == {"container:payload"}


def test_unknown_frame_is_found(tmp_path):
    """Every frame that is used is declared."""

    def lost(topic: str, data: bytes) -> bytes:
        if topic != "/scene/static":
            return data
        scene = SceneUpdate.FromString(data)
        scene.entities[0].frame_id = "nowhere"
        return scene.SerializeToString()

    report = validate(forge(log_of(), tmp_path / "f.mcap", message=lost))
    assert rules(report) == {"container:frame"}


def _patched(opcode: int, at: int, form: str, change: Callable[[int], int]) -> bytes:
    """The good log with a number in a summary record changed and the summary's CRC made to fit."""
    data = bytearray(log_of().read_bytes())
    body = memoryview(bytes(data))[:-8]
    found = [piece for piece in pieces(body, 8) if piece.opcode == opcode]
    place = found[-1].offset + 9 + at
    (value,) = struct.unpack_from(form, data, place)
    struct.pack_into(form, data, place, change(value))
    footer = [piece for piece in pieces(body, 8) if piece.opcode == Opcode.FOOTER][-1]
    (start,) = struct.unpack_from("<Q", data, footer.offset + 9)
    crc_at = footer.end - 4
    struct.pack_into("<I", data, crc_at, zlib.crc32(data[start:crc_at]))
    return bytes(data)


@pytest.mark.parametrize(
    ("opcode", "at", "form", "rule"),
    [
        (Opcode.STATISTICS, 0, "<Q", "container:statistics"),  # messages
        (Opcode.STATISTICS, 10, "<I", "container:statistics"),  # channels
        (Opcode.CHUNK_INDEX, 0, "<Q", "container:index"),  # first time
        (Opcode.CHUNK_INDEX, 16, "<Q", "container:index"),  # offset
        (Opcode.ATTACHMENT_INDEX, 8, "<Q", "container:index"),  # length
        (Opcode.METADATA_INDEX, 0, "<Q", "container:index"),  # offset
        (Opcode.SUMMARY_OFFSET, 1, "<Q", "container:index"),  # start of a group
    ],
)
def test_wrong_index_is_found(tmp_path, opcode, at, form, rule):
    """Indexes and statistics say what is there, CRC or no CRC."""
    path = tmp_path / "f.mcap"
    path.write_bytes(_patched(opcode, at, form, lambda value: value + 1))
    assert rules(validate(path)) == {rule}


def test_sizes_in_the_file_are_not_believed(tmp_path):
    """A chunk that claims to unpack to an exabyte is a finding, not an attempt."""
    data = bytearray(log_of().read_bytes())
    chunk = next(p for p in pieces(memoryview(bytes(data))[:-8], 8) if p.opcode == Opcode.CHUNK)
    struct.pack_into("<Q", data, chunk.offset + 9 + 16, 1 << 60)
    path = tmp_path / "f.mcap"
    path.write_bytes(data)
    assert "container:crc" in rules(validate(path), 1)
