"""Records become protobuf messages and come back unchanged."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import ClassVar, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import given, settings
from hypothesis import strategies as st

from logs.errors import LogError
from logs.protobuf import (
    CODECS,
    decode,
    encode,
    field_layout,
    file_descriptor,
    message_name,
    schema_data,
)
from logs.records import RECORD_TYPES, Record, RobotState, RunStart, Sample

STATE = RobotState(1.5, 3, "r0", 2, 5, -1, 5, "moving", "", "ap1", "connected", 21.25, 800.0)

SCALARS = {
    float: st.floats(allow_nan=False),
    int: st.integers(-(2**31), 2**31 - 1),
    bool: st.booleans(),
    str: st.text(st.characters(codec="utf-8"), max_size=12),
}


def values(hint: object) -> st.SearchStrategy:
    """Any value of an annotation."""
    if get_origin(hint) is tuple:
        return st.lists(SCALARS[get_args(hint)[0]], max_size=5).map(tuple)
    return SCALARS[hint]


def records(record_type: type[Record]) -> st.SearchStrategy:
    """Any record of a type."""
    hints = get_type_hints(record_type)
    return st.builds(record_type, *(values(hints[f.name]) for f in fields(record_type)))


@pytest.mark.parametrize("record_type", RECORD_TYPES, ids=lambda t: t.__name__)
def test_record_comes_back_unchanged(record_type):
    """decode(encode(record)) is the record, for any values of its fields, and of their types."""

    @settings(max_examples=30, deadline=None)
    @given(records(record_type))
    def check(record):
        data = encode(record)
        back = decode(message_name(record_type), data)
        assert back == record
        assert [type(getattr(back, f.name)) for f in fields(back)] == [
            type(getattr(record, f.name)) for f in fields(record)
        ]
        assert encode(back) == data

    check()


@pytest.mark.parametrize("record_type", RECORD_TYPES, ids=lambda t: t.__name__)
def test_packed_bytes_are_those_protobuf_writes(record_type):
    """Field by field by hand or by protobuf's own serializer: the same bytes, for any values."""
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file_descriptor(record_type))
    message_class = message_factory.GetMessageClass(
        pool.FindMessageTypeByName(message_name(record_type))
    )

    @settings(max_examples=30, deadline=None)
    @given(records(record_type))
    def check(record):
        message = message_class(**{f.name: getattr(record, f.name) for f in fields(record)})
        assert encode(record) == message.SerializeToString(deterministic=True)

    check()


@pytest.mark.parametrize("value", [0.0, -0.0, math.inf, -math.inf, 5e-324])
def test_zero_is_left_out_and_nothing_else(value):
    """−0 is another number than 0 and is written, as protobuf does."""
    data = encode(replace(STATE, snr_db=value))
    back = decode("mapp.RobotState", data).snr_db
    assert (back, math.copysign(1.0, back)) == (value, math.copysign(1.0, value))
    assert len(data) == len(encode(replace(STATE, snr_db=0.0))) + 9 * (str(value) != "0.0")


def test_numbers_of_numpy_are_taken_as_protobuf_takes_them():
    """Values of other types than the field's go through protobuf itself."""
    state = replace(STATE, slot=np.int64(3), snr_db=np.float64(21.25), visit=np.int32(2))
    assert encode(state) == encode(STATE)


@pytest.mark.parametrize("record_type", RECORD_TYPES, ids=lambda t: t.__name__)
def test_fields_are_numbered_in_the_order_of_declaration(record_type):
    """Field n of the message is the n-th field of the dataclass, `t_s` the first."""
    message = file_descriptor(record_type).message_type[0]
    names = [f.name for f in fields(record_type)]
    assert names[0] == "t_s"
    assert [(f.name, f.number) for f in message.field] == [
        (name, number) for number, name in enumerate(names, start=1)
    ]


