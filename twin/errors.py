"""The exceptions of this package; their text is written for the user who can mend the input."""

from __future__ import annotations


class TwinError(ValueError):
    """A run cannot be made as asked; the text names value, rule and remedy."""
