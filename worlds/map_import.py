"""From a grid of blocked cells, whatever map it comes from, to a world a person can go on editing.

A map says where robots cannot drive. All else is filled in with defaults that are said to be such
in the file: how high obstacles are, how large robots are, where access points might hang, who
drives where.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from worlds.ap_proposal import Proposal, propose_aps
from worlds.errands import components, with_covered_robots
from worlds.errors import Fault, WorldError
from worlds.floor import Floor
from worlds.generate import resolve
from worlds.merge_boxes import merge_boxes
from worlds.radio_map import build_radio_map, kept_edges, kept_vertices
from worlds.toml_file import dump_world, parse_world
from worlds.world import (
    AccessPoint,
    Body,
    ChannelModel,
    Hall,
    Obstacle,
    Place,
    PlanOptions,
    Radio,
    RandomRobots,
    Robot,
    Robots,
    World,
)

DEFAULT_BODY_M = (Body().length_m, Body().width_m)
DEFAULT_PITCH_M = 1.0
FINER_PITCHES_M = (0.8, 0.6, 0.5, 0.4, 0.3, 0.25, 0.2, 0.15, 0.1)
COARSER_PITCHES_M = (1.5, 2.0, 3.0, 5.0, 10.0)

MAX_HEIGHT_M = 100.0

POSITIONS_PER_ROBOT = 8
KEPT_SHARE = 0.7
MAX_CELLS = 30_000
"""What a pitch must leave to be chosen without being asked for: room for the fleet, most of the
free floor in one piece; and no more cells than a plan can be made on in minutes."""


@dataclass(frozen=True)
class ImportParams:
    """What a map does not say.

    Attributes:
        pitch_m: distance of positions; from the map when None.
        body_m: (length, width) of the robots; the default body, smaller where the pitch asks for
            it, when None.
        obstacle_height_m, ap_height_m: heights [m].
        model: channel model; the format's default when None.
        coverage: share of the floor the proposed APs are to cover.
        robots: how many are drawn.
        seed: of their errands.
        horizon: slots to plan for; from the longest errand when None.
        name: of the world.
    """

    pitch_m: float | None = None
    body_m: tuple[float, float] | None = None
    obstacle_height_m: float = 2.0
    ap_height_m: float = 5.0
    model: ChannelModel | None = None
    coverage: float = 0.99
    robots: int = 20
    seed: int = 1
    horizon: int | None = None
    name: str = "imported map"

    def __post_init__(self) -> None:
        wrong = []
        if self.pitch_m is not None and not 0.01 <= self.pitch_m <= 100:
            wrong.append(f"pitch {self.pitch_m:g} m is outside 0.01 to 100 m")
        if self.body_m is not None and not all(0 < side <= 20 for side in self.body_m):
            wrong.append(f"a body of {self.body_m} m is none; give length and width in metres")
        for what in ("obstacle_height_m", "ap_height_m"):
            if not 0 < getattr(self, what) <= MAX_HEIGHT_M:
                high = f"{what.removesuffix('_m').replace('_', ' ')} {getattr(self, what):g} m"
                wrong.append(f"{high} is outside 0 to {MAX_HEIGHT_M:g} m")
        if not 0 < self.coverage <= 1:
            wrong.append(f"coverage {self.coverage:g} is no share; give 0.99 for 99 %")
        if not 1 <= self.robots <= 100_000:
            wrong.append(f"{self.robots} robots: give 1 to 100000")
        if wrong:
            raise WorldError([Fault((), text) for text in wrong])

    def chosen_body_m(self, pitch_m: float) -> tuple[float, float]:
        """The body given, or the default one made to fit the pitch.

        length + width ≤ pitch, so that two robots following each other around a corner never
        touch; page 5 of the design only asks for width ≤ pitch / √2.
        """
        if self.body_m is not None:
            return self.body_m
        scale = min(1.0, pitch_m / sum(DEFAULT_BODY_M))
        length, width = (math.floor(side * scale * 100 + 1e-6) / 100 for side in DEFAULT_BODY_M)
        return max(length, 0.01), max(width, 0.01)


@dataclass(frozen=True, eq=False)
class BlockedGrid:
    """Where nobody may drive.

    Attributes:
        blocked: (rows, columns) bool, row 0 at the bottom.
        pitch_m: side of a cell.
        story: what the world's story begins with.
        notes: lines for the head of the file: where it comes from.
        errands: pairs of cells (column, row) that the map comes with, one per robot.
    """

    blocked: NDArray[np.bool_]
    pitch_m: float
    story: str
    notes: tuple[str, ...] = ()
    errands: tuple[tuple[tuple[int, int], tuple[int, int]], ...] = ()


@dataclass(frozen=True, eq=False)
class ImportedWorld:
    """The result.

    Attributes:
        world: as parsed from `text`.
        text: of the file.
        floor: its floor, robots in place.
        proposal: of the access points.
        longest_errand: in slots, on an otherwise empty floor.
        hints: what the user should know.
    """

    world: World
    text: str
    floor: Floor
    proposal: Proposal
    longest_errand: int
    hints: tuple[str, ...] = field(default=())


def pitch_for(body_m: tuple[float, float] | None) -> float:
    """The pitch to begin with: robots of this body never touch at corners."""
    if body_m is None:
        return DEFAULT_PITCH_M
    return math.ceil(sum(body_m) * 20 - 1e-6) / 20


def largest_share(blocked: NDArray[np.bool_]) -> tuple[int, int]:
    """Cells of the largest connected free area, and free cells in all."""
    from scipy.ndimage import label

    labels, _ = label(~blocked)
    sizes = np.bincount(labels.ravel())[1:]
    return (int(sizes.max()) if len(sizes) else 0), int(sizes.sum())


def crop(blocked: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], tuple[int, int]]:
    """The part around the free cells, and its first (column, row).

    What lies beyond is neither driven on nor crossed by a ray between places within.
    """
    row, column = np.nonzero(~blocked)
    if not len(row):
        return blocked, (0, 0)
    rows = slice(int(row.min()), int(row.max()) + 1)
    columns = slice(int(column.min()), int(column.max()) + 1)
    return blocked[rows, columns], (columns.start, rows.start)


def import_grid(grid: BlockedGrid, params: ImportParams) -> ImportedWorld:
    """A complete world: obstacles merged, access points proposed, robots drawn.

    Raises:
        WorldError: no floor to drive on, robots too large for the pitch, too little room.
    """
    hints: list[str] = []
    bare = _bare_world(grid, params)
    length, width = bare.hall.body.length_m, bare.hall.body.width_m
    if length + width > grid.pitch_m + 1e-9:
        hints.append(
            f"robots of {length:g} m x {width:g} m can touch at corners: length + width is more "
            f"than the pitch, {grid.pitch_m:g} m (twin check: W106)"
        )
    # The random errands of this first look only tell whether there is room.
    first = resolve(bare)
    main = components(first, _all(first.vertex_xy_m), _all(first.edge_uv)) == 0
    proposal = propose_aps(
        bare,
        first,
        height_m=params.ap_height_m,
        robots=params.robots,
        target=params.coverage,
        wanted=main,
    )
    if proposal.covered_share < params.coverage - 1e-9:
        hints.append(
            f"the proposed access points cover {proposal.covered_share:.1%} of the floor, not the "
            f"{params.coverage:.1%} asked for: no further mount reaches more"
        )
    world, floor, longest, told = with_aps_and_horizon(bare, first, proposal, params.horizon)
    hints += told
    text = _text(world, grid, params, proposal, longest)
    parsed = parse_world(text)
    if parsed != world:
        raise AssertionError("the text does not say what the world says")  # a defect here
    return ImportedWorld(parsed, text, floor, proposal, longest, tuple(hints))


def _bare_world(grid: BlockedGrid, params: ImportParams) -> World:
    """The world without its access points (one stands for them) and with the default horizon."""
    pitch = grid.pitch_m
    rows, columns = grid.blocked.shape
    free, _ = largest_share(grid.blocked)
    if free < 2:
        message = (
            f"of {columns} x {rows} cells of {pitch:g} m none is free next to another; give a "
            "smaller --pitch, or check what the map counts as free"
        )
        raise WorldError([Fault((), message)])
    length, width = params.chosen_body_m(pitch)
    obstacles = [
        Obstacle(
            name=f"block {number}",
            center_m=(_tidy((x + w / 2) * pitch), _tidy((y + h / 2) * pitch)),
            size_m=(_tidy(w * pitch), _tidy(h * pitch)),
            height_m=params.obstacle_height_m,
        )
        for number, (x, y, w, h) in enumerate(merge_boxes(grid.blocked))
    ]
    listed = tuple(
        Robot(id=f"r{i:02d}", start=Place(cell=start), goal=Place(cell=goal))
        for i, (start, goal) in enumerate(grid.errands)
    )
    robots = RandomRobots(count=params.robots, seed=params.seed)
    return World(
        name=params.name,
        story=grid.story,
        hall=Hall(
            size_m=(_tidy(columns * pitch), _tidy(rows * pitch)),
            pitch_m=pitch,
            body=Body(length_m=length, width_m=width),
        ),
        obstacle=tuple(obstacles),
        ap=(AccessPoint(id="none yet", position_m=(0.0, 0.0, 2 * MAX_HEIGHT_M)),),
        radio=Radio() if params.model is None else Radio(model=params.model),
        robot=listed,
        robots=None if listed else Robots(random=robots),
    )


def _tidy(metres: float) -> float:
    """Without the noise of floating point, which nobody wants to read; a tenth of a micron."""
    return round(metres, 7)


def _all(array: NDArray[np.generic]) -> NDArray[np.bool_]:
    return np.ones(len(array), dtype=np.bool_)


def with_aps_and_horizon(
    bare: World, first: Floor, proposal: Proposal, horizon: int | None
) -> tuple[World, Floor, int, list[str]]:
    """A world with the access points proposed for it, and with time for its longest errand.

    Args:
        bare: the world without them.
        first: its floor.
        proposal: of access points.
        horizon: T, or None for one that suits the errands.

    Returns:
        The world, its floor with robots where there is coverage, the slots of the longest errand,
        and hints for the user.
    """
    world = bare.model_copy(update={"ap": proposal.aps})
    radio_map = build_radio_map(world, first, exact=False)
    floor = with_covered_robots(world, first, radio_map)
    longest = longest_errand_slots(floor, kept_vertices(radio_map), kept_edges(floor, radio_map))
    slots = horizon or default_horizon(longest)
    hints = []
    if longest > slots:
        hints.append(
            f"the longest errand takes {longest} slots, the horizon is {slots}: no plan exists"
        )
    return world.model_copy(update={"plan": PlanOptions(horizon=slots)}), floor, longest, hints


def longest_errand_slots(
    floor: Floor, vertices: NDArray[np.int32], edges: NDArray[np.int32]
) -> int:
    """Slots of the longest of the shortest paths, each robot alone, coverage respected."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    usable = np.zeros(len(floor.vertex_xy_m), dtype=np.bool_)
    usable[vertices] = True
    kept = edges[usable[floor.edge_uv[edges]].all(axis=1)]
    u, v = floor.edge_uv[kept].T
    slots, back = floor.edge_slots[kept].astype(np.float64), ~floor.edge_oneway[kept]
    n = len(usable)
    ends = (np.concatenate((u, v[back])), np.concatenate((v, u[back])))
    graph = csr_array((np.concatenate((slots, slots[back])), ends), shape=(n, n))
    longest = 0.0
    for start, goal in zip(floor.start.tolist(), floor.goal.tolist(), strict=True):
        distance = dijkstra(graph, indices=start)[goal]
        longest = max(longest, float(distance) if math.isfinite(distance) else 0.0)
    return int(longest)


