"""Which bodies may cast on which."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import views
from eclipses import SUN_RAD, eclipsed
from glrender import Pose, generate
from glrender.base.constants import AU_M
from glrender.scene.shape.convex_hull import Hull
from glrender.view.occluders import casters
from glrender.view.view import view_bodies
from scipy.spatial.transform import Rotation


@pytest.mark.parametrize("place_m, sun_radius_rad, is_caster", [
    ((400.0, 0.0, 0.0), 0.0, True), ((400.0, 119.0, 0.0), 0.0, True), ((400.0, 121.0, 0.0), 0.0, False),
    ((-150.0, 0.0, 0.0), 0.0, False), ((0.0, 119.0, 0.0), 0.0, True), ((20_000.0, 200.0, 0.0), 0.0, False),
    ((20_000.0, 200.0, 0.0), SUN_RAD, True), ((20_000.0, 0.0, 215.0), SUN_RAD, False)],
    ids=["before it", "grazing", "beside it", "behind it", "at its side", "far aside", "its penumbra reaches",
         "its penumbra does not"])
def test_what_is_before_the_sun_casts(place_m, sun_radius_rad, is_caster):
    """A moon of 20 m, a body of 100 m; at 20,000 m the Sun's radius is as wide as 93 m."""
    found, *_ = eclipsed(place_m, 20.0, sun_radius_rad=sun_radius_rad)
    assert [name for name, *_ in found] == (["moon"] if is_caster else [])


def test_a_caster_s_place_is_told_in_the_receiver_s_frame():
    ((_, rotation, shift_m),), view, _, state = eclipsed((400.0, 30.0, -10.0), 20.0, phase_deg=50.0)
    np.testing.assert_allclose(rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(shift_m, state.bodies["moon"].r_inertial_m, atol=1e-6)
    assert shift_m @ view.sun_direction_body == pytest.approx(400.0, rel=1e-6)


@pytest.mark.parametrize("widths_m", [(60.0, 60.0, 300.0), (100.0, 100.0, 10.0)])
def test_a_tilted_body_casts_on_what_its_sunward_end_is_before(widths_m):
    """Of a long or flat ellipsoid the sunward end; the middle of a small sphere is sunward of its own."""
    sphere = generate.icosphere(radius_m=1.0, subdivisions=4)
    turned = Rotation.from_euler("y", 45.0 if widths_m[2] > 100.0 else -45.0, degrees=True)
    hulls = {"small": Hull(10.0 * sphere.vertices_m, sphere.facets),
             "tilted": Hull(turned.apply(sphere.vertices_m * widths_m), sphere.facets)}
    state, camera = views.state(60.0, bodies=["small", "tilted"]), views.camera(64, 400.0)
    end_m = 0.5 * max(widths_m)
    posed = replace(state, r_sun_inertial_m=[0.0, 0.0, AU_M], bodies={
        "small": Pose(r_inertial_m=[end_m, 0.0, 0.4 * end_m]), "tilted": Pose(r_inertial_m=np.zeros(3))})
    small, tilted = view_bodies(posed, camera, hulls)
    assert [name for name, *_ in casters(small, [small, tilted], hulls)] == ["tilted"]
