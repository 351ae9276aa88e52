"""Named random streams: nobody's draws shift when somebody else is added."""

from __future__ import annotations

from zlib import crc32

import numpy as np


def stream(seed: int, name: str, entity: str = "") -> np.random.Generator:
    """The random numbers of one entity for one purpose.

    Args:
        seed: from the world.
        name: of the purpose, such as "robots".
        entity: id of whom the draws are for; empty when they are for the world as a whole.
    """
    return np.random.default_rng([seed, crc32(name.encode()), crc32(entity.encode())])
