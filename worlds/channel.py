"""From distance to path loss, SNR and data rate.

Path loss and shadow fading are those of 3GPP TR 38.901 v16.1.0, table 7.4.1-1, for indoor office
(InH) and indoor factory (InF): sparse or dense clutter (S, D), AP below or above it (L, H). In
every formula d is the distance between the antennas in space [m] and f the carrier [GHz]:

    PL = offset + per_lg_d · lg d + per_lg_f · lg f    [dB]

and a link without line of sight loses the greatest of several such values. Whether there is line of
sight is decided by a ray (`worlds.scene`), never drawn; the report's LOS probability is not used.

Distances under `MIN_DISTANCE_M` count as that, since the table starts there. Beyond the table's far
end (150 m InH, 600 m InF) the same lines go on.

Oxygen absorbs α(f) · d, with α of table 7.6.1-1. Shadow fading that hangs together falls to 1/e at
the correlation distances of tables 7.5-6 Part 2 and Part 3 (InH, InF).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worlds.errors import Fault, WorldError

if TYPE_CHECKING:
    from worlds.world import Radio

Array = NDArray[np.float64]

MIN_DISTANCE_M = 1.0
"""Where the models of table 7.4.1-1 begin [m]."""


@dataclass(frozen=True)
class Line:
    """One path-loss line: PL = offset_db + per_lg_d · lg d + per_lg_f · lg f."""

    offset_db: float
    per_lg_d: float
    per_lg_f: float

    def loss_db(self, distance_m: Array, frequency_ghz: float) -> Array:
        """PL at each distance [dB]."""
        at_one_metre = self.offset_db + self.per_lg_f * np.log10(frequency_ghz)
        return np.asarray(at_one_metre + self.per_lg_d * np.log10(distance_m))

    def reach_m(self, loss_db: float, frequency_ghz: float) -> float:
        """The distance at which PL is `loss_db` [m]."""
        at_one_metre = self.offset_db + self.per_lg_f * np.log10(frequency_ghz)
        return float(10.0 ** ((loss_db - at_one_metre) / self.per_lg_d))


@dataclass(frozen=True)
class Model:
    """One column of table 7.4.1-1.

    Attributes:
        los: the line for line of sight.
        nlos: lines whose maximum (with `los`) holds without it.
        sigma_los_db, sigma_nlos_db: standard deviations of shadow fading.
        range_m: distances the table is made for.
        correlation_los_m, correlation_nlos_m: where shadow fading has fallen to 1/e (table 7.5-6).
    """

    los: Line
    nlos: tuple[Line, ...]
    sigma_los_db: float
    sigma_nlos_db: float
    range_m: tuple[float, float]
    correlation_los_m: float = 10.0
    correlation_nlos_m: float = 10.0


_INH_LOS = Line(32.4, 17.3, 20.0)
_INF_LOS = Line(31.84, 21.5, 19.0)
_INF_SL = Line(33.0, 25.5, 20.0)

MODELS: dict[str, Model] = {
    "inh-office": Model(_INH_LOS, (Line(17.30, 38.3, 24.9),), 3.0, 8.03, (1.0, 150.0), 10.0, 6.0),
    "inh-office-optional": Model(
        _INH_LOS, (Line(32.4, 31.9, 20.0),), 3.0, 8.29, (1.0, 150.0), 10.0, 6.0
    ),
    "inf-sl": Model(_INF_LOS, (_INF_SL,), 4.3, 5.7, (1.0, 600.0)),
    "inf-dl": Model(_INF_LOS, (_INF_SL, Line(18.6, 35.7, 20.0)), 4.3, 7.2, (1.0, 600.0)),
    "inf-sh": Model(_INF_LOS, (Line(32.4, 23.0, 20.0),), 4.3, 5.9, (1.0, 600.0)),
    "inf-dh": Model(_INF_LOS, (Line(33.63, 21.9, 20.0),), 4.3, 4.0, (1.0, 600.0)),
}
"""Table 7.4.1-1; the keys are the values of `radio.model` in a world."""

OXYGEN_DB_PER_KM: dict[float, float] = {
    52.0: 0.0,
    53.0: 1.0,
    54.0: 2.2,
    55.0: 4.0,
    56.0: 6.6,
    57.0: 9.7,
    58.0: 12.6,
    59.0: 14.6,
    60.0: 15.0,
    61.0: 14.6,
    62.0: 14.3,
    63.0: 10.5,
    64.0: 6.8,
    65.0: 3.9,
    66.0: 1.9,
    67.0: 1.0,
    68.0: 0.0,
}
"""Table 7.6.1-1: α [dB/km] by frequency [GHz]; linear in between, 0 outside."""


def channel_model(name: str) -> Model:
    """The model of that name; WorldError when the table has none."""
    try:
        return MODELS[name]
    except KeyError:
        known = ", ".join(MODELS)
        message = f"{name!r} is not a channel model; choose one of {known}"
        raise WorldError([Fault(("radio", "model"), message)]) from None


def path_loss_db(model: str, distance_m: ArrayLike, los: ArrayLike, frequency_ghz: float) -> Array:
    """Path loss of each link [dB], without shadow fading.

    Args:
        model: a key of `MODELS`.
        distance_m: between the antennas, in space; clipped to at least `MIN_DISTANCE_M`.
        los: bool, line of sight; broadcast against `distance_m`.
        frequency_ghz: carrier.
    """
    table = channel_model(model)
    distance = np.maximum(np.asarray(distance_m, dtype=np.float64), MIN_DISTANCE_M)
    loss = table.los.loss_db(distance, frequency_ghz)
    blocked = loss
    for line in table.nlos:
        blocked = np.maximum(blocked, line.loss_db(distance, frequency_ghz))
    return np.where(np.asarray(los, dtype=np.bool_), loss, blocked)


def reach_m(model: str, loss_db: float, los: bool, frequency_ghz: float) -> float:
    """The farthest distance at which the path loss is at most `loss_db` [m].

    0 when even at `MIN_DISTANCE_M` more is lost.
    """
    table = channel_model(model)
    lines = (table.los,) if los else (table.los, *table.nlos)
    reach = min(line.reach_m(loss_db, frequency_ghz) for line in lines)
    return reach if reach >= MIN_DISTANCE_M else 0.0


def oxygen_db(distance_m: ArrayLike, frequency_ghz: float) -> Array:
    """Absorption by oxygen of each link [dB] (7.6.1): α(f) times the distance [m]."""
    per_km = np.interp(
        frequency_ghz, list(OXYGEN_DB_PER_KM), list(OXYGEN_DB_PER_KM.values()), left=0.0, right=0.0
    )
    return np.asarray(per_km * np.asarray(distance_m, dtype=np.float64) / 1000.0)


def correlation_m(model: str) -> tuple[float, float]:
    """Distances at which the model's shadow fading has fallen to 1/e: with sight, without [m]."""
    table = channel_model(model)
    return table.correlation_los_m, table.correlation_nlos_m


