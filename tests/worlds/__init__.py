"""Tests of worlds, floors and radio maps."""