@pytest.mark.parametrize("record_type", RECORD_TYPES, ids=lambda t: t.__name__)
def test_any_reader_decodes_by_the_schema_alone(record_type):
    """The descriptor set is complete: a fresh pool built from it decodes the fields by name."""
    files = descriptor_pb2.FileDescriptorSet.FromString(schema_data(record_type))
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        assert file.syntax == "proto3"
        pool.Add(file)
    name = message_name(record_type)
    message_class = message_factory.GetMessageClass(pool.FindMessageTypeByName(name))
    hints = get_type_hints(record_type)
    example = {float: 0.25, int: -1, bool: True, str: "ä"}
    given_values = {
        f.name: (example[get_args(hints[f.name])[0]],) * 2
        if get_origin(hints[f.name]) is tuple
        else example[hints[f.name]]
        for f in fields(record_type)
    }
    message = message_class.FromString(encode(record_type(**given_values)))
    for field, value in given_values.items():
        got = getattr(message, field)
        assert (tuple(got) if isinstance(value, tuple) else got) == value


def test_every_type_has_a_message_in_order():
    """All record types are there, under `mapp.` and their own name, in the registered order."""
    assert list(CODECS) == [f"mapp.{t.__name__}" for t in RECORD_TYPES]


def test_columns_are_packed():
    """A column of n numbers is one length-delimited field: 8 bytes per float and a short head."""
    empty = Sample(1.0, 0, (), (), (), (), (), (), (), (), ())
    column = tuple(k / 7 for k in range(300))
    assert len(encode(replace(empty, x_m=column))) - len(encode(empty)) == 8 * 300 + 3


def test_minus_one_takes_one_byte():
    """−1 ("none") is frequent: it costs its tag and one byte, not ten."""
    assert len(encode(replace(STATE, edge=-1))) == len(encode(replace(STATE, edge=0))) + 2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"slot": 2**31}, "range"),
        ({"slot": 1.5}, "integer"),
        ({"robot": 7}, ""),
        ({"snr_db": "high"}, ""),
        ({"robot": "\ud800"}, "surrogates"),
    ],
)
def test_value_of_the_wrong_kind_is_refused(change, words):
    """A value its field cannot hold is a LogError that names the record type."""
    with pytest.raises(LogError, match="a RobotState record cannot be written") as caught:
        encode(replace(STATE, **change))
    assert words in str(caught.value)


@pytest.mark.parametrize("robots", [(7,), ("r0", None)])
def test_texts_of_the_wrong_kind_are_refused(robots):
    """Nor is a list of texts that holds something else written."""
    hints = get_type_hints(RunStart)
    empty = {float: 0.0, int: 0, str: "", bool: False}
    good = RunStart(*(empty.get(hints[f.name], ()) for f in fields(RunStart)))
    assert decode(message_name(RunStart), encode(good)) == good
    with pytest.raises(LogError, match="a RunStart record cannot be written"):
        encode(replace(good, robots=robots))


def test_unknown_types_are_refused():
    """Neither a record type nor a message name that is not in records.py passes."""

    @dataclass(frozen=True, slots=True)
    class Other(Record):
        topic: ClassVar[str] = "/other"

    with pytest.raises(LogError, match="Other is no record type"):
        encode(Other(0.0))
    with pytest.raises(LogError, match=r"mapp\.Other.*mapp\.Sample"):
        decode("mapp.Other", b"")


@pytest.mark.parametrize("data", [b"\xff", b"\x09\x00", b"\x1a\x05ab", b"\x1a\x02\xff\xfe"])
def test_bytes_that_are_no_message_are_refused(data):
    """Broken wire format and broken UTF-8 are LogErrors."""
    with pytest.raises(LogError, match=r"mapp\.RobotState message does not decode"):
        decode("mapp.RobotState", data)


def test_type_without_a_protobuf_form_is_a_programming_error():
    """A record field that is neither a scalar nor a tuple of them is found when it is declared."""

    @dataclass(frozen=True, slots=True)
    class Nested(Record):
        inner: dict

    with pytest.raises(TypeError, match=r"Nested\.inner"):
        file_descriptor(Nested)


def test_layout_of_a_schema_tells_versions_apart():
    """Renamed, renumbered or retyped fields show; no set, or another message, is refused."""
    name = message_name(RunStart)
    known = field_layout(name, schema_data(RunStart))
    assert [entry[0] for entry in known] == [f.name for f in fields(RunStart)]
    file = file_descriptor(RunStart)
    file.message_type[0].field[1].name = "hall"
    other = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    assert field_layout(name, other) != known
    with pytest.raises(LogError, match="does not declare"):
        field_layout("mapp.Sample", other)
    with pytest.raises(LogError, match="no protobuf FileDescriptorSet"):
        field_layout(name, b"\xff\xff")
