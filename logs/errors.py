"""The exceptions of this package; their text is written for the user who can mend the input."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class LogError(ValueError):
    """A log cannot be read or written; the text names the file, what is wrong and the remedy."""


@contextmanager
def in_a_sentence(path: Path, doing: str) -> Iterator[None]:
    """Whatever the contents of a forged log provoke becomes one `LogError`.

    Readers of a log check what they use, but a forger may put together what never was: a plan of
    another problem, a place beside the hall. Who draws or compares such a log need not foresee it.
    """
    try:
        yield
    except LogError:
        raise
    except MemoryError as error:
        raise LogError(f"{path}: cannot be {doing}: it needs more memory than there is") from error
    except Exception as error:
        said = " ".join(str(error).split())[:200]
        raise LogError(
            f"{path}: cannot be {doing}: its contents do not fit together "
            f"({type(error).__name__}: {said}); `twin validate` says what is wrong with it, and if "
            "that is nothing, please report it (--debug shows where)"
        ) from error
