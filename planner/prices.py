"""What room is worth: the duals behind a lower bound, summed over time.

The bound of a plan is proven by penalties p ≥ 0 on places in vertices (γ), edges (π) and APs (λ),
slot by slot: L(p) = Σ_i (least penalised cost of robot i) − Σ p · capacity (Lagrange, §1.13). With
one more unit of room in some resources, the same p proves L(p) less their penalties. So the price
of an AP, its penalties summed over the slots, is the most that one more place on it can take off
the bound; where the price is 0, more room takes off nothing at all. Prices are not unique (several
p may prove one bound), but this holds for each of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.grid_lines import grid_lines
from planner.problem import Problem
from planner.resources import SCALE, Resources

Floats = NDArray[np.float64]

NAMED = 2
"""APs, and aisles or places, named in the advice at most."""
WORTH_NAMING = 0.05
"""Share of all prices of its kind below which an AP or a place is not named."""


@dataclass(frozen=True, eq=False)
class Prices:
    """Prices of one more unit of room in every slot [cost units]; arrays are read-only.

    Attributes:
        vertex: (V,) float64, Σ_t γ_vt: for a second robot at the vertex.
        edge: (E,) float64, Σ_t π_et: for a second robot on the edge.
        ap_by_slot: (T+1, A) float64, λ_at: for one robot more on the AP in that slot.
        bound: the lower bound that they prove, not rounded [cost units].
        c_t: cost of a slot, to tell prices in slots.
        advice: what they say, in one sentence.
    """

    vertex: Floats
    edge: Floats
    ap_by_slot: Floats
    bound: float
    c_t: int
    advice: str = ""

    def __post_init__(self) -> None:
        for name in ("vertex", "edge", "ap_by_slot"):
            array = np.asarray(getattr(self, name), np.float64)
            if array.flags.writeable:
                array = array.copy()
                array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __eq__(self, other: object) -> bool:
        """The same prices, bound and advice."""
        if not isinstance(other, Prices):
            return NotImplemented
        mine = (self.bound, self.c_t, self.advice)
        return mine == (other.bound, other.c_t, other.advice) and all(
            np.array_equal(getattr(self, name), getattr(other, name))
            for name in ("vertex", "edge", "ap_by_slot")
        )

    __hash__ = None  # type: ignore[assignment]  # arrays have no hash

    @property
    def ap(self) -> Floats:
        """(A,) float64, Σ_t λ_at: for one robot more on the AP in every slot."""
        return np.asarray(self.ap_by_slot.sum(axis=0))

    @property
    def unit(self) -> str:
        """What `in_units` counts in."""
        return "slots" if self.c_t else "cost units"

    def in_units(self, price: Floats) -> Floats:
        """Prices in slots (cost units where a slot costs nothing)."""
        return price / (self.c_t or 1)

    @property
    def total(self) -> float:
        """All prices together [cost units]."""
        return float(self.vertex.sum() + self.edge.sum() + self.ap_by_slot.sum())

    def around(self, edge_uv: NDArray[np.int32]) -> Floats:
        """(V,) float64, each vertex's price and half the prices of its edges (of ends `edge_uv`).

        They sum up to the prices of all vertices and edges.
        """
        half = np.repeat(self.edge / 2, 2)
        return np.asarray(
            self.vertex + np.bincount(edge_uv.ravel(), half, minlength=len(self.vertex))
        )


def prices_of(
    resources: Resources, rows: NDArray[np.int64], penalty: NDArray[np.int64], bound: int
) -> Prices:
    """The prices that exact penalties say.

    Args:
        resources: of the problem.
        rows: (k,) int64, resources with a penalty.
        penalty: (k,) int64 ≥ 0 [1/SCALE cost units].
        bound: what they prove [1/SCALE cost units].
    """
    dense = np.zeros(resources.n, np.int64)
    dense[rows] = penalty
    vertex, edge, ap = resources.shaped(dense)
    problem = resources.problem
    # Sums are of integers, so they are exact, and so is the division by a power of two.
    found = Prices(
        vertex.sum(axis=0) / SCALE, edge.sum(axis=0) / SCALE, ap / SCALE, bound / SCALE, problem.c_t
    )
    return Prices(
        found.vertex,
        found.edge,
        found.ap_by_slot,
        found.bound,
        found.c_t,
        advice_of(problem, found),
    )


@dataclass(frozen=True)
class Shortage:
    """Something that holds the fleet back.

    Attributes:
        kind: "ap", "aisle" or "place".
        name: for people, with metres.
        price: [cost units].
        vertices, edges, aps: what belongs to it.
    """

    kind: str
    name: str
    price: float
    vertices: tuple[int, ...] = ()
    edges: tuple[int, ...] = ()
    aps: tuple[int, ...] = ()


def shortages(problem: Problem, prices: Prices) -> list[Shortage]:
    """APs, aisles and places with a price, the dearest first; no price is counted twice.

    On a grid, vertices and edges are gathered into aisles: the dearest stretch of a grid line
    without a gap, then the dearest of what is left, and so on.
    """
    found = [
        Shortage("ap", f"AP {problem.ap_ids[a]}", float(price), aps=(a,))
        for a, price in enumerate(prices.ap)
        if price > 0
    ]
    found += _aisles(problem, prices)
    return sorted(found, key=lambda shortage: -shortage.price)


def _aisles(problem: Problem, prices: Prices) -> Iterable[Shortage]:
    vertex, edge = prices.vertex.copy(), prices.edge.copy()
    lines = grid_lines(problem.xy_m, problem.edge_uv)
    while lines:
        price = [vertex[list(v)].sum() + edge[list(e)].sum() for _, v, e in lines]
        best = int(np.argmax(price))
        if not price[best] > 0:
            break
        axis, vertices, edges = lines.pop(best)
        ends = [(v,) for v in vertices if vertex[v] > 0]
        ends += [tuple(problem.edge_uv[e].tolist()) for e in edges if edge[e] > 0]
        span = sorted({v for pair in ends for v in pair})
        if len(span) > 1:
            name = stretch_name(problem, axis, span)
            yield Shortage("aisle", name, float(price[best]), vertices, edges)
        else:
            name = f"position {place(problem, span[0])}"
            yield Shortage("place", name, float(price[best]), tuple(span))
        vertex[list(vertices)] = 0.0
        edge[list(edges)] = 0.0
    for v in np.flatnonzero(vertex > 0).tolist():
        yield Shortage("place", f"position {place(problem, v)}", float(vertex[v]), (v,))
    for e in np.flatnonzero(edge > 0).tolist():
        u, v = problem.edge_uv[e].tolist()
        name = f"way {place(problem, u)}–{place(problem, v)}"
        yield Shortage("place", name, float(edge[e]), edges=(e,))


def stretch_name(problem: Problem, axis: int, vertices: Iterable[int]) -> str:
    """`aisle x = 12 m, y 3 to 9 m`: the stretch of a grid line that spans these vertices.

    Args:
        problem: for the places.
        axis: 0 for a line of equal x, 1 for one of equal y.
        vertices: on the line.
    """
    xy = problem.xy_m[list(vertices)]
    along, across = ("y", "x") if axis == 0 else ("x", "y")
    low, high = xy[:, 1 - axis].min(), xy[:, 1 - axis].max()
    span = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
    return f"aisle {across} = {xy[0, axis]:.4g} m, {along} {span} m"


def place(problem: Problem, vertex: int) -> str:
    """`(12, 3.5) m`."""
    x, y = problem.xy_m[vertex]
    return f"({x:.4g}, {y:.4g}) m"


def advice_of(problem: Problem, prices: Prices) -> str:
    """One sentence of advice: where one more unit of room would save most."""
    found = shortages(problem, prices)
    if not found:
        return "no shortage: what the fleet costs at least is what each robot costs alone"
    aps = _worth_naming([s for s in found if s.kind == "ap"])
    places = _worth_naming([s for s in found if s.kind != "ap"])
    parts = [
        f"{s.name}'s capacity costs {_rounded_up(s, prices)}"
        + (" (what one place more could save at most)" if k == 0 else "")
        for k, s in enumerate(aps)
    ]
    parts += [
        f"{s.name} costs {_rounded_up(s, prices)}"
        + (" (what a lane more there could save at most)" if k == 0 else "")
        for k, s in enumerate(places)
    ]
    if not aps:
        parts.append("AP capacity costs nothing")
    zone = _dense_zone(problem, prices)
    if zone:
        parts.append(zone)
    if prices.c_t and problem.c_h > problem.c_t:
        parts.append(f"a handover counts as {problem.c_h / problem.c_t:.4g} slots")
    return "; ".join(parts)


def _worth_naming(found: list[Shortage]) -> list[Shortage]:
    least = WORTH_NAMING * sum(s.price for s in found)
    return [s for s in found if s.price >= least][:NAMED]


def _rounded_up(shortage: Shortage, prices: Prices) -> str:
    """The price rounded up, since it is the most that can be saved (noise of an LP aside)."""
    value = shortage.price / (prices.c_t or 1) - 1e-3
    number = math.ceil(value) if value > 9 else math.ceil(10 * value) / 10
    return f"{number:g} {prices.unit.removesuffix('s') if number == 1 else prices.unit}"


def _dense_zone(problem: Problem, prices: Prices) -> str:
    """The window of a quarter of the floor's sides that holds most of the places' prices.

    Named if it holds at least half of them, and the floor is large enough to have zones.
    """
    around = prices.around(problem.edge_uv)
    total = float(around.sum())
    if total <= 0:
        return ""
    low, high = problem.xy_m.min(axis=0), problem.xy_m.max(axis=0)
    side = (high - low) / 4
    lines = [np.unique(problem.xy_m[:, axis]) for axis in (0, 1)]
    if min(len(line) for line in lines) < 8:
        return ""
    # The best window has a priced place on its left and one on its lower side.
    priced = problem.xy_m[around > 0]
    best, corner = -1.0, low
    for x in np.unique(priced[:, 0]):
        column = (problem.xy_m[:, 0] >= x - 1e-9) & (problem.xy_m[:, 0] <= x + side[0] + 1e-9)
        y, weight = problem.xy_m[column, 1], around[column]
        order = np.argsort(y, kind="stable")
        y, running = y[order], np.concatenate(([0.0], np.cumsum(weight[order])))
        end = np.searchsorted(y, y + side[1] + 1e-9, side="right")
        held = running[end] - running[np.searchsorted(y, y - 1e-9)]
        k = int(np.argmax(held))
        if held[k] > best:
            best, corner = float(held[k]), np.array([x, y[k]])
    if best < total / 2:
        return ""
    (x0, y0), (x1, y1) = corner, np.minimum(corner + side, high)
    return (
        f"{100 * best / total:.0f} % of the shortage of floor lies within x {x0:.4g} to {x1:.4g} m,"
        f" y {y0:.4g} to {y1:.4g} m"
    )
