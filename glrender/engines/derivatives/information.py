"""What a camera's noise lets anybody know of a frame's parameters: Fisher's information, and costs in a pose."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from glrender_camera import CameraModel, PinholeCamera
from glrender_camera.camera import checked_exposure
from glrender_camera.expected import (
    are_full,
    changed_electrons,
    gathered_weights,
    mean_electrons,
    scatter_electrons,
)
from glrender_camera.validate import did_you_mean, integer

from ...base.errors import ConfigError
from .jacobian import Jacobian
from .shape_errors import checked_shape_sigma, shape_covariance

UNKNOWN = ("gain", "offset")
"""What besides the parameters may be unknown of a frame: a factor on its light, and a level."""
# Width of a point spread function [px] below which an image bends within a pixel: differences of frames by half a pixel
# leave the derivatives by a fifth there.
_LEAST_PSF_PX = 0.59
# Share of a parameter's information [1] that is nothing: float32 leaves as much of what others explain.
_NOTHING = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Information:
    """What one frame lets be known of its parameters, by the noise of its camera (Cramer and Rao).

    With the error of a shape, what a fit by the noise's weights that believes the shape knows of them.

    Attributes
    ----------
    names : tuple of str
        Of the K parameters: ``spacecraft[0]``, ...
    matrix : (K, K) float64
        Fisher's information, less the share that gain and offset explain.
    covariance : (K, K) float64
        Its inverse; infinite on the diagonal of what cannot be known.
    in_pixels_per_unit : (K,) float64
        Factors of `in_pixels`.
    unknowable : tuple of str
        Parameters that the frame does not show, or does not separate from others.
    warnings : tuple of str
    fit : Fit
        The least-squares fit of differences of images.
    """

    names: tuple[str, ...]
    matrix: np.ndarray
    covariance: np.ndarray
    in_pixels_per_unit: np.ndarray
    unknowable: tuple[str, ...]
    warnings: tuple[str, ...]
    fit: Fit

    @classmethod
    def of(cls, image: Any, model: Any, unknown: Iterable[str], components: Mapping[str, Sequence[int]] | None,
           exposure_s: float | str | None, shape_sigma: Sequence[float] | None) -> Information:
        """Of an `Image` with its derivatives and its request: `Image.information`."""
        jacobian, (*_, camera) = image.jacobian, image.request
        model = camera.model if model is None else model
        if not isinstance(model, CameraModel):
            raise ConfigError("model", "must be a CameraModel, of one band", model,
                              'give one, as CameraModel.from_dict({"preset": "generic_navigation_camera"})')
        chosen, warnings = _chosen(jacobian, components), ()
        sensor = Readout.of(model, camera, image.irradiance_W_m2, exposure_s)
        fit = Fit.of(sensor, jacobian, chosen, checked_unknown(unknown))
        matrix, covariance = fit.matrix, fit.covariance
        if shape_sigma is not None:
            if image.gradient is None:
                raise ConfigError("shape_sigma", "needs gradients by shapes, and this image has none",
                                  tuple(shape_sigma), "draw it by Renderer.render")
            shapes = {body.name: body.drawn_shape.vertices_m for body in image.request[0].bodies}
            of_shape = shape_covariance(fit.pixel_weights(), image.gradient, shapes, checked_shape_sigma(shape_sigma))
            matrix, covariance = np.linalg.solve(np.eye(len(chosen)) + matrix @ of_shape, matrix), covariance + of_shape
        names = tuple(jacobian.label(name, k) for name, k in chosen)
        if (psf_px := psf_width_px(model)) < _LEAST_PSF_PX:
            warnings = (f"the point spread function is {psf_px:.2g} px wide, and the image bends within a pixel: below "
                        f"{_LEAST_PSF_PX:g} px derivatives hold for errors of the noise's size alone",)
        return cls(names=names, matrix=matrix, covariance=covariance, warnings=warnings, fit=fit,
                   in_pixels_per_unit=np.array([_per_unit(jacobian, name, k, camera) for name, k in chosen]),
                   unknowable=tuple(name for name, is_hidden in zip(names, fit.is_hidden, strict=True) if is_hidden))

    @property
    def sigmas(self) -> dict[str, float]:
        """Least standard deviation of each parameter in its own unit [m, rad, px, 1]."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def in_pixels(self) -> dict[str, float]:
        """The same: across [px], along the boresight [% of the range], turns [urad], the focal length [%]."""
        return self._in_pixels(self.sigmas.values())

    def _in_pixels(self, values: Iterable[float]) -> dict[str, float]:
        return {name: value * factor for name, value, factor in zip(
            self.names, values, self.in_pixels_per_unit.tolist(), strict=True)}

    def nees(self, error: Sequence[float]) -> float:
        """Normalised squared error of an estimate (K,) [m, rad, px, 1]: K in the mean, if it is as good as can be."""
        error = np.asarray(error, float)
        if error.shape != (len(self.names),):
            raise ConfigError("error", f"must have shape ({len(self.names)},)", error.shape)
        return float(error @ self.matrix @ error)

    def cost_of(self, image: Any) -> dict[str, float]:
        """The change of the parameters that best explains how another image of the same view differs.

        Parameters
        ----------
        image : Image or (height, width) float array [W/m2]
            Drawn in another way, or of another shape or law: before the camera.

        Returns
        -------
        dict of str to float
            In the units of `in_pixels`.

        Raises
        ------
        ConfigError
        """
        return self._in_pixels(self.fit.explain(getattr(image, "irradiance_W_m2", image)).tolist())


