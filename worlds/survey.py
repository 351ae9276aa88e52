"""Measured radio maps: what was measured near each vertex, held against the model.

A vertex takes the median, or the 10th percentile, of the measurements within a radius, if there are
enough of them. A measured map is the model's map with a correction at each vertex (measured minus
model) that runs linearly along the edges, exactly as shadow fading does: so rays still say where
obstacles stand in the way, twin and validator meet the same field, and at the vertices the SNR is
the measured one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from worlds.errors import Fault, Key, WorldError
from worlds.floor import Floor
from worlds.formats.survey_csv import Survey, parse_survey
from worlds.world import Measured, World

if TYPE_CHECKING:
    from worlds.link import LinkModel
    from worlds.radio_map import RadioMap

NO_SIGNAL_DB = -1000.0
KEY: Key = ("radio", "measured")
NAMED = 3

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Measurement:
    """What a survey says about the vertices.

    Attributes:
        snr_db: (V, A) float64, NaN where there are too few measurements [dB].
        count: (V, A) int32, how many there are within the radius.
    """

    snr_db: Array
    count: NDArray[np.int32]


def survey_of(world: World) -> Survey | None:
    """The survey a world carries; None without one.

    Raises:
        WorldError: it is none, or its file was not taken in (`worlds.world_files`).
    """
    measured = world.radio.measured
    if measured is None:
        return None
    if measured.csv is None:
        rule = f"'{measured.file}' was not read; read the world from its file"
        raise WorldError([Fault(KEY, rule)])
    try:
        return parse_survey(
            measured.csv,
            measured.source or "survey",
            [ap.id for ap in world.ap],
            world.radio.noise_dbm,
            world.hall.size_m,
        )
    except WorldError as error:
        raise WorldError([Fault(KEY, line) for line in error.lines]) from None


def at_vertices(
    survey: Survey, floor: Floor, ap_ids: tuple[str, ...], how: Measured
) -> Measurement:
    """What was measured at each vertex.

    Args:
        survey: the measurements.
        floor: for the vertices.
        ap_ids: (A,) the APs wanted; measurements of others do not count.
        how: statistic, radius, least number.
    """
    from scipy.spatial import cKDTree

    shape = (len(floor.vertex_xy_m), len(ap_ids))
    snr, count = np.full(shape, np.nan), np.zeros(shape, dtype=np.int32)
    radius = how.radius_m if how.radius_m is not None else floor.pitch_m / 2
    share = 50.0 if how.statistic == "median" else 10.0
    vertices = cKDTree(floor.vertex_xy_m)
    for a, name in enumerate(ap_ids):
        rows = np.flatnonzero(survey.ap == survey.ap_ids.index(name))
        if not len(rows):
            continue
        near = vertices.query_ball_tree(cKDTree(survey.xy_m[rows]), radius)
        value = survey.snr_db[rows]
        for v, found in enumerate(near):
            count[v, a] = len(found)
            if len(found) >= how.min_samples:
                snr[v, a] = np.percentile(value[sorted(found)], share)
    return Measurement(snr, count)


def correction_db(
    world: World, floor: Floor, ap_ids: tuple[str, ...], model_snr_db: Array
) -> Array | None:
    """(V, A) what is added to the model's SNR at the vertices; None for a world without a survey.

    Args:
        world: with its survey and the policy for gaps.
        floor: what it resolves to.
        ap_ids: (A,) the enabled APs.
        model_snr_db: (V, A) [dB].

    Raises:
        WorldError: gaps, where the world calls them an error.
    """
    survey, how = survey_of(world), world.radio.measured
    if survey is None or how is None:
        return None
    found = at_vertices(survey, floor, ap_ids, how)
    gap = np.isnan(found.snr_db)
    if how.gaps == "error" and gap.any():
        raise WorldError([Fault(KEY, text) for text in gap_texts(floor, ap_ids, found, how)])
    measured = found.snr_db
    if how.gaps == "uncovered":
        measured = np.where(gap, NO_SIGNAL_DB, measured)
    return np.where(np.isnan(measured), 0.0, measured - model_snr_db)


def measured_fading_db(
    world: World,
    floor: Floor,
    links: LinkModel,
    antenna_m: Array,
    los: NDArray[np.bool_],
    blockage_db: Array,
    fading_db: Array,
) -> Array:
    """(V, A) the fading [dB], and what measurements add to the model where there are some.

    Args, Raises: as `correction_db` and `LinkModel.snr_db`.
    """
    columns = [
        links.snr_db(ap, antenna_m, los[:, ap], fading_db[:, ap], blockage_db[:, ap])
        for ap in range(len(links.ap_ids))
    ]
    model = np.column_stack(columns) if columns else np.empty(los.shape)
    correction = correction_db(world, floor, links.ap_ids, model)
    return fading_db if correction is None else np.asarray(fading_db + correction)


def gap_texts(
    floor: Floor, ap_ids: tuple[str, ...], found: Measurement, how: Measured
) -> list[str]:
    """For each AP with gaps, how many vertices lack measurements and which."""
    gap = np.isnan(found.snr_db)
    radius = how.radius_m if how.radius_m is not None else floor.pitch_m / 2
    texts = []
    for a, name in enumerate(ap_ids):
        vertices = np.flatnonzero(gap[:, a])
        if not len(vertices):
            continue
        some = ", ".join(floor.vertex_name(v) for v in vertices[:NAMED].tolist())
        more = ", …" if len(vertices) > NAMED else ""
        texts.append(
            f"'{name}' has fewer than {how.min_samples} measurements within {radius:g} m of "
            f"{len(vertices)} of {len(gap)} positions ({some}{more}); measure there, widen "
            'radius_m, lower min_samples, or set gaps = "model"'
        )
    return texts


@dataclass(frozen=True)
class Comparison:
    """How far a model is from measurements, for one AP or for all.

    Attributes:
        ap: its id; "" for all together.
        places: vertices with enough measurements.
        samples: measurements near them.
        mean_db: measured minus model, mean over the places: what to add to the model.
        mae_db: mean absolute error.
        std_db: standard deviation of the errors about their mean.
        rest_mae_db: mean absolute error that is left once `mean_db` is added.
    """

    ap: str
    places: int
    samples: int
    mean_db: float
    mae_db: float
    std_db: float
    rest_mae_db: float


def compare(
    survey: Survey, floor: Floor, radio_map: RadioMap, how: Measured
) -> tuple[Comparison, ...]:
    """A radio map of the model against measurements: all APs together first, then each one.

    Raises:
        WorldError: no vertex has enough measurements.
    """
    found = at_vertices(survey, floor, radio_map.ap_ids, how)
    error = found.snr_db - radio_map.snr_db
    if np.isnan(error).all():
        radius = how.radius_m if how.radius_m is not None else floor.pitch_m / 2
        rule = f"no position has {how.min_samples} measurements of an AP within {radius:g} m"
        mend = "widen the radius, or ask for fewer"
        raise WorldError([Fault((), f"{rule} ({len(survey)} measurements in all); {mend}")])
    rows = [_comparison("", error, found.count)]
    for a, name in enumerate(radio_map.ap_ids):
        if not np.isnan(error[:, a]).all():
            rows.append(_comparison(name, error[:, a], found.count[:, a]))
    return tuple(rows)


def _comparison(ap: str, error: Array, count: NDArray[np.int32]) -> Comparison:
    there = ~np.isnan(error)
    e = error[there]
    mean = float(e.mean())
    return Comparison(
        ap,
        int(there.sum()),
        int(count[there].sum()),
        mean,
        float(np.abs(e).mean()),
        float(e.std()),
        float(np.abs(e - mean).mean()),
    )
