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

# Why a robot is HELD; where several hold, the first of this order is told.
BY_FAILURE = "failure"  # it has failed
BY_DELAY = "delay"  # it is late
BY_NO_PATH = "no-path"  # the plan in force has no further way for it
BY_BLOCKAGE = "blockage"  # something stands where it would go
BY_CONNECTION = "connection"  # no connection, and what was released to it is used up
BY_ROBOT = "robot"  # another robot must go first: `waits_for`
CAUSES: tuple[str, ...] = (
    BY_FAILURE,
    BY_DELAY,
    BY_NO_PATH,
    BY_BLOCKAGE,
    BY_CONNECTION,
    BY_ROBOT,
)


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
    visit: int  # index of its path's state it is at or has left last (`NewPath` since, if any)
    vertex: int  # stands at, or left last
    edge: int  # is crossing, −1 if standing
    next_vertex: int  # will reach, the same vertex if standing
    activity: str  # one of MOVING, WAITING, HELD, ARRIVED, GONE
    waits_for: str  # robot that must go first, "" if none
    ap: str  # serving AP, "" if none
    link: str  # one of LINKS
    snr_db: float
    rate_mbps: float
    cause: str = ""  # why it is HELD, one of CAUSES; "" if it is not


@dataclass(frozen=True, slots=True)
class Handover(Record):
    """A robot changes its AP; no data flows from `t_s` to `end_s`.

    `from_ap` is "" where it had lost its AP and finds another one. (That an AP goes out is a
    `Disturbance`; the robot then has a `RobotState` without an AP.) What the plan has is `planned`.
    """

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
    (a body inside an obstacle), "caught" (a body that stands touches the blockage `other`),
    "outage" (SNR below the threshold, or no AP, for `value` seconds up to `t_s`), "overload"
    (`value` robots served by `ap`), "unserved" (the plan has no path for the robot), "deadlock"
    (nobody can move and nothing is due; `value` robots, from `robot` on, wait in a circle, 0 if
    they do not wait for each other).
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
class Disturbance(Record):
    """Something that goes wrong begins, or is over.

    Delays are told where they begin, with their length; the others at the first sample instant at
    which they hold, and at the first at which they do not any more.
    """

    topic: ClassVar[str] = "/disturbances"

    slot: int
    kind: str  # "delay", "ap-outage", "blockage" or "robot-failure"
    name: str  # of the event in the world; "" for a delay that was drawn
    robot: str  # "" if none
    ap: str  # "" if none
    begins: bool
    slots: int  # length of a delay, 0 for other kinds
    until_s: float  # when it will be over; −1 if that is not foreseen
    message: str


@dataclass(frozen=True, slots=True)
class Blockages(Record):
    """All blockages there are at an instant, as columns: their boxes, complete in each record.

    Told at every sample at which one appears, moves, or is gone; between two records all stand as
    the earlier one says. A box is `length_m` along `yaw_rad` and `width_m` across.
    """

    topic: ClassVar[str] = "/blockages"

    slot: int
    name: tuple[str, ...]
    x_m: tuple[float, ...]  # of its centre
    y_m: tuple[float, ...]
    z_m: tuple[float, ...]
    yaw_rad: tuple[float, ...]
    length_m: tuple[float, ...]
    width_m: tuple[float, ...]
    height_m: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Replan(Record):
    """A new plan was asked for at the beginning of a slot.

    `robot`, `without_path` are indices into RunStart's list. Costs are those of the paths from
    here on (§1.9), over the robots that have one both before and after. If the new plan is adopted,
    a `NewPath` follows for every robot on the floor.
    """

    topic: ClassVar[str] = "/replans"

    slot: int
    number: int  # 1, 2, … ; of adopted and kept ones together
    cause: str  # "ap-outage", "blockage", "robot-failure", "slip", "deadlock" or "recovery"
    name: str  # of the AP, blockage or robot that is the cause, "" if none
    adopted: bool  # or else the robots keep the paths they had
    robot: tuple[int, ...]  # those whose way or APs are new
    without_path: tuple[int, ...]  # those that must stand where they are, or end up
    cost_before: int
    cost_after: int
    message: str


@dataclass(frozen=True, slots=True)
class NewPath(Record):
    """The path of one robot from a slot on, in place of the one it had; state k is due in slot + k.

    `vertices`, `aps` and `edges` are those of a `planner.plan.Path`. A robot amid a crossing of
    several slots begins with its slot `piece` of it.
    """

    topic: ClassVar[str] = "/robots/{robot}/path"

    slot: int
    number: int  # of the Replan
    robot: str
    vertices: tuple[int, ...]
    aps: tuple[int, ...]
    edges: tuple[int, ...]
    piece: int
    to_goal: bool  # it ends at its goal; else it stands at its end until there is a new path


@dataclass(frozen=True, slots=True)
class Waits(Record):
    """Who was held by whom, for how many slots: entry k speaks of `robot[k]` and `other[k]`."""

    topic: ClassVar[str] = "/run/waits"

    robot: tuple[int, ...]
    other: tuple[int, ...]
    slots: tuple[int, ...]


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
    planned_makespan_slots: int = 0  # of the whole plan
    unplanned_handovers: int = 0
    ping_pongs: int = 0  # handovers back to the AP left shortly before
    held_by_failure: int = 0  # robot-slots, by the cause that was told
    held_by_delay: int = 0
    held_by_no_path: int = 0
    held_by_blockage: int = 0
    held_by_connection: int = 0
    held_by_robot: int = 0
    delays: int = 0  # that began
    replans: int = 0


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
    mean_rate_mbps: float = 0.0  # over the time on the floor
    unplanned_handovers: int = 0
    ping_pongs: int = 0
    held_by_failure: int = 0  # slots, by the cause that was told
    held_by_delay: int = 0
    held_by_no_path: int = 0
    held_by_blockage: int = 0
    held_by_connection: int = 0
    held_by_robot: int = 0


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
    Disturbance,
    Blockages,
    Replan,
    NewPath,
    Waits,
)
"""In the order in which schemas are registered in a log."""
