"""A distorted frame from an oversampled pinhole image: flux, point sources, limbs, and the fold."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from glrender_camera import BrownConrady, ConfigError, DistortingLens, PinholeCamera

LENSES = {"barrel": BrownConrady(k1=-0.3, k2=0.1, p1=0.001, p2=-0.0005), "pincushion": BrownConrady(k1=0.2),
          "rational": BrownConrady(k1=-0.28, k2=0.07, k4=0.01)}


def camera(**fields):
    return PinholeCamera(**{"name": "c", "width_px": 200, "height_px": 150, "focal_length_px": 200.0, **fields})


def undistorted_pixels(lens):
    y, x = np.indices((lens.camera.height_px, lens.camera.width_px))
    return lens.undistort(np.stack([x, y], axis=-1))


@pytest.mark.parametrize("name", sorted(LENSES))
def test_an_even_sky_gives_each_distorted_pixels_own_solid_angle(name):
    """cos^3 / (f^2 |J|): 1e-3 RMS with 2 x 2 cells, 3e-4 with 4 x 4, the frame's sum 1e-5."""
    for oversampling, rms in ((2, 1e-3), (4, 3e-4)):
        lens = DistortingLens(camera(), LENSES[name], oversampling)
        frame = lens.apply(lens.source.solid_angle_sr().astype(np.float32))
        seen = undistorted_pixels(lens)
        true = (1.0 + np.sum(seen**2, axis=-1)) ** -1.5 / 200.0**2 / np.linalg.det(lens.distortion.jacobian(seen))
        assert np.sqrt(np.mean((frame / true - 1.0) ** 2)) < rms
        np.testing.assert_allclose(frame.sum(dtype=np.float64), true.sum(), rtol=1e-4)
        np.testing.assert_allclose(lens.cos_field_angle, 1.0 / np.sqrt(1.0 + np.sum(seen**2, axis=-1)), rtol=1e-6)


@pytest.mark.parametrize("name", sorted(LENSES))
def test_every_point_keeps_its_flux(name):
    """200 cells, one at a time: all light of each that falls into the frame, 1e-6; within half a pixel of its place."""
    lens = DistortingLens(camera(), LENSES[name], 2)
    source = lens.source
    rng = np.random.default_rng(3)
    cells = rng.integers(0, (source.width_px, source.height_px), (200, 2))
    points = np.concatenate([(cells - source.principal_point_px) / source.focal_length_px, np.ones((200, 1))], axis=1)
    d = lens.distortion
    projected = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), np.array([[200.0, 0, 99.5], [0, 200.0, 74.5], [0, 0, 1]]),
        np.array([d.k1, d.k2, d.p1, d.p2, d.k3, d.k4, d.k5, d.k6]))[0][:, 0]
    n_inside = 0
    for cell, place in zip(cells, projected, strict=True):
        if not ((place > 0.5) & (place < (198.5, 148.5))).all():
            continue
        image = np.zeros((source.height_px, source.width_px), np.float32)
        image[cell[1], cell[0]] = 7.0
        frame = lens.apply(image)
        np.testing.assert_allclose(frame.sum(dtype=np.float64), 7.0, rtol=1e-6)
        rows, columns = np.nonzero(frame)
        assert np.hypot(*(np.stack([columns, rows]) - place[:, None])).max() < 1.5
        centre = np.array([(frame * np.arange(200)).sum(), (frame * np.arange(150)[:, None]).sum()]) / 7.0
        assert np.abs(centre - place).max() <= 0.5
        n_inside += 1
    assert n_inside > 80


def test_a_blob_moves_by_the_distortion():
    """The centroid of a spot of sigma 1.5 px: the mean of its cells' distorted places, 0.01 px."""
    lens = DistortingLens(camera(), LENSES["barrel"], 2)
    source = lens.source
    y, x = np.indices((source.height_px, source.width_px))
    for cx, cy in ((60.3, 210.7), (300.0, 50.5), (215.2, 160.1)):
        spot = np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2.0 * 3.0**2)).astype(np.float32)
        cells = (np.stack([x, y], axis=-1) - source.principal_point_px) / source.focal_length_px
        expected = np.nansum(spot[..., None] * lens.distort(cells), axis=(0, 1)) / spot.sum()
        frame = lens.apply(spot)
        centre = np.array([(frame * np.arange(200)).sum(), (frame * np.arange(150)[:, None]).sum()]) / frame.sum()
        np.testing.assert_allclose(centre, expected, atol=0.01)


