"""What writer and reader of a log agree on: its epoch, its fixed names and its content hash."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Mapping
from typing import Final

FORMAT: Final = "mapp-run/1"
"""Value of `format` in a log's metadata; the number grows with every change a reader must know."""

EPOCH: Final = "2024-01-01T00:00:00Z"
EPOCH_NS: Final = 1_704_067_200 * 10**9
"""Log time of t = 0 [ns since 1970]: `EPOCH`, the same for every run, so that logs compare."""

RUN_METADATA: Final = "mapp-run"
"""Metadata: `format`, `world`, `epoch`, and the seeds the run depends on."""
VERSIONS_METADATA: Final = "mapp-versions"
"""Metadata: the software that wrote the log. Not hashed: it may differ where the run does not."""
HASH_METADATA: Final = "mapp-hash"
"""Metadata: `sha256`, the log's `ContentHash`."""

WORLD_NAME: Final = "world.toml"
RADIO_MAP_NAME: Final = "radio_map.npz"
PROBLEM_NAME: Final = "problem.json"
PLAN_NAME: Final = "plan.json"
LAYOUT_NAME: Final = "layout.json"
ATTACHMENTS: Final[Mapping[str, str]] = {
    WORLD_NAME: "application/toml",
    RADIO_MAP_NAME: "application/x-npz",
    PROBLEM_NAME: "application/json",
    PLAN_NAME: "application/json",
    LAYOUT_NAME: "application/json",
}
"""Name → media type, in the order in which they are written."""


def time_ns(t_s: float) -> int:
    """Log time of simulated time `t_s` [ns since 1970], rounded to the nanosecond."""
    return EPOCH_NS + round(t_s * 1e9)


def time_s(log_time_ns: int) -> float:
    """Simulated time of a log time [s]."""
    return (log_time_ns - EPOCH_NS) / 1e9


_TIME_AND_SIZE = struct.Struct("<QQ")
_TOGETHER_BYTES = 1 << 18


class ContentHash:
    """SHA-256 of what a log says, whatever compression, chunks or library version it is kept in.

    With `len4(x)` for the length of x [bytes] as 4 bytes, `len8(x)` and numbers as 8 bytes, all
    unsigned little-endian, and text in UTF-8:

    - messages = SHA-256 over, for each message in the order of the file:
      len4(topic) topic log_time len8(payload) payload
    - an attachment has the digest SHA-256("A" len4(name) name len4(type) type len8(data) data),
      a metadata record SHA-256("M" len4(name) name, then for its keys in ascending order:
      len4(key) key len4(value) value). `mapp-hash` and `mapp-versions` are left out.
    - the hash = SHA-256(messages, then the digests of attachments and metadata in ascending order
      of (kind, name, digest)), written as 64 hexadecimal digits.
    """

    def __init__(self) -> None:
        self._messages = hashlib.sha256()
        self._parts: list[tuple[str, str, bytes]] = []
        self._topics: dict[str, bytes] = {}
        self._pending: list[bytes] = []  # of messages, hashed together
        self._pending_bytes = 0

    def message(self, topic: str, log_time_ns: int, payload: bytes) -> None:
        """Add the next message."""
        head = self._topics.get(topic)
        if head is None:
            head = self._topics[topic] = _text(topic)
        self._pending += (head, _TIME_AND_SIZE.pack(log_time_ns, len(payload)), payload)
        self._pending_bytes += len(payload)
        if self._pending_bytes > _TOGETHER_BYTES:
            self._hash_pending()

    def _hash_pending(self) -> None:
        self._messages.update(b"".join(self._pending))
        self._pending, self._pending_bytes = [], 0

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Add an attachment."""
        digest = hashlib.sha256(b"A" + _text(name) + _text(media_type))
        digest.update(struct.pack("<Q", len(data)) + data)
        self._parts.append(("A", name, digest.digest()))

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record; those that are not hashed are passed over."""
        if name in {HASH_METADATA, VERSIONS_METADATA}:
            return
        content = b"".join(_text(key) + _text(values[key]) for key in sorted(values))
        self._parts.append(("M", name, hashlib.sha256(b"M" + _text(name) + content).digest()))

    def hexdigest(self) -> str:
        """The hash of what was added so far."""
        self._hash_pending()
        parts = b"".join(digest for _, _, digest in sorted(self._parts))
        return hashlib.sha256(self._messages.digest() + parts).hexdigest()


def _text(value: str) -> bytes:
    data = value.encode()
    return struct.pack("<I", len(data)) + data
