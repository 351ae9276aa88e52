"""The kinds of numbers and names that worlds hold, with the limits that catch wrong units."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

MAX_POSITIONS = 1_000_000

Length = Annotated[float, Field(gt=0, le=5000)]
Height = Annotated[float, Field(ge=0, le=200)]
Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]
Metres2 = tuple[Coordinate, Coordinate]
Metres3 = tuple[Coordinate, Coordinate, Height]
Decibels = Annotated[float, Field(ge=-1000, le=1000)]
Speed = Annotated[float, Field(ge=0.01, le=50)]
Count = Annotated[int, Field(ge=1, le=MAX_POSITIONS)]
Load = Annotated[int, Field(ge=0, le=1_000_000)]
Cost = Annotated[int, Field(ge=0, le=1_000_000_000)]
Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[^\x00-\x1f\x7f]+$")]
Id = Annotated[str, Field(min_length=1, max_length=256, pattern=r"^[^\x00-\x1f\x7f]+$")]
"""An id that another tool gave: longer than the names people make up."""
Seed = Annotated[int, Field(ge=0, lt=2**63)]
