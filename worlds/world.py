"""`World`: everything a run depends on, as frozen models with SI units in their names.

The models hold what a person wrote. What follows from it (free positions, drawn obstacles and
robots, stations resolved to vertices) is computed by `worlds.generate` and `worlds.floor`.

Numbers are strict: "60" is no number, 60.0 no count, true no 1. The upper limits of lengths are
far above any hall; they are there to catch millimetres.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Discriminator, Field, Tag

from worlds.errors import Fault
from worlds.part import Part, given, listed, nearest

MAX_POSITIONS = 1_000_000

Length = Annotated[float, Field(gt=0, le=5000)]
Height = Annotated[float, Field(ge=0, le=200)]
Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]
Metres2 = tuple[Coordinate, Coordinate]
Metres3 = tuple[Coordinate, Coordinate, Height]
Decibels = Annotated[float, Field(ge=-1000, le=1000)]
Count = Annotated[int, Field(ge=1, le=MAX_POSITIONS)]
Load = Annotated[int, Field(ge=0, le=1_000_000)]
Cost = Annotated[int, Field(ge=0, le=1_000_000_000)]
Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[^\x00-\x1f\x7f]+$")]
Seed = Annotated[int, Field(ge=0, lt=2**63)]


class Body(Part):
    """The box every robot is, standing on the floor [m]."""

    length_m: float = Field(default=0.8, gt=0, le=20, description="along its heading")
    width_m: float = Field(default=0.6, gt=0, le=20, description="across")
    height_m: float = Field(default=0.4, gt=0, le=20, description="from the floor")
    antenna_m: float = Field(
        default=0.5, gt=0, le=20, description="height of the antenna, on the robot's centre"
    )


class Hall(Part):
    """The floor: a rectangle from (0, 0) to `size_m`, covered by a square grid of positions.

    Give either `pitch_m` or `positions` (columns, rows). The first position lies `margin_m` from
    the walls (half a pitch when left out). A slot lasts `slot_s`, or pitch / `speed_m_s`.
    """

    exactly_one: ClassVar[tuple[str, ...]] = ("pitch_m", "positions")
    at_most_one: ClassVar[tuple[str, ...]] = ("slot_s", "speed_m_s")

    size_m: tuple[Length, Length] = Field(description="width and depth of the floor")
    pitch_m: float | None = Field(
        default=None, ge=0.01, le=100, description="distance of neighbouring positions"
    )
    positions: tuple[Count, Count] | None = Field(
        default=None, description="columns and rows, instead of `pitch_m`"
    )
    margin_m: float | None = Field(
        default=None,
        ge=0,
        le=2500,
        description="from the walls to the first position; half a pitch when left out",
    )
    slot_s: float | None = Field(
        default=None, ge=0.001, le=3600, description="length of a slot; pitch / speed when left out"
    )
    speed_m_s: float | None = Field(default=None, ge=0.01, le=50, description="1 m/s when left out")
    body: Body = Body()

    def spacing_m(self) -> tuple[float | None, float | None]:
        """Distance of the columns and of the rows [m]; None where there is only one."""
        if self.positions is None:
            return self.pitch_m, self.pitch_m
        if self.margin_m is None:  # half a pitch at both ends
            return self.size_m[0] / self.positions[0], self.size_m[1] / self.positions[1]
        between = [
            (size - 2 * self.margin_m) / (count - 1) if count > 1 else None
            for size, count in zip(self.size_m, self.positions, strict=True)
        ]
        return between[0], between[1]

    @property
    def grid_pitch_m(self) -> float:
        """The pitch of the grid of positions [m], given or from `positions`."""
        x, y = self.spacing_m()
        return x or y or math.nan  # `faults` refuses a hall without either

    @property
    def grid_margin_m(self) -> float:
        """Distance of the first position from the walls [m]."""
        return self.grid_pitch_m / 2 if self.margin_m is None else self.margin_m

    @property
    def grid_positions(self) -> tuple[int, int]:
        """Columns and rows of the grid."""
        if self.positions is not None:
            return self.positions
        pitch, margin = self.grid_pitch_m, self.grid_margin_m
        # 1e-9: a hall of 60 m with a pitch of 0.1 m has all its 600 columns despite rounding.
        columns, rows = (math.floor((s - 2 * margin) / pitch + 1e-9) + 1 for s in self.size_m)
        return columns, rows

    @property
    def grid_slot_s(self) -> float:
        """Length of a slot [s]: given, or pitch / speed (1 m/s when left out)."""
        return self.slot_s if self.slot_s is not None else self.grid_pitch_m / (self.speed_m_s or 1)

    def faults(self) -> list[Fault]:
        """The grid must be square, not empty, and fit memory."""
        if self.positions is not None:
            spacing = self.spacing_m()
            if spacing == (None, None):
                rule = "is a single position, which says nothing about the pitch; give pitch_m"
                return [Fault(("positions",), f"{list(self.positions)} {rule}")]
            known = [d for d in spacing if d is not None]
            if min(known) <= 0:
                return [self._margin_too_wide()]
            if not math.isclose(known[0], known[-1], rel_tol=1e-6):
                rule = f"puts columns {known[0]:.6g} m and rows {known[-1]:.6g} m apart"
                mend = "the grid is square: match the ratio of size_m, or give pitch_m instead"
                return [Fault(("positions",), f"{list(self.positions)} {rule}; {mend}")]
        columns, rows = self.grid_positions
        if min(columns, rows) < 1:
            if self.margin_m is not None:
                return [self._margin_too_wide()]
            rule = f"is larger than the hall ({self.size_m[0]:g} m x {self.size_m[1]:g} m)"
            return [Fault(("pitch_m",), f"{self.pitch_m} {rule}; give a smaller pitch")]
        if columns * rows > MAX_POSITIONS:
            rule = f"makes {columns} x {rows} positions, more than {MAX_POSITIONS}"
            mend = "give a larger pitch, and check that all lengths are metres"
            at = "positions" if self.positions is not None else "pitch_m"
            return [Fault((at,), f"{given(self, at)} {rule}; {mend}")]
        return []

    def _margin_too_wide(self) -> Fault:
        rule = f"leaves no floor in a hall of {self.size_m[0]:g} m x {self.size_m[1]:g} m"
        return Fault(("margin_m",), f"{self.margin_m} {rule}; give a smaller margin")


class Obstacle(Part):
    """A box on the floor, its footprint turned by `yaw_deg` about its centre."""

    name: Name | None = Field(
        default=None, description="in messages and pictures; `obstacle[3]` when left out"
    )
    center_m: Metres2 = Field(description="x and y of its centre")
    size_m: tuple[Length, Length] = Field(description="in x and y, before the turn")
    height_m: float = Field(default=2.0, gt=0, le=200, description="from its underside to its top")
    base_m: float = Field(
        default=0.0, ge=0, le=200, description="height of its underside above the floor"
    )
    yaw_deg: float = Field(default=0.0, description="turn about its centre, counter-clockwise")


class RandomObstacles(Part):
    """Boxes of `side_m` on a random `share` of the positions."""

    share: float = Field(ge=0, lt=1, description="of the positions that carry a box")
    side_m: float = Field(default=1.0, gt=0, le=100, description="of each box, in x and y")
    height_m: float = Field(default=2.0, gt=0, le=200, description="of each box")
    seed: Seed = Field(default=0, description="another seed, other positions")


class Obstacles(Part):
    """Obstacles that are drawn rather than listed."""

    random: RandomObstacles


ChannelModel = Literal["inh-office", "inh-office-optional", "inf-sl", "inf-dl", "inf-sh", "inf-dh"]


class AccessPoint(Part):
    """An access point; what is left out comes from `[radio]`."""

    id: Name = Field(description="its name; shadow fading is drawn from it")
    position_m: Metres3 = Field(description="x, y and height above the floor")
    tx_power_dbm: Decibels | None = Field(
        default=None, description="`radio.tx_power_dbm` when left out"
    )
    gain_db: Decibels | None = Field(default=None, description="`radio.ap_gain_db` when left out")
    capacity: Load | None = Field(default=None, description="robots it can serve at once (m)")
    model: ChannelModel | None = Field(default=None, description="`radio.model` when left out")
    enabled: bool = Field(default=True, description="false: as if it were not there")


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
    bandwidth_mhz: float = Field(default=400.0, gt=0, le=100_000, description="for the data rate")
    efficiency: float = Field(
        default=0.6, gt=0, le=1, description="share of Shannon's rate reached"
    )
    rate_cap_mbps: float = Field(default=2000.0, gt=0, le=1e9, description="no link is faster")


class Place(Part):
    """A place on the floor: the name of a station, a grid cell (column, row), or metres."""

    exactly_one: ClassVar[tuple[str, ...]] = ("station", "cell", "at_m")

    station: Name | None = Field(
        default=None, description="a `[[station]]`; short form: only its name"
    )
    cell: tuple[int, int] | None = Field(default=None, description="column and row, from 0")
    at_m: Metres2 | None = Field(default=None, description="x and y; the nearest position is taken")

    @classmethod
    def accept(cls, data: object) -> object:
        """A plain string is a station's name."""
        return {"station": data} if isinstance(data, str) else data