@dataclass(frozen=True, kw_only=True, eq=False)
class Readout:
    """A camera's frame of an image in the mean, how it changes, and the weights of its pixels."""

    model: CameraModel
    options: Mapping[str, Any]
    exposure_s: float
    electrons: np.ndarray

    @classmethod
    def of(cls, model: CameraModel, camera: PinholeCamera, irradiance_W_m2: np.ndarray,
           exposure_s: float | str | None, margin_px: int = 0) -> Readout:
        """Of an image with a margin, as the camera is; an automatic exposure is that of its light."""
        options = {"relative_illumination": camera.cos_field_angle, "margin_px": margin_px}
        exposure: Any = checked_exposure("exposure_s", model.exposure_s if exposure_s is None else exposure_s)
        if exposure == "auto":
            second = mean_electrons(model, irradiance_W_m2, 1.0, **options)
            exposure = model.auto_exposure.of_irradiance(second, 1.0, model.detector)
        electrons = mean_electrons(model, irradiance_W_m2, exposure, **options)
        return cls(model=model, options=options, exposure_s=exposure, electrons=electrons)

    @cached_property
    def weights(self) -> np.ndarray:
        """(H, W) float32 [1/e-]: none of full pixels."""
        detector, electrons = self.model.detector, self.electrons
        return np.where(are_full(detector, electrons, self.exposure_s), 0.0,
                        scatter_electrons(detector, electrons, self.exposure_s) ** -0.5)

    def changes(self, jacobian: Jacobian, chosen: Sequence[tuple[str, int]]) -> np.ndarray:
        """Changes (K, H, W) float32 [e-] of the frame by chosen parameters."""
        shape = self.options["relative_illumination"].shape
        return changed_electrons(self.model, jacobian.whole(chosen, shape), self.exposure_s, **self.options)


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """The weighted fit of parameters to the difference of two frames, with what else is unknown."""

    sensor: Readout
    design: np.ndarray
    """(pixels, K + unknown) float64 [1]: weighted changes, each column of length 1."""
    scale: np.ndarray
    """(K + unknown,) by which the columns were multiplied."""
    inverse: np.ndarray
    is_hidden: np.ndarray
    matrix: np.ndarray
    covariance: np.ndarray

    @classmethod
    def of(cls, sensor: Readout, jacobian: Jacobian, chosen: Sequence[tuple[str, int]], unknown: Sequence[str]) -> Fit:
        """By the derivatives that are chosen."""
        columns = [*sensor.changes(jacobian, chosen)]
        columns += [{"gain": sensor.electrons, "offset": np.ones_like(sensor.electrons)}[name] for name in unknown]
        design = np.stack([(column * sensor.weights).ravel() for column in columns], axis=1).astype(np.float64)
        length, count = np.sqrt(np.square(design).sum(axis=0)), len(chosen)
        scale = np.where(length > 0.0, 1.0 / np.where(length > 0.0, length, 1.0), 1.0)
        design *= scale
        design[:, :count] = _without(design[:, :count], design[:, count:])
        scaled = design[:, :count].T @ design[:, :count]
        values, vectors = np.linalg.eigh(scaled)
        is_known = values > _NOTHING
        inverse = (vectors[:, is_known] / values[is_known]) @ vectors[:, is_known].T
        is_hidden = (np.abs(vectors[:, ~is_known]) > math.sqrt(_NOTHING)).any(axis=1)
        covariance = inverse * scale[:count] * scale[:count, None]
        covariance[is_hidden, is_hidden] = np.inf
        return cls(sensor=sensor, design=design, scale=scale, inverse=inverse, is_hidden=is_hidden,
                   matrix=scaled / (scale[:count] * scale[:count, None]), covariance=covariance)

    def pixel_weights(self) -> np.ndarray:
        """Weights (K, H, W) of changes of the irradiance, whose sums are what `explain` makes of them."""
        sensor, count = self.sensor, len(self.inverse)
        rows = self.scale[:count, None] * (self.inverse @ self.design[:, :count].T)
        weights = rows.reshape(count, *sensor.electrons.shape) * sensor.weights
        return gathered_weights(sensor.model, weights, sensor.exposure_s,
                                relative_illumination=sensor.options["relative_illumination"])

    def explain(self, irradiance_W_m2: np.ndarray) -> np.ndarray:
        """Changes (K,) of the parameters that make of the image another one (H, W) [W/m2], as far as they can."""
        sensor, count = self.sensor, len(self.inverse)
        image = np.asarray(irradiance_W_m2)
        if image.shape != sensor.electrons.shape:
            raise ConfigError("image", f"must have shape {sensor.electrons.shape}", image.shape)
        other = mean_electrons(sensor.model, image.astype(np.float32), sensor.exposure_s, **sensor.options)
        rest = ((other - sensor.electrons) * sensor.weights).ravel().astype(np.float64)
        return self.scale[:count] * (self.inverse @ (self.design[:, :count].T @ rest))


