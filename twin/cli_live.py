"""`twin live` and `twin replay`: a run on a web socket, for Foxglove's live view."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin.cli_console import DONE, NO, Meter, guarded, stderr
from twin.cli_options import Debug, LogFile, Overwrite, Seed, Set, WorldFile, parse_overrides
from twin.errors import TwinError

if TYPE_CHECKING:
    from logs.records import Record
    from planner.plan import Plan
    from twin.instance import Instance
    from twin.live import LiveView, Options

Port = Annotated[
    int, typer.Option(min=0, max=65535, help="On 127.0.0.1; 0 takes any that is free.")
]
Speed = Annotated[float, typer.Option(min=0.01, max=10_000.0, help="Simulated seconds per second.")]
Paused = Annotated[bool, typer.Option("--paused", help="Wait until a viewer presses play.")]
Once = Annotated[
    bool, typer.Option("--once", help="End with the run, instead of serving until Ctrl-C.")
]


def live(
    world: WorldFile,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="run.mcap", help="Write the log, too."),
    ] = None,
    port: Port = 8765,
    speed: Speed = 1.0,
    paused: Paused = False,
    once: Once = False,
    seed: Seed = None,
    settings: Set = None,
    overwrite: Overwrite = False,
    debug: Debug = False,
) -> None:
    """Plan a world and show the run while it is made, in Foxglove on this machine."""
    with guarded(debug):
        from twin.cli_options import require_suffix
        from twin.instance import Stopwatch, open_instance
        from twin.live import require_sdk
        from twin.outputs import check_file
        from twin.pipeline import describe_plan, make_plan

        require_suffix(world, (".toml",), "a world file")
        if output is not None:
            check_file(output, (".mcap",), overwrite=overwrite)
        require_sdk()
        overrides = parse_overrides(settings)
        with Meter() as meter:
            watch = Stopwatch(meter.step)
            instance = open_instance(world, overrides=overrides, seed=seed, watch=watch)
            plan = make_plan(instance.problem, watch=watch)
        if plan.status == "infeasible" or plan.unserved:
            _say(f"{describe_plan(plan)}; nothing is shown")
            raise typer.Exit(NO)
        _serve_run(instance, plan, _options(instance.world.name, port, speed, paused), output, once)
        raise typer.Exit(DONE)


def replay(
    log: LogFile,
    show: Annotated[
        bool, typer.Option("--live", help="Show it in Foxglove on this machine (the only way yet).")
    ] = False,
    port: Port = 8765,
    speed: Speed = 1.0,
    paused: Paused = False,
    once: Once = False,
    debug: Debug = False,
) -> None:
    """Play a finished log as if it happened now, with play, pause, speed and seek."""
    with guarded(debug):
        from logs.playback import Playback
        from twin.live import LiveView, play_log, require_sdk

        if not show:
            raise TwinError(
                "--live: give it to show the log in Foxglove; to check it by running it again, use "
                "`twin validate --replay`"
            )
        require_sdk()
        with Meter() as meter:
            meter.phase("reading")
            playback = Playback(log)
        options = _options(log.name, port, speed, paused)
        with LiveView(playback.channels, playback.span_ns, options, seekable=True) as view:
            _announce(view)
            _until_interrupted(lambda: play_log(playback, view, once=once))
        raise typer.Exit(DONE)


def _serve_run(
    instance: Instance, plan: Plan, options: Options, output: Path | None, once: bool
) -> None:
    """Make the run at the pace of the view."""
    from contextlib import ExitStack

    from logs.mcap_format import time_ns
    from logs.mcap_writer import RunLog
    from logs.messages import MessageStream
    from twin.live import LiveRun, LiveView, serve_on
    from twin.twin import run

    inputs = (instance.world, instance.floor, instance.radio_map, instance.problem, plan)
    stream = MessageStream(*inputs)
    last = max((path.arrival for path in plan.paths if path is not None), default=0)
    span = (time_ns(0.0), time_ns((last + 1) * instance.floor.slot_s))
    with LiveView(stream.channels, span, options, seekable=False) as view, ExitStack() as stack:
        live_run = LiveRun(stream, view)
        _announce(view)
        written = None
        if output is not None:
            world, floor, radio_map, problem, _ = inputs
            written = stack.enter_context(
                RunLog(
                    output,
                    world=world,
                    floor=floor,
                    radio_map=radio_map,
                    problem=problem,
                    plan=plan,
                    overwrite=True,
                )
            )

        def emit(record: Record) -> None:
            if written is not None:
                written.write(record)
            live_run.emit(record)

        run(*inputs, emit=emit)
        stack.close()  # the log is whole before the last picture is kept for late viewers
        if not once:
            _until_interrupted(lambda: serve_on(view))


def _until_interrupted(serve: Callable[[], None]) -> None:
    """Ctrl-C is how one ends a server."""
    try:
        serve()
    except KeyboardInterrupt:
        return


def _options(name: str, port: int, speed: float, paused: bool) -> Options:
    from twin.live import Options

    return Options(name=name, port=port, speed=speed, paused=paused)


def _announce(view: LiveView) -> None:
    _say(f"{view.address}: in Foxglove choose Open connection → Foxglove WebSocket; Ctrl-C ends it")


def _say(text: str) -> None:
    stderr().print(text, soft_wrap=True)
