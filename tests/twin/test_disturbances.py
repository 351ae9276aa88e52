"""Properties of disturbed runs on random tiny halls: the invariants of page 5 in every slot."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from logs.records import (
    Disturbance,
    Handover,
    Incident,
    Kpi,
    NewPath,
    Replan,
    RobotState,
    RunEnd,
    RunStart,
    Sample,
)
from planner.plan import Plan
from tests.twin.halls import Hall, make_hall, of_type, random_hall
from tests.twin.plans import grid, make_plan, make_problem, random_plan
from twin.association import Instants
from twin.disturbances import Disturbances, declare
from twin.errors import TwinError
from twin.order import StrictOrder, rotation, visit_order
from twin.twin import run
from worlds.errors import WorldError
from worlds.events import Delays, Event


def execute(hall: Hall, plan: Plan, **options) -> list:
    """The records of an execution."""
    records: list = []
    run(*hall, plan, emit=records.append, **options)
    return records


def disturbed(hall: Hall, events=(), delays=None, **options) -> Hall:
    """The hall with these disturbances and these keys of [run]."""
    world = declare(hall.world, [Event.model_validate(e) for e in events], delays)
    own = world.run.model_copy(update=options)
    return hall._replace(world=world.model_copy(update={"run": own}))


def check_invariants(hall: Hall, records: list) -> None:
    """Page 5, from the records alone.

    On edges of several slots a vertex counts as left once the edge is entered (§1.2), so bodies may
    come too near there even by plan: contacts are asked for on edges of one slot only.
    """
    problem = hall.problem
    last_s = 0.0
    slots: dict[int, dict[str, RobotState]] = defaultdict(dict)
    for r in records:
        assert r.t_s >= last_s - 1e-9, "time only grows"
        last_s = r.t_s
        if isinstance(r, RobotState):
            slots[r.slot].setdefault(r.robot, r)
    assert isinstance(records[0], RunStart)
    assert isinstance(records[-1], RunEnd)
    kinds = {i.kind for i in of_type(records, Incident)}
    assert "collision" not in kinds
    if (hall.problem.edge_slots == 1).all():
        assert "contact" not in kinds
    for slot in sorted(slots):
        states = [s for s in slots[slot].values() if s.activity != "gone"]
        for s in states:
            before = slots.get(slot - 1, {}).get(s.robot)
            if s.edge >= 0:
                ends = set(problem.edge_uv[s.edge].tolist())
                assert {s.vertex, s.next_vertex} == ends, "moves are edges of G"
            if before is not None and before.vertex != s.vertex:
                assert before.activity == "moving"
                assert s.vertex == before.next_vertex, "no teleport"
        on_edge = [s.edge for s in states if s.edge >= 0]
        assert len(on_edge) == len(set(on_edge)), "one robot per edge"
        standing = [s.vertex for s in states if s.edge < 0]
        assert len(standing) == len(set(standing)), "one robot per vertex"
    for sample in of_type(records, Sample):
        assert len(set(sample.robot)) == len(sample.robot)
        pairs = zip(sample.ap, sample.link, strict=True)
        assert all((ap >= 0) != (link == 3) for ap, link in pairs)


events = st.lists(
    st.one_of(
        st.builds(
            lambda ap, t, d: {"kind": "ap-outage", "ap": f"ap{ap}", "from_s": t, "to_s": t + d},
            st.integers(0, 2), st.floats(0, 40), st.floats(0.5, 60),
        ),
        st.builds(
            lambda x, y, t, d: {"kind": "blockage", "center_m": (x, y), "size_m": (1.5, 1.0),
                                "from_s": t, "to_s": t + d},
            st.floats(0, 14), st.floats(0, 12), st.floats(0, 40), st.floats(0.5, 60),
        ),
        st.builds(
            lambda x, y, u, v, t: {"kind": "blockage", "way_m": [(x, y), (u, v + 13.0)],
                                   "size_m": (1.8, 1.0), "from_s": t, "to_s": t + 40},
            st.floats(0, 14), st.floats(-0.9, 6), st.floats(0, 14), st.floats(-6, 0),
            st.floats(0, 40),
        ),
        st.builds(lambda i, t: {"kind": "robot-failure", "robot": f"r{i}", "from_s": t},
                  st.integers(0, 7), st.floats(0, 40)),
        st.builds(lambda i, t, d: {"kind": "delay", "robot": f"r{i}", "slot": t, "slots": d},
                  st.integers(0, 7), st.integers(0, 15), st.integers(1, 8)),
    ),
    max_size=4,
)  # fmt: skip


def named(found):
    """Events with names of their own; robots that take part."""
    return [e | {"name": f"event {k}"} for k, e in enumerate(found)]


def open_hall(hall: Hall) -> Hall:
    """The same with its robots listed, so that events can name them."""
    ids = hall.problem.robot_ids
    cells = hall.floor.vertex_cell
    robots = [
        {
            "id": name,
            "start": {"cell": cells[hall.floor.start[i]].tolist()},
            "goal": {"cell": cells[hall.floor.goal[i]].tolist()},
        }
        for i, name in enumerate(ids)
    ]
    data = hall.world.model_dump(exclude_none=True, exclude_defaults=True)
    data.pop("robots", None)
    return hall._replace(world=type(hall.world).model_validate(data | {"robot": robots}))


@settings(max_examples=12, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), events, st.booleans(), st.sampled_from(["leave", "park"]),
       st.sampled_from([0.0, 0.05, 0.2]), st.booleans())  # fmt: skip
def test_every_invariant_holds_in_every_slot(seed, found, slow, at_goal, p_delay, replan):
    """Page 5, whatever goes wrong, with edges of several slots, too; and the run always ends."""
    hall, plan = random_hall(seed, rule="endpoints", slow=slow, at_goal=at_goal)
    hall = open_hall(hall)
    ids = set(hall.problem.robot_ids)
    found = [e for e in named(found) if e.get("robot", "r0") in ids]
    hall = disturbed(hall, found, Delays(p_delay=p_delay, max_delay=4), replan=replan,
                     replan_after_s=4.0, replan_cooldown=2, replan_iterations=20)  # fmt: skip
    records = execute(hall, plan)
    check_invariants(hall, records)
    assert records[-1].slot <= 10 * hall.problem.horizon + 100


@settings(max_examples=8, deadline=None, derandomize=True)
@given(
    st.integers(0, 10**6),
    st.sampled_from(["leave", "park"]),
    st.booleans(),
    st.sampled_from(["bernoulli", "poisson"]),
    st.sampled_from(["uniform", "gaussian"]),
)
def test_delays_alone_stop_nobody_for_good(seed, at_goal, slow, event, time):
    """Group commit: no deadlock ever, everybody that has a path arrives, in the plan's order."""
    hall, plan = random_hall(seed, rule="endpoints", slow=slow, at_goal=at_goal)
    delays = Delays(p_delay=0.15, delay_event=event, delay_time=time, max_delay=6)
    records = execute(disturbed(hall, delays=delays, replan=False), plan)
    check_invariants(hall, records)
    kpi = of_type(records, Kpi)[-1]
    assert kpi.arrived == len(plan.paths) - len(plan.unserved)
    assert not [i for i in of_type(records, Incident) if i.kind == "deadlock"]


