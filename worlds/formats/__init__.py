"""Formats of other tools, one file per format."""

PASSABLE = ".GS"
"""Symbols of a MovingAI map that a robot may stand on: ground (two symbols) and swamp."""
