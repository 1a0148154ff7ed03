"""Materials of binary glTF and of OBJ with MTL. Truth: glTF 2.0, ITU-R BT.709 and IEC 61966-2-1, written anew here."""

from __future__ import annotations

import json
import os
import time
from dataclasses import replace

import numpy as np
import pytest
from glb_parts import SHEET_UV, glb, material, png, png_head, sheet
from glrender import Body, ConfigError, Scene, generate
from glrender.brdf import Lambert, Microfacet
from glrender.scenario.belief.belief import BodyBelief
from glrender.scene.shape.textures import MAX_TEXTURE_PX
from glrender.scene.surface import Surface

GREY = Lambert(normal_albedo=0.3)


def at(*place):
    return {"translation": [float(x) for x in place]}


def opened(path, **kwargs):
    return Body.from_file(path, name="sat", length_unit="m", **kwargs)


def three(path, **more):
    """Paint, cells of two sides, and gold, side by side along x."""
    return glb(path / "sat.glb", [sheet(0, at(-2, 0, 0)), sheet(1), sheet(2, at(2, 0, 0))], [
        material("paint", 0.8), {**material("cells", 0.2, rough=0.6), "doubleSided": True},
        material("gold", 0.9, metal=1.0, rough=0.5)], **more)


def linear(value):
    """A linear value of an sRGB one."""
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4


def factors(body, part=0):
    """The factor on the albedo at a part's facets, by texture and texture coordinates."""
    surface = Surface(body.parts[part])
    return surface.albedo_scale(np.arange(len(body.parts[part].shape.facets)))


# Laws


def test_each_facet_has_its_material(tmp_path):
    body = opened(three(tmp_path))
    assert body.materials == {
        "paint": Microfacet(base_albedo=0.8, metalness=0.0, roughness=1.0),
        "cells": Microfacet(base_albedo=0.2, metalness=0.0, roughness=0.6),
        "gold": Microfacet(base_albedo=0.9, metalness=1.0, roughness=0.5)}
    assert [part.brdf for part in body.parts] == list(body.materials.values())
    # By place: cells have their back as well.
    middles = [part.shape.vertices_m[part.shape.facets].mean(axis=(0, 1))[0] for part in body.parts]
    np.testing.assert_allclose(middles, [-2.0, 0.0, 2.0], atol=1e-12)
    assert [len(part.shape.facets) for part in body.parts] == [2, 4, 2]
    for part in body.parts:
        own = body.part_facets[body.parts.index(part)]
        np.testing.assert_array_equal(part.shape.vertices_m[part.shape.facets],
                                      body.shape.vertices_m[body.shape.facets[own]])


def test_materials_that_look_the_same_are_one_part(tmp_path):
    """But not those with images, and not where another law is given for one."""
    given = [*(material(name, grey) for name, grey in (("a", 0.5), ("b", 0.2), ("c", 0.5))),
             material("d", 0.5, baseColorTexture={"index": 0})]
    path = glb(tmp_path / "a.glb", [sheet(k, at(2 * k, 0, 0), SHEET_UV) for k in range(4)], given,
               [png(np.full((2, 2), 99, np.uint8))])
    body = opened(path)
    assert list(body.materials) == ["a", "b", "c", "d"]
    assert [len(part.shape.facets) for part in body.parts] == [4, 2, 2]
    assert sorted(np.concatenate(body.part_facets)) == list(range(8))
    assert len(opened(path, materials={"c": GREY}).parts) == 4


def test_laws_are_replaced_by_name(tmp_path):
    given = opened(three(tmp_path), materials={"cells": GREY}).materials
    assert given["cells"] == GREY and isinstance(given["gold"], Microfacet)


@pytest.mark.parametrize("kwargs, message", [
    ({"materials": {"cels": GREY}}, "must be names .*, got 'cels'; did you mean 'cells'.*paint, cells, gold"),
    ({"materials": {"x": GREY}}, "got 'x'; the file has paint, cells, gold"),
    ({"materials": {"cells": 0.2}}, r"materials\.cells: must be a law"),
    ({"materials": [GREY]}, "materials: must map names"), ({"materials": []}, "materials: must map names"),
    ({"materials": {"cells": GREY}, "brdf": GREY}, "materials: goes without brdf"),
    ({"brdf": "lambert"}, "brdf: must be a law")])
