"""Where access points might hang in a hall that has none yet: a proposal to begin with.

Candidates hang over free floor, evenly spread. As long as the wanted share of the floor is not
covered, the candidate that covers most of what is left is taken (the greedy algorithm for maximum
coverage, within 1 − 1/e of the best of as many: G. Nemhauser, L. Wolsey and M. Fisher, 1978,
doi:10.1007/BF01588971). Then those that turn out not to be needed are dropped, and more are added,
where they give the floor a second AP, until the fleet fits their capacity. No claim of optimality.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worlds.errors import Fault, WorldError
from worlds.floor import Floor
from worlds.link import LinkModel
from worlds.scene import Scene
from worlds.world import AccessPoint, World

MAX_CANDIDATES = 300
_LINKS = 700_000  # candidates x vertices: bounds the rays to some seconds
_SPARE = 1.5  # capacity per robot, since robots come in clusters

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.intp]


@dataclass(frozen=True)
class Proposal:
    """Access points, and what they achieve.

    Attributes:
        aps: called ap0, ap1, … from the lower left.
        covered_share: of the asked vertices [0 … 1].
        candidates: how many mounts were compared.
    """

    aps: tuple[AccessPoint, ...]
    covered_share: float
    candidates: int


def propose_aps(
    world: World,
    floor: Floor,
    *,
    height_m: float,
    robots: int,
    target: float = 0.99,
    wanted: NDArray[np.bool_] | None = None,
) -> Proposal:
    """Mounts for access points of the world's `[radio]`.

    Args:
        world: its radio and its robots' body; its APs do not matter.
        floor: what the world resolves to.
        height_m: how high they hang [m].
        robots: how many are to be served at once.
        target: share of the wanted vertices to cover, 0 … 1.
        wanted: (V,) the vertices that count; all when left out.

    Raises:
        WorldError: no mount covers any wanted vertex, or no capacity serves any robot.
    """
    wanted = np.ones(len(floor.vertex_xy_m), dtype=np.bool_) if wanted is None else wanted
    vertices = np.flatnonzero(wanted)
    xy = floor.vertex_xy_m[vertices]
    mounts = _mounts(floor, vertices, max(40, min(MAX_CANDIDATES, _LINKS // max(1, len(xy)))))
    aps = [
        AccessPoint(id=f"c{k}", position_m=(x, y, height_m))
        for k, (x, y) in enumerate(mounts.tolist())
    ]
    snr = _snr_db(world.model_copy(update={"ap": tuple(aps)}), floor, xy)
    covers = snr >= world.radio.threshold_db
    if not covers.any():
        best = f"{float(snr.max()):.1f} dB" if snr.size else "nothing"
        message = (
            f"an access point {height_m:g} m high reaches {best} at best, the threshold is "
            f"{world.radio.threshold_db:g} dB; hang it lower or choose another channel model"
        )
        raise WorldError([Fault(("radio", "threshold_db"), message)])
    least = math.ceil(_SPARE * robots / max(1, world.radio.ap_capacity))
    chosen = _cover(covers, snr, target)
    chosen = _needed(covers, chosen, target)
    chosen = _fill_up(covers, snr, chosen, min(least, len(aps)))
    order = sorted(chosen, key=lambda k: (aps[k].position_m[1], aps[k].position_m[0]))
    found = tuple(aps[k].model_copy(update={"id": f"ap{number}"}) for number, k in enumerate(order))
    return Proposal(found, float(covers[:, chosen].any(axis=1).mean()), len(aps))


def _mounts(floor: Floor, vertices: Ints, most: int) -> Array:
    """(K, 2) places over free floor: of each square block of cells the one nearest its middle."""
    cell = floor.vertex_cell[vertices]
    stride = 1
    while True:
        block = cell // stride
        _, first = np.unique(block, axis=0, return_index=True)
        if len(first) <= most:
            break
        stride += 1
    middle = block * stride + (stride - 1) / 2
    off_m = np.abs(cell - middle).sum(axis=1)
    order = np.lexsort((off_m, block[:, 0], block[:, 1]))
    blocks = block[order]
    new = np.ones(len(order), dtype=np.bool_)
    new[1:] = (blocks[1:] != blocks[:-1]).any(axis=1)
    return floor.vertex_xy_m[vertices[order[new]]]


def _snr_db(world: World, floor: Floor, xy_m: Array) -> Array:
    """(n, K) SNR of every AP of the world; rays are cast where they decide about coverage."""
    links = LinkModel(world)
    antenna = links.antenna_m(xy_m)
    snr = np.empty((len(antenna), len(links.ap_ids)))
    with Scene.of(world, floor) as scene:
        for ap in range(len(links.ap_ids)):
            limit = world.radio.threshold_db
            snr[:, ap] = links.predict(scene, ap, antenna, threshold_db=limit)
    return snr


def _cover(covers: Bools, snr_db: Array, target: float) -> list[int]:
    """Candidates until the target is reached, or no further one helps."""
    chosen: list[int] = []
    left = np.ones(len(covers), dtype=np.bool_)
    quality = snr_db.mean(axis=0)  # between equals the one that hangs more centrally
    while left.mean() > 1 - target + 1e-12:
        gain = covers[left].sum(axis=0)
        best = int(np.lexsort((-quality, -gain))[0])
        if gain[best] == 0:
            break
        chosen.append(best)
        left &= ~covers[:, best]
    return chosen


def _needed(covers: Bools, chosen: list[int], target: float) -> list[int]:
    """Without those whose loss leaves as much covered as was asked for (or as there was)."""
    kept = list(chosen)
    enough = min(target, float(covers[:, kept].any(axis=1).mean()))
    for ap in sorted(chosen, key=lambda k: int(covers[:, k].sum())):
        rest = [k for k in kept if k != ap]
        if rest and covers[:, rest].any(axis=1).mean() >= enough - 1e-12:
            kept = rest
    return kept


def _fill_up(covers: Bools, snr_db: Array, chosen: list[int], least: int) -> list[int]:
    """With more candidates, each giving most vertices a second AP, until there are enough."""
    kept = list(chosen)
    while len(kept) < least:
        alone = covers[:, kept].sum(axis=1) < 2
        gain = covers[alone].sum(axis=0) if alone.any() else np.zeros(covers.shape[1])
        # What counts after coverage is SNR where the chosen ones are weak: they spread out.
        best_now = snr_db[:, kept].max(axis=1)
        better = np.maximum(snr_db - best_now[:, None], 0.0).mean(axis=0)
        order = np.lexsort((-better, -gain))
        kept.append(next(int(k) for k in order if int(k) not in kept))
    return kept