class Station(Part):
    """A named place; exactly one of `cell` and `at_m`."""

    exactly_one: ClassVar[tuple[str, ...]] = ("cell", "at_m")

    name: Name = Field(description="for robots to refer to")
    cell: tuple[int, int] | None = Field(default=None, description="column and row, from 0")
    at_m: Metres2 | None = Field(default=None, description="x and y; the nearest position is taken")


class Robot(Part):
    """A robot and its errand. In TOML, a plain string for a place is a station's name."""

    id: Name = Field(description="its name in plans and logs")
    start: Place
    goal: Place


class RandomRobots(Part):
    """Robots with random errands within the largest connected component."""

    count: int = Field(ge=1, le=100_000, description="how many")
    seed: Seed = Field(default=0, description="another seed, other errands")


class Robots(Part):
    """Robots that are drawn rather than listed."""

    random: RandomRobots


class Costs(Part):
    """Integer costs of one slot and of one handover (1-semantics §1.10)."""

    c_t: Cost = Field(description="of a slot on the way")
    c_h: Cost = Field(description="of a handover")


def _objective_form(value: object) -> str | None:
    if isinstance(value, str):
        return "word"
    return "costs" if isinstance(value, Mapping | Costs) else None


Objective = Annotated[
    Annotated[Literal["hp", "tp", "snr"], Tag("word")] | Annotated[Costs, Tag("costs")],
    Discriminator(
        _objective_form,
        custom_error_type="form",
        custom_error_message='must be "hp", "tp", "snr" or {c_t = 1, c_h = 60}',
    ),
]


