"""What pydantic finds wrong with a world, in the words of the person who wrote the file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from worlds.errors import Fault, Key
from worlds.part import Part, nearest
from worlds.world import Place, World

_MISSING: dict[Key, str] = {
    ("name",): 'is missing; give the world a name: name = "my hall"',
    ("hall",): "is missing; add a table [hall] with size_m and pitch_m",
    ("ap",): "is missing; add an access point: [[ap]] with id and position_m",
}
_UNITS = {  # by the end of a key; the first that fits
    "_m_s": "m/s",
    "_m": "m",
    "_s": "s",
    "_ghz": "GHz",
    "_mhz": "MHz",
    "_mbps": "Mbit/s",
    "interruption": "ms",
}
_BELOW = {"position_m", "base_m"}  # heights: less than 0 is below the floor


def faults_of(
    error: ValidationError, data: Mapping[str, object], model: type[Part] = World
) -> list[Fault]:
    """The errors pydantic reports of `World`, reworded; keys are those of the file.

    Args:
        error: raised by `model.model_validate(data)`.
        data: what the file says.
        model: what the file describes.
    """
    found = [(_key(e["loc"]), e) for e in error.errors(include_url=False)]
    meant = {
        (*key[:-1], near)
        for key, e in found
        if e["type"] == "extra_forbidden" and (near := _near_key(key, model))
    }
    faults: dict[Fault, None] = {}  # a dict keeps the order and drops repetitions
    for key, e in found:
        if e["type"] == "missing" and key in meant:
            continue  # misspelt rather than missing, and said so there
        if e["type"] == "missing" and isinstance(key[-1], int):
            list_key = key[:-1]
            wanted = max(int(k[-1]) for k, _ in found if k[:-1] == list_key) + 1
            value = _value_at(data, list_key)
            rule = f"{show(value)} has too few entries; give {wanted}"
            faults[Fault(list_key, rule)] = None
        else:
            faults[Fault(key, _message(key, e, model))] = None
    return list(faults)


def show(value: object) -> str:
    """A value as it would stand in the file, shortened."""
    if isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, str):
        text = f'"{value}"'
    elif isinstance(value, list | tuple):
        text = f"[{', '.join(show(v) for v in value[:8])}{', …' if len(value) > 8 else ''}]"
    elif isinstance(value, Mapping):
        text = "{" + ", ".join(f"{k} = {show(v)}" for k, v in list(value.items())[:4]) + "}"
    else:
        text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


def _key(loc: tuple[str | int, ...]) -> Key:
    """Without the tag that pydantic inserts after a field that may have two forms."""
    tagged = loc[:2] in {
        ("plan", "objective"),
        ("run", "interruption"),
        ("radio", "fading_correlation"),
    }
    return (*loc[:2], *loc[3:]) if tagged else loc


def _value_at(data: object, key: Key) -> object:
    for step in key:
        data = data[step]  # type: ignore[index]  # pydantic found the error there
    return data


def _message(key: Key, e: ErrorDetails, model: type[Part]) -> str:
    kind: str = e["type"]
    value: Any = e["input"]
    limits: dict[str, Any] = e.get("ctx", {})
    shown = show(value)
    match kind:
        case "rule":
            return e["msg"]
        case "form":
            return f"{shown} {e['msg']}"
        case "missing":
            table = _table_name(key[:-1]) if key[1:] else model.__name__.lower()
            return _MISSING.get(key, f"is missing; every {table} needs it")
        case "extra_forbidden":
            return _unknown_key(key, model)
        case "model_type" if _part_at(key, model) is Place:
            return f"{shown} is no place; give a station's name, {{cell = …}} or {{at_m = …}}"
        case "model_type" if isinstance(value, tuple | list) and not isinstance(key[-1], int):
            return f"must be a single table; write [{key[-1]}] with single brackets"
        case "model_type":
            return f"{shown} must be a table; give its keys under {_table_name(key)}"
        case "tuple_type" if isinstance(value, Mapping):
            return f"must be a list of tables; write [[{_dotted(key)}]] with double brackets"
        case "tuple_type":
            return f"{shown} must be a list in square brackets, like [1.0, 2.0]"
        case "too_long":
            return f"{shown} has too many entries; give {limits['max_length']}"
        case "float_type" | "int_type":
            return _not_a_number(value, shown, whole=kind == "int_type")
        case "bool_type":
            return f"{shown} must be true or false, without quotes"
        case "string_type":
            return f'{shown} must be text in quotes; write "{str(value)[:40]}"'
        case "string_too_short":
            return f"{shown} is empty; give a name"
        case "string_too_long":
            return f"{shown} has more than {limits['max_length']} characters; shorten it"
        case "string_pattern_mismatch":
            return f"{value!r:.60} contains a line break, tab or other control character; remove it"
        case "finite_number":
            return f"{shown} is no finite number; give one"
        case "literal_error":
            known = re.findall(r"'([^']*)'", limits["expected"])
            near = nearest(value, known) if isinstance(value, str) else ""
            return f"{shown} must be one of {', '.join(known)};{near}".rstrip(";")
        case "greater_than" | "greater_than_equal" | "less_than" | "less_than_equal":
            return _out_of_range(key, value, kind, next(iter(limits.values())))
        case _:
            return f"{shown} is not accepted: {e['msg'][:1].lower()}{e['msg'][1:]}"


def _not_a_number(value: object, shown: str, *, whole: bool) -> str:
    wanted = "a whole number" if whole else "a number"
    if isinstance(value, float) and value.is_integer():
        return f"{shown} must be a whole number; write {int(value)}"
    if isinstance(value, str) and re.fullmatch(r"\s*[-+]?[\d._]+\s*", value):
        return f"{shown} is text; write {wanted} without quotes"
    return f"{shown} is not {wanted}; give one"


def _out_of_range(key: Key, value: float, kind: str, limit: float) -> str:
    name = next(step for step in reversed(key) if isinstance(step, str))
    unit = next((f" {unit}" for end, unit in _UNITS.items() if name.endswith(end)), "")
    if kind.startswith("greater") and name in _BELOW:
        return f"{value} is below the floor; give metres above it"
    if kind.startswith("less") and unit in {" m", " m/s"}:
        hint = f"millimetres? then write {value / 1000:g}" if value / 1000 <= limit else "check it"
        return f"{value:g} is more than {limit:g}{unit}; {hint}"
    if name == "share" and 1 <= value <= 100:
        return f"{value:g} is more than the whole; {value:g} %? then write {value / 100:g}"
    rule = {
        "greater_than": "more than",
        "greater_than_equal": "at least",
        "less_than": "less than",
        "less_than_equal": "at most",
    }[kind]
    side = "small" if kind.startswith("greater") else "large"
    return f"{value} is too {side}; give {rule} {limit:.15g}{unit}"


def _unknown_key(key: Key, model: type[Part]) -> str:
    part = _part_at(key[:-1], model)
    name = str(key[-1])
    known = list(part.model_fields) if part else []
    homes = [home for home, fields in _tables(model) if name in fields]
    near = _near_key(key, model)
    message = "is not a known key"
    if near:
        message += f"; did you mean '{near}'?"
    if homes:
        message += f"; {name} belongs in {' or '.join(homes[:3])}"
    if not near and not homes:
        message += f"; known here are {', '.join(known)}"
    return message


def _near_key(key: Key, model: type[Part]) -> str:
    part = _part_at(key[:-1], model)
    near = nearest(str(key[-1]), list(part.model_fields)) if part else ""
    return near.split("'")[1] if near else ""


def _parts_in(annotation: object) -> Iterator[type[Part]]:
    """The parts an annotation such as `tuple[Robot, ...] | None` speaks of."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        if issubclass(annotation, Part):
            yield annotation
        return
    for inner in get_args(annotation):
        yield from _parts_in(inner)


def _part_at(key: Key, model: type[Part]) -> type[Part] | None:
    """The model that stands at a key; None where there is none."""
    part: type[Part] | None = model
    for step in key:
        if isinstance(step, int):
            continue
        field = part.model_fields.get(step) if part else None
        part = next(_parts_in(field.annotation), None) if field else None
    return part


def _tables(model: type[Part]) -> Iterator[tuple[str, list[str]]]:
    """Every table of the format as it is headed, with its keys."""

    def walk(part: type[Part], path: str) -> Iterator[tuple[str, list[str]]]:
        for name, field in part.model_fields.items():
            inner = next(_parts_in(field.annotation), None)
            if inner is None:
                continue
            at = f"{path}.{name}" if path else name
            many = str(field.annotation).startswith("tuple[")
            yield f"[[{at}]]" if many else f"[{at}]", list(inner.model_fields)
            yield from walk(inner, at)

    return walk(model, "")


def _dotted(key: Key) -> str:
    return ".".join(str(step) for step in key if isinstance(step, str))


def _table_name(key: Key) -> str:
    if not key:
        return "world"
    many = isinstance(key[-1], int)
    return f"[[{_dotted(key)}]]" if many else f"[{_dotted(key)}]"
