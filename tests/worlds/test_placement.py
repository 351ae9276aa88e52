"""Placements of access points: optimal by enumeration of all choices, and proven so."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from worlds.placement import Ask, Placement, achieved, place, wanted

NONE = np.zeros((0, 0), dtype=bool)


def random_case(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Up to 14 places, 7 mounts, 2 access points that hang already."""
    rng = np.random.default_rng(seed)
    n, c, f = rng.integers(1, 15), rng.integers(1, 8), rng.integers(0, 3)
    density = rng.uniform(0.15, 0.7)
    covers, held = rng.random((n, c)) < density, rng.random((n, f)) < 0.3
    return covers, held, rng.integers(0, 4, n)


def every_choice(mounts: int) -> list[tuple[int, ...]]:
    """All sets of mounts, the smaller first."""
    return [s for size in range(mounts + 1) for s in combinations(range(mounts), size)]


def literally(
    covers: np.ndarray, held: np.ndarray, weight: np.ndarray, chosen: tuple[int, ...], ask: Ask
) -> int:
    """What `achieved` is to say, place by place."""
    reaching = [
        [("held", f) for f in range(held.shape[1]) if held[v, f]]
        + [("new", c) for c in chosen if covers[v, c]]
        for v in range(len(weight))
    ]
    everyone = [("held", f) for f in range(held.shape[1])] + [("new", c) for c in chosen]
    if not ask.failure:
        return int(sum(w for w, r in zip(weight, reaching, strict=True) if len(r) >= ask.k))
    left = [
        int(sum(w for w, r in zip(weight, reaching, strict=True) if len(set(r) - {a}) >= ask.k))
        for a in everyone
    ]
    return min(left, default=0)


@pytest.mark.parametrize("failure", [False, True])
@given(st.integers(0, 100_000), st.integers(1, 3), st.integers(0, 4))
@settings(max_examples=60, deadline=None)
def test_no_choice_of_as_many_mounts_covers_more(
    failure: bool, seed: int, k: int, add: int
) -> None:
    """Greatest coverage, by k and after a single failure: equal to the best of all choices."""
    covers, held, weight = random_case(seed)
    ask = Ask(add=add, k=k, failure=failure)
    found = place(covers, held, weight, ask)
    best = max(
        literally(covers, held, weight, s, ask)
        for s in every_choice(covers.shape[1])
        if len(s) <= add
    )
    assert found.value == best == literally(covers, held, weight, found.chosen, ask)
    assert found.optimal
    assert len(found.chosen) <= add


@pytest.mark.parametrize("failure", [False, True])
@given(st.integers(0, 100_000), st.integers(1, 3), st.sampled_from([1.0, 0.9, 0.6, 0.3]))
@settings(max_examples=60, deadline=None)
def test_no_fewer_mounts_reach_the_share(failure: bool, seed: int, k: int, share: float) -> None:
    """Fewest mounts for a share, by k and after a single failure; or none do, and that is said."""
    covers, held, weight = random_case(seed)
    ask = Ask(share=share, k=k, failure=failure)
    found = place(covers, held, weight, ask)
    target = wanted(weight, share)
    enough = [
        s
        for s in every_choice(covers.shape[1])
        if literally(covers, held, weight, s, ask) >= target
        or (failure and share == 1.0 and literally(covers, held, weight, s, Ask(k=k + 1)) >= target)
    ]
    assert found.possible == bool(enough)
    if enough:
        assert found.value == len(enough[0]) == len(found.chosen)
        assert found.optimal
        assert found.chosen in enough


def test_achieved_is_what_it_says() -> None:
    """Counted place by place on random cases, with and without failure."""
    for seed in range(200):
        covers, held, weight = random_case(seed)
        chosen = tuple(range(0, covers.shape[1], 2))
        for ask in (Ask(k=1), Ask(k=2), Ask(k=1, failure=True), Ask(k=2, failure=True)):
            assert achieved(covers, held, weight, chosen, ask) == literally(
                covers, held, weight, chosen, ask
            )


def test_greedy_alone_would_not_do() -> None:
    """The classic trap: the mount that covers most is in no optimal pair."""
    covers = np.zeros((8, 3), dtype=bool)
    covers[:4, 0] = covers[4:, 1] = True
    covers[[0, 1, 2, 4, 5, 6], 2] = True
    held = np.zeros((8, 0), dtype=bool)
    found = place(covers, held, np.ones(8), Ask())
    assert found == Placement((0, 1), 2, 2, True, found.seconds)
    found = place(covers, held, np.ones(8), Ask(add=2))
    assert (found.chosen, found.value, found.optimal) == ((0, 1), 8, True)


def test_what_hangs_already_counts() -> None:
    """Nothing is added to what is enough; the bound says so."""
    covers = np.eye(4, dtype=bool)
    full = np.ones((4, 1), dtype=bool)
    assert place(covers, full, np.ones(4), Ask()).chosen == ()
    assert place(covers, full, np.ones(4), Ask(k=2)).chosen == (0, 1, 2, 3)
    found = place(covers, full, np.ones(4), Ask(add=2))
    assert (found.value, found.bound, found.optimal) == (4, 4, True)


def test_a_limit_that_is_too_short_leaves_a_gap_and_no_lie() -> None:
    """Stopped at once: still a choice that does what was asked, and a bound below the optimum."""
    rng = np.random.default_rng(1)
    covers = rng.random((400, 120)) < 0.04
    covers[np.arange(400), np.arange(400) % 120] = True
    held = np.zeros((400, 0), dtype=bool)
    quick = place(covers, held, np.ones(400), Ask(seconds=0.0))
    assert achieved(covers, held, np.ones(400, dtype=int), quick.chosen, Ask()) == 400
    assert quick.bound <= quick.value
    assert quick.gap == (quick.value - quick.bound) / quick.value


@pytest.mark.parametrize("ask", [Ask(k=0), Ask(share=1.5), Ask(add=-1)], ids=["k", "share", "add"])
def test_asks_without_sense_are_refused(ask: Ask) -> None:
    """A wrong ask is an error, not an empty answer."""
    with pytest.raises(ValueError, match="makes no sense"):
        place(np.ones((2, 2), dtype=bool), np.ones((2, 0), dtype=bool), np.ones(2), ask)
