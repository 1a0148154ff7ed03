"""Levels of detail: what they keep of a shape's image and flux, and how they are kept on disk."""

from __future__ import annotations

import time
from multiprocessing import get_context

import numpy as np
import pytest
import views
from glrender import Body, Renderer, generate, lod
from glrender.backends.raytrace import RayTracer
from glrender.brdf import Lambert, LommelSeeliger
from glrender.cache import cached_arrays, cached_bytes
from glrender.costs import EngineCosts
from glrender.lod_flux import flux_ratios

GREY = Lambert(normal_albedo=0.3)


@pytest.fixture(scope="module")
def rough():
    """A rough body of 81,920 facets: slopes of some 20 degrees at the smallest scale."""
    shape = generate.gaussian_random_sphere(radius_m=100.0, sigma=0.15, seed=4, subdivisions=4)
    return generate.subdivide_with_relief(shape, levels=2, relief=0.04, seed=1)


@pytest.mark.parametrize("side", [1, 2, 4, 8])
def test_texels_tile_a_facet(side):
    """n * n like parts: inside, each once in its row and column, with their middle in the facet's."""
    weights = lod.texel_barycentric(side)
    assert weights.shape == (side**2, 3) and (weights > 0.0).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    np.testing.assert_allclose(weights.mean(axis=0), 1.0 / 3.0)
    assert len(np.unique(np.round(weights, 9), axis=0)) == side**2
    # The shader's count of texels: row i, place j, and whether the upper part.
    row, column = np.floor(weights[:, 1] * side), np.floor(weights[:, 2] * side)
    upper = weights[:, 1] * side % 1.0 + weights[:, 2] * side % 1.0 > 1.0
    np.testing.assert_array_equal(row * (2 * side - row) + 2 * column + upper, np.arange(side**2))


def test_a_level_lies_on_the_shape_and_carries_its_normals(rough):
    levels = lod.levels_of_detail(rough)
    assert [len(level.facets) for level in levels] == pytest.approx([20480, 5120], rel=0.01)
    for level in levels:
        corner = level.vertices_m[level.facets]
        place = np.einsum("tc,fcx->ftx", lod.texel_barycentric(level.texels_per_side), corner)
        source = rough.vertices_m[rough.facets].mean(axis=1)[level.source_facet]
        edge_m = np.sqrt(rough.facet_areas_m2.mean())
        assert np.median(np.linalg.norm(source - place, axis=-1)) < 1.5 * edge_m
        assert 0.0 < level.deviation_m < 2.0
    assert levels[0].deviation_m < levels[1].deviation_m


def test_a_small_shape_has_no_levels():
    assert lod.levels_of_detail(generate.icosphere(radius_m=1.0, subdivisions=4)) == ()


@pytest.mark.parametrize("phase_deg", [20.0, 60.0, 100.0])
@pytest.mark.parametrize("law", [GREY, LommelSeeliger(single_scattering_albedo=0.3)], ids=lambda law: law.glsl)
def test_the_flux_of_the_lost_relief_is_put_right(rough, law, phase_deg):
    """Over ten aspects that the table was not measured at, against rays: no bias that the plan would not tell."""
    scene = views.scene([Body(name="body", shape=rough, brdf=law)], [views.camera(64, 500.0)])
    rng = np.random.default_rng(5)
    raw, right = [], []
    with Renderer(scene) as renderer, RayTracer(scene) as tracer:
        coarsest = len(lod.levels_of_detail(rough))
        for _ in range(10):
            state = views.state(phase_deg=phase_deg, direction=rng.standard_normal(3),
                                sun_in_image=rng.standard_normal(2))
            truth = tracer.render(state, samples=4).irradiance_W_m2.sum(dtype=np.float64)
            image = renderer.render(state, samples=8, level=coarsest, max_error=0.02)
            flux = image.irradiance_W_m2.sum(dtype=np.float64)
            right.append(flux / truth - 1.0)
            raw.append(flux / image.plan.bodies[0].flux_ratio / truth - 1.0)
    assert abs(np.mean(right)) < 5e-3
    assert np.std(right) < 2.5 * flux_ratios(scene.bodies[0], lod.levels_of_detail(rough))[-1].at(
        np.radians(phase_deg))[1] + 2e-3
    if phase_deg == 100.0:
        assert abs(np.mean(raw)) > 0.025 and abs(np.mean(right)) < 0.2 * abs(np.mean(raw)), "the table puts it right"


def test_a_level_draws_what_the_full_shape_does(monkeypatch, rough):
    """OpenGL's choice at a loose budget is a level, and its error against rays is within the plan's."""
    scene = views.scene([Body(name="body", shape=rough, brdf=GREY)], [views.camera(64, 200.0)])
    state = views.state(phase_deg=40.0)
    with Renderer(scene) as renderer, RayTracer(scene) as tracer:
        monkeypatch.setattr(renderer, "_costs", EngineCosts(facet_ns=100.0, sample_ns=20.0, ray_ns=np.inf))
        truth = tracer.render(state, samples=8).irradiance_W_m2
        image = renderer.render(state, max_error=0.15)
    body, = image.plan.bodies
    assert body.level > 0 and body.n_facets < 25_000
    assert any("facets" in line for line in image.plan.left_out)
    lit = truth > 0.0
    error = np.sqrt(np.mean((image.irradiance_W_m2 - truth)[lit] ** 2)) / truth[lit].mean()
    assert error <= image.plan.predicted_error <= 0.15