@settings(max_examples=4, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), events)
def test_the_same_seed_gives_the_same_records(seed, found):
    """Replanning is deterministic, too: limits are counts."""
    hall, plan = random_hall(seed, rule="endpoints")
    hall = open_hall(hall)
    found = [e for e in named(found) if e.get("robot", "r0") in set(hall.problem.robot_ids)]
    hall = disturbed(hall, found, Delays(p_delay=0.05), replan_after_s=2.0, replan_slip=3)
    assert execute(hall, plan) == execute(hall, plan)


@settings(max_examples=5, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.booleans())
def test_without_disturbances_the_run_is_the_plan(seed, slow):
    """Slot for slot; the KPIs are the plan's cost, and nothing is held, replanned or unplanned."""
    hall, plan = random_hall(seed, rule="endpoints", slow=slow)
    records = execute(hall, plan)
    kpi = of_type(records, Kpi)[-1]
    problem = hall.problem
    assert problem.c_t * kpi.travel_slots + problem.c_h * kpi.handovers == plan.cost
    assert kpi.makespan_slots == kpi.planned_makespan_slots
    assert (kpi.held_slots, kpi.unplanned_handovers, kpi.replans, kpi.delays) == (0, 0, 0, 0)
    assert not of_type(records, Disturbance, Replan, NewPath)


