"""Sources of dust: strengths against Afrho, local time, the dust tail against other ways to propagate, files."""

from __future__ import annotations

import json

import comae
import numpy as np
import pytest
from glrender.base.errors import ConfigError
from glrender.emission.fields import direction_from_octahedral
from glrender.emission.grid_files import Grid, read_exr, read_grid, write_grid
from glrender.emission.light import mean_inverse_distance
from glrender.emission.sources.activity import Activity
from glrender.emission.sources.facets import Facets, noise_strength
from glrender.emission.sources.jets import Jet, surface_point
from glrender.emission.sources.orbit import SUN_GM_M3_S2, propagate, stumpff
from glrender.emission.sources.tail import Tail
from glrender.emission.sources.volume import Volume
from glrender.scene.shape.generate import contact_binary, icosphere
from scipy.integrate import dblquad, solve_ivp

AU_M = 149_597_870_700.0
TAIL = {"weight_m": 5.0, "perihelion_au": 1.24, "eccentricity": 0.64, "true_anomaly_deg": 30.0,
        "pole_inertial": [0.0, 0.1, 1.0], "oldest_s": 60.0 * 86400.0, "length_m": 3e9, "particles": 20_000}


def mean_over_directions(weight, distance_m):
    """By an even grid of the octahedral map, weighted by its solid angle."""
    n = 200
    middle = (np.arange(n) + 0.5) / n
    place = np.stack(np.meshgrid(middle, middle), axis=-1)
    direction = direction_from_octahedral(place)
    # The octahedral map's solid angle goes with |x| + |y| + |z| to the third power.
    share = np.abs(direction).sum(axis=-1) ** 3
    return np.sum(share * weight(distance_m * direction.reshape(-1, 3)).reshape(n, n)) / share.sum()


@pytest.mark.parametrize("width, collimation", [(5.0, 1.0), (20.0, 3.0), (70.0, 1.0)])
def test_a_jet_far_off_has_its_strength_as_mean_over_directions(width, collimation):
    jet = Jet(vent_m=[0.0, 0.0, 1e3], normal=[0.0, 0.0, 1.0], axis=[1.0, 1.0, 3.0], weight_m=2.0, half_width_deg=width,
              collimation=collimation, vent_radius_m=50.0)
    np.testing.assert_allclose(mean_over_directions(jet.weight, 1e8), 2.0, rtol=0.01)
    angle = np.radians(width)
    np.testing.assert_allclose(jet.profile(angle), 0.5, rtol=1e-12)


def test_facets_far_off_have_their_strength_and_face_their_way():
    shape = contact_binary(radius_m=1000.0, seed=1)
    facets = Facets(shape=shape, strength=noise_strength(shape, seed=2), weight_m=3.0, spread=2.0,
                    activity_law=Activity(night=1.0))
    weight = lambda r: facets.activity(np.array([1.0, 0.0, 0.0])) @ facets.components(r)  # noqa: E731
    np.testing.assert_allclose(mean_over_directions(weight, 1e6), 3.0, rtol=0.01)
    sphere = icosphere(radius_m=1000.0)
    day = Facets(shape=sphere, strength=np.ones(len(sphere.facets)),
                 weight_m=1.0, activity_law=Activity(exponent=1.0))
    sun = np.array([0.0, 1.0, 0.0])
    towards, behind = (float((day.activity(sun) @ day.components(sign * 1e6 * sun[None]))[0]) for sign in (1.0, -1.0))
    # K towards the Sun is 4 integral cos^2 over the lit half / 4 pi = 4 (2 pi / 3) / 4 pi; patches keep 3 %.
    np.testing.assert_allclose(towards, 4.0 * (2.0 * np.pi / 3.0) / (4.0 * np.pi), rtol=0.03)
    assert behind < 1e-3


def test_activity_follows_local_time_with_a_lag():
    law = Activity(exponent=1.0, night=0.1, lag_deg=30.0)
    longitude = np.radians(np.arange(0.0, 360.0, 1.0))
    normals = np.stack([np.cos(longitude), np.sin(longitude), np.zeros(360)], axis=1)
    activity = law(normals, np.array([1.0, 0.0, 0.0]))
    # The body turns eastwards: what the Sun stood over earlier is now to the east of noon.
    assert np.argmax(activity) == 30
    np.testing.assert_allclose(activity.max(), 1.0, rtol=1e-12)
    np.testing.assert_allclose(activity.min(), 0.1, rtol=1e-12)


