"""A body's surface in float64: normals, albedo and BRDF at points of its facets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np

from ..brdf.geometry import dot
from .body import Body, albedo_name

# A law is worked out at this many factors on its albedo and interpolated between: to 1e-4.
_ALBEDO_NODES = 33


class Surface:
    """Normals, albedo and BRDF of a body at points of its facets.

    Parameters
    ----------
    body : Body

    Attributes
    ----------
    body : Body
        As it was given; of materials that all look alike the one part, which has a law.
    """

    def __init__(self, body: Body):
        self.body = body.parts[0] if len(body.parts) == 1 else body

    @property
    def is_even(self) -> bool:
        """Whether a facet in sunlight is as bright all over, where no surface detail is drawn."""
        return not self.n_uneven

    @property
    def n_uneven(self) -> int:
        """Facets that are not, by a map or smooth normals."""
        return sum(len(part.shape.facets) for part in self.body.parts
                   if part.smooth_normals or part.albedo_map is not None)

    @cached_property
    def _places(self) -> np.ndarray:
        """Which of the body's parts each facet is in, and its number there: (2, F) int."""
        places = np.zeros((2, len(self.body.shape.facets)), np.intp)
        for k, facets in enumerate(self.body.part_facets):
            places[:, facets] = np.full(len(facets), k), np.arange(len(facets))
        return places

    def _by_parts(self, facet: np.ndarray, value_of: Callable[[Surface, np.ndarray, np.ndarray], np.ndarray]
                  ) -> np.ndarray:
        """Values (N,) at facets (N,) by each part's surface, its facets' numbers (K,), and which (K,) of the N."""
        part, number = self._places.take(facet, axis=1)
        value = np.zeros(len(facet))
        for k, each in enumerate(self.body.parts):
            if len(some := np.flatnonzero(part == k)):
                value[some] = value_of(Surface(each), number.take(some), some)
        return value

    @cached_property
    def _facets(self) -> np.ndarray:
        return np.ascontiguousarray(self.body.drawn_shape.facets.T, np.intp)

    @cached_property
    def _vertices_m(self) -> np.ndarray:
        return np.ascontiguousarray(self.body.drawn_shape.vertices_m.T)

    @cached_property
    def _vertex_normals(self) -> np.ndarray:
        return np.ascontiguousarray(self.body.drawn_shape.vertex_normals.T)

    def weights(self, facet: np.ndarray, r_m: np.ndarray) -> np.ndarray:
        """Barycentric weights (N, 3) of points (N, 3) [m] in facets (N,)."""
        a, b, c = (self._vertices_m.take(vertex, axis=1).T for vertex in self._facets.take(facet, axis=1))
        u, v, w = b - a, c - a, r_m - a
        uu, uv, vv, wu, wv = dot(u, u), dot(u, v), dot(v, v), dot(w, u), dot(w, v)
        determinant = uu * vv - uv * uv
        second, third = (vv * wu - uv * wv) / determinant, (uu * wv - uv * wu) / determinant
        return np.clip([1.0 - second - third, second, third], 0.0, 1.0).T

    def normals(self, facet: np.ndarray, weights: np.ndarray | None = None,
                to_camera: np.ndarray | None = None) -> np.ndarray:
        """Unit normals (N, 3) that shade points: the facet's, or on a smooth body the vertices' between.

        Parameters
        ----------
        facet : (N,) int
        weights : (N, 3) float64, optional
            The facet's middle by default.
        to_camera : (N, 3) float64, optional
            A smooth normal that turns away from it is turned back, as in `surface.glsl`.
        """
        if not self.body.smooth_normals:
            return self.body.drawn_shape.facet_normals[facet]
        a, b, c = (self._vertex_normals.take(vertex, axis=1) for vertex in self._facets.take(facet, axis=1))
        p, q, r = (1.0, 1.0, 1.0) if weights is None else weights.T
        normal = (p * a + q * b + r * c).T
        normal /= np.sqrt(dot(normal, normal))[:, None]
        if to_camera is not None:
            excess = np.maximum(1e-3 - dot(normal, to_camera), 0.0)
            normal += excess[:, None] * to_camera
            normal /= np.sqrt(dot(normal, normal))[:, None]
        return normal

    def albedo_scale(self, facet: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
        """Factor (N,) of the texture on the law's albedo, bilinear; 1 without a texture."""
        texture = self.body.albedo_map
        if len(self.body.parts) > 1:
            return self._by_parts(facet, lambda part, number, some: part.albedo_scale(
                number, None if weights is None else weights[some]))
        if texture is None:
            return np.ones(len(facet))
        weights = np.full((len(facet), 3), 1.0 / 3.0) if weights is None else weights
        uv = np.einsum("ij,ijk->ik", weights, self.body.drawn_shape.uv[facet].astype(np.float64))
        height, width = texture.shape
        x, y = uv[:, 0] * width - 0.5, np.clip((1.0 - uv[:, 1]) * height - 0.5, 0.0, height - 1.0)
        left, top = np.floor(x).astype(int), np.floor(y).astype(int)
        below = np.minimum(top + 1, height - 1)
        along, down = x - left, y - top
        row = lambda k: (1.0 - along) * texture[k, left % width] + along * texture[k, (left + 1) % width]  # noqa: E731
        return (1.0 - down) * row(top) + down * row(below)

    def brdf(self, to_sun: np.ndarray, to_camera: np.ndarray, normal: np.ndarray, albedo_scale: np.ndarray,
             facet: np.ndarray | None = None) -> np.ndarray:
        """BRDF (N,) [1/sr] with the law's albedo scaled and held within 0..1; of a body of materials by facets (N,)."""
        law = self.body.brdf
        if law is None:
            return self._by_parts(facet, lambda part, _, some: part.brdf(
                *(each[some] for each in (np.broadcast_to(to_sun, normal.shape), to_camera, normal, albedo_scale))))
        if self.body.albedo_map is None:
            return law.brdf(to_sun, to_camera, normal)
        name = albedo_name(law)
        if name is None:
            return law.brdf(to_sun, to_camera, normal) * albedo_scale
        albedo = np.clip(getattr(law, name) * albedo_scale, 0.0, 1.0)
        place = albedo * (_ALBEDO_NODES - 1)
        node = np.minimum(place.astype(int), _ALBEDO_NODES - 2)
        to_sun, to_camera = (np.broadcast_to(each, normal.shape) for each in (to_sun, to_camera))
        value = np.zeros(len(normal))
        for k in np.unique(node):
            here = np.flatnonzero(node == k)
            low, high = (replace(law, **{name: (k + step) / (_ALBEDO_NODES - 1)}).brdf(
                to_sun[here], to_camera[here], normal[here]) for step in (0, 1))
            value[here] = low + (place[here] - k) * (high - low)
        return value
