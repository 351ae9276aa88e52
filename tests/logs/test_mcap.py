"""A log holds all of a run, always the same way."""

from __future__ import annotations

import dataclasses
import hashlib
import struct
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.writer import CompressionType

from logs.mcap_format import EPOCH_NS, ContentHash, time_ns, time_s
from logs.mcap_reader import canonical_hash, iter_records, read
from logs.mcap_writer import layout_path
from logs.records import (
    RECORD_TYPES,
    ApLoad,
    Handover,
    RunStart,
    Sample,
)
from tests.logs.mcap_check import assert_good, folder
from tests.logs.mcap_files import LONG, copied, log_bytes, only, write
from tests.logs.sample_run import SAMPLES, SLOT_S, sample_run


@pytest.fixture
def log(tmp_path):
    """A sound log."""
    path = tmp_path / "run.mcap"
    path.write_bytes(log_bytes(10))
    return path


@pytest.fixture
def long_log(tmp_path):
    """A sound log of 130 s."""
    path = tmp_path / "long.mcap"
    path.write_bytes(log_bytes(LONG))
    return path


# --- what is in a log ---------------------------------------------------------------------------


@pytest.mark.parametrize("slots", [10, LONG])
def test_records_come_back_as_they_were_written(tmp_path, slots):
    """Every record of the run, of every type, in the order of writing, with its own values."""
    run = sample_run(slots)
    assert {type(r) for r in run.records} == set(RECORD_TYPES)
    assert read(write(tmp_path / "a.mcap", run)).records == run.records


def test_inputs_come_back_as_they_were(log):
    """World, radio map, problem and plan are attached; the plan without the seconds it took."""
    run, file = sample_run(10), read(log)
    assert file.world == run.world
    for mine, theirs in ((file.radio_map, run.radio_map), (file.problem, run.problem)):
        for field in dataclasses.fields(theirs):
            np.testing.assert_array_equal(getattr(mine, field.name), getattr(theirs, field.name))
    assert file.plan.seconds == 0.0
    assert dict(file.plan.solver) == {"columns": 12, "iterations": 3}
    assert (file.plan.status, file.plan.cost) == (run.plan.status, run.plan.cost)
    assert file.plan.unserved == ("lift 2",)
    for mine, theirs in zip(file.plan.paths, run.plan.paths, strict=True):
        if theirs is None:
            assert mine is None
        else:
            for field in dataclasses.fields(theirs):
                np.testing.assert_array_equal(
                    getattr(mine, field.name), getattr(theirs, field.name)
                )


def test_only_the_asked_for_types_are_read(log):
    """`iter_records` and `of` select by type and keep the order."""
    run = sample_run(10)
    loads = [r for r in run.records if isinstance(r, ApLoad)]
    assert list(iter_records(log, [ApLoad])) == loads
    assert list(read(log).of(ApLoad)) == loads
    both = [r for r in run.records if isinstance(r, (RunStart, Handover))]
    assert list(read(log).iter_records([Handover, RunStart])) == both


def test_metadata_names_format_epoch_seeds_and_versions(log):
    """Who reads the file later finds what made it."""
    metadata = read(log).metadata
    assert metadata["mapp-run"] == {
        "format": "mapp-run/1",
        "world": "sample hall",
        "epoch": "2024-01-01T00:00:00Z",
        "seed.plan": "0",
        "seed.run": "0",
    }
    versions = metadata["mapp-versions"]
    assert {"python", "numpy", "mcap", "pybullet", "highspy"} <= versions.keys()
    assert read(log).library.startswith("mapp-twin/")


def test_times_are_epoch_plus_simulated_time(log):
    """Log and publish time are 2024-01-01 plus t; the same instant is in the record."""
    for message in read(log).iter_messages():
        assert message.publish_time_ns == message.log_time_ns
    samples = [m for m in read(log).iter_messages({"mapp.Sample"})]
    times = [r.t_s for r in sample_run(10).records if isinstance(r, Sample)]
    assert [m.log_time_ns for m in samples] == [time_ns(t) for t in times]
    assert time_ns(0.0) == EPOCH_NS
    assert time_ns(0.07) == EPOCH_NS + 70_000_000
    assert time_s(time_ns(1234.5678)) == 1234.5678


