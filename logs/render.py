"""A run as moving pictures: PNG frames, a GIF, an MP4, or one still.

The hall is drawn once; each frame puts the robots, their links and what is in the way on a copy of
it. Frames are made one by one and handed on, so that a long film takes no more memory than a short
one.
"""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from PIL import Image

from logs.colors import OUTAGE_COLOR, ap_color, rgb
from logs.errors import LogError, in_a_sentence
from logs.figures import draw_aps, draw_ground, rectangle_m
from logs.moments import Moment, moments, run_span

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from logs.mcap_reader import RunFile

OnFrame = Callable[[int, int], None]

LENGTH_S = 20.0
"""A film whose speed is not given lasts about so long [s]."""
MAX_FRAMES = 20_000
WIDTH_PX = 900
NAMES_UP_TO = 30
"""The names of more robots than this would hide them."""
SUFFIXES = (".gif", ".mp4", "")

_DPI = 100
_LEAST_PX = 10.0  # a robot is drawn at least so long
_BLOCKAGE, _BLOCKAGE_INK = "#d95f02", "#6b2d00"
_NEW_S = 4.0  # the last event is shown for so long
_SPEEDS = (1, 2, 5)


@dataclass(frozen=True)
class Film:
    """When its frames are.

    Attributes:
        fps: frames per second of the film.
        speed: simulated seconds per second of the film.
        times_s: simulated time of each frame [s].
    """

    fps: float
    speed: float
    times_s: tuple[float, ...]


def plan_film(run: RunFile, *, fps: float = 10.0, speed: float | None = None) -> Film:
    """Choose the frames of a film of the whole run.

    Args:
        run: the log.
        fps: frames per second.
        speed: simulated seconds per second of the film; a round one for about `LENGTH_S` seconds
            if not given.

    Raises:
        LogError: that would be more frames than `MAX_FRAMES`.
    """
    _, end = run_span(run)
    seconds = max(end.t_s, 0.0)
    if not math.isfinite(seconds):
        raise LogError(f"{run.path}: ends at {end.t_s} s; there is nothing to draw")
    chosen = speed if speed is not None else _round_speed(seconds / LENGTH_S)
    count = seconds / chosen * fps
    if count > MAX_FRAMES:
        raise LogError(
            f"{run.path}: {seconds:.0f} s at speed {chosen:g} and {fps:g} frames per second are "
            f"{count:.0f} frames; at most {MAX_FRAMES}: give a higher speed"
        )
    step = chosen / fps
    times = [k * step for k in range(int(count) + 1)]
    if seconds - times[-1] > step / 2:
        times.append(seconds)
    return Film(fps, chosen, tuple(times))


def _round_speed(least: float) -> float:
    """1, 2, 5, 10, 20, … : the first that is no less."""
    power = 1.0
    while True:
        for k in _SPEEDS:
            if k * power >= least:
                return k * power
        power *= 10


def write_still(run: RunFile, path: Path, slot: int) -> None:
    """Draw the beginning of a slot to a PNG file.

    Raises:
        LogError: there is no such slot, or the file cannot be written.
    """
    start, end = run_span(run)
    if not 0 <= slot <= end.slot + 1:
        raise LogError(f"{run.path}: has no slot {slot}; give one from 0 to {end.slot + 1}")
    with in_a_sentence(run.path, "drawn"):
        (moment,) = moments(run, [slot * start.slot_s])
        image = Painter(run).frame(moment)
    with _written(path) as part:
        image.save(part, format="PNG")


def write_film(run: RunFile, path: Path, film: Film, *, on_frame: OnFrame | None = None) -> None:
    """Write a film; the name says as what: `.gif`, `.mp4`, or a folder for PNG frames.

    Args:
        run: the log.
        path: of the file or folder; nothing is left there if something goes wrong.
        film: when its frames are.
        on_frame: told (frames done, frames in all).

    Raises:
        LogError: ffmpeg is needed and not there, or the place cannot be written to.
    """
    with in_a_sentence(run.path, "drawn"):
        painter = Painter(run)
    total = len(film.times_s)

    def frames() -> Iterator[Image.Image]:
        coming = moments(run, film.times_s)
        for done in range(1, total + 1):
            with in_a_sentence(run.path, "drawn"):
                image = painter.frame(next(coming))
            yield image
            if on_frame:
                on_frame(done, total)

    match path.suffix.lower():
        case ".gif":
            with _written(path) as part:
                _write_gif(frames(), part, film.fps)
        case ".mp4":
            with _written(path) as part:
                _write_mp4(frames(), part, film.fps)
        case _:
            _write_frames(frames(), path, total)


# --- files ----------------------------------------------------------------------------------------


