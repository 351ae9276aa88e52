"""`twin radio --compare`: measurements against the model, and what to add to it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin.cli_console import Meter, print_json, stdout
from twin.instance import Stopwatch, open_radio

if TYPE_CHECKING:
    from worlds.survey import Comparison
    from worlds.world import World

Compare = Annotated[
    Path | None,
    typer.Option(
        metavar="SURVEY.csv",
        help="Hold measurements (x,y,ap,snr_db or rssi_dbm) against the model instead: errors per "
        "AP, and the offsets that mend them.",
    ),
]


def compare_survey(
    path: Path,
    source: Path,
    overrides: dict[str, object],
    seed: int | None,
    *,
    as_json: bool,
) -> None:
    """Print how far the model of a world is from measurements.

    Places are compared as the world's `[radio.measured]` has it, if there is one; else the median
    of all measurements within half a pitch of a position counts, however few.
    """
    from worlds.formats.survey_csv import read_survey
    from worlds.survey import compare
    from worlds.toml_file import read_world
    from worlds.world import Measured

    with Meter() as meter:
        watch = Stopwatch(meter.step)
        how = read_world(path, overrides=overrides).radio.measured
        how = how or Measured(csv="", min_samples=1)
        world, floor, radio_map = open_radio(
            path, overrides={**overrides, "radio.measured": None}, seed=seed, watch=watch
        )
        survey = read_survey(
            source, [ap.id for ap in world.ap], world.radio.noise_dbm, world.hall.size_m
        )
        rows = compare(survey, floor, radio_map, how)
    offsets = offsets_db(world, rows)
    if as_json:
        print_json(
            {
                "world": world.name,
                "survey": str(source),
                "measurements": len(survey),
                "positions": len(floor.vertex_xy_m),
                "all": _values(rows[0]),
                "aps": [_values(row) for row in rows[1:]],
                "offsets_db": offsets,
            }
        )
    else:
        _print(world, source, len(survey), rows, offsets)


def offsets_db(world: World, rows: tuple[Comparison, ...]) -> dict[str, float]:
    """What `offset_db` would have to be: under "" that of `[radio]`, else that of the AP."""
    own = {ap.id: ap.offset_db for ap in world.ap}
    now = world.radio.offset_db
    fitted = {"": now + rows[0].mean_db}
    for row in rows[1:]:
        before = own[row.ap]
        fitted[row.ap] = (now if before is None else before) + row.mean_db
    return {name: round(value, 2) for name, value in fitted.items()}


def _values(row: Comparison) -> dict[str, object]:
    return {
        "ap": row.ap,
        "positions": row.places,
        "measurements": row.samples,
        "mean_db": row.mean_db,
        "mae_db": row.mae_db,
        "std_db": row.std_db,
        "mae_after_offset_db": row.rest_mae_db,
    }


def _print(
    world: World,
    source: Path,
    measurements: int,
    rows: tuple[Comparison, ...],
    offsets: dict[str, float],
) -> None:
    from twin.cli_tables import Facts, number

    facts = Facts(f"{world.name}: measured against the model ({world.radio.model})")
    facts.section(
        [
            ("survey", f"{source}: {number(measurements)} measurements"),
            ("error", "measured minus model, in dB, at links (position, AP) with measurements"),
        ]
    )
    facts.section(
        (
            row.ap or "all",
            f"mean {row.mean_db:+.1f}, absolute {row.mae_db:.1f}, deviation {row.std_db:.1f}; "
            f"{number(row.places)} links, {number(row.samples)} measurements; "
            f"{row.rest_mae_db:.1f} absolute once the mean is added",
        )
        for row in rows
    )
    facts.print(stdout())
    console = stdout()
    console.print("To add the mean to the model, for all access points alike:", soft_wrap=True)
    console.print(f"\n[radio]\noffset_db = {offsets['']}\n", markup=False, highlight=False)
    if len(rows) > 2:
        console.print("or for each one:", soft_wrap=True)
        for row in rows[1:]:
            lines = f'\n[[ap]]\nid = "{row.ap}"\noffset_db = {offsets[row.ap]}'
            console.print(lines, markup=False, highlight=False)
