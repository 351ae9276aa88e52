"""`twin radio`: which access point reaches where, where are the holes, and why."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
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
from twin.cli_survey import Compare, compare_survey
from twin.cli_tables import Facts, Json, number, per_cent, verdict
from twin.errors import TwinError
from twin.pipeline import names

if TYPE_CHECKING:
    from twin.plan_places import PlanPlaces
    from worlds.coverage import Patch, Requirement
    from worlds.floor import Floor
    from worlds.radio_map import RadioMap
    from worlds.world import World

BLOCKERS_NAMED = 5
HOLES_LISTED = 8
PAIRS_LISTED = 6


def radio(
    world: WorldFile,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="radio.png", help="Draw the map, .png or .svg."),
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option("--csv", metavar="radio.csv", help="Write it: a row per position and AP."),
    ] = None,
    require: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SHARE[@DB][xK]",
            help="Ask for a share of the positions, e.g. 95%, 90%@20 (20 dB or more), 99%@10x2 "
            "(by two APs); exit code 1 if it is missed. Can be given many times.",
        ),
    ] = None,
    plan: Annotated[
        Path | None,
        typer.Option(
            metavar="PLAN", help="Show where the robots of a plan.json or RUN.mcap change APs, too."
        ),
    ] = None,
    at: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="X Y", help="Explain one point instead: every link, term by term."),
    ] = None,
    compare: Compare = None,
    seed: Seed = None,
    settings: Set = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Cast the rays of a world: which AP reaches where, and where are the holes."""
    with guarded(debug):
        from twin.instance import Stopwatch, open_radio
        from twin.outputs import PICTURES, check_targets, staged, write_text

        require_world(world)
        if at is not None and (output or table or require or plan):
            raise TwinError("--at explains one point; leave -o, --csv, --require and --plan out")
        check_targets((output, PICTURES), (table, (".csv",)), overwrite=overwrite)
        requirements = parse_requirements(require)
        overrides = parse_overrides(settings)
        if compare is not None:
            if output or table or require or plan or at is not None:
                raise TwinError("--compare only compares; leave the other options out")
            compare_survey(world, compare, overrides, seed, as_json=as_json)
            return
        with Meter() as meter:
            watch = Stopwatch(meter.step)
            read, floor, radio_map = open_radio(world, overrides=overrides, seed=seed, watch=watch)
            if at is not None:
                from worlds.link_budget import explain_point

                report = explain_point(read, floor, at, radio_map)
            places = None
            if plan is not None:
                from twin.plan_places import plan_places

                places = plan_places(plan, read, floor, radio_map)
            if output is not None:
                with watch.phase("picture"):
                    from worlds.figures import save
                    from worlds.radio_figure import radio_figure

                    xy = places.handover_xy_m if places else None
                    source = places.source if places else ""
                    figure = radio_figure(read, floor, radio_map, handover_xy_m=xy, source=source)
                    with staged(output.parent) as stage:
                        save(figure, stage / output.name)
        if at is not None:
            from twin.cli_radio_point import point_values, print_point

            if as_json:
                print_json(point_values(floor, report))
            else:
                print_point(stdout(), read, floor, report)
            raise typer.Exit(DONE if report.covered else NO)
        if table is not None:
            from worlds.coverage import radio_csv

            write_text(table, radio_csv(floor, radio_map))
        files = [("picture", output), ("table", table)]
        if as_json:
            values = radio_values(read, floor, radio_map, requirements, places)
            print_json(
                values
                | {"file": str(output) if output else None, "csv": str(table) if table else None}
            )
        else:
            print_radio(stdout(), read, floor, radio_map, requirements, places, files)
        raise typer.Exit(DONE if all(r.met(radio_map) for r in requirements) else NO)


