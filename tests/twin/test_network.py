"""When robots change their APs, and what their links do meanwhile (§1.6, §1.7)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from logs.records import Handover, Incident, Kpi, RobotKpi, RobotState, Sample
from planner.problem import problem_from_world
from tests.twin.halls import Hall, make_hall
from twin.association import Instants, handover_instants

CORRIDOR = {
    "size": (32.0, 2.0),
    "aps": (("west", (0.0, 1.0, 3.0)), ("east", (32.0, 1.0, 3.0))),
    "errands": (((6, 0), (8, 0)),),
}
"""16 positions; west covers those up to x = 17 m, east those from x = 15 m on."""

PILLAR = {"center_m": (2.0, 5.0), "size_m": (0.4, 0.4), "height_m": 3.0}
"""Between the AP of `HOLE` and the middle of the first edge, and nothing else."""

HOLE = {
    "size": (8.0, 10.0),
    "aps": (("ap", (2.0, 9.0, 3.0)),),
    "errands": (((0, 0), (2, 0)),),
    "obstacles": (PILLAR,),
    "radio": {"edge_rule": "endpoints"},
}


def only(records, record_type, /, **fields):
    """The records of a type with these values."""
    return [
        r
        for r in records
        if isinstance(r, record_type) and all(getattr(r, k) == v for k, v in fields.items())
    ]


# --- choosing the instant ---------------------------------------------------------------------


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.integers(1, 3), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_the_instant_of_a_handover_loses_the_fewest_instants(slots, steps, seed):
    """Brute force over all instants: fewest below, then the last slot, then b to the end, then
    the earliest.
    """
    rng = np.random.default_rng(seed)
    last = slots * steps
    below_a, below_b = rng.random((2, 7, last + 1)) < rng.choice([0.1, 0.5])
    found = handover_instants(below_a, below_b, steps)
    for a, b, chosen in zip(below_a.tolist(), below_b.tolist(), found.tolist(), strict=True):

        def worth(j, a=a, b=b):
            return sum(a[:j]) + sum(b[j:]), j <= last - steps, any(b[j:]), j

        assert chosen == min(range(1, last + 1), key=worth)


def with_edge(hall: Hall, cells, aps) -> Hall:
    """The hall with a map that says `aps` ("west": "11100", …) of the edge between two cells."""
    u, v = (int((hall.floor.vertex_cell == cell).all(axis=1).argmax()) for cell in sorted(cells))
    edge = int((hall.floor.edge_uv == (u, v)).all(axis=1).argmax())
    snr, edge_snr = hall.radio_map.snr_db.copy(), hall.radio_map.edge_snr_db.copy()
    for ap, covered in aps.items():
        a = hall.radio_map.ap_ids.index(ap)
        edge_snr[edge, :, a] = [30.0 if c == "1" else -30.0 for c in covered]
        snr[[u, v], a] = edge_snr[edge, [0, -1], a]
    edge_snr[:, [0, -1]] = snr[hall.floor.edge_uv]  # of the edges beside it, too
    radio_map = replace(hall.radio_map, snr_db=snr, edge_snr_db=edge_snr)
    return Hall(
        hall.world, hall.floor, radio_map, problem_from_world(hall.world, hall.floor, radio_map)
    )


@pytest.mark.parametrize(
    ("west", "east", "step"),
    [
        ("11111", "11111", 1),  # anywhere: the first instant after the slot's beginning
        ("11100", "00111", 2),  # as soon as east holds to the end
        ("11000", "00111", 2),  # no choice
        ("11110", "00001", 4),  # at the very end of the slot
        ("10000", "01111", 1),
        ("10100", "01011", 3),  # alternating: one instant is lost whatever is done
    ],
)
@pytest.mark.parametrize("backwards", [False, True])
def test_a_crossing_hands_over_where_the_map_says(west, east, step, backwards):
    """§1.7: a up to some sample, b from there on, whichever way the edge is driven."""
    hall = with_edge(make_hall(**CORRIDOR, radio={"edge_rule": "endpoints"}), [(6, 0), (7, 0)],
                     {"west": west, "east": east} if not backwards else
                     {"west": east[::-1], "east": west[::-1]})  # fmt: skip
    cells, aps = [(6, 0), (7, 0)], ["west", "east"]
    if backwards:
        cells, aps = cells[::-1], aps[::-1]
    problem = hall.problem
    at_start, at_goal = (hall.vertex(*cell) for cell in cells)
    problem = replace(problem, start=np.array([at_start]), goal=np.array([at_goal]))
    hall = hall._replace(problem=problem)
    records = hall.run(hall.walk("r0", *cells, aps=aps))
    (handover,) = only(records, Handover)
    assert (handover.from_ap, handover.to_ap, handover.slot) == (*aps, 0)
    assert handover.t_s == step * 0.5
    assert handover.end_s == pytest.approx(handover.t_s + 0.1)
    x = [13.0, 15.0][:: -1 if backwards else 1]
    assert handover.x_m == pytest.approx(x[0] + step / 4 * (x[1] - x[0]))
    served = [s.ap[0] for s in only(records, Sample) if s.robot][:5]
    names = [problem.ap_ids[a] for a in served]
    assert names == [aps[0]] * step + [aps[1]] * (5 - step)


def test_robots_whose_links_change_at_one_instant_are_told_in_their_order():
    """Also where the later one in order was scheduled first: numbers decide, not who asked when."""
    errands = (((6, 0), (7, 0)), ((9, 0), (10, 0)))
    hall = make_hall(
        **{**CORRIDOR, "errands": errands}, radio={"edge_rule": "endpoints"},
        run={"interruption": 500.0},
    )  # fmt: skip
    hall = with_edge(hall, [(6, 0), (7, 0)], {"west": "11111", "east": "11111"})
    hall = with_edge(hall, [(9, 0), (10, 0)], {"west": "11000", "east": "00111"})
    records = hall.run(
        hall.walk("r0", (6, 0), (7, 0), aps=["west", "east"]),
        hall.walk("r1", (9, 0), (10, 0), aps=["west", "east"]),
    )
    now = [r for r in records if r.t_s == 1.0]
    told = [(type(r).__name__, r.robot) for r in now if isinstance(r, RobotState | Handover)]
    assert told == [("RobotState", "r0"), ("Handover", "r1"), ("RobotState", "r1")]


def slow_hall(west, east, k=3):
    """The corridor with an edge of k slots, on which the map says this at its five samples."""
    hall = make_hall(**CORRIDOR, radio={"edge_rule": "endpoints"})
    slots = np.ones(len(hall.floor.edge_uv), np.int32)
    slots[6] = k
    hall = hall._replace(floor=replace(hall.floor, edge_slots=slots))
    hall = with_edge(hall, [(6, 0), (7, 0)], {"west": west, "east": east})
    problem = replace(hall.problem, goal=np.array([hall.vertex(7, 0)]))
    return hall._replace(problem=problem)


def test_on_a_slow_edge_the_ap_of_the_vertex_left_serves_until_the_last_slot():
    """§1.6: it serves, and is loaded, until arrival, if the map allows it."""
    hall = slow_hall("11111", "11111")
    records = hall.run(hall.walk("r0", (6, 0), (7, 0), aps=["west", "east"]))
    (handover,) = only(records, Handover)
    assert (handover.slot, handover.t_s) == (2, 4.5)


def test_on_a_slow_edge_the_handover_comes_earlier_where_that_keeps_the_connection():
    """§1.7 before §1.6: the first quarter is west's only, the rest east's only.

    With three slots of four steps, sample fraction 1/4 is instant 3 and fraction 1/2 instant 6; the
    map is linear in between and falls below the threshold after instant 3.
    """
    hall = slow_hall("11000", "00111")
    records = hall.run(hall.walk("r0", (6, 0), (7, 0), aps=["west", "east"]))
    (handover,) = only(records, Handover)
    assert handover.slot == 1
    assert 2.0 < handover.t_s <= 3.0
    # The load stays with the vertex left until arrival all the same.
    loads = [(r.slot, r.ap) for r in records if type(r).__name__ == "ApLoad" and r.load]
    assert loads == [(0, "west"), (1, "west"), (2, "west"), (3, "east")]
    aps = [hall.problem.ap_ids[s.ap[0]] for s in only(records, Sample) if s.robot]
    changed = aps.index("east")
    assert aps == ["west"] * changed + ["east"] * (len(aps) - changed)


def test_a_waiting_robot_hands_over_just_after_the_beginning_of_the_slot():
    """The slot's first instant still shows the AP of the plan; the next one the new one."""
    hall = make_hall(**CORRIDOR)
    cells = [(6, 0), (7, 0), (7, 0), (8, 0)]
    records = hall.run(hall.walk("r0", *cells, aps=["west", "west", "east", "east"]))
    (handover,) = only(records, Handover)
    assert (handover.slot, handover.t_s) == (1, 2.5)
    assert handover.vertex == handover.next_vertex == hall.vertex(7, 0)
    assert [s.ap[0] for s in only(records, Sample, slot=1)] == [0, 1, 1, 1]
    assert only(records, Kpi)[-1].map_error_max_db == pytest.approx(0.0, abs=1e-9)


