"""`twin suggest`: where to hang access points, or which are not needed, with a proof."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.text import Text

from twin.cli_console import DONE, NO, Meter, guarded, print_json, stdout
from twin.cli_options import (
    AsJson,
    Debug,
    Overwrite,
    Seed,
    Set,
    WorldFile,
    parse_overrides,
    require_world,
)
from twin.cli_tables import GOOD, PLAIN, Facts, Json, per_cent
from twin.errors import TwinError
from twin.pipeline import names

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from worlds.floor import Floor
    from worlds.radio_map import RadioMap
    from worlds.suggest import Suggestion
    from worlds.world import AccessPoint, World


def suggest(
    world: WorldFile,
    add: Annotated[
        int | None, typer.Option(min=1, metavar="K", help="Hang at most K, to cover most.")
    ] = None,
    coverage: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=1.0,
            metavar="SHARE",
            help="Hang the fewest that cover it; 1.0 if left out.",
        ),
    ] = None,
    remove: Annotated[
        bool, typer.Option("--remove", help="Find those that are not needed instead.")
    ] = False,
    k: Annotated[
        int, typer.Option("--k", min=1, metavar="N", help="Access points that must reach a place.")
    ] = 1,
    redundant: Annotated[
        bool,
        typer.Option("--redundant", help="Count what remains after the loss of any one of them."),
    ] = False,
    ways: Annotated[
        bool,
        typer.Option("--ways", help="The samples of the ways between positions count, too."),
    ] = False,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="As if none hung there yet; -o leaves them out.")
    ] = False,
    grid: Annotated[
        float | None,
        typer.Option(min=0.1, metavar="M", help="Mounts M metres apart all over the hall."),
    ] = None,
    walls: Annotated[
        float | None,
        typer.Option(min=0.1, metavar="M", help="Mounts on the walls, M metres apart."),
    ] = None,
    mounts: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="Mounts from a file: x_m,y_m and perhaps height_m."),
    ] = None,
    height: Annotated[
        float | None,
        typer.Option(min=0.0, max=200.0, metavar="M", help="Of the mounts; else as most hang now."),
    ] = None,
    margin: Annotated[
        float, typer.Option(min=0.0, metavar="DB", help="Ask new ones for more than the threshold.")
    ] = 0.0,
    plan: Annotated[
        Path | None,
        typer.Option(
            metavar="PLAN",
            help="Count places by how long robots stand there in a plan.json or RUN.mcap.",
        ),
    ] = None,
    limit: Annotated[
        float, typer.Option(min=0.0, metavar="SECONDS", help="For the proof; then a gap is told.")
    ] = 60.0,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="new.toml", help="Write the world with the change."),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Draw before and after, .png or .svg."),
    ] = None,
    seed: Seed = None,
    settings: Set = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Say where further access points should hang, or which are not needed, and prove it."""
    with guarded(debug):
        from twin.instance import Stopwatch, open_radio
        from twin.outputs import PICTURES, check_targets, staged, write_text
        from worlds.placement import Ask

        require_world(world)
        _check_options(add, coverage, remove, redundant, fresh, (grid, walls, mounts))
        check_targets((output, (".toml",)), (picture, PICTURES), overwrite=overwrite)
        overrides = parse_overrides(settings)
        share = 1.0 if coverage is None else coverage
        ask = Ask(add=add, share=share, k=k, failure=redundant, seconds=limit)
        with Meter() as meter:
            watch = Stopwatch(meter.step)
            read, floor, radio_map = open_radio(world, overrides=overrides, seed=seed, watch=watch)
            weight = None if plan is None else _weights(plan, read, floor, radio_map, ways)
            if remove:
                from worlds.suggest import needless

                with watch.phase("proof"):
                    robots, wanted = len(floor.robot_ids), k + int(redundant)
                    found = needless(
                        read,
                        radio_map,
                        k=wanted,
                        robots=robots,
                        seconds=limit,
                        weight=weight,
                        ways=ways,
                    )
            else:
                from worlds.suggest import cast_mounts, held_places
                from worlds.suggest import suggest as choose

                base = read.model_copy(update={"ap": ()}) if fresh else read
                candidates = _candidates(base, read, floor, grid, walls, mounts, height)
                with watch.phase("rays of the mounts"):
                    covers = cast_mounts(
                        read,
                        floor,
                        candidates,
                        margin_db=margin,
                        ways=ways,
                        on_progress=watch.share("rays of the mounts"),
                    )
                with watch.phase("proof"):
                    held = held_places(radio_map, ways=ways)
                    found = choose(candidates, covers, held[:, :0] if fresh else held, ask, weight)
                read = base
            if picture is not None:
                with watch.phase("picture"), staged(picture.parent) as stage:
                    from worlds.figures import save
                    from worlds.suggest_figure import suggestion_figure

                    save(suggestion_figure(read, floor, found), stage / picture.name)
        if output is not None:
            plain = not overrides and seed is None
            write_text(output, _new_world(world if plain else None, read, found, output.parent))
        files = {"file": output, "picture": picture}
        if as_json:
            print_json(_values(read, found, files, watch.seconds))
        else:
            _print(stdout(), read, found, files, watch.seconds, len(floor.robot_ids))
        raise typer.Exit(DONE if found.placement.possible else NO)


