"""Why a place has the SNR it has: every access point's link to one point, term by term."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from worlds import channel
from worlds.blockage import near_pairs, pair_loss_db
from worlds.boxes import contains
from worlds.channel import MIN_DISTANCE_M, Line
from worlds.errors import Fault, WorldError
from worlds.floor import Boxes, Floor
from worlds.link import LinkModel
from worlds.radio_map import RadioMap
from worlds.scene import Scene
from worlds.world import World


@dataclass(frozen=True)
class LinkBudget:
    """One access point's link to a point: SNR = all gains − all losses − noise [dB, dBm].

    Attributes:
        ap: its id.
        model: of the channel, as in a world.
        distance_m: between the antennas, in space.
        line_of_sight: whether the ray is free.
        blocker: the obstacle the ray meets first, "" with line of sight.
        line: which of the model's lines holds: "LOS" or "NLOS".
        offset_db, distance_db, frequency_db: its terms; their sum is the path loss.
        oxygen_db, low_antenna_db, blockage_db: further losses, 0 where the world has none.
        knife_edges: what each box costs that does, the costliest first.
        tx_power_dbm, ap_gain_db, pattern_db, robot_gain_db, noise_dbm, fading_db: the other terms.
        snr_db: the sum.
        covered: whether it reaches the threshold.
    """

    ap: str
    model: str
    distance_m: float
    line_of_sight: bool
    blocker: str
    line: str
    offset_db: float
    distance_db: float
    frequency_db: float
    oxygen_db: float
    low_antenna_db: float
    blockage_db: float
    knife_edges: tuple[tuple[str, float], ...]
    tx_power_dbm: float
    ap_gain_db: float
    pattern_db: float
    robot_gain_db: float
    noise_dbm: float
    fading_db: float
    snr_db: float
    covered: bool

    @property
    def path_loss_db(self) -> float:
        """Of the model's line [dB]."""
        return self.offset_db + self.distance_db + self.frequency_db


@dataclass(frozen=True)
class PointReport:
    """All links to one point.

    Attributes:
        x_m, y_m, z_m: the robot's antenna [m].
        vertex: the nearest vertex; shadow fading is taken from there.
        vertex_away_m: how far it is [m].
        threshold_db: SNR from which the point counts as covered [dB].
        links: one per access point that is on, the best first.
    """

    x_m: float
    y_m: float
    z_m: float
    vertex: int
    vertex_away_m: float
    threshold_db: float
    links: tuple[LinkBudget, ...]

    @property
    def covered(self) -> bool:
        """Whether some access point reaches the threshold."""
        return any(link.covered for link in self.links)


