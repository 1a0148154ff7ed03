"""The planner's numbers are those of docs/rendering.md and docs/accuracy.md, to a few per cent. Without GL.

Each number is a limit of the documents: the plan changes between a little below it and a little above.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from glrender.planner import error_model, small_body_grid
from glrender.planner.penumbra import Penumbra, sun_points
from glrender.planner.predicted import frame_errors
from glrender.planner.request import ImageUse
from glrender.view.regions import Group
from planning import CAMERA, body, seen, traits, view, ways

ACCURACY = (Path(__file__).parents[2] / "docs" / "accuracy.md").read_text(encoding="utf-8")
BELOW, ABOVE = 0.96, 1.04


def first(member, known=None, tolerance=0.02, penumbra=None, engine=None, **planned):
    """The first way to draw a body."""
    return ways([seen(member, known, penumbra=penumbra, **planned)], tolerance, engine=engine)[0][0]


def test_rays_from_300_facets_a_pixel_and_100_000_facets():
    """Facets that face Sun and camera: a third of them at 60 deg, on 0.6 of the square around the body."""
    size_px = 20.0
    limit = 300.0 * 3.0 * 0.6 * size_px**2
    found = [first(view(size_px=size_px), traits(n_facets=int(times * limit))).how for times in (BELOW, ABOVE)]
    assert found == ["centroids", "rays"]
    small = [first(view(size_px=5.0), traits(n_facets=n)).how for n in (96_000, 104_000)]
    assert small == ["centroids", "rays"]


def test_centroids_want_one_facet_in_20_pixels():
    """Half of the facets face a pixel's side, on 0.6 of the square."""
    limit_px = math.sqrt(20.0 * 0.5 / 0.6 * 10_000)
    found = [first(view(size_px=times * limit_px), traits(n_facets=10_000)).how for times in (0.97, 1.03)]
    assert found == ["centroids", "coverage"]


def test_centroids_up_to_123_degrees_anywhere_on_the_body():
    """A radius of 100 m seen from 1000 m: 5.7 deg less at its middle; a flat response leaves the tolerance alone."""
    found = [first(view(size_px=200.0, phase_deg=phase_deg), tolerance=0.9).how for phase_deg in (116.0, 119.0)]
    assert found == ["centroids", "coverage"]


@pytest.mark.parametrize("phase_deg, limit", [(30.0, 0.0086), (60.0, 0.0086), (90.0, 0.045)])
def test_centroids_down_to_the_tolerance_that_leaves_room_for_the_flux(phase_deg, limit):
    member = view(size_px=200.0, phase_deg=phase_deg)
    assert [first(member, tolerance=times * limit).how for times in (BELOW, ABOVE)] == ["coverage", "centroids"]


def test_facets_of_one_radiance_within_0_7_of_the_tolerance():
    """0.44 of a facet's side over its range times the change of the radiance, of highlights; others are planes."""
    middle = np.array([510.0, 510.0, 513.0, 513.0]) + [0, 0, 10, 10]
    member = view(size_px=13.0, bounds_px=middle)
    sides_m = [times * 0.7 * 0.02 * 900.0 / 0.44 / 5.0 for times in (BELOW, ABOVE)]
    for slope, expected in ((5.0, ["coverage", "raster"]), (2.9, ["coverage", "coverage"])):
        each = [traits(n_facets=5_000, facet_m=5.0 / slope * side_m, view_slope=lambda _, slope=slope: slope)
                for side_m in sides_m]
        assert [first(member, known).engine for known in each] == expected


@pytest.mark.parametrize("phase_deg, crease_rad, tolerance, casters, texels, engine", [
    (60.0, 0.1, 0.02, (), 1024, "raster"), (20.0, 0.4, 0.05, (), 512, "raster"), (130.0, 0.6, 0.02, (), 4096, "rays"),
    (90.0, 0.15, 0.005, (), 4096, "raster"), (45.0, 0.1, 0.002, ("moon",), 4096, "raster")])
