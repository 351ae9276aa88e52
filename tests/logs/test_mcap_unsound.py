"""Nothing but a sound log of a run is read; all else is one sentence."""

from __future__ import annotations

import dataclasses
import os
import struct
import tracemalloc
from pathlib import Path

import mcap.writer
import pytest
import zstandard
from mcap.writer import Writer

from logs import mcap_writer
from logs.errors import LogError
from logs.mcap_format import ATTACHMENTS
from logs.mcap_reader import canonical_hash, read
from logs.protobuf import encode, schema_data
from logs.records import (
    ApLoad,
    RunEnd,
)
from tests.logs.mcap_files import copied, log_bytes, only, write
from tests.logs.sample_run import sample_run


@pytest.fixture
def log(tmp_path):
    """A sound log."""
    path = tmp_path / "run.mcap"
    path.write_bytes(log_bytes(10))
    return path


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "is not there"),
        (b"", "is empty"),
        (b"t_s,robot\n0.0,r0\n" * 40, "is not an MCAP file"),
        (b"\x89MCAP0\r\n", "is cut off"),
        (b"\x89MCAP0\r\n" * 2, "is damaged"),
    ],
)
def test_a_file_that_is_no_log_is_told_by_name(tmp_path, content, words):
    """The sentence names the file and what it is instead."""
    path = tmp_path / "some.mcap"
    if content is not None:
        path.write_bytes(content)
    for reader in (read, canonical_hash):
        with pytest.raises(LogError, match=words) as caught:
            reader(path)
        assert str(caught.value).startswith(f"{path}: ")


def test_a_folder_or_a_pipe_is_no_log(tmp_path):
    """Neither is opened."""
    with pytest.raises(LogError, match="is a folder"):
        read(tmp_path)
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(LogError, match="is not a file"):
        read(tmp_path / "pipe.mcap")


