"""`LinkModel`: the SNR of a robot at a place. The map and the twin ask the same one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worlds import channel
from worlds.floor import Floor
from worlds.streams import stream
from worlds.world import World

if TYPE_CHECKING:
    from worlds.scene import Scene

Array = NDArray[np.float64]

FADING_STREAM = "shadow fading"
"""Name of the random stream of shadow fading; its entities are the APs' ids."""


class LinkModel:
    """The enabled access points of a world and what a robot receives from them.

    Attributes:
        ap_ids: (A,) names of the enabled APs, in the world's order.
        ap_index: (A,) their indices in `world.ap`.
        position_m: (A, 3) where they hang [m].
    """

    def __init__(self, world: World) -> None:
        radio = world.radio
        enabled = [(index, ap) for index, ap in enumerate(world.ap) if ap.enabled]
        aps = [ap for _, ap in enabled]
        self.ap_ids = tuple(ap.id for ap in aps)
        self.ap_index = tuple(index for index, _ in enabled)
        self.position_m = _column([ap.position_m for ap in aps]).reshape(-1, 3)
        self._radio = radio
        self._body_antenna_m = world.hall.body.antenna_m
        self._tx_power_dbm = _column(
            [radio.tx_power_dbm if ap.tx_power_dbm is None else ap.tx_power_dbm for ap in aps]
        )
        self._gain_db = _column(
            [radio.ap_gain_db if ap.gain_db is None else ap.gain_db for ap in aps]
        )
        self._model = np.array([ap.model or radio.model for ap in aps], dtype=np.str_)

    def antenna_m(self, xy_m: ArrayLike) -> Array:
        """(n, 3) the antennas of robots whose centres stand at `xy_m` (n, 2) [m]."""
        xy = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
        return np.column_stack((xy, np.full(len(xy), self._body_antenna_m)))

    def measure(
        self, scene: Scene, ap: ArrayLike, antenna_m: Array, fading_db: ArrayLike = 0.0
    ) -> tuple[Array, NDArray[np.int32]]:
        """What robots experience, decided by rays cast in `scene` as it is now.

        Args:
            scene: of the world's floor (`Scene.of`), with whatever moves in it.
            ap: (n,) indices into `ap_ids`, or one for all.
            antenna_m: (n, 3) the robots' antennas [m].
            fading_db: (n,) shadow fading as a gain, 0 without.

        Returns:
            SNR [dB] (n,), and the box that blocks (n,), −1 with line of sight.
        """
        serving = np.broadcast_to(np.asarray(ap, dtype=np.intp), (len(antenna_m),))
        blocker = scene.cast(self.position_m[serving], antenna_m)
        return self.snr_db(serving, antenna_m, blocker < 0, fading_db), blocker

    def snr_db(
        self, ap: ArrayLike, antenna_m: Array, los: ArrayLike, fading_db: ArrayLike = 0.0
    ) -> Array:
        """SNR of each link [dB].

        Args:
            ap: (n,) indices into `ap_ids`, or one for all.
            antenna_m: (n, 3) the robots' antennas [m].
            los: (n,) bool, line of sight, or one for all.
            fading_db: (n,) shadow fading as a gain, 0 without.
        """
        serving = np.broadcast_to(np.asarray(ap, dtype=np.intp), (len(antenna_m),))
        sight = np.broadcast_to(np.asarray(los, dtype=np.bool_), serving.shape)
        distance = np.linalg.norm(antenna_m - self.position_m[serving], axis=1)
        loss = np.empty(len(antenna_m))
        for model, of in self._by_model(serving):
            loss[of] = channel.path_loss_db(
                model, distance[of], sight[of], self._radio.frequency_ghz
            )
        return channel.snr_db(
            loss,
            tx_power_dbm=self._tx_power_dbm[serving],
            ap_gain_db=self._gain_db[serving],
            robot_gain_db=self._radio.robot_gain_db,
            noise_dbm=self._radio.noise_dbm,
            fading_db=fading_db,
        )

    def fading_db(self, floor: Floor, los: NDArray[np.bool_]) -> Array:
        """(V, A) shadow fading at the vertices as a gain [dB]; 0 where the world has none.

        One normal draw per AP and position of the grid, blocked positions included, so that no
        obstacle and no other AP shifts it; scaled by the model's sigma for the vertex's `los`
        (V, A).
        """
        fading = np.zeros(los.shape)
        if not self._radio.shadow_fading:
            return fading
        column, row = floor.vertex_cell.T
        for index, (ap_id, model) in enumerate(zip(self.ap_ids, self._model, strict=True)):
            draws = stream(self._radio.fading_seed, FADING_STREAM, ap_id).standard_normal(
                (floor.rows, floor.columns)
            )
            fading[:, index] = draws[row, column] * channel.sigma_db(str(model), los[:, index])
        return fading

    def _by_model(self, ap: NDArray[np.intp]) -> list[tuple[str, NDArray[np.intp]]]:
        """The links of each channel model: its name and their places in `ap` (n,)."""
        models = self._model[ap]
        return [(str(model), np.flatnonzero(models == model)) for model in np.unique(models)]


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