# --- links ------------------------------------------------------------------------------------


def links(records):
    """(time, AP, link) of each state."""
    return [(round(r.t_s, 6), r.ap, r.link) for r in only(records, RobotState)]


def test_the_link_is_interrupted_for_as_long_as_the_world_says():
    """States, samples and KPIs of a handover of 100 ms that starts with a sample."""
    hall = make_hall(**CORRIDOR)
    records = hall.run(hall.walk("r0", (6, 0), (7, 0), (8, 0), aps=["west", "west", "east"]))
    assert links(records) == [
        (0.0, "west", "connected"),
        (2.0, "west", "connected"),
        (2.5, "east", "handover"),
        (2.6, "east", "connected"),
        (4.0, "east", "connected"),
        (6.0, "", "none"),
    ]
    interrupted = [s for s in only(records, Sample) if s.robot and s.link[0] == 1]
    assert [(s.t_s, s.ap, s.rate_mbps) for s in interrupted] == [(2.5, (1,), (0.0,))]
    kpi = only(records, Kpi)[-1]
    assert kpi.handover_s == pytest.approx(0.1)
    assert kpi.connected_s == pytest.approx(5.9)
    assert kpi.outage_s == 0.0


def test_an_interruption_longer_than_a_slot_is_carried_on():
    """It shows in the states of the next slots and ends when it is over."""
    hall = make_hall(**CORRIDOR, run={"interruption": 2300.0})
    cells = [(6, 0), (7, 0), (8, 0), (8, 0), (8, 0)]
    records = hall.run(hall.walk("r0", *cells, aps=["west", "east", "east", "east", "east"]))
    assert links(records)[:6] == [
        (0.0, "west", "connected"),
        (0.5, "east", "handover"),
        (2.0, "east", "handover"),
        (2.8, "east", "connected"),
        (4.0, "east", "connected"),
        (6.0, "east", "connected"),
    ]
    assert only(records, RobotKpi)[0].handover_s == pytest.approx(2.3)


