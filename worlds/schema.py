"""What a world file may say, told from the model: a JSON schema for editors, and a page.

The schema is draft-07, the newest that TOML language servers (taplo) understand.
Rules between keys that JSON schema cannot say are left to the program.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator
from typing import Any, get_args, get_origin

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from worlds.part import Part
from worlds.world import Place, World

DRAFT = "http://json-schema.org/draft-07/schema#"

Json = dict[str, Any]


def json_schema() -> Json:
    """The schema of a world file; TOML maps onto JSON."""
    models: dict[str, type[Part]] = {model.__name__: model for model in _models(World)}
    schema = World.model_json_schema()
    definitions = {name: _plain(part) for name, part in schema.pop("$defs", {}).items()}
    root: Json = _plain(schema)
    for name, part in [*definitions.items(), ("World", root)]:
        model = models.get(name)
        if model is None:
            continue
        _add_choices(part, model)
        part["description"] = _first_paragraph(model)
        for key, value in part.get("properties", {}).items():
            value.setdefault("description", _described(model, key))
    # The short forms that `accept` takes.
    for name, meaning in (("Place", "name of a station"), ("Measured", "file of a survey")):
        if name in definitions:
            short = {"type": "string", "minLength": 1, "description": meaning}
            definitions[name] = {
                "description": definitions[name]["description"],
                "anyOf": [short, definitions[name]],
            }
    return {
        "$schema": DRAFT,
        "title": "mapp-twin world",
        **{key: value for key, value in root.items() if key != "title"},
        "definitions": definitions,
    }


def schema_text() -> str:
    """The schema as the text of a file."""
    return json.dumps(json_schema(), indent=2, ensure_ascii=False) + "\n"


def _plain(value: Any) -> Any:
    """Pydantic's draft 2020-12 in draft-07, without null, which TOML does not have."""
    if isinstance(value, list):
        return [_plain(v) for v in value]
    if not isinstance(value, dict):
        return value
    if "properties" in value:
        kept = {k: _plain(v) for k, v in value.items() if k not in {"properties", "title"}}
        return kept | {"properties": {k: _plain(v) for k, v in value["properties"].items()}}
    made: Json = {}
    for key, inner in value.items():
        if key == "prefixItems":
            made["items"] = _plain(inner)
        elif key == "$ref":
            made["$ref"] = str(inner).replace("#/$defs/", "#/definitions/")
        elif key == "anyOf":
            options = [_plain(v) for v in inner if v != {"type": "null"}]
            made.update(options[0] if len(options) == 1 else {"anyOf": options})
        elif key == "oneOf":
            made["anyOf"] = [_plain(v) for v in inner]
        elif (key == "default" and inner is None) or key in {"title", "discriminator"}:
            continue
        else:
            made[key] = _plain(inner)
    if "$ref" in made and len(made) > 1:  # draft-07 ignores what stands beside a reference
        made = {"allOf": [{"$ref": made.pop("$ref")}], **made}
    return made


def _add_choices(part: Json, model: type[Part]) -> None:
    """`exactly_one` and `at_most_one` of a part, as far as a schema can say them."""
    if model.exactly_one:
        part["oneOf"] = [{"required": [key]} for key in model.exactly_one]
    if len(model.at_most_one) > 1:
        part["not"] = {"required": list(model.at_most_one)}


# The page


def format_page() -> str:
    """docs/world-format.md."""
    lines = [
        "# The world file",
        "",
        "<!-- Made from worlds/world.py by `twin schema -o docs/world-format.md`. -->",
        "",
        "A world is a TOML file: a hall, what stands in it, its access points, its robots, and",
        "what is asked of them. [`worlds/tiny.toml`](../worlds/tiny.toml) is a small one, every",
        "line of it explained.",
        "",
        "- Units are in the names: `_m` metres, `_s` seconds, `_deg` degrees, `_dbm`, `_db`,",
        "  `_ghz`, `_mhz`, `_mbps`. (0, 0) is the lower left corner of the hall, x goes right,",
        "  y goes up, heights count from the floor.",
        "- What has a default may be left out. An unknown key is an error that names the nearest",
        "  known one. All mistakes of a file are told at once, each with its line.",
        '- Numbers are strict: `60` is a count and a length, `60.0` only a length, `"60"` neither.',
        "- A `[[table]]` with double brackets may stand many times.",
        "- Any value can be set for one run: `--set radio.tx_power_dbm=20`,",
        "  `--set ap.west.capacity=4`.",
        "",
        "`twin schema -o world.schema.json` writes a JSON schema of this page; with the line",
        "`#:schema ./world.schema.json` at the top of a world, editors that know TOML schemas",
        "complete keys and underline mistakes. `twin check` looks for what is legal but unwise",
        "([codes](check-codes.md)).",
    ]
    for header, model in tables():
        lines += ["", f"## {header}", "", *_prose(model)]
        choice = _choice(model)
        if choice:
            lines += ["", choice]
        keys = [k for k in model.model_fields if _inner(model, k) is None or _inline(model, k)]
        if keys:
            lines += ["", "| key | value | default | meaning |", "|---|---|---|---|"]
        for key in keys:
            row = (f"`{key}`", _value(model, key), _default(model, key), _described(model, key))
            lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |")
    return "\n".join(lines) + "\n"


def undescribed() -> list[str]:
    """Keys of the format that say nothing about themselves; there should be none."""
    return [
        f"{header} {key}"
        for header, model in tables()
        for key in model.model_fields
        if not _described(model, key)
    ]


