"""Distances of an image from the truth, in the words that a navigation engineer uses."""

from __future__ import annotations

import cv2
import numpy as np

from .truth import Truth


def errors(irradiance: np.ndarray, truth: Truth, products: dict[str, np.ndarray] | None = None) -> dict[str, float]:
    """Errors of an image (H, W) [W/m2].

    Returns
    -------
    dict
        rms : RMS irradiance error over the mean of the lit pixels, the planner's measure [1];
        flux : relative error of the total [1];
        centroid_px : distance of the centres of brightness;
        limb_px, limb_bias_px : RMS over the pixels of the lit limb, and their mean, of how far the limb would
        have to move to explain the pixel (outward is positive);
        shadow : share of sun-facing pixels whose centre is lit in one and in shadow in the other [1],
        only with `products` (facet_id, sunlit).
    """
    image, exact = np.asarray(irradiance, np.float64), truth.irradiance_W_m2
    lit = exact > 0.0
    level = exact[lit].mean()
    limb = limb_offsets_px(image, truth)
    found = {
        "rms": float(np.sqrt(np.mean((image - exact)[lit | (image > 0.0)] ** 2)) / level),
        "flux": float(image.sum() / exact.sum() - 1.0),
        "centroid_px": float(np.linalg.norm(centroid_px(image) - centroid_px(exact))),
        "limb_px": float(np.sqrt(np.mean(limb**2))) if len(limb) else float("nan"),
        "limb_bias_px": float(limb.mean()) if len(limb) else float("nan"),
        "shadow": float("nan"),
    }
    if products is not None:
        same = (products["facet_id"] == truth.products["facet_id"]) & (truth.products["facet_id"] >= 0)
        facing = same & (truth.products["incidence"] < 0.5 * np.pi)
        if facing.any():
            found["shadow"] = float((products["sunlit"] != truth.products["sunlit"])[facing].mean())
    return found


def centroid_px(image: np.ndarray) -> np.ndarray:
    """(x, y) centre of brightness [px]; NaN of a dark image."""
    total = image.sum()
    if not total > 0.0:
        return np.full(2, np.nan)
    return np.array([image.sum(axis=0) @ np.arange(image.shape[1]), image.sum(axis=1) @ np.arange(image.shape[0])]
                    ) / total


def limb_offsets_px(image: np.ndarray, truth: Truth) -> np.ndarray:
    """Displacement of the lit limb at each of its pixels: excess over the brightness just inside.

    A pixel across which the limb runs holds the share of the inner brightness that the limb leaves it.
    """
    body = (truth.products["body_id"] >= 0).astype(np.uint8)
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    edge = cv2.dilate(body, cross) - cv2.erode(body, cross, borderValue=1)
    exact = truth.irradiance_W_m2
    inside = np.where(cv2.erode(body, cross, borderValue=1) > 0, exact, 0.0)
    inner = cv2.dilate(inside, np.ones((3, 3), np.uint8))
    lit = (edge > 0) & (inner > 0.3 * exact[exact > 0.0].mean()) if (exact > 0.0).any() else edge > 1
    return (image - exact)[lit] / inner[lit]