def test_an_interruption_that_ends_after_the_last_sample_of_a_slot_is_ended_in_it():
    """No sample of the slot shows it: 0.5 s + 3.3 s lies between 3.5 s and 4 s."""
    hall = make_hall(**CORRIDOR, run={"interruption": 3300.0})
    cells = [(6, 0), (7, 0), (8, 0), (8, 0), (8, 0)]
    records = hall.run(hall.walk("r0", *cells, aps=["west", "east", "east", "east", "east"]))
    assert links(records)[1:5] == [
        (0.5, "east", "handover"),
        (2.0, "east", "handover"),
        (3.8, "east", "connected"),
        (4.0, "east", "connected"),
    ]


def test_an_interruption_that_ends_with_a_sample_is_told_once():
    """At the instant of a sample the sample's own link and SNR hold."""
    hall = make_hall(**CORRIDOR, run={"interruption": 500.0})
    records = hall.run(hall.walk("r0", (6, 0), (7, 0), (8, 0), aps=["west", "west", "east"]))
    assert links(records)[1:5] == [
        (2.0, "west", "connected"),
        (2.5, "east", "handover"),
        (3.0, "east", "connected"),
        (4.0, "east", "connected"),
    ]
    (state,) = only(records, RobotState, t_s=3.0)
    (sample,) = only(records, Sample, t_s=3.0)
    assert (state.snr_db, state.rate_mbps) == (sample.snr_db[0], sample.rate_mbps[0])


