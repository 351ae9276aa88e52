"""Compiled kernels on all cores: they release the GIL, so plain threads do.

Results come in the order of the items whatever the number of threads, so that it decides nothing
but the time (§1.15). `NUMBA_NUM_THREADS` limits the threads, as it does numba's own; one is used
where it says 1, as in the workers of a study.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

CHUNK = 4
"""Items per thread between two questions whether to stop."""


def n_threads() -> int:
    """Cores this process may use, or fewer if the environment says so."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    asked = os.environ.get("NUMBA_NUM_THREADS", "")
    return max(1, min(cores or 1, int(asked) if asked.isdigit() else cores or 1))


@cache
def _pool(threads: int, _process: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="planner")


def each(
    function: Callable[[T], R], items: Sequence[T], stop: Callable[[], bool] = lambda: False
) -> Iterator[R]:
    """`function` of every item, in their order; fewer results if stopped on the way.

    Args:
        function: of one item; must not change what other calls read.
        items: in the order of the results.
        stop: asked every few items.
    """
    threads = n_threads()
    if threads == 1 or len(items) < 2:
        for item in items:
            if stop():
                return
            yield function(item)
        return
    pool = _pool(threads, os.getpid())  # threads do not survive a fork
    for begin in range(0, len(items), CHUNK * threads):
        if stop():
            return
        yield from pool.map(function, items[begin : begin + CHUNK * threads])