class PlanOptions(Part):
    """What the planner is asked (1-semantics §1.4, §1.10)."""

    horizon: int = Field(
        default=60, ge=1, le=100_000, description="slots within which all must have arrived (T)"
    )
    objective: Objective = Field(
        default="hp",
        description="`hp`: fewest handovers first; `tp`: shortest time first; `snr`: the best AP "
        "everywhere; or both costs: `{c_t = 1, c_h = 60}`",
    )
    at_goal: Literal["leave", "park"] = Field(
        default="leave", description="who has arrived leaves the floor, or stays"
    )
    seed: Seed = Field(default=0, description="of the planner's random choices")


def _interruption_form(value: object) -> str | None:
    if isinstance(value, str):
        return "word"
    return "number" if isinstance(value, int | float) and not isinstance(value, bool) else None


InterruptionPreset = Literal["l1l2-mobility", "l3-handover", "sector-sweep", "exhaustive-alignment"]
Interruption = Annotated[
    Annotated[InterruptionPreset, Tag("word")]
    | Annotated[float, Field(ge=0, le=60_000), Tag("number")],
    Discriminator(
        _interruption_form,
        custom_error_type="form",
        custom_error_message="must be the name of a preset or a number of milliseconds",
    ),
]

INTERRUPTION_MS: dict[str, float] = {
    "l1l2-mobility": 25.0,
    "l3-handover": 70.0,
    "sector-sweep": 100.0,
    "exhaustive-alignment": 1000.0,
}
"""Handover interruption presets [ms]: 5G L1/L2-triggered mobility (20–30), well-tuned 5G L3
handover (50–90, Ericsson Technology Review), 802.11ad sector sweep plus the wait for its slot
(beacon interval 0–100), exhaustive beam alignment."""


class RunOptions(Part):
    """How the twin executes the plan."""

    interruption: Interruption = Field(
        default="l3-handover",
        description="time without data in a handover: a preset, or milliseconds",
    )
    samples_per_slot: int = Field(
        default=5, ge=1, le=100, description="how often poses and links are sampled"
    )
    seed: Seed = Field(default=0, description="of what the run draws")

    @property
    def interruption_s(self) -> float:
        """Seconds without data during a handover (a number in the file is milliseconds)."""
        chosen = self.interruption
        return (INTERRUPTION_MS[chosen] if isinstance(chosen, str) else chosen) / 1000.0


class World(Part):
    """A hall with all that is in it and all that is asked of it."""

    format: Literal["mapp-world/1"] = Field(
        default="mapp-world/1", description="version of this format"
    )
    name: Name = Field(description="shown in tables, pictures and logs")
    story: str = Field(default="", description="a paragraph for the reader; no program uses it")
    hall: Hall
    obstacle: tuple[Obstacle, ...] = ()
    obstacles: Obstacles | None = None
    ap: tuple[AccessPoint, ...]
    radio: Radio = Radio()
    station: tuple[Station, ...] = ()
    robot: tuple[Robot, ...] = ()
    robots: Robots | None = None
    plan: PlanOptions = PlanOptions()
    run: RunOptions = RunOptions()

    @classmethod
    def faults_given(cls, data: Mapping[str, object]) -> list[Fault]:
        """Doubled ids, unknown stations, robots both listed and drawn."""
        faults = super().faults_given(data)
        for section, key in (("ap", "id"), ("robot", "id"), ("station", "name")):
            first: dict[object, int] = {}
            for i, element in enumerate(listed(data, section)):
                name = given(element, key)
                if isinstance(name, str) and first.setdefault(name, i) != i:
                    rule = f"'{name}' is the {key} of {section}[{first[name]}] already"
                    faults.append(Fault((section, i, key), f"{rule}; give each its own"))
        names = [given(s, "name") for s in listed(data, "station")]
        known = [name for name in names if isinstance(name, str)]
        for i, robot in enumerate(listed(data, "robot")):
            for end in ("start", "goal"):
                place = given(robot, end)
                name = place if isinstance(place, str) else given(place, "station")
                if isinstance(name, str) and name not in known:
                    mend = nearest(name, known) or (
                        f" known are {', '.join(known[:8])}" if known else " add a [[station]]"
                    )
                    rule = f"'{name}' is not the name of a station;"
                    faults.append(Fault(("robot", i, end), rule + mend))
        if listed(data, "robot") and given(data, "robots") is not None:
            rule = "is given beside the listed robots ([[robot]]); keep one of the two"
            faults.append(Fault(("robots",), rule))
        return faults
