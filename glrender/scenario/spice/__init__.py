"""Positions, attitudes and cameras of NAIF's kernels (extra `spice`), on the caller's side alone."""