def test_messages_are_in_time_order_and_numbered(long_log):
    """Times never decrease over all topics; each topic counts its messages from 0."""
    last, counts = 0, defaultdict(int)
    for message in read(long_log).iter_messages():
        assert message.log_time_ns >= last
        assert message.sequence == counts[message.topic]
        last = message.log_time_ns
        counts[message.topic] += 1


def test_topics_are_registered_in_one_order_whatever_happens(log, long_log):
    """Channels do not depend on what the run did, and each robot and AP has its own."""
    assert list(read(log).topics.items()) == list(read(long_log).topics.items())
    topics = read(log).topics
    assert topics["/robots/lift 2/state"] == "mapp.RobotState"
    assert topics["/aps/ap1/load"] == "mapp.ApLoad"
    assert topics["/tf"] == "foxglove.FrameTransforms"


def test_same_records_give_the_same_bytes(tmp_path):
    """No wall clock, no random order: two writings are equal, though the plan took longer."""
    run = sample_run(10)
    slower = dataclasses.replace(
        run.plan, seconds=99.0, solver=run.plan.solver | {"seconds_pricing": 98.0}
    )
    first = write(tmp_path / "a.mcap", run).read_bytes()
    second = write(tmp_path / "b.mcap", run, plan=slower).read_bytes()
    assert first == second
    assert (
        layout_path(tmp_path / "a.mcap").read_bytes()
        == layout_path(tmp_path / "b.mcap").read_bytes()
    )


# --- the hash -----------------------------------------------------------------------------------


def test_stored_hash_is_that_of_the_contents(log, tmp_path):
    """The writer's hash is what the reader computes, also from a copy in another container."""
    stored = read(log).stored_hash
    assert canonical_hash(log) == stored
    plain = copied(log, tmp_path / "plain.mcap", compression=CompressionType.NONE)
    assert plain.read_bytes() != log.read_bytes()
    assert canonical_hash(plain) == stored
    assert read(plain).records == sample_run(10).records


@pytest.mark.parametrize(
    ("kind", "test", "alter", "same"),
    [
        ("message", lambda m: m.sequence == 3, lambda m: dataclasses.replace(m, data=b""), False),
        (
            "message",
            lambda m: m.log_time > EPOCH_NS,
            lambda m: dataclasses.replace(m, log_time=m.log_time + 1),
            False,
        ),
        ("message", lambda m: m.sequence == 3, lambda m: None, False),
        ("attachment", lambda a: a.name == "plan.json", lambda a: None, False),
        (
            "attachment",
            lambda a: a.name == "world.toml",
            lambda a: dataclasses.replace(a, data=a.data + b" "),
            False,
        ),
        (
            "metadata",
            lambda m: m.name == "mapp-run",
            lambda m: dataclasses.replace(m, metadata=m.metadata | {"seed.run": "1"}),
            False,
        ),
        (
            "metadata",
            lambda m: m.name == "mapp-versions",
            lambda m: dataclasses.replace(m, metadata={"python": "9"}),
            True,
        ),
    ],
)
def test_hash_covers_everything_but_the_versions(log, tmp_path, kind, test, alter, same):
    """A change to any message, attachment or seed changes it; another Python does not."""
    other = copied(log, tmp_path / "other.mcap", change=only(kind, test, alter))
    assert (canonical_hash(other) == canonical_hash(log)) is same


def test_hash_has_the_documented_form():
    """The form in the docstring, computed by hand for one message and one attachment."""
    content = ContentHash()
    content.attachment("a", "t", b"data")
    content.message("/x", 5, b"pay")
    content.metadata("mapp-hash", {"sha256": "…"})
    messages = hashlib.sha256(b"\2\0\0\0/x" + struct.pack("<QQ", 5, 3) + b"pay").digest()
    part = hashlib.sha256(b"A\1\0\0\0a\1\0\0\0t" + struct.pack("<Q", 4) + b"data").digest()
    assert content.hexdigest() == hashlib.sha256(messages + part).hexdigest()


