"""SPICE's digital shape kernels, written here by spiceypy: the plates of their source, in kilometres by definition."""

from __future__ import annotations

import numpy as np
import pytest
from glrender import Body, ConfigError, Scene, Shape, ShapeError, generate
from glrender.brdf import Lambert
from glrender.scenario import load_believed_scene
from missing import needed_module

KM = 1000.0


def spice():
    return needed_module("spiceypy", "pip install \"glrender[spice]\"")


def write(path, *segments):
    """A DSK of (surface, shape) of which each has a segment."""
    sp = spice()
    handle = sp.dskopn(str(path), path.stem, 0)
    for surface, shape in segments:
        vertices, plates = shape.vertices_m / KM, shape.facets + 1
        index = sp.dskmi2(vertices, plates, 5.0, 3, 1_000_000, 200_000, 200_000, False, 2_000_000)
        radius = np.linalg.norm(vertices, axis=1)
        sp.dskw02(handle, 2101955, surface, 1, "IAU_BENNU", 1, np.zeros(10), -np.pi, np.pi, -0.5 * np.pi, 0.5 * np.pi,
                  radius.min(), radius.max(), -1e9, 1e9, vertices, plates, *index)
    sp.dskcls(handle, True)
    return path


@pytest.fixture
def rough():
    return generate.three_lobes(radius_m=250.0, subdivisions=3)


@pytest.fixture
def ball():
    return generate.icosphere(radius_m=300.0, subdivisions=2)


@pytest.mark.parametrize("ending", ["bds", "dsk", "BDS"])
def test_a_dsk_is_the_mesh_of_its_source(tmp_path, rough, ending):
    """1e-6 m, facets in their order, and SPICE's pool is as before."""
    path = write(tmp_path / f"one.{ending}", (7, rough))
    n_kernels = spice().ktotal("ALL")
    found = Shape.from_file(path)
    np.testing.assert_array_equal(found.facets, rough.facets)
    np.testing.assert_allclose(found.vertices_m, rough.vertices_m, rtol=0.0, atol=1e-6)
    assert spice().ktotal("ALL") == n_kernels
    with pytest.raises(ShapeError, match=r"one.*length_unit: must be 'km'.*definition, got 'm'; leave it out"):
        Shape.from_file(tmp_path / f"one.{ending}", length_unit="m")
    assert Shape.from_file(tmp_path / f"one.{ending}", length_unit="km").radius_m == found.radius_m


def test_a_surface_of_several_is_chosen(tmp_path, rough, ball):
    """Segments of one surface are one shape; in a scene file and a body likewise."""
    path = write(tmp_path / "two.bds", (7, rough), (9, ball))
    with pytest.raises(ShapeError, match=r"two.bds.surface: missing: the file has 7 and 9; choose: surface = 7"):
        Shape.from_file(path)
    with pytest.raises(ShapeError, match=r"two.bds.surface: must be one of 7 and 9.*got 8"):
        Shape.from_file(path, surface=8)
    assert len(Shape.from_file(path, surface=9).facets) == len(ball.facets)
    body = Body.from_file(path, name="a", brdf=Lambert(normal_albedo=0.1), surface=7)
    assert len(body.shape.facets) == len(rough.facets)
    brdf = {"law": "lambert", "normal_albedo": 0.1}
    table = {"bodies": [{"name": "a", "shape": "two.bds", "surface": 9, "brdf": brdf}],
             "cameras": [{"name": "c", "width_px": 8, "height_px": 8, "focal_length_px": 20.0}]}
    assert len(Scene.from_dict(table, shape_dir=tmp_path).bodies[0].shape.facets) == len(ball.facets)
    (tmp_path / "scene.toml").write_text(
        'bodies = [{name = "a", shape = "two.bds", surface = 9, brdf = {law = "lambert", normal_albedo = 0.1}}]\n'
        'cameras = [{name = "c", width_px = 8, height_px = 8, focal_length_px = 20.0}]\n')
    believed = 'scene = "scene.toml"\nbelief.bodies.a = {{{}}}\n'.format
    (tmp_path / "belief.toml").write_text(believed('shape = "two.bds", surface = 7'))
    assert len(load_believed_scene(tmp_path / "belief.toml").bodies[0].shape.facets) == len(rough.facets)
    (tmp_path / "belief.toml").write_text(believed("surface = 7"))
    with pytest.raises(ConfigError, match=r"belief.bodies.a.surface: goes with `shape`, a file, got 7"):
        load_believed_scene(tmp_path / "belief.toml")
    tiles = [Shape.from_arrays(rough.vertices_m, part) for part in np.array_split(rough.facets, 2)]
    tiled = Shape.from_file(write(tmp_path / "tiles.bds", *((7, tile) for tile in tiles)))
    assert tiled.report.is_watertight and len(tiled.facets) == len(rough.facets)