def sigma_db(model: str, los: ArrayLike) -> Array:
    """Standard deviation of shadow fading of each link [dB]; `los` as in `path_loss_db`."""
    table = channel_model(model)
    return np.where(np.asarray(los, dtype=np.bool_), table.sigma_los_db, table.sigma_nlos_db)


def snr_db(
    path_loss_db: ArrayLike,
    *,
    tx_power_dbm: ArrayLike,
    ap_gain_db: ArrayLike,
    robot_gain_db: float,
    noise_dbm: float,
    fading_db: ArrayLike = 0.0,
) -> Array:
    """SNR = P_tx + G_ap + G_robot − PL − N + fading of each link [dB].

    `fading_db` is a gain: positive is better than the path loss says. (The report adds its shadow
    fading to the loss; it is symmetric about 0, so the sign is ours to choose.)
    """
    gains_db = np.asarray(ap_gain_db, dtype=np.float64) + robot_gain_db
    received_dbm = np.asarray(tx_power_dbm, dtype=np.float64) + gains_db - np.asarray(path_loss_db)
    return np.asarray(received_dbm - noise_dbm + np.asarray(fading_db))


def data_rate_mbps(snr_db: ArrayLike, radio: Radio, served: ArrayLike = 1) -> Array:
    """Data rate of each link [Mbit/s]: Shannon's bound times what is reached of it, capped.

    min(bandwidth · log2(1 + SNR) · efficiency, cap), with `bandwidth_mhz`, `efficiency` and
    `rate_cap_mbps` of the world's radio. With `rate_sharing = "equal"` a link has this rate for one
    n-th of the time, n = `served` being the number of robots its AP serves (≥ 1).
    """
    # log2(1 + 10^(x/10)) without overflow at absurd x.
    bits_per_hz = np.logaddexp2(0.0, np.asarray(snr_db, dtype=np.float64) * (np.log2(10.0) / 10.0))
    rate = radio.bandwidth_mhz * bits_per_hz * radio.efficiency
    alone = np.minimum(rate, radio.rate_cap_mbps)
    return np.asarray(alone / served if radio.rate_sharing == "equal" else alone)
