"""What a network planner asks of a radio map: requirements, holes taken together, distributions."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worlds.errands import components
from worlds.floor import Floor
from worlds.radio_map import RadioMap

Array = NDArray[np.float64]

PERCENTILES = (5, 10, 25, 50, 75, 90)


@dataclass(frozen=True)
class Requirement:
    """So large a share of the positions has so much SNR from so many access points.

    Attributes:
        share: 0 … 1.
        snr_db: the map's threshold when None.
        aps: access points that must reach it.
    """

    share: float
    snr_db: float | None = None
    aps: int = 1

    def reached(self, radio_map: RadioMap) -> float:
        """The share of the positions that has it."""
        return radio_map.covered_share(self.aps, self.snr_db)

    def met(self, radio_map: RadioMap) -> bool:
        """Whether enough have it; 1e-12 for the rounding of shares."""
        return self.reached(radio_map) >= self.share - 1e-12


@dataclass(frozen=True)
class Patch:
    """A hole: neighbouring vertices that no AP covers.

    Attributes:
        vertices: their indices, ascending.
        x_m, y_m: the one nearest to their middle [m].
        best_db: the highest SNR in it [dB].
        blockers: what is in the way of the AP that comes closest, most often first; "" for nothing
            (too far, or faded).
    """

    vertices: tuple[int, ...]
    x_m: float
    y_m: float
    best_db: float
    blockers: tuple[tuple[str, int], ...]


def patches(floor: Floor, radio_map: RadioMap) -> list[Patch]:
    """The holes of the map, the largest first."""
    uncovered = radio_map.coverage_count == 0
    if not uncovered.any():
        return []
    every = np.ones(len(floor.edge_uv), dtype=np.bool_)
    part = components(floor, uncovered, every)
    holes = {hole.vertex: hole for hole in radio_map.holes(floor)}
    found = []
    for number in np.unique(part[uncovered]).tolist():
        vertices = np.flatnonzero(uncovered & (part == number))
        xy = floor.vertex_xy_m[vertices]
        middle = int(np.linalg.norm(xy - xy.mean(axis=0), axis=1).argmin())
        inside = [holes[v] for v in vertices.tolist()]
        blockers = Counter(hole.blocker for hole in inside)
        found.append(
            Patch(
                vertices=tuple(vertices.tolist()),
                x_m=float(xy[middle, 0]),
                y_m=float(xy[middle, 1]),
                best_db=max(hole.snr_db for hole in inside),
                blockers=tuple(sorted(blockers.items(), key=lambda item: (-item[1], item[0]))),
            )
        )
    return sorted(found, key=lambda patch: (-len(patch.vertices), patch.vertices))


def snr_percentiles(radio_map: RadioMap, rank: int = 1) -> dict[int, float]:
    """SNR that so many per cent of the positions fall short of [dB], by per cent.

    Args:
        radio_map: the map.
        rank: 1 for the best AP of each position, 2 for the second best, …; empty where there are
            fewer APs.
    """
    if not len(radio_map.snr_db) or not 1 <= rank <= len(radio_map.ap_ids):
        return {}
    values = np.percentile(radio_map.ranked_snr_db(rank), PERCENTILES)
    return dict(zip(PERCENTILES, values.tolist(), strict=True))


def radio_csv(floor: Floor, radio_map: RadioMap) -> str:
    """The map as CSV: a row per vertex and AP, the best AP of a vertex first.

    The columns x, y, ap and snr_db are those of a survey; the others say why.
    """
    lines = ["x,y,ap,snr_db,rank,covered,line_of_sight,blocker"]
    order = np.argsort(-radio_map.snr_db, axis=1, kind="stable")
    covered = radio_map.covered
    for vertex, (x, y) in enumerate(floor.vertex_xy_m.tolist()):
        for rank, ap in enumerate(order[vertex].tolist()):
            box = int(radio_map.blocker[vertex, ap])
            name = floor.boxes.name[box] if box >= 0 else ""
            values = (
                f"{x:.10g}",
                f"{y:.10g}",
                _quoted(radio_map.ap_ids[ap]),
                f"{radio_map.snr_db[vertex, ap]:.6f}",
                str(rank + 1),
                str(int(covered[vertex, ap])),
                str(int(radio_map.los[vertex, ap])),
                _quoted(name),
            )
            lines.append(",".join(values))
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    """A CSV field, in quotes where it needs them."""
    return '"' + text.replace('"', '""') + '"' if set(text) & set(',"\n\r') else text