def test_wrong_laws_are_refused(tmp_path, kwargs, message):
    with pytest.raises(ConfigError, match=message):
        opened(three(tmp_path), **kwargs)


def test_one_law_for_all_says_what_it_replaces(tmp_path, caplog):
    body = opened(three(tmp_path), brdf=GREY)
    assert body.parts == (body,) and body.materials is None and body.brdf == GREY
    text = "brdf replaces the file's materials: paint, cells, gold; leave it out to have them"
    assert text in body.shape.report.warnings and text in caplog.text
    assert replace(body, name="other").shape.report.warnings.count(text) == 1


def test_a_file_without_materials_needs_a_law(tmp_path):
    path = glb(tmp_path / "bare.glb", [sheet(None)], [])
    with pytest.raises(ConfigError, match="brdf: missing"):
        opened(path)
    with pytest.raises(ConfigError, match="got 'cells'; the file has none: give brdf"):
        opened(path, materials={"cells": GREY})
    assert opened(path, brdf=GREY).shape.report.warnings == opened(path, brdf=GREY).shape.report.warnings[:1]


def test_facets_without_a_material_are_the_formats_white_metal(tmp_path):
    """Section 3.7.2.1: a default material, whose factors are all 1."""
    body = opened(glb(tmp_path / "a.glb", [sheet(0), sheet(None, at(2, 0, 0))], [material("paint", 0.8)]))
    assert body.materials["default"] == Microfacet(base_albedo=1.0, metalness=1.0, roughness=1.0)
    assert any("2 facets without a material" in text for text in body.shape.report.warnings)


def test_names_are_made_distinct(tmp_path):
    given = [material("m", 0.1), material("m", 0.2), {}]
    body = opened(glb(tmp_path / "a.glb", [sheet(k, at(2 * k, 0, 0)) for k in range(3)], given))
    assert list(body.materials) == ["m", "m.1", "material 2"]
    assert [law.base_albedo for law in body.materials.values()] == [0.1, 0.2, 1.0]


def test_a_scene_file_names_materials(tmp_path):
    three(tmp_path)
    camera = {"name": "c", "width_px": 64, "height_px": 64, "focal_length_px": 100.0}
    table = {"name": "sat", "shape": "sat.glb", "length_unit": "m",
             "materials": {"cells": {"law": "lambert", "normal_albedo": 0.3}}}
    made = lambda **more: Scene.from_dict({"bodies": [{**table, **more}], "cameras": [camera]}, shape_dir=tmp_path)  # noqa: E731
    assert made().bodies[0].materials["cells"] == GREY
    with pytest.raises(ConfigError, match=r"scene\.bodies\[0\]\.materials\.cells\.law: must be one of"):
        made(materials={"cells": {"law": "paint"}})
    with pytest.raises(ConfigError, match=r"scene\.bodies\[0\]\.materials: must be names .* got 'x'"):
        made(materials={"x": {"law": "lambert", "normal_albedo": 0.3}})
    with pytest.raises(ConfigError, match=r"scene\.bodies\[0\]\.materials: must map names"):
        made(materials="cells")
    with pytest.raises(ConfigError, match=r"scene\.bodies\[0\]\.albedo_map: goes with brdf"):
        (tmp_path / "map.png").write_bytes(png(np.zeros((2, 2), np.uint8)))
        made(albedo_texture="map.png", albedo_projection={"kind": "equirectangular", "left_edge_deg": -180.0})


def test_a_belief_scales_all_materials(tmp_path):
    truth = opened(three(tmp_path))
    believed = BodyBelief(albedo_factor=0.5).body(truth)
    assert [law.base_albedo for law in believed.materials.values()] == [0.4, 0.1, 0.45]
    assert BodyBelief(brdf=GREY).body(truth).brdf == GREY
    with pytest.raises(ConfigError, match="brdf: missing"):
        BodyBelief(facets=0.5).body(truth)


# Colours and images


@pytest.mark.parametrize("colour, grey", [((0.8, 0.3, 0.1), 0.2126 * 0.8 + 0.7152 * 0.3 + 0.0722 * 0.1),
                                          ((1.0, 1.0, 1.0), 1.0), ((0.0, 0.0, 1.0), 0.0722)])
