"""World files: TOML to `World` and back, with every problem of a file told at once.

    hall.toml:42: ap[3].position_m[2]: -5.0 is below the floor; give metres above it

`tomllib` reads the values, `worlds.world` says what is right, `worlds.toml_faults` words what is
not, `worlds.toml_lines` finds the line.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import ValidationError

from worlds.errors import Fault, Key, WorldError
from worlds.overrides import BadPathError, set_value
from worlds.part import Part
from worlds.toml_faults import faults_of
from worlds.toml_lines import key_lines, line_of
from worlds.world import Costs, Place, World
from worlds.world_files import take_in_files

if TYPE_CHECKING:
    from worlds.floor import Floor

P = TypeVar("P", bound=Part)

MAX_BYTES = 10_000_000
"""A hall with 50 000 listed obstacles takes half of this."""


@dataclass(frozen=True)
class Source:
    """The text a world was read from; it knows the line of every key.

    Attributes:
        name: of the file, as messages show it.
        text: its content, valid TOML.
        overridden: keys whose values do not come from the text.
    """

    name: str
    text: str
    overridden: tuple[Key, ...] = ()

    @cached_property
    def _lines(self) -> dict[Key, int]:
        return key_lines(self.text)

    def line(self, key: Key) -> int:
        """Line of a key, or of the table it is missing from."""
        return line_of(self._lines, key)

    def error(self, faults: Sequence[Fault]) -> WorldError:
        """The faults as an error whose lines say file and line, in the order of the file."""

        def place(fault: Fault) -> tuple[int, str]:
            key = fault.key
            inside = any(key[: len(k)] == k for k in self.overridden)
            implied = key not in self._lines and any(k[: len(key)] == key for k in self.overridden)
            if key and (inside or implied):
                return 0, f"{self.name} (override): {fault}"
            line = self.line(key)
            return line, f"{self.name}:{line}: {fault}"

        placed = sorted(((place(f), f) for f in faults), key=lambda p: p[0][0])
        return WorldError([f for _, f in placed], [text for (_, text), _ in placed])


def read_world(path: Path, *, overrides: Mapping[str, object] | None = None) -> World:
    """The world a file describes.

    Args:
        path: of the TOML file.
        overrides: values by dotted path, set before anything is checked (`worlds.overrides`).

    Raises:
        WorldError: with all problems of the file, each with its line.
    """
    return _parse(_text_of(path), str(path), overrides, path.parent)[0]


def open_world(path: Path, *, overrides: Mapping[str, object] | None = None) -> tuple[World, Floor]:
    """`read_world` and `worlds.generate.resolve`; the latter's faults have their lines, too."""
    from worlds.generate import resolve  # numpy and more: not needed to read a world

    world, source = _parse(_text_of(path), str(path), overrides, path.parent)
    try:
        return world, resolve(world)
    except WorldError as error:
        raise source.error(error.faults) from None


def read_source(path: Path, *, overrides: Mapping[str, object] | None = None) -> Source:
    """What places the faults found in a world after it was read: `source.error(faults)`.

    Raises:
        WorldError: as `read_world`.
    """
    return _parse(_text_of(path), str(path), overrides, path.parent)[1]


def parse_world(
    text: str,
    name: str = "world.toml",
    *,
    overrides: Mapping[str, object] | None = None,
    folder: Path | None = None,
) -> World:
    """`read_world` for a text that is no file; `name` stands for it in messages.

    Such a world can name further files (`hall.graph.lif`) only where a folder is given for them.
    """
    return _parse(text, name, overrides, folder)[0]


def read_document(path: Path, model: type[P]) -> tuple[P, Source]:
    """What a file of another kind, described by a `Part` of its own, says.

    Returns:
        The part, and what places the faults found in it later.

    Raises:
        WorldError: with all problems of the file, each with its line.
    """
    text, name = _text_of(path), str(path)
    if not text.strip():
        raise _refuse(name, "is empty")
    source = Source(name, text)
    return _validated(model, _data_of(text, name), source, []), source


def _refuse(name: str, message: str, line: int | None = None) -> WorldError:
    place = name if line is None else f"{name}:{line}"
    return WorldError([Fault((), message)], [f"{place}: {message}"])


def _text_of(path: Path) -> str:
    name = str(path)
    try:
        if path.is_dir():
            raise _refuse(name, "is a directory; give the TOML file of a world")
        if not path.exists():
            raise _refuse(name, "there is no such file; check the path")
        if not path.is_file():
            raise _refuse(name, "is not a regular file; give the TOML file of a world")
        size = path.stat().st_size
        if size > MAX_BYTES:
            rule = f"has {size / 1e6:.0f} MB, a world at most {MAX_BYTES / 1e6:.0f} MB"
            raise _refuse(name, f"{rule}; is it a world at all?")
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        if isinstance(error, WorldError):
            raise
        why = error.strerror if isinstance(error, OSError) else str(error)
        raise _refuse(name, f"cannot be read: {why}; check the path and its rights") from error
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        rule = f"byte 0x{data[error.start]:02x} is not UTF-8"
        raise _refuse(name, f"{rule}; save the file with encoding UTF-8", line) from error


