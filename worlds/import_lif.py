"""From a LIF file to a world: what a layout of lanes does not say is filled in.

The world names the LIF file and does not copy it, so that a new version of the layout needs no new
import. Walls are taken from the extent of the nodes; racks and machines are the user's to add.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from worlds.ap_proposal import Proposal, propose_aps
from worlds.errands import components
from worlds.errors import Fault, WorldError
from worlds.floor import Floor
from worlds.formats.lif import Lif, read_lif
from worlds.generate import resolve
from worlds.hall import Body, Graph, Hall
from worlds.lane_conflicts import Lanes, near_lanes, near_vertices, touching_followers
from worlds.lanes import lanes, traversal_slots
from worlds.map_import import (
    MAX_HEIGHT_M,
    ImportedWorld,
    ImportParams,
    commented,
    with_aps_and_horizon,
)
from worlds.toml_file import dump_world, parse_world
from worlds.world import (
    AccessPoint,
    Radio,
    RandomRobots,
    Robots,
    Station,
    World,
)

MARGIN_M = 2.0
"""Between the outermost nodes and the walls."""

DEFAULT_SPEED_M_S = 1.5

SLOTS_S = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0)
"""Lengths of a slot to choose from."""


@dataclass(frozen=True)
class LifParams:
    """What a LIF file does not decide by itself, beside `ImportParams`.

    Attributes:
        layout, vehicle: ids, where the file has several.
        slot_s: length of a slot [s]; chosen when None.
        speed_m_s: of the robots where a lane allows it [m/s]; the default when None.
    """

    layout: str | None = None
    vehicle: str | None = None
    slot_s: float | None = None
    speed_m_s: float | None = None

    def __post_init__(self) -> None:
        wrong = []
        if self.slot_s is not None and not 0.001 <= self.slot_s <= 3600:
            wrong.append(f"a slot of {self.slot_s:g} s is outside 0.001 to 3600 s")
        if self.speed_m_s is not None and not 0.01 <= self.speed_m_s <= 50:
            wrong.append(f"a speed of {self.speed_m_s:g} m/s is outside 0.01 to 50 m/s")
        if wrong:
            raise WorldError([Fault((), text) for text in wrong])


def import_lif(
    source: Path, target: Path, params: ImportParams, lif_params: LifParams
) -> ImportedWorld:
    """A complete world around the lanes of a LIF file: walls, access points and robots proposed.

    Args:
        source: the LIF file.
        target: where the world will be written; the path to the LIF file is relative to it.
        params: its pitch and obstacles' height do not matter.
        lif_params: of the layout.

    Raises:
        WorldError: the file is none, or there is no room for the robots.
    """
    lif = read_lif(source, layout=lif_params.layout, vehicle=lif_params.vehicle)
    bare = _bare_world(lif, params, lif_params)
    hints = list(lif.remarks)
    first = resolve(bare)
    everything = np.ones(len(first.vertex_xy_m), dtype=np.bool_)
    every_lane = np.ones(len(first.edge_uv), dtype=np.bool_)
    main = components(first, everything, every_lane) == 0
    if not main.all():
        away = int((~main).sum())
        hints.append(
            f"{away} of {len(main)} nodes cannot be both reached and left along the lanes; random "
            "robots keep to the others (twin check tells which)"
        )
    proposal = propose_aps(
        bare,
        first,
        height_m=params.ap_height_m,
        robots=params.robots,
        target=params.coverage,
        wanted=main,
    )
    world, floor, longest, told = with_aps_and_horizon(bare, first, proposal, params.horizon)
    hints += told
    hints += _rounding(world) + _touching(world, first)
    # Checked by the absolute path, since the folder of the target may not exist yet.
    absolute = _text(world, lif, source.absolute(), proposal, longest)
    parsed = parse_world(absolute, folder=Path())
    if parsed != world:
        raise AssertionError("the text does not say what the world says")  # a defect here
    relative = Path(os.path.relpath(source.resolve(), target.parent.resolve()))
    text = _text(world, lif, relative, proposal, longest)
    return ImportedWorld(parsed, text, floor, proposal, longest, tuple(hints))


def _bare_world(lif: Lif, params: ImportParams, lif_params: LifParams) -> World:
    """The world without its access points (one stands for them) and with the default horizon."""
    if not lif.edges:
        message = f"layout '{lif.layout}' has no edges for '{lif.vehicle}'; there is nowhere to go"
        raise WorldError([Fault((), message)])
    xy = np.array([node.at_m for node in lif.nodes])
    low, high = xy.min(axis=0), xy.max(axis=0)
    offset = np.round(MARGIN_M - low, 3)
    size = np.ceil((high - low + 2 * MARGIN_M) * 2) / 2
    length, width = params.body_m or (Body().length_m, Body().width_m)
    graph = Graph(
        layout=lif.layout,
        vehicle=lif.vehicle,
        offset_m=(float(offset[0]), float(offset[1])),
        speed_m_s=lif_params.speed_m_s or DEFAULT_SPEED_M_S,
        node=lif.nodes,
        edge=lif.edges,
        remarks=lif.remarks,
    )
    body = Body(length_m=length, width_m=width)
    slot_s = lif_params.slot_s or _slot_s(graph, body)
    robots = RandomRobots(count=params.robots, seed=params.seed)
    return World(
        name=params.name,
        story=f"The layout '{lif.layout}' for vehicles of type '{lif.vehicle}'.",
        hall=Hall(
            size_m=(float(size[0]), float(size[1])),
            slot_s=slot_s,
            graph=graph,
            body=body,
        ),
        ap=(AccessPoint(id="none yet", position_m=(0.0, 0.0, 2 * MAX_HEIGHT_M)),),
        radio=Radio() if params.model is None else Radio(model=params.model),
        station=tuple(Station(name=s.id, nodes=s.nodes) for s in lif.stations),
        robots=Robots(random=robots),
    )


def _slot_s(graph: Graph, body: Body) -> float:
    """The slot that suits the lanes: robots get out of each other's way, little time is lost.

    Of the slots with which robots that follow each other touch at the fewest places, the one by
    which rounding up to whole slots lengthens the lanes least.
    """
    length = graph.length_m()
    speed = np.array([min(e.speed_m_s or math.inf, graph.speed_m_s) for e in graph.edge])

    def cost(slot_s: float) -> tuple[int, float]:
        touching = touching_followers(Lanes(graph.xy_m(), *lanes(graph, slot_s)), body)
        slots = traversal_slots(length, speed, slot_s)
        return len(touching), _lost(length, speed, slots, slot_s)

    return min(SLOTS_S, key=cost)


def _lost(
    length_m: NDArray[np.float64],
    speed_m_s: NDArray[np.float64],
    slots: NDArray[np.int32],
    slot_s: float,
) -> float:
    """How much longer lanes take in whole slots than at their speed, as a share."""
    return float(slots.sum() * slot_s / (length_m / speed_m_s).sum()) - 1.0


def _rounding(world: World) -> list[str]:
    graph, slot_s = world.hall.graph, world.hall.grid_slot_s
    assert graph is not None
    speed = np.array([min(e.speed_m_s or math.inf, graph.speed_m_s) for e in graph.edge])
    length = graph.length_m()
    lost = _lost(length, speed, traversal_slots(length, speed, slot_s), slot_s)
    if lost < 0.05:
        return []
    return [
        f"in slots of {slot_s:g} s lanes take {lost:.0%} longer than at their speed, since a lane "
        "takes whole slots; another hall.slot_s may fit better"
    ]


def _touching(world: World, floor: Floor) -> list[str]:
    """Places where robots touch although a plan keeps every rule, counted."""
    found = Lanes(floor.vertex_xy_m, floor.edge_uv, floor.edge_oneway, floor.edge_slots)
    body = world.hall.body
    nodes = {v for pair in near_vertices(found, body) for v in pair}
    nodes |= {follower.vertex for follower in touching_followers(found, body)}
    crossing = len(near_lanes(found, body))
    if not nodes and not crossing:
        return []
    return [
        f"robots of {body.length_m:g} m x {body.width_m:g} m can touch at {len(nodes)} nodes and "
        f"on {crossing} pairs of lanes, and a run would report it: twin check says where (W112 to "
        "W114); smaller robots (--body) or another --slot may help"
    ]


def _text(world: World, lif: Lif, source: Path, proposal: Proposal, longest: int) -> str:
    """The file: it names the LIF file instead of its nodes, edges and stations."""
    graph = world.hall.graph
    assert graph is not None
    named = Graph(
        lif=source.as_posix(),
        layout=graph.layout,
        vehicle=graph.vehicle,
        offset_m=graph.offset_m,
        speed_m_s=graph.speed_m_s,
    )
    hall = world.hall.model_copy(update={"graph": named})
    body = dump_world(world.model_copy(update={"hall": hall, "station": ()})).splitlines()
    ends, oneway, _ = lanes(graph, world.hall.grid_slot_s)
    head = [
        f"Imported from {source.name}: {len(lif.nodes)} nodes, {len(ends)} lanes, "
        f"{int(oneway.sum())} of them one-way, {len(lif.stations)} stations.",
        "",
        "Metres; (0, 0) is the lower left corner of the hall. Next:",
        "  twin check THIS_FILE -o check.png    what is wrong or unwise",
        "  twin radio THIS_FILE -o radio.png    who reaches where",
        "  twin run THIS_FILE                   plan it, execute it, log it",
        "What the layout does not say is filled in and marked with (default): put your own there.",
    ]
    remarks = {
        "[hall]": [f"(default) walls {MARGIN_M:g} m beyond the outermost nodes, no obstacles: add",
                   "[[obstacle]]s with name, center_m, size_m, height_m."],
        "[hall.graph]": ["Nodes, lanes and stations come from this file, whenever it is read."],
        "[hall.body]": ["(default) robots."],
        "[radio]": ["(default) but for what is here; docs/world-format.md has all keys."],
        "[[ap]]": [
            f"(default) Access points, PROPOSED: the layout has none. These cover "
            f"{proposal.covered_share:.1%} of the nodes.",
            "Put the real ones here.",
        ],
        "[robots.random]": [
            "(default) robots with random errands; or list them, between stations:",
            '[[robot]] with id = "r1", start = "a station", goal = "another".',
        ],
        "[plan]": [f"(default) the longest errand alone takes {longest} slots."],
    }  # fmt: skip
    return "\n".join(commented(head, body, remarks)) + "\n"
