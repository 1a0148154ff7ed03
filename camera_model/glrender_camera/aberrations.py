"""The wavefront of an aberrated lens, over its pupil and over its field of view."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from .errors import ConfigError
from .pupil import zernike
from .validate import finite, integer, known_keys, positive, vector, within

# Ten waves RMS: by then geometric optics says the same, and the kernel grows without end.
_MAX_NM = 10_000.0
_MAX_NOLL = 66


@dataclass(frozen=True, kw_only=True)
class Aberrations:
    """Zernike terms, alike over the field or growing with the field height as Seidel's do.

    All are RMS wavefront errors [nm], -10,000..10,000, on the unobscured pupil. The field height is
    0 on the axis, in the middle of the frame, and 1 in its corners.

    Parameters
    ----------
    defocus_nm, spherical_nm : float [nm]
        Over the whole field: Noll's terms 4 and 11.
    zernike_nm : pairs (Noll index 2..66, nm)
        Further terms over the whole field.
    coma_nm : float [nm]
        In the corners; grows with the field height. Positive: the tail points away from the axis
        (external); negative: towards it (internal).
    tangential_nm, sagittal_nm : float [nm]
        In the corners; grow with the field height's square. Defocus that the fan of rays in the
        plane of the axis, and the one across it, see: equal values are field curvature, their
        difference is astigmatism.
    aspect : float [1], > 0
        Width over height of the frame.
    grid : (rows, columns) int, 2..17
        Nodes where kernels are made, evenly spaced over the frame; between them light is shared out
        bilinearly.

    Raises
    ------
    ConfigError

    Source: Seidel's dependence on the field height, Born & Wolf, Principles of Optics, section 5.3.
    """

    defocus_nm: float = 0.0
    spherical_nm: float = 0.0
    zernike_nm: tuple[tuple[int, float], ...] = ()
    coma_nm: float = 0.0
    tangential_nm: float = 0.0
    sagittal_nm: float = 0.0
    aspect: float = 1.0
    grid: tuple[int, int] = (5, 5)

    def __post_init__(self):
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731 (frozen dataclass)
        for name in ("defocus_nm", "spherical_nm", "coma_nm", "tangential_nm", "sagittal_nm"):
            put(name, within(name, getattr(self, name), -_MAX_NM, _MAX_NM))
        if not isinstance(self.zernike_nm, Sequence) or isinstance(self.zernike_nm, str):
            raise ConfigError("zernike_nm", "must be pairs (Noll index, nm)", self.zernike_nm)
        terms = []
        for i, pair in enumerate(self.zernike_nm):
            noll, value = vector(f"zernike_nm[{i}]", pair, 2).tolist()
            terms.append((integer(f"zernike_nm[{i}]", noll, 2, _MAX_NOLL),
                          within(f"zernike_nm[{i}]", finite(f"zernike_nm[{i}]", value), -_MAX_NM, _MAX_NM)))
        put("zernike_nm", tuple(terms))
        put("aspect", positive("aspect", self.aspect))
        rows, columns = vector("grid", self.grid, 2).tolist()
        put("grid", (integer("grid[0]", rows, 2, 17), integer("grid[1]", columns, 2, 17)))

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> Aberrations:
        """From plain data; unknown keys are refused by name."""
        known_keys("", table, [f.name for f in fields(cls)])
        return cls(**table)

    @property
    def varies(self) -> bool:
        """Whether the wavefront depends on the place in the field."""
        return (self.coma_nm, self.tangential_nm, self.sagittal_nm) != (0.0, 0.0, 0.0)

    def nodes(self) -> np.ndarray:
        """Field points (x, y) of the grid, heights 1 in the corners: (rows, columns, 2)."""
        rows, columns = self.grid
        diagonal = math.hypot(self.aspect, 1.0)
        x = np.linspace(-self.aspect, self.aspect, columns) / diagonal
        y = np.linspace(-1.0, 1.0, rows) / diagonal
        return np.stack(np.meshgrid(x, y), axis=-1)

    def opd_nm(self, x: np.ndarray, y: np.ndarray, field_xy: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
        """Optical path difference over the pupil [nm].

        Parameters
        ----------
        x, y : (...) float [1]
            Pupil coordinates over the outer radius.
        field_xy : (2,) float [1]
            Place in the field; its length is the field height.
        """
        total = self.defocus_nm * zernike(4, x, y) + self.spherical_nm * zernike(11, x, y)
        for noll, value in self.zernike_nm:
            total = total + value * zernike(noll, x, y)
        height = math.hypot(*field_xy)
        if self.varies and height > 0.0:
            across, along = field_xy[0] / height, field_xy[1] / height
            # Pupil axes turned so that u points away from the axis of the field.
            u, v = x * across + y * along, y * across - x * along
            total = total + height * self.coma_nm * zernike(8, u, v)
            total = total + height**2 * (0.5 * (self.tangential_nm + self.sagittal_nm) * zernike(4, u, v)
                                         + math.sqrt(0.5) * (self.tangential_nm - self.sagittal_nm)
                                         * zernike(6, u, v))
        return total