def test_a_colour_is_its_luminance(tmp_path, colour, grey):
    given = material("m", baseColorFactor=[*colour, 1.0])
    law = opened(glb(tmp_path / "a.glb", [sheet(0)], [given])).materials["m"]
    np.testing.assert_allclose(law.base_albedo, grey, rtol=1e-12)
    (tmp_path / "a.mtl").write_text(f"newmtl m\nKd {colour[0]} {colour[1]} {colour[2]}\n")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n")
    np.testing.assert_allclose(opened(tmp_path / "a.obj").materials["m"].normal_albedo, grey, rtol=1e-12)


def test_an_images_colours_are_linear_before_they_are_grey(tmp_path):
    """Each quarter of the image has a colour of its own; the factors are linear."""
    colours = np.array([[[255, 0, 0], [0, 128, 0]], [[0, 0, 200], [10, 180, 90]]], np.uint8)
    factor = np.array([0.9, 0.5, 0.7])
    given = material("m", baseColorFactor=[*factor, 0.5], baseColorTexture={"index": 0})
    uv = SHEET_UV[[0, 1, 2, 3]]
    body = opened(glb(tmp_path / "a.glb", [sheet(0, uv=uv)], [given], [png(colours)]))
    part = body.parts[0]
    # u to the right; row 0 of the image is at v = 0, and y = +1/2 of the sheet.
    corners = np.array([part.shape.uv[part.shape.facets == k][0] for k in range(4)])
    np.testing.assert_allclose(corners, [[0, 0], [1, 0], [1, 1], [0, 1]], atol=1e-7)
    want = np.vectorize(linear)(colours / 255.0) * factor @ [0.2126, 0.7152, 0.0722]
    np.testing.assert_allclose(body.materials["m"].base_albedo * part.albedo_map, want, rtol=2e-6)


@pytest.mark.parametrize("image", [np.full((2, 2), 188, np.uint8), np.full((2, 2), 48316, np.uint16)])
def test_grey_images_are_linear_as_well(tmp_path, image):
    given = material("m", 0.5, baseColorTexture={"index": 0})
    body = opened(glb(tmp_path / "a.glb", [sheet(0, uv=SHEET_UV)], [given], [png(image)]))
    np.testing.assert_allclose(0.5 * factors(body), 0.5 * linear(188 / 255.0), rtol=1e-5)


def test_coordinates_are_repeated_and_transformed(tmp_path):
    """Stripes of rows: v runs from 0.5 to 3.5, so a facet crosses three images; a transform by quarter turns."""
    rows = np.repeat([[0], [255]], 2, axis=1).astype(np.uint8).repeat(8, axis=0)
    uv = SHEET_UV * [1.0, 3.0] + [0.0, 0.5]
    given = material("m", baseColorTexture={"index": 0})
    body = opened(glb(tmp_path / "a.glb", [sheet(0, uv=uv)], [given], [png(rows)]))
    surface, weights = Surface(body.parts[0]), np.random.default_rng(1).dirichlet((1.0, 1.0, 1.0), 200)
    facet = np.zeros(len(weights), int)
    vertex = body.parts[0].shape.facets[0]
    y = weights @ body.parts[0].shape.vertices_m[vertex, 1]
    v = (0.5 - y) * 3.0 + 0.5
    is_inside = np.abs(v % 0.5 - 0.25) < 0.2
    assert is_inside.sum() > 100
    np.testing.assert_allclose(surface.albedo_scale(facet, weights)[is_inside], (v % 1.0 > 0.5)[is_inside], atol=1e-6)
    turned = {"index": 0, "extensions": {"KHR_texture_transform": {"rotation": np.pi / 2, "offset": [0.0, 1.0],
                                                                   "scale": [1.0, 1.0]}}}
    body = opened(glb(tmp_path / "b.glb", [sheet(0, uv=SHEET_UV)], [material("m", baseColorTexture=turned)],
                      [png(rows)], extensionsRequired=["KHR_texture_transform"]))
    # [u, v] -> [v, 1 - u] by the extension's matrices; the shape's v counts from below.
    corners = np.array([body.parts[0].shape.uv[body.parts[0].shape.facets == k][0] for k in range(4)])
    np.testing.assert_allclose(corners, np.stack([SHEET_UV[:, 1], SHEET_UV[:, 0]], axis=1), atol=1e-6)


WRAPS = {10497: lambda at, n: at % n, 33071: lambda at, n: np.clip(at, 0, n - 1),
         33648: lambda at, n: np.where(at % (2 * n) < n, at % n, n - 1 - at % n)}


