"""`radio.rate_sharing`: what a robot gets of its AP's airtime, in the twin and in the validator."""

from __future__ import annotations

from collections import Counter

import pytest

from logs.records import CONNECTED, LINKS, Kpi, RobotState, Sample
from logs.validate import validate
from tests.logs.good_logs import log_of
from tests.logs.tamper import edited, forge, records, rules
from tests.logs.test_validate_disturbed import MANY, OUTAGE
from tests.twin.halls import make_hall, of_type
from worlds.channel import data_rate_mbps
from worlds.toml_file import dump_world, parse_world
from worlds.world import Radio

FLOWS = LINKS.index(CONNECTED)
SHARED = 'rate_sharing = "equal"\n'


def sharing(world: str) -> str:
    """The world with equal shares."""
    return world.replace("[radio]\n", "[radio]\n" + SHARED)


def test_alone_a_robot_has_all_of_it():
    """Both ways of sharing give one robot the same."""
    for way in ("none", "equal"):
        radio = Radio(rate_sharing=way)
        assert data_rate_mbps(20.0, radio) == data_rate_mbps(20.0, radio, 1)
    assert data_rate_mbps(20.0, Radio(), 4) == data_rate_mbps(20.0, Radio())


def test_n_robots_have_one_nth_each_of_the_capped_rate():
    """The cap is the link's, so the AP's robots together never have more than it."""
    radio = Radio(rate_sharing="equal", rate_cap_mbps=500.0)
    assert data_rate_mbps(60.0, radio, 4) == 125.0


@pytest.mark.parametrize("world", [OUTAGE, MANY], ids=["outages", "all of it"])
def test_every_sample_shares_equally(world):
    """Each rate is that of its SNR divided by the robots its AP serves at that instant."""
    path = log_of(world=sharing(world))
    found = records(path)
    alone = Radio(tx_power_dbm=4.0)
    most = 0
    for sample in of_type(found, Sample):
        served = Counter(sample.ap)
        for ap, snr, link, rate in zip(
            sample.ap, sample.snr_db, sample.link, sample.rate_mbps, strict=True
        ):
            most = max(most, served[ap])
            expected = float(data_rate_mbps(snr, alone)) / served[ap] if link == FLOWS else 0.0
            assert rate == pytest.approx(expected, rel=1e-12)
    assert most >= 3
    assert validate(path).findings == ()


def test_figures_are_of_shared_rates():
    """Less is delivered where an AP has several robots to serve, and nothing else changes."""
    alone, shared = (of_type(records(log_of(world=w)), Kpi)[-1] for w in (OUTAGE, sharing(OUTAGE)))
    assert shared.delivered_mbit < 0.8 * alone.delivered_mbit
    assert shared.p10_rate_mbps <= alone.p10_rate_mbps
    for name in ("makespan_slots", "handovers", "outage_s", "connected_s", "peak_load"):
        assert getattr(shared, name) == getattr(alone, name)


def test_a_handover_that_ends_between_samples_leads_back_to_the_share():
    """The rate told then is the one of the last sample: measured and shared there."""
    hall = make_hall(
        size=(16.0, 4.0),
        aps=(("west", (1.0, 2.0, 3.0)), ("east", (15.0, 2.0, 3.0))),
        errands=(((0, 0), (7, 0)), ((4, 1), (7, 1)), ((7, 0), (4, 0))),
        radio={"rate_sharing": "equal", "ap_capacity": 9},
    )
    names = ["west"] * 4 + ["east"] * 4
    found = hall.run(
        hall.walk("r0", *[(c, 0) for c in range(8)], aps=names),
        hall.walk("r1", *[(c, 1) for c in (4, 4, 4, 4, 4, 5, 6, 7)], aps=["east"] * 8),
        None,
    )
    amid = [s for s in of_type(found, RobotState) if s.robot == "r0" and s.t_s % 0.5]
    (state,) = [s for s in amid if s.link == CONNECTED]
    assert state.ap == "east"
    expected = float(data_rate_mbps(state.snr_db, hall.world.radio, 2))
    assert state.rate_mbps == expected


def test_rates_that_are_not_shared_are_found(tmp_path):
    """The validator counts who shares an AP on its own."""
    source = log_of(world=OUTAGE)
    declare = edited("world.toml", lambda text: sharing(text.decode()).encode())
    report = validate(forge(source, tmp_path / "forged.mcap", attachment=declare))
    assert "reader" not in rules(report)
    assert "page5:rate" in rules(report, 3)


def test_shared_rates_that_should_not_be_are_found(tmp_path):
    """And the other way round."""
    source = log_of(world=sharing(OUTAGE))
    declare = edited("world.toml", lambda text: text.replace(SHARED.encode(), b""))
    report = validate(forge(source, tmp_path / "forged.mcap", attachment=declare))
    assert "page5:rate" in rules(report, 3)


def test_the_key_survives_a_round_trip():
    """As every key of a world."""
    world = parse_world(sharing(OUTAGE))
    assert world.radio.rate_sharing == "equal"
    assert parse_world(dump_world(world)) == world
    assert parse_world(OUTAGE).radio.rate_sharing == "none"
