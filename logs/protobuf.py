"""Records as protobuf messages, generated from the annotations of `logs.records`.

Each record type T is the message `mapp.T` (proto3) in a file of its own, `mapp/T.proto`. Its fields
are the dataclass's fields in the order of their declaration, numbered from 1 (`t_s`): float is
double, int is sint32 (one byte for the frequent −1), str is string, bool is bool, and a tuple is a
packed repeated field of these. So any reader of protobuf gets typed columns without this project.
"""

from __future__ import annotations

import dataclasses
import struct
import sys
from operator import attrgetter
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from logs.errors import LogError
from logs.records import RECORD_TYPES, Record
from logs.wire import packer

PACKAGE = "mapp"

R = TypeVar("R", bound=Record)

_Field = descriptor_pb2.FieldDescriptorProto
_SCALARS = {
    float: _Field.TYPE_DOUBLE,
    int: _Field.TYPE_SINT32,
    str: _Field.TYPE_STRING,
    bool: _Field.TYPE_BOOL,
}


def message_name(record_type: type[Record]) -> str:
    """Full name of the message of a record type, e.g. `mapp.Sample`."""
    return f"{PACKAGE}.{record_type.__name__}"


def file_descriptor(record_type: type[Record]) -> Any:
    """The `FileDescriptorProto` of the file that declares a record type's message."""
    file = descriptor_pb2.FileDescriptorProto(
        name=f"{PACKAGE}/{record_type.__name__}.proto", package=PACKAGE, syntax="proto3"
    )
    message = file.message_type.add(name=record_type.__name__)
    hints = get_type_hints(record_type)
    for number, field in enumerate(dataclasses.fields(record_type), start=1):
        element, repeated = _element(hints[field.name])
        if element not in _SCALARS:
            raise TypeError(f"{record_type.__name__}.{field.name}: {element} has no protobuf type")
        message.field.add(
            name=field.name,
            number=number,
            type=_SCALARS[element],
            label=_Field.LABEL_REPEATED if repeated else _Field.LABEL_OPTIONAL,
        )
    return file


_SCHEMAS: dict[type[Record], bytes] = {}  # those asked for so far


def schema_data(record_type: type[Record]) -> bytes:
    """A record type's serialized `FileDescriptorSet`: the data of its MCAP schema."""
    if record_type not in _SCHEMAS:
        files = descriptor_pb2.FileDescriptorSet(file=[file_descriptor(record_type)])
        _SCHEMAS[record_type] = files.SerializeToString(deterministic=True)
    return _SCHEMAS[record_type]


def field_layout(name: str, data: bytes) -> tuple[tuple[str, int, int, int], ...]:
    """(name, number, type, label) of the fields of message `name` in a `FileDescriptorSet`.

    Raises:
        LogError: `data` is no descriptor set, or does not hold that message.
    """
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(data)
    except DecodeError as error:
        raise LogError(f"the schema of {name} is no protobuf FileDescriptorSet") from error
    for file in files.file:
        for message in file.message_type:
            if f"{file.package}.{message.name}" == name:
                return tuple((f.name, f.number, f.type, f.label) for f in message.field)
    raise LogError(f"the schema of {name} does not declare a message of that name")


def _element(hint: Any) -> tuple[Any, bool]:
    """The scalar type of an annotation, and whether it is a tuple of these."""
    if get_origin(hint) is tuple:
        return get_args(hint)[0], True
    return hint, False


class Codec:
    """Translates one record type to bytes and back.

    Attributes:
        record_type: the record type.
        name: full name of its message.
    """

    def __init__(self, record_type: type[Record], message_class: Any) -> None:
        self.record_type = record_type
        self.name = message_name(record_type)
        self._message = message_class
        hints = get_type_hints(record_type)
        self._fields = tuple(f.name for f in dataclasses.fields(record_type))
        self._values = attrgetter(*self._fields)
        elements = [_element(hints[name]) for name in self._fields]
        self._tuples = tuple(i for i, (_, repeated) in enumerate(elements) if repeated)
        self._strings = tuple(i for i, e in enumerate(elements) if e == (str, False))
        packers = [
            packer(number, kind, repeated=repeated)
            for number, (kind, repeated) in enumerate(elements, start=1)
        ]
        known = [pack for pack in packers if pack is not None]
        self._packers = tuple(known) if len(known) == len(packers) else None

    def encode(self, record: Record) -> bytes:
        """The record's bytes; the same record gives the same bytes.

        Raises:
            LogError: a value is not of its field's type or range.
        """
        if self._packers is not None:
            try:
                values = zip(self._packers, self._values(record), strict=True)
                return b"".join([pack(value) for pack, value in values])
            except (TypeError, ValueError, OverflowError, struct.error):
                pass  # values of other types than the fields'; protobuf takes some of them
        try:
            message = self._message(**dict(zip(self._fields, self._values(record), strict=True)))
            data: bytes = message.SerializeToString(deterministic=True)
        except (TypeError, ValueError, OverflowError) as error:
            raise LogError(
                f"a {self.record_type.__name__} record cannot be written: {error}"
            ) from error
        return data

    def decode(self, data: bytes) -> Record:
        """The record in `data`.

        Raises:
            LogError: `data` does not decode as this record type.
        """
        try:
            message = self._message.FromString(data)
        except (DecodeError, UnicodeDecodeError) as error:
            raise LogError(f"a {self.name} message does not decode: {error}") from error
        values = list(self._values(message))
        for i in self._tuples:
            values[i] = tuple(values[i])
        for i in self._strings:  # ids and states repeat in every slot: keep one copy of each
            values[i] = sys.intern(values[i])
        return self.record_type(*values)


def _codecs() -> dict[str, Codec]:
    pool = descriptor_pool.DescriptorPool()
    for record_type in RECORD_TYPES:
        pool.AddSerializedFile(file_descriptor(record_type).SerializeToString())
    return {
        message_name(t): Codec(
            t, message_factory.GetMessageClass(pool.FindMessageTypeByName(message_name(t)))
        )
        for t in RECORD_TYPES
    }


CODECS: dict[str, Codec] = _codecs()
"""By message name, in the order of `RECORD_TYPES`."""

_BY_TYPE: dict[type[Record], Codec] = {codec.record_type: codec for codec in CODECS.values()}


def encode(record: Record) -> bytes:
    """The bytes of a record of any type; see `Codec.encode`."""
    codec = _BY_TYPE.get(type(record))
    if codec is None:
        raise LogError(f"{type(record).__name__} is no record type of logs/records.py")
    return codec.encode(record)


def decode(name: str, data: bytes) -> Record:
    """The record in `data`, a message of type `name`; see `Codec.decode`."""
    codec = CODECS.get(name)
    if codec is None:
        known = ", ".join(CODECS)
        raise LogError(f"message type {name!r} is none of this version's record types ({known})")
    return codec.decode(data)
