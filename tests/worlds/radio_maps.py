"""The paper's hall, maps made of a few numbers, and what makes two maps the same."""

from __future__ import annotations

import numpy as np

from tests.worlds.floors import ap, boxes, grid_floor
from worlds.floor import Floor
from worlds.radio_map import RadioMap
from worlds.radio_map_file import DTYPES

FOUR = (ap("ap0", 15, 15), ap("ap1", 45, 15), ap("ap2", 15, 45), ap("ap3", 45, 45))
PITCH_M = 60 / 19


def paper_floor(seed: int, share: float = 0.3, side_m: float = 1.0) -> Floor:
    """20 x 20 positions over 60 m x 60 m, a share of them blocked by boxes 2 m high."""
    cells = np.random.default_rng(seed).permutation(400)[: round(share * 400)]
    blocked = np.column_stack(np.divmod(cells, 20))
    center = np.column_stack((blocked * PITCH_M, np.ones(len(blocked))))
    standing = boxes(center, (side_m / 2, side_m / 2, 1.0))
    gone = [(int(c), int(r)) for c, r in blocked]
    return grid_floor(20, 20, PITCH_M, standing=standing, blocked=gone)


def assert_same(one: RadioMap, other: RadioMap) -> None:
    """All fields equal to the last bit."""
    assert (one.ap_ids, one.threshold_db, one.edge_rule) == (
        other.ap_ids,
        other.threshold_db,
        other.edge_rule,
    )
    for name in DTYPES:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def tiny(
    edge_snr_db: list[list[list[float]]],
    rule: str = "samples",
    vertex_snr_db: list[list[float]] | None = None,
) -> tuple[RadioMap, Floor]:
    """A map of a line of vertices from the SNR at the samples of its edges; threshold 10 dB."""
    edges = np.array(edge_snr_db, dtype=float)
    count, _, aps = edges.shape
    snr = np.vstack((edges[:, 0], edges[-1:, -1]))
    if vertex_snr_db is not None:
        snr = np.array(vertex_snr_db, dtype=float)
    radio_map = RadioMap(
        tuple(f"ap{a}" for a in range(aps)),
        10.0,
        rule,
        snr,
        np.ones(snr.shape, dtype=bool),
        np.full(snr.shape, -1),
        edges,
        np.zeros(snr.shape),
    )
    return radio_map, grid_floor(count + 1, 1)
