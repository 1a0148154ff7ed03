"""The height function of a body's surface detail, in float64: what `shaders/relief.glsl` computes in float32.

h(r) is a sum of layers, each on a lattice of cubes in the body's frame, turned by the seed. It is defined in space and
read where the surface is, so it has no seams and no poles, and asks for no texture coordinates:

* noise: a random number at each corner, quintic between corners, so that slope and curvature are continuous;
* craters and boulders: in some cubes a sphere of influence that stays within its cube, so that a point has to look
  at its own cube only. A surface that cuts it beside the middle has a smaller, shallower one.

A layer whose scale is below two footprints of a pixel is left out, up to four it fades in: finer is not resolved,
and would alias. So the function depends on the footprint, and on nothing else of the view.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .detail import Detail
from .errors import ConfigError

MAX_LAYERS = 64
"""Of a body: what the shader has room for."""
TEXELS_PER_LAYER = 5
"""vec4s of a layer in `Relief.uniforms`."""
# Footprints of a pixel: below the first a scale is left out, from the second on it is whole.
FADE = (2.0, 4.0)
NOISE, CRATER, BOULDER = range(3)
STEPS, LEAST_COSINE, LEAST_RISE = 2, 0.2, 0.125
"""Towards the point of the ground that a line of sight meets; the least cosine of emission that it is moved by; and
the least rise, in footprints, that moves it."""
# Radii of rims that a crater's ejecta reach; height of a rim over the crater's radius, of its depth.
_REACH, _RIM = 1.6, 0.2
# Of a cube's side, the radius of the largest sphere of influence; the middles of smaller ones move.
_SPHERE = 0.5
# Mean cube of sizes that are even between a half and one: of features over that of the largest.
_MEAN_CUBE = 0.46875
# Numbers of cubes are float32 in the shader, exact to 2^24.
_MOST_CELLS = 2.0**22
_ONE = np.uint32(1)


def hashed(value: np.ndarray) -> np.ndarray:
    """A bijection of uint32 whose bits depend on all bits (Wellons' lowbias32)."""
    value = np.atleast_1d(np.asarray(value, np.uint32))
    value = (value ^ (value >> np.uint32(16))) * np.uint32(0x7FEB352D)
    value = (value ^ (value >> np.uint32(15))) * np.uint32(0x846CA68B)
    return value ^ (value >> np.uint32(16))


def hashed_cell(cell: np.ndarray, seed: int) -> np.ndarray:
    """uint32 (N,) of cubes (N, 3) int."""
    x, y, z = (cell[:, k].astype(np.int64).astype(np.uint32) for k in range(3))
    return hashed(np.uint32(seed) + x * np.uint32(0x8DA6B343) + y * np.uint32(0xD8163841) + z * np.uint32(0xCB1AB31F))


@dataclass(frozen=True, kw_only=True, eq=False)
class Layer:
    """One octave of one kind; float32 values, as the shader has them.

    Attributes
    ----------
    kind : int
        NOISE, CRATER or BOULDER.
    lattice_from_body : (3, 3) float64 [1/m]
        Into cubes of side 1.
    seed : int
        Below 2^24, exact in float32.
    scale_m : float [m]
        Wavelength, or least diameter: what a pixel must resolve.
    size : float
        Amplitude of noise [m]; of a crater its depth, of a boulder its height, over its radius.
    share : float [1]
        Of the cubes, those with a feature.
    radius : float [1]
        Of the largest feature, over the cube's side.
    """

    kind: int
    lattice_from_body: np.ndarray
    seed: int
    scale_m: float
    size: float
    share: float = 0.0
    radius: float = 0.0

    @property
    def bound_m(self) -> float:
        """Most that it rises or falls."""
        cell_m = 1.0 / float(np.linalg.norm(self.lattice_from_body[0]))
        return self.size * (1.0 if self.kind == NOISE else self.radius * cell_m)


class Relief:
    """The surface detail of a body of a given shape.

    Parameters
    ----------
    detail : Detail
    facet_m : float [m]
        Side of the shape's facets: a pixel that sees more than one sees the shape, not the detail.
    radius_m : float [m]
        Of the vertex farthest from the body's origin.

    Raises
    ------
    ConfigError
        More than MAX_LAYERS, or sizes that are too small for the body.
    """

    def __init__(self, detail: Detail, facet_m: float, radius_m: float):
        self.facet_m = float(facet_m)
        self.layers = _layers(detail)
        self._slopes = np.array([_rms_slope(layer) for layer in self.layers])
        finest_m = min(1.0 / np.linalg.norm(layer.lattice_from_body[0]) for layer in self.layers)
        if radius_m > _MOST_CELLS * finest_m:
            raise ConfigError("", f"must have no lattice finer than the radius / 2^22, {radius_m / _MOST_CELLS:g} m",
                              finest_m)

    @property
    def bound_m(self) -> float:
        """Most that |h| can be."""
        return sum(layer.bound_m for layer in self.layers)

    def scales_m(self) -> np.ndarray:
        """What a pixel must resolve of each layer (L,): never more than two facets."""
        return np.minimum([layer.scale_m for layer in self.layers], FADE[0] * self.facet_m)

    def active(self, footprint_m: float) -> list[int]:
        """The layers that a pixel of this footprint resolves."""
        return [k for k, scale in enumerate(self.scales_m()) if scale > FADE[0] * footprint_m]

    def slope_rms(self, footprint_m: float) -> float:
        """RMS slope [1] of what pixels of a footprint resolve."""
        return float(np.linalg.norm(self._weights(footprint_m) * self._slopes))

    def _weights(self, footprint_m: float) -> np.ndarray:
        return _smoothstep(*FADE, self.scales_m() / footprint_m)

    def __call__(self, r_body_m: np.ndarray, footprint_m: np.ndarray | float,
                 least_m: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Height (N,) [m] and its gradient (N, 3) [1] at points (N, 3) [m] of the body's surface.

        Parameters
        ----------
        footprint_m : (N,) float [m]
            Of a pixel there.
        least_m : (N,) float [m]
            Layers that rise less are left out, up to twice as much they fade in.
        """
        r, footprint = np.asarray(r_body_m, np.float64), np.broadcast_to(footprint_m, len(r_body_m))
        least = np.broadcast_to(least_m, len(r))
        height, gradient = np.zeros(len(r)), np.zeros((len(r), 3))
        for layer, scale in zip(self.layers, self.scales_m(), strict=True):
            here = np.flatnonzero((scale > FADE[0] * footprint) & (layer.bound_m > least))
            if not len(here):
                continue
            weight = layer.size * _smoothstep(*FADE, scale / footprint[here])
            if least[here].any():
                weight *= _smoothstep(1.0, 2.0, layer.bound_m / least[here])
            place = _product(layer.lattice_from_body, r[here])
            cell = np.floor(place)
            value, slope = (_noise if layer.kind == NOISE else _feature)(layer, cell, place - cell)
            height[here] += weight * value
            gradient[here] += weight[:, None] * slope
        return height, gradient

    def normals(self, normal: np.ndarray, r_body_m: np.ndarray, footprint_m: np.ndarray,
                to_camera: np.ndarray) -> np.ndarray:
        """Unit normals (N, 3) of the ground that a camera sees where it looks at points (N, 3) [m] of facets.

        The line of sight meets the ground where it rises beside that point: found in STEPS steps, exact where slopes
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
        """What the shader reads: layers, how many there are of each kind, and how many of them move what is seen.

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
            place = _product(layer.lattice_from_body, r_origin_body_m[None])[0]
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


def _layers(detail: Detail) -> tuple[Layer, ...]:
    made: list[Layer] = []

    def add(kind: int, cell_m: float, **values: float) -> None:
        seed = int(hashed((detail.seed * 0x9E3779B1 + len(made) * 0x85EBCA6B) & 0xFFFFFFFF)[0])
        rotation = _rotation(seed)
        values = {name: float(np.float32(value)) for name, value in values.items()}
        made.append(Layer(kind=kind, seed=seed >> 8, lattice_from_body=(rotation / cell_m).astype(np.float32)
                          .astype(np.float64), **values))

    if (noise := detail.noise) is not None:
        for scale in _octaves(noise.longest_m, noise.shortest_m):
            # A wave is a corner up and a corner down.
            add(NOISE, 0.5 * scale, scale_m=scale, size=noise.amplitude_m * (scale / noise.longest_m) ** noise.exponent)
    for kind, asked, reach in ((CRATER, detail.craters, _REACH), (BOULDER, detail.boulders, 1.0)):
        if asked is None or not asked.coverage:
            continue
        size = 2.0 * (asked.depth if kind == CRATER else asked.height)
        radius = _SPHERE / reach
        # What a plane cuts of spheres is their share of the volume.
        most = 4.0 / 3.0 * np.pi * radius**3 * _MEAN_CUBE
        n_lattices = int(np.ceil(asked.coverage / most))
        for diameter in _octaves(asked.largest_m, asked.smallest_m):
            for _ in range(n_lattices):
                add(kind, 0.5 * diameter / radius, scale_m=0.5 * diameter, size=size,
                    share=asked.coverage / (n_lattices * most), radius=radius)
    if len(made) > MAX_LAYERS:
        raise ConfigError("", f"must have at most {MAX_LAYERS} layers", len(made),
                          "fewer octaves of sizes, or less coverage: of craters 3 % of an octave is a layer")
    return tuple(made)


def _rms_slope(layer: Layer) -> float:
    """Along a surface: two thirds of the gradient's square, over some cubes."""
    place = np.random.default_rng(0).uniform(0.0, 64.0, (2048, 3))
    cell = np.floor(place)
    slope = (_noise if layer.kind == NOISE else _feature)(layer, cell, place - cell)[1]
    return layer.size * float(np.sqrt(2.0 / 3.0 * np.mean((slope * slope).sum(axis=1))))


def _octaves(large: float, small: float) -> list[float]:
    return [large * 0.5**k for k in range(int(np.floor(np.log2(large / small) + 1e-9)) + 1)]


def _rotation(seed: int) -> np.ndarray:
    """A rotation (3, 3) of its own for each seed; of sums, products and roots alone, which are the same everywhere."""
    q = hashed(np.uint32(seed) + np.arange(1, 5, dtype=np.uint32)).astype(np.float64) * 2.0**-31 - 1.0
    w, x, y, z = q / np.sqrt((q * q).sum())
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def _product(matrix: np.ndarray, r: np.ndarray) -> np.ndarray:
    """matrix @ r of points (N, 3), in one order of sums on all machines."""
    return np.stack([row[0] * r[:, 0] + row[1] * r[:, 1] + row[2] * r[:, 2] for row in matrix], axis=1)


def _noise(layer: Layer, cell: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Noise within -1..1 and its gradient [1/m]."""
    weight = place**3 * (place * (place * 6.0 - 15.0) + 10.0)
    rate = 30.0 * place**2 * (place - 1.0) ** 2
    value, slope = np.zeros(len(cell)), np.zeros((len(cell), 3))
    for corner in np.ndindex(2, 2, 2):
        number = (hashed_cell(cell + corner, layer.seed) >> np.uint32(8)).astype(np.float64) * 2.0**-23 - 1.0
        x, y, z = (weight[:, k] if corner[k] else 1.0 - weight[:, k] for k in range(3))
        dx, dy, dz = (rate[:, k] if corner[k] else -rate[:, k] for k in range(3))
        value += number * x * y * z
        slope += number[:, None] * np.stack([dx * y * z, x * dy * z, x * y * dz], axis=1)
    return value, _product(layer.lattice_from_body.T, slope)


def _feature(layer: Layer, cell: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A crater or boulder's height [m] and gradient [1], of a size of 1."""
    value, slope = np.zeros(len(cell)), np.zeros((len(cell), 3))
    key = hashed_cell(cell, layer.seed)
    here = np.flatnonzero((key >> np.uint32(8)).astype(np.float64) * 2.0**-24 < layer.share)
    key, place = key[here], place[here]
    own = hashed(key + _ONE)
    byte = [((own >> np.uint32(8 * k)) & np.uint32(255)).astype(np.float64) / 255.0 for k in range(4)]
    radius = layer.radius * (0.5 + 0.5 * byte[3])
    reach = radius * (_REACH if layer.kind == CRATER else 1.0)
    centre = 0.5 + (2.0 * np.stack(byte[:3], axis=1) - 1.0) * (0.5 - reach)[:, None]
    aside = (place - centre) / radius[:, None]
    t = (aside * aside).sum(axis=1)
    form, rate = (_crater if layer.kind == CRATER else _boulder)(t)
    cell_m = 1.0 / np.linalg.norm(layer.lattice_from_body[0])
    slope[here] = 2.0 * rate[:, None] * _product(layer.lattice_from_body.T, aside) * cell_m
    value[here] = form * radius * cell_m
    return value, slope


def _crater(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height over the radius, and its rate, by the square of the distance from the middle over the radius."""
    u = np.minimum(t, 1.0)
    v = np.clip((t - 1.0) / (_REACH**2 - 1.0), 0.0, 1.0)
    value = np.where(t < 1.0, (1.0 + _RIM) * u * u * (3.0 - 2.0 * u) - 1.0, _RIM * (1.0 - v * v * (3.0 - 2.0 * v)))
    rate = np.where(t < 1.0, (1.0 + _RIM) * 6.0 * u * (1.0 - u), -_RIM * 6.0 * v * (1.0 - v) / (_REACH**2 - 1.0))
    return value, rate


def _boulder(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `_crater`."""
    u = np.maximum(1.0 - t, 0.0)
    return u * u, -2.0 * u
