"""The line of every key of a TOML text."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

import worlds
from worlds.toml_lines import key_lines, line_of

SHIPPED = sorted(Path(worlds.__file__).parent.glob("*.toml"))
TINY = Path(worlds.__file__).parent / "tiny.toml"


def all_keys(value: object, key: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Every key path of parsed TOML."""
    yield key
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from all_keys(inner, (*key, name))
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            yield from all_keys(inner, (*key, i))


STRANGE = '''\
top.a = 1
"quoted key" . 'b.c'."d\\u00e9" = [ # comment
  1, # one

  { x = 2, y.z = [3,
   4] },
]
[[list]] # first
text = """
[not.a.table]
key = 1
"""
[list.inner]
a = 1
[[list.deep]]
b = 1
[[list.deep]]
b = 2
[[list]]
[list.inner]
a = 2
[[list.deep]]
b = 3
[x.y.z]
w = 1
[x]
v = 1
[[list]]
'''


def test_lines_of_strange_but_valid_toml() -> None:
    """Dotted and quoted keys, inline and implied tables, nested arrays of tables, comments."""
    lines = key_lines(STRANGE)
    assert set(all_keys(tomllib.loads(STRANGE))) == lines.keys()
    wanted = {
        (): 1,
        ("top", "a"): 1,
        ("quoted key", "b.c", "dé"): 2,
        ("quoted key", "b.c", "dé", 0): 3,
        ("quoted key", "b.c", "dé", 1, "x"): 5,
        ("quoted key", "b.c", "dé", 1, "y", "z", 1): 6,
        ("list",): 8,
        ("list", 0): 8,
        ("list", 0, "text"): 9,
        ("list", 0, "inner"): 13,
        ("list", 0, "deep", 1): 17,
        ("list", 0, "deep", 1, "b"): 18,
        ("list", 1): 19,
        ("list", 1, "inner", "a"): 21,
        ("list", 1, "deep", 0, "b"): 23,
        ("x", "y"): 24,
        ("x",): 26,
        ("x", "v"): 27,
        ("list", 2): 28,
    }
    assert {key: lines[key] for key in wanted} == wanted
    assert line_of(lines, ("list", 1, "deep", 0, "nothing", 3)) == 22


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_every_key_of_a_shipped_world_has_its_line(path: Path) -> None:
    """The syntax tree finds exactly the keys that the parser finds, each in a line that says it."""
    text = path.read_text()
    lines = key_lines(text)
    assert set(all_keys(tomllib.loads(text))) == lines.keys()
    for key, line in lines.items():
        if key and isinstance(key[-1], str):
            assert key[-1] in text.splitlines()[line - 1]
