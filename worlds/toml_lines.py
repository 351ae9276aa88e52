"""In which line of a TOML text each key stands.

`tomllib` gives the values and no places. The syntax tree of tree-sitter gives the places; it is
read only to word a fault, never for a value.
"""

from __future__ import annotations

import re
import tomllib
from typing import TYPE_CHECKING

from worlds.errors import Key

if TYPE_CHECKING:
    from tree_sitter import Node

_BARE = re.compile(r"[A-Za-z0-9_.-]+")


def key_lines(text: str) -> dict[Key, int]:
    """Line (from 1) of every key of a TOML text, array elements and implied tables included.

    A table's line is its header, that of an element of an array of tables the header of that
    element, that of a table which only its keys imply the first of these. The root `()` is line 1.
    The text must be valid TOML.
    """
    # tree_sitter_toml ships no types; both are loaded only when there is a fault to place.
    import tree_sitter_toml
    from tree_sitter import Language, Parser

    tree = Parser(Language(tree_sitter_toml.language())).parse(text.encode())
    lines: dict[Key, int] = {(): 1}
    elements: dict[Key, int] = {}  # array of tables -> index of its newest element

    def note(key: Key, line: int) -> None:
        for k in range(1, len(key) + 1):
            lines.setdefault(key[:k], line)

    def header(steps: list[str], line: int, *, element: bool) -> Key:
        key: Key = ()
        for k, step in enumerate(steps, 1):
            key = (*key, step)
            if element and k == len(steps):
                elements[key] = elements.get(key, -1) + 1
            if key in elements:
                lines.setdefault(key, line)
                key = (*key, elements[key])
        note(key, line)
        # `[a.b]` may stand above `[a]`; then the header of `a` is its place, not the first mention.
        lines[key] = line
        return key

    def pair(node: Node, table: Key) -> None:
        name, *rest = node.named_children
        key = (*table, *_steps(name))
        note(key, node.start_point.row + 1)
        for child in rest:
            value(child, key)

    def value(node: Node, key: Key) -> None:
        lines.setdefault(key, node.start_point.row + 1)
        if node.type == "inline_table":
            for child in node.named_children:
                if child.type == "pair":
                    pair(child, key)
        elif node.type == "array":
            items = [child for child in node.named_children if child.type != "comment"]
            for i, child in enumerate(items):
                value(child, (*key, i))

    for node in tree.root_node.named_children:
        if node.type == "pair":
            pair(node, ())
        elif node.type in {"table", "table_array_element"}:
            name, *rest = node.named_children
            element = node.type == "table_array_element"
            table = header(_steps(name), node.start_point.row + 1, element=element)
            for child in rest:
                if child.type == "pair":
                    pair(child, table)
    return lines


def line_of(lines: dict[Key, int], key: Key) -> int:
    """Line of a key, or of the nearest table around it when the file does not have the key."""
    while key not in lines:
        key = key[:-1]
    return lines[key]


def _steps(node: Node) -> list[str]:
    """The parts of a bare, quoted or dotted key."""
    text = (node.text or b"").decode()
    if _BARE.fullmatch(text):
        return text.split(".")
    steps: list[str] = []
    inner: object = tomllib.loads(f"{text} = 0")  # quotes and escapes, read by the one who knows
    while isinstance(inner, dict):
        ((step, inner),) = inner.items()
        steps.append(step)
    return steps
