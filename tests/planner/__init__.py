"""Tests of the planner: problem and plan files, checker, solver."""
