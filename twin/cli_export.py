"""`twin export`: what other tools can read of a world or a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin.cli_console import Meter, guarded, print_json, stdout
from twin.cli_options import AsJson, Debug, Overwrite, Set, parse_overrides, require_suffix
from twin.errors import TwinError

if TYPE_CHECKING:
    from logs.mcap_reader import RunFile
    from worlds.floor import Floor
    from worlds.world import World


def export(
    source: Annotated[
        Path,
        typer.Argument(metavar="WORLD.toml|RUN.mcap", help="A world, or the log of a run."),
    ],
    lif: Annotated[
        Path | None,
        typer.Option(metavar="out.json", help="The tracks as a VDMA LIF 1.0 layout."),
    ] = None,
    vda5050: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="VDA 5050 3.0 orders, one per robot, and when what is released."
        ),
    ] = None,
    csv: Annotated[
        Path | None, typer.Option(metavar="plan.csv", help="The plan, a row per robot and slot.")
    ] = None,
    manufacturer: Annotated[
        str, typer.Option(metavar="NAME", help="VDA 5050: of the robots.")
    ] = "mapp-twin",
    release: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="VISITS",
            help="VDA 5050: how many nodes are released ahead of a robot; else "
            "run.release_horizon of the world.",
        ),
    ] = None,
    settings: Set = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Write the tracks of a world, or the orders and the plan of a run, for other tools."""
    with guarded(debug):
        from twin.outputs import check_file, write_text

        require_suffix(source, (".toml", ".mcap"), "a world or a log")
        is_run = source.suffix.lower() == ".mcap"
        if lif is None and vda5050 is None and csv is None:
            raise TwinError("say what to write: --lif out.json, --vda5050 DIR or --csv plan.csv")
        if not is_run and (vda5050 is not None or csv is not None):
            raise TwinError(
                f"{source}: orders and plans are those of a run; first run it (twin run {source}), "
                "then export its run.mcap"
            )
        if is_run and settings:
            raise TwinError(f"--set: {source} is a run; only the values of a world can be set")
        for path, suffixes in ((lif, (".json", ".lif")), (csv, (".csv",))):
            if path is not None:
                check_file(path, suffixes, overwrite=overwrite)
        if vda5050 is not None:
            _check_folder(vda5050, overwrite=overwrite)
        values: dict[str, object] = {"source": str(source)}
        hints: list[str] = []
        with Meter() as meter:
            meter.phase("reading")
            run, world, floor = _open(source, settings, is_run=is_run)
            texts: dict[Path, str] = {}
            if lif is not None:
                from twin.export import dump_lif, lif_of

                layout, hints = lif_of(world, floor)
                texts[lif] = dump_lif(world, layout)
                values["lif"] = {
                    "file": str(lif),
                    "nodes": len(layout.nodes),
                    "edges": len(layout.edges),
                    "stations": len(layout.stations),
                }
            if csv is not None and run is not None:
                texts[csv] = _plan_csv(run)
                values["csv"] = {"file": str(csv), "rows": texts[csv].count("\n") - 1}
            orders = None
            if vda5050 is not None and run is not None:
                from twin.export_orders import orders_of

                orders = orders_of(run, manufacturer=manufacturer, release_horizon=release)
                values["vda5050"] = {
                    "folder": str(vda5050),
                    "orders": len(orders.order),
                    "releases": len(orders.releases),
                }
            for path, text in texts.items():
                write_text(path, text)
            if orders is not None and vda5050 is not None:
                _write_all(vda5050, orders.files())
        if as_json:
            print_json(values | {"hints": hints})
        else:
            _print(values, hints)


def _open(
    source: Path, settings: list[str] | None, *, is_run: bool
) -> tuple[RunFile | None, World, Floor]:
    """The run, if it is one, and the world with its floor."""
    if is_run:
        from logs.mcap_reader import read

        run = read(source)
        return run, run.world, run.floor
    from worlds.toml_file import open_world

    return None, *open_world(source, overrides=parse_overrides(settings))


def _plan_csv(run: RunFile) -> str:
    from twin.export import plan_csv
    from twin.track_names import TrackNames
    from worlds.radio_map import kept_vertices

    names = TrackNames.of(run.world, run.floor).kept(kept_vertices(run.radio_map))
    return plan_csv(run.problem, run.plan, names, run.floor.slot_s)


def _check_folder(folder: Path, *, overwrite: bool) -> None:
    """A folder that can take the orders, before anything is computed."""
    from twin.outputs import check_writable

    if folder.exists() and not folder.is_dir():
        raise TwinError(f"{folder}: is a file; --vda5050 names a folder")
    if folder.is_dir() and any(folder.iterdir()) and not overwrite:
        raise TwinError(
            f"{folder}: is not empty; choose another folder, or replace files with --overwrite"
        )
    check_writable(folder)


def _write_all(folder: Path, texts: dict[str, str]) -> None:
    from twin.outputs import staged

    with staged(folder) as stage:
        for name, text in texts.items():
            (stage / name).write_text(text, encoding="utf-8")


def _print(values: dict[str, object], hints: list[str]) -> None:
    from twin.cli_tables import Facts, number

    def of(key: str):  # type: ignore[no-untyped-def]
        return values[key]

    facts = Facts(f"{of('source')}: exported")
    if "lif" in values:
        lif = of("lif")
        counted = f"{number(lif['nodes'])} nodes, {number(lif['edges'])} edges"
        said = f"{counted}, {number(lif['stations'])} stations"
        facts.section([("LIF", said), ("file", lif["file"])])
    if "vda5050" in values:
        orders = of("vda5050")
        said = f"{number(orders['orders'])} orders, {number(orders['releases'])} releases"
        facts.section([("VDA 5050", said), ("folder", orders["folder"])])
    if "csv" in values:
        facts.section([("plan", f"{number(of('csv')['rows'])} rows"), ("file", of("csv")["file"])])
    if hints:
        facts.section([("hint", hint) for hint in hints])
    facts.print(stdout())
