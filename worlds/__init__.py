"""Worlds: the hall, its obstacles, access points and robots, and the radio map they make."""