def test_a_new_handover_cuts_the_interruption_by_the_last_one():
    """Two handovers in a row: no time is counted twice, the later one ends it."""
    hall = make_hall(**CORRIDOR, run={"interruption": 2300.0})
    cells = [(6, 0), (7, 0), (7, 0), (8, 0), (8, 0)]
    records = hall.run(hall.walk("r0", *cells, aps=["west", "east", "west", "west", "west"]))
    assert [h.t_s for h in only(records, Handover)] == [0.5, 2.5]
    assert links(records)[:5] == [
        (0.0, "west", "connected"),
        (0.5, "east", "handover"),
        (2.0, "east", "handover"),
        (2.5, "west", "handover"),
        (4.0, "west", "handover"),
    ]
    assert only(records, RobotKpi)[0].handover_s == pytest.approx(4.3)


def test_without_interruption_the_ap_changes_and_the_link_stays():
    """An interruption of 0 ms: no state HANDOVER at all."""
    hall = make_hall(**CORRIDOR, run={"interruption": 0.0})
    records = hall.run(hall.walk("r0", (6, 0), (7, 0), (8, 0), aps=["west", "west", "east"]))
    assert (2.5, "east", "connected") in links(records)
    assert {link for _, _, link in links(records)} == {"connected", "none"}


def test_a_hole_in_the_middle_of_an_edge_is_an_outage_under_endpoints():
    """§1.7 `endpoints`: an incident and a KPI, from the sample that shows it to the next good."""
    hall = make_hall(**HOLE)
    records = hall.run(hall.walk("r0", (0, 0), (1, 0), (2, 0)))
    (outage,) = only(records, Incident)
    assert (outage.kind, outage.robot, outage.ap, outage.slot) == ("outage", "r0", "ap", 0)
    assert (outage.t_s, outage.value) == (1.5, 0.5)
    assert "from 1.000 s to 1.500 s" in outage.message
    assert links(records)[:4] == [
        (0.0, "ap", "connected"),
        (1.0, "ap", "outage"),
        (1.5, "ap", "connected"),
        (2.0, "ap", "connected"),
    ]
    below = [s for s in only(records, Sample) if s.robot and s.link[0] == 2]
    assert [(s.t_s, s.rate_mbps) for s in below] == [(1.0, (0.0,))]
    kpi = only(records, Kpi)[-1]
    assert kpi.outage_s == kpi.worst_outage_s == 0.5
    assert kpi.map_error_max_db == 0.0  # the map's samples know of the hole


def test_an_outage_that_ends_with_the_slot_is_told_at_the_beginning_of_the_next():
    """The last sample of the crossing is behind a pillar, the vertex is not."""
    pillar = {"center_m": (2.25, 5.0), "size_m": (0.2, 0.2), "height_m": 3.0}
    hall = make_hall(**{**HOLE, "obstacles": (pillar,)})
    records = hall.run(hall.walk("r0", (0, 0), (1, 0), (2, 0)))
    (outage,) = only(records, Incident)
    assert (outage.t_s, outage.value, outage.slot) == (2.0, 0.5, 1)
    arrives = records.index(outage)
    assert records[arrives + 1] == only(records, RobotState, slot=1)[0]


def test_the_same_edge_is_no_edge_of_the_problem_under_samples():
    """§1.8: so that an undisturbed run has no outage."""
    hall = make_hall(**{**HOLE, "radio": {"edge_rule": "samples"}, "errands": (((1, 0), (2, 0)),)})
    assert hall.problem.n_edges < make_hall(**HOLE).problem.n_edges


def overrated(hall: Hall, *errands, **changes) -> Hall:
    """The hall with a map that promises 60 dB more, and robots from cell to cell."""
    radio_map = replace(
        hall.radio_map,
        snr_db=hall.radio_map.snr_db + 60.0,
        edge_snr_db=hall.radio_map.edge_snr_db + 60.0,
    )
    hall = hall._replace(radio_map=radio_map)
    hall = hall._replace(problem=problem_from_world(hall.world, hall.floor, radio_map))
    ends = np.array([[hall.vertex(*cell) for cell in errand] for errand in errands])
    changes |= {"start": ends[:, 0], "goal": ends[:, 1]}
    return hall._replace(problem=replace(hall.problem, **changes))