def test_a_level_has_no_hole_where_it_reaches_beyond_the_hull():
    """81,920 facets as 5,120, with corners before the full shape's nearest point: the near plane cuts none off."""
    shape = generate.icosphere(radius_m=100.0, subdivisions=6)
    scene = views.scene([Body(name="body", shape=shape, brdf=GREY)], [views.camera(128, 1000.0)])
    _, coarse = lod.levels_of_detail(shape)
    beyond = np.linalg.norm(coarse.vertices_m, axis=1) - np.linalg.norm(shape.vertices_m, axis=1).max()
    assert 0.0 < beyond.max() < 1.5 * coarse.beyond_m
    corners = coarse.vertices_m[np.argsort(beyond)[-5:]]
    with Renderer(scene) as renderer:
        for direction in corners:
            light = renderer.render(views.state(phase_deg=5.0, direction=direction, range_m=1800.0), samples=2,
                                    level=2).irradiance_W_m2
            assert light[30:98, 30:98].min() > 0.5 * light.max()


def test_products_are_told_of_the_full_shape(rough):
    scene = views.scene([Body(name="body", shape=rough, brdf=GREY)], [views.camera(64, 300.0)])
    with Renderer(scene) as renderer:
        names = ["facet_id", "range", "sunlit", "incidence"]
        exact, coarse = (renderer.render(views.state(), products=names, level=level, max_error=0.05)
                         for level in (0, 2))
    for name in names:
        np.testing.assert_array_equal(exact.products[name], coarse.products[name])
    assert exact.products["facet_id"].max() > 25_000


def test_levels_are_kept_and_a_broken_file_is_made_again(tmp_path, rough, monkeypatch):
    made = lod.levels_of_detail(rough, tmp_path)
    file, = tmp_path.glob("lod3-*.npz")
    monkeypatch.setattr(lod, "_made", lambda *_: pytest.fail("made again"))
    kept = lod.levels_of_detail(rough, tmp_path)
    for a, b in zip(made, kept, strict=True):
        np.testing.assert_array_equal(a.facets, b.facets)
        np.testing.assert_array_equal(a.source_facet, b.source_facet)
    monkeypatch.undo()
    file.write_bytes(file.read_bytes()[:1000])
    again = lod.levels_of_detail(rough, tmp_path)
    np.testing.assert_array_equal(again[0].vertices_m, made[0].vertices_m)
    assert lod.levels_of_detail(rough, file)[0].texels_per_side > 0, "no folder: made, not kept"


def test_a_table_of_another_size_is_made_again_and_kept(tmp_path, monkeypatch, caplog):
    """Loops look at no bounds; nothing else is left in the folder, nor where what is there can't be replaced."""
    monkeypatch.setenv("GLRENDER_CACHE", str(tmp_path))
    right, n_made = np.arange(6, dtype=np.uint8).reshape(2, 3), 0

    def make():
        nonlocal n_made
        n_made += 1
        return right

    for wrong in (right[:1], right.astype(np.int16), b"", b"PK", None):
        if isinstance(wrong, bytes):
            (tmp_path / "some.npz").write_bytes(wrong)
        elif wrong is not None:
            np.savez(tmp_path / "some.npz", table=wrong)
        # As a process leaves it that was killed.
        (tmp_path / "some.part.npz").write_bytes(b"half")
        np.testing.assert_array_equal(cached_bytes("some", (2, 3), make), right)
        (tmp_path / "some.part.npz").unlink(missing_ok=True)
    np.save(tmp_path / "some.npy", right)
    (tmp_path / "some.npy").replace(tmp_path / "some.npz")
    np.testing.assert_array_equal(cached_bytes("some", (2, 3), make), right)
    assert n_made == 5 and [file.name for file in tmp_path.iterdir()] == ["some.npz"]
    (tmp_path / "other.npz").mkdir()
    np.testing.assert_array_equal(cached_bytes("other", (2, 3), make), right)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["other.npz", "some.npz"]
    assert "other is not kept" in caplog.text


def _cache(folder, log, barrier):
    def make():
        with open(log, "a") as stream:
            stream.write("made\n")
        time.sleep(0.5)
        return {"a": np.arange(3)}

    barrier.wait()
    assert cached_arrays("some", ["a"], make, folder)["a"].tolist() == [0, 1, 2]


def test_of_processes_that_start_together_one_makes_what_is_kept(tmp_path):
    """Two workers of a server on an empty cache do not both take minutes on two cores."""
    spawn = get_context("spawn")
    barrier = spawn.Barrier(3)
    processes = [spawn.Process(target=_cache, args=(tmp_path / "cache", tmp_path / "log", barrier)) for _ in range(3)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(60.0)
    assert [process.exitcode for process in processes] == [0, 0, 0]
    assert (tmp_path / "log").read_text() == "made\n"
    assert [file.name for file in (tmp_path / "cache").iterdir()] == ["some.npz"], "no lock is left"
