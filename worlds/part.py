"""`Part`: what all parts of a world have in common."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    ModelWrapValidatorHandler,
    ValidationError,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from worlds.errors import Fault


def given(part: object, key: str) -> object:
    """What a part, finished or still as read from a file, says under a key; None if nothing."""
    if isinstance(part, Mapping):
        return part.get(key)
    return getattr(part, key, None) if isinstance(part, Part) else None


def listed(part: object, key: str) -> Sequence[object]:
    """The elements of a list of parts, finished or not; none if it is not a list."""
    found = given(part, key)
    return found if isinstance(found, list | tuple) else ()


def nearest(word: str, known: Sequence[str]) -> str:
    """` did you mean 'x'?` for the known word most like this one; empty if none is like it."""
    found = difflib.get_close_matches(word, known, n=1, cutoff=0.55)
    return f" did you mean '{found[0]}'?" if found else ""


def _tuples(value: object) -> object:
    """Lists (TOML's arrays) as the tuples the models hold."""
    return tuple(_tuples(v) for v in value) if isinstance(value, list | tuple) else value


class Part(BaseModel):
    """Base of all parts of a world: frozen, strict, no unknown keys, no NaN or infinity.

    A part reports all that is wrong with it at once. pydantic checks relations between fields
    only when every field is right by itself; `faults_given` sees the input in any state, so a
    misspelt key does not hide a doubled id.
    """

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)

    exactly_one: ClassVar[tuple[str, ...]] = ()
    at_most_one: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def accept(cls, data: object) -> object:
        """Short forms of the part, written out."""
        return data

    @classmethod
    def faults_given(cls, data: Mapping[str, object]) -> list[Fault]:
        """Faults between fields, found in input that may be wrong in other ways, too."""
        faults = []
        one = [key for key in cls.exactly_one if data.get(key) is not None]
        unknown = [key for key in data if key not in cls.model_fields]
        meant = any(nearest(str(key), cls.exactly_one) for key in unknown)  # said there already
        if cls.exactly_one and not one and not meant:
            faults.append(Fault((), f"has none of {', '.join(cls.exactly_one)}; give one of them"))
        most = [key for key in cls.at_most_one if data.get(key) is not None]
        for first, *rest in filter(None, (one, most)):
            faults += [Fault((k,), f"is given beside {first}; keep one of the two") for k in rest]
        return faults

    def faults(self) -> list[Fault]:
        """Faults between the values of a part whose fields are right by themselves."""
        return []

    @model_validator(mode="wrap")
    @classmethod
    def _all_at_once(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        data = cls.accept(data)
        if not isinstance(data, Mapping):
            return handler(data)
        data = {key: _tuples(value) for key, value in data.items()}
        faults = cls.faults_given(data)
        found: list[InitErrorDetails] = []
        part = None
        try:
            part = handler(data)
            faults += part.faults() if not faults else []
        except ValidationError as error:
            for e in error.errors(include_url=False):
                kind = PydanticCustomError(e["type"], e["msg"], e.get("ctx"))
                found.append(InitErrorDetails(type=kind, loc=e["loc"], input=e["input"]))
        for fault in faults:
            rule = PydanticCustomError("rule", "{text}", {"text": fault.message})
            found.append(InitErrorDetails(type=rule, loc=fault.key, input=data))
        if part is None or found:
            raise ValidationError.from_exception_data(cls.__name__, found)
        return part
