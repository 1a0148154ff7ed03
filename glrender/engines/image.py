"""The image that every backend returns."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from glrender_camera import CameraModel, PinholeCamera
from glrender_camera.notebook import png
from glrender_camera.validate import did_you_mean

from ..base.errors import ConfigError
from ..base.names import PRODUCTS
from ..planner.plan import RenderPlan
from ..scene.scene import Scene
from ..view.state import State
from .advice import Advice, image_advice
from .derivatives.information import UNKNOWN, Information
from .derivatives.jacobian import Jacobian
from .small_bodies import SmallBody

_BYTES = {"range": 8, "body_id": 4, "facet_id": 4, "incidence": 4, "emission": 4, "phase": 4, "r_body": 12, "sunlit": 4}
# Bytes a pixel from which products are made: three layers of four float32.
_LAYER_BYTES = 48


@dataclass(frozen=True, kw_only=True, eq=False)
class Image:
    """A rendered frame.

    Attributes
    ----------
    irradiance_W_m2 : (height, width) float32 [W/m2]
        Irradiance that arrives at the aperture from the solid angle of each pixel.
    products : dict of str to array
        Products that were asked for, at each pixel's centre: ``range`` float64 [m] (NaN on the sky),
        ``body_id`` int32 (index into the scene's bodies, -1 on the sky), ``facet_id`` int32 (likewise),
        ``incidence``, ``emission``, ``phase`` float32 [rad] (NaN there), ``r_body`` (height, width, 3)
        float32 [m] (NaN there), ``sunlit`` float32 (0 in a cast shadow or facing away, 1 in sunlight).
    plan : RenderPlan
    timings_ms : dict of str to float
    small_bodies : tuple of SmallBody
        Bodies of a few pixels or less: flux and centre of brightness, where OpenGL drew them alone.
    request : (Scene, State, PinholeCamera), optional
        Scene, state and camera of the image.
    jacobian : Jacobian, optional
        Derivatives by the parameters that were asked for.
    gradient : callable, optional
        With derivatives: `Renderer.gradient` of the same frame by weights (height, width), while its renderer is open.
    """

    irradiance_W_m2: np.ndarray
    products: dict[str, np.ndarray]
    plan: RenderPlan
    timings_ms: dict[str, float]
    small_bodies: tuple[SmallBody, ...] = ()
    request: tuple[Scene, State, PinholeCamera] | None = None
    jacobian: Jacobian | None = None
    gradient: Callable[[np.ndarray], Mapping[str, Any]] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """What a copy in another process has: no gradients, which are the renderer's."""
        return {**vars(self), "gradient": None}

    def __repr__(self) -> str:
        height, width = self.irradiance_W_m2.shape
        return (f"<Image {self.plan.camera} {width} x {height} px, {self.irradiance_W_m2.max():.3g} W/m2 at most, "
                f"predicted RMS error {self.plan.predicted_error:.2%}, products {list(self.products)}>")

    def _repr_png_(self) -> bytes:
        """For notebooks: the irradiance in grey."""
        return png(self.irradiance_W_m2)

    @property
    def roi(self) -> tuple[int, int, int, int]:
        """Region [px] outside which the irradiance is zero: x0, y0, x1, y1, one past the last."""
        return self.plan.roi

    def information(self, model: CameraModel | None = None, unknown: Iterable[str] = UNKNOWN, *,
                    components: Mapping[str, Sequence[int]] | None = None, exposure_s: float | str | None = None,
                    shape_sigma: Sequence[float] | None = None) -> Information:
        """What the noise of a camera lets be known of the parameters that the image was differentiated by.

        Parameters
        ----------
        model : CameraModel, optional
            That of the image's camera by default.
        unknown : iterable of str
            Out of ``gain``, a factor on the light, and ``offset``, a level, both in digital numbers.
        components : mapping of str to sequence of int, optional
            Of each parameter the components that are estimated, as {"spacecraft": (0, 1, 2)} where the attitude is
            known; all by default.
        exposure_s : float [s] or "auto", optional
            The model's by default.
        shape_sigma : (float, float) [m], optional
            Standard deviation >= 0 of the heights of the bodies' shapes, and their correlation length > 0: heights at a
            distance d correlate by exp(-d^2 / (2 length^2)). The covariance is then that of a fit which believes the
            shapes; each parameter costs a gradient, by the renderer, which must be open.

        Raises
        ------
        ConfigError
        """
        if self.jacobian is None or self.request is None:
            raise ConfigError("derivatives", "must have been asked for", hint='derivatives=["spacecraft"] of render')
        return Information.of(self, model, unknown, components, exposure_s, shape_sigma)

    @cached_property
    def warnings(self) -> tuple[Advice, ...]:
        """Oddities of the image: no body in view, nothing lit, distances of another unit; the plan's warnings."""
        if self.request is None:
            return ()
        has_points = any(body.is_apart and body.irradiance_W_m2 > 0.0 for body in self.small_bodies)
        return image_advice(*self.request, self.plan, self.irradiance_W_m2, self.roi, has_points=has_points)


def checked_products(products: Iterable[str], known: Iterable[str] = tuple(PRODUCTS)) -> tuple[str, ...]:
    """The products asked for besides the irradiance, in the order of those that are known."""
    if not isinstance(products, Iterable):
        raise ConfigError("products", "must be names of products", products)
    products = (products,) if isinstance(products, str) else tuple(products)
    for index, name in enumerate(products):
        # A list, as what is no text may have no hash.
        if name not in list(known):
            raise ConfigError(f"products[{index}]", f"must be one of {', '.join(known)}", name,
                              did_you_mean(name, known))
    return tuple(name for name in known if name in products and name != "irradiance")


def peak_bytes(n_pixels: int, products: Iterable[str]) -> int:
    """Memory [byte] that a frame takes at its largest: irradiance and products, their copies to send, layers."""
    each = [_BYTES[name] for name in checked_products(products)]
    return n_pixels * (2 * (4 + sum(each)) + (_LAYER_BYTES if each else 0))
