"""Which mounts to use: coverage by access points as mixed-integer programs, solved with a proof.

What is wanted is an `Ask`; the programs are written out in `worlds.placement_model`.

The solver is HiGHS by way of `scipy.optimize.milp`. Its bounds are rounded to whole numbers, since
every objective is one; what it finds is never worse than the greedy algorithm (G. Nemhauser,
L. Wolsey and M. Fisher, 1978, doi:10.1007/BF01588971), whose value it is given to beat.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worlds.placement_model import Ask, Rows, program, wanted

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

__all__ = ["Ask", "Placement", "achieved", "keep", "place", "wanted"]

_TINY = 1e-6


@dataclass(frozen=True)
class Placement:
    """Mounts and how good they are.

    Attributes:
        chosen: indices of the mounts used, ascending.
        value: weight covered as asked (greatest coverage), or number of mounts (fewest).
        bound: no choice of these mounts covers more, or is fewer.
        possible: the share asked for can be reached at all (fewest).
        seconds: the solver took.
    """

    chosen: tuple[int, ...]
    value: int
    bound: int
    possible: bool
    seconds: float

    @property
    def optimal(self) -> bool:
        """Whether the bound is reached."""
        return self.possible and self.value == self.bound

    @property
    def gap(self) -> float:
        """|value − bound| relative to the larger of both."""
        return abs(self.value - self.bound) / max(1, self.value, self.bound)


def place(covers: Bools, held: Bools, weight: Ints, ask: Ask) -> Placement:
    """The best mounts.

    Args:
        covers: (n, C) whether mount c covers place v.
        held: (n, F) the same for the access points that hang already.
        weight: (n,) what each place counts for, whole numbers ≥ 0.
        ask: what is wanted.

    Raises:
        ValueError: sizes that do not fit, or an ask that makes no sense.
    """
    if len(covers) != len(held) or len(covers) != len(weight):
        raise ValueError("covers, held and weight tell of different numbers of places")
    if ask.k < 1 or not 0 <= ask.share <= 1 or (ask.add is not None and ask.add < 0):
        raise ValueError(f"{ask} makes no sense: k ≥ 1, 0 ≤ share ≤ 1, add ≥ 0")
    begun = time.perf_counter()
    weight = np.asarray(weight, dtype=np.int64)
    whole = ask.add is None and ask.share == 1.0
    if ask.failure and whole:
        ask = Ask(None, 1.0, ask.k + 1, False, ask.seconds)
    greedy = _greedy(covers, held, weight, ask)
    if ask.add is None and not _enough(achieved(covers, held, weight, greedy, ask), weight, ask):
        every = tuple(range(covers.shape[1]))
        most = achieved(covers, held, weight, every, ask)
        if not _enough(most, weight, ask):
            spent = time.perf_counter() - begun
            return Placement(every, len(every), len(every), False, spent)
        greedy = every
    chosen, bound = _solve(covers, held, weight, ask, greedy)
    value = len(chosen) if ask.add is None else achieved(covers, held, weight, chosen, ask)
    return Placement(chosen, value, bound, True, time.perf_counter() - begun)


def keep(
    covers: Bools, need: Ints, capacity: Ints, robots: int, seconds: float = 60.0
) -> Placement:
    """The fewest of the access points that hang with which each place keeps what it needs.

    Args:
        covers: (n, A) whether access point a covers place v.
        need: (n,) access points that must remain at each place, at most those there are.
        capacity: (A,) robots each serves.
        robots: that must be served at once, as far as all together can.
        seconds: limit for the solver.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp

    begun = time.perf_counter()
    every = tuple(range(covers.shape[1]))
    asked = np.flatnonzero(need > 0)
    rows = np.unique(np.column_stack((covers[asked], need[asked])).astype(np.int64), axis=0)
    least = min(robots, int(capacity.sum()))
    if not len(rows) and least <= 0:
        return Placement((), 0, 0, True, time.perf_counter() - begun)
    answer = milp(
        np.ones(len(every)),
        integrality=np.ones(len(every)),
        bounds=Bounds(0.0, 1.0),
        constraints=[
            LinearConstraint(rows[:, :-1].astype(np.float64), rows[:, -1].astype(float), np.inf),
            LinearConstraint(capacity[None, :].astype(np.float64), float(least), np.inf),
        ],
        options={"time_limit": max(0.01, seconds), "mip_rel_gap": 0.0},
    )
    chosen = every
    if answer.x is not None:
        found = np.flatnonzero(answer.x > 0.5)
        if (covers[:, found].sum(axis=1) >= need).all() and capacity[found].sum() >= least:
            chosen = tuple(found.tolist())
    dual = getattr(answer, "mip_dual_bound", None)
    bound = 0 if dual is None else max(0, math.ceil(dual - _TINY))
    return Placement(chosen, len(chosen), bound, True, time.perf_counter() - begun)


