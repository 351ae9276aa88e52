"""Step 1 of validation, behind the data: the summary says what the data section holds."""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from typing import Any

from mcap import records as mcap_records
from mcap.opcode import Opcode

from logs.container import MAGIC, DamageError, Piece, parse
from logs.findings import Checks
from logs.validate_container import Contents

STEP = 1
_INDEX = "container:index"


def check_summary(
    data: memoryview, summary: list[Piece], contents: Contents, checks: Checks
) -> None:
    """Hold summary and footer against the contents of the data section.

    Args:
        data: the file.
        summary: the pieces behind DataEnd.
        contents: what the walk found.
        checks: where findings go.
    """
    found: dict[int, list[Any]] = defaultdict(list)
    groups: dict[int, tuple[int, int]] = {}  # first and last byte of each kind of record
    for piece in summary:
        try:
            found[piece.opcode].append(parse(piece))
        except DamageError as error:
            checks.find(STEP, "container:structure", error, "a record of the form its kind has")
            continue
        start, _ = groups.get(piece.opcode, (piece.offset, 0))
        groups[piece.opcode] = (start, piece.end)

    if not summary or summary[-1].opcode != Opcode.FOOTER or not found[Opcode.FOOTER]:
        checks.find(STEP, "container:structure", "the file has no footer", "a footer at its end")
        return
    _check_footer(data, summary, found[Opcode.FOOTER][-1], groups, checks)

    def same(rule: str, what: str, claimed: object, real: object) -> None:
        checks.same(STEP, rule, what, claimed, real)

    schemas = {schema.id: schema for schema in found[Opcode.SCHEMA]}
    channels = {channel.id: channel for channel in found[Opcode.CHANNEL]}
    same(_INDEX, "schemas repeated", sorted(schemas), sorted(contents.schemas))
    same(_INDEX, "channels repeated", sorted(channels), sorted(contents.channels))
    for number, schema in contents.schemas.items():
        checks.count(STEP, _INDEX)
        if schemas.get(number, schema) != schema:
            checks.find(STEP, _INDEX, f"schema {number} repeated otherwise", schema.name)
    for number, channel in contents.channels.items():
        checks.count(STEP, _INDEX)
        if channels.get(number, channel) != channel:
            checks.find(STEP, _INDEX, f"channel {number} repeated otherwise", channel.topic)
    for opcode, real in (
        (Opcode.CHUNK_INDEX, contents.chunk_indexes),
        (Opcode.ATTACHMENT_INDEX, contents.attachment_indexes),
        (Opcode.METADATA_INDEX, contents.metadata_indexes),
    ):
        claimed = found[opcode]
        name = opcode.name.lower().replace("_", " ")
        same(_INDEX, f"number of {name} records", len(claimed), len(real))
        for a, b in zip(claimed, real, strict=False):
            same(_INDEX, name, a, b)

    for kind, (start, end) in groups.items():
        if kind not in (Opcode.SUMMARY_OFFSET, Opcode.FOOTER):
            told = [
                (offset.group_start, offset.group_start + offset.group_length)
                for offset in found[Opcode.SUMMARY_OFFSET]
                if offset.group_opcode == kind
            ]
            same(_INDEX, f"summary offset of kind 0x{kind:02x}", told, [(start, end)])
    _check_statistics(found[Opcode.STATISTICS], contents, checks)


def _check_footer(
    data: memoryview,
    summary: list[Piece],
    footer: mcap_records.Footer,
    groups: dict[int, tuple[int, int]],
    checks: Checks,
) -> None:
    start = summary[0].offset if len(summary) > 1 else 0
    offsets = groups.get(Opcode.SUMMARY_OFFSET, (0, 0))[0]
    checks.same(STEP, _INDEX, "start of the summary", footer.summary_start, start)
    checks.same(STEP, _INDEX, "start of summary offsets", footer.summary_offset_start, offsets)
    until = len(data) - len(MAGIC) - struct.calcsize("<I")  # all of the footer but the CRC
    computed = zlib.crc32(data[summary[0].offset : until])
    checks.same(
        STEP,
        "container:crc",
        "CRC of the summary",
        f"0x{footer.summary_crc:08x}",
        f"0x{computed:08x}",
    )


def _check_statistics(
    found: list[mcap_records.Statistics], contents: Contents, checks: Checks
) -> None:
    rule = "container:statistics"
    checks.same(STEP, rule, "number of statistics records", len(found), 1)
    real = mcap_records.Statistics(
        attachment_count=len(contents.attachments),
        channel_count=len(contents.channels),
        channel_message_counts=dict(contents.counts),
        chunk_count=len(contents.chunks),
        message_count=contents.counts.total(),
        message_end_time=contents.span[1],
        message_start_time=contents.span[0],
        metadata_count=len(contents.metadata),
        schema_count=len(contents.schemas),
    )
    for statistics in found[:1]:
        for name in real.__dataclass_fields__:
            checks.same(STEP, rule, name, getattr(statistics, name), getattr(real, name))
