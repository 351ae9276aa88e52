"""Disturbed runs on lanes of one to several slots, from the world to the validated log.

Here edges of k ≥ 2 slots are real ones: made by the length and speed of lanes, drawn in the scene,
logged, and checked by a validator that knows nothing of the twin.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from logs.findings import Report
from logs.mcap_reader import read
from logs.mcap_writer import RunLog
from logs.records import Handover, Incident, Kpi, Record, Replan, RobotState
from logs.validate import validate
from planner.plan import Plan
from planner.solve import SolveParams, solve
from tests.twin.halls import of_type
from tests.twin.lanes import random_layout
from twin.errors import TwinError
from twin.instance import Instance, survey
from twin.order import rotation, visit_order
from twin.twin import run
from worlds.events import Delays, Event
from worlds.generate import resolve
from worlds.world import RunOptions, World

ROBOTS = 7


def planned(world: World) -> tuple[Instance, Plan]:
    """The world's instance and a plan; some of its edges take several slots."""
    instance = survey(world, resolve(world))
    assert instance.problem.edge_slots.max() > 1
    return instance, solve(instance.problem, SolveParams(method="cooperative"))


def logged(instance: Instance, plan: Plan) -> tuple[list[Record], Report]:
    """The records of a run as they are read from its log, and what is found in it."""
    inputs = {
        "floor": instance.floor,
        "radio_map": instance.radio_map,
        "problem": instance.problem,
        "plan": plan,
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        with RunLog(path, world=instance.world, **inputs) as log:
            run(instance.world, **inputs, emit=log.write)
        return list(read(path).records), validate(path)


def on_edges(records: list[Record]) -> set[int]:
    """Edges in the states of a run."""
    return {s.edge for s in of_type(records, RobotState) if s.edge >= 0}


def an_event(draw) -> dict[str, object]:
    """One thing that goes wrong somewhere on the floor, some time in the first half."""
    begins, lasts = draw(st.floats(0, 50)), draw(st.floats(1, 60))
    spot = (draw(st.floats(2, 22)), draw(st.floats(2, 16)))
    robot = f"r{draw(st.integers(0, ROBOTS - 1)):02d}"
    span = {"from_s": begins, "to_s": begins + lasts}
    kind = draw(st.sampled_from(["ap-outage", "box", "fork-lift", "robot-failure", "delay"]))
    if kind == "ap-outage":
        return {"kind": kind, "ap": draw(st.sampled_from(["west", "east"])), **span}
    if kind == "box":
        return {"kind": "blockage", "center_m": spot, "size_m": (1.5, 1.0), **span}
    if kind == "fork-lift":
        way = [spot, (24.0 - spot[0], 1.0), (1.0, 17.0 - spot[1])]
        return {"kind": "blockage", "way_m": way, "size_m": (1.8, 1.0), **span}
    if kind == "robot-failure":
        return {"kind": kind, "robot": robot, "from_s": begins}
    return {"kind": kind, "robot": robot, "slot": draw(st.integers(0, 20)),
            "slots": draw(st.integers(1, 12))}  # fmt: skip


@st.composite
def bad_days(draw) -> World:
    """Lanes that are wide enough for the robots, and what goes wrong on them."""
    events = [an_event(draw) for _ in range(draw(st.integers(0, 4)))]
    return random_layout(
        2 * draw(st.integers(0, 10_000)),
        event=tuple(Event.model_validate(e | {"name": f"e{k}"}) for k, e in enumerate(events)),
        delays=Delays(p_delay=draw(st.sampled_from([0.0, 0.05, 0.2])), max_delay=5),
        run=RunOptions(
            replan=draw(st.booleans()),
            replan_after_s=4.0,
            replan_cooldown=2,
            replan_slip=draw(st.sampled_from([3, 20])),
            replan_iterations=20,
            release_horizon=draw(st.integers(1, 3)),
            interruption=draw(st.sampled_from([0.0, 70.0, 2500.0])),
            max_slots=300,
        ),
    )


@settings(max_examples=9, deadline=None, derandomize=True)
@given(bad_days())
def test_whatever_goes_wrong_the_log_is_valid(world):
    """Every invariant of page 5 in every slot, and §1.1–§1.3 and §1.6 for crossings of k slots."""
    instance, plan = planned(world)
    records, report = logged(instance, plan)
    assert report.findings == ()
    assert not report.skipped
    kinds = {i.kind for i in of_type(records, Incident)}
    assert not kinds & {"collision", "contact", "obstacle"}
    assert (instance.problem.edge_slots[sorted(on_edges(records))] > 1).any()


@settings(max_examples=5, deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.sampled_from(["bernoulli", "poisson"]))
def test_delays_alone_keep_nobody_from_arriving(seed, event):
    """Group commit with crossings of k slots: everybody that has a path arrives, none collides."""
    delays = Delays(p_delay=0.25, delay_event=event, max_delay=6)
    instance, plan = planned(random_layout(2 * seed, delays=delays, run=RunOptions(replan=False)))
    records, report = logged(instance, plan)
    assert report.findings == ()
    end = of_type(records, Kpi)[-1]
    assert end.arrived == sum(path is not None for path in plan.paths)
    assert end.delays > 0
    assert "deadlock" not in {i.kind for i in of_type(records, Incident)}


@settings(max_examples=5, deadline=None, derandomize=True)
@given(st.integers(0, 10_000))
def test_strict_order_refuses_rotations_and_nothing_else(seed):
    """A plan without one is executed to its end, however late robots are, and logged validly."""
    world = random_layout(
        2 * seed, delays=Delays(p_delay=0.1), run=RunOptions(replan=False, policy="strict")
    )
    instance, plan = planned(world)
    if rotation(visit_order(instance.problem, plan)) is not None:
        with pytest.raises(TwinError, match="rotation"):
            logged(instance, plan)
        return
    records, report = logged(instance, plan)
    assert report.findings == ()
    assert of_type(records, Kpi)[-1].arrived == sum(path is not None for path in plan.paths)


def test_an_outage_amid_a_long_crossing_is_planned_around():
    """Both happen amid crossings of several slots: unplanned handovers, and new plans adopted."""
    unplanned = adopted = 0
    for seed in (0, 2, 4, 6):
        out = [
            {"kind": "ap-outage", "name": "west", "ap": "west", "from_s": 7.0, "to_s": 60.0},
            {"kind": "blockage", "name": "box", "center_m": (12.0, 9.0), "size_m": (2.0, 2.0),
             "from_s": 5.0, "to_s": 90.0},
        ]  # fmt: skip
        world = random_layout(
            seed,
            event=tuple(map(Event.model_validate, out)),
            run=RunOptions(replan_after_s=2.0, replan_cooldown=2, time_to_trigger_s=0.4),
        )
        instance, plan = planned(world)
        records, report = logged(instance, plan)
        assert report.findings == ()
        crossing = {
            (s.slot, s.robot): instance.problem.edge_slots[s.edge] > 1
            for s in of_type(records, RobotState)
            if s.edge >= 0
        }
        unplanned += sum(
            crossing.get((h.slot, h.robot), False)
            for h in of_type(records, Handover)
            if not h.planned
        )
        adopted += sum(
            r.adopted and any(slot == r.slot for (slot, _), slow in crossing.items() if slow)
            for r in of_type(records, Replan)
        )
    assert unplanned > 0
    assert adopted > 0
