"""Geometry of one epoch: where Sun, camera and bodies are, which overlap in the image, and which may shade which."""
