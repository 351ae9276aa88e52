"""Key figures: the fold against a literal computation, one interval at a time, in exact numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from logs.distribution import Distribution
from logs.kpi import KpiFold
from logs.records import (
    HELD,
    LINKS,
    MOVING,
    WAITING,
    ApLoad,
    Arrival,
    Handover,
    Incident,
    Kpi,
    Record,
    RobotKpi,
    RobotState,
    RunStart,
    Sample,
    Separation,
)
from tests.logs.good_logs import POST_WORLD, log_of
from tests.logs.tamper import records

SLOT_S = 3.0
STEP_S = 0.75
THRESHOLD_DB = 10.0
CONNECTED, HANDOVER, OUTAGE, NO_AP = range(4)


def start(robots: int = 2, aps: tuple[int, ...] = (2, 3)) -> RunStart:
    """A run of that many robots and of APs of these capacities."""
    return RunStart(
        t_s=0.0,
        world="fabricated",
        slot_s=SLOT_S,
        horizon=20,
        samples_per_slot=4,
        interruption_s=0.07,
        threshold_db=THRESHOLD_DB,
        policy="group-commit",
        at_goal="leave",
        seed=0,
        robots=tuple(f"r{i}" for i in range(robots)),
        aps=tuple(f"ap{a}" for a in range(len(aps))),
        ap_capacity=aps,
    )


Entry = tuple[int, int, float, float, int, float]
"""robot, AP, SNR, predicted SNR, link, rate."""


def sample(t_s: float, *entries: Entry) -> Sample:
    """A sample at `t_s`; where a robot stands does not matter to a figure."""
    robot, ap, snr, predicted, link, rate = zip(*entries, strict=True) if entries else ((),) * 6
    nowhere = (0.0,) * len(entries)
    slot = int(t_s / SLOT_S)
    return Sample(
        t_s, slot, robot, nowhere, nowhere, nowhere, ap, snr, predicted, link, rate
    )  # fmt: skip


def handover(t_s: float, end_s: float, robot: str = "r0", out: str = "ap0", to: str = "ap1"):
    """A planned handover."""
    slot = int(t_s / SLOT_S)
    return Handover(t_s, slot, robot, out, to, 0, 1, 0.0, 0.0, end_s, True)


def state(slot: int, robot: str, activity: str, *, t_s: float | None = None, link: str = LINKS[0]):
    """A robot's state, at the beginning of the slot unless told."""
    t_s = slot * SLOT_S if t_s is None else t_s
    return RobotState(t_s, slot, robot, 0, 0, -1, 0, activity, "", "ap0", link, 20.0, 700.0)


def fold(records: list[Record], robots: int = 2, planned=(("r0", 5, 1), ("r1", 4, 0))) -> KpiFold:
    """A fold that has been given these records."""
    kpis = KpiFold(start(robots), planned)
    for record in records:
        kpis.add(record)
    return kpis


def p10(spent: dict[Fraction, Fraction]) -> float:
    """The least rate that at least a tenth of the time has at most."""
    total, reached = sum(spent.values()), Fraction(0)
    for rate in sorted(spent):
        reached += spent[rate]
        if spent[rate] and 10 * reached >= total:
            return float(rate)
    return 0.0


