"""Slow reference solvers and instance generators that the tests compare against."""
