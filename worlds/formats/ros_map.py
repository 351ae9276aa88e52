"""ROS map_server maps: a YAML file beside a PGM or PNG image.

What a pixel means is that of map_server and nav2_map_server (http://wiki.ros.org/map_server#Map_format):
occ = 1 − shade, with `negate` occ = shade; occupied if occ > occupied_thresh, free if
occ < free_thresh, both strict; else unknown. Mode `scale` knows values in between, which count as
occupied here, since something is there. Mode `raw` takes the level itself as per cent of occupancy,
unknown above 100, whatever `negate` says (as nav2 does). Pixels that are not opaque are unknown.
The origin is the place of the lower left pixel's corner; row 0 of the image is the top.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worlds.errors import Fault, WorldError
from worlds.formats.image import MAX_PIXELS, GreyImage, read_image
from worlds.part import nearest

MAX_YAML_BYTES = 65_536
MODES = ("trinary", "scale", "raw")
RESOLUTION_M = (0.001, 2.0)
"""Least and largest plausible size of a pixel [m]; outside it is another unit."""

FREE, OCCUPIED, UNKNOWN = 0, 1, 2

_USUAL = {
    "image": "map.pgm",
    "resolution": "0.05",
    "origin": "[0.0, 0.0, 0.0]",
    "negate": "0",
    "occupied_thresh": "0.65",
    "free_thresh": "0.196",
}


@dataclass(frozen=True)
class RosMapInfo:
    """What the YAML file says.

    Attributes:
        source: the YAML file as messages call it.
        image: the image file.
        resolution_m: side of a pixel [m].
        origin_m: (x, y) of the lower left corner of the image in the map's frame [m].
        negate: whether white is occupied.
        occupied_thresh, free_thresh: limits of the occupancy, 0 … 1.
        mode: one of `MODES`.
    """

    source: str
    image: Path
    resolution_m: float
    origin_m: tuple[float, float]
    negate: bool
    occupied_thresh: float
    free_thresh: float
    mode: str


@dataclass(frozen=True, eq=False)
class RosMap:
    """A map, its image included.

    Attributes:
        info: what the YAML file says.
        state: (rows, columns) uint8, read-only: FREE, OCCUPIED or UNKNOWN, row 0 at the *bottom*.
    """

    info: RosMapInfo
    state: NDArray[np.uint8]

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and depth of the image [m]."""
        rows, columns = self.state.shape
        return columns * self.info.resolution_m, rows * self.info.resolution_m

    def blocked(self, *, unknown_is_free: bool = False) -> NDArray[np.bool_]:
        """(rows, columns) where nobody may drive: occupied, and unknown unless told otherwise."""
        return np.asarray(self.state == OCCUPIED if unknown_is_free else self.state != FREE)


def read_ros_map(path: Path, *, image: Path | None = None, max_pixels: int = MAX_PIXELS) -> RosMap:
    """A map from its YAML file.

    Args:
        path: of the YAML file.
        image: the image, if it is not the one the YAML file names.
        max_pixels: larger images are refused before they are read.

    Raises:
        WorldError: with all that is wrong with the YAML file, or what is wrong with the image.
    """
    info = read_info(path, image=image)
    state = classify(read_image(info.image, max_pixels=max_pixels), info)[::-1]
    state = np.ascontiguousarray(state)
    state.flags.writeable = False
    return RosMap(info, state)


def classify(image: GreyImage, info: RosMapInfo) -> NDArray[np.uint8]:
    """(rows, columns) uint8 FREE, OCCUPIED or UNKNOWN for every pixel, rows as in the image."""
    level = np.arange(image.white + 1)
    if info.mode == "raw":
        occ = level / 100.0
    else:
        # Not 1 − shade: that misses a threshold by a rounding, and both comparisons are strict.
        occ = (level if info.negate else image.white - level) / image.white
    between = OCCUPIED if info.mode == "scale" else UNKNOWN
    meaning = np.full(len(level), between, dtype=np.uint8)
    meaning[occ > info.occupied_thresh] = OCCUPIED
    meaning[occ < info.free_thresh] = FREE
    if info.mode == "raw":
        meaning[level > 100] = UNKNOWN
    state = meaning[image.levels]
    if image.opaque is not None:
        state[~image.opaque] = UNKNOWN
    return np.asarray(state)


