"""A picture of a deviation: the model shaded and coloured from four sides, and the histogram of its distances."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from glrender import ConfigError
from glrender_photogrammetry import Deviation, Mesh
from scipy.spatial.transform import Rotation

_SIDE_PX = 420
_HEIGHT_PX = 180
_TURNS_DEG = (0.0, 90.0, 180.0, 270.0)
_ELEVATION_DEG = 20.0
_GROUND = 24
# Direction of the light as the eye sees it: from the upper left.
_LIGHT = np.array([-0.4, 0.5, 0.77])
_N_BINS = 121


def write_picture(path: str | Path, found: Deviation, title: str = "") -> None:
    """Write a deviation as a PNG or JPEG: shaded above, coloured below (blue inside of the truth, red outside).

    Raises
    ------
    ConfigError
        A path of another ending, or one that cannot be written.
    """
    full_m = max(float(np.quantile(np.abs(found.per_vertex_m), 0.99)), 1e-12)
    rows = []
    for is_coloured in (False, True):
        sides = [_view(found.mesh, turn_deg, found.per_vertex_m / full_m if is_coloured else None)
                 for turn_deg in _TURNS_DEG]
        rows.append(np.hstack(sides))
    sheet = np.vstack([*rows, _histogram(found, full_m, len(_TURNS_DEG) * _SIDE_PX, title)])
    if Path(path).suffix.lower() not in (".png", ".jpg", ".jpeg") or not cv2.imwrite(str(path), sheet):
        raise ConfigError("--picture", "must be a file .png or .jpg", str(path))


def _view(mesh: Mesh, turn_deg: float, share: np.ndarray | None) -> np.ndarray:
    """(side, side, 3) uint8, blue first, seen from afar with the light next to the eye."""
    turned = Rotation.from_euler("zx", [turn_deg, _ELEVATION_DEG - 90.0], degrees=True)
    at = turned.apply(mesh.corners_m.reshape(-1, 3))
    low, high = at.min(axis=0), at.max(axis=0)
    x, y = np.meshgrid(*2 * [(np.arange(_SIDE_PX) - (_SIDE_PX - 1) / 2.0) / (0.92 * _SIDE_PX)])
    middle, size = (low + high) / 2.0, (high - low)[:2].max()
    eyes = np.stack([middle[0] + size * x.ravel(), middle[1] - size * y.ravel(),
                     np.full(x.size, high[2] + 0.1 * size)], axis=1)
    down = turned.inv().apply(np.tile([0.0, 0.0, -1.0], (len(eyes), 1)))
    front = mesh.rays.intersects_first(turned.inv().apply(eyes), down).reshape(x.shape)
    light = np.abs(turned.apply(mesh.facet_normals) @ _LIGHT) ** 0.8
    colour = np.full((len(mesh.facets), 3), 235.0)
    if share is not None:
        colour, light = _diverging(share[mesh.facets].mean(axis=1)), 0.45 + 0.55 * light
    picture = np.full((_SIDE_PX, _SIDE_PX, 3), _GROUND, np.uint8)
    on = front >= 0
    picture[on] = np.clip(colour[front[on]] * light[front[on], None], 0.0, 255.0)
    return picture


def _diverging(share: np.ndarray) -> np.ndarray:
    """(N, 3) blue, green, red from -1 (blue) over 0 (white) to 1 (red)."""
    share = np.clip(share, -1.0, 1.0)[:, None]
    ends = np.where(share < 0.0, (172.0, 102.0, 33.0), (43.0, 24.0, 178.0))
    return 245.0 + np.abs(share) * (ends - 245.0)


def _histogram(found: Deviation, full_m: float, width_px: int, title: str) -> np.ndarray:
    strip = np.full((_HEIGHT_PX, width_px, 3), 255, np.uint8)
    count, edges = np.histogram(found.per_vertex_m, bins=_N_BINS, range=(-full_m, full_m))
    wide, foot = width_px // 2 // _N_BINS, _HEIGHT_PX - 30
    colour = _diverging((edges[1:] + edges[:-1]) / 2.0 / full_m) * 0.85
    for k, high in enumerate((count / max(count.max(), 1) * (foot - 10)).astype(int).tolist()):
        cv2.rectangle(strip, (20 + k * wide, foot - high), (20 + (k + 1) * wide - 1, foot), colour[k].tolist(), -1)
    ends = [(20, f"{-full_m:.3g} m"), (20 + _N_BINS * wide // 2, "0"), (_N_BINS * wide - 50, f"{full_m:.3g} m")]
    lines = [title, f"mean {found.mean_m:.3g}  sigma {found.sigma_m:.3g}  MAD {found.mad_m:.3g} m",
             f"95 % within {found.p95_m:.3g} m, largest {found.max_m:.3g} m"]
    if found.complete_1px is not None and found.complete_2px is not None:
        lines.append(f"complete: {100 * found.complete_1px:.1f} % within 1 px, {100 * found.complete_2px:.1f} % in 2")
    places = [*((x, foot + 20, text) for x, text in ends),
              *((width_px // 2 + 60, 40 + 32 * k, text) for k, text in enumerate(lines))]
    for x, y, text in places:
        cv2.putText(strip, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (40, 40, 40), 1, cv2.LINE_AA)
    return strip
