"""Path loss, SNR and data rate against TR 38.901 and the numbers of the paper."""

from __future__ import annotations

import math

import numpy as np
import pytest

from worlds import channel
from worlds.errors import WorldError
from worlds.world import Radio

GHZ = 60.0
MODELS = tuple(channel.MODELS)


def loss(model: str, distance_m: float, los: bool, ghz: float = GHZ) -> float:
    """Path loss of one link [dB]."""
    return float(channel.path_loss_db(model, distance_m, los, ghz))


@pytest.mark.parametrize(
    ("model", "los", "metres"),
    [
        ("inh-office", True, 269.0),
        ("inh-office", False, 18.4),
        ("inf-sl", False, 42.2),
        ("inf-dl", False, 36.7),
        ("inf-sh", False, 67.2),
        ("inf-dh", False, 73.0),
    ],
)
def test_covered_distance_with_the_papers_numbers(model: str, los: bool, metres: float) -> None:
    """With 24 dBm, 15 + 1 dB, −80 dBm and 10 dB covered means PL ≤ 110 dB: up to these metres."""
    reach = channel.reach_m(model, 110.0, los, GHZ)
    assert reach == pytest.approx(metres, abs=0.5 if metres > 100 else 0.06)
    for distance, covered in ((reach * 0.999, True), (reach * 1.001, False)):
        snr = channel.snr_db(
            channel.path_loss_db(model, distance, los, GHZ),
            tx_power_dbm=24.0,
            ap_gain_db=15.0,
            robot_gain_db=1.0,
            noise_dbm=-80.0,
        )
        assert (snr >= 10.0) == covered


@pytest.mark.parametrize(
    ("model", "los", "distance_m", "ghz", "expected_db"),
    [
        # 32.4 + 17.3 lg 10 + 20 lg 28
        ("inh-office", True, 10.0, 28.0, 78.643),
        # 38.3 lg 50 + 17.3 + 24.9 lg 28
        ("inh-office", False, 50.0, 28.0, 118.404),
        # 32.4 + 20 lg 28 + 31.9 lg 50
        ("inh-office-optional", False, 50.0, 28.0, 115.540),
        # 31.84 + 21.5 lg 100 + 19 lg 3.5
        ("inf-sl", True, 100.0, 3.5, 85.177),
        # 33 + 25.5 lg 100 + 20 lg 3.5
        ("inf-sl", False, 100.0, 3.5, 94.881),
        # 18.6 + 35.7 lg 100 + 20 lg 3.5
        ("inf-dl", False, 100.0, 3.5, 100.881),
        # the SL line is the greater one here: 33 + 25.5 lg 5 + 20 lg 3.5
        ("inf-dl", False, 5.0, 3.5, 61.705),
        # 32.4 + 23 lg 100 + 20 lg 3.5
        ("inf-sh", False, 100.0, 3.5, 89.281),
        # 33.63 + 21.9 lg 100 + 20 lg 3.5
        ("inf-dh", False, 100.0, 3.5, 88.311),
    ],
)
def test_path_loss_worked_out_by_hand(
    model: str, los: bool, distance_m: float, ghz: float, expected_db: float
) -> None:
    """Each line of table 7.4.1-1 at one distance and frequency, computed with a calculator."""
    assert loss(model, distance_m, los, ghz) == pytest.approx(expected_db, abs=0.001)


@pytest.mark.parametrize("model", MODELS)
def test_no_sight_never_loses_less_than_sight(model: str) -> None:
    """NLOS is a maximum with LOS in every model; both grow with the distance."""
    distance = np.geomspace(1.0, 600.0, 400)
    los = channel.path_loss_db(model, distance, True, GHZ)
    nlos = channel.path_loss_db(model, distance, False, GHZ)
    assert (nlos >= los).all()
    assert (np.diff(los) > 0).all()
    assert (np.diff(nlos) > 0).all()


@pytest.mark.parametrize("model", MODELS)
def test_under_one_metre_counts_as_one_metre(model: str) -> None:
    """The models begin at 1 m; nothing nearer, not even 0, gains more."""
    assert loss(model, 0.0, True) == loss(model, 0.3, True) == loss(model, 1.0, True)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("los", [True, False])
def test_reach_is_where_the_loss_is_met(model: str, los: bool) -> None:
    """`reach_m` inverts `path_loss_db`; it is 0 when even 1 m loses too much."""
    for metres in (1.5, 20.0, 180.0):
        assert channel.reach_m(model, loss(model, metres, los), los, GHZ) == pytest.approx(metres)
    assert channel.reach_m(model, 10.0, los, GHZ) == 0.0


def test_links_are_computed_together_as_alone() -> None:
    """Arrays of distances and sights give what each link gives by itself."""
    distance = np.array([0.5, 3.0, 30.0, 300.0])
    los = np.array([True, False, True, False])
    together = channel.path_loss_db("inf-dl", distance, los, GHZ)
    alone = [loss("inf-dl", d, bool(s)) for d, s in zip(distance, los, strict=True)]
    np.testing.assert_array_equal(together, alone)


@pytest.mark.parametrize(
    ("model", "los_db", "nlos_db"),
    [
        ("inh-office", 3.0, 8.03),
        ("inh-office-optional", 3.0, 8.29),
        ("inf-sl", 4.3, 5.7),
        ("inf-dl", 4.3, 7.2),
        ("inf-sh", 4.3, 5.9),
        ("inf-dh", 4.3, 4.0),
    ],
)
def test_shadow_fading_is_as_wide_as_the_table_says(
    model: str, los_db: float, nlos_db: float
) -> None:
    """Sigma of table 7.4.1-1 for each link's own state."""
    np.testing.assert_array_equal(channel.sigma_db(model, [True, False]), [los_db, nlos_db])


def test_snr_is_the_sum_of_its_parts() -> None:
    """SNR = P_tx + G_ap + G_robot − PL − N + fading, per link."""
    snr = channel.snr_db(
        [100.0, 90.0],
        tx_power_dbm=[24.0, 10.0],
        ap_gain_db=15.0,
        robot_gain_db=1.0,
        noise_dbm=-80.0,
        fading_db=[0.0, -3.0],
    )
    np.testing.assert_allclose(snr, [20.0, 13.0])


def test_data_rate_is_shannons_share_with_a_cap() -> None:
    """Rate = bandwidth · log2(1 + SNR) · efficiency [Mbit/s], at most the cap; finite always."""
    radio = Radio(bandwidth_mhz=400.0, efficiency=0.6, rate_cap_mbps=2000.0)
    rate = channel.data_rate_mbps([-1000.0, 0.0, 10.0, 60.0, 1e5], radio)
    expected = [0.0, 240.0, 240.0 * math.log2(11.0), 2000.0, 2000.0]
    np.testing.assert_allclose(rate, expected, atol=1e-9)


def test_an_unknown_model_is_named_with_the_known_ones() -> None:
    """A name the table lacks is an error of the world, not a KeyError."""
    with pytest.raises(WorldError, match=r"'umi' is not a channel model; choose one of inh-office"):
        channel.path_loss_db("umi", 10.0, True, GHZ)
