"""The execution of plans: records against the plan, their order, and what the twin notices."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from logs.kpi import KpiFold, planned_figures
from logs.records import (
    LINKS,
    ApKpi,
    ApLoad,
    Arrival,
    Handover,
    Incident,
    Kpi,
    RobotKpi,
    RobotState,
    RunEnd,
    RunStart,
    Sample,
    Separation,
    Waits,
)
from tests.twin.halls import SQUARE, incidents, make_hall, of_type, random_hall
from tests.twin.plans import make_plan
from twin.errors import TwinError
from twin.order import Commit
from twin.twin import run


def execute(hall, plan, **options):
    """The records of the execution of a plan."""
    records = []
    run(*hall, plan, emit=records.append, **options)
    return records


# --- the plan is replayed ---------------------------------------------------------------------


@settings(max_examples=12, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.booleans(), st.sampled_from(["leave", "park"]))
def test_in_every_slot_every_robot_is_where_the_plan_has_it(seed, slow, at_goal):
    """§1.1, §1.4, §1.6: states, arrivals and handovers equal the plan's; GONE comes once."""
    hall, plan = random_hall(seed, rule="endpoints", slow=slow, at_goal=at_goal)
    records = execute(hall, plan)
    last = max((p.arrival for p in plan.paths if p), default=0)
    starts = {}
    for r in of_type(records, RobotState):
        starts.setdefault((r.robot, r.slot), r)
    for path in filter(None, plan.paths):
        own = {t: r for (robot, t), r in starts.items() if robot == path.robot}
        for t in range(path.arrival + 1):
            assert own[t].t_s == t * hall.floor.slot_s
            assert (own[t].visit, own[t].vertex) == (t, path.vertices[t])
            assert own[t].edge == (path.edges[t] if t < path.arrival else -1)
        activities = [own[t].activity for t in sorted(own)]
        moving = ["moving" if e >= 0 else "waiting" for e in path.edges]
        if at_goal == "leave":
            assert activities == [*moving, "arrived", "gone"]
        else:
            assert activities == [*moving, *["arrived"] * (last - path.arrival + 1)]
        arrivals = [r for r in of_type(records, Arrival) if r.robot == path.robot]
        assert [(r.slot, r.vertex) for r in arrivals] == [(path.arrival, path.vertices[-1])]
        handovers = [
            (hall.problem.ap_ids.index(r.from_ap), hall.problem.ap_ids.index(r.to_ap))
            for r in of_type(records, Handover)
            if r.robot == path.robot
        ]
        changes = np.flatnonzero(np.diff(path.aps))
        assert handovers == [(path.aps[t], path.aps[t + 1]) for t in changes]
    unserved = [r.robot for r in of_type(records, Incident) if r.kind == "unserved"]
    assert tuple(unserved) == plan.unserved
    assert all(r.slot <= last + 1 for r in starts.values())
    assert records[-1].slot == last


@settings(max_examples=12, deadline=None, derandomize=True)
@given(st.integers(0, 10**6))
def test_under_samples_an_undisturbed_run_has_no_outage_and_meets_the_map(seed):
    """Page 3: an outage would be a defect of ours, unless coverage alternates along an edge."""
    hall, plan = random_hall(seed, rule="samples")
    records = execute(hall, plan)
    kpi = of_type(records, Kpi)[-1]
    assert kpi.map_error_max_db == pytest.approx(0.0, abs=1e-9)
    alternating = alternating_handovers(hall, plan)
    if not alternating:
        assert kpi.outage_s == 0
        assert [i for i in incidents(records) if i[1] == "outage"] == []


def alternating_handovers(hall, plan):
    """Handovers on edges along which no single change of AP keeps the connection."""
    found = []
    covered = hall.radio_map.edge_snr_db >= hall.radio_map.threshold_db
    floor_vertex = [
        int((hall.floor.vertex_xy_m == xy).all(axis=1).argmax()) for xy in hall.problem.xy_m
    ]
    pairs = [tuple(uv) for uv in hall.floor.edge_uv.tolist()]
    for path in filter(None, plan.paths):
        for t in np.flatnonzero(np.diff(path.aps)).tolist():
            if path.edges[t] < 0:
                continue
            v, u = floor_vertex[path.vertices[t]], floor_vertex[path.vertices[t + 1]]
            on = covered[pairs.index((min(u, v), max(u, v)))][:: 1 if v < u else -1]
            a, b = on[:, path.aps[t]], on[:, path.aps[t + 1]]
            if not any(a[:j].all() and b[j:].all() for j in range(1, len(on))):
                found.append((path.robot, t))
    return found


