"""`twin render`: a run as moving pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin.cli_console import Meter, guarded, print_json, stdout
from twin.cli_options import AsJson, Debug, LogFile, Overwrite
from twin.errors import TwinError


def render(
    log: LogFile,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="run.gif|run.mp4|DIR|still.png",
            help="A film, a folder of PNG frames, or with --slot a still; else a GIF beside the "
            "log.",
        ),
    ] = None,
    slot: Annotated[
        int | None, typer.Option(min=0, help="Draw only the beginning of this slot.")
    ] = None,
    fps: Annotated[
        float, typer.Option(min=0.1, max=60.0, help="Frames per second of the film.")
    ] = 10.0,
    speed: Annotated[
        float | None,
        typer.Option(
            min=0.01,
            max=10_000.0,
            help="Simulated seconds per second; else a film of about 20 seconds.",
        ),
    ] = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Draw a run: the hall from above, the robots, who serves them, and what happens."""
    with guarded(debug):
        from logs.mcap_reader import read
        from logs.render import plan_film, require_ffmpeg, write_film, write_still

        target = output or log.with_suffix(".gif" if slot is None else ".png")
        _check_target(target, slot is not None, overwrite=overwrite)
        if target.suffix.lower() == ".mp4":
            require_ffmpeg()
        frames = 1
        with Meter() as meter:
            meter.phase("reading")
            run = read(log)
            if slot is not None:
                meter.phase("drawing")
                write_still(run, target, slot)
            else:
                film = plan_film(run, fps=fps, speed=speed)
                frames = len(film.times_s)
                write_film(
                    run,
                    target,
                    film,
                    on_frame=lambda done, total: meter.step(
                        f"frame {done} of {total}", done / total
                    ),
                )
        if as_json:
            print_json({"file": str(target), "frames": frames})
        elif slot is not None:
            stdout().print(f"{target}", soft_wrap=True)
        else:
            what = f"{frames} frames, {frames / fps:.1f} s at {film.speed:g} times the speed"
            stdout().print(f"{target}: {what}", soft_wrap=True)


def _check_target(target: Path, still: bool, *, overwrite: bool) -> None:
    """Refuse a name that does not fit, or a place that is taken, before the work.

    Raises:
        TwinError: one of these.
    """
    from twin.outputs import check_file, check_writable

    if still:
        check_file(target, (".png",), overwrite=overwrite)
    elif target.suffix.lower() == ".png":
        raise TwinError(f"{target}: is one picture; add --slot, or give a folder for all frames")
    elif target.suffix:
        check_file(target, (".gif", ".mp4"), overwrite=overwrite)
    else:
        if target.exists() and not target.is_dir():
            raise TwinError(f"{target}: is a file; give the name of a folder for the frames")
        if target.is_dir():
            strange = [p.name for p in target.iterdir() if not _is_frame(p)]
            if strange:
                raise TwinError(
                    f"{target}: holds other files than frames ({strange[0]}); choose another folder"
                )
            if any(target.iterdir()) and not overwrite:
                raise TwinError(f"{target}: holds frames already; add --overwrite")
        check_writable(target.parent)


def _is_frame(path: Path) -> bool:
    return path.name.startswith("frame_") and path.suffix == ".png"