def test_a_straight_limb_keeps_its_photometry():
    """A half plane against 8 x 8 rays in each distorted pixel: sums of bands across the limb 2e-3, all 1e-4."""
    lens = DistortingLens(camera(), LENSES["barrel"], 4)
    source = lens.source
    normal, offset = np.array([0.6, 0.8]), 0.1
    # The rendered image: each cell's lit share, by 4 x 4 rays in it.
    lit = np.zeros((source.height_px, source.width_px))
    y, x = np.indices(lit.shape)
    fine = (np.arange(4) - 1.5) / 4.0
    for dy in fine:
        for dx in fine:
            cells = (np.stack([x + dx, y + dy], axis=-1) - source.principal_point_px) / source.focal_length_px
            lit += (cells @ normal > offset) / 16.0
    frame = lens.apply((lit * source.solid_angle_sr()).astype(np.float32))
    true = np.zeros((150, 200))
    rows, columns = np.indices(true.shape)
    sub = (np.arange(8) - 3.5) / 8.0
    for dy in sub:
        for dx in sub:
            seen = lens.undistort(np.stack([columns + dx, rows + dy], axis=-1))
            area = (1.0 + np.sum(seen**2, axis=-1)) ** -1.5 / 200.0**2 / np.linalg.det(lens.distortion.jacobian(seen))
            true += (seen @ normal > offset) * area / 64.0
    np.testing.assert_allclose(frame.sum(dtype=np.float64), true.sum(), rtol=1e-4)
    limb = (true > 0.0) & (true < 0.9 * true.max())
    for rows in np.array_split(np.arange(150), 5):
        np.testing.assert_allclose(frame[rows].sum(), true[rows].sum(), rtol=2e-3)
    assert np.abs(frame - true)[limb].mean() < 0.02 * true.max()


def test_magnification_scales_about_the_principal_point():
    """Lateral colour of 2e-3: a spot 80 px off axis moves out by 0.16 px, 0.002 px, and keeps its flux."""
    lenses = [DistortingLens(camera(), BrownConrady(), 2, m) for m in (1.0, 1.002)]
    centres = []
    for lens in lenses:
        source = lens.source
        y, x = np.indices((source.height_px, source.width_px))
        place = np.array(source.principal_point_px) + (160.0, -100.0)
        spot = np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2.0 * 3.0**2)).astype(np.float32)
        frame = lens.apply(spot)
        np.testing.assert_allclose(frame.sum(), spot.sum(), rtol=1e-5)
        centres.append([(frame * np.arange(200)).sum() / frame.sum(),
                        (frame * np.arange(150)[:, None]).sum() / frame.sum()])
    np.testing.assert_allclose(np.diff(centres, axis=0)[0], [0.16, -0.10], atol=2e-3)


def test_a_field_of_view_beyond_the_fold_is_refused_with_the_radius():
    """k1 = -0.3 folds at 1.0541, where it images 0.7027: a frame with corners at 0.72 asks for more."""
    DistortingLens(camera(focal_length_px=200.0), BrownConrady(k1=-0.3))
    with pytest.raises(ConfigError, match=r"distortion: .* the model folds over at 1\.0540\d"):
        DistortingLens(camera(focal_length_px=174.0), BrownConrady(k1=-0.3))


def test_cells_larger_than_pixels_are_refused():
    with pytest.raises(ConfigError, match="oversampling: a cell is stretched to 1.* oversample more"):
        lens = DistortingLens(camera(), BrownConrady(k1=0.2), 1)
        lens.apply(np.zeros((lens.source.height_px, lens.source.width_px), np.float32))
    lens = DistortingLens(camera(), BrownConrady(k1=0.2), 2)
    with pytest.raises(ConfigError, match="irradiance_W_m2: must have shape"):
        lens.apply(np.zeros((10, 10), np.float32))
