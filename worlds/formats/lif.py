"""VDMA LIF, the Layout Interchange Format: tracks of automated guided vehicles as a graph, JSON.

Version 1.0.0 of VDMA's guideline, with the schema of github.com/continua-systems/vdma-lif. A layout
has nodes, directed edges, and stations; which of them a vehicle may use, and how fast, is said per
type of vehicle. There are no walls and no access points in it.

What is read: places of nodes, ends and `maxSpeed` of edges, `interactionNodeIds` of stations, for
one layout and one vehicle type. Lengths are metres and angles radians by the guideline; robots here
head along the edge, so angles are not used, but told of where they must be degrees. Trajectories
are driven as the straight line between the nodes, which is told of, too. Keys that are not known
(version 2.0 has `origins`) are passed over.
"""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from worlds.formats.json_file import (
    faults_of,
    file_error,
    listed_error,
    parse_json,
    read_text,
)
from worlds.formats.lif_json import LifEdgeProperty, LifFile, LifLayout, LifNode
from worlds.hall import GraphEdge, GraphNode, graph_faults
from worlds.part import nearest

WHAT = "a LIF file"
LIF_VERSION = "1.0.0"
MAX_LANE_M, MAX_SITE_M, MAX_SPEED_M_S = 100.0, 5000.0, 20.0
"""A layout whose typical edge, whose extent or whose speeds are larger is not in metres."""


@dataclass(frozen=True)
class LifStation:
    """A station.

    Attributes:
        id: of the station.
        nodes: ids of those from which it is served, at least one.
    """

    id: str
    nodes: tuple[str, ...]


@dataclass(frozen=True)
class Lif:
    """A layout as one type of vehicle may use it.

    Attributes:
        layout: its id.
        vehicle: id of the type of vehicle.
        nodes, edges: places [m] and speeds [m/s].
        stations: those the type can get to.
        remarks: what was left out or taken differently than the file may mean it.
    """

    layout: str
    vehicle: str
    nodes: tuple[GraphNode, ...]
    edges: tuple[GraphEdge, ...]
    stations: tuple[LifStation, ...]
    remarks: tuple[str, ...] = ()


def read_lif(path: Path, *, layout: str | None = None, vehicle: str | None = None) -> Lif:
    """A layout of a LIF file.

    Args:
        path: of the JSON file.
        layout: id of the layout; may be left out where there is one only.
        vehicle: id of the vehicle type; may be left out where there is one only.

    Raises:
        WorldError: with all that is wrong, each naming the file and the place in it.
    """
    return parse_lif(read_text(path, WHAT), str(path), layout=layout, vehicle=vehicle)


def parse_lif(
    text: str, name: str, *, layout: str | None = None, vehicle: str | None = None
) -> Lif:
    """`read_lif` for a text; `name` stands for the file in messages."""
    data = parse_json(text, name, WHAT)
    if not isinstance(data, dict) or "layouts" not in data:
        raise file_error(name, "is not a LIF file: it has no layouts")
    try:
        lif = LifFile.model_validate(data)
    except ValidationError as error:
        raise faults_of(error, data, name) from None
    remarks = _version_remarks(lif.metaInformation.lifVersion, name)
    index = _chosen_layout(lif, layout, name)
    return _taken(lif, index, vehicle, remarks, name)


def _version_remarks(version: str, name: str) -> list[str]:
    major = version.split(".", maxsplit=1)[0]
    if major not in {"0", "1", "2"}:
        rule = f"lifVersion {version!r} is not known"
        raise file_error(name, f"metaInformation.lifVersion: {rule}; versions 1 and 2 are read")
    return [f"the file has LIF version {version}, read as 1.0"] if major != "1" else []


def _chosen_layout(lif: LifFile, wanted: str | None, name: str) -> int:
    ids = [layout.layoutId for layout in lif.layouts]
    doubled = [k for k, i in enumerate(ids) if i in ids[:k]]
    if doubled:
        k = doubled[0]
        raise file_error(name, f"layouts[{k}].layoutId: '{ids[k]}' is an earlier layout's already")
    if wanted is None:
        if len(ids) > 1:
            known = ", ".join(ids[:8])
            raise file_error(name, f"has {len(ids)} layouts; name one as layout: {known}")
        return 0
    if wanted not in ids:
        hint = nearest(wanted, ids) or f" known are {', '.join(ids[:8])}"
        raise file_error(name, f"has no layout '{wanted}';{hint}")
    return ids.index(wanted)


def _chosen_vehicle(layout: LifLayout, wanted: str | None, name: str) -> str:
    types = dict.fromkeys(
        p.vehicleTypeId for edge in layout.edges for p in edge.vehicleTypeEdgeProperties
    )
    known = list(types) or list(
        dict.fromkeys(p.vehicleTypeId for n in layout.nodes for p in n.vehicleTypeNodeProperties)
    )
    if wanted is None:
        if len(known) > 1:
            said = ", ".join(known[:8])
            rule = f"is for {len(known)} vehicle types; name one as vehicle: {said}"
            raise file_error(name, rule)
        if not known:
            raise file_error(name, "names no vehicle type, so nobody may use the layout")
        return known[0]
    if wanted not in known:
        hint = nearest(wanted, known) or f" known are {', '.join(known[:8])}"
        raise file_error(name, f"has nothing for a vehicle type '{wanted}';{hint}")
    return wanted


