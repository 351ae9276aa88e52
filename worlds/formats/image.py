"""Grey images from strangers: PGM (P2, P5) and PNG, read without trusting their headers.

The size a header claims is held against a limit and against the bytes that are there before any
memory is taken for pixels.
"""

from __future__ import annotations

import re
import struct
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worlds.errors import Fault, WorldError

MAX_PIXELS = 100_000_000
"""10 000 x 10 000: a hall of 500 m at 5 cm."""

_HEADER = 4096  # bytes within which the header of a PGM, comments included, must end
_PGM_TOKEN = re.compile(rb"(?:\s|#[^\n\r]*[\n\r])*(\d+)")
_PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True, eq=False)
class GreyImage:
    """An image as levels of grey.

    Attributes:
        levels: (rows, columns) uint8 or uint16, read-only, row 0 at the top.
        white: the level that is white.
        opaque: (rows, columns) bool, read-only; None when the whole image is.
    """

    levels: NDArray[np.unsignedinteger[Any]]
    white: int
    opaque: NDArray[np.bool_] | None = None


def read_image(path: Path, *, max_pixels: int = MAX_PIXELS) -> GreyImage:
    """The image a file holds, by its content and not by its name.

    Colours become grey as the mean of red, green and blue.

    Raises:
        WorldError: no such file, another format, too many pixels, or fewer bytes than pixels.
    """
    name = str(path)
    try:
        if not path.exists():
            raise _error(name, "there is no such image; copy it there, or name it with --image")
        if not path.is_file():
            raise _error(name, "is not a regular file; name a PGM or PNG image")
        with path.open("rb") as file:
            head = file.read(_HEADER)
            if head.startswith(_PNG):
                if head[12:16] == b"IHDR" and len(head) >= 24:
                    width, height = struct.unpack(">II", head[16:24])
                    _check_size(name, width, height, max_pixels)
                return _read_png(path, name, max_pixels)
            if head[:2] in {b"P2", b"P5"}:
                return _read_pgm(path, name, head, max_pixels)
    except OSError as error:
        raise _error(
            name, f"cannot be read: {error.strerror or error}; check its rights"
        ) from error
    if not head:
        raise _error(name, "is empty; get the whole image")
    begins = f"begins with {head[:8]!r}"
    raise _error(name, f"is no PGM (P2, P5) or PNG image: it {begins}; convert it to one of these")


