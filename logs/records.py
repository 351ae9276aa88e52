"""Every record the twin can emit: the one place that says what a run is.

Records are flat: their fields are numbers, strings, booleans and tuples of these, so that each type
maps to one protobuf message and one table. `t_s` is simulated time since the start of slot 0 [s];
slot t lasts from t·slot_s to (t+1)·slot_s. Vertices and edges are indices into the problem's lists.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

# What a robot does in a slot.
MOVING = "moving"  # crosses an edge
WAITING = "waiting"  # stands, as planned
HELD = "held"  # stands although the plan has it move
ARRIVED = "arrived"  # stands at its goal for good (park), or in its last slot (leave)
GONE = "gone"  # has left the floor (leave)

# What its radio link does at an instant.
CONNECTED = "connected"  # served, SNR at or above the threshold
HANDOVER = "handover"  # served, interrupted while the handover lasts
OUTAGE = "outage"  # served, SNR below the threshold
NO_AP = "none"  # not served by any AP
LINKS: tuple[str, ...] = (CONNECTED, HANDOVER, OUTAGE, NO_AP)


@dataclass(frozen=True, slots=True)
class Record:
    """Base of all records."""

    topic: ClassVar[str] = ""
    """MCAP topic; `{robot}` and `{ap}` stand for the field of that name."""

    t_s: float


@dataclass(frozen=True, slots=True)
class RunStart(Record):
    """The first record: who takes part and how time is cut."""

    topic: ClassVar[str] = "/run/start"

    world: str
    slot_s: float
    horizon: int
    samples_per_slot: int
    interruption_s: float
    threshold_db: float
    policy: str
    at_goal: str
    seed: int
    robots: tuple[str, ...]
    aps: tuple[str, ...]
    ap_capacity: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Sample(Record):
    """All bodies on the floor at one instant, as columns: entry k speaks of `robot[k]`.

    Several samples per slot, its first and last instant included (the last one is the next slot's
    first). `robot` and `ap` index RunStart's lists; `link` indexes `LINKS`; ap −1 is none. Where
    ap is −1, snr_db and map_snr_db are −1000.
    """

    topic: ClassVar[str] = "/samples"

    slot: int
    robot: tuple[int, ...]
    x_m: tuple[float, ...]
    y_m: tuple[float, ...]
    heading_rad: tuple[float, ...]
    ap: tuple[int, ...]
    snr_db: tuple[float, ...]  # experienced: rays cast at this very place and time
    map_snr_db: tuple[float, ...]  # predicted by the radio map
    link: tuple[int, ...]
    rate_mbps: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class RobotState(Record):
    """One robot at the beginning of a slot, and whenever its link changes within it."""

    topic: ClassVar[str] = "/robots/{robot}/state"

    slot: int
    robot: str
    visit: int  # index of its plan's state it is at or has left last
    vertex: int  # stands at, or left last
    edge: int  # is crossing, −1 if standing
    next_vertex: int  # will reach, the same vertex if standing
    activity: str  # one of MOVING, WAITING, HELD, ARRIVED, GONE
    waits_for: str  # robot that must go first, "" if none
    ap: str  # serving AP, "" if none
    link: str  # one of LINKS
    snr_db: float
    rate_mbps: float


@dataclass(frozen=True, slots=True)
class Handover(Record):
    """A robot changes its AP; no data flows from `t_s` to `end_s`."""

    topic: ClassVar[str] = "/robots/{robot}/handover"

    slot: int
    robot: str
    from_ap: str
    to_ap: str
    vertex: int
    next_vertex: int
    x_m: float
    y_m: float
    end_s: float
    planned: bool


@dataclass(frozen=True, slots=True)
class ApLoad(Record):
    """Robots an AP serves in a slot; an on-edge robot counts for the AP of the vertex it left."""

    topic: ClassVar[str] = "/aps/{ap}/load"

    slot: int
    ap: str
    load: int
    capacity: int


@dataclass(frozen=True, slots=True)
class Separation(Record):
    """The least clearance between two bodies during a slot [m], negative when they overlap."""

    topic: ClassVar[str] = "/separation"

    slot: int
    clearance_m: float
    robot_a: str  # "" while fewer than two bodies are on the floor (clearance −1000 then)
    robot_b: str


@dataclass(frozen=True, slots=True)
class Arrival(Record):
    """A robot stands at its goal for good."""

    topic: ClassVar[str] = "/robots/{robot}/arrival"

    slot: int
    robot: str
    vertex: int


@dataclass(frozen=True, slots=True)
class Incident(Record):
    """Something a person should look at.

    `kind`: "collision" (two robots on a vertex or edge), "contact" (bodies overlap), "obstacle"
    (a body inside an obstacle), "outage" (SNR below the threshold for `value` seconds up to `t_s`),
    "overload" (`value` robots served by `ap`), "unserved" (the plan has no path for the robot).
    """

    topic: ClassVar[str] = "/events"

    slot: int
    kind: str
    robot: str
    other: str
    ap: str
    value: float
    message: str


@dataclass(frozen=True, slots=True)
class Kpi(Record):
    """Key figures of the run up to the end of a slot; the last one is the run's result."""

    topic: ClassVar[str] = "/kpi"

    slot: int
    robots: int
    arrived: int
    makespan_slots: int  # slot of the last arrival so far
    travel_slots: int  # slots until arrival, or so far, summed over robots
    planned_travel_slots: int  # of the whole plan
    handovers: int
    planned_handovers: int  # of the whole plan
    held_slots: int  # robot-slots held although the plan moves
    connected_s: float
    handover_s: float
    outage_s: float  # link OUTAGE or NO_AP
    worst_outage_s: float  # longest single one of any robot
    peak_load: int
    peak_load_share: float  # of the capacity of that AP
    overload_robot_slots: int
    delivered_mbit: float
    p10_rate_mbps: float  # 10th percentile over all samples of connected and other links
    min_clearance_m: float  # −1000 while fewer than two bodies were on the floor
    map_error_mean_db: float  # predicted minus experienced SNR
    map_error_max_db: float  # largest absolute one
    incidents: int


@dataclass(frozen=True, slots=True)
class RobotKpi(Record):
    """Key figures of one robot at the end of the run."""

    topic: ClassVar[str] = "/robots/{robot}/kpi"

    robot: str
    arrived: bool
    travel_slots: int
    planned_travel_slots: int
    handovers: int
    planned_handovers: int
    waiting_slots: int
    held_slots: int
    connected_s: float
    handover_s: float
    outage_s: float
    worst_outage_s: float
    delivered_mbit: float
    p10_rate_mbps: float


@dataclass(frozen=True, slots=True)
class ApKpi(Record):
    """Key figures of one AP at the end of the run."""

    topic: ClassVar[str] = "/aps/{ap}/kpi"

    ap: str
    mean_load: float
    peak_load: int
    capacity: int
    overload_robot_slots: int
    handovers_in: int
    handovers_out: int


@dataclass(frozen=True, slots=True)
class RunEnd(Record):
    """The last record. `verdict`: "completed", or "failed" with the reason in `message`."""

    topic: ClassVar[str] = "/run/end"

    slot: int
    verdict: str
    message: str


RECORD_TYPES: tuple[type[Record], ...] = (
    RunStart,
    Sample,
    RobotState,
    Handover,
    ApLoad,
    Separation,
    Arrival,
    Incident,
    Kpi,
    RobotKpi,
    ApKpi,
    RunEnd,
)
"""In the order in which schemas are registered in a log."""
