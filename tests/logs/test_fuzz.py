"""Damaged logs are refused or found out, by every reader: no traceback, no hang, no flood.

`python -m tests.logs.fuzz RUN.mcap` does the same with thousands of files.
"""

from __future__ import annotations

import resource
import time

import pytest

from tests.logs.fuzz import READERS, damaged, outcome
from tests.logs.good_logs import log_of

FILES = 24
SECONDS = 30.0
MEMORY_MB = 1500.0


@pytest.mark.parametrize("seed", range(FILES))
def test_damage_is_refused_or_found(tmp_path, seed):
    """Each reader ends with an answer or a `LogError`, in bounded time and memory."""
    path = tmp_path / "f.mcap"
    path.write_bytes(damaged(log_of().read_bytes(), seed))
    for reader in READERS:
        if reader == "report" and seed % 4 != 3:
            continue  # pictures take their time
        begun = time.perf_counter()
        assert outcome(reader, path, log_of()) in {"fine", "refused"}
        assert time.perf_counter() - begun < SECONDS
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 < MEMORY_MB


def test_damage_is_the_same_every_time():
    """File and number decide what is damaged, so that a finding can be repeated; each differs."""
    data = log_of().read_bytes()
    made = [damaged(data, seed) for seed in range(8)]
    assert made == [damaged(data, seed) for seed in range(8)]
    assert len({*made, data}) >= 8
