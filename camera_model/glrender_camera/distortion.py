"""Lens distortion after Brown and Conrady, in OpenCV's convention, with a domain and a checked inverse.

The model folds over beyond some field angle: there one image point belongs to two directions and
an iterative inverse gives a wrong one in silence. Here the radius up
to which the radial part rises is found at load, and nothing outside it is accepted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from . import lens_loops
from .errors import ConfigError
from .validate import known_keys, within

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# Where the search for a fold ends: 89.4 degrees off axis, as no rectilinear camera sees farther.
_MAX_RADIUS = 100.0
# A field of a degree has k3 of 1e8 at most; beyond, the polynomials' products overflow.
_MAX_COEFFICIENT = 1e9


@dataclass(frozen=True, kw_only=True)
class BrownConrady:
    """Radial (rational) and tangential distortion of normalised image coordinates.

    With x = X / Z, y = Y / Z in the camera frame and r^2 = x^2 + y^2,

        q  = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)
        x' = x q + 2 p1 x y + p2 (r^2 + 2 x^2)
        y' = y q + p1 (r^2 + 2 y^2) + 2 p2 x y

    Parameters
    ----------
    k1, k2, k3, k4, k5, k6, p1, p2 : float [1], -1e9..1e9
        OpenCV's names. Its coefficient vector is ordered k1, k2, p1, p2, k3, k4, k5, k6: see
        `from_opencv`.

    Raises
    ------
    ConfigError

    Source: OpenCV, camera calibration, `projectPoints`; Brown (1966), Conrady (1919).
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    def __post_init__(self):
        for f in fields(self):
            object.__setattr__(self, f.name, within(f.name, getattr(self, f.name), -_MAX_COEFFICIENT, _MAX_COEFFICIENT))

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> BrownConrady:
        """From plain data; unknown keys are refused by name."""
        if isinstance(table, Sequence) and not isinstance(table, str):
            raise ConfigError("", "must be a table", table, "OpenCV's order is k1, k2, p1, p2, k3, k4, k5, k6: "
                              "write { k1 = ..., k2 = ... }, or in Python BrownConrady.from_opencv")
        known_keys("", table, [f.name for f in fields(cls)])
        return cls(**table)

    @classmethod
    def from_opencv(cls, coefficients: ArrayLike) -> BrownConrady:
        """From OpenCV's vector of 4, 5 or 8 coefficients, k3 fifth."""
        values = np.asarray(coefficients, dtype=np.float64).ravel()
        if values.size not in (4, 5, 8):
            raise ConfigError("coefficients", "must be 4, 5 or 8 numbers", coefficients)
        names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")[:values.size]
        return cls(**dict(zip(names, values.tolist(), strict=True)))

    @property
    def is_any(self) -> bool:
        """Whether any coefficient is not zero."""
        return any(getattr(self, f.name) != 0.0 for f in fields(self))

    @property
    def text(self) -> str:
        """The distortion in words: the coefficients that are not zero."""
        return ", ".join(f"{f.name} {getattr(self, f.name):g}" for f in fields(self) if getattr(self, f.name) != 0.0)

    @cached_property
    def max_radius(self) -> float:
        """Undistorted radius r [1] below which the model does not fold over; at most 100.

        The radial part alone rises up to the first root of d(r q)/dr = 0 or of q's denominator,
        both polynomials in r^2. The tangential part folds earlier, see `_tangential_folds`.
        """
        radius = self._radial_limit
        return min([radius, *self._tangential_folds(radius)])

    def _tangential_folds(self, radius: float) -> list[float]:
        """Radii [1] below `radius` where the Jacobian's determinant first vanishes somewhere on the circle.

        With P the length of (p2, p1), a = P cos(angle to it) and Q = d(r q)/dr, the determinant is

            Q q - 4 r^2 P^2 + 2 r (Q + 3 q) a + 16 r^2 a^2.

        Its least over the circle is (Q - 6 r P)(q - 2 r P), at a = -P, or that of the parabola where its bottom is
        among the a. While q > 2 r P, circles become curves without crossings: inside the first fold no two
        places are imaged to one.
        """
        length = math.hypot(self.p1, self.p2)
        if length == 0.0:
            return []
        # In r / radius, whose roots of interest are below 1.
        r = np.polynomial.Polynomial([0.0, radius])
        top, bottom = (polynomial(r * r) for polynomial in self._polynomials)
        slope = top * bottom + r * (top.deriv() * bottom - top * bottom.deriv()) / radius
        square, ratio, shift = bottom * bottom, top * bottom, length * r
        parabola = slope * ratio - (slope + 3.0 * ratio) ** 2 / 16.0 - 4.0 * (shift * square) ** 2
        inside = 16.0 * shift * square - slope - 3.0 * ratio
        roots = np.concatenate([_real_roots(slope - 6.0 * shift * square), _real_roots(top - 2.0 * shift * bottom),
                                [root for root in _real_roots(parabola) if inside(root) >= 0.0]])
        return (radius * roots[roots < 1.0]).tolist()

    @property
    def _radial_limit(self) -> float:
        top, bottom = self._polynomials
        s = np.polynomial.Polynomial([0.0, 1.0])
        # With s = r^2: d(r n/d)/dr = (n d + 2 s (n' d - n d')) / d^2.
        slope = top * bottom + 2.0 * s * (top.deriv() * bottom - top * bottom.deriv())
        real = np.concatenate([_real_roots(slope), _real_roots(bottom)])
        return min(math.sqrt(real.min()), _MAX_RADIUS) if real.size else _MAX_RADIUS

    @property
    def _polynomials(self) -> tuple[np.polynomial.Polynomial, np.polynomial.Polynomial]:
        """Numerator and denominator of q in r^2."""
        return (np.polynomial.Polynomial([1.0, self.k1, self.k2, self.k3]),
                np.polynomial.Polynomial([1.0, self.k4, self.k5, self.k6]))

    def distort(self, xy: np.ndarray) -> np.ndarray:
        """Distorted coordinates.

        Parameters
        ----------
        xy : (..., 2) float [1]
            X / Z, Y / Z.

        Returns
        -------
        (..., 2) float64 [1]
            NaN beyond `max_radius`.
        """
        xy = np.asarray(xy, dtype=np.float64)
        inside = np.sum(xy * xy, axis=-1, keepdims=True) < self.max_radius**2
        return np.where(inside, self._map(np.where(inside, xy, 0.0))[0], np.nan)

    def jacobian(self, xy: np.ndarray) -> np.ndarray:
        """d(distorted) / d(undistorted); its determinant is the magnification of areas.

        Parameters
        ----------
        xy : (..., 2) float [1]

        Returns
        -------
        (..., 2, 2) float64 [1]
            Row: distorted x, y; column: undistorted x, y. NaN beyond `max_radius`.
        """
        xy = np.asarray(xy, dtype=np.float64)
        inside = np.sum(xy * xy, axis=-1) < self.max_radius**2
        matrix = self._map(np.where(inside[..., None], xy, 0.0))[1]
        return np.where(inside[..., None, None], matrix, np.nan)

    def undistort(self, distorted: np.ndarray) -> np.ndarray:
        """The inverse of `distort`, by Newton's method with a residual test.

        Parameters
        ----------
        distorted : (..., 2) float [1]

        Returns
        -------
        (..., 2) float64 [1]
            NaN where no point inside `max_radius` is imaged within 1e-12 of the place asked for.
        """
        target = np.asarray(distorted, dtype=np.float64)
        found = np.empty((2, target.size // 2))
        lens_loops.undistort(target.reshape(-1, 2).T, self.numbers(0.0), found)
        return np.ascontiguousarray(found.T).reshape(target.shape)

    def numbers(self, rim: float) -> np.ndarray:
        """The lens (10,) as `lens_loops` takes it, with the radius [1] beyond which its map goes on straight."""
        return np.array([self.k1, self.k2, self.k3, self.k4, self.k5, self.k6, self.p1, self.p2,
                         self.max_radius * (1.0 - 1e-9), rim])

    def require_seen(self, xy: np.ndarray) -> None:
        """Refuse a frame whose border (..., 2) [1], undistorted, is not all within `max_radius`: `require_field`."""
        # Where the edge is the image of nothing (NaN), the radius that it would need is beyond the fold.
        radius = np.hypot(xy[..., 0], xy[..., 1]).max()
        self.require_field(float(radius) if np.isfinite(radius) else math.inf)

    def require_field(self, radius: float, path: str = "distortion") -> None:
        """Refuse a field of view that the model cannot image.

        Parameters
        ----------
        radius : float [1]
            Largest undistorted radius tan(field angle) in use.

        Raises
        ------
        ConfigError
            Naming the radius beyond which the model folds over.
        """
        if not radius < self.max_radius:
            fold_deg = math.degrees(math.atan(self.max_radius))
            reached = f"the radius {radius:.6g}" if math.isfinite(radius) else "places that no direction is imaged to"
            rule = (f"the field of view reaches {reached} but the model folds over at "
                    f"{self.max_radius:.6g} ({fold_deg:.4g} deg off axis)")
            raise ConfigError(path, rule, hint="use a narrower field or other coefficients")

    def _map(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distorted coordinates and the Jacobian, wherever the formula leads."""
        x, y = xy[..., 0], xy[..., 1]
        xx, yy, xy2 = x * x, y * y, 2.0 * x * y
        rr = xx + yy
        top = 1.0 + rr * (self.k1 + rr * (self.k2 + rr * self.k3))
        bottom = 1.0 + rr * (self.k4 + rr * (self.k5 + rr * self.k6))
        d_top = self.k1 + rr * (2.0 * self.k2 + rr * 3.0 * self.k3)
        d_bottom = self.k4 + rr * (2.0 * self.k5 + rr * 3.0 * self.k6)
        # Trial points outside the domain may meet the pole; they are thrown away.
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            q = top / bottom
            dq = 2.0 * (d_top - q * d_bottom) / bottom
            place = np.stack([x * q + self.p1 * xy2 + self.p2 * (rr + 2.0 * xx),
                              y * q + self.p1 * (rr + 2.0 * yy) + self.p2 * xy2], axis=-1)
            cross = x * y * dq + 2.0 * (self.p1 * x + self.p2 * y)
            matrix = np.stack([
                np.stack([q + xx * dq + 2.0 * self.p1 * y + 6.0 * self.p2 * x, cross], axis=-1),
                np.stack([cross, q + yy * dq + 6.0 * self.p1 * y + 2.0 * self.p2 * x], axis=-1)], axis=-2)
        return place, matrix


def _real_roots(polynomial: np.polynomial.Polynomial) -> np.ndarray:
    """The positive real roots."""
    roots = polynomial.trim().roots()
    # A double root is an inflection that float64 splits into a complex pair of 1e-8.
    return roots.real[(np.abs(roots.imag) < 1e-7 * np.maximum(np.abs(roots), 1.0)) & (roots.real > 0.0)]


def frame_border(width_px: int, height_px: int, rim_px: int = 0) -> np.ndarray:
    """(N, 2) float64 [px]: places around a frame, `rim_px` beyond the centres of its outermost pixels."""
    x, y = (np.arange(-rim_px, size + rim_px, dtype=np.float64) for size in (width_px, height_px))
    return np.concatenate([np.stack(np.broadcast_arrays(x, edge), axis=-1) for edge in (y[0], y[-1])]
                          + [np.stack(np.broadcast_arrays(edge, y), axis=-1) for edge in (x[0], x[-1])])