@pytest.mark.parametrize("make, rule", [
    (lambda whole: whole[:5000], "cut.bds: is cut off: .*got 5000; copy it again, as binary, all"),
    (lambda whole: whole[:-1], "cut.bds: is cut off"),
    (lambda whole: whole[:900], "cut.bds: is no readable DSK.*may be cut off"),
    (lambda whole: whole[:1500] + bytes(len(whole) - 1500), "cut.bds: is "),
    (lambda whole: b"DAF/SPK " + whole[8:], "cut.bds: is no DSK: it must begin with 'DAS/DSK', got 'DAF/SPK '"),
    (lambda whole: b"solid a", "cut.bds: is no DSK")], ids=["half", "tail", "head", "zeros", "SPK", "text"])
def test_files_that_are_no_dsk_are_refused(tmp_path, rough, make, rule):
    (tmp_path / "cut.bds").write_bytes(make(write(tmp_path / "one.bds", (7, rough)).read_bytes()))
    with pytest.raises(ShapeError, match=rule):
        Shape.from_file(tmp_path / "cut.bds")
    assert len(Shape.from_file(tmp_path / "one.bds").facets) == len(rough.facets), "SPICE goes on after an error"


def test_a_segment_of_another_type_is_refused(tmp_path, rough):
    """Its descriptor has surface, body, class and type in a row: no program writes a type but 2."""
    whole = write(tmp_path / "one.bds", (7, rough)).read_bytes()
    found = np.array([7.0, 2101955.0, 1.0, 2.0]).tobytes()
    assert whole.count(found) == 1
    (tmp_path / "four.bds").write_bytes(whole.replace(found, np.array([7.0, 2101955.0, 1.0, 4.0]).tobytes()))
    with pytest.raises(ShapeError, match=r"four.bds.*has a segment of type 4, and only type 2.*mkdsk makes plates"):
        Shape.from_file(tmp_path / "four.bds")


def test_a_kernel_of_places_by_that_name_is_refused(tmp_path):
    """A whole SPK, as SPICE writes it."""
    handle = spice().spkopn(str(tmp_path / "spk.bsp"), "spk", 0)
    spice().spkw08(handle, 10, 0, "J2000", 0.0, 100.0, "s", 1, 2, np.ones((2, 6)), 0.0, 100.0)
    spice().spkcls(handle)
    (tmp_path / "spk.bsp").rename(tmp_path / "spk.bds")
    with pytest.raises(ShapeError, match="spk.bds: is no DSK: it must begin with 'DAS/DSK', got 'DAF/SPK '"):
        Shape.from_file(tmp_path / "spk.bds")


def test_other_rules_have_a_way_out(tmp_path, rough):
    path = write(tmp_path / "one.bds", (7, rough))
    with pytest.raises(ShapeError, match="more than 10 facets.*raise max_facets"):
        Shape.from_file(path, max_facets=10)
    rough.to_file(tmp_path / "one.obj")
    with pytest.raises(ShapeError, match="surface: is a choice among a DSK's surfaces.*leave it out"):
        Shape.from_file(tmp_path / "one.obj", length_unit="m", surface=3)
    with pytest.raises(ShapeError, match="one.obj.length_unit: missing; shape files carry no unit"):
        Shape.from_file(tmp_path / "one.obj")
    (tmp_path / "one.gltf").write_text("{}")
    with pytest.raises(ShapeError, match=r"must end in one of \.bds, \.dsk, .*export it as \.glb"):
        Shape.from_file(tmp_path / "one.gltf", length_unit="m")