@pytest.mark.parametrize("wrap_u", WRAPS)
@pytest.mark.parametrize("wrap_v", WRAPS)
def test_images_go_on_as_their_sampler_says(tmp_path, wrap_u, wrap_v):
    """REPEAT, CLAMP_TO_EDGE and MIRRORED_REPEAT of glTF 2.0, 5.26, by texels between which is straight; v downwards."""
    image = np.random.default_rng(4).integers(0, 256, (3, 4), dtype=np.uint8)
    uv = SHEET_UV * [3.4, 2.9] - [1.2, 1.6]
    given = material("m", baseColorTexture={"index": 0})
    body = opened(glb(tmp_path / "a.glb", [sheet(0, uv=uv)], [given], [png(image)],
                      textures=[{"source": 0, "sampler": 0}], samplers=[{"wrapS": wrap_u, "wrapT": wrap_v}]))
    (part,), weights = body.parts, np.random.default_rng(5).dirichlet((1.0, 1.0, 1.0), 300)
    place = weights @ part.shape.vertices_m[part.shape.facets[1]]
    u, v = ((place[:, 0] + 0.5) * 3.4 - 1.2) * 4 - 0.5, ((0.5 - place[:, 1]) * 2.9 - 1.6) * 3 - 0.5
    values, low = np.array([[linear(x / 255.0) for x in row] for row in image]), (np.floor(v), np.floor(u))
    # REPEAT is held within half a texel of an image's upper and lower edge.
    is_inside = (wrap_v != 10497) | (np.abs((v + 0.5) / 3 - np.round((v + 0.5) / 3)) > 1 / 6)
    truth = sum(abs(1 - row - (v - low[0])) * abs(1 - column - (u - low[1])) * values[
        WRAPS[wrap_v](low[0].astype(int) + row, 3), WRAPS[wrap_u](low[1].astype(int) + column, 4)]
        for row in (0, 1) for column in (0, 1))
    got = Surface(part).albedo_scale(np.ones(300, int), weights)
    np.testing.assert_allclose(got[is_inside], truth[is_inside], atol=2e-6)
    assert is_inside.sum() > 150


def test_of_metal_and_roughness_the_mean_is_taken_and_told(tmp_path):
    """Roughness is the image's green, metalness its blue, both linear (section 3.9.2)."""
    image = np.zeros((2, 2, 3), np.uint8)
    image[..., 1], image[..., 2] = [[51, 102], [153, 204]], [[0, 0], [255, 255]]
    given = material("m", 0.5, metal=0.8, rough=0.9, metallicRoughnessTexture={"index": 0})
    body = opened(glb(tmp_path / "a.glb", [sheet(0, uv=SHEET_UV)], [given], [png(image)]))
    law = body.materials["m"]
    np.testing.assert_allclose([law.roughness, law.metalness], [0.9 * 0.5, 0.8 * 0.5], rtol=1e-12)
    assert any("material m: metalness 0.4 and roughness 0.45 are the means" in text
               for text in body.shape.report.warnings)


def test_what_is_left_out_is_told(tmp_path):
    given = {**material("m", rough=0.02), "alphaMode": "BLEND", "normalTexture": {"index": 0},
             "extensions": {"KHR_materials_clearcoat": {}}}
    body = opened(glb(tmp_path / "a.glb", [sheet(0)], [given], [png(np.zeros((2, 2), np.uint8))]))
    text = "; ".join(body.shape.report.warnings)
    assert "material m: normalTexture, alphaMode, KHR_materials_clearcoat left out" in text
    assert "roughness 0.02 is drawn as 0.1" in text and body.materials["m"].roughness == 0.1
    (tmp_path / "a.mtl").write_text("newmtl m\nKd 0.5 0.5 0.5\nKs 0 0 0\nd 1.0\nmap_Kd a.png\n")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n")
    warnings = opened(tmp_path / "a.obj").shape.report.warnings
    assert any(text.startswith("material m: map_Kd left out") for text in warnings)


def test_colours_of_vertices_are_left_out_with_a_word(tmp_path):
    path = glb(tmp_path / "a.glb", [sheet(0, uv=SHEET_UV)], [material("m")])
    path.write_bytes(path.read_bytes().replace(b'"TEXCOORD_0"', b'"COLOR_0"   '))
    assert "colours of vertices are left out" in opened(path).shape.report.warnings