def test_a_vent_is_on_the_surface():
    point, normal = surface_point(icosphere(radius_m=500.0), np.array([0.6, 0.0, 0.8]))
    np.testing.assert_allclose(np.linalg.norm(point), 500.0, rtol=0.01)
    np.testing.assert_allclose(normal @ [0.6, 0.0, 0.8], 1.0, atol=0.01)


def test_stumpff_functions():
    z = np.array([-40.0, -1.0, -1e-3, 0.0, 1e-3, 1.0, 40.0])
    root = np.sqrt(z.astype(complex))
    c = stumpff(z)
    np.testing.assert_allclose(c[0], np.cos(root).real, rtol=1e-12)
    safe = np.where(z == 0.0, 1.0, root)
    np.testing.assert_allclose(c[1], np.where(z == 0.0, 1.0, (np.sin(safe) / safe).real), rtol=1e-12)
    np.testing.assert_allclose(1.0 - z * c[2], c[0], rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(1.0 - z * c[3], c[1], rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("beta", [0.0, 0.3, 1.0, 1.8])
def test_orbits_against_numerical_integration(beta):
    r, v = np.array([1.3 * AU_M, 0.2 * AU_M, 0.0]), np.array([-3e3, 2.9e4, 1e3])
    gm = (1.0 - beta) * SUN_GM_M3_S2
    for time in (80.0 * 86400.0, -200.0 * 86400.0):
        made, speed = propagate(r[None], v[None], np.array([gm]), np.array([time]))
        truth = solve_ivp(lambda t, y: np.concatenate([y[3:], -gm * y[:3] / np.linalg.norm(y[:3]) ** 3]), (0.0, time),
                          np.concatenate([r, v]), method="DOP853", rtol=1e-12, atol=1e-3).y[:, -1]
        np.testing.assert_allclose(made[0], truth[:3], rtol=1e-8, atol=50.0)
        np.testing.assert_allclose(speed[0], truth[3:], rtol=1e-8, atol=1e-4)


def test_syndynes_and_synchrones():
    tail = Tail(**TAIL)
    ages = np.array([1.0, 10.0, 50.0]) * 86400.0
    # Without pressure grains stay with the nucleus.
    np.testing.assert_allclose(tail.grains(np.zeros(3), ages), 0.0, atol=50.0)
    # Soon after leaving: beta g t^2 / 2 away from the Sun.
    r_m = tail.perihelion_au * AU_M * (1.0 + tail.eccentricity) / (
        1.0 + tail.eccentricity * np.cos(np.radians(tail.true_anomaly_deg)))
    age = 3600.0
    drift = tail.grains(np.array([0.5]), np.array([age]))[0]
    np.testing.assert_allclose(drift[0], 0.25 * SUN_GM_M3_S2 / r_m**2 * age**2, rtol=1e-3)
    assert np.abs(drift[1:]).max() < 1e-3 * drift[0]
    # Old grains lag behind the motion, the more the older; the tail keeps to the orbit's plane.
    syndyne = tail.grains(np.full(3, 0.3), ages)
    assert (np.diff(syndyne[:, 0]) > 0.0).all() and (np.diff(syndyne[:, 1]) < 0.0).all()
    np.testing.assert_allclose(syndyne[:, 2], 0.0, atol=1.0)


def test_a_tail_near_its_nucleus_is_the_coma_of_its_strength():
    """Of young grains, what is within a distance is 4 pi K r: dC/dr = 4 pi r^2 k = 4 pi K."""
    tail = Tail(**{**TAIL, "particles": 50_000})
    r, section = tail.sample()
    distance = np.linalg.norm(r, axis=1)
    # Slow large grains take longest: shells in which all sizes are still going straight out.
    low, high = 3e5, 1e6
    inside = section[(distance > low) & (distance < high)].sum() / (high - low)
    np.testing.assert_allclose(inside, 4.0 * np.pi * 5.0, rtol=0.15)
    field = tail.field(500.0)
    assert field.values_m.min() >= 0.0 and max(field.values_m.shape) <= 96
    axes = tail.field_from_body(np.eye(3), np.array([-1.0, 0.0, 0.0]))
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(axes[0], [1.0, 0.0, 0.0], atol=1e-12)


def test_grids_on_disk(tmp_path):
    rng = np.random.default_rng(5)
    density = rng.uniform(size=(6, 7, 8)).astype(np.float32)
    write_grid(tmp_path / "a.npz", Grid(density=density, low_m=np.array([-1.0, -2.0, -3.0]), high_m=np.ones(3)))
    read = read_grid(tmp_path / "a.npz")
    np.testing.assert_array_equal(read.density, density)
    np.testing.assert_array_equal(read.low_m, [-1.0, -2.0, -3.0])


def test_a_tile_sheet_is_cut_as_comacreator_laid_it_out(tmp_path):
    """Slice i in tile (i % across, i // across), row y, column z: as its loop writes pixels one by one."""
    n, across = 7, 3
    rng = np.random.default_rng(6)
    cube = rng.uniform(size=(n, n, n)).astype(np.float32)
    sheet = np.zeros((n * across, n * across), np.float32)
    for i in range(n):
        for j in range(n):
            for k in range(n):
                sheet[(i // across) * n + j, (i % across) * n + k] = cube[i, j, k]
    comae.write_exr(tmp_path / "coma.exr", {"R": 0.0 * sheet, "G": sheet, "B": 2.0 * sheet})
    about = {"dimensions": [20.0, 20.0, 20.0], "resolution": n, "tiles_x": across, "tiles_y": across,
             "tiles_file": "/somewhere/else/coma.exr"}
    (tmp_path / "coma.json").write_text(json.dumps(about), encoding="utf-8")
    read = read_grid(tmp_path / "coma.json")
    np.testing.assert_array_equal(read.density, cube)
    np.testing.assert_array_equal(read.high_m, [1e4, 1e4, 1e4])
    np.testing.assert_array_equal(read_grid(tmp_path / "coma.json", "gas").density, 2.0 * cube)
    comae.write_tile_sheet(tmp_path / "own.json", cube, np.full(3, 2e4))
    np.testing.assert_allclose(read_grid(tmp_path / "own.json").density, cube / cube.max(), rtol=1e-6)
    np.testing.assert_array_equal(read_exr(tmp_path / "coma.exr", "G", sheet.shape), sheet)


@pytest.mark.parametrize("change, field", [
    ({"resolution": 8}, "tiles_file"), ({"tiles_x": 1, "tiles_y": 1}, "tiles_x"),
    ({"dimensions": [1.0, 2.0]}, "dimensions"),
    ({"dimensions": [1.0, -2.0, 1.0]}, "dimensions[1]"), ({"tiles_file": "none.exr"}, "tiles_file"),
    ({"resolution": "7"}, "resolution")])
def test_a_bad_tile_sheet_is_told_by_its_field(tmp_path, change, field):
    comae.write_tile_sheet(tmp_path / "own.json", np.ones((7, 7, 7)), np.full(3, 2e4))
    about = json.loads((tmp_path / "own.json").read_text(encoding="utf-8")) | change
    (tmp_path / "own.json").write_text(json.dumps(about), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        read_grid(tmp_path / "own.json")
    assert str(caught.value).startswith(field)


@pytest.mark.parametrize("name, content", [("a.npz", b"no zip"), ("a.json", b"{"), ("a.json", b"[]"), ("a.txt", b"")])
def test_what_is_no_grid_is_refused(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ConfigError):
        read_grid(tmp_path / name)


def test_a_volume_of_an_even_coma_has_its_weight_in_every_cell():
    n, half = 40, 2e4
    middle = (np.arange(n) + 0.5) / n * 2.0 * half - half
    squared = sum(axis**2 for axis in np.meshgrid(middle, middle, middle, indexing="ij"))
    volume = Volume(cross_section_per_m=4.0 / squared, low_m=[-half] * 3, high_m=[half] * 3)
    values = volume.field(500.0).values_m
    far = squared > (10.0 * half / n * 2.0) ** 2
    np.testing.assert_allclose(values[far], 4.0, rtol=4e-3)


def test_mean_of_one_over_distance_over_a_pixel():
    """4 ln(1 + sqrt 2) in the middle; a double integral beside it."""
    np.testing.assert_allclose(mean_inverse_distance(np.array(0.0), np.array(0.0)), 4.0 * np.log(1.0 + np.sqrt(2.0)))
    for x, y in ((1.0, 0.0), (0.7, 1.9), (-3.0, 0.2)):
        truth = dblquad(lambda b, a: 1.0 / np.hypot(a, b), x - 0.5, x + 0.5, y - 0.5, y + 0.5)[0]
        np.testing.assert_allclose(mean_inverse_distance(np.array(x), np.array(y)), truth, rtol=1e-7)
