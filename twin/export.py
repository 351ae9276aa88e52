"""What others can read of a world and of a plan: VDMA LIF, and a table of the plan.

Of orders for robots see `twin.export_orders`.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

from logs.mcap_format import EPOCH
from planner.plan import Plan
from planner.problem import Problem
from twin.errors import TwinError
from twin.track_names import TrackNames
from worlds.floor import Floor
from worlds.formats.lif import Lif, LifStation, lif_text
from worlds.hall import GraphEdge, GraphNode
from worlds.places import NowhereError, position_of
from worlds.world import World

VEHICLE = "robot"
"""Vehicle type of a hall that names none."""

CSV_COLUMNS = ("robot", "slot", "t_s", "node", "x_m", "y_m", "ap", "edge", "to_node", "handover")


def lif_of(world: World, floor: Floor) -> tuple[Lif, list[str]]:
    """The tracks of a world as a LIF layout, and what of it a LIF file cannot say.

    A graph is given as it was read, blocked nodes and lanes included, in its own frame; a grid by
    its free positions and moves, each in both directions, in that of the hall.
    """
    graph = world.hall.graph
    if graph is not None:
        stations = tuple(LifStation(s.name, s.nodes) for s in world.station if s.nodes)
        left = [s.name for s in world.station if not s.nodes]
        told = [f"station '{name}' is not at a node of the graph: left out" for name in left]
        layout, vehicle = graph.layout or world.name, graph.vehicle or VEHICLE
        return Lif(layout, vehicle, graph.node, graph.edge, stations), told
    names = TrackNames.of(world, floor)
    speed = world.hall.grid_pitch_m / floor.slot_s
    nodes = tuple(
        GraphNode(id=name, at_m=(x, y))
        for name, (x, y) in zip(names.node, names.at_m.tolist(), strict=True)
    )
    edges = tuple(
        GraphEdge(id=names.edge_id(a, b), start=names.node[a], end=names.node[b], speed_m_s=speed)
        for u, v in floor.edge_uv.tolist()
        for a, b in ((u, v), (v, u))
    )
    told, found = [], []
    for station in world.station:
        try:
            vertex = floor.vertex_at(position_of(world.hall, station))
        except NowhereError:
            vertex = -1
        if vertex < 0:
            told.append(f"station '{station.name}' is at a blocked position: left out")
        else:
            found.append(LifStation(station.name, (names.node[vertex],)))
    return Lif(world.name, VEHICLE, nodes, edges, tuple(found)), told


def dump_lif(world: World, lif: Lif, timestamp: str = f"{EPOCH[:-1]}.00Z") -> str:
    """A LIF 1.0.0 file: the same world gives the same bytes, `timestamp` is no wall clock's."""
    return lif_text(
        lif.nodes,
        lif.edges,
        lif.stations,
        layout=lif.layout,
        vehicle=lif.vehicle,
        project=world.name,
        timestamp=timestamp,
    )


def plan_csv(problem: Problem, plan: Plan, names: TrackNames, slot_s: float) -> str:
    """The plan as a table: one row per robot and slot, comma-separated, with a heading.

    `edge` and `to_node` are those being crossed in the slot, empty while waiting; `handover` is 1
    where the AP is another one than in the slot before.

    Args:
        problem: what was planned for.
        plan: of the problem.
        names: of the problem's vertices.
        slot_s: length of a slot [s].

    Raises:
        TwinError: the plan has no path for any robot.
    """
    if all(path is None for path in plan.paths):
        raise TwinError("the plan has no path for any robot; there is nothing to export")
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    writer.writerows(_rows(problem, plan, names, slot_s))
    return text.getvalue()


def _rows(
    problem: Problem, plan: Plan, names: TrackNames, slot_s: float
) -> Iterator[tuple[object, ...]]:
    for path in plan.paths:
        if path is None:
            continue
        edges = [*path.edges.tolist(), -1]
        aps = path.aps.tolist()
        for slot, (vertex, ap) in enumerate(zip(path.vertices.tolist(), aps, strict=True)):
            edge, to_node = "", ""
            if edges[slot] >= 0:
                u, v = problem.edge_uv[edges[slot]].tolist()
                end = v if u == vertex else u
                edge, to_node = names.edge_id(vertex, end), names.node[end]
            x, y = problem.xy_m[vertex].tolist()
            yield (
                path.robot,
                slot,
                round(slot * slot_s, 9),
                names.node[vertex],
                x,
                y,
                problem.ap_ids[ap],
                edge,
                to_node,
                int(slot > 0 and ap != aps[slot - 1]),
            )