def _taken(lif: LifFile, index: int, vehicle: str | None, remarks: list[str], name: str) -> Lif:
    """What one type may use of a layout, checked."""
    layout = lif.layouts[index]
    chosen = _chosen_vehicle(layout, vehicle, name)
    every_node = {node.nodeId for node in layout.nodes}
    elsewhere = {n.nodeId for other in lif.layouts for n in other.nodes} - every_node
    at = f"layouts[{index}]"
    # All nodes and edges are checked, so that a mistake shows whatever the type.
    nodes = [
        GraphNode(id=n.nodeId, at_m=_xy(n, f"{at}.nodes[{i}]", name))
        for i, n in enumerate(layout.nodes)
    ]
    _check(layout, nodes, elsewhere, at, name)

    ours = {n.nodeId for n in layout.nodes if _of(n.vehicleTypeNodeProperties, chosen)}
    edges: list[GraphEdge] = []
    ways: set[tuple[str, str]] = set()
    left: dict[str, int] = {}
    properties: list[LifEdgeProperty] = []
    for edge in layout.edges:
        found = _of(edge.vehicleTypeEdgeProperties, chosen)
        way = (edge.startNodeId, edge.endNodeId)
        reason = ""
        if not found:
            continue
        if edge.endNodeId in elsewhere:
            reason = "lead to another layout"
        elif not ours.issuperset(way):
            reason = f"lead from or to a node that '{chosen}' may not use"
        elif way in ways:
            reason = "lead where an earlier edge leads already"
        if reason:
            left[reason] = left.get(reason, 0) + 1
            continue
        ways.add(way)
        properties.append(found[0])
        speed = found[0].maxSpeed
        edges.append(GraphEdge(id=edge.edgeId, start=way[0], end=way[1], speed_m_s=speed))
    remarks += [f"{_edges(n, reason)}: left out" for reason, n in left.items()]
    remarks += _remarks(layout, properties, chosen)
    stations, lost = [], []
    for station in layout.stations:
        usable = tuple(node for node in station.interactionNodeIds if node in ours)
        if usable:
            stations.append(LifStation(station.stationId, usable))
        else:
            lost.append(station.stationId)
    if lost:
        names = ", ".join(f"'{s}'" for s in lost[:4])
        remarks.append(f"'{chosen}' may not get to the stations {names}: left out")
    kept = tuple(node for node in nodes if node.id in ours)
    return Lif(layout.layoutId, chosen, kept, tuple(edges), tuple(stations), tuple(remarks))


def _of(properties: Sequence[Any], vehicle: str) -> list[Any]:
    return [p for p in properties if p.vehicleTypeId == vehicle]


def _xy(node: LifNode, place: str, name: str) -> tuple[float, float]:
    x, y = node.nodePosition.x, node.nodePosition.y
    if max(abs(x), abs(y)) > 1e6:
        rule = f"[{x:g}, {y:g}] is more than 1000 km from the origin"
        raise file_error(name, f"{place}.nodePosition: {rule}; give metres")
    return x, y


_KEYS = {
    "node": "nodes",
    "edge": "edges",
    "start": "startNodeId",
    "end": "endNodeId",
    "at_m": "nodePosition",
}


def _check(
    layout: LifLayout, nodes: list[GraphNode], elsewhere: set[str], at: str, name: str
) -> None:
    """Refuse a layout whose ids, ends, lengths or units cannot be right.

    Raises:
        WorldError: with all that is wrong.
    """
    inside = [
        # Ends in another layout are not dangling, and parallel edges of types or loads are usual.
        GraphEdge.model_construct(id=e.edgeId, start=e.startNodeId, end=e.endNodeId)
        for e in layout.edges
    ]
    found: list[tuple[str, str]] = []
    for fault in graph_faults(tuple(nodes), tuple(inside)):
        table, i, *rest = fault.key
        if not rest and "keep one of them" in fault.message:
            continue
        end = rest[0] if rest else ""
        if end in {"start", "end"} and getattr(inside[int(i)], str(end)) in elsewhere:
            continue
        key = {("node", "id"): "nodeId", ("edge", "id"): "edgeId"}.get(
            (str(table), str(end)), _KEYS.get(str(end), "")
        )
        place = f"{at}.{_KEYS[str(table)]}[{i}]" + (f".{key}" if key else "")
        found.append((place, fault.message))
    seen: set[str] = set()
    known = {node.id for node in nodes}
    for i, station in enumerate(layout.stations):
        place = f"{at}.stations[{i}]"
        if station.stationId in seen:
            rule = f"'{station.stationId}' is the id of an earlier station already"
            found.append((f"{place}.stationId", rule))
        seen.add(station.stationId)
        for k, node in enumerate(station.interactionNodeIds):
            if node not in known:
                hint = nearest(node, list(known)) or " mend it, or take it out"
                rule = f"'{node}' is not the id of a node of this layout;{hint}"
                found.append((f"{place}.interactionNodeIds[{k}]", rule))
    found += _unit_faults(layout, nodes, at)
    if found:
        raise listed_error(name, found)


