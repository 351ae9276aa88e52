"""What `twin radio --at X Y` answers: every link to one point, term by term."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from twin.cli_tables import Json, verdict

if TYPE_CHECKING:
    from worlds.floor import Floor
    from worlds.link_budget import LinkBudget, PointReport
    from worlds.world import World


def point_values(floor: Floor, report: PointReport) -> Json:
    """A point's links as plain values."""
    links: list[Json] = []
    for link in report.links:
        values = asdict(link) | {"path_loss_db": link.path_loss_db}
        values["knife_edges"] = [{"name": n, "loss_db": db} for n, db in link.knife_edges]
        links.append(values)
    return {
        "x_m": report.x_m,
        "y_m": report.y_m,
        "z_m": report.z_m,
        "nearest_position": _vertex_values(floor, report),
        "threshold_db": report.threshold_db,
        "covered": report.covered,
        "best_ap": report.links[0].ap if report.links else None,
        "links": links,
    }


def _vertex_values(floor: Floor, report: PointReport) -> Json | None:
    if report.vertex < 0:
        return None
    x, y = floor.vertex_xy_m[report.vertex].tolist()
    return {"x_m": x, "y_m": y, "away_m": report.vertex_away_m}


def print_point(console: Console, world: World, floor: Floor, report: PointReport) -> None:
    """A column per access point, a row per term, gains with +, losses with −."""
    title = f"{world.name}: ({report.x_m:g}, {report.y_m:g}) m, antenna at {report.z_m:g} m"
    table = Table(title=Text(title, style="bold"), title_justify="left", border_style="dim")
    table.add_column("", style="cyan", no_wrap=True)
    for link in report.links:
        table.add_column(Text(link.ap), justify="right", overflow="fold")
    for name, cells in _terms(report.links, _fading_name(world)):
        table.add_row(
            Text(name), *[cell if isinstance(cell, Text) else Text(cell) for cell in cells]
        )
    console.print(table)
    if any(link.fading_db for link in report.links) and report.vertex_away_m > 1e-6:
        x, y = floor.vertex_xy_m[report.vertex].tolist()
        said = f"{_fading_name(world)} is that of the nearest position, ({x:g}, {y:g}) m"
        console.print(Text(said, style="dim"))
    if not report.links:
        console.print(verdict("not covered: no access point is on", False))
        return
    best = report.links[0]
    limit = f"the threshold is {report.threshold_db:g} dB"
    if report.covered:
        others = sum(link.covered for link in report.links) - 1
        more = f", and {others} more" if others else ", and by no other"
        said = f"covered by {best.ap} with {best.snr_db:.1f} dB{more}; {limit}"
    else:
        way = f", behind {best.blocker}" if best.blocker else ", in line of sight"
        said = f"not covered: the best is {best.ap} with {best.snr_db:.1f} dB{way}; {limit}"
    console.print(verdict(said, report.covered), soft_wrap=True)


def _fading_name(world: World) -> str:
    """What a radio map's `fading_db` is made of: drawn, measured minus model, or both."""
    if world.radio.measured is None:
        return "shadow fading"
    return "fading and survey" if world.radio.shadow_fading else "survey − model"


def _terms(links: Sequence[LinkBudget], fading: str) -> list[tuple[str, list[str | Text]]]:
    """Rows of the table; those of what no link has are left out."""

    def row(name: str, cells: list[str | Text]) -> tuple[str, list[str | Text]]:
        return name, cells

    def amounts(name: str, field: str, sign: float = 1.0) -> tuple[str, list[str | Text]]:
        values = [sign * getattr(link, field) for link in links]
        return row(name, [f"{value:+.2f}" if value else "0" for value in values])

    rows = [
        row("model", [f"{link.model} {link.line}" for link in links]),
        row("distance [m]", [f"{link.distance_m:.2f}" for link in links]),
        row(
            "in the way",
            [link.blocker or Text("line of sight", style="green") for link in links],
        ),
        amounts("power [dBm]", "tx_power_dbm"),
        amounts("AP gain [dB]", "ap_gain_db"),
        amounts("robot gain [dB]", "robot_gain_db"),
        amounts("loss: constant [dB]", "offset_db", -1.0),
        amounts("loss: distance [dB]", "distance_db", -1.0),
        amounts("loss: frequency [dB]", "frequency_db", -1.0),
    ]
    optional = (
        ("antenna pattern [dB]", "pattern_db", 1.0),
        ("oxygen [dB]", "oxygen_db", -1.0),
        ("low antenna [dB]", "low_antenna_db", -1.0),
        ("knife edges [dB]", "blockage_db", -1.0),
        (f"{fading} [dB]", "fading_db", 1.0),
    )
    for name, field, sign in optional:
        if any(getattr(link, field) for link in links):
            rows.append(amounts(name, field, sign))
    rows.append(amounts("minus noise [dBm]", "noise_dbm", -1.0))
    rows.append(
        row(
            "= SNR [dB]",
            [verdict(f"{link.snr_db:.2f}", link.covered) for link in links],
        )
    )
    rows.append(row("covered", [verdict("yes" if k.covered else "no", k.covered) for k in links]))
    for place in range(max((len(link.knife_edges) for link in links), default=0)):
        cells: list[str | Text] = [
            "{} −{:.1f}".format(*link.knife_edges[place]) if place < len(link.knife_edges) else ""
            for link in links
        ]
        rows.append(row("box costs [dB]" if place == 0 else "", cells))
    return rows
