"""Tests of the discrete-event execution of plans."""