def test_a_shadow_map_is_as_fine_as_the_formula_says(phase_deg, crease_rad, tolerance, casters, texels, engine):
    """Texels by the formula of docs/rendering.md; where that many leak too much, rays draw."""
    member, known = view(size_px=250.0, phase_deg=phase_deg), traits(crease_rad=crease_rad, facet_m=math.inf)
    phase_rad, tangent = math.radians(phase_deg), math.tan(0.5 * math.radians(phase_deg))
    edges = 1.0 if casters else min(0.1 * phase_rad, 0.2)
    leak = 1.9 * max(tangent**1.2, tangent**1.57) * max(crease_rad / 0.146, 1.0) ** 1.5
    side_px = 250.0 * 1000.0 / 900.0
    wanted = max(side_px * (0.094 * edges / tolerance**2) ** (1 / 3), side_px, leak / (0.1 * tolerance))
    assert texels == min(max(2 ** math.ceil(math.log2(wanted)), 256), 4096)
    assert engine == ("raster" if 2.0 * leak / texels <= tolerance else "rays")
    assert body(member, known, tolerance, casters).shadow_map_px == texels
    assert first(member, known, tolerance, casters=casters).engine == engine


@pytest.mark.parametrize("phase_deg, crease_rad, n_facets, flux", [
    (10.0, 0.1, 1e4, 0.002), (60.0, 0.3, 1e6, 0.001), (120.0, 0.2, 1e5, 0.005)])
def test_samples_across_a_body_below_32_px_follow_the_formula(phase_deg, crease_rad, n_facets, flux):
    counts = np.array([64, 96, 128, 192, 256, 384, 512, 768, 1024])
    lit = 0.5 * (1.0 + math.cos(math.radians(phase_deg)))
    creases = 0.67 * crease_rad**0.8 * np.minimum(np.sqrt(math.sqrt(n_facets / 24.0) / counts), 1.0)
    error = 2.8 * lit**-1.65 * np.sqrt(0.22 / counts + creases**2) / counts
    known = traits(n_facets=n_facets, crease_rad=crease_rad)
    found = small_body_grid.samples_across(view(size_px=10.0, phase_deg=phase_deg), known, flux)
    assert found == counts[np.flatnonzero(error <= flux)[0]]


def test_the_sun_has_4_points_up_to_1_75_times_the_tolerance_and_8_beyond():
    """Steps of 4 points leave 0.4 of a hard edge's error, 8 leave 0.25; penumbras may take 0.7 of the tolerance."""
    found = [sun_points(times * 0.02, 0.02) for times in (0.69, 0.71, 1.74, 1.76, 2.81)]
    assert [n_points for n_points, _ in found] == [1, 4, 4, 8, 8]


def test_rays_in_a_penumbra_wider_than_0_3_of_the_body_or_that_changes_its_light():
    """By 0.7 of a tenth of the tolerance."""
    member = view(size_px=100.0)
    for times, engine in ((BELOW, "coverage"), (ABOVE, "rays")):
        for penumbra in (Penumbra(cast_px=times * 30.0), Penumbra(hard_flux=times * 0.7 * 0.1 * 0.02)):
            assert first(member, penumbra=penumbra, casters=("moon",)).engine == engine


def test_a_grid_of_its_own_below_4_px():
    assert [first(view(size_px=size_px)).samples == 0 for size_px in (3.9, 4.1)] == [True, False]


def test_rays_hold_the_flux_of_bodies_below_32_px():
    rough = traits(n_facets=10_000_000, crease_rad=0.35)
    found = [first(view(size_px=size_px), rough, 0.001, engine="rays").samples for size_px in (31.0, 33.0)]
    assert found[0] > 4 and found[1] == 2


def test_rays_are_a_million_at_first_and_four_times_as_many_by_opengl():
    """Of a region 0.8 times as high as wide, 2 x 2 a pixel."""
    sides_px = [times * math.sqrt(2.0**20 / 4.0 / 0.8) for times in (BELOW, ABOVE)]
    assert [first(view(size_px=side_px), engine="rays").samples for side_px in sides_px] == [2, 1]
    assert [first(view(size_px=side_px), engine="raster").samples for side_px in sides_px] == [2, 2]


