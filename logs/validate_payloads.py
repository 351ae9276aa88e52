"""Step 1 of validation, inside the messages: payloads decode, times agree, frames exist.

And, for step 3, the picture is that of the run: /tf shows every robot of a sample where the sample
has it. (That lines, labels and colours of the scenes fit the records is not checked.)
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError
from mcap import records as mcap_records

from logs.container import RawMessage
from logs.findings import Checks
from logs.protobuf import CODECS, field_layout, schema_data

STEP = 1
RUN_STEP = 3  # of what is wrong with the run rather than with the file
_FOXGLOVE = "foxglove."
SNAP_M = 1.0 / 1024.0
"""What is shown may be this far from what is recorded [m]: positions are rounded for it."""
_TURN = 1e-6
_FRAMES = ("frame_id", "parent_frame_id", "child_frame_id")


class Payloads:
    """Decodes every message by the schema that is in the file, with nothing but protobuf."""

    def __init__(self, checks: Checks) -> None:
        self._checks = checks
        self._classes: dict[int, Any] = {}  # message class by schema id, None if unusable
        self._names: dict[int, str] = {}
        self._frames: set[str] = set()  # frames some transform has told of so far
        self._robots: tuple[str, ...] = ()
        self._sample: tuple[int, Any] | None = None  # the last one, and its time

    def add_schema(self, schema: mcap_records.Schema) -> None:
        """Learn to decode a schema; a finding if it is not usable."""
        self._checks.count(STEP, "container:schema")
        self._names[schema.id] = schema.name
        try:
            if schema.encoding != "protobuf":
                raise ValueError(f"encoding {schema.encoding!r}")
            codec = CODECS.get(schema.name)
            if codec is not None:
                own = field_layout(schema.name, schema_data(codec.record_type))
                if field_layout(schema.name, schema.data) != own:
                    raise ValueError("other fields than this version's records have")
            self._classes[schema.id] = _message_class(schema.name, schema.data)
        except (ValueError, TypeError, KeyError, DecodeError) as error:
            self._classes[schema.id] = None
            self._checks.find(
                STEP,
                "container:schema",
                f"schema {schema.id} ({schema.name}): {error}",
                "a protobuf FileDescriptorSet that declares the message as it is used",
            )

    def add_message(self, topic: str, schema_id: int, message: RawMessage) -> None:
        """Check one message's payload."""
        message_class = self._classes.get(schema_id)
        if message_class is None:
            return
        self._checks.count(STEP, "container:payload")
        try:
            payload = message_class.FromString(bytes(message.data))
        except (DecodeError, ValueError) as error:
            self._checks.find(
                STEP,
                "container:payload",
                f"message on {topic} at {message.log_time} ns does not decode: {error}",
                self._names[schema_id],
            )
            return
        match self._names[schema_id]:
            case "mapp.RunStart":
                self._robots = tuple(payload.robots)
            case "mapp.Sample":
                self._sample = (message.log_time, payload)
            case "foxglove.FrameTransforms":
                self._transforms(topic, message.log_time, payload)
            case name if name.startswith(_FOXGLOVE):
                self._foxglove(topic, message.log_time, payload)

    def _foxglove(self, topic: str, log_time: int, payload: Any) -> None:
        """The time stamps in it are the message's own, its frames are known by then."""
        seconds, nanos = divmod(log_time, 1_000_000_000)
        stamps = uses = 0
        for part in _parts(payload):
            stamped, frames = _roles(part.DESCRIPTOR)
            if stamped:
                stamps += 1
                stamp = part.timestamp
                if stamp.seconds != seconds or stamp.nanos != nanos:
                    self._wrong_stamp(topic, stamp, log_time)
            for name in frames:
                uses += 1
                frame = getattr(part, name)
                if frame not in self._frames:
                    self._checks.find(
                        STEP,
                        "container:frame",
                        f"{topic} at {log_time} ns uses frame {frame!r}",
                        "a frame that a transform has declared by then",
                    )
        self._checks.count(STEP, "container:time", stamps)
        self._checks.count(STEP, "container:frame", uses)

    def _wrong_stamp(self, topic: str, stamp: Any, log_time: int) -> None:
        told = stamp.seconds * 1_000_000_000 + stamp.nanos
        self._checks.find(
            STEP,
            "container:time",
            f"{topic}: time stamp {told} ns in a message of {log_time} ns",
            "the same time",
        )

    def _transforms(self, topic: str, log_time: int, payload: Any) -> None:
        """What is shown is what the sample of the same instant says: robots, places, headings.

        Its time stamps are checked here and not in `_foxglove`, in one pass: nine tenths of a long
        log's parts are transforms. The frames in it are those it declares.
        """
        rule = "page6:tf"
        seconds, nanos = divmod(log_time, 1_000_000_000)
        expected: dict[str, tuple[float, float, float]] = {}
        if self._sample is not None and self._sample[0] == log_time:
            sample = self._sample[1]
            for i, *pose in zip(
                sample.robot, sample.x_m, sample.y_m, sample.heading_rad, strict=False
            ):
                if 0 <= i < len(self._robots):
                    expected[self._robots[i]] = (pose[0], pose[1], pose[2])
        shown = 0
        for transform in payload.transforms:
            child = transform.child_frame_id
            self._frames.add(child)
            self._frames.add(transform.parent_frame_id)
            stamp = transform.timestamp
            if stamp.seconds != seconds or stamp.nanos != nanos:
                self._wrong_stamp(topic, stamp, log_time)
            pose_told = expected.get(child)
            if pose_told is None:
                if child in self._robots:
                    told = f"{child} at {log_time} ns"
                    self._checks.find(RUN_STEP, rule, told, "no robot without a sample")
                continue
            shown += 1
            x, y, heading = pose_told
            place, turn = transform.translation, transform.rotation
            z, w = turn.z, turn.w
            cos, sin = _half_turn(heading)
            if not (
                abs(place.x - x) <= SNAP_M
                and abs(place.y - y) <= SNAP_M
                and abs(z * cos - w * sin) <= _TURN
                and abs(math.hypot(z, w) - 1.0) <= _TURN
            ):
                self._checks.find(
                    RUN_STEP,
                    rule,
                    f"({place.x}, {place.y}) m, rotation z, w ({z}, {w}) at {log_time} ns",
                    f"({x}, {y}) m, heading {heading} rad",
                    robot=child,
                )
        self._checks.count(RUN_STEP, rule, shown)
        self._checks.count(STEP, "container:time", len(payload.transforms))
        self._checks.count(STEP, "container:frame", 2 * len(payload.transforms))
        if shown != len(expected):
            told = f"{shown} robots at {log_time} ns"
            self._checks.find(RUN_STEP, rule, told, f"the {len(expected)} of the sample")


