"""`twin import`: maps of other tools become worlds."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin.cli_console import Meter, guarded, print_json, stdout
from twin.cli_options import AsJson, Debug, Overwrite, require_suffix
from twin.errors import TwinError
from worlds.formats import PASSABLE

if TYPE_CHECKING:
    from worlds.map_import import BlockedGrid, ImportedWorld, ImportParams

MAPS = {
    ".yaml": "ROS map_server",
    ".yml": "ROS map_server",
    ".map": "MovingAI",
}
"""What a file's ending says about its format."""


class Unknown(StrEnum):
    """What unknown pixels count as."""

    blocked = "blocked"
    free = "free"


def import_world(
    source: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="A ROS map (.yaml) or a MovingAI map (.map)."),
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="WORLD.toml", help="Else <name of the map>.toml."),
    ] = None,
    pitch: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="Distance of positions; else 1 m, or what suits the map. A MovingAI cell is one "
            "position.",
        ),
    ] = None,
    body: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH,WIDTH",
            help="Of the robots, in metres; else 0.8,0.6 or smaller, so that length + width fit "
            "the pitch.",
        ),
    ] = None,
    robots: Annotated[int, typer.Option(min=1, help="How many robots are to drive.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Of their random errands.")] = 1,
    scenario: Annotated[
        Path | None,
        typer.Option(
            "--scen", metavar="FILE.scen", help="MovingAI: errands from here, not random."
        ),
    ] = None,
    passable: Annotated[
        str, typer.Option(metavar="SYMBOLS", help="MovingAI: what a robot may stand on.")
    ] = PASSABLE,
    unknown: Annotated[
        Unknown, typer.Option(help="ROS: what unknown pixels count as.")
    ] = Unknown.blocked,
    image: Annotated[
        Path | None, typer.Option(metavar="FILE", help="ROS: the image, if it lies elsewhere.")
    ] = None,
    obstacle_height: Annotated[
        float, typer.Option(metavar="M", help="Of all obstacles; the map does not say.")
    ] = 2.0,
    ap_height: Annotated[
        float, typer.Option(metavar="M", help="Of the proposed access points.")
    ] = 5.0,
    coverage: Annotated[
        float, typer.Option(metavar="SHARE", help="Of the floor that they are to cover.")
    ] = 0.99,
    model: Annotated[
        str | None,
        typer.Option(
            metavar="MODEL",
            help="Channel: inh-office, inf-sl, inf-dl, inf-sh, inf-dh (3GPP TR 38.901).",
        ),
    ] = None,
    horizon: Annotated[
        int | None, typer.Option(min=1, help="Slots to plan for; else from the longest errand.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Of the world; else the map's.")] = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Make a world of a map: obstacles merged, access points proposed, robots drawn."""
    with guarded(debug):
        from twin.outputs import check_file, write_text
        from worlds.import_maps import parse_body
        from worlds.map_import import ImportParams, import_grid

        require_suffix(source, tuple(MAPS), "a map")
        target = output or Path(f"{source.stem}.toml")
        check_file(target, (".toml",), overwrite=overwrite)
        params = ImportParams(
            pitch_m=pitch,
            body_m=None if body is None else parse_body(body),
            obstacle_height_m=obstacle_height,
            ap_height_m=ap_height,
            model=_model(model),
            coverage=coverage,
            robots=robots,
            seed=seed,
            horizon=horizon,
            name=name or source.stem[:64],
        )
        with Meter() as meter:
            meter.phase("reading the map")
            grid, hints = _grid(source, params, scenario, passable, unknown, image)
            meter.phase("placing access points")
            imported = import_grid(grid, params)
        write_text(target, imported.text)
        values = _values(source, target, imported, [*hints, *imported.hints])
        if as_json:
            print_json(values)
        else:
            _print(values)


def _model(name: str | None):  # type: ignore[no-untyped-def]
    """A channel model of the table, checked by name."""
    if name is not None:
        from worlds.channel import channel_model

        channel_model(name)
    return name


def _grid(
    source: Path,
    params: ImportParams,
    scenario: Path | None,
    passable: str,
    unknown: Unknown,
    image: Path | None,
) -> tuple[BlockedGrid, list[str]]:
    """The map's blocked cells, and hints; options of the other format are refused."""
    from worlds.formats.movingai import read_map, read_scenario
    from worlds.formats.ros_map import read_ros_map
    from worlds.import_maps import movingai_grid, ros_grid

    kind = MAPS[source.suffix.lower()]
    ours = kind == "MovingAI"
    strangers = {
        "--scen": not ours and scenario is not None,
        "--passable": not ours and passable != PASSABLE,
        "--unknown": ours and unknown is not Unknown.blocked,
        "--image": ours and image is not None,
    }
    wrong = [option for option, given in strangers.items() if given]
    if wrong:
        raise TwinError(f"{', '.join(wrong)}: not for a {kind} map; leave it out")
    if ours:
        found = read_map(source, passable=passable)
        return movingai_grid(found, params, None if scenario is None else read_scenario(scenario))
    free = unknown is Unknown.free
    return ros_grid(read_ros_map(source, image=image), params, unknown_is_free=free)


def _values(
    source: Path, target: Path, imported: ImportedWorld, hints: list[str]
) -> dict[str, object]:
    world, floor = imported.world, imported.floor
    body = world.hall.body
    return {
        "source": str(source),
        "file": str(target),
        "world": world.name,
        "size_m": list(world.hall.size_m),
        "pitch_m": world.hall.grid_pitch_m,
        "body_m": [body.length_m, body.width_m],
        "positions": floor.columns * floor.rows,
        "free_positions": len(floor.vertex_xy_m),
        "obstacles": len(world.obstacle),
        "aps": [{"id": ap.id, "position_m": list(ap.position_m)} for ap in world.ap],
        "covered_share": imported.proposal.covered_share,
        "robots": len(floor.robot_ids),
        "longest_errand": imported.longest_errand,
        "horizon": world.plan.horizon,
        "hints": hints,
    }


def _print(values: dict[str, object]) -> None:
    from twin.cli_tables import Facts, number, per_cent

    def of(key: str):  # type: ignore[no-untyped-def]
        return values[key]

    facts = Facts(f"{of('world')}: imported")
    width, depth = of("size_m")
    length, across = of("body_m")
    facts.section(
        [
            ("map", of("source")),
            ("hall", f"{width:g} m x {depth:g} m, pitch {of('pitch_m'):g} m"),
            (
                "positions",
                f"{number(of('positions'))}, {number(of('free_positions'))} of them free",
            ),
            ("obstacles", f"{number(of('obstacles'))} boxes, exactly the blocked cells"),
        ]
    )
    covered = per_cent(of("covered_share"))
    facts.section(
        [
            ("access points", f"{len(of('aps'))} proposed, covering {covered} of the floor"),
            ("robots", f"{of('robots')} of {length:g} m x {across:g} m"),
            ("horizon", f"{of('horizon')} slots, the longest errand takes {of('longest_errand')}"),
        ]
    )
    hints = [("hint", hint) for hint in of("hints")]
    if hints:
        facts.section(hints)
    facts.section([("world", of("file")), ("next", f"twin check {of('file')} -o check.png")])
    facts.print(stdout())
