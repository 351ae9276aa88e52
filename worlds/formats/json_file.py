"""JSON from strangers: read within limits, its faults in words."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NoReturn

from pydantic import BaseModel, ConfigDict, ValidationError

from worlds.errors import Fault, WorldError
from worlds.toml_faults import show

MAX_BYTES = 64_000_000
SHOWN = 8
"""Faults of one file that are listed; the others are counted."""


class JsonPart(BaseModel):
    """Base of what a JSON file must hold; keys it does not name are somebody else's business."""

    model_config = ConfigDict(frozen=True, strict=True, extra="ignore", allow_inf_nan=False)


def read_text(path: Path, what: str) -> str:
    """The text of a file that should be `what` ("a LIF file").

    Raises:
        WorldError: no such file, no regular one, too large, or not UTF-8.
    """
    name = str(path)
    try:
        if path.is_dir():
            raise file_error(name, f"is a directory; name {what}")
        if not path.exists():
            raise file_error(name, "there is no such file; check the path")
        if not path.is_file():
            raise file_error(name, f"is not a regular file; name {what}")
        size = path.stat().st_size
        if size > MAX_BYTES:
            rule = f"has {size / 1e6:.0f} MB, {what} at most {MAX_BYTES / 1e6:.0f} MB"
            raise file_error(name, f"{rule}; is it one at all?")
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        if isinstance(error, WorldError):
            raise
        why = error.strerror if isinstance(error, OSError) else str(error)
        raise file_error(name, f"cannot be read: {why}; check the path and its rights") from error
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        rule = f"byte 0x{data[error.start]:02x} is not UTF-8"
        raise file_error(f"{name}:{line}", f"{rule}; save the file as UTF-8") from error


def parse_json(text: str, name: str, what: str) -> Any:
    """The value a text says; `name` stands for its file in messages.

    Raises:
        WorldError: no JSON, or none that means the same to every reader (NaN, doubled keys).
    """

    def constant(word: str) -> NoReturn:
        at = text.find(word)
        line = text.count("\n", 0, max(at, 0)) + 1
        raise file_error(f"{name}:{line}", f"{word} is no number; give one")

    def pairs(found: list[tuple[str, Any]]) -> dict[str, Any]:
        made = dict(found)
        if len(made) < len(found):
            keys = [key for key, _ in found]
            key = next(k for k in keys if keys.count(k) > 1)
            raise file_error(name, f"the key '{key}' stands twice in one object; keep one")
        return made

    if not text.strip():
        raise file_error(name, f"is empty; name {what}")
    try:
        return json.loads(text, parse_constant=constant, object_pairs_hook=pairs)
    except json.JSONDecodeError as error:
        why = error.msg[:1].lower() + error.msg[1:]
        place = f"{name}:{error.lineno}"
        raise file_error(place, f"is not valid JSON: {why}; get the whole file") from error
    except RecursionError as error:
        raise file_error(name, f"is nested too deeply to be {what}") from error
    except ValueError as error:
        if isinstance(error, WorldError):
            raise
        raise file_error(name, f"is not valid JSON: {error}") from error


def faults_of(error: ValidationError, data: object, name: str) -> WorldError:
    """What pydantic finds wrong with a file's value, in words, each with its place."""
    words = {
        "missing": "is missing",
        "finite_number": "is no finite number",
        "string_too_short": "is empty",
        "string_too_long": "is too long",
        "too_short": "is empty",
        "string_pattern_mismatch": "has a control character",
    }
    types = {"float": "a number", "string": "a text", "list": "a list", "dict": "an object",
             "bool": "true or false", "tuple": "a list"}  # fmt: skip
    found = []
    for e in error.errors(include_url=False):
        kind = e["type"]
        if kind in words:
            said = words[kind]
        elif kind.removesuffix("_type") in types:
            said = f"{show(e['input'])} is not {types[kind.removesuffix('_type')]}"
        elif kind == "model_type":
            said = f"{show(e['input'])} is not an object"
        else:
            said = f"{show(e['input'])}: {e['msg'][:1].lower()}{e['msg'][1:]}"
        found.append((place_of(e["loc"]), said))
    return listed_error(name, found)


def place_of(key: tuple[str | int, ...]) -> str:
    """`layouts[0].nodes[3].nodePosition.x`."""
    place = ""
    for step in key:
        place += f"[{step}]" if isinstance(step, int) else f".{step}" if place else str(step)
    return place


def listed_error(name: str, found: list[tuple[str, str]]) -> WorldError:
    """Faults (place, what is wrong) of a file, the first of them listed."""
    lines = [
        f"{name}: {place}: {said}" if place else f"{name}: {said}" for place, said in found[:SHOWN]
    ]
    if len(found) > SHOWN:
        lines.append(f"{name}: and {len(found) - SHOWN} more faults")
    return WorldError([Fault((), line) for line in lines], lines)


def file_error(place: str, message: str) -> WorldError:
    """One fault of a file, or of a line of it."""
    return WorldError([Fault((), message)], [f"{place}: {message}"])
