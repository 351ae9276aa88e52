"""The exceptions of this package; their text is written for the user who can mend the input."""

from __future__ import annotations


class PlannerError(ValueError):
    """A problem or plan, or a file that holds one, cannot be used as it is.

    Attributes:
        lines: all that is wrong, one line each, naming place, value and remedy.
    """

    def __init__(self, *lines: str) -> None:
        self.lines: tuple[str, ...] = lines
        super().__init__("\n".join(lines))
