"""What goes wrong in a run, as a world declares it: `[delays]` and `[[event]]`.

The models hold what a person wrote. What follows from it in a run (which robot is late in which
slot, where a fork-lift is now) is drawn and computed by the twin, and again by the validator, by
the rules that stand here.

**Delays** are drawn for each robot from two streams of its own (`worlds.streams.stream`, seed
`run.seed`, entity the robot's id), so that one robot more shifts nobody else's luck. In slot t one
number of the stream "delays" and one of "delay lengths" is taken, whatever came before:

- `delay_event = "bernoulli"`: a delay begins if the uniform number u_t < p_delay.
- `delay_event = "poisson"`: one begins if u_t < 1 − exp(−p_delay), the chance of at least one event
  of a Poisson process of p_delay events per slot.
- `delay_time = "uniform"`: it lasts min_delay + ⌊w_t · (max_delay − min_delay + 1)⌋ slots.
- `delay_time = "gaussian"`: it lasts round(mean + deviation · Φ⁻¹(w_t)) slots with the mean
  (min_delay + max_delay) / 2 and the deviation (max_delay − min_delay) / 6, cut to the two ends.

A robot that is late makes no transition in the slots t … t + length − 1. A delay that begins while
another one lasts is nothing: the robot stands anyway.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from worlds.errors import Fault
from worlds.part import Part, given, listed, nearest
from worlds.scalars import Id, Length, Metres2, Name, Speed

if TYPE_CHECKING:
    from worlds.world import World

DELAYS_STREAM, LENGTHS_STREAM = "delays", "delay lengths"
"""Names of the random streams of delays; their entities are the robots' ids."""

Seconds = Annotated[float, Field(ge=0, le=1e7)]
Slot = Annotated[int, Field(ge=0, le=10_000_000)]
EventKind = Literal["ap-outage", "blockage", "robot-failure", "delay"]

_NEEDED: dict[str, tuple[str, ...]] = {
    "ap-outage": ("ap",),
    "blockage": ("size_m",),
    "robot-failure": ("robot",),
    "delay": ("robot", "slot", "slots"),
}
_ALLOWED: dict[str, tuple[str, ...]] = {
    "ap-outage": ("ap", "from_s", "to_s"),
    "blockage": (
        *("from_s", "to_s", "center_m", "way_m", "speed_m_s"),
        *("size_m", "height_m", "base_m", "yaw_deg"),
    ),
    "robot-failure": ("robot", "from_s"),
    "delay": ("robot", "slot", "slots"),
}


class Delays(Part):
    """Robots that are late at random: each draws its own luck, slot by slot.

    Keys and words are those of the League of Robot Runners' `delayConfig` where they coincide.
    """

    p_delay: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="chance that a delay begins, per robot and slot; with `poisson` the mean "
        "number of delays that begin",
    )
    delay_event: Literal["bernoulli", "poisson"] = Field(
        default="bernoulli", description="how delays come about"
    )
    delay_time: Literal["uniform", "gaussian"] = Field(
        default="uniform", description="how their lengths are spread"
    )
    min_delay: int = Field(default=1, ge=1, le=10_000, description="the shortest delay, in slots")
    max_delay: int = Field(default=10, ge=1, le=10_000, description="the longest delay, in slots")

    def faults(self) -> list[Fault]:
        """The shortest is not longer than the longest."""
        if self.min_delay <= self.max_delay:
            return []
        rule = f"{self.min_delay} is more than max_delay, {self.max_delay}; exchange the two"
        return [Fault(("min_delay",), rule)]


class Event(Part):
    """Something that goes wrong at a known time.

    - `ap-outage`: the access point `ap` serves nobody.
    - `blockage`: a box stands in the way of robots and of the radio, at `center_m`, or drives along
      `way_m` with `speed_m_s` (a fork-lift), standing at its end until `to_s`.
    - `robot-failure`: `robot` stops for good at the next position.
    - `delay`: `robot` makes no move in `slots` slots from `slot` on.
    """

    kind: EventKind = Field(description="what happens")
    name: Name | None = Field(
        default=None, description="in messages and pictures; `event[3]` when left out"
    )
    ap: Name | None = Field(default=None, description="id of the access point that is out")
    robot: Id | None = Field(default=None, description="id of the robot that fails or is late")
    from_s: Seconds = Field(default=0.0, description="when it begins, from the start of the run")
    to_s: Seconds | None = Field(
        default=None, description="when it is over; when left out it lasts to the end of the run"
    )
    slot: Slot | None = Field(default=None, description="first slot of a delay")
    slots: Annotated[int, Field(ge=1, le=10_000_000)] | None = Field(
        default=None, description="slots a delay lasts"
    )
    center_m: Metres2 | None = Field(
        default=None, description="x and y of a blockage that does not move"
    )
    way_m: tuple[Metres2, ...] = Field(
        default=(), description="way-points of one that does, the first where it appears"
    )
    speed_m_s: Speed = Field(default=1.0, description="along the way")
    size_m: tuple[Length, Length] | None = Field(
        default=None, description="of a blockage: along its way (or in x) and across, in m"
    )
    height_m: float = Field(default=2.0, gt=0, le=200, description="from its underside to its top")
    base_m: float = Field(
        default=0.0, ge=0, le=200, description="height of its underside above the floor"
    )
    yaw_deg: float = Field(
        default=0.0,
        ge=-3600,
        le=3600,
        description="turn of one that does not move, counter-clockwise; one that moves looks ahead",
    )

    @classmethod
    def faults_given(cls, data: Mapping[str, object]) -> list[Fault]:
        """Keys the kind needs, and keys it has no use for."""
        faults = super().faults_given(data)
        kind = data.get("kind")
        if not isinstance(kind, str) or kind not in _NEEDED:
            return faults
        faults += [
            Fault((), f"is of kind {kind} and has no `{key}`; give it")
            for key in _NEEDED[kind]
            if data.get(key) is None
        ]
        for key in data:
            if key in cls.model_fields and key not in {"kind", "name", *_ALLOWED[kind]}:
                default = cls.model_fields[key].default
                if data[key] is None or data[key] == default:
                    continue
                rule = f"means nothing to an event of kind {kind}; take it out"
                faults.append(Fault((key,), rule))
        if kind == "blockage":
            way = data.get("way_m")
            if (data.get("center_m") is None) == (not way):
                rule = "needs either `center_m`, where it stands, or `way_m`, where it drives"
                faults.append(Fault((), rule))
            if isinstance(way, Sequence) and len(way) == 1:
                rule = "has one way-point; give two or more, or `center_m` for one that stands"
                faults.append(Fault(("way_m",), rule))
        return faults

    def faults(self) -> list[Fault]:
        """It ends after it begins, and its way leads somewhere."""
        faults = []
        if self.to_s is not None and self.to_s <= self.from_s:
            rule = f"{self.to_s:g} s is not after from_s, {self.from_s:g} s; give a later time"
            faults.append(Fault(("to_s",), rule))
        for i, (a, b) in enumerate(zip(self.way_m, self.way_m[1:], strict=False)):
            if a == b:
                rule = f"way-points {i} and {i + 1} are the same; take one out"
                faults.append(Fault(("way_m", i + 1), rule))
        return faults