@pytest.mark.parametrize("at_goal", ["leave", "park"])
def test_an_outage_that_lasts_until_the_end_is_reported(at_goal):
    """Below the threshold from the first sample on: it ends when the robot leaves, or the run."""
    hall = overrated(make_hall(**CORRIDOR), ((14, 0), (15, 0)), at_goal=at_goal)
    records = hall.run(hall.walk("r0", (14, 0), (15, 0), aps=["west", "west"]))
    (outage,) = only(records, Incident)
    assert (outage.kind, outage.t_s, outage.value) == ("outage", 4.0, 4.0)
    least = min(s.snr_db[0] for s in only(records, Sample) if s.robot)
    assert least < only(records, Sample)[0].snr_db[0]
    assert f"{least:.1f} dB" in outage.message
    assert only(records, Kpi)[-1].worst_outage_s == 4.0
    assert only(records, Kpi)[-1].map_error_mean_db == pytest.approx(60.0)


def test_an_outage_ends_when_its_robot_leaves_though_the_run_goes_on():
    """§1.4, `leave`: told before its state GONE, while another robot is still under way."""
    hall = make_hall(**{**CORRIDOR, "errands": (((6, 0), (7, 0)), ((8, 0), (9, 0)))})
    hall = overrated(hall, ((14, 0), (15, 0)), ((0, 0), (3, 0)))
    records = hall.run(
        hall.walk("r0", (14, 0), (15, 0), aps=["west", "west"]),
        hall.walk("r1", (0, 0), (1, 0), (2, 0), (3, 0), aps=["west"] * 4),
    )
    (outage,) = only(records, Incident)
    assert (outage.robot, outage.t_s, outage.value, outage.slot) == ("r0", 4.0, 4.0, 2)
    after = records[records.index(outage) + 1]
    assert (after.robot, after.activity) == ("r0", "gone")


def test_interruptions_are_not_counted_as_outage_even_where_one_cuts_another():
    """One outage from start to end, with handovers at 0.5 s and 2.5 s of 2.3 s each.

    Their union lasts from 0.5 s to 4.8 s; of the 10 s on the floor 5.7 s remain. The KPIs, which
    are computed from the records alone, say the same.
    """
    hall = make_hall(**CORRIDOR, run={"interruption": 2300.0})
    hall = overrated(hall, ((1, 0), (1, 0)))
    away = [ap.model_copy(update={"position_m": (900.0, 1.0, 3.0)}) for ap in hall.world.ap]
    world = hall.world.model_copy(update={"ap": tuple(away)})
    cells = [(1, 0), (2, 0), (2, 0), (2, 0), (1, 0)]
    records = hall._replace(world=world).run(
        hall.walk("r0", *cells, aps=["west", "east", "west", "west", "west"])
    )
    assert [h.t_s for h in only(records, Handover)] == [0.5, 2.5]
    (outage,) = only(records, Incident)
    kpi = only(records, Kpi)[-1]
    assert outage.value == pytest.approx(5.7)
    assert kpi.worst_outage_s == pytest.approx(5.7)
    assert kpi.handover_s == pytest.approx(4.3)
    assert kpi.connected_s == 0.0


@pytest.mark.parametrize(("samples", "per_slot"), [(1, 1), (2, 1), (3, 2), (7, 6)])
def test_a_slot_has_as_many_samples_as_the_world_asks_for(samples, per_slot):
    """Both ends included, the last being the next slot's first; one sample is as good as two."""
    hall = make_hall(**CORRIDOR, run={"samples_per_slot": samples})
    records = hall.run(hall.walk("r0", (6, 0), (7, 0), (8, 0), aps=["west", "west", "east"]))
    times = [s.t_s for s in only(records, Sample)]
    assert times == pytest.approx(np.arange(3 * per_slot + 1) * 2.0 / per_slot)
    (handover,) = only(records, Handover)
    assert handover.t_s == pytest.approx(2.0 + 2.0 / per_slot)


def test_the_last_instant_of_a_slot_is_the_first_of_the_next():
    """Also in floating point."""
    instants = Instants.of(60.0 / 19.0, 6)
    assert all(instants.t_s(t, 5) == instants.t_s(t + 1) for t in range(1000))