# --- random streams ---------------------------------------------------------------------------


def test_one_robot_more_shifts_nobody_elses_luck():
    """Each robot draws its delays from streams of its own."""
    drawn = []
    for robots in (3, 4):
        errands = [((k, 0), (7, 0)) for k in range(robots)]
        hall = make_hall(errands=errands, plan={"at_goal": "leave"})
        hall = disturbed(hall, delays=Delays(p_delay=0.2))
        source = Disturbances(hall.world, hall.problem, Instants.of(2.0, 5))
        drawn.append([source.delays(t) for t in range(600)])
    three, four = drawn
    assert any(three)
    assert three == [[d for d in slot if d[0] < 3] for slot in four]


@pytest.mark.parametrize("time", ["uniform", "gaussian"])
def test_delays_are_as_frequent_and_as_long_as_declared(time):
    """p_delay per robot-slot; lengths between the two ends, their mean in the middle."""
    hall = make_hall(errands=[((k, 0), (7, 0)) for k in range(6)])
    delays = Delays(p_delay=0.1, delay_time=time, min_delay=2, max_delay=8)
    source = Disturbances(disturbed(hall, delays=delays).world, hall.problem, Instants.of(2.0, 5))
    lengths = [length for t in range(3000) for _, length, _ in source.delays(t)]
    assert len(lengths) / 18000 == pytest.approx(0.1, abs=0.01)
    assert (min(lengths), max(lengths)) == (2, 8)
    assert np.mean(lengths) == pytest.approx(5.0, abs=0.15)


# --- strict order -----------------------------------------------------------------------------


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.booleans())
def test_strict_order_deadlocks_exactly_where_there_is_a_rotation(seed, slow):
    """It is refused then, and finishes otherwise; edges of several slots included."""
    rng = np.random.default_rng(seed)
    xy, edges = grid(3, 3)
    starts, goals = rng.permutation(9)[:7], rng.permutation(9)[:7]
    slots = rng.integers(1, 4, len(edges)).tolist() if slow else None
    problem = make_problem(xy, edges, list(zip(starts.tolist(), goals.tolist(), strict=True)),
                           slots=slots, horizon=40)  # fmt: skip
    order = visit_order(problem, random_plan(problem, rng))
    at, policy = np.zeros(7, np.int32), StrictOrder()
    for _ in range(400):
        ready = ~order.done(at) & ~order.gone(at)
        commit = policy.decide(order, at, ready)
        if not commit.advance.any():
            break
        at = at + commit.advance
    finished = bool((order.done(at) | order.gone(at)).all())
    assert finished == (rotation(order) is None)


def rotating():
    """Four robots around a square, each into the place the next one leaves."""
    hall = make_hall(
        size=(4.0, 4.0),
        aps=(("ap", (2.0, 2.0, 3.0)),),
        errands=(((0, 0), (1, 0)), ((1, 0), (1, 1)), ((1, 1), (0, 1)), ((0, 1), (0, 0))),
    )
    cells = [(0, 0), (1, 0), (1, 1), (0, 1)]
    paths = [hall.walk(f"r{k}", cells[k], cells[(k + 1) % 4]) for k in range(4)]
    return hall, make_plan(hall.problem, *paths)


def test_a_rotation_is_refused_by_name():
    """The message names the robots and the slot, and what to do."""
    hall, plan = rotating()
    strict = disturbed(hall, policy="strict")
    with pytest.raises(TwinError, match=r"slot 0: robots r0, r1, r2, r3 .*run\.policy = \"group\""):
        execute(strict, plan)
    assert execute(hall, plan)[-1].verdict == "completed"


@pytest.mark.parametrize("policy", ["group", "strict"])
def test_a_plan_without_any_path_is_over_at_once(policy):
    """Nobody is on the floor: the run has one slot, and says that nobody has arrived."""
    hall, plan = rotating()
    nobody = make_plan(hall.problem, *(None for _ in plan.paths))
    records = execute(disturbed(hall, policy=policy), nobody)
    assert (records[-1].slot, records[-1].verdict) == (0, "failed")
    assert len([i for i in of_type(records, Incident) if i.kind == "unserved"]) == 4


