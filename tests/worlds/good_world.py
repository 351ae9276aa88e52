"""A world without a mistake, the way to put some in, and what is then said."""

from __future__ import annotations

from typing import Any

from worlds.errors import WorldError
from worlds.toml_file import parse_world

GOOD = """\
format = "mapp-world/1"
name = "good"

[hall]
size_m = [8.0, 6.0]
pitch_m = 1.0

[[ap]]
id = "west"
position_m = [1.0, 1.0, 4.0]

[[ap]]
id = "east"
position_m = [7.0, 5.0, 4.0]
capacity = 3

[[station]]
name = "dock 1"
cell = [0, 0]

[[robot]]
id = "anna"
start = "dock 1"
goal = { at_m = [7.2, 5.4] }

[[robot]]
id = "bert"
start = { cell = [1, 1] }
goal = "dock 1"

[plan]
horizon = 30
"""


def lines_of(text: str, **overrides: Any) -> list[str]:
    """The lines of the error a text causes, or none."""
    try:
        parse_world(text, "hall.toml", overrides=overrides)
    except WorldError as error:
        return list(error.lines)
    return []


def edited(*edits: tuple[str, str]) -> str:
    """GOOD with replacements; each must be there once."""
    text = GOOD
    for old, new in edits:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text