def test_crescents_beyond_120_degrees_begin_with_4_x_4():
    found = [first(view(size_px=200.0, phase_deg=phase_deg), engine="rays").samples for phase_deg in (112.0, 122.0)]
    assert found == [2, 4]


def test_estimates_rise_from_146_degrees_on_to_2_2_at_174():
    assert error_model.crescent_gain(math.radians(145.0)) == 1.0 < error_model.crescent_gain(math.radians(147.5))
    assert error_model.crescent_gain(math.radians(174.0)) == pytest.approx(2.2, rel=0.02)


def test_noise_errs_as_it_was_measured_and_little_more():
    """Four rough shapes: 1.1, 1.2, 1.3, 1.7 times the error of an edge at 0.6, 2, 6, 20 facets a sample."""
    for n_facets, measured in ((0.6, 1.1), (2.0, 1.2), (6.0, 1.3), (20.0, 1.7), (300.0, 1.7)):
        assert measured <= error_model.noise_gain(0.4, n_facets) <= 1.15 * measured
    assert error_model.noise_gain(0.15, 20.0) == 1.0, "of smooth shapes none"
    assert error_model.noise_power(error_model.noise_gain(0.4, 20.0)) == pytest.approx(2.0)


def test_rays_rounding_is_that_of_a_pillar_s_shadow():
    """0.0055 at 5e-6 radii a pixel; at 4e-5 an eighth of it; below 1e-5, with coordinates about the camera, half."""
    found = error_model.ray_rounding_error(replace(view(), footprint_m=4e-3), traits())
    assert 0.0055 / 8.0 <= found <= 1.2 * 0.0055 / 8.0
    near = error_model.ray_rounding_error(replace(view(), footprint_m=1e-9), traits())
    assert near == pytest.approx(4.0 * found)


def _table():
    """Factors of the documented laws by unit, of clipped coverage, centroids and samples; powers of area and share."""
    number = r" ([\d.]+) \|"
    rows = re.findall(rf"^\| `(\w+)` \|{3 * number} A\^([-\d/]+) s\^([-\d/]+) \|", ACCURACY, re.M)

    def power(text):
        over, _, under = text.partition("/")
        return float(over) / float(under)

    return {unit: (*map(float, factors), power(area), power(lit)) for unit, *factors, area, lit in rows}


@pytest.mark.parametrize("how, column, times", [
    ("coverage", 0, 1.0), ("centroids", 1, 1.0), ("rough centroids", 1, 1.8), ("rays", 2, 1.0), ("raster", 2, 1.0)])
@pytest.mark.parametrize("size_px, phase_deg", [(50.0, 20.0), (400.0, 130.0)])
def test_errors_by_unit_follow_the_documented_table(how, column, times, size_px, phase_deg):
    """A large RMS error, beside which the least that is promised is nothing; the area is that of the body's box."""
    member, rms = view(size_px=size_px, phase_deg=phase_deg), 50.0
    area, lit = 0.8 * size_px**2, 0.5 * (1.0 + math.cos(math.radians(phase_deg)))
    found, table = frame_errors([(Group.of([member], CAMERA), how, rms, 0.0)]), _table()
    assert set(table) == set(found)
    for unit, row in table.items():
        assert found[unit] == pytest.approx(times * rms * row[column] * area ** row[3] * lit ** row[4], rel=1e-3), unit


@pytest.mark.parametrize("asked, wanted", [(0.02, "rough centroids"), ({"limb_px": 0.05}, "coverage")])
def test_rough_facets_by_centroids_err_more_and_are_clipped_sooner_where_a_unit_is_asked_for(asked, wanted):
    """A limb to 0.05 px: smooth facets by centroids may err by 1.8 times as much as rough ones, in RMS."""
    member, hows = view(size_px=300.0), []
    for crease_rad in (0.148, 0.152):
        window = first(member, traits(n_facets=300_000, crease_rad=crease_rad, facet_m=1.0), asked)
        hows.append(window.how)
    assert hows == ["centroids", wanted]