@settings(max_examples=8, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.booleans())
def test_loads_count_the_robots_the_samples_show_and_the_plan_has(seed, slow):
    """§1.6: in every slot and for every AP; in edges of one slot also what the samples say."""
    hall, plan = random_hall(seed, rule="endpoints", slow=slow)
    records = execute(hall, plan)
    last = records[-1].slot
    loads = {(r.slot, r.ap): r.load for r in of_type(records, ApLoad)}
    assert len(loads) == (last + 1) * hall.problem.n_aps
    first = {r.t_s: Counter(r.ap) for r in of_type(records, Sample)}
    for (t, name), load in loads.items():
        a = hall.problem.ap_ids.index(name)
        assert load == sum(p.aps[t] == a for p in plan.paths if p and t <= p.arrival)
        if not slow:
            assert load == first[t * hall.floor.slot_s][a]


def test_the_same_inputs_give_the_same_records():
    """Equal records in equal order, the second time as the first."""
    hall, plan = random_hall(4, rule="endpoints")
    assert execute(hall, plan) == execute(hall, plan)


# --- the order of events ----------------------------------------------------------------------


def place_in_instant(record, hall):
    """(phase, number) of a record by the contract in the head of `twin.twin`."""
    robots, aps = hall.problem.robot_ids, hall.problem.ap_ids
    slot_s = hall.floor.slot_s
    boundary = abs(record.t_s / slot_s - round(record.t_s / slot_s)) < 1e-9
    begins = boundary and record.slot == round(record.t_s / slot_s)
    robot = robots.index(record.robot) if getattr(record, "robot", "") in robots else -1
    kind = getattr(record, "kind", "")
    if isinstance(record, Sample):
        return 7, 0
    if isinstance(record, (Separation, Kpi)) or kind in {"contact", "obstacle"}:
        return 2, 0
    if kind == "unserved":
        return 3, 0
    if kind == "collision":
        return 6, 0
    if isinstance(record, ApLoad) or kind == "overload":
        return 5, aps.index(record.ap)
    assert isinstance(record, (RobotState, Arrival, Handover)) or kind == "outage"
    return (4 if begins else 1), robot


@settings(max_examples=8, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.sampled_from([70.0, 500.0, 1000.0, 2500.0]))
def test_records_come_in_the_order_of_the_contract(seed, interruption_ms):
    """Times never decrease; within an instant phases and numbers never do."""
    hall, plan = random_hall(seed, rule="endpoints")
    world = hall.world.model_copy(
        update={"run": hall.world.run.model_copy(update={"interruption": interruption_ms})}
    )
    records = execute(hall._replace(world=world), plan)
    assert isinstance(records[0], RunStart)
    assert isinstance(records[-1], RunEnd)
    body = [r for r in records[1:-1] if not isinstance(r, (RobotKpi, ApKpi, Waits))]
    end_s = records[-1].t_s
    keys = [(round(r.t_s * 1e9), *place_in_instant(r, hall)) for r in body if r.t_s < end_s]
    assert keys == sorted(keys)
    final = [type(r) for r in records if r.t_s == end_s]
    tail = [Kpi, *[RobotKpi] * len(plan.paths), *[ApKpi] * hall.problem.n_aps, Waits, RunEnd]
    assert final[-len(tail) :] == tail
    before = [t for t in final[: -len(tail)] if t is not Incident]
    assert before.count(Separation) == before.count(Sample) == 1
    assert set(before[before.index(Separation) + 1 : before.index(Sample)]) <= {RobotState}


def told(record):
    """A record in one line."""
    name = type(record).__name__
    match record:
        case RunStart():
            return f"{name} {' '.join(record.robots)}"
        case Sample():
            shown = [f"r{i} {LINKS[k]}" for i, k in zip(record.robot, record.link, strict=True)]
            return f"{name} {record.t_s:g} {', '.join(shown)}"
        case RobotState():
            return (
                f"{name} {record.t_s:g} {record.robot} {record.activity} {record.ap} {record.link}"
            )
        case Handover():
            return f"{name} {record.t_s:g} {record.robot} {record.from_ap} {record.to_ap}"
        case ApLoad():
            return f"{name} {record.t_s:g} {record.ap} {record.load}"
        case Separation():
            return f"{name} {record.t_s:g} {record.clearance_m:g}"
        case Incident():
            return f"{name} {record.t_s:g} {record.kind} {record.robot}{record.ap}"
        case Arrival():
            return f"{name} {record.t_s:g} {record.robot}"
        case RunEnd():
            return f"{name} {record.t_s:g} {record.verdict} {record.message}"
        case _:
            return f"{name} {record.t_s:g}"


