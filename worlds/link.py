"""`LinkModel`: the SNR of a robot at a place. Map, twin and validator ask the same one.

SNR = P_tx + G_ap + pattern + G_robot − N + fading − (path loss + oxygen + low antenna + blockage)

What a world does not switch on is 0. With `blockage = "knife-edge"` a link counts as one with line
of sight in all tables (path loss, sigma, correlation, margin); what the boxes in its way cost is
added on top (`worlds.blockage`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worlds import channel, fading
from worlds.antenna import pattern_db
from worlds.blockage import knife_edge_db
from worlds.floor import Floor
from worlds.streams import stream
from worlds.world import World

if TYPE_CHECKING:
    from worlds.scene import Scene

Array = NDArray[np.float64]

FADING_STREAM = "shadow fading"
"""Name of the random stream of shadow fading; its entities are the APs' ids."""

RASTER_SHARE = 20.0
"""On a graph, correlated fading is drawn on cells of this part of its correlation distance."""


@dataclass(frozen=True)
class Sight:
    """What lies between APs and robots.

    Attributes:
        blocker: (n,) int32, the box that blocks, −1 with line of sight.
        blockage_db: (n,) float64, what knife edges cost; 0 where the world does not ask for them.
    """

    blocker: NDArray[np.int32]
    blockage_db: Array

    @property
    def free(self) -> NDArray[np.bool_]:
        """(n,) line of sight."""
        return np.asarray(self.blocker < 0)


@dataclass(frozen=True)
class Budget:
    """The terms of the SNR of n links, each (n,) [dB] or [dBm]; losses are positive.

    Attributes:
        distance_m: between the antennas.
        tx_power_dbm, ap_gain_db: of the AP, along its boresight if it points somewhere.
        pattern_db: ≤ 0, what its pattern leaves of the gain.
        robot_gain_db, noise_dbm: of the robots.
        path_loss_db: of table 7.4.1-1.
        oxygen_db, low_antenna_db, blockage_db: further losses.
        fading_db: a gain.
    """

    distance_m: Array
    tx_power_dbm: Array
    ap_gain_db: Array
    pattern_db: Array
    robot_gain_db: float
    noise_dbm: float
    path_loss_db: Array
    oxygen_db: Array
    low_antenna_db: Array
    blockage_db: Array
    fading_db: Array

    @property
    def loss_db(self) -> Array:
        """(n,) all losses together [dB]."""
        further = self.oxygen_db + self.low_antenna_db + self.blockage_db
        return np.asarray(self.path_loss_db + further)

    @property
    def snr_db(self) -> Array:
        """(n,) the SNR [dB]."""
        return channel.snr_db(
            self.loss_db,
            tx_power_dbm=self.tx_power_dbm,
            ap_gain_db=self.ap_gain_db + self.pattern_db,
            robot_gain_db=self.robot_gain_db,
            noise_dbm=self.noise_dbm,
            fading_db=self.fading_db,
        )


