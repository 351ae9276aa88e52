"""LIF files made for tests: a small one-way ring with a spur, and ways to spoil it."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

Lif = dict[str, Any]

SCHEMAS = Path(__file__).resolve().parents[3] / "shared/data/schemas"


def node(name: str, x: float, y: float, *types: str) -> dict[str, Any]:
    """A node that vehicles of these types may use."""
    return {
        "nodeId": name,
        "nodePosition": {"x": x, "y": y},
        "vehicleTypeNodeProperties": [{"vehicleTypeId": t} for t in types or ("tug",)],
    }


def edge(start: str, end: str, speed: float | None = None, *types: str, **more: Any) -> Lif:
    """A directed edge."""
    properties: list[dict[str, Any]] = [
        {"vehicleTypeId": t, "rotationAllowed": False, **more} for t in types or ("tug",)
    ]
    for p in properties:
        if speed is not None:
            p["maxSpeed"] = speed
    return {
        "edgeId": f"{start}>{end}",
        "startNodeId": start,
        "endNodeId": end,
        "vehicleTypeEdgeProperties": properties,
    }


# a 6 m x 4 m ring a → b → c → d → a, and a spur d ⇄ dock
RING: Lif = {
    "metaInformation": {
        "projectIdentification": "ring",
        "creator": "test",
        "exportTimestamp": "2024-01-01T00:00:00.00Z",
        "lifVersion": "1.0.0",
    },
    "layouts": [
        {
            "layoutId": "floor 1",
            "layoutVersion": "1",
            "nodes": [
                node("a", 0.0, 0.0),
                node("b", 6.0, 0.0),
                node("c", 6.0, 4.0),
                node("d", 0.0, 4.0),
                node("dock", -3.0, 4.0),
            ],
            "edges": [
                edge("a", "b", 2.0),
                edge("b", "c", 1.0),
                edge("c", "d"),
                edge("d", "a", 1.0),
                edge("d", "dock", 0.5),
                edge("dock", "d", 1.0),
            ],
            "stations": [
                {"stationId": "gate", "interactionNodeIds": ["dock", "d"]},
                {"stationId": "shelf", "interactionNodeIds": ["b"]},
            ],
        }
    ],
}


def spoilt(change: Callable[[Lif], None]) -> str:
    """The ring's text after a change of its value."""
    value = copy.deepcopy(RING)
    change(value)
    return json.dumps(value)


def layout(value: Lif) -> dict[str, Any]:
    """The first layout."""
    found: dict[str, Any] = value["layouts"][0]
    return found


# A world around the ring: 2 m of floor on each side; two access points reach all of it.
WORLD = """\
name = "ring"
[hall]
size_m = [14.0, 8.0]
slot_s = 1.0
[hall.graph]
lif = "ring.lif.json"
offset_m = [5.0, 2.0]
[hall.body]
length_m = 0.6
width_m = 0.4
[[ap]]
id = "west"
position_m = [3.0, 1.0, 4.0]
[[ap]]
id = "east"
position_m = [12.0, 7.0, 4.0]
[[robot]]
id = "anna"
start = "gate"
goal = "shelf"
[[robot]]
id = "bert"
start = "shelf"
goal = {node = "a"}
[plan]
horizon = 40
"""


def write_world(folder: Path, *edits: tuple[str, str], lif: str | None = None) -> Path:
    """The world with replacements (each is there once), and its LIF file beside it."""
    text = WORLD
    for old, new in edits:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    (folder / "ring.lif.json").write_text(json.dumps(RING) if lif is None else lif)
    path = folder / "ring.toml"
    path.write_text(text)
    return path