def _check_options(
    add: int | None,
    coverage: float | None,
    remove: bool,
    redundant: bool,
    fresh: bool,
    sources: tuple[float | None, float | None, Path | None],
) -> None:
    """Refuse options that contradict each other, all at once."""
    wrong = []
    if sum((add is not None, coverage is not None, remove)) > 1:
        wrong.append("--add, --coverage and --remove are three questions; ask one at a time")
    if sum(source is not None for source in sources) > 1:
        wrong.append("--grid, --walls and --mounts each say where to hang them; give one")
    if remove and (fresh or any(source is not None for source in sources)):
        wrong.append("--remove looks at what hangs there; leave --fresh and the mounts out")
    if wrong:
        raise TwinError("\n".join(wrong))


def _candidates(
    base: World,
    read: World,
    floor: Floor,
    grid: float | None,
    walls: float | None,
    file: Path | None,
    height: float | None,
) -> tuple[AccessPoint, ...]:
    """Access points at the mounts the options name."""
    from worlds import mounts as of

    high = of.usual_height_m(read) if height is None else height
    if file is not None:
        return of.mounts(base, floor, of.read_mounts(file, high))
    if walls is not None:
        xy = of.walls_m(read, walls)
    else:
        xy = of.grid_m(read, of.grid_spacing_m(read) if grid is None else grid)
    return of.mounts(base, floor, [(x, y, high) for x, y in xy.tolist()])


def _weights(
    path: Path, world: World, floor: Floor, radio_map: RadioMap, ways: bool
) -> NDArray[np.int64]:
    """(n,) robot-slots of a plan or run at each place."""
    from twin.plan_places import plan_places
    from worlds.suggest import place_weights

    slots = plan_places(path, world, floor, radio_map).slots
    return place_weights(floor, radio_map, slots) if ways else slots


def _new_world(source: Path | None, world: World, found: Suggestion, folder: Path) -> str:
    """The changed world as it is to stand in a folder.

    The text it was read from with lines added, where that says the same there: other files are
    named relative to the folder.
    """
    from worlds.errors import WorldError
    from worlds.toml_file import dump_world, parse_world

    changed = found.world(world)
    if source is not None and not found.removed:
        text = source.read_text(encoding="utf-8-sig").rstrip("\n") + "\n\n" + toml_lines(found)
        try:
            if parse_world(text, folder=folder) == changed:
                return text
        except WorldError:  # the file lists its access points in a way that cannot be added to
            pass
    return dump_world(changed)


def toml_lines(found: Suggestion) -> str:
    """The new access points as they stand in a world file."""
    lines = []
    for ap in found.added:
        position = ", ".join(repr(value) for value in ap.position_m)
        lines += ["[[ap]]", f'id = "{ap.id}"', f"position_m = [{position}]", ""]
    return "\n".join(lines)


def _values(
    world: World,
    found: Suggestion,
    files: Mapping[str, Path | None],
    seconds: Mapping[str, float],
) -> Json:
    """The suggestion as plain values."""
    placement, ask = found.placement, found.ask
    return {
        "world": world.name,
        "ask": {
            "add": ask.add,
            "share": ask.share if ask.add is None else None,
            "k": ask.k,
            "redundant": ask.failure,
            "remove": found.remove,
        },
        "possible": placement.possible,
        "optimal": placement.optimal,
        "value": placement.value,
        "bound": placement.bound,
        "gap": placement.gap,
        "mounts": len(found.mounts),
        "places": len(found.before),
        "share_before": found.share(found.reached_before),
        "share_after": found.share(found.reached_after),
        "uncovered_before": int((found.before == 0).sum()),
        "uncovered_after": int((found.after == 0).sum()),
        "single_before": int((found.before == 1).sum()),
        "single_after": int((found.after == 1).sum()),
        "out_of_reach": int(found.out_of_reach.sum()),
        "added": [{"id": ap.id, "position_m": list(ap.position_m)} for ap in found.added],
        "removed": list(found.removed),
        "seconds": {phase: round(s, 3) for phase, s in seconds.items()},
        **{key: str(path) if path else None for key, path in files.items()},
    }


