"""Photogrammetry of small bodies: a surface from the frames of a sequence, and its deviation from the true one. ::

    from glrender_photogrammetry import deviation, posed_frames, reconstruct
    model = reconstruct(posed_frames("out/flyby"), body="67p", poses="known")
    deviation(model.shape, truth, px_m=5.7, align="similarity").sigma_m

It reads files and arrays, by OpenCV, SciPy and pycolmap (extra `reconstruction`), and knows nothing of the renderer.
"""

from .deviation import Deviation, deviation
from .frames import PosedFrame, posed_frames
from .mesh import Mesh
from .reconstruction import Reconstruction, reconstruct
from .texture import textured, vertex_brightness

__all__ = ["Deviation", "Mesh", "PosedFrame", "Reconstruction", "deviation", "posed_frames", "reconstruct",
           "textured", "vertex_brightness"]
