"""How fast the radio map is: our rays, the rays its bounds save, and a plain loop, in one run.

The hall of the comparison is 100 m x 60 m at 1 m pitch, with 16 access points, 2 000 boxes and 5
samples per edge. The plain loop is what one would write first: a box shape per obstacle and one
`rayTest` call per link. It casts the very same rays, all of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from worlds.floor import Floor
from worlds.generate import resolve
from worlds.link import LinkModel, edge_xy_m
from worlds.radio_map import RadioMap, build_radio_map
from worlds.scene import Scene, ray_growth_m
from worlds.world import World

Figures = dict[str, float | int | str | None]
Build = Callable[[], tuple[World, Floor]]


@dataclass(frozen=True)
class RadioCase:
    """A hall whose rays are cast.

    Attributes:
        size: what it is grouped by.
        seed: of its boxes.
        build: makes the hall (not timed).
    """

    size: str
    seed: int
    build: Build


def hall(columns: int, rows: int, across: int, up: int, boxes: int, seed: int, model: str) -> Build:
    """A hall at 1 m pitch with across x up access points 6 m high and boxes 0.8 m wide."""

    def build() -> tuple[World, Floor]:
        x, y = ((np.arange(n) + 0.5) * size / n for n, size in ((across, columns), (up, rows)))
        aps = [
            {"id": f"ap{i * up + j}", "position_m": [float(x[i]), float(y[j]), 6.0]}
            for i in range(across)
            for j in range(up)
        ]
        share = boxes / (columns * rows)
        world = World.model_validate(
            {
                "name": "benchmark hall",
                "hall": {"size_m": [float(columns), float(rows)], "pitch_m": 1.0},
                "obstacles": {"random": {"share": share, "side_m": 0.8, "seed": seed}},
                "ap": aps,
                "radio": {"samples_per_edge": 5, "model": model},
                "robots": {"random": {"count": 1}},
            }
        )
        return world, resolve(world)

    return build


def cases(smoke: bool, seeds: int) -> Iterator[RadioCase]:
    """The hall of the comparison, in an office and in a factory with dense clutter."""
    for seed in range(1, seeds + 1):
        if smoke:
            yield RadioCase("12x8 2 APs", seed, hall(12, 8, 2, 1, 20, seed, "inh-office"))
            continue
        for model in ("inh-office", "inf-dl"):
            name = f"100x60 16 APs 2000 boxes {model}"
            yield RadioCase(name, seed, hall(100, 60, 4, 4, 2000, seed, model))


def radio_map(world: World, floor: Floor) -> tuple[Figures, RadioMap]:
    """Every ray that changes an SNR."""
    return _map(world, floor, exact=True)


def radio_map_coverage(world: World, floor: Floor) -> tuple[Figures, RadioMap]:
    """Only rays that change coverage: where neither sight nor its lack decides alone."""
    return _map(world, floor, exact=False)


def _map(world: World, floor: Floor, *, exact: bool) -> tuple[Figures, RadioMap]:
    with Scene.of(world, floor) as scene:
        found = build_radio_map(world, floor, scene=scene, exact=exact)
        links = len(found.ap_ids) * (
            len(floor.vertex_xy_m) + len(floor.edge_uv) * (world.radio.samples_per_edge - 2)
        )
        figures: Figures = {
            "links": links,
            "rays": scene.rays_cast,
            "rays_saved_share": 1.0 - scene.rays_cast / links,
            "ray_seconds": scene.seconds,
        }
    return figures, found


def plain_loop(world: World, floor: Floor) -> tuple[Figures, RadioMap | None]:
    """One `rayTest` per link in a world of box shapes, the same rays and sizes; then the SNR."""
    import pybullet

    client = pybullet.connect(pybullet.DIRECT)
    grow = ray_growth_m(world)
    boxes = floor.boxes
    for center, half, yaw in zip(
        boxes.center_m.tolist(), (boxes.half_m + grow).tolist(), boxes.yaw_rad, strict=True
    ):
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=half, physicsClientId=client
        )
        turn = pybullet.getQuaternionFromEuler([0.0, 0.0, float(yaw)])
        pybullet.createMultiBody(0, shape, -1, center, turn, physicsClientId=client)
    links = LinkModel(world)
    samples = world.radio.samples_per_edge
    edge = np.repeat(np.arange(len(floor.edge_uv)), samples - 2)
    share = np.tile(np.linspace(0.0, 1.0, samples)[1:-1], len(floor.edge_uv))
    places = links.antenna_m(np.concatenate((floor.vertex_xy_m, edge_xy_m(floor, edge, share))))
    targets = places.tolist()
    los = np.empty((len(targets), len(links.ap_ids)), dtype=np.bool_)
    began = time.perf_counter()
    for ap, position in enumerate(links.position_m.tolist()):
        for place, target in enumerate(targets):
            hit = pybullet.rayTest(position, target, physicsClientId=client)
            los[place, ap] = hit[0][0] < 0
    seconds = time.perf_counter() - began
    for ap in range(len(links.ap_ids)):
        links.snr_db(ap, places, los[:, ap])
    pybullet.disconnect(client)
    figures: Figures = {
        "links": los.size,
        "rays": los.size,
        "rays_saved_share": 0.0,
        "ray_seconds": seconds,
        "line_of_sight_share": float(los.mean()),
    }
    return figures, None


RADIO_PHASES: dict[str, Callable[[World, Floor], tuple[Figures, RadioMap | None]]] = {
    "radio_map": radio_map,
    "radio_map_coverage": radio_map_coverage,
    "plain_loop": plain_loop,
}


def measure(smoke: bool, seeds: int) -> Iterator[dict[str, Any]]:
    """A row per case and phase, as `python -m benchmarks run` writes them."""
    warm, floor = hall(4, 4, 1, 1, 2, 1, "inh-office")()
    radio_map(warm, floor)  # imports are not timed
    for case in cases(smoke, seeds):
        world, floor = case.build()
        for name, phase in RADIO_PHASES.items():
            began, cpu = time.perf_counter(), time.process_time()
            figures, _ = phase(world, floor)
            seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
            row = {"family": "radio", "size": case.size, "seed": case.seed, "phase": name}
            yield row | {"seconds": seconds, "cpu_seconds": cpu, **figures}
