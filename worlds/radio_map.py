"""`RadioMap`: SNR and coverage at vertices and along edges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worlds import radio_map_file
from worlds.boxes import contains
from worlds.errors import Fault, WorldError
from worlds.floor import Boxes, Floor
from worlds.link import LinkModel, edge_xy_m
from worlds.world import World

if TYPE_CHECKING:
    from worlds.scene import Scene

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int32]

EDGE_RULES = ("samples", "endpoints")


@dataclass(frozen=True)
class RadioMap:
    """What every AP offers at every vertex and along every edge of the floor.

    Arrays given to it are copied, and read-only from then on.

    Attributes:
        ap_ids: (A,) the enabled APs, in the world's order.
        threshold_db: SNR from which a place counts as covered [dB].
        edge_rule: "samples" or "endpoints" (1-semantics §1.7).
        snr_db: (V, A) float64, SNR at the vertices [dB].
        los: (V, A) bool, line of sight to the AP.
        blocker: (V, A) int32, index of the box that blocks, -1 where there is line of sight.
        edge_snr_db: (E, S, A) float64, SNR at S evenly spaced samples, both ends included [dB].
        fading_db: (V, A) float64, the shadow-fading draw contained in `snr_db` as a gain [dB]
            (0 without). Along an edge it runs linearly from end to end.

    Raises:
        WorldError: arrays that do not fit together.
    """

    ap_ids: tuple[str, ...]
    threshold_db: float
    edge_rule: str
    snr_db: Array
    los: Bools
    blocker: Ints
    edge_snr_db: Array
    fading_db: Array

    def __post_init__(self) -> None:
        for name, dtype in radio_map_file.DTYPES.items():
            array: NDArray[Any] = np.array(getattr(self, name), dtype=dtype)
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if faults := _misfits(self):
            raise WorldError(faults)

    # Coverage (1-semantics §1.6–§1.8)

    @property
    def covered(self) -> Bools:
        """(V, A) whether AP a covers vertex v: A_v."""
        return np.asarray(self.snr_db >= self.threshold_db)

    @property
    def edge_covered(self) -> Bools:
        """(E, A) whether AP a covers the whole of edge e: A_e (§1.7).

        At all its samples, or under `endpoints` at its two ends.
        """
        return np.asarray(self._sample_covered.all(axis=1))

    def edge_handover(self, floor: Floor) -> Bools:
        """(E, A, A) whether [AP at u, AP at v] may take turns on edge e; False for a pair of one.

        §1.7: the first covers u, the second v, and at each sample one of them covers it (under
        `endpoints` there are no samples but the ends).
        """
        covered = self.covered
        at_u, at_v = covered[floor.edge_uv[:, 0]], covered[floor.edge_uv[:, 1]]
        allowed = at_u[:, :, None] & at_v[:, None, :]
        for sample in np.moveaxis(self._sample_covered, 1, 0):
            allowed &= sample[:, :, None] | sample[:, None, :]
        allowed[:, np.arange(len(self.ap_ids)), np.arange(len(self.ap_ids))] = False
        return allowed

    @property
    def edge_holes(self) -> Bools:
        """(E, A) edges whose ends AP a covers but not all in between; a hint under `endpoints`."""
        covered = self.edge_snr_db >= self.threshold_db
        return covered[:, 0] & covered[:, -1] & ~covered.all(axis=1)

    @property
    def _sample_covered(self) -> Bools:
        """(E, S', A) coverage at the samples that the edge rule looks at."""
        covered = self.edge_snr_db >= self.threshold_db
        return covered if self.edge_rule == "samples" else covered[:, [0, -1]]

    # What a network planner asks

    @property
    def best_ap(self) -> Ints:
        """(V,) the AP of highest SNR, ties to the lowest index; −1 where there is no AP."""
        if not self.ap_ids:
            return np.full(len(self.snr_db), -1, dtype=np.int32)
        return np.asarray(self.snr_db.argmax(axis=1), dtype=np.int32)

    def ranked_snr_db(self, rank: int) -> Array:
        """(V,) SNR of the best AP (rank 1), the second best (2), …; −inf where there are fewer."""
        if not 1 <= rank <= len(self.ap_ids):
            return np.full(len(self.snr_db), -np.inf)
        return np.asarray(np.sort(self.snr_db, axis=1)[:, -rank])

    @property
    def coverage_count(self) -> Ints:
        """(V,) how many APs cover each vertex; where it is 1, the loss of that AP leaves a hole."""
        return np.asarray(self.covered.sum(axis=1), dtype=np.int32)

    def covered_share(self, aps: int = 1, threshold_db: float | None = None) -> float:
        """Share of the vertices at which at least `aps` APs reach `threshold_db`; 0 of none."""
        limit = self.threshold_db if threshold_db is None else threshold_db
        enough = (self.snr_db >= limit).sum(axis=1) >= aps
        return float(enough.mean()) if len(enough) else 0.0

    def holes(self, floor: Floor) -> list[Hole]:
        """The vertices no AP covers, each with the AP that comes closest and what blocks it."""
        best = self.best_ap
        found = []
        for vertex in np.flatnonzero(self.coverage_count == 0).tolist():
            ap = int(best[vertex])
            x, y = floor.vertex_xy_m[vertex].tolist()
            if ap < 0:
                found.append(Hole(vertex, x, y, "", -np.inf, ""))
                continue
            box = int(self.blocker[vertex, ap])
            blocker = floor.boxes.name[box] if box >= 0 else ""
            snr = float(self.snr_db[vertex, ap])
            found.append(Hole(vertex, x, y, self.ap_ids[ap], snr, blocker))
        return found

    # Along an edge

    def snr_along(self, edge: ArrayLike, fraction: ArrayLike, ap: ArrayLike) -> Array:
        """Predicted SNR part of the way along edges, linear between samples [dB].

        Args:
            edge: (n,) or one for all.
            fraction: (n,) or one for all, of the way from u to v.
            ap: (n,) or one for all, indices into `ap_ids`.
        """
        on, by = np.asarray(edge, dtype=np.intp), np.asarray(ap, dtype=np.intp)
        gaps = self.edge_snr_db.shape[1] - 1
        place = np.clip(np.asarray(fraction, dtype=np.float64), 0.0, 1.0) * gaps
        before = np.minimum(place.astype(np.intp), gaps - 1)
        first, last = self.edge_snr_db[on, before, by], self.edge_snr_db[on, before + 1, by]
        return _between(first, last, place - before)

    def fading_along(
        self, floor: Floor, edge: ArrayLike, fraction: ArrayLike, ap: ArrayLike
    ) -> Array:
        """Shadow fading part of the way along edges, linear between their ends [dB].

        Args:
            floor: the one the map was made for.
            edge: (n,) or one for all.
            fraction: (n,) or one for all, of the way from u to v.
            ap: (n,) or one for all, indices into `ap_ids`.
        """
        u, v = np.moveaxis(floor.edge_uv[np.asarray(edge, dtype=np.intp)], -1, 0)
        by = np.asarray(ap, dtype=np.intp)
        share = np.clip(np.asarray(fraction, dtype=np.float64), 0.0, 1.0)
        return _between(self.fading_db[u, by], self.fading_db[v, by], share)

    # Bytes

    def to_bytes(self) -> bytes:
        """The map as an `.npz` archive; equal maps give equal bytes."""
        return radio_map_file.to_bytes(self)

    @staticmethod
    def from_bytes(data: bytes, name: str = "radio map") -> RadioMap:
        """The map in `data`; `name` says in messages where it comes from.

        Raises:
            WorldError: these bytes are not a radio map.
        """
        try:
            return RadioMap(**radio_map_file.from_bytes(data))
        except WorldError as error:
            reason = "; ".join(error.lines)
        except ValueError as error:
            reason = str(error)
        message = f"{name} is not a radio map ({reason}); build it anew from its world"
        raise WorldError([Fault((), message)])


@dataclass(frozen=True)
class Hole:
    """A vertex that no AP covers.

    Attributes:
        vertex: index into the floor's vertices.
        x_m, y_m: where it is [m].
        ap, snr_db: the AP that comes closest, and its SNR [dB].
        blocker: the obstacle in the way; "" with line of sight (too far, or faded).
    """

    vertex: int
    x_m: float
    y_m: float
    ap: str
    snr_db: float
    blocker: str


def kept_vertices(radio_map: RadioMap) -> Ints:
    """(V',) the floor's vertices that are in G: covered by at least one AP (§1.8)."""
    return np.flatnonzero(radio_map.coverage_count > 0).astype(np.int32)


def kept_edges(floor: Floor, radio_map: RadioMap) -> Ints:
    """(E',) the floor's edges that are in G: each of their samples covered by some AP (§1.8).

    Under `endpoints` the two ends are the only samples.
    """
    if len(floor.edge_uv) != len(radio_map.edge_snr_db):
        raise WorldError([Fault((), "the radio map was made for another floor; build it anew")])
    whole = np.asarray(radio_map._sample_covered.any(axis=2)).all(axis=1)
    return np.flatnonzero(whole).astype(np.int32)


def build_radio_map(
    world: World,
    floor: Floor,
    *,
    scene: Scene | None = None,
    exact: bool = True,
    on_progress: Callable[[int, int], None] | None = None,
) -> RadioMap:
    """Cast a ray from every AP to every vertex and edge sample, and tell the SNR there.

    Args:
        world: its enabled APs and its radio.
        floor: what the world resolves to.
        scene: an open `Scene.of(world, floor)` to use; one is made for the purpose otherwise.
        exact: when False, rays to edge samples are left out where coverage is known without them
            (line of sight would not reach the threshold, or its absence would not matter) and the
            SNR without line of sight stands there. Coverage is the same, `edge_snr_db` is not.
        on_progress: told (APs done, APs in all) after each AP.

    Raises:
        WorldError: an AP or a robot's antenna would be inside an obstacle.
    """
    from worlds.scene import Scene, ray_growth_m

    links = LinkModel(world)
    at_vertex = links.antenna_m(floor.vertex_xy_m)
    if faults := _embedded(links, floor.boxes, at_vertex, ray_growth_m(world)):
        raise WorldError(faults)
    own_scene = scene is None
    scene = scene or Scene.of(world, floor)
    try:
        if scene.grow_m != ray_growth_m(world):
            raise ValueError("the scene's boxes are not grown as the world asks; use Scene.of")
        shape = (len(at_vertex), len(links.ap_ids))
        blocker, blockage = np.empty(shape, dtype=np.int32), np.empty(shape)
        for ap in range(len(links.ap_ids)):
            sight = links.look(scene, ap, at_vertex)
            blocker[:, ap], blockage[:, ap] = sight.blocker, sight.blockage_db
        los = blocker < 0
        fading = links.fading_db(floor, los)
        if world.radio.measured is not None:
            from worlds.survey import measured_fading_db

            fading = measured_fading_db(world, floor, links, at_vertex, los, blockage, fading)
        snr = np.empty(los.shape)
        edge_snr = np.empty((len(floor.edge_uv), world.radio.samples_per_edge, len(links.ap_ids)))
        for ap in range(len(links.ap_ids)):
            snr[:, ap] = links.snr_db(ap, at_vertex, los[:, ap], fading[:, ap], blockage[:, ap])
            # The ends are the vertices themselves: no ray is cast twice.
            edge_snr[:, 0, ap] = snr[floor.edge_uv[:, 0], ap]
            edge_snr[:, -1, ap] = snr[floor.edge_uv[:, 1], ap]
            edge_snr[:, 1:-1, ap] = _inner_snr_db(
                world, floor, links, scene, ap, fading[:, ap], exact
            )
            if on_progress:
                on_progress(ap + 1, len(links.ap_ids))
    finally:
        if own_scene:
            scene.close()
    return RadioMap(
        links.ap_ids,
        world.radio.threshold_db,
        world.radio.edge_rule,
        snr,
        los,
        blocker,
        edge_snr,
        fading,
    )


def _inner_snr_db(
    world: World,
    floor: Floor,
    links: LinkModel,
    scene: Scene,
    ap: int,
    fading_db: Array,
    exact: bool,
) -> Array:
    """(E, S − 2) SNR of one AP at the samples between the ends of the edges [dB].

    A ray is cast only where it makes a difference: to the SNR, or (not `exact`) to coverage.
    """
    share = np.linspace(0.0, 1.0, world.radio.samples_per_edge)[1:-1]
    edges = len(floor.edge_uv)
    edge = np.repeat(np.arange(edges), len(share))
    fraction = np.tile(share, edges)
    antenna = links.antenna_m(edge_xy_m(floor, edge, fraction))
    at_u, at_v = fading_db[floor.edge_uv[edge, 0]], fading_db[floor.edge_uv[edge, 1]]
    faded = _between(at_u, at_v, fraction)
    snr = links.predict(
        scene,
        ap,
        antenna,
        free_fading_db=faded,
        blocked_fading_db=faded,
        threshold_db=None if exact else world.radio.threshold_db,
    )
    return snr.reshape(edges, len(share))


def _between(first: Array, last: Array, share: Array) -> Array:
    """Linear interpolation; exactly `first` at 0 and `last` at 1."""
    return np.asarray((1.0 - share) * first + share * last)


def _embedded(links: LinkModel, boxes: Boxes, antenna_m: Array, grow_m: float) -> list[Fault]:
    """APs inside a box as rays see it (they would see nothing), antennas inside a real one."""
    faults = []
    for ap, box in enumerate(contains(boxes, links.position_m, grow_m).tolist()):
        if box >= 0:
            message = (
                f"AP {links.ap_ids[ap]!r} is inside obstacle {boxes.name[box]!r} (or nearer than "
                f"{grow_m:g} m) and reaches nothing; move it at least {grow_m:g} m off"
            )
            faults.append(Fault(("ap", links.ap_index[ap], "position_m"), message))
    inside = contains(boxes, antenna_m)
    for vertex in np.flatnonzero(inside >= 0)[:5].tolist():
        x, y, z = antenna_m[vertex].tolist()
        message = (
            f"the antenna of a robot at ({x:g}, {y:g}) would be {z:g} m high inside obstacle "
            f"{boxes.name[inside[vertex]]!r}; change antenna_m or the obstacle"
        )
        faults.append(Fault(("hall", "body", "antenna_m"), message))
    return faults


def _misfits(radio_map: RadioMap) -> list[Fault]:
    """What is wrong with the arrays of a map, taken together."""
    vertices, aps = radio_map.fading_db.shape[:1], (len(radio_map.ap_ids),)
    edges = radio_map.edge_snr_db.shape[:2]
    shapes = {
        "snr_db": vertices + aps,
        "los": vertices + aps,
        "blocker": vertices + aps,
        "edge_snr_db": edges + aps,
        "fading_db": vertices + aps,
    }
    faults: list[Fault] = []

    def wrong(field: str, message: str) -> None:
        faults.append(Fault(("radio_map", field), message))

    for field, shape in shapes.items():
        array: NDArray[Any] = getattr(radio_map, field)
        if array.shape != shape or array.ndim != (3 if field == "edge_snr_db" else 2):
            wrong(field, f"has shape {array.shape}; the other arrays and the APs ask for {shape}")
        if array.dtype == np.float64 and not np.isfinite(array).all():
            wrong(field, "holds NaN or infinity; use −1000 dB for no signal")
    if len(set(radio_map.ap_ids)) != len(radio_map.ap_ids):
        wrong("ap_ids", "names an AP twice")
    if not np.isfinite(radio_map.threshold_db):
        wrong("threshold_db", f"is {radio_map.threshold_db}; give a number of decibels")
    if radio_map.edge_rule not in EDGE_RULES:
        wrong("edge_rule", f"is {radio_map.edge_rule!r}; give one of {', '.join(EDGE_RULES)}")
    if len(edges) == 2 and edges[1] < 2:
        wrong("edge_snr_db", f"has {edges[1]} samples an edge; its two ends are the least")
    if not faults and not np.array_equal(radio_map.los, radio_map.blocker < 0):
        wrong("blocker", "must be −1 exactly where there is line of sight")
    return faults
