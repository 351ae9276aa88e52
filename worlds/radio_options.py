"""The radio of a world: access points, the channel, measurements in its place."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Discriminator, Field, Tag

from worlds.part import Part
from worlds.scalars import Decibels, Load, Metres3, Name, Seed

ChannelModel = Literal["inh-office", "inh-office-optional", "inf-sl", "inf-dl", "inf-sh", "inf-dh"]


class Antenna(Part):
    """The element pattern of 3GPP TR 38.901, table 7.3-1, for an AP that points somewhere.

    An AP without it radiates `gain_db` in every direction; with it, `gain_db` is reached along the
    boresight only (the table's element has 8 dB).
    """

    azimuth_deg: float = Field(description="where it points, counter-clockwise from the x axis")
    tilt_deg: float = Field(
        default=0.0, ge=-90, le=90, description="how far it points down from the horizontal"
    )
    beamwidth_deg: float = Field(
        default=65.0, gt=0, le=360, description="between the directions of half power, both ways"
    )
    front_to_back_db: float = Field(
        default=30.0, ge=0, le=100, description="no direction loses more than this"
    )


class AccessPoint(Part):
    """An access point; what is left out comes from `[radio]`."""

    id: Name = Field(description="its name; shadow fading is drawn from it")
    position_m: Metres3 = Field(description="x, y and height above the floor")
    tx_power_dbm: Decibels | None = Field(
        default=None, description="`radio.tx_power_dbm` when left out"
    )
    gain_db: Decibels | None = Field(default=None, description="`radio.ap_gain_db` when left out")
    capacity: Load | None = Field(default=None, description="robots it can serve at once (m)")
    offset_db: Decibels | None = Field(
        default=None, description="calibration, `radio.offset_db` when left out"
    )
    model: ChannelModel | None = Field(default=None, description="`radio.model` when left out")
    enabled: bool = Field(default=True, description="false: as if it were not there")
    antenna: Antenna | None = Field(
        default=None, description="where it points; all directions alike when left out"
    )


def _correlation_form(value: object) -> str | None:
    if isinstance(value, str):
        return "word"
    return "number" if isinstance(value, int | float) and not isinstance(value, bool) else None


Correlation = Annotated[
    Annotated[Literal["none", "table"], Tag("word")]
    | Annotated[float, Field(gt=0, le=1000), Tag("number")],
    Discriminator(
        _correlation_form,
        custom_error_type="form",
        custom_error_message='must be "none", "table" or a number of metres',
    ),
]


class Measured(Part):
    """Measurements that take the place of the channel model where there are enough of them.

    A table with columns x, y, ap and snr_db or rssi_dbm. A position takes the median, or the 10th
    percentile, of those within `radius_m`; along edges the difference to the model runs linearly.
    `measured = "survey.csv"` is short for a table with only its `file`.
    """

    exactly_one: ClassVar[tuple[str, ...]] = ("file", "csv")

    file: str | None = Field(
        default=None, min_length=1, description="the table, relative to this file"
    )
    csv: str | None = Field(
        default=None, description="the table itself, as logs carry it", repr=False
    )
    source: str | None = Field(default=None, description="the file that `csv` was read from")
    statistic: Literal["median", "p10"] = Field(
        default="median", description="of the measurements near a position"
    )
    radius_m: Annotated[float, Field(gt=0, le=1000)] | None = Field(
        default=None, description="how near they must be; half a pitch when left out"
    )
    min_samples: int = Field(default=3, ge=1, le=1_000_000, description="how many there must be")
    gaps: Literal["model", "uncovered", "error"] = Field(
        default="model",
        description="positions with fewer: the channel model, no signal, or an error",
    )

    @classmethod
    def accept(cls, data: object) -> object:
        """A plain string is a file."""
        return {"file": data} if isinstance(data, str) else data


class Radio(Part):
    """The radio of the hall; defaults are the paper's numbers."""

    frequency_ghz: float = Field(default=60.0, ge=0.5, le=100.0, description="carrier")
    model: ChannelModel = Field(
        default="inh-office",
        description="path loss of 3GPP TR 38.901: indoor hotspot, or a factory hall with sparse or "
        "dense clutter, APs below it or above it (sl, dl, sh, dh)",
    )
    tx_power_dbm: Decibels = Field(default=24.0, description="of the APs")
    ap_gain_db: Decibels = Field(default=15.0, description="antenna gain of the APs")
    robot_gain_db: Decibels = Field(default=1.0, description="antenna gain of the robots")
    noise_dbm: Decibels = Field(default=-80.0, description="at the receiver, noise figure included")
    threshold_db: Decibels = Field(
        default=10.0, description="SNR at which a place counts as covered"
    )
    ap_capacity: Load = Field(default=15, description="robots an AP serves at once (m)")
    samples_per_edge: int = Field(default=5, ge=2, le=101, description="both ends included")
    edge_rule: Literal["samples", "endpoints"] = Field(
        default="samples",
        description="where an edge must be covered: at each sample, or at its ends (the paper)",
    )
    clearance_m: float = Field(
        default=0.0, ge=0, description="obstacles are this much larger for rays"
    )
    shadow_fading: bool = Field(default=False, description="log-normal, drawn per AP and position")
    fading_seed: Seed = Field(default=0, description="another seed, another field")
    fading_correlation: Correlation = Field(
        default="none",
        description="how far shadow fading hangs together: not at all, as TR 38.901's tables say "
        "(InH 10 m with and 6 m without line of sight, InF 10 m), or metres (to 1/e)",
    )
    oxygen: bool = Field(
        default=False, description="absorption by oxygen (TR 38.901, 7.6.1): 15 dB/km at 60 GHz"
    )
    blockage: Literal["nlos", "knife-edge"] = Field(
        default="nlos",
        description="what an obstacle in the way does: the model's path loss without line of "
        "sight, or that with it plus diffraction around each box (TR 38.901, 7.6.4.2)",
    )
    low_antenna_los_db: Annotated[float, Field(ge=0, le=100)] = Field(
        default=0.0,
        description="further loss of antennas near the floor, with line of sight (10.7 dB measured "
        "at 142 GHz and 0.5 m, arXiv 2302.12142)",
    )
    low_antenna_nlos_db: Annotated[float, Field(ge=0, le=100)] = Field(
        default=0.0, description="the same without line of sight (6.0 dB measured)"
    )
    offset_db: Decibels = Field(
        default=0.0,
        description="calibration, added to every SNR; `twin radio --compare` fits it",
    )
    measured: Measured | None = None
    bandwidth_mhz: float = Field(default=400.0, gt=0, le=100_000, description="for the data rate")
    efficiency: float = Field(
        default=0.6, gt=0, le=1, description="share of Shannon's rate reached"
    )
    rate_cap_mbps: float = Field(default=2000.0, gt=0, le=1e9, description="no link is faster")
    rate_sharing: Literal["none", "equal"] = Field(
        default="none",
        description="how an AP's airtime is shared: `none`, each robot has all of it (a beam of "
        "its own); `equal`, each of the n robots it serves at an instant has one n-th",
    )