def _unit_faults(layout: LifLayout, nodes: list[GraphNode], at: str) -> Iterator[tuple[str, str]]:
    """Coordinates that are not metres, speeds that are not metres per second."""
    xy = {node.id: node.at_m for node in nodes}
    pairs = [
        (e.startNodeId, e.endNodeId)
        for e in layout.edges
        if e.startNodeId in xy and e.endNodeId in xy
    ]
    if pairs:
        typical = statistics.median(math.dist(xy[a], xy[b]) for a, b in pairs)
        x, y = zip(*xy.values(), strict=True)
        extent = max(max(x) - min(x), max(y) - min(y))
        if typical > MAX_LANE_M or extent > MAX_SITE_M:
            rule = f"a typical edge is {typical:g} m long, the layout spans {extent:g} m"
            yield f"{at}.nodes", f"{rule}; LIF has metres, these look like millimetres"
    for i, edge in enumerate(layout.edges):
        for k, p in enumerate(edge.vehicleTypeEdgeProperties):
            if p.maxSpeed is None:
                continue
            place = f"{at}.edges[{i}].vehicleTypeEdgeProperties[{k}].maxSpeed"
            if p.maxSpeed <= 0:
                yield place, f"{p.maxSpeed:g} m/s: nobody can drive there; take the edge out"
            elif p.maxSpeed > MAX_SPEED_M_S:
                yield place, f"{p.maxSpeed:g} m/s is too fast; LIF has metres per second"
            elif p.maxSpeed < 0.01:
                yield place, f"{p.maxSpeed:g} m/s is too slow; LIF has metres per second"


def _remarks(layout: LifLayout, properties: list[LifEdgeProperty], vehicle: str) -> list[str]:
    """What a file says that is taken more simply here."""
    remarks = []
    curved = sum(p.trajectory is not None for p in properties)
    if curved:
        remarks.append(f"{_edges(curved, 'have a trajectory')}: robots drive straight instead")
    loads = [p.loadRestriction for p in properties if p.loadRestriction is not None]
    restricted = sum(not (load.loaded and load.unloaded) for load in loads)
    if restricted:
        remarks.append(f"{_edges(restricted, 'have load restrictions')}: not heeded")
    angles = [p.vehicleOrientation for p in properties]
    angles += [p.theta for n in layout.nodes for p in _of(n.vehicleTypeNodeProperties, vehicle)]
    largest = max((abs(a) for a in angles if a is not None), default=0.0)
    if largest > 2 * math.pi + 1e-6:
        remarks.append(
            f"angles up to {largest:g} cannot be radians, which LIF asks for; they are not used"
        )
    return remarks


def _edges(count: int, what: str) -> str:
    """`1 edge leads …`, `3 edges lead …`."""
    if count == 1:
        verb, _, rest = what.partition(" ")
        return f"1 edge {'has' if verb == 'have' else verb + 's'} {rest}"
    return f"{count} edges {what}"


def lif_text(
    nodes: Sequence[GraphNode],
    edges: Sequence[GraphEdge],
    stations: Sequence[LifStation],
    *,
    layout: str,
    vehicle: str,
    project: str,
    timestamp: str,
) -> str:
    """A LIF 1.0.0 file of one layout for one type of vehicle.

    Args:
        nodes: places in metres.
        edges: each directed; a speed of None is no limit.
        stations: with ids of `nodes`.
        layout: its id.
        vehicle: id of the type of vehicle.
        project: name of the project.
        timestamp: of the export, ISO 8601 in UTC.
    """
    value = {
        "metaInformation": {
            "projectIdentification": project,
            "creator": "mapp-twin",
            "exportTimestamp": timestamp,
            "lifVersion": LIF_VERSION,
        },
        "layouts": [
            {
                "layoutId": layout,
                "layoutVersion": "1",
                "nodes": [
                    {
                        "nodeId": node.id,
                        "nodePosition": {"x": node.at_m[0], "y": node.at_m[1]},
                        "vehicleTypeNodeProperties": [{"vehicleTypeId": vehicle}],
                    }
                    for node in nodes
                ],
                "edges": [
                    {
                        "edgeId": edge.id,
                        "startNodeId": edge.start,
                        "endNodeId": edge.end,
                        "vehicleTypeEdgeProperties": [
                            {"vehicleTypeId": vehicle, "rotationAllowed": False}
                            | ({} if edge.speed_m_s is None else {"maxSpeed": edge.speed_m_s})
                        ],
                    }
                    for edge in edges
                ],
                "stations": [
                    {"stationId": s.id, "interactionNodeIds": list(s.nodes)} for s in stations
                ],
            }
        ],
    }
    return json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
