"""Everything a run says, as messages: what a log holds and what a live view shows are the same.

`MessageStream` takes a run's records one by one and gives the bytes of each with those of the
Foxglove messages that go with it, ready for a file (`logs.mcap_writer`), for a web socket
(`twin.live`), or to be held against those of a log (`twin.rerun`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from mcap_protobuf.schema import build_file_descriptor_set

from logs.errors import LogError
from logs.foxglove_view import Out, View
from logs.mcap_format import time_ns
from logs.protobuf import encode, message_name, schema_data
from logs.records import RECORD_TYPES, Record, RunEnd, RunStart, Sample
from planner.plan import Plan
from planner.problem import Problem
from worlds.floor import Floor
from worlds.radio_map import RadioMap
from worlds.world import World


@dataclass(frozen=True, slots=True)
class MessageType:
    """What a topic carries.

    Attributes:
        name: full name of the message, e.g. `mapp.Sample`.
        schema: its serialized protobuf `FileDescriptorSet`.
    """

    name: str
    schema: bytes


class MessageStream:
    """Turns the records of one run into messages.

    Attributes:
        channels: topic → type, in the order in which they are registered in a log.
        last: the record that came last, None before the first.
    """

    def __init__(
        self, world: World, floor: Floor, radio_map: RadioMap, problem: Problem, plan: Plan
    ) -> None:
        """Prepare for a run of these inputs.

        Raises:
            LogError: names of robots or APs that a log cannot tell apart.
        """
        self._robots, self._aps = problem.robot_ids, problem.ap_ids
        self._topics: dict[type[Record], tuple[str, dict[str, str]]] = {}  # whose, by their names
        self._view = View(world, floor, radio_map, problem, plan)
        self.channels: Mapping[str, MessageType] = self._channels()
        self.last: Record | None = None

    def of(self, record: Record) -> list[Out]:
        """The messages of the next record, in the order of their times.

        Raises:
            LogError: the record does not fit the run, or its time goes back.
        """
        refusal, topic = self._refusal(record), self._topic_of(record)
        if refusal or topic is None:
            reason = refusal or "its robot or AP is none of the problem's"
            raise LogError(f"{type(record).__name__} at t = {record.t_s} s: {reason}")
        data = encode(record)
        out = self._view.before(record)
        out.append((topic, time_ns(record.t_s), data))
        out += self._view.after(record)
        self.last = record
        return out

    def _channels(self) -> dict[str, MessageType]:
        channels: dict[str, MessageType] = {}
        for record_type in RECORD_TYPES:
            own = MessageType(message_name(record_type), schema_data(record_type))
            subject = subject_of(record_type)
            names = {"robot": self._robots, "ap": self._aps, "": ("",)}[subject]
            topics = topics_of(record_type, self._robots, self._aps)
            self._topics[record_type] = subject, dict(zip(names, topics, strict=True))
            for topic in topics:
                if topic in channels:
                    raise LogError(f"two robots or APs would share the topic {topic}")
                channels[topic] = own
        types: dict[str, MessageType] = {}
        for topic, message_class in self._view.topics.items():
            name = message_class.DESCRIPTOR.full_name
            if name not in types:
                files = build_file_descriptor_set(message_class)
                types[name] = MessageType(name, files.SerializeToString(deterministic=True))
            if topic in channels:
                raise LogError(f"a robot or AP would take the topic {topic}")
            channels[topic] = types[name]
        return channels

    def _refusal(self, record: Record) -> str | None:
        """Why a record may not come now, None if it may."""
        if not math.isfinite(record.t_s):
            return "its time is no number"
        if self.last is None:
            if not isinstance(record, RunStart):
                return "the first record of a log is RunStart"
            if (record.robots, record.aps) != (self._robots, self._aps):
                return "its robots and APs are not those of the problem, in its order"
        elif isinstance(record, RunStart) or isinstance(self.last, RunEnd):
            return "RunStart is the first record of a log and RunEnd its last"
        elif record.t_s < self.last.t_s:
            return f"comes after a record of t = {self.last.t_s} s; time only grows"
        if isinstance(record, Sample):
            return _sample_refusal(record, len(self._robots), len(self._aps))
        return None

    def _topic_of(self, record: Record) -> str | None:
        """The record's topic, None if it speaks of a robot or AP that the problem has not."""
        subject, topics = self._topics.get(type(record), ("", {}))
        return topics.get(getattr(record, subject) if subject else "")


def subject_of(record_type: type[Record]) -> str:
    """The field of a record type that its topic has in it, "robot" or "ap"; "" if none."""
    return next((name for name in ("robot", "ap") if f"{{{name}}}" in record_type.topic), "")


def topics_of(
    record_type: type[Record], robots: tuple[str, ...], aps: tuple[str, ...]
) -> list[str]:
    """Every topic of a record type in a run with these robots and APs."""
    topic = record_type.topic
    match subject_of(record_type):
        case "robot":
            return [topic.format(robot=name) for name in robots]
        case "ap":
            return [topic.format(ap=name) for name in aps]
        case _:
            return [topic]


def _sample_refusal(sample: Sample, robots: int, aps: int) -> str | None:
    columns = (
        sample.x_m,
        sample.y_m,
        sample.heading_rad,
        sample.ap,
        sample.snr_db,
        sample.map_snr_db,
        sample.link,
        sample.rate_mbps,
    )
    n = len(sample.robot)
    if any(len(column) != n for column in columns):
        return "its columns are not equally long"
    if n and not (min(sample.robot) >= 0 and max(sample.robot) < robots):
        return f"a robot's index is not in 0 … {robots - 1}"
    if n and not (min(sample.ap) >= -1 and max(sample.ap) < aps):
        return f"an AP's index is not in −1 … {aps - 1}"
    return None
