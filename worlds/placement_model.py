"""The whole-number programs behind a placement of access points: their rows and columns.

With x_c = 1 for a mount that is used and z_v = 1 for a place v that counts as covered,

    greatest coverage:  max Σ w_v z_v   s.t.  Σ_{c covers v} x_c ≥ need_v z_v,  Σ x_c ≤ K
    fewest mounts:      min Σ x_c       s.t.  the same, and Σ w_v z_v ≥ S

(the maximal covering and the set covering problem: R. Church and C. ReVelle, 1974,
doi:10.1007/BF01942293; C. Toregas et al., 1971, doi:10.1287/opre.19.6.1363). `need_v` is what is
missing of k access points that reach v beside those that hang already.

A single failure. With u_v = 1 for a place that k + 1 access points reach, the loss of a takes the
places of z_v − u_v = 1 that a covers, so for what remains, R, and each access point a in use

    R ≤ Σ w_v z_v − Σ_{a covers v} w_v (z_v − u_v).

If all places must remain this is coverage by k + 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

_TINY = 1e-6
_WORK = 2_000_000_000  # multiplications up to which rows and columns are compared with each other


@dataclass(frozen=True)
class Ask:
    """What is wanted of a placement.

    Attributes:
        add: at most so many mounts, for the greatest coverage; None: as few as possible.
        share: of the weight to be covered; without `add` only.
        k: access points that must reach a place.
        failure: the share must remain covered whichever single access point is lost.
        seconds: limit for the solver.
    """

    add: int | None = None
    share: float = 1.0
    k: int = 1
    failure: bool = False
    seconds: float = 60.0


def wanted(weight: Ints, share: float) -> int:
    """Least whole weight that is this share of all."""
    return math.ceil(share * int(weight.sum()) - _TINY)


@dataclass(frozen=True)
class Rows:
    """Places that are alike, taken together; mounts that others outdo, left out.

    Attributes:
        covers: (R, C') by mounts.
        held: (R, F) by what hangs already.
        need: (R,) access points still missing to k.
        weight: (R,) places together.
        mount: (C',) index of each column.
        given: weight that needs nothing more (not among the rows).
        target: weight to be covered if mounts are to be few.
    """

    covers: Bools
    held: Bools
    need: Ints
    weight: Ints
    mount: Ints
    given: int
    target: int

    @classmethod
    def of(cls, covers: Bools, held: Bools, weight: Ints, ask: Ask) -> Rows:
        """The rows that matter for an ask; arguments as of `worlds.placement.place`."""
        need = np.maximum(ask.k - held.sum(axis=1), 0).astype(np.int64)
        mount = np.flatnonzero(covers.any(axis=0)).astype(np.int64)
        if ask.failure:
            keep = weight > 0
            pattern = np.concatenate((covers, held), axis=1)[keep]
        else:
            keep = (weight > 0) & (need > 0) & (covers.sum(axis=1) >= need)
            pattern = covers[keep]
        given = 0 if ask.failure else int(weight[need == 0].sum())
        key = np.column_stack((np.packbits(pattern, axis=1), need[keep]))
        _, first, group = np.unique(key, axis=0, return_index=True, return_inverse=True)
        together = np.bincount(group.ravel(), weights=weight[keep], minlength=len(first))
        at = np.flatnonzero(keep)[first]
        rows = cls(
            covers[at][:, mount],
            held[at],
            need[at],
            together.astype(np.int64),
            mount,
            given,
            wanted(weight, ask.share),
        )
        if not ask.failure and ask.add is None and ask.share == 1.0:
            rows = rows._without_implied()
        if not ask.failure and len(rows.need):
            rows = rows._without_outdone()
        return rows

    def _without_implied(self) -> Rows:
        """All must be covered: a row that holds all mounts of another says nothing more."""
        n, c = self.covers.shape
        if n * n * c > _WORK:
            return self
        a = self.covers.astype(np.float32)
        size = a.sum(axis=1)
        within = (a @ a.T) >= size[:, None]  # [i, j]: mounts of i are among those of j
        within &= self.need[:, None] >= self.need[None, :]
        np.fill_diagonal(within, False)
        same = within & within.T
        within &= ~np.tril(same.T, -1).T | ~same  # of two equal ones the first stays
        keep = ~within.any(axis=0)
        return self._take(keep, np.ones(c, dtype=np.bool_))

    def _without_outdone(self) -> Rows:
        """A mount is not needed if as many others as a row may miss cover all that it covers.

        Where one of those others is not used, it can take the mount's place; where all are, they
        supply the mount's rows already. Of equal mounts the first count as better.
        """
        n, c = self.covers.shape
        if c * c * n > _WORK:
            return self
        a = self.covers.astype(np.float32)
        size = a.sum(axis=0)
        within = (a.T @ a) >= size[:, None]  # [c, d]: rows of c are among those of d
        index = np.arange(c)
        equal = size[None, :] == size[:, None]
        better = (size[None, :] > size[:, None]) | (equal & (index[None, :] < index[:, None]))
        outdone = (within & better).sum(axis=1) >= self.need.max()
        return self._take(np.ones(n, dtype=np.bool_), ~outdone)

    def _take(self, row: Bools, column: Bools) -> Rows:
        return Rows(
            self.covers[row][:, column],
            self.held[row],
            self.need[row],
            self.weight[row],
            self.mount[column],
            self.given,
            self.target,
        )


@dataclass(frozen=True)
class Program:
    """min cost · x with 0 ≤ x ≤ 1 (or `bounds`), whole where `integer` is 1, under constraints."""

    cost: Floats
    integer: Ints
    constraints: list[object]
    bounds: object = None


def program(rows: Rows, ask: Ask, greedy: int, greedy_value: int) -> Program | None:
    """The program, its first variables the mounts; None if there is nothing to decide."""
    if not len(rows.need) or not len(rows.mount) or ask.add == 0:
        return None
    if ask.failure:
        return _failure_model(rows, ask, greedy, greedy_value)
    return _cover_model(rows, ask, greedy, greedy_value)


def _cover_model(rows: Rows, ask: Ask, greedy: int, greedy_value: int) -> Program:
    """Variables x (mounts), and z (rows) unless every row must be covered."""
    from scipy.optimize import LinearConstraint
    from scipy.sparse import csr_array, diags_array, hstack

    n, c = rows.covers.shape
    matrix = csr_array(rows.covers.astype(np.float64))
    need = rows.need.astype(np.float64)
    use = np.ones(c)
    if ask.add is None and ask.share == 1.0:
        met = LinearConstraint(matrix, need, np.inf)
        few = LinearConstraint(use[None, :], 0.0, float(greedy))
        return Program(use, np.ones(c, dtype=np.int64), [met, few])
    met = LinearConstraint(hstack([matrix, diags_array(-need)], format="csr"), 0.0, np.inf)
    # With one missing at most, whole mounts make whole rows; else z must be said to be whole.
    z_integer = 0 if need.max() == 1 else 1
    integer = np.concatenate((np.ones(c), np.full(n, z_integer))).astype(np.int64)
    mounts = np.concatenate((use, np.zeros(n)))
    worth = np.concatenate((np.zeros(c), rows.weight.astype(np.float64)))
    if ask.add is not None:
        few = LinearConstraint(mounts[None, :], 0.0, float(ask.add))
        good = LinearConstraint(worth[None, :], float(greedy_value - rows.given), np.inf)
        return Program(-worth, integer, [met, few, good])
    few = LinearConstraint(mounts[None, :], 0.0, float(greedy))
    good = LinearConstraint(worth[None, :], float(rows.target - rows.given), np.inf)
    return Program(mounts, integer, [met, few, good])


def _failure_model(rows: Rows, ask: Ask, greedy: int, greedy_value: int) -> Program:
    """Variables x (mounts), z and u (rows with k and k + 1 access points), R (what remains)."""
    from scipy.optimize import Bounds, LinearConstraint
    from scipy.sparse import csr_array, diags_array, hstack, vstack

    n, c = rows.covers.shape
    weight, held = rows.weight.astype(np.float64), rows.held.sum(axis=1).astype(np.float64)
    matrix = csr_array(rows.covers.astype(np.float64))
    zero, last = csr_array((n, n)), csr_array((n, 1))
    some = hstack([matrix, diags_array(np.full(n, -float(ask.k))), zero, last])
    more = hstack([matrix, zero, diags_array(np.full(n, -float(ask.k + 1))), last])
    met = LinearConstraint(vstack([some, more], format="csr"), np.tile(-held, 2), np.inf)
    # R − Σ w z + Σ_{a covers v} w (z − u) ≤ 0; a mount that is not used is let off all it covers.
    lost = np.concatenate((rows.held, rows.covers), axis=1).T * weight
    slack = lost[rows.held.shape[1] :].sum(axis=1)
    used = np.concatenate((np.zeros((rows.held.shape[1], c)), np.diag(slack)))
    remain = np.hstack((used, lost - weight, -lost, np.ones((len(lost), 1))))
    limit = np.concatenate((np.zeros(rows.held.shape[1]), slack))
    left = LinearConstraint(csr_array(remain), -np.inf, limit)
    whole = np.concatenate((np.zeros(c), -weight, np.zeros(n), [1.0]))
    at_all = LinearConstraint(whole[None, :], -np.inf, 0.0)
    mounts = np.concatenate((np.ones(c), np.zeros(2 * n + 1)))
    remains = np.concatenate((np.zeros(c + 2 * n), [1.0]))
    integer = np.ones(c + 2 * n + 1, dtype=np.int64)
    most = Bounds(0.0, np.append(np.ones(c + 2 * n), weight.sum()))
    if ask.add is not None:
        few = LinearConstraint(mounts[None, :], 0.0, float(ask.add))
        good = LinearConstraint(remains[None, :], float(greedy_value), np.inf)
        return Program(-remains, integer, [met, left, at_all, few, good], most)
    few = LinearConstraint(mounts[None, :], 0.0, float(greedy))
    good = LinearConstraint(remains[None, :], float(rows.target), np.inf)
    return Program(mounts, integer, [met, left, at_all, few, good], most)
