"""Irradiance from a plan."""