def tables() -> Iterator[tuple[str, type[Part]]]:
    """Every table of the format, as it is headed in a file, in the order of the model."""

    def walk(model: type[Part], path: str) -> Iterator[tuple[str, type[Part]]]:
        for key in model.model_fields:
            inner = _inner(model, key)
            if inner is None or _inline(model, key):
                continue
            at = f"{path}.{key}" if path else key
            yield f"[[{at}]]" if _many(model, key) else f"[{at}]", inner
            yield from walk(inner, at)

    yield "Top level", World
    yield from walk(World, "")
    seen: list[type[Part]] = []
    for model in _models(World):
        for key in model.model_fields:
            inner = _inner(model, key)
            if inner is not None and _inline(model, key) and inner not in seen:
                seen.append(inner)
                yield f"Value {{{inner.__name__.lower()}}}", inner


def _models(model: type[Part]) -> Iterator[type[Part]]:
    """A model and all that its fields hold, each once."""
    seen = {model: None}
    todo = [model]
    while todo:
        for field in todo.pop(0).model_fields.values():
            for part in _parts(field.annotation, field.metadata):
                if part not in seen:
                    seen[part] = None
                    todo.append(part)
    yield from seen


def _parts(annotation: object, metadata: object = ()) -> Iterator[type[Part]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        if issubclass(annotation, Part):
            yield annotation
        return
    for inner in get_args(annotation):
        yield from _parts(inner)


def _inner(model: type[Part], key: str) -> type[Part] | None:
    return next(_parts(model.model_fields[key].annotation), None)


def _many(model: type[Part], key: str) -> bool:
    return "tuple[" in str(model.model_fields[key].annotation)


def _inline(model: type[Part], key: str) -> bool:
    """Whether a part stands in a value and not under a header of its own.

    Places do, and parts that are only one of several forms, such as the costs of an objective.
    """
    annotation: object = model.model_fields[key].annotation
    forms = [form for form in get_args(annotation) if form not in {type(None), Ellipsis}]
    if isinstance(annotation, type) or get_origin(annotation) is tuple or len(forms) == 1:
        return _inner(model, key) is Place
    return True


def _prose(model: type[Part]) -> list[str]:
    return _doc(model).split("\n")


def _first_paragraph(model: type[Part]) -> str:
    return " ".join(_doc(model).replace("`", "").split("\n\n")[0].split())


def _doc(model: type[Part]) -> str:
    """Its docstring, without references that only developers can look up."""
    return re.sub(r" \(1-semantics[^)]*\)", "", inspect.cleandoc(model.__doc__ or ""))


def _choice(model: type[Part]) -> str:
    said = []
    if model.exactly_one:
        said.append(f"Exactly one of {_keys(model.exactly_one)}.")
    if model.at_most_one:
        said.append(f"At most one of {_keys(model.at_most_one)}.")
    return " ".join(said)


def _keys(names: tuple[str, ...]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _described(model: type[Part], key: str) -> str:
    field = model.model_fields[key]
    inner = _inner(model, key)
    if field.description:
        return field.description
    return _first_paragraph(inner) if inner is not None else ""


def _default(model: type[Part], key: str) -> str:
    field = model.model_fields[key]
    if field.is_required():
        return "**needed**"
    if field.default in (None, (), "", PydanticUndefined):
        return "–"
    value = field.default
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, str):
        return f'`"{value}"`'
    return f"`{value}`"


def _value(model: type[Part], key: str) -> str:
    """The kind of value, and its limits."""
    schema = World.model_json_schema() if model is World else model.model_json_schema()
    return _kind(_plain(schema["properties"][key]), schema.get("$defs", {}))


def _kind(schema: Json, definitions: Json) -> str:
    if "allOf" in schema:
        schema = schema["allOf"][0]
    if "$ref" in schema:
        return f"{{{schema['$ref'].rsplit('/', 1)[-1].lower()}}}"
    if "anyOf" in schema:
        return " or ".join(_kind(option, definitions) for option in schema["anyOf"])
    if "const" in schema:
        return f'`"{schema["const"]}"`'
    if "enum" in schema:
        return " ".join(f'`"{value}"`' for value in schema["enum"])
    if schema.get("type") == "array":
        items = schema.get("items")
        if isinstance(items, list):
            kinds = [_kind(item, definitions) for item in items]
            if len(set(kinds)) == 1:
                return f"[{len(kinds)} × {kinds[0]}]"
            return f"[{', '.join(kinds)}]"
        return f"list of {_kind(items or {}, definitions)}"
    name = {"number": "number", "integer": "integer", "string": "text", "boolean": "true or false"}
    return " ".join(filter(None, (name.get(str(schema.get("type")), "value"), _limits(schema))))


def _limits(schema: Json) -> str:
    low, high = schema.get("minimum"), schema.get("maximum")
    above, below = schema.get("exclusiveMinimum"), schema.get("exclusiveMaximum")
    said = []
    if low is not None and low > -1000:
        said.append(f"≥ {_short(low)}")
    if above is not None:
        said.append(f"> {_short(above)}")
    if high is not None and high < 1e6 and (low is None or low > -1000):
        said.append(f"≤ {_short(high)}")
    if below is not None and below < 1e6:
        said.append(f"< {_short(below)}")
    return ", ".join(said)


def _short(value: float) -> str:
    return re.sub(r"\.0$", "", f"{value:g}")