class LinkModel:
    """The enabled access points of a world and what a robot receives from them.

    Attributes:
        ap_ids: (A,) names of the enabled APs, in the world's order.
        ap_index: (A,) their indices in `world.ap`.
        position_m: (A, 3) where they hang [m].
        model: (A,) the channel model of each.
        knife_edge: whether boxes in the way cost diffraction instead of the line of sight.
    """

    def __init__(self, world: World) -> None:
        radio = world.radio
        enabled = [(index, ap) for index, ap in enumerate(world.ap) if ap.enabled]
        aps = [ap for _, ap in enabled]
        self.ap_ids = tuple(ap.id for ap in aps)
        self.ap_index = tuple(index for index, _ in enabled)
        self.position_m = _column([ap.position_m for ap in aps]).reshape(-1, 3)
        self.model = tuple(ap.model or radio.model for ap in aps)
        self.knife_edge = radio.blockage == "knife-edge"
        self._model = np.array(self.model, dtype=np.str_)
        self._radio = radio
        self._body_antenna_m = world.hall.body.antenna_m
        self._tx_power_dbm = _column(
            [radio.tx_power_dbm if ap.tx_power_dbm is None else ap.tx_power_dbm for ap in aps]
        )
        offset = [radio.offset_db if ap.offset_db is None else ap.offset_db for ap in aps]
        gain = [radio.ap_gain_db if ap.gain_db is None else ap.gain_db for ap in aps]
        self._gain_db = _column([g + o for g, o in zip(gain, offset, strict=True)])
        self._antenna = [ap.antenna for ap in aps]

    def antenna_m(self, xy_m: ArrayLike) -> Array:
        """(n, 3) the antennas of robots whose centres stand at `xy_m` (n, 2) [m]."""
        xy = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
        return np.column_stack((xy, np.full(len(xy), self._body_antenna_m)))

    # What robots experience

    def look(self, scene: Scene, ap: ArrayLike, antenna_m: Array, own: ArrayLike = -1) -> Sight:
        """What is between APs and robots in `scene` as it is now.

        Args:
            scene: of the world's floor (`Scene.of`), with whatever moves in it.
            ap: (n,) indices into `ap_ids`, or one for all.
            antenna_m: (n, 3) the robots' antennas [m].
            own: (n,) the robots' own bodies as `Scene.cast` numbers them, or one for all; they do
                not shade their antenna. Negative for none.
        """
        at = self.position_m[_serving(ap, antenna_m)]
        mine = np.broadcast_to(np.asarray(own, dtype=np.int64), len(at))
        blocker = scene.cast(at, antenna_m)
        # Its own body is the last box on the way to the antenna, unless another body reaches into
        # it (the next robot at a goal that this one is leaving): then they are met together.
        met = np.flatnonzero((blocker == mine) & (mine >= 0))
        if len(met):
            blocker[met] = scene.cast_past(at[met], antenna_m[met], mine[met])
        return Sight(blocker, self._blockage_db(scene, at, antenna_m, mine))

    def measure(
        self,
        scene: Scene,
        ap: ArrayLike,
        antenna_m: Array,
        fading_db: ArrayLike = 0.0,
        own: ArrayLike = -1,
    ) -> tuple[Array, NDArray[np.int32]]:
        """What robots experience, decided by rays cast in `scene` as it is now.

        Args:
            scene, ap, antenna_m, own: as for `look`.
            fading_db: (n,) shadow fading as a gain, 0 without.

        Returns:
            SNR [dB] (n,), and the box that blocks (n,), −1 with line of sight.
        """
        sight = self.look(scene, ap, antenna_m, own)
        snr = self.snr_db(ap, antenna_m, sight.free, fading_db, sight.blockage_db)
        return snr, sight.blocker

    def predict(
        self,
        scene: Scene,
        ap: int,
        antenna_m: Array,
        *,
        free_fading_db: ArrayLike = 0.0,
        blocked_fading_db: ArrayLike = 0.0,
        threshold_db: float | None = None,
    ) -> Array:
        """(n,) SNR of one AP [dB]; a ray is cast only where its answer makes a difference.

        Args:
            scene, antenna_m: as for `look`.
            ap: index into `ap_ids`.
            free_fading_db, blocked_fading_db: (n,) shadow fading with and without line of sight.
            threshold_db: ask only whether this is reached; where that is known without a ray, the
                SNR without line of sight stands (with knife edges: that with it).
        """
        free = self.snr_db(ap, antenna_m, True, free_fading_db)
        if self.knife_edge:
            limit = -np.inf if threshold_db is None else threshold_db
            asked = np.flatnonzero(free >= limit)
            at = np.broadcast_to(self.position_m[ap], (len(asked), 3))
            blockage = np.zeros(len(free))
            blockage[asked] = self._blockage_db(scene, at, antenna_m[asked])
            return self.snr_db(ap, antenna_m, True, free_fading_db, blockage)
        snr = self.snr_db(ap, antenna_m, False, blocked_fading_db)
        if threshold_db is None:
            matters = free != snr
        else:
            matters = (free >= threshold_db) != (snr >= threshold_db)
        rays = np.flatnonzero(matters)
        seen = rays[scene.cast(self.position_m[ap], antenna_m[rays]) < 0]
        snr[seen] = free[seen]
        return snr

    def _blockage_db(
        self, scene: Scene, at_m: Array, antenna_m: Array, own: NDArray[np.int64] | None = None
    ) -> Array:
        """(n,) what knife edges cost; 0 where the world does not ask for them."""
        if not self.knife_edge:
            return np.zeros(len(antenna_m))
        handle, boxes = scene.visible_boxes()
        mine = None
        if own is not None:  # as an index into `boxes`; −1 for what is not among them
            at = np.minimum(np.searchsorted(handle, own), max(0, len(handle) - 1))
            mine = np.where(handle[at] == own, at, -1) if len(handle) else None
        return knife_edge_db(boxes, at_m, antenna_m, self._radio.frequency_ghz, mine)

    # The formulas

    def snr_db(
        self,
        ap: ArrayLike,
        antenna_m: Array,
        los: ArrayLike,
        fading_db: ArrayLike = 0.0,
        blockage_db: ArrayLike = 0.0,
    ) -> Array:
        """SNR of each link [dB]; see `budget`."""
        return self.budget(ap, antenna_m, los, fading_db, blockage_db).snr_db

    def budget(
        self,
        ap: ArrayLike,
        antenna_m: Array,
        los: ArrayLike,
        fading_db: ArrayLike = 0.0,
        blockage_db: ArrayLike = 0.0,
    ) -> Budget:
        """The terms of each link's SNR.

        Args:
            ap: (n,) indices into `ap_ids`, or one for all.
            antenna_m: (n, 3) the robots' antennas [m].
            los: (n,) bool, line of sight, or one for all.
            fading_db: (n,) shadow fading as a gain, 0 without.
            blockage_db: (n,) of `Sight`, 0 without knife edges.
        """
        radio = self._radio
        serving = _serving(ap, antenna_m)
        sight = self.as_if_free(np.broadcast_to(np.asarray(los, dtype=np.bool_), serving.shape))
        away = antenna_m - self.position_m[serving]
        distance = np.linalg.norm(away, axis=1)
        loss = np.empty(len(antenna_m))
        for model, of in self._by_model(serving):
            loss[of] = channel.path_loss_db(model, distance[of], sight[of], radio.frequency_ghz)
        none = np.zeros(len(antenna_m))
        return Budget(
            distance_m=distance,
            tx_power_dbm=self._tx_power_dbm[serving],
            ap_gain_db=self._gain_db[serving],
            pattern_db=self._pattern_db(serving, away),
            robot_gain_db=radio.robot_gain_db,
            noise_dbm=radio.noise_dbm,
            path_loss_db=loss,
            oxygen_db=channel.oxygen_db(distance, radio.frequency_ghz) if radio.oxygen else none,
            low_antenna_db=np.where(sight, radio.low_antenna_los_db, radio.low_antenna_nlos_db),
            blockage_db=none + np.asarray(blockage_db, dtype=np.float64),
            fading_db=none + np.asarray(fading_db, dtype=np.float64),
        )

    def as_if_free(self, los: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """The sight that counts in the tables: with knife edges every link has it."""
        return np.ones_like(los) if self.knife_edge else los

    def fading_db(self, floor: Floor, los: NDArray[np.bool_]) -> Array:
        """(V, A) shadow fading at the vertices as a gain [dB]; 0 where the world has none.

        Drawn per AP for every position of the grid, blocked positions included, so that no
        obstacle and no other AP shifts it; scaled by the model's sigma for the vertex's `los`
        (V, A). Correlated fields have the correlation distance of that state, too.
        """
        drawn = np.zeros(los.shape)
        if not self._radio.shadow_fading:
            return drawn
        sight = self.as_if_free(los)
        for index in range(len(self.ap_ids)):
            free, blocked = self.fading_by_sight_db(floor, index)
            drawn[:, index] = np.where(sight[:, index], free, blocked)
        return drawn

    def fading_by_sight_db(self, floor: Floor, ap: int) -> tuple[Array, Array]:
        """Shadow fading of an AP at the vertices with and without line of sight, each (V,) [dB]."""
        if not self._radio.shadow_fading:
            none = np.zeros(len(floor.vertex_xy_m))
            return none, none
        free, blocked = self._fields(floor, self.ap_ids[ap], self.model[ap])
        sigma = channel.sigma_db(self.model[ap], self.as_if_free(np.array([True, False])))
        return free * sigma[0], blocked * sigma[1]

    def _fields(self, floor: Floor, ap_id: str, model: str) -> tuple[Array, Array]:
        """Standard normal fields of an AP with and without line of sight, at the vertices (V,)."""
        random = stream(self._radio.fading_seed, FADING_STREAM, ap_id)
        asked = self._radio.fading_correlation
        column, row = floor.vertex_cell.T
        if asked == "none":
            same = fading.white(random, floor.rows, floor.columns)[row, column]
            return same, same
        distances = channel.correlation_m(model) if isinstance(asked, str) else (asked, asked)
        step = 1
        if floor.raster_m is not None:  # a raster is finer than the field has use for
            step = max(1, int(min(distances) / (RASTER_SHARE * floor.raster_m)))
        rows, columns = -(-floor.rows // step), -(-floor.columns // step)
        free, blocked = (
            field[row // step, column // step]
            for field in fading.correlated(random, rows, columns, step * floor.cell_m, distances)
        )
        if self.knife_edge:
            blocked = free
        return free, blocked

    def _pattern_db(self, serving: NDArray[np.intp], away_m: Array) -> Array:
        """(n,) what the patterns of APs that point somewhere leave of their gain [dB]."""
        pattern = np.zeros(len(serving))
        for index, antenna in enumerate(self._antenna):
            if antenna is not None:
                of = np.flatnonzero(serving == index)
                pattern[of] = pattern_db(antenna, away_m[of])
        return pattern

    def _by_model(self, ap: NDArray[np.intp]) -> list[tuple[str, NDArray[np.intp]]]:
        """The links of each channel model: its name and their places in `ap` (n,)."""
        models = self._model[ap]
        return [(str(model), np.flatnonzero(models == model)) for model in np.unique(models)]


def _serving(ap: ArrayLike, antenna_m: Array) -> NDArray[np.intp]:
    """(n,) the AP of each link."""
    return np.broadcast_to(np.asarray(ap, dtype=np.intp), (len(antenna_m),))


def edge_xy_m(floor: Floor, edge: ArrayLike, fraction: ArrayLike) -> Array:
    """(n, 2) the places at `fraction` (n,) of the way from u to v along `edge` (n,) [m]."""
    share = np.asarray(fraction, dtype=np.float64)[..., None]
    u, v = np.moveaxis(floor.vertex_xy_m[floor.edge_uv[np.asarray(edge, dtype=np.intp)]], -2, 0)
    return np.asarray((1.0 - share) * u + share * v)


def _column(values: list[float] | list[tuple[float, float, float]]) -> Array:
    """A read-only float64 array."""
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array
