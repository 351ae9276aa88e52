"""`twin check`: what is wrong or unwise with a layout, as coded findings.

What makes a world unusable (`worlds.generate` and `worlds.errands` say so) becomes errors; the
search goes on with what is left when the elements at fault are set aside, so that one misplaced
robot does not hide a hole in the coverage. What the codes mean stands in `worlds.check_codes`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from worlds.check_codes import severity
from worlds.errands import with_covered_robots, with_robots
from worlds.errors import Fault, Key, WorldError
from worlds.floor import Floor
from worlds.generate import resolve
from worlds.places import NowhereError, position_m, position_of
from worlds.radio_map import RadioMap, build_radio_map
from worlds.world import AccessPoint, RandomRobots, Robots, World

MAX_PLACES = 2000
_ORDER = {"error": 0, "warning": 1, "note": 2}

Places = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong or unwise.

    Attributes:
        code: of `worlds.check_codes.CODES`.
        message: value, rule and remedy in one sentence.
        key: where in the world; () when it concerns the world as a whole.
        places_m: where in the hall, to mark in a picture [m]; at most `MAX_PLACES`.
    """

    code: str
    message: str
    key: Key = ()
    places_m: Places = ()

    @property
    def severity(self) -> str:
        """`error`, `warning` or `note`."""
        return severity(self.code)

    @property
    def fault(self) -> Fault:
        """As a fault, for those who can place it in a file."""
        return Fault(self.key, self.message, self.code)


@dataclass(frozen=True, eq=False)
class CheckReport:
    """All findings of a world.

    Attributes:
        world: that was checked.
        findings: errors first, then by code and key.
        ignored: how many findings were left out because their codes were to be ignored.
        floor, radio_map: of the world without what is at fault; None where none is left.
    """

    world: World
    findings: tuple[Finding, ...]
    ignored: int
    floor: Floor | None
    radio_map: RadioMap | None

    def count(self, kind: str) -> int:
        """How many errors, warnings or notes there are."""
        return sum(finding.severity == kind for finding in self.findings)

    def passed(self, *, strict: bool = False) -> bool:
        """No error; `strict`: no warning either."""
        return not self.count("error") and not (strict and self.count("warning"))


@dataclass(frozen=True, eq=False)
class Site:
    """What the checks look at.

    Attributes:
        world: as written.
        sound: without what is at fault; its robots do not matter.
        floor: of `sound`, with those robots of `world` that have a place.
        radio_map: of `floor`; None where there is no radio.
    """

    world: World
    sound: World
    floor: Floor
    radio_map: RadioMap | None

    @property
    def robots(self) -> int:
        """How many robots the world asks for."""
        drawn = self.world.robots
        return drawn.random.count if drawn is not None else len(self.world.robot)


def check_world(
    world: World,
    *,
    ignore: Collection[str] = (),
    on_progress: Callable[[int, int], None] | None = None,
) -> CheckReport:
    """All findings of a world.

    Args:
        world: to look at.
        ignore: codes of warnings and notes that are not to be reported.
        on_progress: told (APs done, APs in all) while rays are cast.
    """
    from worlds.check_floor import floor_findings, written_findings
    from worlds.check_lanes import lane_findings
    from worlds.check_radio import radio_findings
    from worlds.check_survey import survey_findings

    found: list[Finding] = []
    site = _site(world, found, on_progress)
    found += written_findings(world)
    if site is not None:
        found += floor_findings(site) + lane_findings(site)
        if site.radio_map is not None:
            found += radio_findings(site, site.radio_map)
            found += survey_findings(site, site.radio_map)
    unique = list(dict.fromkeys(found))
    kept = [finding for finding in unique if finding.code not in ignore]
    kept.sort(key=lambda f: (_ORDER[f.severity], f.code, [(str(type(k)), k) for k in f.key]))
    return CheckReport(
        world,
        tuple(kept),
        len(unique) - len(kept),
        site.floor if site else None,
        site.radio_map if site else None,
    )


def places(xy_m: NDArray[np.float64]) -> Places:
    """Rows of an array as places to mark."""
    return tuple((float(x), float(y)) for x, y in xy_m[:MAX_PLACES])


def _site(
    world: World, found: list[Finding], on_progress: Callable[[int, int], None] | None
) -> Site | None:
    """Floor and radio map of what is sound in a world; what is not is added to `found`."""
    sound, floor = _sound(world, found)
    if floor is None:
        return None
    radio_map = None
    if any(ap.enabled for ap in sound.ap):
        try:
            radio_map = build_radio_map(sound, floor, exact=False, on_progress=on_progress)
        except WorldError as error:
            found += _findings(world, error)
    if radio_map is not None and not radio_map.covered.any():
        best = float(radio_map.snr_db.max())
        message = (
            f"{radio_map.threshold_db:g} dB is reached nowhere: the best SNR at any of the "
            f"{len(radio_map.snr_db)} free positions is {best:.1f} dB; lower it, raise "
            "tx_power_dbm, or move the access points"
        )
        found.append(Finding("E116", message, ("radio", "threshold_db")))
        radio_map = None
    return Site(world, sound, _with_sound_robots(world, floor, radio_map, found), radio_map)


