"""`World`: everything a run depends on, as frozen models with SI units in their names.

The models hold what a person wrote. What follows from it (free positions, drawn obstacles and
robots, stations resolved to vertices) is computed by `worlds.generate` and `worlds.floor`.

Numbers are strict: "60" is no number, 60.0 no count, true no 1. The upper limits of lengths are
far above any hall; they are there to catch millimetres.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Discriminator, Field, Tag

from worlds.errors import Fault
from worlds.events import Delays, Event, event_faults, event_misfits
from worlds.hall import Body, Hall, graph_misfits
from worlds.part import Part, given, listed, nearest
from worlds.radio_options import AccessPoint, Antenna, ChannelModel, Measured, Radio
from worlds.scalars import Cost, Id, Length, Metres2, Name, Seed

__all__ = [
    "INTERRUPTION_MS",
    "AccessPoint",
    "Antenna",
    "Body",
    "ChannelModel",
    "Costs",
    "Delays",
    "Event",
    "Hall",
    "Measured",
    "Obstacle",
    "Obstacles",
    "Place",
    "PlanOptions",
    "Radio",
    "RandomObstacles",
    "RandomRobots",
    "Robot",
    "Robots",
    "RunOptions",
    "Station",
    "World",
]


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


class Place(Part):
    """A place on the floor: a station, a cell of the grid, a node of the graph, or metres."""

    exactly_one: ClassVar[tuple[str, ...]] = ("station", "cell", "node", "at_m")

    station: Id | None = Field(
        default=None, description="a `[[station]]`; short form: only its name"
    )
    cell: tuple[int, int] | None = Field(default=None, description="column and row, from 0")
    node: Id | None = Field(default=None, description="id of a node of the hall's graph")
    at_m: Metres2 | None = Field(default=None, description="x and y; the nearest position is taken")

    @classmethod
    def accept(cls, data: object) -> object:
        """A plain string is a station's name."""
        return {"station": data} if isinstance(data, str) else data


class Station(Part):
    """A named place."""

    exactly_one: ClassVar[tuple[str, ...]] = ("cell", "nodes", "at_m")

    name: Id = Field(description="for robots to refer to")
    cell: tuple[int, int] | None = Field(default=None, description="column and row, from 0")
    nodes: tuple[Id, ...] | None = Field(
        default=None,
        min_length=1,
        description="ids of nodes of the hall's graph; robots drive to the first one",
    )
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
    policy: Literal["group", "strict"] = Field(
        default="group",
        description="who may advance: `group`, whoever can in this slot together with others; "
        "`strict`, into places that are empty already (for fleets without a common clock)",
    )
    max_slots: Annotated[int, Field(ge=1, le=10_000_000)] | None = Field(
        default=None,
        description="the run is ended after so many slots; 10 · horizon and all listed delays "
        "when left out",
    )
    release_horizon: int = Field(
        default=3,
        ge=1,
        le=100_000,
        description="positions a robot may still drive to after it has lost its connection",
    )
    hysteresis_db: Annotated[float, Field(ge=0, le=100)] = Field(
        default=3.0, description="an unplanned change of the AP must gain so much"
    )
    time_to_trigger_s: Annotated[float, Field(ge=0, le=3600)] = Field(
        default=0.5, description="and its reason must have lasted so long"
    )
    robots_block: bool = Field(
        default=False,
        description="bodies of robots block the radio of others (where they are taller than the "
        "antenna)",
    )
    replan: bool = Field(default=True, description="plan anew when the plan cannot be kept")
    replan_after_s: Annotated[float, Field(ge=0, le=1e7)] = Field(
        default=10.0, description="how long an AP must have been out"
    )
    replan_slip: int = Field(
        default=20,
        ge=1,
        le=10_000_000,
        description="plan anew when the end of the run is put off by so many slots",
    )
    replan_cooldown: int = Field(
        default=5, ge=0, le=10_000_000, description="slots from one new plan to the next"
    )
    replan_iterations: int = Field(
        default=200, ge=0, le=1_000_000, description="neighbourhoods tried to better a new plan"
    )

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
    delays: Delays = Delays()
    event: tuple[Event, ...] = ()

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
        faults += graph_misfits(data)
        faults += event_misfits(data)
        if listed(data, "robot") and given(data, "robots") is not None:
            rule = "is given beside the listed robots ([[robot]]); keep one of the two"
            faults.append(Fault(("robots",), rule))
        return faults

    def faults(self) -> list[Fault]:
        """Events out of time or place."""
        return event_faults(self)
