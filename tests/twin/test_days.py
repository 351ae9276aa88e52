"""The worlds that ship with something that goes wrong, from the file to the validated log."""

from __future__ import annotations

from pathlib import Path

import pytest

from logs.mcap_reader import read
from logs.records import Disturbance, Replan
from logs.validate import validate
from tests.logs.good_logs import log_of
from tests.twin.halls import of_type

WORLDS = Path(__file__).resolve().parents[2] / "worlds"


@pytest.mark.parametrize(
    ("world", "options", "cause"),
    [
        ("assembly_hall", (), "blockage"),
        ("warehouse_day", (("robots.random.count", 25),), "ap-outage"),
    ],
)
def test_the_day_ends_well_and_its_log_is_valid(world, options, cause):
    """Everybody arrives, a new plan is made for the reason the story tells, no finding."""
    path = log_of(options, world=world)
    records = read(path).records
    assert records[-1].verdict == "completed"
    assert cause in {r.cause for r in of_type(records, Replan)}
    assert of_type(records, Disturbance)
    assert validate(path).valid
