"""Requirements, holes, distributions and single points, worked out by hand on tiny worlds."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from tests.worlds.floors import ap, boxes, grid_floor, world
from tests.worlds.radio_maps import FOUR, paper_floor, tiny
from worlds.coverage import Requirement, patches, radio_csv, snr_percentiles
from worlds.errors import WorldError
from worlds.link_budget import explain_point
from worlds.radio_map import build_radio_map
from worlds.world import Antenna

# Five vertices in a line, three access points, threshold 10 dB.
SNR = [[20.0, 9.0, 1.0], [15.0, 10.0, 1.0], [8.0, 7.0, 9.9], [5.0, 6.0, 4.0], [12.0, 30.0, 11.0]]
MAP, FLOOR = tiny([[[0.0] * 3, [0.0] * 3]] * 4, vertex_snr_db=SNR)


@pytest.mark.parametrize(
    ("requirement", "reached", "met"),
    [
        (Requirement(0.6), 0.6, True),
        (Requirement(0.61), 0.6, False),
        (Requirement(0.4, None, 2), 0.4, True),
        (Requirement(0.2, None, 3), 0.2, True),
        (Requirement(0.6, 15.0), 0.6, True),
        (Requirement(0.5, 20.0), 0.4, False),
        (Requirement(1.0, 4.0, 3), 0.6, False),
        (Requirement(0.0, None, 4), 0.0, True),
    ],
)
def test_requirements_by_hand(requirement: Requirement, reached: float, met: bool) -> None:
    """Share of the positions with so much SNR from so many APs; equality suffices."""
    assert requirement.reached(MAP) == pytest.approx(reached)
    assert requirement.met(MAP) == met


def test_coverage_counts_by_hand() -> None:
    """k-coverage, best and second best of the line above."""
    np.testing.assert_array_equal(MAP.coverage_count, [1, 2, 0, 0, 3])
    np.testing.assert_array_equal(MAP.best_ap, [0, 0, 2, 1, 1])
    np.testing.assert_array_equal(MAP.ranked_snr_db(2), [9.0, 10.0, 8.0, 5.0, 12.0])
    assert snr_percentiles(MAP)[50] == 15.0
    assert snr_percentiles(MAP, 2)[50] == 9.0
    assert snr_percentiles(MAP, 4) == {}


def test_neighbouring_holes_are_one() -> None:
    """Vertices 2 and 3 make one hole with the SNR of the better one; others are not in it."""
    (patch,) = patches(FLOOR, MAP)
    assert patch.vertices == (2, 3)
    assert patch.best_db == 9.9
    assert (patch.x_m, patch.y_m) == (2.0, 0.0)
    assert patch.blockers == (("", 2),)


def test_holes_name_the_wall_that_causes_them() -> None:
    """Two rooms in the shadow of two walls: two holes, the larger first, each with its wall."""
    walls = boxes([(3.0, 1.0, 2.0), (11.0, 1.0, 2.0)], (0.2, 3.0, 2.0))
    gone = [(c, r) for c in (3, 11) for r in range(3)]
    floor = grid_floor(14, 3, standing=walls, blocked=gone)
    hall = world([ap("a", 7.0, 1.0, 3.0)], (14, 3), tx_power_dbm=0.0, threshold_db=8.0)
    found = build_radio_map(hall, floor)
    np.testing.assert_array_equal(found.covered[:, 0], found.los[:, 0])
    left, right = patches(floor, found)
    assert (len(left.vertices), left.blockers) == (9, (("b0", 9),))
    assert (len(right.vertices), right.blockers) == (6, (("b1", 6),))


def test_the_table_says_what_the_map_says() -> None:
    """A row per vertex and AP, best first; a survey's columns lead; names are quoted if need be."""
    floor = paper_floor(3)
    named = [ap('a, "b"', 15, 15), *FOUR[1:]]
    found = build_radio_map(world(named), floor)
    rows = list(csv.DictReader(radio_csv(floor, found).splitlines()))
    assert len(rows) == found.snr_db.size
    assert list(rows[0])[:4] == ["x", "y", "ap", "snr_db"]
    names = list(found.ap_ids)
    for k, row in enumerate(rows):
        vertex, a = k // 4, names.index(row["ap"])
        assert float(row["snr_db"]) == pytest.approx(found.snr_db[vertex, a], abs=1e-6)
        assert (row["covered"] == "1") == found.covered[vertex, a]
        assert (row["line_of_sight"] == "1") == found.los[vertex, a] == (row["blocker"] == "")
        assert int(row["rank"]) == k % 4 + 1
    first = [float(row["snr_db"]) for row in rows if row["rank"] == "1"]
    np.testing.assert_allclose(first, found.ranked_snr_db(1), atol=1e-6)