def parse_requirements(texts: Sequence[str] | None) -> list[Requirement]:
    """`95%@10x2` → 95 % of the positions with 10 dB or more from two APs.

    Raises:
        TwinError: with every text that is not of that form.
    """
    from worlds.coverage import Requirement

    found, wrong = [], []
    for text in texts or []:
        form = r"(\d+(?:\.\d+)?)\s*(%?)(?:@(-?\d+(?:\.\d+)?))?(?:x(\d+))?"
        match = re.fullmatch(form, text.strip())
        share = float(match[1]) / (100.0 if match[2] else 1.0) if match else 2.0
        aps = int(match[4] or 1) if match else 1
        if match is None or share > 1.0 or aps < 1:
            wrong.append(
                f"--require {text}: must be a share of the positions, and perhaps an SNR and a "
                "number of APs: 95%, 0.95@15 or 95%@15x2"
            )
        else:
            found.append(Requirement(share, float(match[3]) if match[3] else None, aps))
    if wrong:
        raise TwinError("\n".join(wrong))
    return found


def radio_values(
    world: World,
    floor: Floor,
    radio_map: RadioMap,
    requirements: Sequence[Requirement] = (),
    places: PlanPlaces | None = None,
) -> Json:
    """Coverage of the hall and of each AP, and every hole."""
    from worlds.coverage import patches, snr_percentiles

    counts = radio_map.coverage_count
    best = radio_map.best_ap
    return {
        "world": world.name,
        "threshold_db": radio_map.threshold_db,
        "edge_rule": radio_map.edge_rule,
        "positions": len(counts),
        "edges": len(floor.edge_uv),
        "covered": int((counts > 0).sum()),
        "covered_by": {str(k): int(n) for k, n in sorted(Counter(counts.tolist()).items())},
        "snr_percentiles_db": {
            "best": {str(p): v for p, v in snr_percentiles(radio_map, 1).items()},
            "second": {str(p): v for p, v in snr_percentiles(radio_map, 2).items()},
        },
        "requirements": [
            {
                "share": r.share,
                "snr_db": radio_map.threshold_db if r.snr_db is None else r.snr_db,
                "aps": r.aps,
                "reached": r.reached(radio_map),
                "met": r.met(radio_map),
            }
            for r in requirements
        ],
        "aps": [
            {
                "id": ap,
                "covers": int(radio_map.covered[:, a].sum()),
                "covers_alone": int((radio_map.covered[:, a] & (counts == 1)).sum()),
                "best_at": int((best == a).sum()),
                "line_of_sight": int(radio_map.los[:, a].sum()),
            }
            for a, ap in enumerate(radio_map.ap_ids)
        ],
        "edges_with_a_hole": int(radio_map.edge_holes.any(axis=1).sum()),
        "holes": [
            {
                "x_m": hole.x_m,
                "y_m": hole.y_m,
                "nearest_ap": hole.ap,
                "snr_db": hole.snr_db if hole.ap else None,
                "blocker": hole.blocker,
            }
            for hole in radio_map.holes(floor)
        ],
        "patches": [
            {
                "positions": len(patch.vertices),
                "x_m": patch.x_m,
                "y_m": patch.y_m,
                "best_db": patch.best_db if radio_map.ap_ids else None,
                "blockers": [{"name": name, "positions": n} for name, n in patch.blockers],
            }
            for patch in patches(floor, radio_map)
        ],
        "handovers": None if places is None else _handover_values(places),
    }


def _handover_values(places: PlanPlaces) -> Json:
    return {
        "source": places.source,
        "count": len(places.handovers),
        "places": [
            {"x_m": x, "y_m": y, "from": a, "to": b}
            for (x, y), (a, b) in zip(places.handover_xy_m.tolist(), places.handovers, strict=True)
        ],
    }


