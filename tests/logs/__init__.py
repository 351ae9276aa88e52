"""Tests of run logs: records, MCAP files, validation."""