class _written:  # noqa: N801  (used as a function)
    """A file that is written beside its place and renamed when all is well."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._part = path.with_name(path.name + ".part")

    def __enter__(self) -> Path:
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise _refused(self._path, error) from error
        return self._part

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: object) -> None:
        try:
            if kind is None:
                os.replace(self._part, self._path)
        except OSError as refusal:
            raise _refused(self._path, refusal) from refusal
        finally:
            self._part.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise _refused(self._path, error) from error


def _refused(path: Path, error: OSError) -> LogError:
    return LogError(f"{path}: cannot be written: {error.strerror or error}")


def _write_gif(frames: Iterator[Image.Image], path: Path, fps: float) -> None:
    first = next(frames)
    palette = first.quantize(255, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)

    def reduced(image: Image.Image) -> Image.Image:
        return image.quantize(palette=palette, dither=Image.Dither.NONE)

    reduced(first).save(
        path,
        format="GIF",
        save_all=True,
        append_images=map(reduced, frames),
        duration=max(20, round(1000 / fps)),  # viewers slow down what is shorter
        loop=0,
        optimize=False,
        disposal=1,
    )


def require_ffmpeg() -> str:
    """Where ffmpeg is.

    Raises:
        LogError: it is not installed.
    """
    found = shutil.which("ffmpeg")
    if found is None:
        raise LogError(
            "ffmpeg is not installed, and MP4 needs it; install it (apt install ffmpeg), or give a "
            "name ending in .gif, or one without an ending for a folder of frames"
        )
    return found


def _write_mp4(frames: Iterator[Image.Image], path: Path, fps: float) -> None:
    first = next(frames)
    command = [
        *(require_ffmpeg(), "-loglevel", "error", "-y"),
        *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{first.width}x{first.height}"),
        *("-r", f"{fps:g}", "-i", "-", "-an"),
        *("-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20", "-movflags", "+faststart"),
        *("-f", "mp4", str(path)),
    ]
    with (
        tempfile.TemporaryFile() as said,
        subprocess.Popen(command, stdin=subprocess.PIPE, stderr=said) as process,
    ):
        try:
            if process.stdin is None:
                raise LogError("ffmpeg takes no frames")
            process.stdin.write(first.tobytes())
            for image in frames:
                process.stdin.write(image.tobytes())
            process.stdin.close()
        except BrokenPipeError:
            pass  # it says below why it has ended
        except BaseException:
            process.kill()
            raise
        if process.wait():
            said.seek(0)
            words = said.read().decode(errors="replace").strip().splitlines() or ["no reason given"]
            raise LogError(f"{path.with_suffix('')}: ffmpeg failed: {words[-1]}")


def _write_frames(frames: Iterator[Image.Image], folder: Path, total: int) -> None:
    digits = max(4, len(str(total)))
    part = folder.with_name(folder.name + ".part")
    try:
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        for k, image in enumerate(frames):
            image.save(part / f"frame_{k:0{digits}}.png")
        if folder.exists():
            shutil.rmtree(folder)
        os.replace(part, folder)
    except OSError as error:
        raise _refused(folder, error) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


# --- drawing --------------------------------------------------------------------------------------


class Painter:
    """Draws moments of one run, all as large."""

    def __init__(self, run: RunFile) -> None:
        """Draw what stands still."""
        world = run.world
        self._start, _ = run_span(run)
        self._aps = np.array([p for ap in self._start.aps for p in _place(world, ap)]).reshape(
            -1, 2
        )
        width, depth = world.hall.size_m
        inches = WIDTH_PX / _DPI
        height = min(max(inches * depth / width, 2.0), 1.4 * inches) + 0.9
        # Both sides are even numbers of pixels: video codecs want that.
        size = (inches, 2 * round(height * _DPI / 2) / _DPI)
        self._figure = Figure(figsize=size, dpi=_DPI, layout="constrained")
        self._canvas = cast("Any", FigureCanvasAgg(self._figure))  # its methods have no types
        ax = self._figure.subplots()
        draw_ground(ax, run)
        draw_aps(ax, world, self._start.aps, 11.0)
        ax.grid(False)
        self._title = ax.set_title(" \n ", loc="left", size=10, family="DejaVu Sans")
        self._canvas.draw()
        # The frame is fixed now; a title of another length must not move it.
        self._figure.set_layout_engine("none")
        self._title.set_text("")
        self._canvas.draw()
        self._ground = self._canvas.copy_from_bbox(self._figure.bbox)
        self._ax = ax

        scale = float(np.diff(ax.transData.transform([(0, 0), (1, 0)])[:, 0])[0])  # pixels per m
        body = world.hall.body
        grow = max(1.0, _LEAST_PX / (body.length_m * scale))
        self._half = np.array([body.length_m, body.width_m]) / 2 * grow
        self._colors = [(*ap_color(k), 1.0) for k in range(len(self._start.aps))]
        self._lost_color = (*rgb(OUTAGE_COLOR), 1.0)
        self._links = LineCollection([], linewidths=1.1, alpha=0.75, zorder=4)
        self._bodies: Any = PolyCollection([], edgecolors="#111111", linewidths=0.8, zorder=6)
        self._noses: Any = LineCollection([], colors="white", linewidths=1.6, zorder=7)
        self._boxes = PolyCollection(
            [], facecolors=_BLOCKAGE, edgecolors="#111111", linewidths=1.0, zorder=5
        )
        for artist in (self._links, self._bodies, self._noses, self._boxes):
            artist.set_animated(True)
            ax.add_collection(artist, autolim=False)

    def frame(self, moment: Moment) -> Image.Image:
        """One picture, RGB."""
        self._canvas.restore_region(self._ground)
        lost = moment.lost
        colors = [
            self._lost_color if gone or ap < 0 else self._colors[ap]
            for ap, gone in zip(moment.ap.tolist(), lost.tolist(), strict=True)
        ]
        served = moment.ap >= 0
        ends = np.stack([moment.xy_m[served], self._aps[moment.ap[served]]], axis=1)
        self._links.set_segments(list(ends))
        self._links.set_colors([c for c, has in zip(colors, served.tolist(), strict=True) if has])
        corners, noses = self._shapes(moment)
        self._bodies.set_verts(corners)
        self._bodies.set_facecolors(colors)
        self._noses.set_segments(noses)
        boxes = moment.blockages
        columns = (
            zip(*(boxes.x_m, boxes.y_m, boxes.length_m, boxes.width_m, boxes.yaw_rad), strict=False)
            if boxes is not None
            else ()
        )
        self._boxes.set_verts([rectangle_m(*box) for box in columns])
        for artist in (self._links, self._boxes, self._bodies, self._noses):
            self._ax.draw_artist(artist)
        self._write(moment, int(lost.sum()))
        pixels = np.asarray(self._canvas.buffer_rgba())[:, :, :3]
        return Image.fromarray(np.ascontiguousarray(pixels))

    def _shapes(self, moment: Moment) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Corners (n, 4, 2) of the bodies, and their noses (n, 2, 2) [m]."""
        cos, sin = np.cos(moment.heading_rad), np.sin(moment.heading_rad)
        ahead = np.stack([cos, sin], axis=1) * self._half[0]
        aside = np.stack([-sin, cos], axis=1) * self._half[1]
        at = moment.xy_m
        corners = np.stack(
            [at + ahead + aside, at - ahead + aside, at - ahead - aside, at + ahead - aside], axis=1
        )
        noses = np.stack([at + 0.75 * ahead + 0.5 * aside, at + 0.75 * ahead - 0.5 * aside], axis=1)
        return corners, noses

    def _write(self, moment: Moment, lost: int) -> None:
        """Time and counts above the hall, names of robots if they are few, marks of the rest."""
        ax, robots = self._ax, len(moment.robot)
        line = f"{moment.t_s:.1f} s (slot {moment.slot}): {robots} robots on the floor"
        line += f", {lost} without connection" if lost else ""
        since, event = moment.event
        new = event if moment.t_s - since <= _NEW_S else ""
        self._title.set_text(f"{line}\n{new[:110] or ' '}")
        ax.draw_artist(self._title)
        if robots <= NAMES_UP_TO:
            for robot, (x, y) in zip(moment.robot.tolist(), moment.xy_m.tolist(), strict=True):
                self._label(x, y, self._start.robots[robot], "#111111")
        for name in moment.out:
            if name in self._start.aps:
                x, y = self._aps[self._start.aps.index(name)].tolist()
                self._label(x, y, f"{name}: out", OUTAGE_COLOR)
        if moment.blockages is not None:
            boxes = moment.blockages
            for name, x, y in zip(boxes.name, boxes.x_m, boxes.y_m, strict=False):
                self._label(x, y, name, _BLOCKAGE_INK)

    def _label(self, x: float, y: float, text: str, color: str) -> None:
        label = self._ax.annotate(
            text.replace("$", r"\$"),
            (x, y),
            xytext=(5, 5),
            textcoords="offset points",
            size=7.5,
            color=color,
            path_effects=[withStroke(linewidth=2.0, foreground="white")],
            zorder=8,
            annotation_clip=False,
        )
        self._ax.draw_artist(label)
        label.remove()


def _place(world: Any, ap: str) -> Iterator[tuple[float, float]]:
    """Where an AP hangs, seen from above [m]."""
    for part in world.ap:
        if part.id == ap:
            yield part.position_m[:2]
