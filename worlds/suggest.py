"""Where to hang further access points, or which to take down: mounts, rays, and a proof.

The rays of every mount are cast once, where they decide about coverage; what to use is then a
whole-number program over the table of who covers what (`worlds.placement`).

Places are the floor's V vertices and, where the ways between them count, too, the samples between
the ends of its edges behind them: n = V, or V + E (S − 2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worlds.errors import Fault, WorldError
from worlds.floor import Floor
from worlds.link import LinkModel
from worlds.placement import Ask, Placement, achieved, keep, place
from worlds.radio_map import RadioMap, build_radio_map
from worlds.scene import Scene
from worlds.world import AccessPoint, World

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

MAX_LINKS = 60_000_000
"""Mounts x positions; beyond, memory and patience run out."""


@dataclass(frozen=True)
class Suggestion:
    """A change of the access points, and what it achieves at n places.

    Attributes:
        ask: what was wanted.
        placement: the choice and its proof.
        added, removed: access points to hang, and ids of those to take down.
        mounts: (C, 3) where one could have hung [m]; those that hang, when removing.
        before, after: (n,) int64, access points that cover each place.
        weight: (n,) int64, what each place counts for.
        reached_before, reached_after: weight covered as asked; with `ask.failure`, what remains of
            it after the worst single loss.
        out_of_reach: (n,) bool, what even all mounts together would not cover as asked.
        remove: asked was which are not needed.
    """

    ask: Ask
    placement: Placement
    added: tuple[AccessPoint, ...]
    removed: tuple[str, ...]
    mounts: NDArray[np.float64]
    before: Ints
    after: Ints
    weight: Ints
    reached_before: int
    reached_after: int
    out_of_reach: Bools
    remove: bool = False

    def share(self, reached: int) -> float:
        """A weight as a share of all."""
        return reached / max(1, int(self.weight.sum()))

    def world(self, world: World) -> World:
        """The world with the change: new access points at the end, needless ones off."""
        kept = (
            ap.model_copy(update={"enabled": False}) if ap.id in self.removed else ap
            for ap in world.ap
        )
        return world.model_copy(update={"ap": (*kept, *self.added)})


def held_places(radio_map: RadioMap, *, ways: bool = False) -> Bools:
    """(n, A) whether the access points that hang cover each place."""
    if not ways:
        return radio_map.covered
    inner = radio_map.edge_snr_db[:, 1:-1] >= radio_map.threshold_db
    return np.concatenate((radio_map.covered, inner.reshape(-1, len(radio_map.ap_ids))))


def place_weights(floor: Floor, radio_map: RadioMap, vertex: Ints) -> Ints:
    """(V + E (S − 2),) what places count for if a vertex counts `vertex` (V,).

    A sample of an edge counts as the lesser of its ends.
    """
    edge = np.minimum(vertex[floor.edge_uv[:, 0]], vertex[floor.edge_uv[:, 1]])
    return np.concatenate((vertex, np.repeat(edge, radio_map.edge_snr_db.shape[1] - 2)))


def cast_mounts(
    world: World,
    floor: Floor,
    candidates: tuple[AccessPoint, ...],
    *,
    margin_db: float = 0.0,
    ways: bool = False,
    on_progress: Callable[[int, int], None] | None = None,
) -> Bools:
    """(n, C) whether an access point at each mount covers each place, as the radio map would say.

    Args:
        world: its radio and its robots' body.
        floor: what the world resolves to.
        candidates: access points at the mounts.
        margin_db: so much more than the threshold is wanted.
        ways: the samples of edges count, too.
        on_progress: told (mounts done, in all).

    Raises:
        WorldError: too many mounts for a floor of this size.
    """
    vertices = len(floor.vertex_xy_m)
    places = vertices + ways * len(floor.edge_uv) * (world.radio.samples_per_edge - 2)
    if places * len(candidates) > MAX_LINKS:
        rule = f"{len(candidates)} mounts for {places} places are too many"
        raise WorldError([Fault((), f"{rule}; space them wider")])
    limit = world.radio.threshold_db + margin_db
    # What was measured tells nothing of access points that do not hang yet.
    radio = world.radio.model_copy(update={"threshold_db": limit, "measured": None})
    covers = np.empty((places, len(candidates)), dtype=np.bool_)
    with Scene.of(world, floor) as scene:
        for c, candidate in enumerate(candidates):
            alone = world.model_copy(update={"ap": (candidate,), "radio": radio})
            if ways:
                found = build_radio_map(alone, floor, scene=scene, exact=False)
                covers[:, c] = held_places(found, ways=True)[:, 0]
                if on_progress:
                    on_progress(c + 1, len(candidates))
                continue
            links = LinkModel(alone)
            antenna = links.antenna_m(floor.vertex_xy_m)
            free, blocked = links.fading_by_sight_db(floor, 0)
            snr = links.predict(
                scene,
                0,
                antenna,
                free_fading_db=free,
                blocked_fading_db=blocked,
                threshold_db=limit,
            )
            covers[:, c] = snr >= limit
            if on_progress:
                on_progress(c + 1, len(candidates))
    return covers


def suggest(
    candidates: tuple[AccessPoint, ...],
    covers: Bools,
    held: Bools,
    ask: Ask,
    weight: Ints | None = None,
) -> Suggestion:
    """Which of the candidates to hang.

    Args:
        candidates: C access points that could hang.
        covers: (n, C) of `cast_mounts`.
        held: (n, F) of `held_places`, for those that hang already.
        ask: what is wanted.
        weight: (n,) what each place counts for, whole; 1 each when left out.

    Returns:
        With `placement.possible` False where all candidates together fall short of the share; then
        nothing is added.
    """
    weight = np.ones(len(covers), np.int64) if weight is None else weight
    placement = place(covers, held, weight, ask)
    chosen = placement.chosen if placement.possible else ()
    before = held.sum(axis=1).astype(np.int64)
    need = ask.k + int(ask.failure)
    return Suggestion(
        ask=ask,
        placement=placement,
        added=tuple(candidates[c] for c in chosen),
        removed=(),
        mounts=np.array([ap.position_m for ap in candidates]).reshape(-1, 3),
        before=before,
        after=before + covers[:, list(chosen)].sum(axis=1),
        weight=weight,
        reached_before=achieved(covers, held, weight, (), ask),
        reached_after=achieved(covers, held, weight, chosen, ask),
        out_of_reach=(weight > 0) & (before + covers.sum(axis=1) < need),
    )


def needless(
    world: World,
    radio_map: RadioMap,
    *,
    k: int = 1,
    robots: int = 0,
    seconds: float = 60.0,
    weight: Ints | None = None,
    ways: bool = False,
) -> Suggestion:
    """The most access points that can be taken down together.

    Every place that k access points cover keeps k; one that fewer cover keeps those. What is left
    serves `robots` at once.

    Args:
        world: with the map's access points.
        radio_map: of the world.
        k: access points wanted at a place.
        robots: the fleet.
        seconds: limit for the solver.
        weight: (n,) places of weight 0 may lose coverage; all count when left out.
        ways: the samples of edges count, too.
    """
    covered = held_places(radio_map, ways=ways)
    count = covered.sum(axis=1).astype(np.int64)
    weight = np.ones(len(covered), np.int64) if weight is None else weight
    own = {ap.id: ap for ap in world.ap}
    candidates = tuple(own[name] for name in radio_map.ap_ids)
    default = world.radio.ap_capacity
    capacity = np.array(
        [default if ap.capacity is None else ap.capacity for ap in candidates], dtype=np.int64
    )
    need = np.where(weight > 0, np.minimum(count, k), 0)
    placement = keep(covered, need, capacity, robots, seconds)
    kept = set(placement.chosen)
    removed = tuple(name for a, name in enumerate(radio_map.ap_ids) if a not in kept)
    after = covered[:, sorted(kept)].sum(axis=1).astype(np.int64)
    ask = Ask(k=k, seconds=seconds)
    return Suggestion(
        ask=ask,
        placement=placement,
        added=(),
        removed=removed,
        mounts=np.array([ap.position_m for ap in candidates]).reshape(-1, 3),
        before=count,
        after=after,
        weight=weight,
        reached_before=int(weight[count >= k].sum()),
        reached_after=int(weight[after >= k].sum()),
        out_of_reach=np.zeros(len(covered), dtype=np.bool_),
        remove=True,
    )
