"""Random layouts of lanes, most of them one-way, that take one slot or several to cross."""

from __future__ import annotations

from typing import Any

import numpy as np

from worlds.hall import Body, Graph, GraphEdge, GraphNode, Hall
from worlds.world import AccessPoint, PlanOptions, Radio, RandomRobots, Robots, World


def random_layout(seed: int, **parts: Any) -> World:
    """A lattice of 4 x 3 nodes some metres apart, its rim one-way, half of the rest two-way.

    `parts` are further parts of the world, or take the place of its own.
    """
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.uniform(2.5, 6.0, 4))
    y = np.cumsum(rng.uniform(2.5, 6.0, 3))
    at = {(c, r): (float(x[c]), float(y[r])) for c in range(4) for r in range(3)}
    rim = [*((c, 0) for c in range(4)), (3, 1), *((c, 2) for c in range(3, -1, -1)), (0, 1)]
    pairs = list(zip(rim, [*rim[1:], rim[0]], strict=True))
    inner = [((c, 1), (c + 1, 1)) for c in range(3)]
    inner += [((c, r), (c, r + 1)) for c in (1, 2) for r in range(2)]
    for a, b in inner:
        two_way, turned = rng.random(2) < 0.5
        one, other = (b, a) if turned else (a, b)
        pairs += [(one, other), (other, one)] if two_way else [(one, other)]
    name = "n{}{}".format
    edges = tuple(
        GraphEdge(
            id=f"{name(*a)}-{name(*b)}",
            start=name(*a),
            end=name(*b),
            speed_m_s=float(rng.choice([1.0, 1.5, 2.0])),
        )
        for a, b in pairs
    )
    nodes = tuple(GraphNode(id=name(*k), at_m=p) for k, p in at.items())
    own: dict[str, Any] = {
        "name": f"lattice {seed}",
        "hall": Hall(
            size_m=(30.0, 20.0),
            slot_s=float(rng.choice([1.5, 2.0, 3.0])),
            graph=Graph(node=nodes, edge=edges, speed_m_s=2.0),
            # Every second layout is too narrow for its robots.
            body=Body(length_m=1.4, width_m=1.0) if seed % 2 else Body(length_m=0.7, width_m=0.5),
        ),
        "ap": (
            AccessPoint(id="west", position_m=(1.0, 10.0, 4.0)),
            AccessPoint(id="east", position_m=(29.0, 10.0, 4.0)),
        ),
        "radio": Radio(tx_power_dbm=12.0),
        "robots": Robots(random=RandomRobots(count=7, seed=seed)),
        "plan": PlanOptions(horizon=60),
    }
    return World(**(own | parts))