def literal(
    samples: list[Sample], handovers: list[Handover], robots: int, states: Sequence[RobotState] = ()
) -> list[dict]:
    """Each robot's times, data and P10 by the rules at the head of logs/kpi.py, in fractions.

    Robot i is called `r{i}`.
    """
    results = []
    for i in range(robots):
        own = [h for h in handovers if h.robot == f"r{i}"]
        busy = [(Fraction(h.t_s), Fraction(h.end_s)) for h in own]
        time = dict.fromkeys(("connected", "handover", "outage"), Fraction(0))
        data, worst, current = Fraction(0), Fraction(0), Fraction(0)
        spent: dict[Fraction, Fraction] = {}
        for here, there in pairwise(samples):
            if i not in here.robot:
                continue
            k = here.robot.index(i)
            a, b = Fraction(here.t_s), Fraction(there.t_s)
            cuts = sorted({a, b, *(min(max(x, a), b) for span in busy for x in span)})
            h = sum(
                (v - u for u, v in pairwise(cuts) if any(x <= u and v <= y for x, y in busy)),
                Fraction(0),
            )
            link, rate = here.link[k], Fraction(here.rate_mbps[k])
            if link == HANDOVER:
                link = CONNECTED if here.snr_db[k] >= THRESHOLD_DB else OUTAGE
                for s in states:
                    if s.robot == f"r{i}" and a < s.t_s < b and s.link != LINKS[HANDOVER]:
                        link, rate = LINKS.index(s.link), Fraction(s.rate_mbps)
            rest = b - a - h
            time["handover"] += h
            time["connected" if link == CONNECTED else "outage"] += rest
            current = Fraction(0) if link == CONNECTED else current + rest
            worst = max(worst, current)
            data += rate * rest
            spent[rate] = spent.get(rate, Fraction(0)) + rest
            spent[Fraction(0)] = spent.get(Fraction(0), Fraction(0)) + h
        results.append(
            {f"{name}_s": float(value) for name, value in time.items()}
            | {"worst_outage_s": float(worst), "delivered_mbit": float(data), "p10": p10(spent)}
        )
    return results


@st.composite
def runs(draw: st.DrawFn) -> tuple[int, list[Sample], list[Handover]]:
    """Up to 3 robots and 12 samples, with interruptions from 0 to several samples, overlapping."""
    robots = draw(st.integers(1, 3))
    links = st.integers(0, 3)
    samples = []
    for k in range(draw(st.integers(1, 12))):
        entries: list[Entry] = []
        for i in range(robots):
            if draw(st.integers(0, 4)):  # else it is not on the floor
                link = draw(links)
                snr = draw(st.sampled_from([5.0, 9.99, 10.0, 25.5]))
                rate = draw(st.sampled_from([0.0, 10.5, 100.0, 333.25, 2000.0]))
                entries.append((i, -1 if link == NO_AP else 0, snr, snr + 1.0, link, rate))
        samples.append(sample(k * STEP_S, *entries))
    handovers = []
    for _ in range(draw(st.integers(0, 5))):
        begin = draw(st.integers(0, 12 * 16)) * STEP_S / 16
        length = draw(st.sampled_from([0.0, 0.07, 0.5, 0.75, 2.0]))
        robot = draw(st.integers(0, robots - 1))
        handovers.append(handover(begin, begin + length, robot=f"r{robot}"))
    handovers = [h for h in handovers if h.t_s <= samples[-1].t_s]
    return robots, samples, handovers


@settings(max_examples=80, deadline=None)
@given(runs(), st.randoms(use_true_random=False))
def test_times_equal_a_literal_computation(run, random) -> None:
    """Times, data, worst outage and P10 of any run equal those of the definition, whenever asked.

    Records at the same instant may come in any order, and asking in between changes nothing.
    """
    robots, samples, handovers = run
    records: list[Record] = [*samples, *handovers]
    random.shuffle(records)
    records.sort(key=lambda record: record.t_s)
    kpis = KpiFold(start(robots), [])
    for record in records:
        kpis.add(record)
        if random.random() < 0.3:
            kpis.current(record.t_s, int(record.t_s / SLOT_S))
    end = samples[-1].t_s
    expected = literal(samples, handovers, robots)
    for figure, own in zip(kpis.final(end, 3)[:robots], expected, strict=True):
        for name, value in own.items():
            assert getattr(figure, name.replace("p10", "p10_rate_mbps")) == pytest.approx(
                value, abs=1e-9
            ), name
    whole = kpis.current(end, 3)
    for name in ("connected_s", "handover_s", "outage_s", "delivered_mbit"):
        assert getattr(whole, name) == pytest.approx(sum(own[name] for own in expected), abs=1e-9)
    assert whole.worst_outage_s == pytest.approx(max(own["worst_outage_s"] for own in expected))