def explain_point(
    world: World, floor: Floor, xy_m: ArrayLike, radio_map: RadioMap | None = None
) -> PointReport:
    """The links of every access point to a robot whose centre stands at a point.

    Args:
        world: its radio and access points.
        floor: what it resolves to.
        xy_m: (2,) the point [m].
        radio_map: the world's; it tells shadow fading and what a survey adds. Not needed without.

    Raises:
        WorldError: the point is outside the hall, or the antenna would be inside an obstacle.
    """
    x, y = (float(value) for value in np.asarray(xy_m, dtype=np.float64))
    width, depth = world.hall.size_m
    if not (0 <= x <= width and 0 <= y <= depth):
        message = f"({x:g}, {y:g}) is outside the hall of {width:g} m x {depth:g} m"
        raise WorldError([Fault((), f"{message}; give a point inside")])
    links = LinkModel(world)
    antenna = links.antenna_m([[x, y]])
    inside = int(contains(floor.boxes, antenna)[0])
    if inside >= 0:
        name, z = floor.boxes.name[inside], float(antenna[0, 2])
        message = f"the antenna of a robot at ({x:g}, {y:g}), {z:g} m high, is inside '{name}'"
        raise WorldError([Fault((), f"{message}; give a point beside it")])
    away = np.linalg.norm(floor.vertex_xy_m - (x, y), axis=1)
    vertex = int(away.argmin()) if len(away) else -1
    n = len(links.ap_ids)
    fading = np.zeros(n)
    if radio_map is not None and vertex >= 0:
        fading = radio_map.fading_db[vertex]
    antennas = np.repeat(antenna, n, axis=0)
    with Scene.of(world, floor) as scene:
        sight = links.look(scene, np.arange(n), antennas)
        _, boxes = scene.visible_boxes()
    budget = links.budget(np.arange(n), antennas, sight.free, fading, sight.blockage_db)
    free = links.as_if_free(sight.free)
    snr = budget.snr_db
    frequency = world.radio.frequency_ghz
    found = []
    for ap in range(n):
        line = _line(links.model[ap], bool(free[ap]), float(budget.distance_m[ap]), frequency)
        box = int(sight.blocker[ap])
        metres = max(float(budget.distance_m[ap]), MIN_DISTANCE_M)
        edges: tuple[tuple[str, float], ...] = ()
        if links.knife_edge:
            edges = _knife_edges(boxes, floor, links.position_m[ap], antenna[0], frequency)
        found.append(
            LinkBudget(
                ap=links.ap_ids[ap],
                model=links.model[ap],
                distance_m=float(budget.distance_m[ap]),
                line_of_sight=box < 0,
                blocker=floor.boxes.name[box] if box >= 0 else "",
                line="LOS" if free[ap] else "NLOS",
                offset_db=line.offset_db,
                distance_db=float(line.per_lg_d * np.log10(metres)),
                frequency_db=float(line.per_lg_f * np.log10(frequency)),
                oxygen_db=float(budget.oxygen_db[ap]),
                low_antenna_db=float(budget.low_antenna_db[ap]),
                blockage_db=float(budget.blockage_db[ap]),
                knife_edges=edges,
                tx_power_dbm=float(budget.tx_power_dbm[ap]),
                ap_gain_db=float(budget.ap_gain_db[ap]),
                pattern_db=float(budget.pattern_db[ap]),
                robot_gain_db=budget.robot_gain_db,
                noise_dbm=budget.noise_dbm,
                fading_db=float(budget.fading_db[ap]),
                snr_db=float(snr[ap]),
                covered=bool(snr[ap] >= world.radio.threshold_db),
            )
        )
    found.sort(key=lambda link: -link.snr_db)  # stable: equals keep the world's order
    return PointReport(
        x_m=x,
        y_m=y,
        z_m=float(antenna[0, 2]),
        vertex=vertex,
        vertex_away_m=float(away[vertex]) if vertex >= 0 else 0.0,
        threshold_db=world.radio.threshold_db,
        links=tuple(found),
    )


def _line(model: str, free: bool, distance_m: float, frequency_ghz: float) -> Line:
    """The line of the model that holds: with sight its own, without the one that loses most."""
    table = channel.channel_model(model)
    lines = (table.los,) if free else (table.los, *table.nlos)
    metres = np.array([max(distance_m, MIN_DISTANCE_M)])
    return max(lines, key=lambda line: float(line.loss_db(metres, frequency_ghz)[0]))


def _knife_edges(
    boxes: Boxes, floor: Floor, at_m: ArrayLike, antenna_m: ArrayLike, frequency_ghz: float
) -> tuple[tuple[str, float], ...]:
    """The boxes that cost a path more than 0.05 dB, and how much [dB]."""
    start, end = (np.asarray(p, dtype=np.float64).reshape(1, 3) for p in (at_m, antenna_m))
    _, near = near_pairs(boxes, start, end, frequency_ghz)
    chosen = Boxes(("",) * len(near), boxes.center_m[near], boxes.half_m[near], boxes.yaw_rad[near])
    lost = pair_loss_db(
        chosen,
        np.repeat(start, len(near), axis=0),
        np.repeat(end, len(near), axis=0),
        frequency_ghz,
    )
    order = np.argsort(-lost, kind="stable")
    names = floor.boxes.name
    return tuple((names[near[k]], float(lost[k])) for k in order.tolist() if lost[k] > 0.05)
