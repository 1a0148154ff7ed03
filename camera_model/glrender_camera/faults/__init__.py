"""Faults of a camera and of its link, by name and seed: lost, stuck, dirty or blinded; none unless asked for."""
