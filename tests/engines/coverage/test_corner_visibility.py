"""What corners show of a body, what boundaries cut, and the error of it: planes and a sphere, by closed form."""

from __future__ import annotations

import numpy as np
import pytest
import views
from glrender.engines.coverage.boundary_refinement import find_areas
from roofs import EMISSION, HALF_M, LAW, ROOF_M, below_a_roof, seen_of
from scipy.spatial.transform import Rotation


@pytest.mark.parametrize("phase_deg", [0.0, 90.0, 150.0])
def test_corners_of_a_sphere_are_all_lit_and_have_its_light(phase_deg):
    """Lambert's sphere: (sin g + (pi - g) cos g) / pi times two thirds of its disc at full phase."""
    state, camera = views.state(phase_deg=phase_deg, range_m=1e5), views.camera(64, 2e4)
    seen, *_ = seen_of([views.sphere(LAW, 5)], state, camera)
    phase = np.radians(phase_deg)
    expected = 0.3 / np.pi * 2.0 / 3.0 * (np.sin(phase) + (np.pi - phase) * np.cos(phase)) * (100.0 / 1e5 * 2e4) ** 2
    assert seen.light * seen.view.sun_distance_au**2 == pytest.approx(expected, rel=5e-3 / np.cos(0.5 * phase))
    assert len(seen.whole) == len(seen.facing) == seen.n_areas and not len(seen.boundary.facet)
    assert seen.is_alone and not seen.may_stand_before


def test_a_shadow_and_what_is_hidden_leave_facets_whole_crossed_or_dark():
    bodies, state, camera = below_a_roof(5, 200.0, 20.0)
    seen, *_ = seen_of(bodies, state, camera)
    exact_px = ((2.0 * HALF_M) ** 2 - 2.0 * (2.0 * ROOF_M) ** 2) * np.cos(EMISSION)
    assert seen.area_px == pytest.approx(exact_px, rel=5e-3)
    dark = np.setdiff1d(seen.facing, np.concatenate([seen.whole, seen.boundary.facet]))
    middle = seen.facets.corner_m(dark).mean(axis=0)[:2]
    hidden = middle - np.array([-200.0 * np.tan(EMISSION), 0.0])[:, None]
    reach = np.minimum(*(np.abs(Rotation.from_euler("z", 20.0, degrees=True).as_matrix()[:2, :2] @ each).max(axis=0)
                         for each in (middle, hidden)))
    assert len(dark) > 20 and reach.max() < ROOF_M


@pytest.mark.parametrize("turn_deg", [7.0, 31.0])
@pytest.mark.parametrize("tolerance", [0.1, 0.02, 0.005])
def test_clipped_areas_are_those_of_the_closed_form_within_their_error(turn_deg, tolerance):
    """And as tolerances get tighter more is divided; what corners showed stays as it was."""
    bodies, state, camera = below_a_roof(3, 200.0, turn_deg, px_m=2.0)
    seen, views_, rays, _ = seen_of(bodies, state, camera)
    def looks():
        return (seen.hard_edges(rays, views_, camera.focal_length_px)[1].tolist(), seen.low_sun(),
                len(seen.boundary.facet))

    before = looks()
    squared = (tolerance * seen.light) ** 2 / seen.area_px
    areas = find_areas(seen, squared, 1.0)
    r_m = seen.cutter.points.r_m[:2]
    lit_m2 = 4.0 * seen.facet_px(areas.whole).sum() / np.cos(EMISSION)
    for corner, _ in areas.polygons:
        x, y = r_m[:, corner]
        lit_m2 += 0.5 * np.abs((x * np.roll(y, -1, axis=0) - y * np.roll(x, -1, axis=0)).sum(axis=0)).sum()
    exact = (2.0 * HALF_M) ** 2 - 2.0 * (2.0 * ROOF_M) ** 2
    assert areas.squared <= squared
    assert abs(lit_m2 - exact) / 4.0 * np.cos(EMISSION) * seen.brightest <= np.sqrt(areas.squared * seen.area_px)
    assert abs(lit_m2 / exact - 1.0) < max(0.1 * tolerance, 5e-4)
    assert before == looks()


def test_too_much_light_in_too_few_facets_is_told():
    """Of twelve facets of 150 m each would have to be divided more than six times: the parts have an error."""
    bodies, state, camera = below_a_roof(1, 200.0, 7.0)
    seen, *_ = seen_of(bodies, state, camera)
    most = (0.0005 * seen.light) ** 2 / seen.area_px
    areas = find_areas(seen, most, 1.0)
    assert len(areas.large.facet) and areas.squared > most


@pytest.mark.parametrize("turn_deg", [12.0, 40.0])
def test_a_hard_edge_costs_what_the_ramp_in_its_place_differs_by(turn_deg):
    """Across a straight edge the light is the share of the Sun's disc that shows: 3.7 px from dark to bright."""
    bodies, state, camera = below_a_roof(5, 400.0, turn_deg)
    seen, views_, rays, _ = seen_of(bodies, state, camera)
    x = (np.arange(2000) + 0.5) / 2000
    hidden = 0.5 - (np.arcsin(x) + x * np.sqrt(1.0 - x**2)) / np.pi
    wide_px = 2.0 * seen.view.sun_radius_rad * 400.0
    expected = seen.brightest**2 * 8.0 * ROOF_M * wide_px * np.mean(hidden**2)
    _, squared, mean_px = seen.hard_edges(rays, views_, camera.focal_length_px)
    found = squared.sum()
    assert mean_px == pytest.approx(wide_px, rel=0.2)
    assert 0.5 < found / expected < 1.4
