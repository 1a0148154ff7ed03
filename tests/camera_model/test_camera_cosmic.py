"""Cosmic rays: rate, charge, angles and seeds against the closed forms of an isotropic flux."""

from __future__ import annotations

import numpy as np
import pytest
from glrender_camera import CameraModel, ConfigError, Detector, Optics, cosmic
from scipy.stats import kstest

SENSOR = dict(quantum_efficiency=0.5, full_well_electrons=1e6, gain_DN_per_electron=0.05, bit_depth=16,
              cosmic_ray_hits_per_px_s=2e-4, cosmic_ray_electrons_per_px=1000.0, cosmic_ray_depth_px=0.5)


def model(**detector):
    return CameraModel(optics=Optics(aperture_diameter_m=0.01), detector=Detector(**(SENSOR | detector)),
                       exposure_s=1.0)


DARK = np.zeros((300, 320), np.float32)


def test_the_mean_charge_is_twice_the_depth_a_hit():
    """Rate x area x time hits of 2 x depth x charge each on average: 5 sigma of 40 frames."""
    charges = [model().expose(DARK, seed).electrons.sum(dtype=np.float64) for seed in range(40)]
    n_hits = 2e-4 * DARK.size
    # A path of depth / cos z has E[path^2] = infinity to the first order: the spread is taken from the frames.
    expected = n_hits * 2.0 * 0.5 * 1000.0
    assert abs(np.mean(charges) - expected) < 5.0 * np.std(charges) / np.sqrt(40) + 0.02 * expected


def test_tracks_are_straight_as_long_as_their_angle_says_and_keep_their_charge():
    """One hit at a time: charge = q hypot(run, depth); sin^2 z of 400 hits is even (Kolmogorov, p > 1e-3)."""
    shape, depth, charge = (4000, 4000), 3.0, 800.0
    sine2 = []
    for seed in range(400):
        pixel, electrons = cosmic.tracks(np.random.default_rng(seed), shape, 1, electrons_per_px=charge, depth_px=depth)
        rows, columns = np.divmod(pixel, shape[1])
        if rows.min() == 0 or columns.min() == 0 or rows.max() == 3999 or columns.max() == 3999:
            continue
        path = electrons.sum(dtype=np.float64) / charge
        run = np.sqrt(path**2 - depth**2)
        sine2.append(1.0 - (depth / path) ** 2)
        extent = np.hypot(np.ptp(rows), np.ptp(columns))
        assert abs(extent - run) < 2.0
        if run > 20.0:
            # No pixel is farther from the line through the ends than a pixel's half diagonal and theirs.
            points = np.stack([columns, rows], axis=1) - np.array([columns.mean(), rows.mean()])
            across = np.linalg.svd(points, full_matrices=False)[2][1]
            assert np.abs(points @ across).max() < 1.5
            assert electrons.max() <= charge * np.hypot(run, depth) / run * np.sqrt(2.0) * 1.001
    assert len(sine2) > 350
    assert kstest(sine2, "uniform").pvalue > 1e-3


def test_hits_are_counted_by_the_exposure_and_belong_to_the_frames_seed():
    first, again, other, longer = (model().expose(DARK, seed, exposure_s=t)
                                   for seed, t in ((1, 1.0), (1, 1.0), (2, 1.0), (1, 10.0)))
    assert first.dn.tobytes() == again.dn.tobytes() != other.dn.tobytes()
    assert longer.electrons.sum() > 5.0 * first.electrons.sum() > 0.0
    assert not model(cosmic_ray_hits_per_px_s=0.0).expose(DARK, 1).electrons.any()
    assert first.stages["cosmic_rays"] == "0.0002 hits/(px s)" and first.stages["shot_noise"] == "Poisson"


def test_other_noise_is_the_same_with_and_without_hits():
    """Rays draw from a stream of their own: beside their tracks no byte changes."""
    with_hits = model(read_noise_electrons=5.0).expose(DARK, 3)
    without = model(read_noise_electrons=5.0, cosmic_ray_hits_per_px_s=0.0).expose(DARK, 3)
    changed = with_hits.dn != without.dn
    assert 0.0 < changed.mean() < 0.01


@pytest.mark.parametrize("field, value", [
    ("cosmic_ray_hits_per_px_s", 0.1), ("cosmic_ray_hits_per_px_s", float("nan")),
    ("cosmic_ray_electrons_per_px", -1.0), ("cosmic_ray_depth_px", 0.0)])
def test_bad_rays_are_refused_by_field(field, value):
    with pytest.raises(ConfigError) as error:
        Detector(**(SENSOR | {field: value}))
    assert error.value.path == field
