"""Derivatives of frames of exact areas, with respect to poses, the Sun, the focal length and laws."""
