"""The JSON schema and the page of the format say what the model says."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest

from tests.worlds.good_world import GOOD, edited, lines_of
from worlds.schema import format_page, json_schema, schema_text, tables, undescribed
from worlds.world import World

jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
ROOT = Path(__file__).resolve().parents[2]


def accepts(text: str) -> bool:
    """Whether the schema accepts a world file."""
    data: Any = tomllib.loads(text)
    return bool(jsonschema.Draft7Validator(json_schema()).is_valid(data))


def test_it_is_a_schema() -> None:
    """Draft-07, readable as JSON, the same each time."""
    jsonschema.Draft7Validator.check_schema(json_schema())
    assert json.loads(schema_text()) == json_schema()
    assert schema_text() == schema_text()


@pytest.mark.parametrize("path", sorted((ROOT / "worlds").glob("*.toml")), ids=lambda p: p.stem)
def test_worlds_that_ship_are_accepted(path: Path) -> None:
    """An editor with the schema underlines nothing in them."""
    assert accepts(path.read_text(encoding="utf-8"))


RIGHT = {
    "as it is": (),
    "station with a table": (('start = "dock 1"', 'start = { station = "dock 1" }'),),
    "costs": (("horizon = 30", "objective = { c_t = 1, c_h = 60 }"),),
    "milliseconds": (("[plan]", "[run]\ninterruption = 50\n[plan]"),),
    "whole metres": (("pitch_m = 1.0", "pitch_m = 1"),),
    "drawn robots": (("[plan]", "[obstacles.random]\nshare = 0.1\n[plan]"),),
}
WRONG = {
    "unknown key": (("pitch_m = 1.0", "pitchm = 1.0"),),
    "text for a number": (("horizon = 30", 'horizon = "30"'),),
    "fraction for a count": (("capacity = 3", "capacity = 3.5"),),
    "negative height": (("[7.0, 5.0, 4.0]", "[7.0, 5.0, -4.0]"),),
    "two coordinates": (("[7.0, 5.0, 4.0]", "[7.0, 5.0]"),),
    "millimetres": (("[8.0, 6.0]", "[8000.0, 6000.0]"),),
    "unknown word": (("horizon = 30", 'objective = "fast"'),),
    "neither pitch nor positions": (("pitch_m = 1.0\n", ""),),
    "both": (("pitch_m = 1.0", "pitch_m = 1.0\npositions = [8, 6]"),),
    "slot and speed": (("pitch_m = 1.0", "pitch_m = 1.0\nslot_s = 1.0\nspeed_m_s = 1.0"),),
    "place of two kinds": (("{ cell = [1, 1] }", "{ cell = [1, 1], at_m = [1.0, 1.0] }"),),
    "table for a list": (("[[station]]", "[station]"),),
    "no name": (('name = "good"\n', ""),),
}


@pytest.mark.parametrize("case", [*RIGHT, *WRONG])
def test_schema_and_model_agree(case: str) -> None:
    """What the one accepts or refuses, so does the other."""
    text = edited(*(RIGHT | WRONG)[case])
    good = case in RIGHT
    assert (not lines_of(text)) == good, lines_of(text)
    assert accepts(text) == good
    assert accepts(GOOD)


def test_every_key_is_described() -> None:
    """No key of the format is without a sentence, in the page and in the schema."""
    assert undescribed() == []
    for definition in [json_schema(), *json_schema()["definitions"].values()]:
        for key, value in definition.get("properties", {}).items():
            assert value.get("description"), key


def test_the_page_lists_every_table_and_key() -> None:
    """Headers as they stand in files; each key of each table in a row of its own."""
    page = format_page()
    for header, model in tables():
        assert f"\n## {header}\n" in page
        for key in model.model_fields:
            table = f".{key}]" in page or f"[{key}]" in page
            assert f"\n| `{key}` |" in page or table, (header, key)
    assert "| `pitch_m` | number ≥ 0.01, ≤ 100 |" in page
    assert set(World.model_fields) - {"format", "name", "story"} <= {
        header.strip("[]").split(".")[0] for header, _ in tables()
    }


def test_the_committed_page_is_current() -> None:
    """docs/world-format.md is what the model says; else `twin schema -o docs/world-format.md`."""
    assert (ROOT / "docs/world-format.md").read_text(encoding="utf-8") == format_page()
