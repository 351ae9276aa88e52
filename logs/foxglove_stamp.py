"""Foxglove messages packed once and told again and again: only their time is put in.

A scene or a grid is a few hundred small messages, of which nothing changes from one telling to the
next but the timestamps. `Stamped` keeps the bytes between these. What comes out is what protobuf
would write, field by field in the order of their numbers.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from logs.foxglove_parts import timestamp
from logs.wire import LEN, block, field_tag, varint


def tag(message: Any, field: str, wire_type: int) -> bytes:
    """What comes before the value of a field of a message class."""
    return field_tag(message.DESCRIPTOR.fields_by_name[field].number, wire_type)


_STAMP = tag(SceneEntity, "timestamp", LEN)
_ENTITY = tag(SceneUpdate, "entities", LEN)
_DELETION = tag(SceneUpdate, "deletions", LEN)


@lru_cache(maxsize=4)  # several messages are told at one time
def stamp_field(log_time_ns: int) -> bytes:
    """The field `timestamp`, which is the first one of all messages that have it."""
    return block(_STAMP, timestamp(log_time_ns).SerializeToString(deterministic=True))


class Stamped:
    """A message whose timestamps are put in when it is told."""

    def __init__(self, parts: Iterable[tuple[bytes, bytes]]) -> None:
        """Keep the parts that bear a timestamp each.

        Args:
            parts: (tag in the message, "" if it is the message itself; content without timestamp).
        """
        self._parts = tuple(parts)

    @classmethod
    def of(cls, message: Any) -> Stamped:
        """A `foxglove.SceneUpdate` or a message with a timestamp of its own; it has none yet."""
        if isinstance(message, SceneUpdate):
            return cls.scene(map(packed, message.entities), map(packed, message.deletions))
        return cls([(b"", packed(message))])

    @classmethod
    def scene(cls, entities: Iterable[bytes], deletions: Iterable[bytes] = ()) -> Stamped:
        """A `foxglove.SceneUpdate` of packed entities and deletions without timestamps."""
        return cls(
            [*((_DELETION, part) for part in deletions), *((_ENTITY, part) for part in entities)]
        )

    def at(self, log_time_ns: int) -> bytes:
        """The bytes of the message, told at that time."""
        stamp = stamp_field(log_time_ns)
        out: list[bytes] = []
        for before, content in self._parts:
            if before:
                out += (before, varint(len(stamp) + len(content)))
            out += (stamp, content)
        return b"".join(out)


def packed(message: Any) -> bytes:
    """A message's bytes; the same message gives the same ones."""
    data: bytes = message.SerializeToString(deterministic=True)
    return data