def test_no_less_is_promised_than_the_document_says():
    """3e-5, 3e-4 px, 0.012 px, and 0.002 px of the mean limb over the root of the area."""
    least = ("3e-5 for `flux`", "3e-4 px for `centroid_px`", "0.012 px for `limb_px`", "mean limb by 0.002 px")
    assert [text for text in least if text in " ".join(ACCURACY.split())] == list(least)
    found = frame_errors([(Group.of([view(size_px=100.0)], CAMERA), "coverage", 0.0, 0.0)])
    side_px = math.sqrt(0.8) * 100.0
    assert found == pytest.approx({"flux": 3e-5, "centroid_px": 3e-4, "limb_px": 0.012, "range": 0.002 / side_px})


def test_cells_are_16_to_32_across_and_2048_at_most():
    for size_px, phase_deg, n_across in ((0.01, 60.0, 21), (0.5, 60.0, 17), (3.0, 60.0, 25), (1000.0, 175.0, 2001)):
        member = view(size_px=size_px, phase_deg=phase_deg, bounds_px=np.array([0.5, 0.5, 0.5, 0.5])
                      + size_px * np.array([0.0, 0.0, 1.0, 0.8]))
        (option, *_), = ways([seen(member, traits(n_facets=9_000))], 0.005, ImageUse(apart_px=256.0), engine="coverage")
        assert max(option.grid) == n_across


def test_a_pixel_s_solid_angle_varies_off_the_boresight():
    """By cos^3: its spread over a pixel, numerically; what is predicted is above it, by no more than a half."""
    found = first(view(size_px=100.0, bounds_px=np.array([920.0, 470.0, 1020.0, 550.0]))).modelled["uneven facets"]
    focal_px, middle_px = CAMERA.focal_length_px, CAMERA.principal_point_px
    offset = (np.arange(64) + 0.5) / 64 - 0.5
    x, y = np.meshgrid(1020.0 + offset - middle_px[0], 550.0 + offset - middle_px[1])
    angle = (1.0 + (x**2 + y**2) / focal_px**2) ** -1.5
    spread = angle.std() / angle.mean()
    assert spread <= found <= 1.5 * spread


def test_an_eclipse_begins_with_4_x_4_rays_a_pixel_up_to_100_000():
    penumbra = Penumbra(eclipse_px=5.0, left=0.5)
    for times, samples in ((BELOW, 4), (ABOVE, 3)):
        size_px = times * math.sqrt(1e5 / 16.0 / 0.8)
        found = first(view(size_px=size_px), penumbra=penumbra, casters=("moon",), engine="rays")
        assert found.samples == samples and found.eclipse_px == 5.0


def test_coordinates_of_float32_are_off_by_half_a_step():
    """2^-24 of their size; a pixel that they are off errs by 0.04 at most as measured, and by no more than 0.1 here."""
    seen, known = replace(view(), footprint_m=1e-6), traits()
    assert error_model.rounding_px(seen, known, False) == pytest.approx(100.0 * 2.0**-24 / 1e-6)
    relative_px = error_model.rounding_px(seen, replace(known, longest_side_m=1.0), True)
    assert relative_px == pytest.approx(200.0 * 2.0**-24 / 1e-6), "of the body's diameter at most"
    assert 0.04 <= error_model.rounding_error(replace(view(), footprint_m=100.0 * 2.0**-24), known, False) <= 0.1


def test_edges_of_shadows_have_a_tenth_of_the_squared_error_a_radian_and_a_fifth_at_most():
    """Round choices; of a part of a body, or in another's shadow, they may be all that there is."""
    for phase_rad, share in ((0.5, 0.05), (1.9, 0.19), (2.5, 0.2)):
        assert error_model.usual_edges(replace(view(), phase_rad=phase_rad), False) == pytest.approx(share)
    assert error_model.usual_edges(view(), True) == error_model.usual_edges(view(size_px=np.inf), False) == 1.0

