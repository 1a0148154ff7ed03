"""Errors, constants, rotations, disk cache, Numba set-up: what every room may use."""
