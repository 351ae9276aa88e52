"""Values set by dotted path (`plan.horizon`, `ap.ap3.enabled`) in what a world file says."""

from __future__ import annotations

import re
from collections.abc import Mapping
from copy import deepcopy
from typing import Any

from worlds.errors import Fault, Key
from worlds.part import Part, given, nearest

_NAMED_BY = {"ap": "id", "robot": "id", "station": "name", "obstacle": "name", "event": "name"}
_STEP = re.compile(r"""\s*(?:"([^"]*)"|'([^']*)'|([^."'\[\]]+)|\[(\d+)\])\s*""")


class BadPathError(ValueError):
    """A dotted path leads nowhere.

    Attributes:
        fault: the path as key, and why.
    """

    def __init__(self, path: str, message: str) -> None:
        self.fault = Fault((path,), message)
        super().__init__(str(self.fault))


def set_value(data: dict[str, Any], path: str, value: object) -> Key:
    """Set one value in place and return its key.

    A step is a key, or the id, name or index of an element of a list (`ap.ap3`, `ap.3`, `ap[3]`);
    quote a step that contains a dot. Tables that the path implies are made. None takes a key back
    to its default. Whether key and value suit the world is for the validation to say. The value is
    copied: a later path that leads into it leaves the caller's own as it is.

    Raises:
        BadPathError: an element that is not there, or a path through something without keys.
    """
    *tables, last = _steps(path)
    value = deepcopy(value)
    at: Any = data
    key: Key = ()
    for step in tables:
        at, found = _enter(at, key, step, path)
        key = (*key, found)
    if isinstance(at, dict):
        if value is None:
            at.pop(last, None)
        else:
            at[last] = value
        return (*key, last)
    _, found = _enter(at, key, last, path)
    if value is None:
        hint = "set its enabled to false" if key == ("ap",) else "override the whole list"
        raise BadPathError(path, f"an element of a list cannot be taken out; {hint}")
    at[found] = value
    return (*key, found)


def value_at(part: Part, path: str) -> object:
    """What a finished part says at a dotted path, its defaults included.

    Raises:
        BadPathError: nothing can be there.
    """
    at: object = part
    for step in _steps(path):
        if isinstance(at, Part) and step in type(at).model_fields:
            at = getattr(at, step)
        elif isinstance(at, tuple):
            named = [e for e in at if step in (given(e, "id"), given(e, "name"))]
            if not named and not (step.isdecimal() and int(step) < len(at)):
                raise BadPathError(path, f"nothing is called '{step}'")
            at = named[0] if named else at[int(step)]
        elif at is None:
            return None  # a table that was left out
        else:
            raise BadPathError(path, f"'{step}' is not a known key")
    return at


def _steps(path: str) -> list[str]:
    steps: list[str] = []
    at = 0
    while at < len(path) or not steps:
        if steps and path[at] == ".":
            at += 1
        found = _STEP.match(path, at)
        if not found:
            raise BadPathError(path, f"'{path}' is not a dotted path; write one like plan.horizon")
        steps.append(next(g for g in found.groups() if g is not None).strip())
        at = found.end()
    return steps


def _enter(at: Any, key: Key, step: str, path: str) -> tuple[Any, str | int]:
    """What lies under a step, and the step as the key the file has for it."""
    where = ".".join(str(k) for k in key)
    if isinstance(at, dict):
        if step in _NAMED_BY and not key:
            at.setdefault(step, [])
        return at.setdefault(step, {}), step
    if not isinstance(at, list):
        raise BadPathError(path, f"{where} is a single value; set it as a whole")
    named_by = _NAMED_BY.get(where, "")
    names = [e.get(named_by) if isinstance(e, Mapping) else None for e in at]
    if step in names:
        return at[names.index(step)], names.index(step)
    if step.isdecimal() and int(step) < len(at):
        return at[int(step)], int(step)
    known = [name for name in names if isinstance(name, str)]
    hint = nearest(step, known) or f" known are {', '.join(known[:8]) or 'none'}"
    raise BadPathError(path, f"no {where} has the {named_by or 'index'} '{step}';{hint}")
