"""The logs of the worlds that ship, read by a program that knows nothing of this project."""

from __future__ import annotations

import pytest

from tests.logs.good_logs import WORLDS, log_of
from tests.logs.mcap_check import assert_good, folder

NAMES = sorted(path.stem for path in WORLDS.glob("*.toml"))


@pytest.mark.parametrize("world", NAMES)
def test_an_independent_reader_finds_it_good(world):
    """`@mcap/core` agrees with every CRC, index, schema, payload, frame and grid of it."""
    folder()  # before the run, which takes its time
    assert_good(log_of(world=world))
