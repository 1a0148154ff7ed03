"""Convolution with point spread functions: the cheapest exact way for each kernel, one or many over the frame."""

from __future__ import annotations

import cv2
import numpy as np

from .threads import run

# Dropped singular values together stay below this share of the light.
_RANK_TOLERANCE = 1e-7
# From 12 px on OpenCV's filter goes by Fourier transform itself, anew for each call.
_LARGEST_DIRECT_PX = 11
# Transforms of a kernel are kept for so many sizes of image; sizes are rounded up so that few are needed.
_N_TRANSFORMS, _SIZE_STEP_PX = 8, 32
# Large images are spread in parallel bands of rows; their number does not depend on that of the threads.
_MAX_BANDS, _BAND_PX = 4, 2**17


class Convolution:
    """One kernel, prepared.

    A kernel of low rank is a sum of separable ones, two passes of n points each instead of n x n.
    The rank that leaves 1e-7 of the light, its passes, the direct sum and the Fourier transform have
    costs; the least is taken.

    Parameters
    ----------
    kernel : (n,) or (n, m) float64, odd sizes
        One axis of a separable kernel, symmetric, or the whole.
    """

    def __init__(self, kernel: np.ndarray):
        kernel = np.asarray(kernel, np.float64)
        self.shape = kernel.shape if kernel.ndim == 2 else 2 * kernel.shape
        if kernel.ndim == 1:
            self._passes = [(kernel.astype(np.float32),) * 2]
        else:
            self._kernel = kernel.astype(np.float32)
            # OpenCV correlates: a convolution turns the kernel about.
            self._passes = _separated(kernel[::-1, ::-1])
        self._transforms: dict[tuple[int, int], np.ndarray] = {}
        self.method = f"{len(self._passes)} separable" if self._passes else (
            "direct" if max(self.shape) <= _LARGEST_DIRECT_PX else "Fourier")

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Convolve, with darkness beyond the edges and no wrap-around: (H, W) float32 -> (H, W) float32."""
        height, margin = image.shape[0], self.shape[0] // 2
        n_bands = min(_MAX_BANDS, image.size // _BAND_PX, height // max(4 * margin, 1))
        if n_bands < 2:
            return np.ascontiguousarray(self._spread(image))
        out = np.empty(image.shape, np.float32)
        edges = np.linspace(0, height, n_bands + 1).astype(int)

        def spread_band(band: int) -> None:
            first, last = edges[band], edges[band + 1]
            top, bottom = max(0, first - margin), min(height, last + margin)
            out[first:last] = self._spread(image[top:bottom])[first - top:last - top]

        run(spread_band, range(n_bands))
        return out

    def _spread(self, image: np.ndarray) -> np.ndarray:
        border = cv2.BORDER_CONSTANT
        if self._passes:
            (column, row), *rest = self._passes
            spread = cv2.sepFilter2D(image, cv2.CV_32F, row, column, borderType=border)
            for column, row in rest:
                spread += cv2.sepFilter2D(image, cv2.CV_32F, row, column, borderType=border)
        elif self.method == "direct":
            spread = cv2.filter2D(image, cv2.CV_32F, self._kernel[::-1, ::-1], borderType=border)
        else:
            spread = self._by_transform(image)
        # Rounding must not make light negative.
        return np.maximum(spread, 0.0, out=spread)

    def _by_transform(self, image: np.ndarray) -> np.ndarray:
        height, width = image.shape
        # So much darkness beyond the edges that nothing wraps around into the image.
        shape = tuple(cv2.getOptimalDFTSize(-(-(size + n // 2) // _SIZE_STEP_PX) * _SIZE_STEP_PX)
                      for size, n in zip(image.shape, self.shape, strict=True))
        transform = self._transforms.get(shape)
        if transform is None:
            if len(self._transforms) >= _N_TRANSFORMS:
                self._transforms.clear()
            kernel = np.zeros(shape, np.float32)
            rows, columns = (np.arange(n) - n // 2 for n in self.shape)
            np.add.at(kernel, np.ix_(rows % shape[0], columns % shape[1]), self._kernel)
            transform = self._transforms[shape] = cv2.dft(kernel)
        # `nonzeroRows` and transforms in place would be twice as slow.
        padded = cv2.copyMakeBorder(image, 0, shape[0] - height, 0, shape[1] - width, cv2.BORDER_CONSTANT, value=0.0)
        spectrum = cv2.dft(padded)
        cv2.mulSpectrums(spectrum, transform, 0, c=spectrum)
        spread = cv2.idft(spectrum, flags=cv2.DFT_SCALE | cv2.DFT_REAL_OUTPUT)
        return spread[:height, :width]


def _separated(kernel: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Columns and rows whose products sum to the kernel, or none if another way is cheaper."""
    n = max(kernel.shape)
    # [ms per megapixel and core], measured: two passes, direct sum, Fourier transform.
    two_passes, whole = 0.6 + 0.1 * n, 0.052 * n * n if n <= _LARGEST_DIRECT_PX else 11.0 + 0.02 * n
    if n > 1 and min(kernel.shape) > 2 * _LARGEST_DIRECT_PX and not _may_be_low_rank(kernel):
        return []
    u, s, v = np.linalg.svd(kernel)
    # A dropped term holds at most s sqrt(n m) of the light.
    left = np.append(np.cumsum(s[::-1])[::-1], 0.0) * np.sqrt(kernel.size)
    rank = max(1, int(np.argmax(left <= _RANK_TOLERANCE * max(kernel.sum(), 1e-30))))
    if rank * two_passes > whole:
        return []
    root = np.sqrt(s[:rank])
    return [((u[:, i] * root[i]).astype(np.float32), (v[i] * root[i]).astype(np.float32)) for i in range(rank)]


