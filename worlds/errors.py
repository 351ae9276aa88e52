"""The exceptions of this package; their text is written for the user who can mend the input."""

from __future__ import annotations

from dataclasses import dataclass

Key = tuple[str | int, ...]
"""A place in a world: ("ap", 3, "position_m", 2) is the third coordinate of the fourth AP."""


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong with a world.

    Attributes:
        key: where; () when it concerns the world as a whole.
        message: value, rule and remedy in one sentence.
        code: of `worlds.check_codes`, for those faults of a layout that have one.
    """

    key: Key
    message: str
    code: str = ""

    def __str__(self) -> str:
        """`ap[3].position_m[2]: message`."""
        place = ""
        for step in self.key:
            place += f"[{step}]" if isinstance(step, int) else f".{step}" if place else str(step)
        return f"{place}: {self.message}" if place else self.message


class WorldError(ValueError):
    """A world, or a file that describes one, cannot be used as it is.

    Attributes:
        faults: all that is wrong, at once.
        lines: the same as text, one line each, with file and line where they are known.
    """

    def __init__(self, faults: list[Fault], lines: list[str] | None = None) -> None:
        self.faults = tuple(faults)
        self.lines = tuple(lines) if lines is not None else tuple(str(f) for f in faults)
        super().__init__("\n".join(self.lines))