GOLDEN = """\
RunStart r0 r1
RobotState 0 r0 moving west connected
RobotState 0 r1 waiting east connected
ApLoad 0 west 1
ApLoad 0 east 1
Sample 0 r0 connected, r1 connected
Handover 0.5 r0 west east
RobotState 0.5 r0 moving east handover
Sample 0.5 r0 handover, r1 connected
RobotState 0.6 r0 moving east connected
Sample 1 r0 connected, r1 connected
Sample 1.5 r0 connected, r1 connected
Separation 2 1.2
Kpi 2
Arrival 2 r0
RobotState 2 r0 arrived east connected
RobotState 2 r1 moving east connected
ApLoad 2 west 0
ApLoad 2 east 2
Incident 2 overload east
Sample 2 r0 connected, r1 connected
Sample 2.5 r0 connected, r1 connected
Sample 3 r0 connected, r1 connected
Sample 3.5 r0 connected, r1 connected
Separation 4 1.2
Kpi 4
RobotState 4 r0 gone  none
Arrival 4 r1
RobotState 4 r1 arrived east connected
ApLoad 4 west 0
ApLoad 4 east 1
Sample 4 r1 connected
Sample 4.5 r1 connected
Sample 5 r1 connected
Sample 5.5 r1 connected
Separation 6 -1000
RobotState 6 r1 gone  none
Sample 6 
Kpi 6
RobotKpi 6
RobotKpi 6
ApKpi 6
ApKpi 6
Waits 6
RunEnd 6 completed 
"""


def test_a_short_run_in_full():
    """Golden: two robots in a corridor, one hands over, the other makes room, one place too few."""
    hall = make_hall(
        size=(32.0, 2.0),
        aps=(("west", (0.0, 1.0, 3.0)), ("east", (32.0, 1.0, 3.0))),
        errands=(((7, 0), (8, 0)), ((9, 0), (10, 0))),
        radio={"ap_capacity": 1},
        run={"interruption": 100.0},
    )
    records = hall.run(
        hall.walk("r0", (7, 0), (8, 0), aps=["west", "east"]),
        hall.walk("r1", (9, 0), (9, 0), (10, 0), aps=["east"] * 3),
    )
    assert "\n".join(map(told, records)) + "\n" == GOLDEN


def test_a_state_within_a_slot_is_told_only_when_the_link_changes():
    """A quiet run has exactly one state per robot and slot."""
    hall = make_hall(**SQUARE, errands=(((0, 0), (1, 0)), ((3, 3), (2, 3))))
    records = hall.run(hall.walk("r0", (0, 0), (1, 0)), hall.walk("r1", (3, 3), (3, 3), (2, 3)))
    states = Counter((r.robot, r.slot) for r in of_type(records, RobotState))
    assert set(states.values()) == {1}


# --- figures, policies, inputs ----------------------------------------------------------------


def test_kpis_are_those_of_the_records_slot_by_slot():
    """Folding the records anew gives every Kpi of the run, and the last ones."""
    hall, plan = random_hall(4, rule="endpoints")
    records = execute(hall, plan)
    fold = KpiFold(records[0], planned_figures(plan))
    slots = []
    for record in records[1:]:
        if isinstance(record, Kpi):
            assert record == fold.current(record.t_s, record.slot)
            slots.append(record.slot)
        fold.add(record)
    assert slots == list(range(records[-1].slot + 1))
    figures = of_type(records, RobotKpi, ApKpi)
    assert figures == fold.final(records[-1].t_s, records[-1].slot)
    floor_s = sum(p.arrival + 1 for p in plan.paths if p) * hall.floor.slot_s
    last = of_type(records, Kpi)[-1]
    assert last.connected_s + last.handover_s + last.outage_s == pytest.approx(floor_s)


class _Never:
    name = "never"

    def decide(self, order, at, ready):
        """Let nobody advance."""
        return Commit(np.zeros_like(ready), np.where(ready, 0, -1).astype(np.int32))


