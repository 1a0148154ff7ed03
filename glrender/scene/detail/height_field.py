"""The height function of a body's surface detail, in float64: what `shaders/relief.glsl` computes in float32.

h(r) is a sum of layers, each on a lattice of cubes in the body's frame, turned by the seed. It is defined in space and
read where the surface is, so it has no seams and no poles, and asks for no texture coordinates:

* noise: a random number at each corner, quintic between corners, so that slope and curvature are continuous;
* craters and boulders: in some cubes a sphere of influence that stays within its cube, so that a point has to look
  at its own cube only. A surface that cuts it off the middle has a smaller, shallower one.

A layer whose scale is below two footprints of a pixel is left out, up to four it fades in: finer is not resolved,
and would alias. So the function depends on the footprint, and on nothing else of the view.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...base.errors import ConfigError
from .config import Detail
from .layers import layers_of, product

MAX_LAYERS = 64
"""Most layers of a body: the shader has room for no more."""
TEXELS_PER_LAYER = 5
"""vec4s of a layer in `Relief.uniforms`."""
# Footprints of a pixel: below the first a scale is left out, from the second on it is whole.
FADE = (2.0, 4.0)
STEPS, LEAST_COSINE, LEAST_RISE = 2, 0.2, 0.125
"""Towards the point of the ground that a line of sight meets; the least cosine of emission that it is moved by; and
the least rise, in footprints, that moves it."""
# Numbers of cubes are float32 in the shader, exact to 2^24.
_MOST_CELLS = 2.0**22
# Arrays that a cache holds.
_POINTS_AT_ONCE = 8192


class Relief:
    """The surface detail of a body of a given shape.

    Parameters
    ----------
    detail : Detail
    facet_m : float [m]
        Side of the shape's facets: a pixel that sees more than one sees the shape, not the detail.
    radius_m : float [m]
        Distance of the vertex farthest from the body's origin.

    Raises
    ------
    ConfigError
        More than MAX_LAYERS, or sizes that are too small for the body.
    """

    def __init__(self, detail: Detail, facet_m: float, radius_m: float):
        self.facet_m = float(facet_m)
        self.layers = layers_of(detail)
        if len(self.layers) > MAX_LAYERS:
            raise ConfigError("", f"must have at most {MAX_LAYERS} layers", len(self.layers),
                              "fewer octaves of sizes, or less coverage: of craters 6 % of an octave is a layer")
        self._slopes = np.array([layer.slope_rms for layer in self.layers])
        finest_m = min(layer.cell_m for layer in self.layers)
        if radius_m > _MOST_CELLS * finest_m:
            raise ConfigError("", f"must have no lattice finer than the radius / 2^22, {radius_m / _MOST_CELLS:g} m",
                              finest_m)

    @property
    def bound_m(self) -> float:
        """Upper bound of |h| [m]."""
        return sum(layer.bound_m for layer in self.layers)

    def scales_m(self) -> np.ndarray:
        """Length [m] that a pixel must resolve of each layer (L,): never more than two facets."""
        return np.minimum([layer.scale_m for layer in self.layers], FADE[0] * self.facet_m)

    def active(self, footprint_m: float) -> list[int]:
        """The layers that a pixel of this footprint resolves."""
        return [k for k, scale in enumerate(self.scales_m()) if scale > FADE[0] * footprint_m]

    def slope_rms(self, footprint_m: float) -> float:
        """RMS slope [1] of the ground that pixels of a footprint resolve."""
        return float(np.linalg.norm(self._weights(footprint_m) * self._slopes))

    def _weights(self, footprint_m: float) -> np.ndarray:
        return _smoothstep(*FADE, self.scales_m() / footprint_m)

    def __call__(self, r_body_m: np.ndarray, footprint_m: np.ndarray | float,
                 least_m: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Height (N,) [m] and its gradient (N, 3) [1] at points (N, 3) [m] of the body's surface.

        Parameters
        ----------
        footprint_m : (N,) float [m]
            Footprint of a pixel there.
        least_m : (N,) float [m]
            Layers that rise less are left out, up to twice as much they fade in.
        """
        r_body_m = np.asarray(r_body_m, np.float64)
        footprint, least = (np.broadcast_to(value, len(r_body_m)) for value in (footprint_m, least_m))
        height, gradient = np.zeros(len(r_body_m)), np.zeros((len(r_body_m), 3))
        scales = self.scales_m()
        for start in range(0, len(r_body_m), _POINTS_AT_ONCE):
            part = slice(start, start + _POINTS_AT_ONCE)
            r = list(np.ascontiguousarray(r_body_m[part].T))
            for layer, scale in zip(self.layers, scales, strict=True):
                weight = layer.size * _smoothstep(*FADE, scale / footprint[part])
                if least[part].any():
                    weight *= _smoothstep(1.0, 2.0, layer.bound_m / np.maximum(least[part], 1e-300))
                if weight.any():
                    value, slope = layer(r)
                    height[part] += weight * value
                    gradient[part] += (weight * slope).T
        return height, gradient

    def normals(self, normal: np.ndarray, r_body_m: np.ndarray, footprint_m: np.ndarray,
                to_camera: np.ndarray) -> np.ndarray:
        """Unit normals (N, 3) of the ground that a camera sees where it looks at points (N, 3) [m] of facets.

        The line of sight meets the ground where it rises near that point: found in STEPS steps, exact where slopes
        are less than the line's. There the facet's normal (N, 3) is tilted by the slope, and turned back where it would
        face away from the camera (N, 3).

        Twin: shaders/relief.glsl.
        """
        cosine = np.einsum("ij,ij->i", normal, to_camera)[:, None]
        per_height = (to_camera - cosine * normal) / np.maximum(cosine, LEAST_COSINE)
        r = r_body_m
        for _ in range(STEPS):
            r = r_body_m + per_height * self(r, footprint_m, LEAST_RISE * footprint_m)[0][:, None]
        slope = self(r, footprint_m)[1]
        slope -= np.einsum("ij,ij->i", slope, normal)[:, None] * normal
        tilted = normal - slope
        tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
        excess = np.maximum(1e-3 - np.einsum("ij,ij->i", tilted, to_camera), 0.0)
        tilted += excess[:, None] * to_camera
        return tilted / np.linalg.norm(tilted, axis=1, keepdims=True)

    def uniforms(self, r_origin_body_m: np.ndarray, footprint_m: float) -> dict[str, Any]:
        """Uniforms of the shader: layers, their number by kind, and the number of those that move the visible point.

        Parameters
        ----------
        r_origin_body_m : (3,) float64 [m]
            Of the shader's coordinates: lattices are moved there in float64, so that float32 does from near
            what it does from afar.
        footprint_m : float [m]
            Least of the pixels.
        """
        table, counts, high = np.zeros((TEXELS_PER_LAYER * MAX_LAYERS, 4)), [0, 0, 0], [0, 0, 0]
        scales = self.scales_m()
        for row, k in enumerate(self.active(footprint_m)):
            layer = self.layers[k]
            counts[layer.kind] += 1
            high[layer.kind] += layer.bound_m > LEAST_RISE * footprint_m
            place = np.array(product(layer.lattice_from_body, list(r_origin_body_m)))
            cell = np.floor(place)
            start = TEXELS_PER_LAYER * row
            table[start:start + 3, :3], table[start:start + 3, 3] = layer.lattice_from_body, place - cell
            table[start + 3] = *cell, layer.seed
            table[start + 4] = layer.size, scales[k], layer.share, layer.radius
        kinds = ("noise", "craters", "boulders")
        return {"relief_layers": table, **{f"relief_{kind}": n for kind, n in zip(kinds, counts, strict=True)},
                **{f"high_{kind}": n for kind, n in zip(kinds, high, strict=True)}}


def _smoothstep(low: float, high: float, x: np.ndarray) -> np.ndarray:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)