def _parts(payload: Any) -> Iterator[Any]:
    """The message and the messages in its repeated fields one level down."""
    yield payload
    for descriptor, value in payload.ListFields():
        if descriptor.message_type is not None and hasattr(value, "__len__"):
            yield from value


@lru_cache(maxsize=1024)  # robots on a grid have few headings
def _half_turn(heading: float) -> tuple[float, float]:
    """Cosine and sine of half an angle [rad]."""
    return math.cos(heading / 2.0), math.sin(heading / 2.0)


@lru_cache(maxsize=256)
def _roles(descriptor: Any) -> tuple[bool, tuple[str, ...]]:
    """Whether a message type has a time stamp, and which of its fields name frames."""
    fields = descriptor.fields_by_name
    stamped = "timestamp" in fields and fields["timestamp"].message_type is not None
    return stamped, tuple(name for name in _FRAMES if name in fields)


@lru_cache(maxsize=64)
def _message_class(message_name: str, schema_data: bytes) -> Any:
    """The class of a schema's message, from a pool of its own."""
    files = {f.name: f for f in descriptor_pb2.FileDescriptorSet.FromString(schema_data).file}
    pool = descriptor_pool.DescriptorPool()
    added: set[str] = set()

    def add(name: str, under: tuple[str, ...]) -> None:
        if name in added:
            return
        if name not in files or name in under:
            raise ValueError(f"file {name!r} is missing from the set or imports itself")
        for needed in files[name].dependency:
            add(needed, (*under, name))
        pool.Add(files[name])
        added.add(name)

    for name in files:
        add(name, ())
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(message_name))
