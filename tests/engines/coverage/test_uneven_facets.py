"""Facets so large that their radiance varies: light and centre of boxes against sums over parts of their sides."""

from __future__ import annotations

import numpy as np
import pytest
import solids
import views
from glrender import Body, Renderer, Shape, frames
from glrender.brdf import Hapke, LommelSeeliger
from scipy.spatial.transform import Rotation

LAWS = (LommelSeeliger(single_scattering_albedo=0.3), Hapke(single_scattering_albedo=0.4, b=0.3, c=0.5))


def exact(shape, state, camera, law, count=64):
    """Light [W/m2] and its centre (2,) [px] of a convex body: facets in parts of a `count`-th of their sides each."""
    first, second = np.array([(i, j) for i in range(count) for j in range(count - i)]).T
    upright = np.stack([first + 1 / 3, second + 1 / 3], axis=1)
    turned = np.stack([first + 2 / 3, second + 2 / 3], axis=1)[first + second < count - 1]
    share = np.concatenate([upright, turned]) / count
    a, b, c = (shape.vertices_m[shape.facets[:, k]] for k in range(3))
    place_m = (a[:, None] + share[:, :1] * (b - a)[:, None] + share[:, 1:] * (c - a)[:, None]).reshape(-1, 3)
    normal = np.repeat(shape.facet_normals, len(share), axis=0)
    area_m2 = np.repeat(shape.facet_areas_m2 / count**2, len(share))
    away_m, sun = state.spacecraft.r_inertial_m - place_m, state.r_sun_inertial_m / np.linalg.norm(
        state.r_sun_inertial_m)
    range_m = np.linalg.norm(away_m, axis=1)
    to_camera = away_m / range_m[:, None]
    mu, mu0 = (to_camera * normal).sum(axis=1), normal @ sun
    light = np.where((mu > 0.0) & (mu0 > 0.0), law.brdf(sun, to_camera, normal) * mu0 * mu * area_m2 / range_m**2, 0.0)
    places = camera.project(-away_m @ frames.dcm(state.spacecraft.q_from_inertial).T)
    return views.SOLAR_IRRADIANCE_W_M2 * light.sum(), (light[:, None] * places).sum(axis=0) / light.sum()


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.glsl)
@pytest.mark.parametrize("half_m, range_m", [((80.0, 80.0, 80.0), 2000.0), ((150.0, 20.0, 60.0), 1000.0)])
def test_light_and_centre_of_a_box_are_as_predicted(law, half_m, range_m):
    """With one radiance a facet the centre is 0.1 to 0.3 px off."""
    vertices_m, facets = solids.box(-np.array(half_m), half_m)
    shape = Shape.from_arrays(Rotation.from_rotvec([0.4, -1.1, 0.7]).apply(vertices_m), facets)
    camera = views.camera(240, 0.7 * range_m)
    state = views.state(phase_deg=75.0, range_m=range_m, direction=(1.0, -0.3, 0.6))
    with Renderer(views.scene([Body(name="body", shape=shape, brdf=law)], [camera], sun_disc=False)) as renderer:
        image = renderer.render(state, max_error=0.05)
    window, = image.plan.windows
    assert window.engine == "coverage" and window.has_planes
    light, centre_px = exact(shape, state, camera, law)
    found_px = views.centroid_px(image.irradiance_W_m2)
    assert abs(image.irradiance_W_m2.sum(dtype=float) / light - 1.0) < max(image.plan.predicted["flux"], 5e-5)
    assert np.linalg.norm(found_px - centre_px) < 0.01


def test_small_facets_have_one_radiance_each():
    """Planes are for facets whose light it moves by more than a hundredth of a pixel."""
    scene = views.scene([views.sphere(LAWS[0], subdivisions=4)], [views.camera(200, 2000.0)], sun_disc=False)
    with Renderer(scene) as renderer:
        windows = [renderer.render(views.state(range_m=range_m), max_error=0.02).plan.windows[0]
                   for range_m in (20_000.0, 400.0)]
    assert [window.has_planes for window in windows] == [False, True]
