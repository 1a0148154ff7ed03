"""What Sun and camera see of large shapes, as triangles: found at a node of both, and drawn in all frames near it.

It changes little while they hardly move about the body, as its shadow map does.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from glrender_camera import PinholeCamera, threads

from . import coverage, facet_loops
from .facet_tables import FacetTables
from .kept_nodes import phase_gain
from .view import BodyView

# Triangles in a turn of each of the two images that are made at once; so few that waking a thread takes longer.
_BLOCK, _FEW = 1 << 12, 1 << 14
# And that a thread lights.
_AT_ONCE = 1 << 15
# Cosine beyond the terminator at which no light is left: relief has some on it.
_BEYOND = 0.02


class LitTriangles:
    """Facets of one body that Sun and camera see from a node, and parts of facets.

    Parameters
    ----------
    points_m : (3, P) float64 [m]
    corners : (3, N) int
        Of the triangles, among the points.
    facet : (N,) int
        That each is, or is a part of.
    radiance : (N,) float64
        At the node.
    facets : FacetTables
    node : BodyView
    edges : (4,) float64, optional
        Of whole facets: `facet_loops.lit_edges` for a focal length of 1 px.

    Attributes
    ----------
    facet, edges
    n_bytes : int
    """

    def __init__(self, points_m: np.ndarray, corners: np.ndarray, facet: np.ndarray, radiance: np.ndarray,
                 facets: FacetTables, node: BodyView, edges: np.ndarray | None = None):
        self.facet, self._surface, self._node, self.edges = facet, facets.surface, node, edges
        # Good to 6e-8 of the largest distance from the body's origin: 1e-4 px of one of 2000 px about it.
        self._corners_m = np.empty((9, len(facet)), np.float32)
        self._in_turns(lambda part: [np.copyto(self._corners_m[3 * k:3 * k + 3, part],
                                               points_m.take(corners[k, part], axis=1)) for k in range(3)])
        self._slopes = np.empty((len(facet), 4), np.float32)
        self._in_turns(lambda part: facet_loops.slopes(
            facets.normal, facet, radiance, part.start, part.stop, node.sun_direction_body, _BEYOND, self._slopes))
        self.n_bytes = sum(each.nbytes for each in (self._corners_m, facet, self._slopes))

    def radiance(self, view: BodyView, brightness: float) -> np.ndarray:
        """Radiance (N,) from near the node, of the incidence and the phase angle there.

        Parameters
        ----------
        view : BodyView
        brightness : float
            Over that at the node.
        """
        found = np.empty(len(self.facet))
        gain = brightness * phase_gain(self._surface, view, self._node)
        self._in_turns(lambda part: facet_loops.relit(self._slopes, part.start, part.stop, view.sun_direction_body,
                                                      gain, _BEYOND, found))
        return found

    def add_to(self, view: BodyView, camera: PinholeCamera, brightness: float, changes: np.ndarray,
               origin_px: np.ndarray, per_px: np.ndarray, _off_axis_power: float = 0.0) -> None:
        """Add what the areas change in the cells of an image, as `SunlitAreas.add_to` does without a power.

        Parameters
        ----------
        view : BodyView
        camera : PinholeCamera
        brightness : float
            As `radiance` takes them.
        changes : (rows, columns + 2) complex128
        origin_px : (2,) float64 [px]
        per_px : (2,) float64 [1/px]
        """
        radiance, shift_m = self.radiance(view, brightness), -view.camera_from_body @ view.r_camera_body_m
        middle_px = np.array(camera.principal_point_px, float)
        in_two_images(changes, len(radiance), lambda image, *turn: coverage.add_seen(
            image, self._corners_m, radiance, *turn, view.camera_from_body, shift_m, camera.focal_length_px, middle_px,
            origin_px, per_px))

    def _in_turns(self, task: Callable[[slice], None]) -> None:
        threads.run_in_parts(task, len(self.facet), _AT_ONCE)


def add_small(changes: np.ndarray, xy: np.ndarray, corners: np.ndarray, radiance: np.ndarray, origin_px: np.ndarray,
              per_px: np.ndarray) -> None:
    """`coverage.add_small` of all triangles, by two threads."""
    in_two_images(changes, len(radiance), lambda image, *turn: coverage.add_small(
        image, xy, corners, radiance, *turn, origin_px, per_px))


def in_two_images(changes: np.ndarray, n_triangles: int, add: Callable[[np.ndarray, int, int, int], None]) -> None:
    """Add triangles by two threads, few by one: to two images, whatever the number of threads, for the same bytes.

    Each turn is of a block from a first one on, and others so many apart: `add` has the image and the three numbers.
    """
    images = [changes, np.zeros_like(changes)]
    threads.run(lambda k: add(images[k], k * _BLOCK, _BLOCK, len(images) * _BLOCK), range(len(images)),
                threads.N_CORES if n_triangles > _FEW else 1)
    changes += images[1]
