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
    ".json": "VDMA LIF",
    ".lif": "VDMA LIF",
}
"""What a file's ending says about its format."""


OBSTACLE_HEIGHT_M = 2.0


class Unknown(StrEnum):
    """What unknown pixels count as."""

    blocked = "blocked"
    free = "free"


def import_world(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="A ROS map (.yaml), a MovingAI map (.map) or a VDMA LIF layout (.json, .lif).",
        ),
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
    layout: Annotated[
        str | None, typer.Option(metavar="ID", help="LIF: which layout, if there are several.")
    ] = None,
    vehicle: Annotated[
        str | None, typer.Option(metavar="ID", help="LIF: which type, if there are several.")
    ] = None,
    slot: Annotated[
        float | None,
        typer.Option(metavar="S", help="LIF: length of a slot; else what suits the lanes."),
    ] = None,
    speed: Annotated[
        float | None,
        typer.Option(metavar="M/S", help="LIF: of the robots where lanes allow it; else 1.5."),
    ] = None,
    obstacle_height: Annotated[
        float, typer.Option(metavar="M", help="Of all obstacles; the map does not say.")
    ] = OBSTACLE_HEIGHT_M,
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
        stem = source.stem.removesuffix(".lif")
        target = output or Path(f"{stem}.toml")
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
            name=name or stem[:64],
        )
        kind = MAPS[source.suffix.lower()]
        _refuse_options_of_others(
            kind,
            {
                "--scen": ("MovingAI", scenario is not None),
                "--passable": ("MovingAI", passable != PASSABLE),
                "--unknown": ("ROS map_server", unknown is not Unknown.blocked),
                "--image": ("ROS map_server", image is not None),
                "--layout": ("VDMA LIF", layout is not None),
                "--vehicle": ("VDMA LIF", vehicle is not None),
                "--slot": ("VDMA LIF", slot is not None),
                "--speed": ("VDMA LIF", speed is not None),
                "--pitch": ("a grid", pitch is not None),
                "--obstacle-height": ("a grid", obstacle_height != OBSTACLE_HEIGHT_M),
            },
        )
        hints: list[str] = []
        with Meter() as meter:
            meter.phase("reading the map")
            if kind == "VDMA LIF":
                from worlds.import_lif import LifParams, import_lif

                imported = import_lif(
                    source, target, params, LifParams(layout, vehicle, slot, speed)
                )
            else:
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


def _refuse_options_of_others(kind: str, options: dict[str, tuple[str, bool]]) -> None:
    """Refuse options that are given and mean nothing for this kind of map."""
    grids = {"MovingAI", "ROS map_server"}
    wrong = [
        option
        for option, (of, given) in options.items()
        if given and of != kind and not (of == "a grid" and kind in grids)
    ]
    if wrong:
        raise TwinError(f"{', '.join(wrong)}: not for a {kind} map; leave it out")


def _grid(
    source: Path,
    params: ImportParams,
    scenario: Path | None,
    passable: str,
    unknown: Unknown,
    image: Path | None,
) -> tuple[BlockedGrid, list[str]]:
    """The blocked cells of a map that is a grid, and hints."""
    from worlds.formats.movingai import read_map, read_scenario
    from worlds.formats.ros_map import read_ros_map
    from worlds.import_maps import movingai_grid, ros_grid

    if MAPS[source.suffix.lower()] == "MovingAI":
        found = read_map(source, passable=passable)
        return movingai_grid(found, params, None if scenario is None else read_scenario(scenario))
    free = unknown is Unknown.free
    return ros_grid(read_ros_map(source, image=image), params, unknown_is_free=free)


def _values(
    source: Path, target: Path, imported: ImportedWorld, hints: list[str]
) -> dict[str, object]:
    world, floor = imported.world, imported.floor
    body, graph = world.hall.body, world.hall.graph
    lanes = {}
    if graph is not None:
        lanes = {
            "lanes": len(floor.edge_uv),
            "one_way": int(floor.edge_oneway.sum()),
            "stations": len(world.station),
            "slot_s": floor.slot_s,
        }
    return lanes | {
        "source": str(source),
        "file": str(target),
        "world": world.name,
        "size_m": list(world.hall.size_m),
        "pitch_m": world.hall.grid_pitch_m,
        "body_m": [body.length_m, body.width_m],
        "positions": floor.columns * floor.rows if graph is None else len(graph.node),
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
    size = f"{width:g} m x {depth:g} m"
    if "lanes" in values:
        facts.section(
            [
                ("layout", of("source")),
                ("hall", f"{size}, the extent of the nodes and a margin"),
                ("nodes", number(of("positions"))),
                ("lanes", f"{number(of('lanes'))}, {number(of('one_way'))} of them one-way"),
                ("stations", number(of("stations"))),
                ("slot", f"{of('slot_s'):g} s; a typical lane is {of('pitch_m'):g} m long"),
            ]
        )
    else:
        facts.section(
            [
                ("map", of("source")),
                ("hall", f"{size}, pitch {of('pitch_m'):g} m"),
                (
                    "positions",
                    f"{number(of('positions'))}, {number(of('free_positions'))} of them free",
                ),
                ("obstacles", f"{number(of('obstacles'))} boxes, exactly the blocked cells"),
            ]
        )
    covered = per_cent(of("covered_share"))
    ground = "nodes" if "lanes" in values else "floor"
    facts.section(
        [
            ("access points", f"{len(of('aps'))} proposed, covering {covered} of the {ground}"),
            ("robots", f"{of('robots')} of {length:g} m x {across:g} m"),
            ("horizon", f"{of('horizon')} slots, the longest errand takes {of('longest_errand')}"),
        ]
    )
    hints = [("hint", hint) for hint in of("hints")]
    if hints:
        facts.section(hints)
    facts.section([("world", of("file")), ("next", f"twin check {of('file')} -o check.png")])
    facts.print(stdout())
