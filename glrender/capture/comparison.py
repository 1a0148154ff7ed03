"""A frame compared with the predicted one: the normal equations of a least-squares fit, in place of images."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from glrender_camera import ConfigError, PinholeCamera
from glrender_camera.camera import checked_exposure
from glrender_camera.expected import are_full, ideal_DN, largest_ideal_DN, scatter_electrons
from glrender_camera.validate import within

from ..base.plausible import Advice
from ..engines.advice import image_advice
from ..engines.derivatives.information import Readout, checked_unknown
from ..engines.derivatives.parameters import checked_derivatives
from ..planner.plan import RenderPlan
from ..view.state import State
from .frame_advice import bad_pixel_advice, lost_pixel_advice
from .frame_derivatives import check_still
from .motion_path import moves
from .outputs import checked_output
from .static_exposure import Drawing, checked_region, margin_of

FRAME_DTYPES = ("uint8", "uint16", "float32", "float64")
"""Kinds of numbers that a frame may come in."""
MAX_BLUR_PX = 64.0
"""Widest blur of a comparison [px]: a smaller camera shows as much of what is wider."""
MAX_DN = 1e9
"""Largest digital number that is compared [DN], of either sign: detectors have 16 bits, sums of frames a few more."""
UNITS = {"gain": "1", "offset": "DN"}
_POSE_UNITS = ("m", "m", "m", "rad", "rad", "rad")
# Weights follow the gain, and outliers the weights: a fourth turn changes both by less than 1e-3.
_TURNS = 3
# Deviations of the read-out noise by which a full well may be seen below its level: noise comes after it.
_UNDER_FULL = 4.0
# Residuals count in full up to twice their robust deviation, the median over 0.6745 of a normal distribution (Huber).
_HUBER, _PER_MEDIAN = 2.0, 1.4826
# Share of the brightest pixel's light [1] from which a pixel is lit, and tells how far residuals scatter.
_LIT = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """The least-squares fit of K parameters to a frame, about the state that was drawn.

    ``numpy.linalg.solve(matrix, vector)`` is the step that best explains the frame. A parameter that is known is left
    out with its row and column.

    Attributes
    ----------
    names, units : tuple of str
        Of the parameters, ``spacecraft[0]``, ..., then of what else is unknown: ``gain``, ``offset``.
    matrix : (K, K) float64
        J^T W J of the mean digital numbers' derivatives J, and the weights W by the camera's noise.
    vector : (K,) float64
        J^T W r of the residuals r, the frame less the predicted one with its best gain and offset.
    chi2 : float [1]
        r^T W r.
    n_pixels : int
        Pixels that count: full and masked ones do not.
    gain : float [1]
        Best factor on the predicted light at this state; 1 where it is known. Where the best is not above zero, as the
        frame's light is elsewhere, it is the factor of the whole frames' light.
    offset_DN : float [DN]
        Best level above the detector's own; 0 where it is known.
    exposure_s : float [s]
    plan : RenderPlan
    timings_ms : dict of str to float
    warnings : tuple of Advice
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    matrix: np.ndarray
    vector: np.ndarray
    chi2: float
    n_pixels: int
    gain: float
    offset_DN: float
    exposure_s: float
    plan: RenderPlan
    timings_ms: dict[str, float]
    warnings: tuple[Advice, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The fit as plain data, as `docs/protocol.md` has it."""
        return {"names": list(self.names), "units": list(self.units), "matrix": self.matrix.tolist(),
                "vector": self.vector.tolist(), "chi2": self.chi2, "n_pixels": self.n_pixels, "gain": self.gain,
                "offset_DN": self.offset_DN}


def compare_frame(renderer: Any, state: State, camera: str | None = None, *, frame_DN: np.ndarray,
                  derivatives: Iterable[str] = ("spacecraft",), unknown: Iterable[str] = ("gain", "offset"),
                  exposure_s: float | str | None = None, roi: Sequence[int] | None = None, blur_px: float = 0.0,
                  is_robust: bool = False, **options: Any) -> Comparison:
    """Compare a frame with the one that a state predicts: the normal equations of a fit of the state.

    Predicted are mean digital numbers, without stars, faults and the pixels' own pattern. The table of a bent
    characteristic is taken off the frame.

    Parameters
    ----------
    renderer
        A renderer of `glrender.open_renderer`.
    state : State
        Standing still.
    camera : str, optional
        Name; the scene's only camera by default.
    frame_DN : (height, width) uint8, uint16, float32 or float64 [DN]
        The camera's frame, or its region `roi`. Pixels that a masked array masks do not count.
    derivatives : iterable of str
        The parameters, as of `Renderer.render`.
    unknown : iterable of str
        Out of ``gain``, a factor on the light, and ``offset``, a level.
    exposure_s : float [s] or "auto", optional
        The frame's; the camera's by default. Automatic ones are of an unknown gain alone.
    roi : (x0, y0, x1, y1) int [px], optional
        The part of the frame that is compared, one past the last.
    blur_px : float [px], 0..64
        Deviation of a Gaussian by which both are blurred, so that a fit finds the state from farther away. Pixels then
        weigh alike, and `chi2` is no measure of a fit.
    is_robust : bool
        Whether pixels that differ by more than twice the robust deviation of the lit ones weigh less (Huber).
    **options
        As of `draw_still`, but for `out`.

    Raises
    ------
    SceneError, ConfigError
    """
    began, scene = time.perf_counter(), renderer.scene
    pinhole = scene.camera(camera)
    checked_output("dn", pinhole)
    unknown = checked_unknown(unknown)
    exposure = _checked_exposure(exposure_s, pinhole, unknown)
    model: Any = pinhole.model
    longest_s = model.auto_exposure.max_s if exposure == "auto" else exposure
    check_still(pinhole, moves(state, 0.5 * longest_s))
    derivatives = checked_derivatives(derivatives, scene)
    if not derivatives:
        raise ConfigError("derivatives", "must name one parameter at least", derivatives, 'as ["spacecraft"]')
    blur_px = within("blur_px", blur_px, 0.0, MAX_BLUR_PX)
    if not isinstance(is_robust, (bool, np.bool_)):
        raise ConfigError("is_robust", "must be true or false", is_robust)
    box = (0, 0, pinhole.width_px, pinhole.height_px) if roi is None else checked_region(roi, pinhole)
    frame = checked_frame(frame_DN, (box[3] - box[1], box[2] - box[0]))
    margin_px, _ = margin_of(renderer, state, pinhole, is_moving=False)
    drawing = Drawing(renderer, pinhole, margin_px, True, exposure, derivatives=derivatives, **options)
    still = drawing.still(state)
    predicted = _Predicted(pinhole, margin_px, box, still.irradiance_W_m2, exposure)
    changes, names, units = predicted.changes_DN(still.jacobian, derivatives)
    # Numbers beyond the camera's are of no light.
    seen_DN = np.where(frame > model.detector.max_DN, np.inf, ideal_DN(model.detector, frame)) - predicted.level_DN
    fit = _Fit.of(seen_DN, predicted, unknown, blur_px, is_robust)
    rows = [*(fit.gain * fit.blurred(each) for each in changes), *fit.looks]
    columns = np.array([(each * fit.root_weights).ravel() for each in rows]).reshape(len(rows), frame.size)
    rest = (fit.rest * fit.root_weights).ravel()
    inner = np.s_[margin_px:margin_px + pinhole.height_px, margin_px:margin_px + pinhole.width_px]
    timings = {**still.timings_ms, "compare": 1e3 * (time.perf_counter() - began) - sum(still.timings_ms.values())}
    # Sums that threads of BLAS may not order anew: equal requests have equal bytes.
    return Comparison(names=(*names, *unknown), units=(*units, *(UNITS[name] for name in unknown)),
                      matrix=np.einsum("ip,jp->ij", columns, columns), vector=np.einsum("ip,p->i", columns, rest),
                      chi2=float(np.einsum("p,p->", rest, rest)), n_pixels=int(np.count_nonzero(fit.counts)),
                      gain=fit.gain, offset_DN=fit.offset_DN, exposure_s=predicted.exposure_s, plan=still.plan,
                      timings_ms=timings, warnings=(
                          *(() if is_robust else bad_pixel_advice(pinhole)),
                          *lost_pixel_advice(_are_lit(predicted.light_DN), fit.counts),
                          *image_advice(scene, state, pinhole, still.plan, still.irradiance_W_m2[inner], box)))


def checked_frame(frame_DN: object, shape: tuple[int, int]) -> np.ndarray:
    """A frame (H, W) float64 [DN] of a shape, with `MAX_DN`, so full, where it is masked.

    Raises
    ------
    ConfigError
    """
    is_masked: Any = False
    if isinstance(frame_DN, np.ma.MaskedArray):
        is_masked, frame_DN = np.ma.getmaskarray(frame_DN), frame_DN.filled(0)
    frame = np.asarray(frame_DN)
    if frame.dtype.name not in FRAME_DTYPES:
        raise ConfigError("compare", f"must have a dtype out of {', '.join(FRAME_DTYPES)}", frame.dtype.name,
                          "give the camera's digital numbers")
    if frame.shape != shape:
        raise ConfigError("compare", f"must have the shape {shape} (height, width) of the camera's frame, or of roi",
                          frame.shape, "give the frame of this camera, or roi, the part of it that this is")
    if n_odd := np.count_nonzero(~(np.abs(frame.astype(np.float64)) <= MAX_DN)):
        raise ConfigError("compare", f"must have finite numbers within {MAX_DN:g} DN", f"{n_odd} pixels that have none",
                          "mask lost pixels by numpy.ma, or give them the camera's largest digital number: neither "
                          "count")
    return np.where(is_masked, MAX_DN, frame.astype(np.float64))


def _checked_exposure(exposure_s: object, camera: PinholeCamera, unknown: Sequence[str]) -> Any:
    model: Any = camera.model
    exposure = checked_exposure("exposure_s", model.exposure_s if exposure_s is None else exposure_s)
    if exposure == "auto" and "gain" not in unknown:
        raise ConfigError("exposure_s", 'must be a number where "gain" is not unknown', exposure,
                          "give the frame's own exposure")
    return exposure


class _Predicted:
    """The mean digital numbers of a region of a camera's frame at a state, and how they change."""

    def __init__(self, camera: PinholeCamera, margin_px: int, box: tuple[int, int, int, int],
                 irradiance_W_m2: np.ndarray, exposure_s: Any):
        model: Any = camera.model
        self._readout = Readout.of(model, camera.with_margin(margin_px), irradiance_W_m2, exposure_s, margin_px)
        self._detector, self._box = model.detector, np.s_[..., box[1]:box[3], box[0]:box[2]]
        self.exposure_s = self._readout.exposure_s
        self._electrons = self._readout.electrons[self._box].astype(np.float64)
        self._gain_DN = self._detector.gain_DN_per_electron

    @property
    def light_DN(self) -> np.ndarray:
        """(h, w)."""
        return self._gain_DN * self._electrons

    @property
    def level_DN(self) -> float:
        """Mean digital number of a dark pixel."""
        dark = self._detector.dark_rate_electrons_per_s * self.exposure_s
        return self._detector.offset_DN + self._gain_DN * dark

    def changes_DN(self, jacobian: Any, names: Sequence[str]) -> tuple[list[np.ndarray], list[str], list[str]]:
        """Changes (h, w) [DN] by each parameter, its name and unit."""
        changes: list[np.ndarray] = []
        labels: list[str] = []
        units: list[str] = []
        for name in names:
            each = jacobian.each(name)
            changes += [*(self._gain_DN * self._readout.changes(jacobian, each)[self._box].astype(np.float64))]
            labels += [jacobian.label(*one) for one in each]
            units += {"sun": ["rad", "rad"], "focal_length": ["px"]}.get(
                name, ["1"] if name.startswith("law.") else _POSE_UNITS)
        return changes, labels, units

    def variance_DN2(self, gain: float) -> np.ndarray:
        """Variance (h, w) of the digital numbers, of light by a factor."""
        return self._gain_DN**2 * scatter_electrons(self._detector, gain * self._electrons, self.exposure_s)

    def are_full(self, gain: float, seen_DN: np.ndarray) -> np.ndarray:
        """Pixels (h, w) that are full in the predicted frame, or in one that is seen above the level."""
        detector = self._detector
        full = detector.full_well_electrons - _UNDER_FULL * detector.read_noise_electrons
        largest = min(largest_ideal_DN(detector), int(detector.offset_DN + self._gain_DN * full))
        return (seen_DN + self.level_DN >= largest) | are_full(detector, gain * self._electrons, self.exposure_s)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fit:
    """Gain and offset of a frame at a fixed state, the weights of its pixels, and what is left."""

    gain: float
    offset_DN: float
    counts: np.ndarray
    root_weights: np.ndarray
    rest: np.ndarray
    looks: list[np.ndarray]
    blur_px: float

    @classmethod
    def of(cls, seen_DN: np.ndarray, predicted: _Predicted, unknown: Sequence[str], blur_px: float,
           is_robust: bool) -> _Fit:
        """Of a frame (h, w) above the dark level, infinite where it is lost."""
        light = predicted.light_DN
        is_read = np.isfinite(seen_DN)
        gain, offset = _ratio(seen_DN[is_read], light[is_read]) if "gain" in unknown else 1.0, 0.0
        counts = ~predicted.are_full(gain, seen_DN)
        seen, image, even = (_blurred(each, counts, blur_px) for each in (seen_DN, light, np.ones_like(light)))
        looks = {"gain": image, "offset": even}
        for turn in range(_TURNS):
            variance = predicted.variance_DN2(gain)
            weights = counts / (variance.mean() if blur_px else variance)
            if is_robust and turn:
                weights = weights * _huber(seen - gain * image - offset * even, weights, image)
            found = _solved(looks, unknown, seen, weights, {"gain": gain, "offset": 0.0})
            if not found["gain"] > 0.0:  # light that is not the predicted one's
                found = _solved(looks, [name for name in unknown if name != "gain"], seen, weights,
                                {"gain": gain, "offset": 0.0})
            gain, offset = found["gain"], found["offset"]
        return cls(gain=gain, offset_DN=offset, counts=counts, root_weights=np.sqrt(weights), blur_px=blur_px,
                   rest=seen - gain * image - offset * even, looks=[looks[name] for name in unknown])

    def blurred(self, image: np.ndarray) -> np.ndarray:
        """An image as it is compared."""
        return _blurred(image, self.counts, self.blur_px)


def _blurred(image: np.ndarray, counts: np.ndarray, blur_px: float) -> np.ndarray:
    """An image without the pixels that do not count, blurred."""
    image = np.where(counts, image, 0.0)
    return cv2.GaussianBlur(image, (0, 0), blur_px) if blur_px else image


def _ratio(seen_DN: np.ndarray, light_DN: np.ndarray) -> float:
    """The light (N,) above its median over the predicted, of pixels that were read: roughly the gain."""
    if not seen_DN.size:
        return 1.0
    total, above = float(light_DN.sum()), float((seen_DN - np.median(seen_DN)).sum())
    return above / total if total > 0.0 and above > 0.0 else 1.0


def _solved(looks: Mapping[str, np.ndarray], free: Sequence[str], seen: np.ndarray, weights: np.ndarray,
            known: Mapping[str, float]) -> dict[str, float]:
    """Factors of images whose sum is nearest to another by weights: those that are free, and 0 of dark ones."""
    if not free:
        return dict(known)
    rest = seen - sum(known[name] * image for name, image in looks.items() if name not in free)
    matrix = np.array([[np.einsum("ij,ij,ij->", looks[a], looks[b], weights) for b in free] for a in free])
    vector = np.array([np.einsum("ij,ij,ij->", looks[name], rest, weights) for name in free])
    found = (np.linalg.pinv(matrix, hermitian=True) @ vector).tolist()
    return {**known, **dict(zip(free, found, strict=True))}


def _are_lit(light: np.ndarray) -> np.ndarray:
    return light > _LIT * light.max()


def _huber(rest: np.ndarray, weights: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Factors on weights of residuals."""
    size = np.abs(rest) * np.sqrt(weights)
    is_lit = _are_lit(light) & (weights > 0.0)
    if not is_lit.any():
        return np.ones_like(rest)
    limit = _HUBER * max(_PER_MEDIAN * float(np.median(size[is_lit])), 1.0)
    return limit / np.maximum(size, limit)
