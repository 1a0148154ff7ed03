"""Features that a frame and a believed frame share: their places on the body, their errors, and what moves them."""

from __future__ import annotations

import cv2
import numpy as np

ALIKE = 2.0
"""Windows of features overlap, and errors of neighbours are alike: factor of their variance."""


def places_at(r_body_m: np.ndarray, points_px: np.ndarray) -> np.ndarray:
    """Places (N, 3) [m] on the body, between pixel centres; NaN at outlines, also between near and far ground."""
    at = points_px.astype(np.float32)[:, None]
    places = cv2.remap(np.ascontiguousarray(r_body_m, np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR,
                       borderMode=cv2.BORDER_CONSTANT, borderValue=(np.nan,) * 3)[:, 0]
    return places.astype(np.float64)


def variance(left_px: np.ndarray) -> float:
    """Variance [px2] of residuals, without their outliers."""
    return float((1.4826 * np.median(np.abs(left_px)))**2) + 0.05**2


def jacobian(focal_length_px: float, places_m: np.ndarray, r_m: np.ndarray) -> np.ndarray:
    """Derivatives (2 N, 6) [px/rad, px/m] of landmarks' (N, 3) pixels by a turn of the body and its place."""
    x, y, z = (places_m + r_m).T
    zero = np.zeros_like(x)
    by_place = focal_length_px * np.stack([np.column_stack([1.0 / z, zero, -x / z**2]),
                                           np.column_stack([zero, 1.0 / z, -y / z**2])], axis=1)
    # A turn t moves a landmark by t x p.
    by_turn = np.cross(places_m[:, None], by_place)
    return np.concatenate([by_turn, by_place], axis=2).reshape(-1, 6)