def test_colours_that_are_elsewhere_are_asked_for(tmp_path):
    """Where the file does not say, by a format that is not read here, another law or brdf may."""
    basis = {"textures": [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]}
    path = glb(tmp_path / "a.glb", [sheet(0, uv=SHEET_UV)], [material("m", baseColorTexture={"index": 0})], **basis)
    gloss = glb(tmp_path / "b.glb", [sheet(0)], [{"extensions": {"KHR_materials_pbrSpecularGlossiness": {}}}])
    for file, message in ((path, r"materials\.m: missing: its image is none of PNG, JPEG and WebP.*give its law"),
                          (gloss, r"materials\.material 0: missing: .*KHR_materials_pbrSpecularGlossiness")):
        with pytest.raises(ConfigError, match=message):
            opened(file)
        assert opened(file, brdf=GREY).brdf == GREY
    assert opened(path, materials={"m": GREY}).parts[0].brdf == GREY


# OBJ and MTL


def obj(folder, mtl="newmtl white\nKd 0.8 0.8 0.8\nnewmtl black\nKd 0.1 # dark\n", library="two.mtl", first=""):
    (folder / "two.mtl").write_text(mtl)
    (folder / "two.obj").write_text(
        f"mtllib {library}\n" + "".join(f"v {x} {y} 0\n" for x in (0, 1, 2, 3) for y in (0, 1))
        + f"{first}usemtl white\nf 1 3 4 2\nusemtl black\nf 3 5 6 4\nusemtl white\nf 5 7 8\nf 5 8 6\n")
    return folder / "two.obj"


def test_faces_of_an_obj_have_the_material_in_use(tmp_path):
    body = opened(obj(tmp_path))
    assert body.materials == {"white": Lambert(normal_albedo=0.8), "black": Lambert(normal_albedo=0.1)}
    middle = body.shape.vertices_m[body.shape.facets].mean(axis=1)[:, 0]
    np.testing.assert_array_equal(body.shape.material, (np.abs(middle - 1.5) < 0.5).astype(int))


@pytest.mark.parametrize("library", ["two.mtl", "./two.mtl", "none.mtl two.mtl", "my two.mtl", "two.mtl # it"])
def test_libraries_are_named_in_many_ways(tmp_path, library):
    path = obj(tmp_path, library=library)
    if library.startswith("my"):
        (tmp_path / "two.mtl").rename(tmp_path / library)
    assert [law.normal_albedo for law in opened(path).materials.values()] == [0.8, 0.1]


@pytest.mark.parametrize("library", ["../two.mtl", "/etc/passwd", "sub/two.mtl", "none.mtl", "link.mtl", "pipe.mtl"])
def test_only_a_library_in_the_folder_is_opened(tmp_path, library):
    folder = tmp_path / "shapes"
    (folder / "sub").mkdir(parents=True)
    path = obj(folder)
    for place in (tmp_path, folder / "sub"):
        (place / "two.mtl").write_text("newmtl white\nKd 1 1 1\nnewmtl black\nKd 1 1 1\n")
    (folder / "link.mtl").symlink_to(tmp_path / "two.mtl")
    os.mkfifo(folder / "pipe.mtl")
    path = obj(folder, library=library)
    with pytest.raises(ConfigError, match=r"materials\.white: missing: mtllib .*give its law, or brdf for all facets"):
        opened(path)
    assert opened(path, brdf=GREY).shape.report.warnings == opened(path, brdf=GREY).shape.report.warnings
    assert opened(path, materials={"white": GREY, "black": GREY}).materials["black"] == GREY


@pytest.mark.parametrize("mtl, message", [
    ("newmtl white\nKd 0.8 0.8 0.8\n", r"materials\.black: missing: no `newmtl` of this name in two.mtl"),
    ("newmtl white\nKd 1\nnewmtl black\nKd 1.5 0 0\n", r"materials\.black: missing: Kd must be .*got '1.5 0 0'"),
    ("newmtl white\nKd 1\nnewmtl black\nKd spectral a.rfl\n", r"materials\.black: missing: Kd must be"),
    ("newmtl white\nKd 1\nnewmtl black\nKd nan 0 0\n", r"materials\.black: missing: Kd must be")])
def test_materials_that_a_library_does_not_give_are_asked_for(tmp_path, mtl, message):
    with pytest.raises(ConfigError, match=message):
        opened(obj(tmp_path, mtl))
    assert opened(obj(tmp_path, mtl), materials={"black": GREY}).materials["black"] == GREY


