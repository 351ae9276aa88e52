"""The parts of a LIF file that are read, as they stand in its JSON."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from worlds.formats.json_file import JsonPart
from worlds.scalars import Id


class LifPosition(JsonPart):
    """Metres in the layout's frame."""

    x: float
    y: float


class LifNodeProperty(JsonPart):
    """How one type of vehicle may use a node."""

    vehicleTypeId: Id  # noqa: N815 (the format's name, as all of these)
    theta: float | None = None


class LifNode(JsonPart):
    """A position."""

    nodeId: Id  # noqa: N815
    nodePosition: LifPosition  # noqa: N815
    vehicleTypeNodeProperties: list[LifNodeProperty] = Field(min_length=1)  # noqa: N815


class LifLoadRestriction(JsonPart):
    """Which vehicles may use an edge."""

    unloaded: bool
    loaded: bool


class LifEdgeProperty(JsonPart):
    """How one type of vehicle may use an edge."""

    vehicleTypeId: Id  # noqa: N815
    vehicleOrientation: float | None = None  # noqa: N815
    maxSpeed: float | None = None  # noqa: N815
    loadRestriction: LifLoadRestriction | None = None  # noqa: N815
    trajectory: dict[str, Any] | None = None


class LifEdge(JsonPart):
    """A lane in one direction."""

    edgeId: Id  # noqa: N815
    startNodeId: Id  # noqa: N815
    endNodeId: Id  # noqa: N815
    vehicleTypeEdgeProperties: list[LifEdgeProperty] = Field(min_length=1)  # noqa: N815


class LifStationPart(JsonPart):
    """A place to pick up and drop loads, with the nodes it is served from."""

    stationId: Id  # noqa: N815
    interactionNodeIds: Annotated[list[Id], Field(min_length=1)]  # noqa: N815


class LifLayout(JsonPart):
    """One floor."""

    layoutId: Id  # noqa: N815
    nodes: list[LifNode]
    edges: list[LifEdge]
    stations: list[LifStationPart]


class LifMeta(JsonPart):
    """About the file."""

    lifVersion: str  # noqa: N815


class LifFile(JsonPart):
    """The whole file."""

    metaInformation: LifMeta  # noqa: N815
    layouts: Annotated[list[LifLayout], Field(min_length=1)]