def test_strict_order_moves_into_empty_places_only():
    """A follower waits until the place ahead has been left: one slot later than group commit."""
    hall = make_hall(errands=(((1, 0), (7, 0)), ((0, 0), (6, 0))))
    paths = (
        hall.walk("r0", *[(c, 0) for c in range(1, 8)]),
        hall.walk("r1", *[(c, 0) for c in range(7)]),
    )
    records = execute(disturbed(hall, policy="strict"), make_plan(hall.problem, *paths))
    assert records[0].policy == "strict"
    held = [(s.slot, s.robot, s.waits_for, s.cause) for s in of_type(records, RobotState)
            if s.activity == "held"]  # fmt: skip
    assert held == [(0, "r1", "r0", "robot")]
    assert records[-1].slot == 7


# --- single disturbances ----------------------------------------------------------------------

CORRIDOR = {
    "size": (32.0, 2.0),
    "aps": (("west", (0.0, 1.0, 3.0)), ("east", (32.0, 1.0, 3.0))),
    "errands": (((0, 0), (15, 0)),),
}


def corridor(**options):
    """One robot along a corridor whose middle both APs cover."""
    hall = make_hall(**CORRIDOR, **options)
    path = hall.walk("r0", *[(c, 0) for c in range(16)], aps=["west"] * 8 + ["east"] * 8)
    return hall, make_plan(hall.problem, path)


def test_a_robot_without_connection_drives_what_was_released_to_it():
    """`release_horizon` positions after the last slot with a connection, then it stops."""
    hall, plan = corridor()
    out = {"kind": "ap-outage", "ap": "west", "from_s": 4.0, "to_s": 24.0}
    hall = disturbed(hall, [out], release_horizon=2, replan=False)
    records = execute(hall, plan)
    states = [s for s in of_type(records, RobotState) if s.t_s == s.slot * 2.0]
    assert [s.vertex for s in states[:8]] == [0, 1, 2, 3, 4, 4, 4, 4]
    assert {s.cause for s in states[4:12]} == {"connection"}
    assert records[-1].verdict == "completed"
    found = [(h.from_ap, h.to_ap, h.planned) for h in of_type(records, Handover)]
    assert found == [("", "west", False), ("west", "east", True)]
    kpi = of_type(records, Kpi)[-1]
    assert (kpi.unplanned_handovers, kpi.held_by_connection) == (1, kpi.held_slots)


def test_an_outage_where_another_ap_reaches_costs_a_handover_only():
    """Best server, after the time to trigger; the plan's AP is the one it ends with."""
    hall, plan = corridor()
    out = {"kind": "ap-outage", "ap": "west", "from_s": 13.5, "to_s": 60.0}
    records = execute(disturbed(hall, [out], replan=False), plan)
    handovers = of_type(records, Handover)
    assert [(h.from_ap, h.to_ap, h.planned) for h in handovers] == [("", "east", False)]
    assert of_type(records, Kpi)[-1].held_slots == 0
    assert records[-1].verdict == "completed"


def test_a_blockage_that_stands_holds_and_one_that_goes_releases():
    """Robots hold before it, whoever waits behind says for whom, and go on when it is gone."""
    hall, plan = corridor()
    box = {"kind": "blockage", "name": "box", "center_m": (13.0, 1.0), "size_m": (1.0, 1.0),
           "from_s": 2.0, "to_s": 30.0}  # fmt: skip
    records = execute(disturbed(hall, [box]), plan)
    assert records[-1].verdict == "completed"
    held = {s.vertex for s in of_type(records, RobotState) if s.activity == "held"}
    assert held <= {0, 1, 2, 3, 4, 5}
    replans = of_type(records, Replan)
    assert replans[0].cause == "blockage"
    assert not replans[0].adopted  # there is no other way


def test_a_robot_that_fails_ends_the_run_when_the_others_are_home():
    """It is named in the verdict; no deadlock is told, for nobody waits for anything."""
    hall, plan = corridor()
    fails = {"kind": "robot-failure", "robot": "r0", "from_s": 5.0}
    records = execute(disturbed(hall, [fails]), plan)
    end = records[-1]
    assert (end.verdict, end.slot) == ("failed", 3)
    assert "r0" in end.message
    assert "failed" in end.message
    assert not [i for i in of_type(records, Incident) if i.kind == "deadlock"]


