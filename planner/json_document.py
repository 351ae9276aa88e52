"""A JSON text being read: every value is asked for by type, and every fault is kept, not raised.

Readers call the getters for all they need, use what comes back (None where the value was unusable)
and end with `finish`, which raises one `PlannerError` with all faults.
"""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Sequence
from dataclasses import replace

from planner.errors import PlannerError
from planner.validation import Fault, Key

INT32_MAX = 2**31 - 1


class _Object(dict[str, object]):
    """A JSON object that remembers the keys it was given twice."""

    def __init__(self, pairs: list[tuple[str, object]]) -> None:
        super().__init__(pairs)
        names = [name for name, _ in pairs]
        self.twice: list[str] = []
        if len(self) < len(names):
            self.twice = [name for name in self if names.count(name) > 1]


class _Constant(str):
    """NaN or Infinity: Python's reader knows them, JSON does not."""


class Document:
    """A parsed JSON text and the faults found in it so far.

    Attributes:
        name: what to call the text in messages, usually the file's name.
        root: the parsed value.
        faults: found so far.

    Raises:
        PlannerError: with line and column, when the text is not JSON.
    """

    def __init__(self, text: str, name: str) -> None:
        self.name = name
        self.faults: list[Fault] = []
        self._faulty: set[Key] = set()
        try:
            self.root: object = json.loads(
                text.removeprefix("\ufeff"), object_pairs_hook=_Object, parse_constant=_Constant
            )
        except json.JSONDecodeError as error:
            remedy = "the text ends early" if error.pos >= len(text.rstrip()) else "mend it there"
            raise PlannerError(
                f"{name}:{error.lineno}:{error.colno}: not JSON: {error.msg}; {remedy}"
            ) from error
        except RecursionError as error:
            raise PlannerError(f"{name}: not usable: its brackets nest too deeply") from error
        except ValueError as error:  # an integer of thousands of digits
            raise PlannerError(f"{name}: not usable: {error}") from error

    def fault(self, key: Key, value: object, message: str) -> None:
        """Records that `value` at `key` is wrong."""
        self._note(Fault(key, _shown(value), message))

    def _note(self, fault: Fault) -> None:
        self.faults.append(fault)
        self._faulty.add(fault.key)

    def add(self, faults: Sequence[Fault]) -> None:
        """Adds what a later stage found, except what merely follows from a fault known already.

        A fault about a member of a list is moved to the member's place in the file.
        """
        known = set(self._faulty)
        above = {key[:n] for key in known for n in range(len(key) + 1)}
        for fault in map(self._at_member, faults):
            follows = any(
                key in above or any(key[:n] in known for n in range(len(key) + 1))
                for key in (fault.key, *fault.depends)
            )
            if not follows:
                self._note(fault)

    def _at_member(self, fault: Fault) -> Fault:
        value = self.root
        for step in fault.key:
            if isinstance(value, dict) and isinstance(step, str):
                value = value.get(step)
            elif isinstance(value, list) and isinstance(step, int) and step < len(value):
                value = value[step]
            else:
                return fault
        if fault.member is not None and isinstance(value, list) and fault.member in value:
            return replace(fault, key=(*fault.key, value.index(fault.member)))
        return fault

    def finish(self) -> None:
        """Raises all faults, in the order of the file's parts.

        Raises:
            PlannerError: with one line `file: $.vertices[3].aps[1]: value: message` per fault.
        """
        if self.faults:
            faults = sorted(self.faults, key=lambda fault: self._order(fault.key))
            raise PlannerError(*(fault.line(f"{self.name}: ") for fault in faults))

    def _order(self, key: Key) -> list[tuple[int, str]]:
        """Sorts as the file's own parts stand, then by number or name."""
        parts = list(self.root) if isinstance(self.root, dict) else []
        order = [(step, "") if isinstance(step, int) else (0, step) for step in key]
        if order:
            order[0] = (parts.index(key[0]) if key[0] in parts else len(parts), str(key[0]))
        return order

    def mapping(
        self, value: object, key: Key, required: Sequence[str], optional: Sequence[str] = ()
    ) -> dict[str, object]:
        """`value` as an object with these keys; what is missing or unknown becomes a fault."""
        if not isinstance(value, _Object):
            self.fault(key, value, f"must be an object with the keys {_listed(required)}")
            return {}
        known = (*required, *optional)
        for name in value.twice:
            self.fault((*key, name), value[name], "this key is given twice; keep one")
        for name in value:
            if name not in known:
                close = difflib.get_close_matches(name, known, n=1)
                hint = f'did you mean "{close[0]}"?' if close else f"known are {_listed(known)}"
                self.fault((*key, name), value[name], f"unknown key; {hint}")
        for name in required:
            if name not in value:
                self._note(Fault((*key, name), "missing", "this key must be given"))
        return {name: value[name] for name in known if name in value}

    def array(self, value: object, key: Key, of: str) -> list[object]:
        """`value` as a list, [] after a fault; `of` says what it should list."""
        if not isinstance(value, list):
            self.fault(key, value, f"must be a list of {of}")
            return []
        return value

    def integer(self, value: object, key: Key, low: int = 0, high: int = INT32_MAX) -> int | None:
        """`value` as an integer from `low` to `high`, None after a fault."""
        if isinstance(value, float) and value.is_integer():
            self.fault(key, value, f"must be an integer; write {int(value)}")
        elif not isinstance(value, int) or isinstance(value, bool):
            self.fault(key, value, "must be an integer")
        elif not low <= value <= high:
            wanted = f"at least {low}" if value < low else f"at most {high}"
            self.fault(key, value, f"must be {wanted}")
        else:
            return value
        return None

    def index(self, value: object, key: Key, what: str, count: int, listed: Key = ()) -> int | None:
        """`value` as an index into the file's list of `count` things, None after a fault.

        Where the list itself, at `listed`, is unusable, an index into it is not called wrong.
        """
        index = self.integer(value, key, -INT32_MAX)
        if index is None or 0 <= index < count:
            return index
        if not self.is_faulty(listed):
            self.fault(key, value, f"is no {what}: there are {count}, counted from 0")
        return None

    def is_faulty(self, key: Key) -> bool:
        """The value at exactly this place is known to be unusable."""
        return key in self._faulty

    def number(self, value: object, key: Key) -> float | None:
        """`value` as a finite number, None after a fault."""
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            try:
                if math.isfinite(float(value)):
                    return float(value)
            except OverflowError:
                pass
        self.fault(key, value, "must be a finite number")
        return None

    def string(self, value: object, key: Key) -> str | None:
        """`value` as text, None after a fault."""
        if isinstance(value, str) and not isinstance(value, _Constant):
            return value
        self.fault(key, value, "must be text in double quotes")
        return None

    def boolean(self, value: object, key: Key) -> bool | None:
        """`value` as true or false, None after a fault."""
        if isinstance(value, bool):
            return value
        self.fault(key, value, "must be true or false")
        return None

    def choice(
        self, value: object, key: Key, choices: Sequence[str], among: str = ""
    ) -> str | None:
        """`value` as one of `choices`, None after a fault; `among` names them if they are many."""
        if isinstance(value, str) and value in choices:
            return value
        close = difflib.get_close_matches(value, choices, n=1) if isinstance(value, str) else []
        hint = f'; did you mean "{close[0]}"?' if close else ""
        wanted = f"one of {among}" if among else _listed(choices, "or")
        self.fault(key, value, f"must be {wanted}{hint}")
        return None


def _shown(value: object, width: int = 60) -> str:
    """`value` as it stands in the file, cut to `width` characters."""
    text = str(value) if isinstance(value, _Constant) else json.dumps(value, ensure_ascii=False)
    text = text.encode("utf-8", "backslashreplace").decode()
    return text if len(text) <= width else text[: width - 1] + "…"


def _listed(names: Sequence[str], word: str = "and") -> str:
    quoted = [f'"{name}"' for name in names]
    return quoted[0] if len(quoted) == 1 else f"{', '.join(quoted[:-1])} {word} {quoted[-1]}"
