"""Planner: multi-robot association-path planning (MAPP) with proven bounds."""
