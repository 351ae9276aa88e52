"""Logs: records of a run, their MCAP file, its validation and the pictures drawn from it."""