def event_name(world: World, index: int) -> str:
    """What an event is called in records and messages."""
    return world.event[index].name or f"event[{index}]"


def longest_run_slots(world: World) -> int:
    """Slots after which a run is ended: `run.max_slots`, or 10 · horizon and all listed delays."""
    if world.run.max_slots is not None:
        return world.run.max_slots
    listed_delays = sum(event.slots or 0 for event in world.event)
    return 10 * world.plan.horizon + listed_delays


def robot_ids_given(data: Mapping[str, object]) -> list[str] | None:
    """Ids of a world's robots, listed or drawn, as far as the input says; None if it does not."""
    robots = listed(data, "robot")
    if robots:
        names = [given(robot, "id") for robot in robots]
        return [name for name in names if isinstance(name, str)]
    count = given(given(given(data, "robots"), "random"), "count")
    if isinstance(count, int) and not isinstance(count, bool) and 0 < count <= 100_000:
        return [f"r{i:02d}" for i in range(count)]
    return None


def event_misfits(data: Mapping[str, object]) -> list[Fault]:
    """Events that name APs or robots there are none of, and names given twice."""
    faults: list[Fault] = []
    aps = [name for ap in listed(data, "ap") if isinstance(name := given(ap, "id"), str)]
    robots = robot_ids_given(data)
    first: dict[str, int] = {}
    for i, event in enumerate(listed(data, "event")):
        for key, known, what in (
            ("ap", aps, "an access point"),
            ("robot", robots, "a robot"),
        ):
            name = given(event, key)
            if known is None or not isinstance(name, str) or name in known:
                continue
            mend = nearest(name, known) or f" known are {', '.join(known[:8]) or 'none'}"
            faults.append(Fault(("event", i, key), f"'{name}' is not the id of {what};{mend}"))
        name = given(event, "name")
        if isinstance(name, str) and first.setdefault(name, i) != i:
            rule = f"'{name}' is the name of event[{first[name]}] already; give each its own"
            faults.append(Fault(("event", i, "name"), rule))
    return faults


def event_faults(world: World) -> list[Fault]:
    """Events in a world that is right by itself: in time, and within the hall."""
    faults: list[Fault] = []
    slot_s = world.hall.grid_slot_s
    most = longest_run_slots(world)
    off = {ap.id for ap in world.ap if not ap.enabled}
    for i, event in enumerate(world.event):
        late = event.slot if event.slot is not None else event.from_s / slot_s
        if late >= most:
            key = "slot" if event.slot is not None else "from_s"
            rule = f"is after the end of the longest run ({most} slots, {most * slot_s:g} s)"
            mend = "give an earlier time, or more run.max_slots"
            faults.append(Fault(("event", i, key), f"{getattr(event, key):g} {rule}; {mend}"))
        if event.ap in off:
            rule = f"'{event.ap}' is switched off anyway (enabled = false); take the event out"
            faults.append(Fault(("event", i, "ap"), rule))
        faults += _outside(world, i, event)
    return faults


def _outside(world: World, i: int, event: Event) -> list[Fault]:
    """A blockage must touch the floor of the hall at each of its places."""
    if event.size_m is None:
        return []
    reach = math.hypot(*event.size_m) / 2.0
    size = world.hall.size_m
    faults = []
    places = [(("center_m",), event.center_m)] if event.center_m else []
    places += [(("way_m", k), point) for k, point in enumerate(event.way_m)]  # type: ignore[misc]
    for key, place in places:
        if place is not None and not all(
            -reach <= c <= s + reach for c, s in zip(place, size, strict=True)
        ):
            rule = f"{list(place)} puts '{event_name(world, i)}' outside the hall of"
            hint = "check that lengths are metres, and move it inside"
            faults.append(
                Fault(("event", i, *key), f"{rule} {size[0]:g} m x {size[1]:g} m; {hint}")
            )
    return faults
