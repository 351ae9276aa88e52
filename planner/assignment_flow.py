"""The flow of robots through their AP layers as an integer program (see `planner.assignment`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import LinearConstraint
from scipy.sparse import coo_array

from planner.ap_layers import APs, Bools, Layers

HUB = -1
"""Stands for the AP of a node between two slots, through which handovers go."""


class FlowModel:
    """Columns and rows of the flow for `scipy.optimize.milp`.

    A column is an arc between two nodes of one robot: from its source into a state of the first
    slot of its window, between states of consecutive slots, or into and out of the node in between
    (`HUB`).

    Args:
        layers: of the robots in it.
        windows: per robot the first and the last slot in which it could use one of the rows.
        rows: (k, 2) slots and APs whose capacity is kept.
        capacity: (A,) robots.
        parked_until: the last slot in which parked robots are counted; None if robots leave.
        elastic: capacities may be exceeded, and that is all that costs.

    Attributes:
        cost, integral: per column.
        constraints: conservation of flow, capacities.
    """

    def __init__(
        self,
        layers: dict[int, Layers],
        windows: dict[int, tuple[int, int]],
        rows: NDArray[np.int64],
        capacity: NDArray[np.int32],
        *,
        parked_until: int | None,
        elastic: bool,
    ) -> None:
        self._layers, self._windows, self._parked_until = layers, windows, parked_until
        self._row_of = {(t, a): k for k, (t, a) in enumerate(rows.tolist())}
        self._arcs: list[tuple[int, int, int]] = []  # robot, slot it leads into, AP there
        self._price: list[int] = []
        self._supply: list[int] = []  # per node: 1 at a source, 0 elsewhere
        self._flow: list[tuple[int, int, int]] = []  # node, column, +1 leaving or -1 entering
        self._use: list[tuple[int, int]] = []  # capacity row, column
        for i, (first, last) in windows.items():
            self._add_robot(i, layers[i], first, last)

        n_arcs, n_rows = len(self._arcs), len(rows)
        price = np.array(self._price, np.float64)
        slack = n_rows if elastic else 0
        self.cost = np.concatenate((price * (not elastic), np.ones(slack)))
        self.integral = np.concatenate((np.ones(n_arcs), np.zeros(slack)))
        node, column, sign = np.array(self._flow, np.int64).reshape(-1, 3).T
        shape = (len(self._supply), n_arcs + slack)
        flow = coo_array((sign.astype(np.float64), (node, column)), shape=shape)
        row, column = np.array(self._use, np.int64).reshape(-1, 2).T
        value = np.concatenate((np.ones(len(row)), -np.ones(slack)))
        row = np.concatenate((row, np.arange(slack)))
        column = np.concatenate((column, n_arcs + np.arange(slack)))
        use = coo_array((value, (row, column)), shape=(n_rows, n_arcs + slack))
        self.constraints = [
            LinearConstraint(flow.tocsr(), self._supply, self._supply),
            LinearConstraint(use.tocsr(), -np.inf, capacity[rows[:, 1]]),
        ]

    def _node(self, supply: int = 0) -> int:
        self._supply.append(supply)
        return len(self._supply) - 1

    def _arc(self, arc: tuple[int, int, int], price: int, tail: int, head: int | None) -> None:
        """An arc and the places it takes; `head` is None in the last slot of a window."""
        column = len(self._arcs)
        self._arcs.append(arc)
        self._price.append(price)
        self._flow.append((tail, column, 1))
        if head is not None:
            self._flow.append((head, column, -1))
        i, slot, ap = arc
        if ap == HUB:
            return
        until = slot
        if self._parked_until is not None and slot == self._layers[i].arrival:
            until = self._parked_until
        for t in range(slot, until + 1):
            if (t, ap) in self._row_of:
                self._use.append((self._row_of[t, ap], column))

    def _add_robot(self, i: int, x: Layers, first: int, last: int) -> None:
        source = self._node(supply=1)
        tails: dict[int, int] = {}
        for t in range(first, last + 1):
            here = np.flatnonzero(x.alive[t]).tolist()
            heads = {a: self._node() if t < last else None for a in here}
            after = x.to_goal[t].tolist() if t == last else [0] * len(x.alive[t])
            if t == first:
                for a, head in heads.items():
                    self._arc((i, t, a), int(x.from_start[t, a]) + after[a], source, head)
            else:
                step = x.allowed[t - 1]
                for a in np.flatnonzero(np.diag(step)).tolist():
                    self._arc((i, t, a), after[a], tails[a], heads[a])
                change = step & ~np.eye(len(step), dtype=np.bool_)
                leave, enter = change.any(axis=1), change.any(axis=0)
                if _through_hub(step, change, leave, enter):
                    hub = self._node()
                    for a in np.flatnonzero(leave).tolist():
                        self._arc((i, t, HUB), 1, tails[a], hub)
                    for b in np.flatnonzero(enter).tolist():
                        self._arc((i, t, b), after[b], hub, heads[b])
                else:
                    for a, b in np.argwhere(change).tolist():
                        self._arc((i, t, b), 1 + after[b], tails[a], heads[b])
            tails = {a: head for a, head in heads.items() if head is not None}

    def read(self, chosen: Bools) -> dict[int, APs]:
        """The APs of the arcs that carry flow, and those before and after the windows."""
        aps = {i: np.empty(self._layers[i].arrival + 1, np.int32) for i in self._windows}
        for column in np.flatnonzero(chosen[: len(self._arcs)]).tolist():
            i, slot, ap = self._arcs[column]
            if ap != HUB:
                aps[i][slot] = ap
        for i, (first, last) in self._windows.items():
            self._layers[i].complete(aps[i], first, last)
        return aps


def _through_hub(step: Bools, change: Bools, leave: Bools, enter: Bools) -> bool:
    """Whether one node in between stands for all handovers of a slot, with fewer arcs.

    It also lets a robot go out and back into the same AP, at the price of a handover; that never
    pays where the AP may be kept, so it must be one that may.
    """
    same = leave & enter
    worth = int(leave.sum()) * int(enter.sum()) > int(leave.sum()) + int(enter.sum())
    every = leave[:, None] & enter & ~np.eye(len(step), dtype=np.bool_)
    return worth and bool(np.diag(step)[same].all()) and bool((change == every).all())