# --- what Foxglove is shown ---------------------------------------------------------------------


def shown(path: Path):
    """(topic, log time, decoded message) of the transforms and scenes, in file order."""
    classes = {"foxglove.FrameTransforms": FrameTransforms, "foxglove.SceneUpdate": SceneUpdate}
    for message in read(path).iter_messages(classes):
        yield message.topic, message.log_time_ns, classes[message.schema].FromString(message.data)


def test_statics_come_again_every_minute(long_log):
    """In 130 s: at 0, 60 and 120 s, each time the whole picture and nothing but a new stamp."""
    found = defaultdict(list)
    for message in read(long_log).iter_messages():
        found[message.topic].append(message)
    for topic in ("/scene/static", "/scene/plan", "/radio/coverage"):
        assert [time_s(m.log_time_ns) for m in found[topic]] == [0.0, 60.0, 120.0]
        assert len({len(m.data) for m in found[topic]}) <= 2  # nanoseconds 0 are left out
    times = [time_s(m.log_time_ns) for m in found["/scene/robots"]]
    assert {0.0, 60.0, 120.0} <= set(times)


def test_a_seek_to_any_instant_finds_every_frame(long_log):
    """At each scene message, each frame it uses is in the last transforms before it."""
    frames: set[str] = set()
    for _, _, message in shown(long_log):
        if isinstance(message, FrameTransforms):
            frames = {t.child_frame_id for t in message.transforms}
            frames |= {t.parent_frame_id for t in message.transforms}
        else:
            assert {entity.frame_id for entity in message.entities} <= frames


def test_transforms_come_before_the_scenes_of_the_same_instant(long_log):
    """Within an instant that has transforms, they are first."""
    order = defaultdict(list)
    for topic, time, _ in shown(long_log):
        order[time].append(topic)
    assert all(topics[0] == "/tf" for topics in order.values() if "/tf" in topics)
    assert all(order[time_ns(t)].count("/tf") for t in (0.0, 60.0, 120.0))


def test_a_robot_that_left_vanishes(log):
    """§1.4 leave: from the slot after its arrival r0 is in no transform, and deleted by name."""
    arrival = 8 * SLOT_S
    for topic, time, message in shown(log):
        gone = time_s(time) >= arrival + SLOT_S
        if topic == "/tf" and time_s(time) > 0:
            frames = {t.child_frame_id for t in message.transforms}
            assert frames == ({"hall", "r1"} if gone else {"hall", "r0", "r1"})
        if topic == "/scene/robots":
            bodies = {e.id for e in message.entities}
            deleted = {d.id for d in message.deletions}
            assert ("robot/r0" in bodies, "robot/r0" in deleted) == (not gone, gone)
            assert "robot/lift 2" in deleted
            assert bodies  # never a message that only deletes
    changes = [time_s(t) for topic, t, _ in shown(log) if topic == "/scene/robots"]
    assert changes == [0.0, arrival + SLOT_S]


def test_transforms_are_written_at_every_sample(log):
    """One message per sample, and one at the start, so that no motion is interpolated over."""
    times = [time_s(t) for topic, t, _ in shown(log) if topic == "/tf"]
    assert times == [0.0, *(k * SLOT_S / SAMPLES for k in range(10 * SAMPLES + 1))]


def test_links_are_written_when_they_change(long_log):
    """While nothing moves they are not repeated but for the minute's heartbeat."""
    last = None
    for topic, time, message in shown(long_log):
        if topic == "/scene/links":
            lines = [line.SerializeToString() for line in message.entities[0].lines]
            assert lines != last or time_s(time) in {60.0, 120.0}
            last = lines


def test_an_independent_reader_finds_the_log_good(tmp_path):
    """`@mcap/core`, the package of web viewers, agrees with every CRC, index and schema."""
    folder()
    for slots in (10, LONG):
        assert_good(write(tmp_path / f"{slots}.mcap", sample_run(slots)))