def _sound(world: World, found: list[Finding]) -> tuple[World, Floor | None]:
    """The world without APs, obstacles, stations and robots at fault, and its floor."""
    wrong: dict[str, set[int]] = {"ap": set(), "obstacle": set()}
    try:
        resolve(world)
    except WorldError as error:
        # Robots are looked at again, once the floor is there.
        faults = [f for f in error.faults if f.key[:1] not in {("robot",), ("robots",), ()}]
        found += _findings(world, WorldError(faults))
        for fault in faults:
            if fault.key and fault.key[0] in wrong and len(fault.key) > 1:
                wrong[str(fault.key[0])].add(int(fault.key[1]))
    named = [
        o.model_copy(update={"name": o.name or f"obstacle[{i}]"})
        for i, o in enumerate(world.obstacle)
    ]
    slim = world.hall.body
    if world.hall.graph is None:
        pitch = world.hall.grid_pitch_m
        slim = slim.model_copy(
            update={
                "width_m": min(slim.width_m, pitch / math.sqrt(2)),
                "length_m": min(slim.length_m, 0.99 * pitch),
            }
        )
    aps = tuple(ap for i, ap in enumerate(world.ap) if i not in wrong["ap"])
    sound = world.model_copy(
        update={
            "hall": world.hall.model_copy(update={"body": slim}),
            "obstacle": tuple(o for i, o in enumerate(named) if i not in wrong["obstacle"]),
            "ap": aps,
            "station": (),
            "robot": (),
            "robots": Robots(random=RandomRobots(count=1)),
        }
    )
    # The floor needs an AP, wherever it hangs, and one robot.
    high = AccessPoint.model_construct(
        id="none", position_m=(0.0, 0.0, 1e4), enabled=True, model=None, capacity=None
    )
    try:
        return sound, resolve(sound.model_copy(update={"ap": (high,)}))
    except WorldError as error:
        found += _findings(world, error)
        return sound, None


def _with_sound_robots(
    world: World, floor: Floor, radio_map: RadioMap | None, found: list[Finding]
) -> Floor:
    """The floor with the robots that have places; the others are added to `found`."""
    none = np.empty(0, dtype=np.int32)
    empty = replace(floor, robot_ids=(), start=none, goal=none)
    rest, index = world, list(range(len(world.robot)))
    for _ in range(2):  # the second time without those that were at fault the first time
        faults: dict[tuple[Key, str], Fault] = {}
        placed = empty
        for covered in (False, True):
            try:
                if covered and radio_map is not None:
                    placed = with_covered_robots(rest, empty, radio_map)
                else:
                    placed = with_robots(rest, empty)
            except WorldError as error:
                for fault in error.faults:
                    key = fault.key
                    if key[:1] == ("robot",):
                        key = ("robot", index[int(key[1])], *key[2:])
                    faults.setdefault((key, fault.code), replace(fault, key=key))
                if world.robots is not None or not world.robot:
                    break  # one cause, one finding
        found += _findings(world, WorldError(list(faults.values())))
        if not faults:
            return placed
        bad = {int(key[1]) for key, _ in faults if key[:1] == ("robot",)}
        index = [i for i in range(len(world.robot)) if i not in bad]
        if world.robots is not None or not index:
            return empty
        rest = world.model_copy(update={"robot": tuple(world.robot[i] for i in index)})
    return empty


def _findings(world: World, error: WorldError) -> list[Finding]:
    """Faults as findings, with the place they speak of."""
    return [
        Finding(fault.code or "E100", fault.message, fault.key, _place(world, fault.key))
        for fault in error.faults
    ]


def _place(world: World, key: Key) -> Places:
    """Where in the hall the element of a key is; () where that is nowhere."""
    match key:
        case ("ap", int(i), *_):
            return (world.ap[i].position_m[:2],)
        case ("obstacle", int(i), *_):
            return (world.obstacle[i].center_m,)
        case ("station", int(i), *_):
            place = world.station[i]
        case ("robot", int(i), "start" | "goal" as end, *_):
            place = getattr(world.robot[i], str(end))
            stations = {station.name: station for station in world.station}
            place = stations.get(place.station, place) if place.station else place
        case _:
            return ()
    try:
        position = position_of(world.hall, place)
    except NowhereError:
        return (place.at_m,) if place.at_m is not None else ()
    return (position_m(world.hall, position),)