@settings(max_examples=60, deadline=None)
@given(runs())
def test_times_add_up_to_the_time_on_the_floor(run) -> None:
    """Connected, handover and outage together are each robot's time on the floor."""
    robots, samples, handovers = run
    records = sorted([*samples, *handovers], key=lambda record: record.t_s)
    kpis = KpiFold(start(robots), [])
    for record in records:
        kpis.add(record)
    for i, own in enumerate(kpis.final(samples[-1].t_s, 3)[:robots]):
        on_floor = sum(b.t_s - a.t_s for a, b in pairwise(samples) if i in a.robot)
        assert own.connected_s + own.handover_s + own.outage_s == pytest.approx(on_floor, abs=1e-9)


def test_an_interruption_is_taken_from_the_interval_it_falls_into() -> None:
    """0.07 s of handover leave 0.68 s of a 0.75 s interval, and its data with it."""
    served = (0, 0, 20.0, 20.0, CONNECTED, 100.0)
    kpis = fold([sample(0.0, served), handover(0.3, 0.37), sample(0.75, served)])
    now = kpis.current(0.75, 0)
    assert now.handover_s == pytest.approx(0.07)
    assert now.connected_s == pytest.approx(0.68)
    assert now.delivered_mbit == pytest.approx(68.0)


def test_a_sample_within_a_handover_does_not_speak_for_what_follows() -> None:
    """After a handover that hides a sample, link and rate are those of the state at its end."""
    hidden = (0, 0, 20.0, 20.0, HANDOVER, 0.0)
    records = [
        sample(0.0, hidden),
        handover(0.0, 0.07),
        state(0, "r0", MOVING, t_s=0.07),
        sample(0.75, (0, 1, 20.0, 20.0, CONNECTED, 100.0)),
    ]
    assert fold(records).current(0.75, 0).delivered_mbit == pytest.approx(700.0 * 0.68)
    lost = fold([*records[:2], state(0, "r0", MOVING, t_s=0.07, link="outage"), records[3]])
    assert lost.current(0.75, 0).outage_s == pytest.approx(0.68)


def test_a_state_at_a_sample_does_not_replace_it() -> None:
    """States change link and rate only where a sample was hidden by a handover."""
    served = (0, 0, 20.0, 20.0, CONNECTED, 100.0)
    records = [sample(0.0, served), state(0, "r0", MOVING, t_s=0.2), sample(0.75, served)]
    assert fold(records).current(0.75, 0).delivered_mbit == pytest.approx(75.0)


def test_figures_of_a_run_equal_a_literal_computation() -> None:
    """The figures in the log of a run are those of its own samples, handovers and states."""
    run = records(log_of(world=POST_WORLD))
    names = next(r for r in run if isinstance(r, RunStart)).robots
    number = {name: f"r{i}" for i, name in enumerate(names)}
    run = [
        replace(r, robot=number[r.robot]) if getattr(r, "robot", 0) in number else r for r in run
    ]
    of = {
        kind: [r for r in run if type(r) is kind]
        for kind in (Sample, Handover, RobotState, RobotKpi)
    }
    expected = literal(of[Sample], of[Handover], len(names), of[RobotState])
    assert sum(own["handover_s"] for own in expected) > 0
    assert sum(own["outage_s"] for own in expected) > 0
    for figure, own in zip(of[RobotKpi], expected, strict=True):
        for name, value in own.items():
            found = getattr(figure, name.replace("p10", "p10_rate_mbps"))
            assert found == pytest.approx(value, abs=1e-9), name