def test_a_policy_that_stops_everybody_ends_the_run_as_failed():
    """Nothing else is due that could change it: the run must not hang."""
    hall = make_hall(**SQUARE, errands=(((0, 0), (1, 0)), ((3, 3), (3, 1))))
    records = hall.run(
        hall.walk("r0", (0, 0), (1, 0)), hall.walk("r1", (3, 3), (3, 2), (3, 1)), policy=_Never()
    )
    assert records[0].policy == "never"
    assert (records[-1].slot, records[-1].verdict) == (0, "failed")
    assert "nobody can move; r0 waits for r0; r1 waits for r0" in records[-1].message
    assert {r.activity for r in of_type(records, RobotState)} == {"held"}


class _HoldsFirst:
    """Holds robot 0 in its first two slots, then keeps to the order."""

    name = "holds first"

    def __init__(self):
        self.slots = 0

    def decide(self, order, at, ready):
        """Group commit among the others, meanwhile."""
        from twin.order import group_commit

        self.slots += 1
        able = ready.copy()
        able[0] &= self.slots > 2
        return replace(group_commit(order, at, able), due=self.slots <= 2)


def test_a_policy_that_holds_a_robot_holds_its_followers_and_nobody_collides():
    """The structure for delays: HELD, with the robot waited for, then the rest of the plan."""
    hall = make_hall(**SQUARE, errands=(((1, 0), (3, 0)), ((0, 0), (2, 0))))
    records = hall.run(
        hall.walk("r0", (1, 0), (2, 0), (3, 0)),
        hall.walk("r1", (0, 0), (1, 0), (2, 0)),
        policy=_HoldsFirst(),
    )
    held = [
        (r.slot, r.robot, r.waits_for) for r in of_type(records, RobotState) if r.activity == "held"
    ]
    assert held == [(0, "r0", ""), (0, "r1", "r0"), (1, "r0", ""), (1, "r1", "r0")]
    assert incidents(records) == []
    assert records[-1].verdict == "completed"
    last = of_type(records, Kpi)[-1]
    assert (last.held_slots, last.travel_slots, last.planned_travel_slots) == (4, 8, 4)


def test_a_late_robot_makes_up_for_its_delay_in_planned_waits():
    """Held for two slots, it leaves out its two waits and arrives as planned."""
    hall = make_hall(**SQUARE, errands=(((0, 0), (2, 0)),))
    path = hall.walk("r0", (0, 0), (1, 0), (1, 0), (1, 0), (2, 0))
    records = hall.run(path, policy=_HoldsFirst())
    states = of_type(records, RobotState)
    assert [(r.activity, r.visit) for r in states] == [
        ("held", 0), ("held", 0), ("moving", 0), ("moving", 3), ("arrived", 4), ("gone", 4)
    ]  # fmt: skip
    assert records[-1].slot == path.arrival


def test_progress_is_told_after_each_slot():
    """(slots done, slots of the plan), the last time with all done."""
    hall = make_hall(**SQUARE, errands=(((0, 0), (2, 0)),))
    told_of = []
    hall.run(
        hall.walk("r0", (0, 0), (1, 0), (2, 0)), on_slot=lambda *numbers: told_of.append(numbers)
    )
    assert told_of == [(1, 3), (2, 3), (3, 3)]


def test_the_problem_of_another_world_is_refused():
    """The message says what differs and what to do."""
    hall = make_hall(**SQUARE, errands=(((0, 0), (2, 0)),))
    other = make_hall(errands=(((0, 0), (2, 0)),), radio={"tx_power_dbm": 24.0})
    plan = make_plan(other.problem, other.walk("r0", (0, 0), (1, 0), (2, 0)))
    with pytest.raises(TwinError, match=r"8 vertices.*\(16, 24, 1, 1\).*problem_from_world"):
        run(hall.world, hall.floor, hall.radio_map, other.problem, plan, emit=print)


def test_an_error_of_the_listener_ends_the_run():
    """What `emit` raises, say a full disk, comes out as it is."""
    hall = make_hall(**SQUARE, errands=(((0, 0), (2, 0)),))

    def refuse(record):
        if isinstance(record, Sample):
            raise OSError("disk full")

    plan = make_plan(hall.problem, hall.walk("r0", (0, 0), (1, 0), (2, 0)))
    with pytest.raises(OSError, match="disk full"):
        run(*hall, plan, emit=refuse)