def _read_pgm(path: Path, name: str, head: bytes, max_pixels: int) -> GreyImage:
    """Netpbm's PGM: magic number, width, height, maxval, one white space, the levels."""
    values, at = [], 2
    for what in ("width", "height", "largest level"):
        found = _PGM_TOKEN.match(head, at)
        if not found or len(found[1]) > 9:
            place = f"byte {at}"
            raise _error(name, f"the PGM header has no {what} at {place}; save the image anew")
        values.append(int(found[1]))
        at = found.end()
    columns, rows, white = values
    _check_size(name, columns, rows, max_pixels)
    if not 1 <= white <= 65535:
        raise _error(name, f"largest level {white} is outside 1 to 65535; save the image anew")
    if not head[at : at + 1].isspace():
        raise _error(name, f"the PGM header does not end at byte {at}; save the image anew")
    if head[:2] == b"P5":
        kind = np.dtype(np.uint8) if white < 256 else np.dtype(">u2")
        wanted, there = rows * columns * kind.itemsize, path.stat().st_size - at - 1
        if there < wanted:
            raise _truncated(name, columns, rows, there // (columns * kind.itemsize))
        levels = np.fromfile(path, dtype=kind, count=rows * columns, offset=at + 1)
    else:
        kind = np.dtype(np.uint16)
        # A level takes two bytes at least; the last one may lack its white space.
        there = path.stat().st_size - at
        if there + 1 < 2 * rows * columns or there > 12 * rows * columns + 10**6:
            least = f"{columns} x {rows} levels do not fit {there} bytes"
            raise _error(name, f"the image is cut short or damaged: {least}; get the whole file")
        body = re.sub(rb"#[^\n\r]*", b"", path.read_bytes()[at:])
        if not re.fullmatch(rb"[\d\s]*", body):
            strange = re.search(rb"[^\d\s]", body)
            found_byte = strange[0] if strange else b""
            raise _error(name, f"{found_byte!r} is no level of grey; save the image anew")
        words = body.split()
        if len(words) != rows * columns:
            if len(words) < rows * columns:
                raise _truncated(name, columns, rows, len(words) // columns)
            more = len(words) - rows * columns
            raise _error(name, f"has {more} levels more than {columns} x {rows}; save it anew")
        # Longer than any level: told below, and never parsed into something that fits.
        levels = np.array([int(w) if len(w) < 9 else 10**9 for w in words], dtype=np.int64)
    above = np.greater(levels, white)
    if above.any():
        over = int(np.argmax(above))
        place = f"row {over // columns}, column {over % columns}"
        value = int(levels[over])
        raise _error(name, f"{place}: level {value} is above the largest, {white}; save it anew")
    narrow = np.uint8 if white < 256 else np.uint16
    return GreyImage(_frozen(levels.astype(narrow).reshape(rows, columns)), white)


def _read_png(path: Path, name: str, max_pixels: int) -> GreyImage:
    from PIL import Image, UnidentifiedImageError

    # The limit here is stricter than Pillow's, and the file's chunks are Pillow's own to bound.
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path, formats=("PNG",)) as image:
                columns, rows = image.size
                _check_size(name, columns, rows, max_pixels)
                return _grey(image)
    except Image.DecompressionBombError as error:
        raise _error(name, f"claims far too many pixels; at most {max_pixels} are read") from error
    except (UnidentifiedImageError, SyntaxError, ValueError, OSError) as error:
        if isinstance(error, WorldError):
            raise
        why = " ".join(str(error).split())
        if "truncated" in why.lower() or "cannot identify" in why.lower():
            why = "the PNG is cut short or damaged"
        raise _error(name, f"{why}; get the whole file") from error


def _grey(image: Any) -> GreyImage:
    """An opened PNG, its pixels now read."""
    opaque = None
    if image.mode in {"LA", "RGBA", "PA"} or "transparency" in image.info:
        colour = np.asarray(image.convert("RGBA"))
        opaque = _frozen(colour[..., 3] == 255)
        levels = _mean_of_colours(colour)
    elif image.mode.startswith("I"):  # 16 bits
        levels = _frozen(np.asarray(image).astype(np.uint16))
        return GreyImage(levels, 65535)
    elif image.mode in {"1", "L"}:
        levels = np.asarray(image.convert("L")).copy()
    else:
        levels = _mean_of_colours(np.asarray(image.convert("RGB")))
    return GreyImage(_frozen(levels), 255, opaque)


def _mean_of_colours(colour: NDArray[np.uint8]) -> NDArray[np.uint8]:
    total = colour[..., 0].astype(np.uint16)
    total += colour[..., 1]
    total += colour[..., 2]
    return np.asarray((total + 1) // 3, dtype=np.uint8)


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    array.flags.writeable = False
    return array


def _check_size(name: str, columns: int, rows: int, max_pixels: int) -> None:
    if columns < 1 or rows < 1:
        raise _error(name, f"{columns} x {rows} pixels are no image; save it anew")
    if columns * rows > max_pixels:
        rule = f"claims {columns} x {rows} pixels, at most {max_pixels} are read"
        raise _error(name, f"{rule}; crop it or save it at a coarser resolution")


def _truncated(name: str, columns: int, rows: int, there: int) -> WorldError:
    rule = f"the image is cut short: it has {there} whole rows of {columns} pixels, its header"
    return _error(name, f"{rule} says {rows}; get the whole file")


def _error(name: str, message: str) -> WorldError:
    return WorldError([Fault((), message)], [f"{name}: {message}"])