def achieved(covers: Bools, held: Bools, weight: Ints, chosen: tuple[int, ...], ask: Ask) -> int:
    """Weight of the places that these mounts and the access points there are cover as asked.

    With `failure`: of what remains after the worst single loss.
    """
    reach = np.concatenate((held, covers[:, list(chosen)]), axis=1)
    count = reach.sum(axis=1)
    if not ask.failure:
        return int(weight[count >= ask.k].sum())
    left = [int(weight[count - reach[:, a] >= ask.k].sum()) for a in range(reach.shape[1])]
    return min(left, default=0)


def _enough(covered: int, weight: Ints, ask: Ask) -> bool:
    return covered >= wanted(weight, ask.share)


def _greedy(covers: Bools, held: Bools, weight: Ints, ask: Ask) -> tuple[int, ...]:
    """Mount by mount the one that supplies most; then those that turn out needless out again."""
    need = np.maximum(ask.k + int(ask.failure) - held.sum(axis=1), 0)
    chosen: list[int] = []
    most = covers.shape[1] if ask.add is None else min(ask.add, covers.shape[1])
    free = np.ones(covers.shape[1], dtype=np.bool_)
    while len(chosen) < most:
        if ask.add is None and _enough(
            achieved(covers, held, weight, tuple(chosen), ask), weight, ask
        ):
            break
        gain = np.where(free, (weight * (need > 0)) @ covers, 0)
        best = int(gain.argmax())
        if gain[best] <= 0:
            break
        chosen.append(best)
        free[best] = False
        need = np.maximum(need - covers[:, best], 0)
    if ask.add is None:
        for mount in list(chosen):
            rest = tuple(c for c in chosen if c != mount)
            if _enough(achieved(covers, held, weight, rest, ask), weight, ask):
                chosen.remove(mount)
    return tuple(sorted(chosen))


def _solve(
    covers: Bools, held: Bools, weight: Ints, ask: Ask, greedy: tuple[int, ...]
) -> tuple[tuple[int, ...], int]:
    """Mounts and the proven bound; the greedy ones where the solver finds none better."""
    from scipy.optimize import Bounds, milp

    rows = Rows.of(covers, held, weight, ask)
    model = program(rows, ask, len(greedy), achieved(covers, held, weight, greedy, ask))
    if model is None:  # nothing is missing, or nothing can be gained
        value = 0 if ask.add is None else achieved(covers, held, weight, (), ask)
        return (), value
    answer = milp(
        model.cost,
        integrality=model.integer,
        bounds=model.bounds or Bounds(0.0, 1.0),
        constraints=model.constraints,
        options={"time_limit": max(0.01, ask.seconds), "mip_rel_gap": 0.0},
    )
    dual = getattr(answer, "mip_dual_bound", None)
    worst = 0 if ask.add is None else int(weight.sum())
    if ask.add is None:
        bound = worst if dual is None else max(worst, math.ceil(dual - _TINY))
    else:
        bound = worst if dual is None else min(worst, rows.given + math.floor(-dual + _TINY))
    if answer.x is None:
        if answer.status == 2:  # nothing beats the greedy mounts by the whole number asked for
            raise RuntimeError(f"HiGHS calls a solvable placement infeasible: {answer.message}")
        return greedy, bound
    used = np.flatnonzero(answer.x[: len(rows.mount)] > 0.5)
    found = tuple(sorted(int(rows.mount[c]) for c in used))
    if ask.add is None:
        # The solver keeps its constraints to 1e-6 only; whole mounts are counted anew.
        good = _enough(achieved(covers, held, weight, found, ask), weight, ask)
        return (found if good and len(found) <= len(greedy) else greedy), bound
    ours, theirs = (achieved(covers, held, weight, c, ask) for c in (found, greedy))
    return (found if ours >= theirs else greedy), bound