# One point


def test_a_point_by_hand() -> None:
    """InH at 60 GHz, AP 3 m above a robot 4 m off: each term, the sum, and who blocks the other."""
    wall = boxes([(10.0, 0.0, 2.0)], (0.5, 5.0, 2.0))
    floor = grid_floor(5, 1, standing=wall)
    hall = world([ap("far", 16.0, 0.0, 0.5), ap("near", 0.0, 0.0, 3.5)], (20, 5))
    report = explain_point(hall, floor, (4.0, 0.0))
    near, far = report.links
    assert (near.ap, near.line, near.blocker, near.line_of_sight) == ("near", "LOS", "", True)
    assert near.distance_m == pytest.approx(5.0)
    assert near.offset_db == 32.4
    assert near.distance_db == pytest.approx(17.3 * 0.69897, abs=1e-4)
    assert near.frequency_db == pytest.approx(35.563, abs=1e-3)
    assert near.snr_db == pytest.approx(24 + 15 + 1 + 80 - (32.4 + 12.092 + 35.563), abs=1e-3)
    assert (far.ap, far.line, far.blocker) == ("far", "NLOS", "b0")
    assert far.distance_m == pytest.approx(12.0)
    assert far.path_loss_db == pytest.approx(17.3 + 38.3 * 1.07918 + 24.9 * 1.77815, abs=1e-3)
    assert far.snr_db == pytest.approx(120 - 102.909, abs=1e-3)
    assert report.covered
    assert (report.vertex, report.vertex_away_m) == (4, 0.0)


def test_every_term_adds_up_with_every_switch_on() -> None:
    """SNR = gains − losses − noise, equal to the radio map's at a vertex, whatever is on."""
    floor = paper_floor(4)
    turned = (
        FOUR[0].model_copy(update={"antenna": Antenna(azimuth_deg=45.0, tilt_deg=10.0)}),
        *FOUR[1:],
    )
    for physics in (
        {},
        {"shadow_fading": True, "fading_correlation": "table", "model": "inf-dl"},
        {"oxygen": True, "low_antenna_los_db": 10.7, "low_antenna_nlos_db": 6.0},
        {"blockage": "knife-edge", "shadow_fading": True, "oxygen": True},
    ):
        hall = world(turned, **physics)  # type: ignore[arg-type]
        found = build_radio_map(hall, floor)
        for vertex in (0, 77, 201):
            report = explain_point(hall, floor, floor.vertex_xy_m[vertex], found)
            snr = [link.snr_db for link in report.links]
            np.testing.assert_allclose(snr, sorted(found.snr_db[vertex])[::-1], atol=1e-9)
            for link in report.links:
                losses = link.path_loss_db + link.oxygen_db + link.low_antenna_db + link.blockage_db
                gains = link.tx_power_dbm + link.ap_gain_db + link.pattern_db + link.robot_gain_db
                total = gains - losses + link.fading_db - link.noise_dbm
                assert total == pytest.approx(link.snr_db, abs=1e-9)
                assert sum(db for _, db in link.knife_edges) == pytest.approx(
                    link.blockage_db, abs=0.05 * 40
                )
                a = found.ap_ids.index(link.ap)
                assert link.line_of_sight == found.los[vertex, a]
                assert link.covered == found.covered[vertex, a]


def test_points_nobody_can_stand_at_are_refused() -> None:
    """Outside the hall, and inside an obstacle, with its name."""
    floor = grid_floor(3, 3, standing=boxes([(1.0, 1.0, 1.0)]))
    hall = world([ap("a", 0, 0)], (3, 3))
    with pytest.raises(WorldError, match=r"\(4, 1\) is outside the hall of 3 m x 3 m"):
        explain_point(hall, floor, (4.0, 1.0))
    with pytest.raises(WorldError, match="inside 'b0'"):
        explain_point(hall, floor, (1.0, 1.2))