def test_the_watchdog_names_the_reason_and_ends_the_run():
    """An AP that never comes back: deadlock is told once, a new plan asked for, then it ends."""
    hall, plan = corridor()
    out = {"kind": "ap-outage", "ap": "west", "from_s": 0.0}
    records = execute(disturbed(hall, [out], release_horizon=1), plan)
    dead = [i for i in of_type(records, Incident) if i.kind == "deadlock"]
    assert len(dead) == 1
    assert "r0: connection" in dead[0].message
    assert [r.cause for r in of_type(records, Replan)][-1] == "deadlock"
    assert records[-1].verdict == "failed"


def test_delays_of_robots_without_a_way_keep_no_run_going():
    """Behind a robot that has failed nobody gets on, late or not: the run is over, not drawn out.

    Nor is a new plan asked for again and again because of a slip of nobody's arrival.
    """
    hall = make_hall(size=(16.0, 2.0), errands=(((0, 0), (6, 0)), ((1, 0), (7, 0))))
    plan = make_plan(
        hall.problem,
        hall.walk("r0", *[(c, 0) for c in range(7)]),
        hall.walk("r1", *[(c, 0) for c in range(1, 8)]),
    )
    fails = {"kind": "robot-failure", "robot": "r1", "from_s": 4.0}
    hall = disturbed(hall, [fails], Delays(p_delay=0.5, max_delay=3), replan_slip=1,
                     replan_cooldown=1, replan_after_s=0.0)  # fmt: skip
    records = execute(hall, plan)
    end = records[-1]
    assert end.verdict == "failed"
    assert end.slot < 30
    assert len(of_type(records, Replan)) < 15
    assert "deadlock" in {i.kind for i in of_type(records, Incident)}


def test_a_run_ends_at_max_slots():
    """Whatever lasts longer is cut off, with a complete end."""
    hall, plan = corridor()
    late = {"kind": "delay", "robot": "r0", "slot": 1, "slots": 500}
    records = execute(disturbed(hall, [late], max_slots=20), plan)
    assert (records[-1].slot, records[-1].verdict) == (19, "failed")
    assert "limit of 20 slots" in records[-1].message
    assert len(of_type(records, Kpi)) == 20


def test_robots_shade_each_other_only_if_asked_for():
    """`run.robots_block`: the body of one in the ray of the other costs line of sight."""
    options = {"hall": {"body": {"height_m": 1.8, "antenna_m": 0.9}}}
    hall = make_hall(size=(20.0, 2.0), aps=(("west", (0.0, 1.0, 1.2)),),
                     errands=(((3, 0), (3, 0)), ((6, 0), (6, 0))),
                     plan={"at_goal": "park"}, **options)  # fmt: skip
    plan = make_plan(hall.problem, hall.walk("r0", (3, 0)), hall.walk("r1", (6, 0)))
    clear = of_type(execute(hall, plan), Sample)[0]
    shaded = of_type(execute(disturbed(hall, robots_block=True), plan), Sample)[0]
    assert shaded.snr_db[0] == clear.snr_db[0]
    assert shaded.snr_db[1] < clear.snr_db[1] - 5.0


def test_a_fork_lift_shades_who_is_behind_it():
    """Blockages are bodies in the scene: SNR drops while it is between robot and AP."""
    hall = make_hall(size=(20.0, 8.0), aps=(("west", (0.0, 1.0, 1.5)),),
                     errands=(((6, 0), (7, 0)),))  # fmt: skip
    path = hall.walk("r0", *[(6, 0)] * 8, (7, 0))
    lift = {"kind": "blockage", "way_m": [(6.0, 7.0), (6.0, -1.0)], "size_m": (2.0, 1.2),
            "from_s": 1.0, "to_s": 12.0, "height_m": 2.5}  # fmt: skip
    records = execute(disturbed(hall, [lift]), make_plan(hall.problem, path))
    levels = {s.t_s: s.snr_db[0] for s in of_type(records, Sample) if s.robot}
    assert levels[7.0] < levels[0.0] - 5.0
    assert levels[13.0] == levels[0.0]


def test_faults_of_passed_disturbances_are_told():
    """A list that does not suit the world is refused like a file."""
    hall, _ = corridor()
    wrong = Event.model_validate({"kind": "ap-outage", "ap": "wset"})
    with pytest.raises(WorldError, match=r"event\[0\]\.ap: 'wset'.*did you mean 'west'"):
        declare(hall.world, [wrong])