def pool_blocked(blocked: NDArray[np.bool_], pixel_m: float, cell_m: float) -> NDArray[np.bool_]:
    """Cells of `cell_m` that are blocked because some pixel in them is (max-pooling).

    A pixel that lies in two cells counts in both. Cells start at the lower left corner; what does
    not fill a whole cell at the other ends makes cells that are blocked, for they leave the map.

    Args:
        blocked: (rows, columns) bool, row 0 at the bottom.
        pixel_m, cell_m: sides of a pixel and of a cell [m]; the cell is the larger.
    """
    if cell_m < pixel_m * (1 - 1e-9):
        raise ValueError(f"cells of {cell_m} m are smaller than the pixels of {pixel_m} m")
    pooled = np.asarray(blocked, dtype=np.bool_)
    for axis in (0, 1):
        pixels = pooled.shape[axis]
        cells = max(1, math.ceil(pixels * pixel_m / cell_m - 1e-6))
        edges = np.arange(cells + 1) * cell_m / pixel_m
        first = np.floor(edges[:-1] + 1e-6).astype(np.intp)
        last = np.minimum(np.ceil(edges[1:] - 1e-6).astype(np.intp), pixels)
        parts = [
            pooled.take(range(a, b), axis=axis).any(axis=axis)
            for a, b in zip(first.tolist(), last.tolist(), strict=True)
        ]
        pooled = np.stack(parts, axis=axis)
        if edges[-1] > pixels + 1e-6:
            pooled[(-1,) if axis == 0 else (slice(None), -1)] = True
    return np.ascontiguousarray(pooled)


def read_info(path: Path, *, image: Path | None = None) -> RosMapInfo:
    """The YAML file of a map; the image is not opened.

    Raises:
        WorldError: with all that is wrong.
    """
    name = str(path)
    values, lines = _mapping(_text_of(path, name), name)
    wrong: list[tuple[int, str]] = []
    taken: dict[str, Any] = {}

    def refuse(key: str, message: str) -> None:
        wrong.append((lines.get(key, 1), f"{key}: {message}"))

    for key, usual in _USUAL.items():
        if key in values:
            taken[key] = values[key]
        elif not (key == "image" and image is not None):
            near = nearest(key, [k for k in values if k not in _USUAL])
            hint = near.strip() if near else f"map_saver writes {key}: {usual}"
            refuse(key, f"is missing; {hint}")
    if "image" in taken and not (isinstance(taken["image"], str) and taken["image"].strip()):
        refuse("image", f"{_shown(taken['image'])} is no file name; give one in quotes")
    resolution = taken.get("resolution")
    if resolution is not None and not _is_number(resolution):
        refuse("resolution", f"{_shown(resolution)} is no number; give metres per pixel")
    elif resolution is not None and not RESOLUTION_M[0] <= resolution <= RESOLUTION_M[1]:
        refuse("resolution", _not_a_resolution(float(resolution)))
    _check_origin(taken.get("origin"), refuse)
    negate = taken.get("negate", 0)
    if negate not in (0, 1):  # False and True, too
        refuse("negate", f"{_shown(negate)} is neither 0 nor 1")
    for key in ("occupied_thresh", "free_thresh"):
        limit = taken.get(key, 0.5)
        if not _is_number(limit) or not 0 <= limit <= 1:
            per_cent = _is_number(limit) and 1 < limit <= 100
            hint = f"; per cent? then write {limit / 100:g}" if per_cent else ""
            refuse(key, f"{_shown(limit)} is no share between 0 and 1{hint}")
            taken.pop(key, None)
    if taken.get("free_thresh", 0) > taken.get("occupied_thresh", 1):
        both = f"{taken['free_thresh']} is above occupied_thresh, {taken['occupied_thresh']}"
        refuse("free_thresh", f"{both}; a pixel cannot be both free and occupied")
    mode = values.get("mode", "trinary")
    if mode not in MODES:
        near = nearest(mode, MODES) if isinstance(mode, str) else ""
        refuse("mode", f"{_shown(mode)} must be one of {', '.join(MODES)};{near}".rstrip(";"))
    target = image
    if image is None and not any(text.startswith("image:") for _, text in wrong):
        target = _image_path(path, taken["image"], refuse)
    if wrong or target is None:
        wrong.sort()
        told = [f"{name}:{line}: {text}" for line, text in wrong]
        raise WorldError([Fault((), text) for _, text in wrong], told)
    x, y, _ = taken["origin"]
    return RosMapInfo(
        name,
        target,
        float(taken["resolution"]),
        (float(x), float(y)),
        bool(negate),
        float(taken["occupied_thresh"]),
        float(taken["free_thresh"]),
        mode,
    )