def _may_be_low_rank(kernel: np.ndarray) -> bool:
    """Whether sixteen of a large kernel's rows are: the whole one's decomposition would cost seconds."""
    rows = kernel[np.linspace(0, kernel.shape[0] - 1, 16).astype(int)]
    s = np.linalg.svd(rows, compute_uv=False)
    return bool(s[8] <= 1e-9 * s[0])


class FieldConvolution:
    """A grid of kernels over the frame.

    They sit on nodes evenly spaced from the frame's first to its last pixel. The light, not the
    result, is shared out between the four nodes around it with bilinear weights that sum to 1: no
    light is lost or made, and there is no seam.

    Parameters
    ----------
    kernels : (ny, nx, n, m) float64, n and m odd
        A grid of one row or column does not vary that way.
    """

    def __init__(self, kernels: np.ndarray):
        self.shape = kernels.shape
        self._nodes = {place: Convolution(kernels[place]) for place in np.ndindex(kernels.shape[:2])}

    def __call__(self, image: np.ndarray, origin_px: tuple[int, int], frame_shape: tuple[int, int]) -> np.ndarray:
        """Spread a part of the frame.

        Parameters
        ----------
        image : (h, w) float32
            A part of the frame; darkness elsewhere.
        origin_px : (row, column) int [px]
            Place of the part in the frame.
        frame_shape : (H, W) int [px]

        Returns
        -------
        (h, w) float32
        """
        row_weights, column_weights = (
            hats(origin + np.arange(size), length, n_nodes) for origin, size, length, n_nodes
            in zip(origin_px, image.shape, frame_shape, self.shape[:2], strict=True))
        margin_y, margin_x = self.shape[2] // 2, self.shape[3] // 2
        out = np.zeros(image.shape, np.float32)
        for (i, j), convolution in self._nodes.items():
            rows, columns = _support(row_weights[i]), _support(column_weights[j])
            light = image[rows, columns] * row_weights[i, rows, None] * column_weights[j, columns]
            if not light.any():
                continue
            light = cv2.copyMakeBorder(light, margin_y, margin_y, margin_x, margin_x, cv2.BORDER_CONSTANT, value=0.0)
            spread = convolution(light)
            # Light that reaches beyond the part is cut off.
            top, left = rows.start - margin_y, columns.start - margin_x
            inside = np.s_[max(0, -top):image.shape[0] - top, max(0, -left):image.shape[1] - left]
            part = spread[inside]
            out[max(0, top):max(0, top) + part.shape[0], max(0, left):max(0, left) + part.shape[1]] += part
        return out


def hats(position: np.ndarray, length: int, n_nodes: int) -> np.ndarray:
    """(n_nodes, N) float32: linear weights of evenly spaced nodes from 0 to length - 1; columns sum to 1."""
    if n_nodes == 1:
        return np.ones((1, position.size), np.float32)
    # Beyond the frame, in a margin, the last node's kernel goes on.
    place = np.clip(position * ((n_nodes - 1) / max(length - 1, 1)), 0, n_nodes - 1)
    return np.maximum(1.0 - np.abs(place - np.arange(n_nodes)[:, None]), 0.0).astype(np.float32)


def _support(weights: np.ndarray) -> slice:
    index = np.flatnonzero(weights)
    return slice(int(index[0]), int(index[-1]) + 1) if index.size else slice(0, 0)