def test_facets_before_the_first_usemtl_have_none(tmp_path):
    with pytest.raises(ConfigError, match=r"materials\.without usemtl: missing"):
        opened(obj(tmp_path, first="f 1 3 4\n"))


def test_smooth_parts_have_the_normals_of_the_whole(tmp_path):
    """Along the border of two materials, near the origin and about a centre far from it."""
    shape = generate.icosphere(radius_m=1.0, subdivisions=1)
    is_up = shape.vertices_m[shape.facets].mean(axis=1)[:, 2] > 0.0
    (tmp_path / "two.mtl").write_text("newmtl white\nKd 0.8 0.8 0.8\nnewmtl black\nKd 0.1 0.1 0.1\n")
    for x in (0.0, 30.0):
        lines = ["mtllib two.mtl", *(f"v {a + x} {b} {c}" for a, b, c in shape.vertices_m)]
        for name, chosen in (("white", is_up), ("black", ~is_up)):
            lines += [f"usemtl {name}", *(f"f {a} {b} {c}" for a, b, c in shape.facets[chosen] + 1)]
        (tmp_path / "two.obj").write_text("\n".join(lines))
        body = Body.from_file(tmp_path / "two.obj", name="body", length_unit="m", smooth_normals=True)
        assert body.shape.centre_m.any() == (x > 0.0) and len(body.parts) == 2
        for part, facets in zip(body.parts, body.part_facets, strict=True):
            drawn = part.drawn_shape
            np.testing.assert_array_equal(drawn.vertex_normals[drawn.facets],
                                          body.drawn_shape.vertex_normals[body.shape.facets[facets]])


def test_names_may_have_a_hash_and_a_bare_usemtl_ends_a_material(tmp_path):
    """`Material #25` is a usual name: cut off there, all such are one."""
    (tmp_path / "two.mtl").write_text("newmtl mat#1 # one\nKd 0.1 0.1 0.1#\n# Kd 1 1 1\nnewmtl mat #2\n\tkd 0.9\n")
    text = "mtllib two.mtl # here\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl mat#1\nf 1 2 3#\nusemtl mat #2 # two\n"
    (tmp_path / "a.obj").write_text(text + "f 1 3 4\n")
    body = opened(tmp_path / "a.obj")
    assert {name: law.normal_albedo for name, law in body.materials.items()} == {"mat#1": 0.1, "mat #2": 0.9}
    (tmp_path / "a.obj").write_text(text + "usemtl\nf 1 3 4\n")
    with pytest.raises(ConfigError, match="materials.without usemtl: missing"):
        opened(tmp_path / "a.obj")


@pytest.mark.parametrize("statements, note", [
    ("Ka 1 1 1\nKd 0.5\nKs 0 0 0\nKe 0 0 0\nNi 1.45\nillum 2\nTf 1 1 1\nTr 0\nd 1\nPm 0\n", None),
    ("Kd 0.5\nKe 0.1 0 0\nmap_d -clamp on a.png\nd -halo 0.5\nTf 0.5 0.5 0.5\ndisp b.png\nPr 0.5\n",
     "material m: Ke, map_d, d, Tf, disp, Pr left out; Kd alone"),
    ("Ns 5\n", "material m: Ns left out"), ("Ka 1 1 1\n", "material m: without Kd it is drawn with 0.8")])
def test_statements_that_are_not_drawn_are_told_of_an_mtl(tmp_path, statements, note):
    (tmp_path / "a.mtl").write_text("newmtl m\n" + statements)
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n")
    notes = [text for text in opened(tmp_path / "a.obj").shape.report.warnings if text.startswith("material")]
    assert not notes if note is None else any(text.startswith(note) for text in notes)


# Bad input


def with_image(**more):
    return [material("m", baseColorTexture={"index": 0, **more})]


