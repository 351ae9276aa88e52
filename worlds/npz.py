"""Arrays ⇄ `.npz` bytes: the same arrays give the same bytes, and bad bytes give one error.

`numpy.savez` writes the time of day into the archive; here dates are fixed and nothing is
compressed, so the bytes depend on the arrays alone. `numpy.load` reads the result.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

_DATE = (1980, 1, 1, 0, 0, 0)  # the first a zip can hold


def pack(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """The archive of these arrays, in their order."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            member = io.BytesIO()
            np.lib.format.write_array(
                member, np.ascontiguousarray(array).reshape(array.shape), (1, 0), allow_pickle=False
            )
            info = zipfile.ZipInfo(f"{name}.npy", date_time=_DATE)
            info.create_system = 3  # or it would tell the writer's operating system
            info.external_attr = 0o644 << 16
            archive.writestr(info, member.getvalue())
    return buffer.getvalue()


def unpack(data: bytes) -> dict[str, NDArray[Any]]:
    """The arrays of an archive that `pack` wrote.

    Raises:
        ValueError: whatever is wrong with the bytes, in words.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            infos = archive.infolist()
            if any(info.compress_type != zipfile.ZIP_STORED for info in infos):
                raise ValueError("its arrays are compressed")
            return {
                info.filename.removesuffix(".npy"): _array(archive.read(info)) for info in infos
            }
    except ValueError:
        raise
    except Exception as error:  # zipfile and numpy report damage through a dozen types
        raise ValueError(str(error) or type(error).__name__) from error


def _array(member: bytes) -> NDArray[Any]:
    """One `.npy` member; what its header claims is compared with what is there."""
    stream = io.BytesIO(member)
    if np.lib.format.read_magic(stream) != (1, 0):
        raise ValueError("an array has an unknown version")
    shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
    if dtype.hasobject or fortran:
        raise ValueError(f"an array has the unexpected type {dtype}")
    values = member[stream.tell() :]
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != len(values):
        raise ValueError(f"an array of shape {shape} has {len(values)} bytes")
    return np.ndarray(shape, dtype, buffer=values).copy()
