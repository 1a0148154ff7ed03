"""What a small body's own grid of samples is told to err by, beside rays."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
import views
from glrender import generate
from glrender.area_grid import add_by_area
from glrender.brdf import Lambert
from glrender.error_model import Lattice, LevelTraits
from glrender.scene import Body
from glrender.view import view_bodies
from missing import needed_module

TRUTH_ACROSS, ACROSS, SIZES_PX = 1500, (64, 128, 256), (0.1, 0.7, 2.0, 5.0, 15.0)
SMOOTH, ROUGH = (LevelTraits(n_facets=n, crease_rad=math.radians(deg)) for n, deg in ((80_000, 0.6), (800_000, 18.0)))


def small(size_px, phase_deg=60.0):
    return SimpleNamespace(size_px=size_px, phase_rad=math.radians(phase_deg))


def shapes():
    lumpy = generate.contact_binary(radius_m=100.0, seed=3, subdivisions=5)
    return {"sphere": generate.icosphere(radius_m=100.0, subdivisions=5), "contact binary": lumpy,
            "rough": generate.subdivide_with_relief(lumpy, levels=2, relief=0.06, seed=1)}


class Lattices:
    """Of a body that fills the image: what samples across it see, and the pixels of them at another size."""

    MARGIN = 0.02

    def __init__(self, engine, camera, views_):
        self._engine, self._camera, self._views = engine, camera, views_
        x0, y0, x1, y1 = views_[0].bounds_px
        self.longer_px = max(x1 - x0, y1 - y0)
        margin = self.MARGIN * self.longer_px
        self._low, self._high = np.array([x0, y0]) - margin, np.array([x1, y1]) + margin
        self._sides = self._high - self._low

    def samples(self, across):
        counts = np.ceil(across * self._sides / self.longer_px / (1.0 + 2.0 * self.MARGIN)).astype(int)
        x, y = (low + (np.arange(n) + 0.5) * side / n
                for low, side, n in zip(self._low, self._sides, counts, strict=True))
        at = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        return self._engine.irradiance(at, self._camera, self._views).reshape(counts[::-1])

    def pixels(self, samples, scale, place):
        image = np.zeros((32, 32), np.float32)
        add_by_area(image, samples, (*place, *(place + scale * self._sides)))
        return image.astype(float)


@pytest.mark.parametrize("name", shapes())
def test_what_is_told_of_a_lattice_holds_beside_rays(name):
    """Of ten attitudes, 10 to 130 deg, 0.1 to 15 px, 64 to 256 samples across: nine in ten, and not four times it."""
    needed_module("embreex", "pip install 'glrender[raytrace]'")
    from glrender.ray_engine import RayEngine

    shape, rng, told = shapes()[name], np.random.default_rng(7), []
    level = LevelTraits(n_facets=len(shape.facets), crease_rad=shape.crease_rad)
    camera = views.camera(256, 1000.0)
    scene = views.scene([Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.3))], [camera], sun_disc=False)
    engine = RayEngine(scene)
    for phase_deg in np.linspace(10.0, 130.0, 10):
        q_body = rng.standard_normal(4)
        state = views.state(phase_deg, sun_in_image=rng.standard_normal(2), q_body=q_body / np.linalg.norm(q_body))
        seen = view_bodies(state, camera, scene.hulls)
        lattices = Lattices(engine, camera, seen)
        truth, *coarse = (lattices.samples(across) for across in (TRUTH_ACROSS, *ACROSS))
        for size_px in SIZES_PX:
            scale, place = size_px / seen[0].size_px, 8.0 + rng.random(2)
            model = Lattice.of(small(size_px, phase_deg), level)
            expected = lattices.pixels(truth, scale, place)
            told += [views.relative_rms(lattices.pixels(samples, scale, place), expected)
                     / (model.pixels * model.at(across / (lattices.longer_px * scale)))
                     for across, samples in zip(ACROSS, coarse, strict=True)]
    assert np.mean(np.array(told) <= 1.0) >= 0.9
    assert 0.25 <= np.median(told) <= 1.0


@pytest.mark.parametrize("level", [SMOOTH, ROUGH])
@pytest.mark.parametrize("size_px", [0.01, 1.0, 30.0])
def test_samples_and_errors_are_inverse(level, size_px):
    model = Lattice.of(small(size_px), level)
    for across in (20.0, 100.0, 1000.0):
        assert model.samples_per_px(model.at(across / size_px)) * size_px == pytest.approx(across)


def test_the_error_of_a_body_does_not_depend_on_its_pixels_below_one():
    """Its flux has all of it: the same samples across, the same error."""
    for level in (SMOOTH, ROUGH):
        errors = [(model := Lattice.of(small(size_px), level)).flux * model.at(100.0 / size_px)
                  for size_px in (0.01, 0.5, 1.0, 3.0)]
        np.testing.assert_allclose(errors, errors[0])


def test_rough_facets_smaller_than_samples_are_noise():
    """N^-1 beside N^-1.5; of 800,000 facets from 180 samples across on they are not smaller."""
    noise, edges = (Lattice.of(small(1.0), level) for level in (ROUGH, SMOOTH))
    assert noise.at(50.0) == pytest.approx(2.0 * noise.at(100.0))
    assert noise.at(400.0) == pytest.approx(2.0**1.5 * noise.at(800.0))
    assert edges.at(50.0) == pytest.approx(2.0**1.5 * edges.at(100.0))
    assert noise.at(100.0) > 5.0 * edges.at(100.0)


def test_a_moon_errs_by_its_share_of_the_light():
    alone, beside = (Lattice.of(small(0.3), ROUGH, share) for share in (1.0, 0.01))
    assert beside.flux == pytest.approx(0.01 * alone.flux)
    assert beside.pixels - beside.flux == pytest.approx(alone.pixels - alone.flux)
