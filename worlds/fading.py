"""Shadow fading on the grid of positions: standard normal fields of an access point.

Independent from place to place, or with the autocorrelation exp(−Δ / d) of 3GPP TR 38.901 v16.1.0,
clause 7.4.4 (7.4-5). Correlated fields are exact, by circulant embedding (C. Dietrich and
G. Newsam, 1997, doi:10.1137/S1064827592240555): the grid lies on a torus so large that a field with
that autocorrelation exists on it; there its spectrum is the Fourier transform of the
autocorrelation.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MAX_CELLS = 16_777_216
"""Cells of the torus; beyond, memory would run out."""

_NEGATIVE = 1e-9
"""Negative values of the spectrum, relative to the largest, that count as rounding."""


def white(random: np.random.Generator, rows: int, columns: int) -> Array:
    """(rows, columns) independent standard normal draws."""
    return random.standard_normal((rows, columns))


def correlated(
    random: np.random.Generator,
    rows: int,
    columns: int,
    pitch_m: float,
    distances_m: tuple[float, ...],
) -> list[Array]:
    """A field for each correlation distance [m], all from the same noise.

    Each is standard normal at every place, with correlation exp(−Δ / distance) between places Δ
    apart. Being made of one noise, the fields of two distances resemble each other: where a robot
    comes out of the shadow, its fading does not jump to something unrelated.

    Args:
        random: of the access point.
        rows, columns: of the grid.
        pitch_m: of the grid [m].
        distances_m: where the correlation has fallen to 1/e [m].

    Returns:
        For each distance (rows, columns) float64.
    """
    size, amplitudes = _amplitudes(rows, columns, pitch_m, distances_m)
    noise = random.standard_normal(size) + 1j * random.standard_normal(size)
    fields = []
    for amplitude in amplitudes:
        field = np.fft.fft2(amplitude * noise).real
        fields.append(np.ascontiguousarray(field[:rows, :columns]))
    return fields


@lru_cache(maxsize=2)
def _amplitudes(
    rows: int, columns: int, pitch_m: float, distances_m: tuple[float, ...]
) -> tuple[tuple[int, int], tuple[Array, ...]]:
    """Size of the torus, and the roots of the spectra; the same for all access points of a hall."""
    size = _torus(rows, columns, pitch_m, max(distances_m))
    spectra = (np.maximum(_spectrum(size, pitch_m, distance), 0.0) for distance in distances_m)
    return size, tuple(np.sqrt(spectrum / spectrum.size) for spectrum in spectra)


def _torus(rows: int, columns: int, pitch_m: float, distance_m: float) -> tuple[int, int]:
    """Rows and columns of the least torus, doubling, on which the field exists."""
    size = (_smooth(2 * rows), _smooth(2 * columns))
    while True:
        spectrum = _spectrum(size, pitch_m, distance_m)
        if spectrum.min() >= -_NEGATIVE * spectrum.max():
            return size
        larger = (2 * size[0], 2 * size[1])
        if larger[0] * larger[1] > MAX_CELLS:
            # What is negative is set to 0 then: the variance is off by less than its share.
            return size
        size = larger


def _spectrum(size: tuple[int, int], pitch_m: float, distance_m: float) -> Array:
    """Eigenvalues of the covariance on the torus: the transform of exp(−Δ / d)."""
    y, x = (np.minimum(np.arange(n), n - np.arange(n)) * pitch_m for n in size)
    covariance = np.exp(-np.hypot(y[:, None], x[None, :]) / distance_m)
    return np.asarray(np.fft.fft2(covariance).real)


def _smooth(least: int) -> int:
    """A power of two, for which the transform is fast and the same on every machine."""
    return 1 << max(1, (least - 1).bit_length())