def _print(
    console: Console,
    world: World,
    found: Suggestion,
    files: Mapping[str, Path | None],
    seconds: Mapping[str, float],
    robots: int,
) -> None:
    """A table, the lines to paste, and a sentence."""
    facts = Facts(f"{world.name}: access points")
    facts.section(
        [
            ("asked", _asked(found)),
            ("mounts", f"{len(found.mounts)} compared, {len(found.before)} places"),
        ]
    )
    rows = []
    for name, count, reached in (
        ("now", found.before, found.reached_before),
        ("then", found.after, found.reached_after),
    ):
        shares = [f"{per_cent(float((count >= k).mean()))} by {k} or more" for k in (1, 2, 3)]
        text = f"{names(shares)}; as asked {per_cent(found.share(reached))}"
        rows.append((name, text))
    facts.section(rows)
    facts.section([("proof", proof(found)), ("seconds", _seconds(seconds))])
    facts.section([(key, str(path)) for key, path in files.items() if path is not None])
    facts.print(console)
    if found.added and files["file"] is None:
        console.print(Text(toml_lines(found)), soft_wrap=True)
    if world.radio.shadow_fading and found.added:
        hint = (
            "hint: shadow fading is drawn per access point, so mounts with lucky draws win; "
            "--margin, or --set radio.shadow_fading=false, plans without luck"
        )
        console.print(Text(hint, style="dim"), soft_wrap=True)
    if short := _short_of_capacity(world, found, robots):
        console.print(Text(short, style="dim"), soft_wrap=True)
    style = GOOD if found.placement.possible else "bold red"
    console.print(Text(sentence(found), style=style or PLAIN), soft_wrap=True)


def _short_of_capacity(world: World, found: Suggestion, robots: int) -> str:
    """A hint if the access points, then, cannot serve the fleet at once; else empty."""
    default = world.radio.ap_capacity
    on = [ap for ap in found.world(world).ap if ap.enabled]
    total = sum(default if ap.capacity is None else ap.capacity for ap in on)
    if total >= robots or not found.placement.possible:
        return ""
    return (
        f"hint: these {len(on)} access points serve {total} robots at once, the fleet has "
        f"{robots}; coverage alone is what was asked"
    )


def _asked(found: Suggestion) -> str:
    ask = found.ask
    by = f" by {ask.k} access points" if ask.k > 1 else ""
    after = " after the loss of any one access point" if ask.failure else ""
    if found.remove:
        return f"which are needed so that each position keeps what covers it{by}"
    if ask.add is not None:
        return f"the greatest coverage{by}{after} with {ask.add} more"
    return f"{per_cent(ask.share)} covered{by}{after} with the fewest"


def _seconds(seconds: Mapping[str, float]) -> str:
    parts = [f"{phase} {s:.1f}" for phase, s in seconds.items()]
    return f"{', '.join(parts)}; in all {sum(seconds.values()):.1f}"


def proof(found: Suggestion) -> str:
    """What is proven, in a sentence."""
    placement, ask = found.placement, found.ask
    total = int(found.weight.sum())
    if not placement.possible:
        return "even an access point at every mount is not enough"
    if ask.add is not None:
        if placement.optimal:
            return f"optimal: no choice of {ask.add} of these mounts covers more"
        most = per_cent(placement.bound / max(1, total))
        return f"within {per_cent(placement.gap)}: no choice covers more than {most}"
    if placement.optimal:
        return "optimal: no fewer of these will do"
    return f"gap {per_cent(placement.gap)}: at least {placement.bound} are needed"


def sentence(found: Suggestion) -> str:
    """The outcome in one line."""
    placement, ask = found.placement, found.ask
    if not placement.possible:
        far = int(found.out_of_reach.sum())
        return (
            f"no: {far} of {len(found.before)} places are out of reach of these mounts "
            "(obstacles, distance); give other mounts, a lower height, or less coverage"
        )
    if found.removed:
        return f"not needed: {names(found.removed)}; {proof(found)}"
    if not found.added:
        return f"nothing to change; {proof(found)}"
    more = f"{len(found.added)} more access point{'s' if len(found.added) != 1 else ''}"
    was, now = (per_cent(found.share(r)) for r in (found.reached_before, found.reached_after))
    what = "covered" + (f" by {ask.k}" if ask.k > 1 else "")
    what += " after any single loss" if ask.failure else ""
    return f"{more}: {was} → {now} {what}; {proof(found)}"