def test_counts() -> None:
    """Arrivals, travel, waits, loads, clearance, map error and incidents are counted as defined."""
    records: list[Record] = [
        sample(0.0, (0, 0, 20.0, 21.0, CONNECTED, 1.0), (1, -1, -1000.0, -1000.0, NO_AP, 0.0)),
        state(0, "r0", MOVING),
        state(0, "r0", HELD, t_s=1.0),  # the same slot: only its first state counts
        state(0, "r1", HELD),
        ApLoad(0.0, 0, "ap0", 3, 2),
        ApLoad(0.0, 0, "ap1", 3, 3),
        Separation(0.0, 0, -1000.0, "", ""),
        state(1, "r0", WAITING),
        state(1, "r1", HELD),
        ApLoad(3.0, 1, "ap0", 0, 2),
        ApLoad(3.0, 1, "ap1", 1, 3),
        Separation(3.0, 1, 0.4, "r0", "r1"),
        handover(3.0, 3.07),
        Arrival(3.0, 1, "r1", 4),
        sample(3.0, (0, 0, 20.0, 17.5, CONNECTED, 1.0)),
        Incident(3.0, 1, "overload", "", "", "ap0", 3.0, "AP ap0 serves 3 robots, capacity 2"),
    ]
    kpis = fold(records)
    now = kpis.current(6.0, 1)
    assert now == Kpi(
        t_s=6.0,
        slot=1,
        robots=2,
        arrived=1,
        makespan_slots=1,
        travel_slots=2 + 1,  # r0 is under way until the end of slot 1, r1 arrived in slot 1
        planned_travel_slots=9,
        handovers=1,
        planned_handovers=1,
        held_slots=2,
        connected_s=pytest.approx(3.0 + 2.93),
        handover_s=pytest.approx(0.07),
        outage_s=3.0,
        worst_outage_s=3.0,
        peak_load=3,
        peak_load_share=1.5,
        overload_robot_slots=1,
        delivered_mbit=pytest.approx(5.93),
        p10_rate_mbps=0.0,
        min_clearance_m=0.4,
        map_error_mean_db=pytest.approx((1.0 - 2.5) / 2),
        map_error_max_db=2.5,
        incidents=1,
        planned_makespan_slots=5,
    )
    r0, r1, ap0, ap1 = kpis.final(6.0, 1)
    assert (r0.arrived, r0.travel_slots, r0.waiting_slots, r0.held_slots) == (False, 2, 1, 0)
    assert (r1.arrived, r1.travel_slots, r1.waiting_slots, r1.held_slots) == (True, 1, 0, 2)
    assert (ap0.mean_load, ap0.peak_load, ap0.overload_robot_slots) == (1.5, 3, 1)
    assert (ap1.mean_load, ap1.peak_load, ap1.overload_robot_slots) == (2.0, 3, 0)
    assert (ap0.handovers_out, ap0.handovers_in) == (1, 0)
    assert (ap1.handovers_out, ap1.handovers_in) == (0, 1)


def test_nothing_happened_yet() -> None:
    """Before anything happens every figure is defined."""
    kpis = fold([])
    now = kpis.current(0.0, -1)
    assert (now.travel_slots, now.p10_rate_mbps, now.min_clearance_m) == (0, 0.0, -1000.0)
    assert [figure.p10_rate_mbps for figure in kpis.final(0.0, -1)[:2]] == [0.0, 0.0]


def test_robots_without_a_path_travel_no_slots() -> None:
    """A robot the plan does not serve counts as a robot, but neither travels nor arrives."""
    now = fold([], planned=[("r0", 5, 1)]).current(9.0, 2)
    assert (now.robots, now.travel_slots, now.planned_travel_slots) == (2, 3, 5)


def test_switched_off_ap_has_a_defined_share() -> None:
    """A load on an AP of capacity 0 counts as over capacity, its share over 1."""
    kpis = KpiFold(start(1, (0,)), [])
    kpis.add(ApLoad(0.0, 0, "ap0", 2, 0))
    now = kpis.current(3.0, 0)
    assert (now.peak_load, now.peak_load_share, now.overload_robot_slots) == (2, 2.0, 2)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.lists(st.tuples(st.integers(0, 30), st.integers(0, 8)), max_size=40), max_size=12),
    st.sampled_from([1, 7, 1 << 14]),
)
def test_percentile_of_a_growing_distribution(parts, recent) -> None:
    """P10 equals its definition after every addition, however the values are kept."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("logs.distribution._RECENT", recent)
        rates = Distribution()
        spent: dict[Fraction, Fraction] = {}
        for part in parts:
            rates.add(
                np.array([v for v, _ in part], float), np.array([w / 8 for _, w in part], float)
            )
            for value, weight in part:
                key = Fraction(value)
                spent[key] = spent.get(key, Fraction(0)) + Fraction(weight, 8)
            assert rates.percentile_10() == p10(spent)
