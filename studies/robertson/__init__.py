"""Reproduction of R: the Mission Mode loop simulated through the flight's first five months, and the flight's values."""