def _text(
    world: World, grid: BlockedGrid, params: ImportParams, proposal: Proposal, longest: int
) -> str:
    """The file: what people edit first comes first, the obstacles of the map last."""
    head = [
        *grid.notes,
        "",
        "Metres; (0, 0) is the lower left corner of the hall. Next:",
        "  twin check THIS_FILE -o check.png    what is wrong or unwise",
        "  twin radio THIS_FILE -o radio.png    who reaches where",
        "  twin run THIS_FILE                   plan it, execute it, log it",
        "What the map does not say is filled in and marked with (default): put your own there.",
    ]
    body = dump_world(world.model_copy(update={"obstacle": ()})).splitlines()
    remarks = {
        "[hall]": [f"The cells of the map: {'x'.join(map(str, world.hall.grid_positions))}."],
        "[hall.body]": ["(default) robots; length + width <= pitch_m keeps corners safe."],
        "[radio]": ["(default) but for what is here; docs/world-format.md has all keys."],
        "[[ap]]": [
            f"(default) Access points, PROPOSED: the map has none. Of {proposal.candidates} mounts",
            f"{params.ap_height_m:g} m over free floor these cover {proposal.covered_share:.1%} of "
            f"it ({world.radio.model}, {world.radio.frequency_ghz:g} GHz) and serve "
            f"{sum(_capacity(world, ap) for ap in world.ap)} robots.",
            "Put the real ones here.",
        ],
        "[robots.random]": ["(default) robots with random errands; or list them ([[robot]])."],
        "[[robot]]": ["Errands of the scenario."],
        "[plan]": [f"(default) the longest errand alone takes {longest} slots."],
    }
    obstacles = [
        "",
        f"# {len(world.obstacle)} boxes, disjoint, exactly the blocked cells of the map. Their",
        "# height is a (default).",
    ]
    # `dump_world` writes what differs from the defaults; a height is worth seeing all the same.
    for o in world.obstacle:
        obstacles += [
            "",
            "[[obstacle]]",
            f'name = "{o.name}"',
            f"center_m = [{o.center_m[0]!r}, {o.center_m[1]!r}]",
            f"size_m = [{o.size_m[0]!r}, {o.size_m[1]!r}]",
            f"height_m = {o.height_m!r}",
        ]
    lines = commented(head, body, remarks)
    return "\n".join([*lines, *(obstacles if world.obstacle else [])]) + "\n"


def commented(head: list[str], body: list[str], remarks: dict[str, list[str]]) -> list[str]:
    """Lines of TOML under a head of comments, with comments before the lines of `remarks`.

    A line that occurs several times has its comment once, at the first.
    """
    lines = [f"# {text}".rstrip() for text in head] + [""]
    left = dict(remarks)
    for line in body:
        lines += [f"# {text}" for text in left.pop(line, [])]
        lines.append(line)
    return lines


def default_horizon(longest: int) -> int:
    """Slots to plan for when the longest errand alone takes this many."""
    return max(20, 5 * math.ceil((1.2 * longest + 10) / 5))


def _capacity(world: World, ap: AccessPoint) -> int:
    return world.radio.ap_capacity if ap.capacity is None else ap.capacity