def _without(columns: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Columns (N, K) less their parts along others (N, M)."""
    return columns - others @ (np.linalg.pinv(others.T @ others) @ (others.T @ columns))


def psf_width_px(model: CameraModel) -> float:
    """Deviation [px] of the Gaussian that averages noise as the point spread function does."""
    return 1.0 / (2.0 * math.sqrt(math.pi) * model.psf_noise_gain)


def _per_unit(jacobian: Jacobian, name: str, k: int, camera: PinholeCamera) -> float:
    """Factor of `Information.in_pixels`."""
    if name == "focal_length":
        return 100.0 / camera.focal_length_px
    if name.startswith("law."):
        return 1.0
    if name == "sun" or k > 2:
        return 1e6
    return (100.0 if k == 2 else camera.focal_length_px) / jacobian.ranges_m[name]


def _chosen(jacobian: Jacobian, components: Mapping[str, Sequence[int]] | None) -> list[tuple[str, int]]:
    """Names and numbers of the derivatives whose parameters are estimated: by default all."""
    if components is None:
        return [(name, k) for name in jacobian for k in range(len(jacobian[name]))]
    if not isinstance(components, Mapping):
        raise ConfigError("components", "must be a mapping of names to numbers", components,
                          'as {"spacecraft": (0, 1, 2)}')
    chosen = []
    for name, numbers in components.items():
        if name not in jacobian:
            raise ConfigError(f"components.{name}", f"must be one of {', '.join(jacobian)}", name,
                              did_you_mean(name, jacobian) or "ask for it in derivatives")
        if isinstance(numbers, str) or not isinstance(numbers, Iterable):
            raise ConfigError(f"components.{name}", "must be a list of numbers", numbers, "as (0, 1, 2)")
        chosen += [(name, integer(f"components.{name}[{place}]", k, 0, len(jacobian[name]) - 1))
                   for place, k in enumerate(numbers)]
    if not chosen or len(set(chosen)) < len(chosen):
        raise ConfigError("components", "must name one at least, and each once", components, "leave it out for all")
    return chosen


def checked_unknown(unknown: Iterable[str]) -> tuple[str, ...]:
    if not isinstance(unknown, Iterable):
        raise ConfigError("unknown", f"must be names of {', '.join(UNKNOWN)}", unknown, "() for none")
    names = (unknown,) if isinstance(unknown, str) else tuple(unknown)
    for index, name in enumerate(names):
        if name not in UNKNOWN:
            raise ConfigError(f"unknown[{index}]", f"must be one of {', '.join(UNKNOWN)}", name,
                              did_you_mean(name, UNKNOWN))
        if name in names[:index]:
            raise ConfigError(f"unknown[{index}]", "must be named once", name)
    return names
