"""The wire format of protobuf, as far as messages here are packed by hand.

Specification: https://protobuf.dev/programming-guides/encoding
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any

VARINT, I64, LEN = 0, 1, 2
"""Wire types."""

_ONE_BYTE = [bytes([value]) for value in range(0x80)]
_KEPT = 1 << 14
"""Packed values that are remembered of one field."""
_SINT32 = 1 << 31


def varint(value: int) -> bytes:
    """A number that is not negative."""
    out = b""
    while value >= len(_ONE_BYTE):
        out += bytes([value & 0x7F | 0x80])
        value >>= 7
    return out + _ONE_BYTE[value]


def block(tag: bytes, content: bytes) -> bytes:
    """A length-delimited field."""
    return tag + varint(len(content)) + content


def field_tag(number: int, wire_type: int) -> bytes:
    """What comes before the value of field `number`."""
    return varint(number << 3 | wire_type)


Packer = Callable[[Any], bytes]
"""Packs a field with its value; nothing for the value 0, "" or False, as proto3 has it.

Raises `TypeError`, `struct.error` or `OverflowError` for all but values of the very Python type; a
double may be any number.
"""


def packer(number: int, kind: type, *, repeated: bool) -> Packer | None:
    """What packs field `number`, of `kind` float (double), int (sint32), bool or str.

    None for what is not packed here: repeated bool.
    """
    if repeated:
        by_kind = {float: _doubles, int: _numbers, str: _strings}
    else:
        by_kind = {float: _double, int: _number, str: _string, bool: _truth}
    make = by_kind.get(kind)
    return make(number) if make else None


class _Varints(dict[int, bytes]):
    """sint32 → its bytes."""

    def __missing__(self, value: int) -> bytes:
        if not -_SINT32 <= value < _SINT32:
            raise TypeError(f"{value} is not in the range of a sint32")
        data = varint(value << 1 ^ value >> 31)
        if len(self) < _KEPT:
            self[value] = data
        return data


_SINTS = _Varints()


def _double(number: int) -> Packer:
    tag = field_tag(number, I64)
    pack = struct.Struct(f"<{len(tag)}sd").pack
    nothing = pack(tag, 0.0)  # −0 is another pattern, and is written

    def packed(value: float) -> bytes:
        data = pack(tag, value)
        return b"" if data == nothing else data

    return packed


def _number(number: int) -> Packer:
    tag = field_tag(number, VARINT)
    known: dict[int, bytes] = {0: b""}

    def packed(value: int) -> bytes:
        if value.__class__ is not int:
            raise TypeError(f"{value!r} is no int")
        data = known.get(value)
        if data is None:
            data = tag + _SINTS[value]
            if len(known) < _KEPT:
                known[value] = data
        return data

    return packed


def _string(number: int) -> Packer:
    tag = field_tag(number, LEN)
    known: dict[str, bytes] = {"": b""}

    def packed(value: str) -> bytes:
        data = known.get(value)
        if data is None:
            if value.__class__ is not str:
                raise TypeError(f"{value!r} is no str")
            data = block(tag, value.encode())
            if len(known) < _KEPT:
                known[value] = data
        return data

    return packed


def _truth(number: int) -> Packer:
    tag = field_tag(number, VARINT)

    def packed(value: bool) -> bytes:
        if value.__class__ is not bool:
            raise TypeError(f"{value!r} is no bool")
        return tag + b"\x01" if value else b""

    return packed


def _doubles(number: int) -> Packer:
    tag = field_tag(number, LEN)

    def packed(values: Sequence[float]) -> bytes:
        n = len(values)
        return tag + varint(8 * n) + struct.pack(f"<{n}d", *values) if n else b""

    return packed


def _numbers(number: int) -> Packer:
    tag, only = field_tag(number, LEN), {int}

    def packed(values: Sequence[int]) -> bytes:
        if not only.issuperset(map(type, values)):
            raise TypeError("a value is no int")
        return block(tag, b"".join([_SINTS[value] for value in values])) if values else b""

    return packed


def _strings(number: int) -> Packer:
    tag, only = field_tag(number, LEN), {str}

    def packed(values: Sequence[str]) -> bytes:
        if not only.issuperset(map(type, values)):
            raise TypeError("a value is no str")
        return b"".join([block(tag, value.encode()) for value in values])

    return packed