def test_a_log_cut_anywhere_is_refused(log):
    """No part of a log passes for a whole one."""
    whole = log.read_bytes()
    for length in [*range(1, len(whole), len(whole) // 150), len(whole) - 1]:
        log.write_bytes(whole[:length])
        with pytest.raises(LogError, match=r"run\.mcap: "):
            read(log)


def test_a_flipped_bit_anywhere_is_found(log):
    """CRCs cover every byte of the file."""
    whole = log.read_bytes()
    for place in [*range(0, len(whole), len(whole) // 200), *range(len(whole) - 40, len(whole))]:
        damaged = bytearray(whole)
        damaged[place] ^= 1 << place % 8
        log.write_bytes(damaged)
        with pytest.raises(LogError, match=r"run\.mcap: "):
            read(log)


def test_flipped_bits_behind_zeroed_crcs_never_raise_anything_else(log):
    """Without CRCs a flip may pass or not, but it is a LogError or a log."""
    whole = without_crcs(log.read_bytes())
    told = []
    places = range(8, len(whole) - 8, len(whole) // 120)
    for place in places:
        damaged = bytearray(whole)
        damaged[place] ^= 1 << place % 8
        log.write_bytes(damaged)
        try:
            file = read(log)
            assert len(file.records)
            assert all((file.world, file.radio_map, file.problem, file.plan, file.layout))
        except LogError as error:
            told.append(str(error))
    assert 0 < len(told) < len(places)
    assert all(text.startswith(str(log)) for text in told)


HEAD = struct.Struct("<BQ")


def without_crcs(data: bytes) -> bytes:
    """The same MCAP file with every CRC set to 0, which means "not stored"."""
    out = bytearray(data)
    place = 8
    while place < len(data) - 8:
        opcode, length = HEAD.unpack_from(data, place)
        body = place + HEAD.size
        if opcode == 0x06:  # chunk: start, end, size, CRC
            out[body + 24 : body + 28] = bytes(4)
        elif opcode in (0x09, 0x0F, 0x02):  # attachment, end of data, footer: CRC at the end
            out[body + length - 4 : body + length] = bytes(4)
        place = body + length
    return bytes(out)


def chunk_at(data: bytes) -> tuple[int, int]:
    """Offset of the first chunk's content and its length."""
    place = 8
    while data[place] != 0x06:
        place += HEAD.size + HEAD.unpack_from(data, place)[1]
    return place + HEAD.size, HEAD.unpack_from(data, place)[1]


@pytest.mark.parametrize("size", [2**28 + 1, 2**40, 2**63])
def test_a_chunk_that_claims_gigabytes_is_refused(log, size):
    """Its claim alone is enough; nothing is unpacked."""
    data = bytearray(without_crcs(log.read_bytes()))
    body, _ = chunk_at(data)
    data[body + 16 : body + 24] = struct.pack("<Q", size)
    log.write_bytes(data)
    with pytest.raises(LogError, match="claims to unpack"):
        read(log)


def test_a_small_chunk_that_unpacks_to_gigabytes_is_refused(log):
    """A frame of zeros that lies about its size is stopped at the size the chunk claims."""
    packer = zstandard.ZstdCompressor().compressobj()
    zeros = b"".join(packer.compress(bytes(1 << 20)) for _ in range(1024)) + packer.flush()
    data = without_crcs(log.read_bytes())
    body, length = chunk_at(data)
    head = bytearray(data[body : body + 32 + 4 + 4])
    head[16:24] = struct.pack("<Q", 1000)
    struct.pack_into("<Q", head, 32, len(zeros))  # after "zstd": length of what is packed
    chunk = bytes(head[:28]) + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(zeros))
    chunk += zeros
    forged = data[: body - HEAD.size] + HEAD.pack(0x06, len(chunk)) + chunk + data[body + length :]
    log.write_bytes(forged)
    tracemalloc.start()
    try:
        with pytest.raises(LogError, match="unpacks to"):
            read(log)
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()


def test_many_chunks_together_are_bounded(log, monkeypatch):
    """The sum of what chunks claim is bounded too."""
    monkeypatch.setattr("logs.mcap_reader.MAX_UNPACKED_BYTES", 10_000)
    with pytest.raises(LogError, match="claims to unpack to more than 10000 bytes"):
        read(log)


@pytest.mark.parametrize("length", [2**31, 2**62, 2**64 - 1])
def test_a_record_that_claims_to_be_long_is_refused(log, length):
    """A length is held against the bytes there are before anything is read."""
    data = bytearray(log.read_bytes())
    struct.pack_into("<Q", data, 9, length)
    log.write_bytes(data)
    with pytest.raises(LogError, match="bytes are left"):
        read(log)


def test_a_foreign_mcap_file_is_told_from_a_log(tmp_path):
    """An MCAP file of another program, with or without schemas, is named as such."""
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(library="someone else/3")
        channel = writer.register_channel("/x", "json", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(LogError, match=r"not of a run.*mapp-run.*someone else/3"):
        read(path)
    assert len(canonical_hash(path)) == 64


def test_a_log_of_a_later_format_names_both(tmp_path, monkeypatch):
    """What this version does not know it does not guess at."""
    monkeypatch.setattr(mcap_writer, "FORMAT", "mapp-run/2")
    path = write(tmp_path / "later.mcap", sample_run(10))
    with pytest.raises(LogError, match=r"'mapp-run/2', this version reads mapp-run/1"):
        read(path)


@pytest.mark.parametrize(
    ("alter", "words"),
    [
        (lambda s: dataclasses.replace(s, name="mapp.Ambush"), r"'mapp\.Ambush'.*unknown"),
        (lambda s: dataclasses.replace(s, encoding="jsonschema"), "jsonschema.*unknown"),
        (lambda s: dataclasses.replace(s, data=schema_data(ApLoad)), "does not declare"),
        (lambda s: dataclasses.replace(s, data=b"\xff"), "no protobuf FileDescriptorSet"),
    ],
)
def test_a_record_type_of_another_version_is_refused(log, tmp_path, alter, words):
    """Unknown types and types with other fields are told with the version that wrote them."""
    change = only("schema", lambda s: s.name == "mapp.Handover", alter)
    other = copied(log, tmp_path / "other.mcap", change=change)
    with pytest.raises(LogError, match=words):
        read(other)


def test_a_record_type_with_other_fields_is_refused(log, tmp_path):
    """A field renamed by another version is not read as ours."""
    change = only(
        "schema",
        lambda s: s.name == "mapp.Handover",
        lambda s: dataclasses.replace(s, data=s.data.replace(b"planned", b"foreseen"[:7])),
    )
    other = copied(log, tmp_path / "other.mcap", change=change)
    with pytest.raises(LogError, match=r"mapp\.Handover records have other fields"):
        read(other)


def test_a_payload_that_does_not_decode_is_a_log_error(log, tmp_path):
    """Also where the container is sound."""
    first = encode(sample_run(10).records[0])
    change = only(
        "message",
        lambda m: m.data == first,
        lambda m: dataclasses.replace(m, data=b"\xff\xff\xff"),
    )
    file = read(copied(log, tmp_path / "other.mcap", change=change))
    with pytest.raises(LogError, match=r"other\.mcap: is damaged: .*mapp\.RunStart"):
        _ = file.records


@pytest.mark.parametrize("name", ATTACHMENTS)
def test_an_input_that_is_missing_or_broken_is_a_log_error(log, tmp_path, name):
    """Each attachment's absence and each kind of rubbish in it is told with its name."""
    member = Path(name).stem
    this = lambda a: a.name == name  # noqa: E731
    missing = copied(
        log, tmp_path / "missing.mcap", change=only("attachment", this, lambda _: None)
    )
    with pytest.raises(LogError, match=f"carries no {name}"):
        getattr(read(missing), member)
    rubbish = [b"\xff\xfe\x00", *([] if name == "layout.json" else [b"", b"[" * 5000, b"PK\3\4 "])]
    for k, data in enumerate(rubbish):
        change = only("attachment", this, lambda a, d=data: dataclasses.replace(a, data=d))
        broken = copied(log, tmp_path / f"broken{k}.mcap", change=change)
        with pytest.raises(LogError, match=rf"broken{k}\.mcap: {name}"):
            getattr(read(broken), member)


@pytest.mark.parametrize("kind", ["attachment", "metadata"])
def test_two_parts_of_one_name_are_refused(log, tmp_path, kind):
    """Which of them counts is not for the reader to guess."""
    alike = {"plan.json": "problem.json", "mapp-versions": "mapp-run"}
    change = only(
        kind, lambda p: p.name in alike, lambda p: dataclasses.replace(p, name=alike[p.name])
    )
    other = copied(log, tmp_path / "other.mcap", change=change)
    with pytest.raises(LogError, match=f"has two {kind}.*tampered"):
        read(other)


def test_messages_outside_chunks_are_read(log, tmp_path):
    """A copy without chunks says the same (the format allows it)."""
    target = tmp_path / "flat.mcap"
    original = mcap.writer.Writer.__init__

    def flat(self, output, **options):
        original(self, output, **(options | {"use_chunking": False}))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mcap.writer.Writer, "__init__", flat)
        copied(log, target)
    assert read(target).records == sample_run(10).records
    assert canonical_hash(target) == canonical_hash(log)


def test_run_end_is_the_last_message_of_a_run(log):
    """Nothing follows the end but its own log line."""
    messages = list(read(log).iter_messages())
    assert [m.topic for m in messages[-2:]] == ["/run/end", "/log"]
    assert isinstance(read(log).records[-1], RunEnd)