def _check_origin(origin: Any, refuse: Any) -> None:
    if origin is None:
        return
    good = isinstance(origin, list) and len(origin) == 3 and all(_is_number(v) for v in origin)
    if not good:
        refuse("origin", f"{_shown(origin)} is not [x, y, yaw]; give metres, metres, radians")
    elif origin[2] != 0:
        turned = f"yaw {origin[2]:g} rad ({math.degrees(origin[2]):.4g}°) turns the map"
        refuse("origin", f"{turned}; rotate the image and write yaw 0, as only that is read")
    elif max(abs(origin[0]), abs(origin[1])) > 1e6:
        refuse("origin", f"{_shown(origin)} is more than 1000 km off; give metres")


def _not_a_resolution(value: float) -> str:
    if value <= 0:
        return f"{value:g} must be more than 0; give metres per pixel, such as 0.05"
    unit, factor = ("millimetres", 1000) if value >= 10 else ("centimetres", 100)
    if value > RESOLUTION_M[1]:
        fixed = f"{value / factor:g}"
        return f"{value:g} m per pixel is too coarse for a hall; {unit}? then write {fixed}"
    return f"{value:g} m per pixel is finer than a millimetre; give metres per pixel"


def _image_path(path: Path, named: str, refuse: Any) -> Path | None:
    """The image: an absolute name as it is, a relative one only below the YAML file's folder."""
    if "\x00" in named:
        refuse("image", "the file name contains a null byte; give another")
        return None
    if Path(named).is_absolute():
        return Path(named)
    folder = path.parent
    target = folder / named
    try:
        inside = target.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # a circle of links
        inside = False
    if not inside:
        rule = f"{_shown(named)} leads out of the folder of the YAML file"
        refuse("image", f"{rule}; copy the image there, or name it with --image")
        return None
    return target


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _shown(value: Any) -> str:
    """A value, shortened; one that is nested is only counted, lest it be exponentially large."""
    if isinstance(value, list | dict):
        if any(isinstance(v, list | dict) for v in value) or len(value) > 8:
            return f"a {type(value).__name__} of {len(value)} entries"
        return str(value)[:60]
    return repr(value)[:60]


def _mapping(text: str, name: str) -> tuple[dict[str, Any], dict[str, int]]:
    """Values and lines of the keys of a YAML mapping; plain values only, no objects."""
    import yaml

    loader = yaml.SafeLoader(text)
    try:
        node = loader.get_single_node()
        if not isinstance(node, yaml.MappingNode):
            rule = "is no list of `key: value`; give the YAML file of a map_server map"
            raise _error(name, 1, rule)
        values: dict[str, Any] = {}
        lines: dict[str, int] = {}
        for key_node, value_node in node.value:
            key = str(loader.construct_object(key_node, deep=True))
            line = key_node.start_mark.line + 1
            if key in values:
                raise _error(name, line, f"{key}: is given in line {lines[key]} already; keep one")
            values[key] = loader.construct_object(value_node, deep=True)
            lines[key] = line
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
        why = getattr(error, "problem", None) or " ".join(str(error).split())
        if isinstance(error, yaml.constructor.ConstructorError):
            why = f"{why}; only plain values are read"
        line = mark.line + 1 if mark else 1
        raise _error(name, line, f"is not valid YAML: {str(why)[:200]}") from error
    except RecursionError as error:
        raise _error(name, 1, "is nested too deeply to be a map; check its brackets") from error
    except (ValueError, OverflowError) as error:  # dates and numbers that look right and are not
        if isinstance(error, WorldError):
            raise
        raise _error(name, 1, f"is not valid YAML: {str(error)[:200]}") from error
    finally:
        loader.dispose()
    return values, lines


def _text_of(path: Path, name: str) -> str:
    try:
        if not path.exists():
            raise _error(name, None, "there is no such file; check the path")
        if not path.is_file():
            raise _error(name, None, "is not a regular file; give the YAML file of a map")
        if path.stat().st_size > MAX_YAML_BYTES:
            size = f"has {path.stat().st_size / 1000:.0f} kB"
            raise _error(name, None, f"{size}, too much for the YAML file of a map; is it one?")
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        rule = "is not text; give the YAML file of the map, not its image"
        raise _error(name, None, rule) from error
    except OSError as error:
        why = error.strerror or str(error)
        raise _error(name, None, f"cannot be read: {why}; check its rights") from error


def _error(name: str, line: int | None, message: str) -> WorldError:
    place = name if line is None else f"{name}:{line}"
    return WorldError([Fault((), message)], [f"{place}: {message}"])