@pytest.mark.parametrize("materials, images, more, message", [
    ([material("m", baseColorTexture={"index": 1})], [png(np.zeros((2, 2), np.uint8))], {},
     r"materials\[0\]\.pbrMetallicRoughness\.baseColorTexture\.index: must be a number below 1, got 1; export"),
    (with_image(), [], {"textures": [{"source": 3}]}, r"baseColorTexture\.source: must be a number below 0, got 3"),
    ([material("m", baseColorTexture={})], [], {}, r"baseColorTexture\.index: must be a number below 0, got None"),
    (with_image(), [{"uri": "/etc/passwd"}], {}, r"images\.uri: must not be there.*got '/etc/passwd'; export it"),
    (with_image(), [{"bufferView": 99}], {}, r"bufferView: must be a number below 3, got 99"),
    (with_image(), [b"no picture"], {}, "texture cannot be read"),
    (with_image(), [png_head(20000, 20000)], {}, r"at most 16384 pixels a side.*got \(20000, 20000\)"),
    ([material("m", metal=1.5)], [], {}, r"metallicFactor: must be within 0\.\.1, got 1\.5"),
    ([material("m", rough=-0.1)], [], {}, r"roughnessFactor: must be within 0\.\.1, got -0\.1"),
    ([material("m", rough="x")], [], {}, "roughnessFactor: must be 1 numbers, got 'x'"),
    ([material("m", baseColorFactor=[2, 0, 0, 1])], [], {}, r"baseColorFactor: must be within 0\.\.1"),
    ([material("m", baseColorFactor=[1, 0, 0])], [], {}, "baseColorFactor: must be 4 numbers"),
    ([{"pbrMetallicRoughness": 3}], [], {}, "pbrMetallicRoughness: must be an object, got 3"),
    (with_image(), [png(np.zeros((2, 2), np.uint8))], {"textures": [{"source": 0, "sampler": 0}]},
     r"baseColorTexture\.sampler: must be a number below 0, got 0"),
    (with_image(), [png(np.zeros((2, 2), np.uint8))],
     {"textures": [{"source": 0, "sampler": 0}], "samplers": [{"wrapS": 7}]},
     r"baseColorTexture\.samplers: must wrap by one of 10497, 33071, 33648, got 7"),
    (with_image(texCoord=1), [png(np.zeros((2, 2), np.uint8))], {}, "must have TEXCOORD_1.*'m'"),
    (with_image(), [png(np.zeros((2, 2), np.uint8))], {"extensionsRequired": ["KHR_draco_mesh_compression"]},
     "extensionsRequired: must be known.*KHR_draco_mesh_compression")])
def test_hostile_materials_are_refused_soon(tmp_path, materials, images, more, message):
    path, began = glb(tmp_path / "bad.glb", [sheet(0, uv=SHEET_UV)], materials, images, **more), time.process_time()
    for kwargs in ({}, {"brdf": GREY}):
        with pytest.raises(ConfigError, match=rf"bad\.glb.*{message}" if "bufferView" not in message else message):
            opened(path, **kwargs)
    assert time.process_time() - began < 1.0


def test_all_images_of_a_file_are_counted_together(tmp_path):
    """Nine images of 16384 x 1024, of which a file may have eight: refused by their headers."""
    images = [png_head(16384, 1024)] * 9
    assert 9 * 16384 * 1024 > MAX_TEXTURE_PX
    given = [material(f"m{k}", baseColorTexture={"index": k}) for k in range(9)]
    path = glb(tmp_path / "bad.glb", [sheet(k, at(2 * k, 0, 0), SHEET_UV) for k in range(9)], given, images)
    with pytest.raises(ConfigError, match=rf"images: must have at most {MAX_TEXTURE_PX} pixels together"):
        opened(path)


def test_an_image_that_is_cut_off_is_refused_when_it_is_unpacked(tmp_path):
    data = png(np.random.default_rng(1).integers(0, 255, (64, 64), np.uint8))
    path = glb(tmp_path / "bad.glb", [sheet(0, uv=SHEET_UV)], with_image(), [data[:len(data) // 2]])
    with pytest.raises(ConfigError, match=r"materials\.m\.baseColorTexture: texture cannot be read"):
        opened(path)


def test_too_many_repeats_are_refused(tmp_path):
    path = glb(tmp_path / "bad.glb", [sheet(0, uv=SHEET_UV * [1.0, 1e9])], with_image(),
               [png(np.zeros((64, 64), np.uint8))])
    with pytest.raises(ConfigError, match="texture coordinates: must repeat"):
        _ = opened(path).parts


def test_every_cut_of_a_file_is_refused_or_read(tmp_path):
    """Files that end early raise nothing but glrender's own errors."""
    data = three(tmp_path).read_bytes()
    for end in range(0, len(data), 97):
        (tmp_path / "cut.glb").write_bytes(data[:end])
        with pytest.raises(ConfigError):
            opened(tmp_path / "cut.glb")
    assert json.loads(data[20:20 + int.from_bytes(data[12:16], "little")])["materials"][0]["name"] == "paint"
