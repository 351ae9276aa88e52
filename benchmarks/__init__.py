"""Benchmarks of the planner: a registry of instances and phases, JSON results, comparisons."""
