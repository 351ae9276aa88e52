"""The exceptions of this package; their text is written for the user who can mend the input."""

from __future__ import annotations


class LogError(ValueError):
    """A log cannot be read or written; the text names the file, what is wrong and the remedy."""