def _parse(
    text: str, name: str, overrides: Mapping[str, object] | None, folder: Path | None = None
) -> tuple[World, Source]:
    if not text.strip():
        raise _refuse(name, "is empty; `worlds/tiny.toml` shows what a world looks like")
    data = _data_of(text, name)
    faults: list[Fault] = []
    keys: list[Key] = []
    for path, value in (overrides or {}).items():
        try:
            keys.append(set_value(data, path, value))
        except BadPathError as error:
            faults.append(error.fault)
            keys.append(error.fault.key)
    source = Source(name, text, tuple(keys))
    if file_faults := take_in_files(data, folder):
        # Without the file's contents, names that stand in it would seem to be mistakes.
        raise source.error(faults + file_faults)
    return _validated(World, data, source, faults), source


def _data_of(text: str, name: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise _refuse(name, "is nested too deeply to be a world; check its brackets") from error
    except ValueError as error:  # TOMLDecodeError, or a number beyond what Python converts
        found = re.search(r"^(.*?) \(at line (\d+), column (\d+)\)$", str(error), re.DOTALL)
        last = len(text.splitlines())
        why, line = (found[1], int(found[2])) if found else (str(error), last)
        raise _refuse(name, f"is not valid TOML: {_plain(why)}", line) from error


def _validated(model: type[P], data: dict[str, Any], source: Source, faults: list[Fault]) -> P:
    """The data as a part; the faults found before are told together with those found now."""
    part: P | None = None
    try:
        part = model.model_validate(data)
    except ValidationError as error:
        faults += faults_of(error, data, model)
    if faults or part is None:
        raise source.error(faults)
    return part


def _plain(why: str) -> str:
    """A reason tomllib gives, reworded where one must know TOML by heart to understand it."""
    reworded = {
        "Cannot overwrite a value": "this key is given twice; keep one",
        "Invalid value": "this is no value; text needs quotes, a decimal point is a point",
        "Expected '=' after a key in a key/value pair": "a key needs '=' and a value after it",
        "Invalid statement": "this is neither `key = value` nor a [table] header",
    }
    twice = re.match(r"Cannot declare \((.*?),?\) twice", why)
    if twice:
        header = ".".join(re.findall(r"'([^']*)'", twice[1]))
        return f"[{header}] is headed twice; keep one, or write [[{header}]] for a list"
    if why.startswith("Exceeds the limit"):
        return "this number has too many digits"
    return reworded.get(why, why[:1].lower() + why[1:])


def dump_world(world: World) -> str:
    """Canonical TOML of a world: `parse_world(dump_world(w)) == w`, and equal worlds equal texts.

    What equals its default is left out; the defaults belong to the format's version.
    """
    return "\n".join(_table(world, "")).strip("\n") + "\n"


def _table(part: Part, header: str) -> list[str]:
    """The lines of a table: its values, then the tables below it."""
    pairs: list[str] = []
    below: list[str] = []
    for key, field in type(part).model_fields.items():
        value = getattr(part, key)
        path = f"{header}.{key}" if header else key
        if value is None or (value == field.default and key != "format"):
            continue
        if isinstance(value, Part) and not isinstance(value, Place | Costs):
            inner = _table(value, path)
            below += ["", f"[{path}]", *inner] if inner and inner[0] else inner
        elif isinstance(value, tuple) and value and isinstance(value[0], Part):
            for element in value:
                below += ["", f"[[{path}]]", *_table(element, path)]
        else:
            pairs.append(f"{key} = {_value(value)}")
    return pairs + below


def _value(value: Any) -> str:
    match value:
        case Place(station=str(station)):
            return _value(station)
        case Part():
            given = {key: v for key, v in dict(value).items() if v is not None}
            return "{" + ", ".join(f"{key} = {_value(v)}" for key, v in given.items()) + "}"
        case tuple():
            return f"[{', '.join(_value(v) for v in value)}]"
        case bool():
            return str(value).lower()
        case str() if "\n" in value:
            return '"""\n' + "\n".join(_escaped(line) for line in value.split("\n")) + '"""'
        case str():
            return f'"{_escaped(value)}"'
        case _:
            return repr(value)


def _escaped(text: str) -> str:
    """For a basic string; quotes are always escaped, so three of them never end one early."""
    text = text.replace("\\", "\\\\").replace('"', '\\"')
    return re.sub(r"[\x00-\x08\x0a-\x1f\x7f]", lambda c: f"\\u{ord(c[0]):04X}", text)
