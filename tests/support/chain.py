"""Cameras, lenses and scene tables for tests of the chain from a state to a frame."""

from __future__ import annotations

import cv2
import numpy as np
from glrender_camera import BrownConrady, Detector, MosaicModel, Optics

LENS = BrownConrady(k1=-0.25, k2=0.08, p1=0.002, p2=-0.001)
DETECTOR = Detector(quantum_efficiency=0.5, full_well_electrons=1e9, gain_DN_per_electron=1e-5, bit_depth=16)
MOSAIC = MosaicModel(
    optics={letter: Optics(aperture_diameter_m=0.01, band_nm=band, transmission=t)
            for letter, band, t in (("R", (600.0, 700.0), 0.8), ("G", (500.0, 600.0), 0.9),
                                    ("B", (400.0, 500.0), 0.7))},
    detector=DETECTOR, exposure_s=1e-3)
BODIES = [{"name": "b", "generated": {"kind": "icosphere", "radius_m": 1.0, "subdivisions": 1},
           "brdf": {"law": "lambert", "normal_albedo": 0.1}}]
OPTICS = {"aperture_diameter_m": 0.01}
READ = {"quantum_efficiency": 0.5, "full_well_electrons": 1e4, "gain_DN_per_electron": 0.1, "bit_depth": 12}
COLOURS = {"pattern": ["RG", "GB"], "optics": {"R": OPTICS, "G": OPTICS, "B": OPTICS}, "detector": READ,
           "exposure_s": 0.1}


def opencv(camera, points):
    """Pixels (N, 2) of points (N, 3) in `camera`, by another program."""
    d, (cx, cy), f = camera.distortion, camera.principal_point_px, camera.focal_length_px
    matrix = np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]])
    coefficients = np.array([d.k1, d.k2, d.p1, d.p2, d.k3, d.k4, d.k5, d.k6])
    return cv2.projectPoints(np.asarray(points, float), np.zeros(3), np.zeros(3), matrix, coefficients)[0][:, 0]


def table(camera=(), **fields):
    return {"bodies": BODIES, "cameras": [{"name": "c", "width_px": 64, "height_px": 48, "focal_length_px": 60.0,
                                           **dict(camera)}], **fields}
