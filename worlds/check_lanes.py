"""Findings about a graph of lanes: W109–W116."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from worlds.boxes import footprint_hits, swept
from worlds.check import Finding, Site, places
from worlds.errands import components, robot_height_m
from worlds.floor import Floor
from worlds.hall import Graph
from worlds.lane_conflicts import Lanes, near_lanes, near_vertices, touching_followers
from worlds.lanes import lanes

NAMED = 3
SLOWED_SHARE = 0.25

KEY = ("hall", "graph")


def lane_findings(site: Site) -> list[Finding]:
    """All of them; none for a hall with a grid."""
    graph = site.world.hall.graph
    if graph is None:
        return []
    found = [Finding("W115", remark, (*KEY, "remarks")) for remark in graph.remarks]
    return [
        *found,
        *_ends(site.floor),
        *_traps(site.floor),
        *_blocked(site, graph),
        *_near(site),
        *_rounding(site, graph),
    ]


def _ends(floor: Floor) -> list[Finding]:
    """W109: nodes that no lane leads to, or none from."""
    n = len(floor.vertex_xy_m)
    u, v = floor.edge_uv.T
    both = ~floor.edge_oneway
    off = np.bincount(np.concatenate((u, v[both])), minlength=n) > 0
    to = np.bincount(np.concatenate((v, u[both])), minlength=n) > 0
    found = []
    for chosen, rule, effect in (
        (to & ~off, "cannot be left", "who drives there stays"),
        (off & ~to, "cannot be entered", "robots can only start there"),
        (~off & ~to, "has no lane", "it is of no use"),
    ):
        vertices = np.flatnonzero(chosen)
        if not len(vertices):
            continue
        many = f"{_named(floor, vertices)} {rule if len(vertices) == 1 else _plural(rule)}"
        message = f"{many} along the lanes: {effect}; add a lane, unless that is meant"
        found.append(Finding("W109", message, KEY, places(floor.vertex_xy_m[vertices])))
    return found


def _plural(rule: str) -> str:
    return rule.replace("has no lane", "have no lane")


def _traps(floor: Floor) -> list[Finding]:
    """W110: several nodes that can be entered and never be left, or the other way round."""
    n, m = len(floor.vertex_xy_m), len(floor.edge_uv)
    every_v, every_e = np.ones(n, dtype=np.bool_), np.ones(m, dtype=np.bool_)
    part = components(floor, every_v, every_e)
    u, v = floor.edge_uv.T
    size = np.bincount(part)
    goes_out, comes_in = np.zeros(len(size), np.bool_), np.zeros(len(size), np.bool_)
    between = part[u] != part[v]
    goes_out[part[u[between]]] = True
    comes_in[part[v[between]]] = True
    found = []
    for p in np.flatnonzero((size > 1) & (np.arange(len(size)) > 0)).tolist():
        if goes_out[p] == comes_in[p]:
            continue  # in between, or another piece altogether (W104)
        rule = "can be entered, but not left" if comes_in[p] else "can be left, but not entered"
        inside = np.flatnonzero(part == p)
        message = f"{_named(floor, inside)} {rule} along the one-way lanes; add a lane"
        found.append(Finding("W110", message, KEY, places(floor.vertex_xy_m[inside])))
    return found


def _blocked(site: Site, graph: Graph) -> list[Finding]:
    """W111: lanes on which a robot would touch an obstacle; they are not used."""
    floor, body = site.floor, site.sound.hall.body
    xy = graph.xy_m()
    ends, _, _ = lanes(graph, floor.slot_s)
    if not len(ends):
        return []
    strip = swept(xy[ends[:, 0]], xy[ends[:, 1]], body.length_m, body.width_m)
    hit = footprint_hits(floor.boxes, *strip, body_height_m=robot_height_m(site.sound))
    wrong = np.flatnonzero(hit >= 0)
    if not len(wrong):
        return []
    said = ", ".join(
        f"{_lane(graph, *ends[e].tolist())} ('{floor.boxes.name[hit[e]]}')"
        for e in wrong[:NAMED].tolist()
    )
    more = f" and {len(wrong) - NAMED} more" if len(wrong) > NAMED else ""
    message = (
        f"on {_count(len(wrong), 'lane')} a robot would touch an obstacle: {said}{more}; move the "
        "obstacle or the nodes, or take the lane out: it is not used"
    )
    middle = xy[ends[wrong]].mean(axis=1)
    return [Finding("W111", message, KEY, places(middle))]


def _near(site: Site) -> list[Finding]:
    """W112–W114: where robots touch although the rules of a plan are kept."""
    floor, body = site.floor, site.sound.hall.body
    all_lanes = Lanes(floor.vertex_xy_m, floor.edge_uv, floor.edge_oneway, floor.edge_slots)
    xy, uv, ids = floor.vertex_xy_m, floor.edge_uv, floor.node_id
    found = []
    size = f"{body.length_m:g} m x {body.width_m:g} m"
    pairs = near_vertices(all_lanes, body)
    if pairs:
        said = _examples([f"'{ids[a]}' and '{ids[b]}'" for a, b in pairs])
        message = (
            f"{_count(len(pairs), 'pair')} of nodes are nearer than bodies of {size}: {said}; "
            "robots standing there at the same time touch. Make the robots smaller, or make one "
            "node of two"
        )
        found.append(Finding("W112", message, KEY, places(xy[sorted({a for a, _ in pairs})])))
    crossing = near_lanes(all_lanes, body)
    if crossing:
        lane = [f"'{ids[u]}'–'{ids[v]}'" for u, v in uv.tolist()]
        said = _examples([f"{lane[a]} and {lane[b]}" for a, b in crossing])
        message = (
            f"{_count(len(crossing), 'pair')} of lanes cross or run too near each other for bodies "
            f"of {size}: {said}; nothing keeps robots on them apart. Put a node where they cross"
        )
        middle = np.array([xy[uv[[a, b]].ravel()].mean(axis=0) for a, b in crossing])
        found.append(Finding("W113", message, KEY, places(middle)))
    touching = touching_followers(all_lanes, body)
    if touching:
        count = Counter(follower.vertex for follower in touching)
        said = _examples([f"'{ids[v]}'" for v, _ in count.most_common()])
        message = (
            f"at {_count(len(count), 'node')} robots following each other touch: {said}; in a slot "
            f"of {floor.slot_s:g} s the one ahead is not out of the way of bodies of {size}. Take "
            "a longer hall.slot_s, smaller robots, or faster lanes there"
        )
        found.append(Finding("W114", message, KEY, places(xy[sorted(count)])))
    return found


def _rounding(site: Site, graph: Graph) -> list[Finding]:
    """W116: slots so long that lanes take much longer than at their speed."""
    speed = np.array([min(e.speed_m_s or np.inf, graph.speed_m_s) for e in graph.edge])
    length = graph.length_m()
    alone = float((length / speed).sum())
    _, oneway, slots = lanes(graph, site.floor.slot_s)
    taken = float((slots * np.where(oneway, 1, 2)).sum()) * site.floor.slot_s
    if not alone or taken / alone - 1 <= SLOWED_SHARE:
        return []
    message = (
        f"in slots of {site.floor.slot_s:g} s lanes take {taken / alone - 1:.0%} longer than at "
        "their speed, since each takes whole slots; try another hall.slot_s"
    )
    return [Finding("W116", message, ("hall", "slot_s"))]


def _lane(graph: Graph, u: int, v: int) -> str:
    return f"'{graph.node[u].id}'–'{graph.node[v].id}'"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' if number != 1 else ''}"


def _examples(names: list[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more


def _named(floor: Floor, vertices: NDArray[np.intp]) -> str:
    names = _examples([f"'{floor.node_id[v]}'" for v in vertices.tolist()])
    return f"{'nodes' if len(vertices) > 1 else 'node'} {names}"