def print_radio(
    console: Console,
    world: World,
    floor: Floor,
    radio_map: RadioMap,
    requirements: Sequence[Requirement],
    places: PlanPlaces | None,
    files: Sequence[tuple[str, Path | None]],
) -> None:
    """Coverage in a table."""
    from worlds.coverage import patches, snr_percentiles

    counts, positions = radio_map.coverage_count, len(radio_map.snr_db)
    facts = Facts(f"{world.name}: radio map")
    facts.section(
        [
            ("covered", f"SNR of {radio_map.threshold_db:g} dB or more ({world.radio.model})"),
            ("positions", f"{positions} free, {per_cent(radio_map.covered_share())} covered"),
            *(
                (f"by {k} AP{'s' if k != 1 else ''}", f"{n} ({per_cent(n / positions)})")
                for k, n in sorted(Counter(counts.tolist()).items())
            ),
        ]
    )
    rows: list[tuple[str, str | Text]] = []
    for rank, name in ((1, "SNR, best"), (2, "SNR, second")):
        if shares := snr_percentiles(radio_map, rank):
            said = [f"{100 - p} % of the positions {value:.1f}" for p, value in shares.items()]
            rows.append((name, "at least " + ", ".join(said[:1] + said[3:4]) + " dB"))
    for wanted in requirements:
        limit = radio_map.threshold_db if wanted.snr_db is None else wanted.snr_db
        by = f" from {wanted.aps} APs" if wanted.aps > 1 else ""
        met = wanted.met(radio_map)
        share = per_cent(wanted.reached(radio_map), 2)
        text = f"{per_cent(wanted.share)} with {limit:g} dB{by}: {share}, "
        rows.append(("required", Text.assemble(text, verdict("met" if met else "MISSED", met))))
    facts.section(rows)
    covered, los, best = radio_map.covered, radio_map.los, radio_map.best_ap
    facts.section(
        (
            ap,
            f"covers {int(covered[:, a].sum())} ({per_cent(covered[:, a].mean())}), "
            f"{int((covered[:, a] & (counts == 1)).sum())} of them alone, best at "
            f"{int((best == a).sum())}, line of sight to {per_cent(los[:, a].mean())}",
        )
        for a, ap in enumerate(radio_map.ap_ids)
    )
    broken = int(radio_map.edge_holes.any(axis=1).sum())
    said_edges = (
        f"{number(len(floor.edge_uv))}, of which {number(broken)} hide a hole of an AP covering "
        "both ends"
    )
    hole_rows: list[tuple[str, str | Text]] = [("edges", said_edges)]
    if holes := radio_map.holes(floor):
        blockers = Counter(hole.blocker or "none: too far or faded" for hole in holes)
        named = [f"{name} ({n})" for name, n in blockers.most_common(BLOCKERS_NAMED)]
        hole_rows.append(("holes", f"{len(holes)} positions without coverage"))
        hole_rows.append(("in the way", names(named)))
    facts.section(hole_rows)
    found = patches(floor, radio_map)
    facts.section(_patch_rows(found, radio_map))
    if places is not None:
        facts.section(_handover_rows(places))
    facts.section([(name, str(path)) for name, path in files if path is not None])
    facts.print(console)


def _patch_rows(found: list[Patch], radio_map: RadioMap) -> list[tuple[str, str | Text]]:
    """The largest holes, each with its place and what is in the way."""
    rows: list[tuple[str, str | Text]] = []
    for patch in found[:HOLES_LISTED]:
        many = f"{len(patch.vertices)} position{'s' if len(patch.vertices) != 1 else ''}"
        best = f", at best {patch.best_db:.1f} dB" if radio_map.ap_ids else ""
        way = names([name or "nothing (too far or faded)" for name, _ in patch.blockers], 3)
        rows.append(
            ("hole", f"{many} at ({patch.x_m:.1f}, {patch.y_m:.1f}) m{best}; in the way: {way}")
        )
    if len(found) > HOLES_LISTED:
        rows.append(("", f"… and {len(found) - HOLES_LISTED} smaller ones, see --json or --csv"))
    return rows


def _handover_rows(places: PlanPlaces) -> list[tuple[str, str | Text]]:
    pairs = Counter(f"{a} → {b}" for a, b in places.handovers)
    said = [f"{pair} ({n})" for pair, n in sorted(pairs.items(), key=lambda p: (-p[1], p[0]))]
    return [
        ("handovers", f"{len(places.handovers)} in {places.source}"),
        *([("between", names(said, PAIRS_LISTED))] if said else []),
    ]
