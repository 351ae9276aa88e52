"""What `twin radio` answers."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from twin.cli_tables import Facts, Json, names, number, per_cent

if TYPE_CHECKING:
    from worlds.floor import Floor
    from worlds.radio_map import RadioMap
    from worlds.world import World

BLOCKERS_NAMED = 5


def radio_values(world: World, floor: Floor, radio_map: RadioMap) -> Json:
    """Coverage of the hall and of each AP, and every hole."""
    counts = radio_map.coverage_count
    return {
        "world": world.name,
        "threshold_db": radio_map.threshold_db,
        "edge_rule": radio_map.edge_rule,
        "positions": len(counts),
        "edges": len(floor.edge_uv),
        "covered": int((counts > 0).sum()),
        "covered_by": {str(k): int(n) for k, n in sorted(Counter(counts.tolist()).items())},
        "aps": [
            {
                "id": ap,
                "covers": int(radio_map.covered[:, a].sum()),
                "covers_alone": int((radio_map.covered[:, a] & (counts == 1)).sum()),
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
    }


def print_radio(
    console: Console, world: World, floor: Floor, radio_map: RadioMap, picture: Path | None
) -> None:
    """Coverage in a table."""
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
    covered, los = radio_map.covered, radio_map.los
    facts.section(
        (
            ap,
            f"covers {int(covered[:, a].sum())} ({per_cent(covered[:, a].mean())}), "
            f"{int((covered[:, a] & (counts == 1)).sum())} of them alone, "
            f"line of sight to {per_cent(los[:, a].mean())}",
        )
        for a, ap in enumerate(radio_map.ap_ids)
    )
    broken = int(radio_map.edge_holes.any(axis=1).sum())
    edges = len(floor.edge_uv)
    rows = [
        (
            "edges",
            f"{number(edges)}, of which {number(broken)} hide a hole of an AP covering both ends",
        )
    ]
    holes = radio_map.holes(floor)
    if holes:
        blockers = Counter(hole.blocker or "none: too far or faded" for hole in holes)
        said = [f"{name} ({n})" for name, n in blockers.most_common(BLOCKERS_NAMED)]
        rows.append(("holes", f"{len(holes)} positions without coverage"))
        rows.append(("in the way", names(said)))
    facts.section(rows)
    if picture is not None:
        facts.section([("picture", str(picture))])
    facts.print(console)
