"""Brightness of vertices: a ball of two materials, drawn in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from arcs import ball_frames
from glrender import generate
from glrender_photogrammetry import Mesh, textured, vertex_brightness


def test_two_materials_differ_by_their_ratio(tmp_path):
    """A half that is twice as bright, whatever the light; what no frame saw lit is nan, and black in the file."""
    mesh = Mesh.of(generate.icosphere(radius_m=100.0, subdivisions=5))
    found = vertex_brightness(ball_frames(100.0, lambda x: np.where(x[..., 2] > 0.0, 2.0, 1.0)), mesh)
    z = mesh.vertices_m[:, 2]
    bright, dark = found[(z > 5.0) & np.isfinite(found)], found[(z < -5.0) & np.isfinite(found)]
    assert min(len(bright), len(dark)) > 500 and np.isnan(found).sum() > 2000
    np.testing.assert_allclose(np.median(bright) / np.median(dark), 2.0, rtol=0.02)
    assert bright.std() / bright.mean() < 0.05 and dark.std() / dark.mean() < 0.05
    np.testing.assert_allclose(np.nanmean(found), 1.0)
    longer = [replace(frame, image=n * frame.image, exposure_s=float(n)) for n, frame in enumerate(ball_frames(
        100.0, lambda x: np.where(x[..., 2] > 0.0, 2.0, 1.0)), start=1)]
    np.testing.assert_allclose(vertex_brightness(longer, mesh), found, rtol=1e-5)
    with pytest.raises(ValueError, match="frames: must be one or more"):
        vertex_brightness([], mesh)
    mesh.to_file(tmp_path / "ball.ply", found)
    grey = np.asarray(trimesh.load(tmp_path / "ball.ply", process=False).visual.vertex_colors)[:, 0]
    seen = np.isfinite(found)
    assert (grey[~seen] == 0).all()
    np.testing.assert_allclose(np.median(grey[(z > 5.0) & seen]) / np.median(grey[(z < -5.0) & seen]), 2.0, rtol=0.03)


@pytest.mark.parametrize("ending", ["obj", "glb"])
def test_a_map_of_texels_has_the_materials_where_the_facets_are(tmp_path, ending):
    """Stripes finer than the facets, read back from the file at places within facets, as a viewer reads them."""
    def stripes(up):
        return np.where(np.sin(12.0 * up[..., 2]) > 0.0, 1.5, 0.5)

    mesh = Mesh.of(generate.icosphere(radius_m=100.0, subdivisions=3))
    textured(ball_frames(100.0, stripes), mesh, n_texels=8).export(tmp_path / f"ball.{ending}")
    back = trimesh.load(tmp_path / f"ball.{ending}", process=False, force="mesh")
    assert len(back.faces) == len(mesh.facets) and back.visual.material is not None
    picture = back.visual.material.image if ending == "obj" else back.visual.material.baseColorTexture
    picture = np.asarray(picture.convert("L"), float)
    faces = np.repeat(back.faces, 4, axis=0)
    weights = np.random.default_rng(1).dirichlet([1.0, 1.0, 1.0], len(faces))
    place, uv = (np.einsum("fk,fkc->fc", weights, np.asarray(each)[faces])
                 for each in (back.vertices, back.visual.uv))
    height, width = picture.shape
    at = np.stack([(1.0 - uv[:, 1]) * height, uv[:, 0] * width], axis=1) - 0.5
    low = np.floor(at).astype(int)
    found = sum(picture[low[:, 0] + i, low[:, 1] + j] * np.abs(1 - i - at[:, 0] + low[:, 0])
                * np.abs(1 - j - at[:, 1] + low[:, 1]) for i in (0, 1) for j in (0, 1))
    up = place / np.linalg.norm(place, axis=1, keepdims=True)
    seen = (found > 5.0) & (np.abs(np.sin(12.0 * up[:, 2])) > 0.5)
    assert seen.sum() > 1000
    bright = stripes(up[seen]) > 1.0
    np.testing.assert_allclose(np.median(found[seen][bright]) / np.median(found[seen][~bright]), 3.0, rtol=0.05)
    assert ((found[seen] > found[seen].mean()) == bright).mean() > 0.97


def test_a_map_needs_a_texel():
    with pytest.raises(ValueError, match="n_texels: must be an integer >= 1, got 0"):
        textured(ball_frames(100.0, lambda up: 1.0 + 0.0 * up[..., 2]), Mesh.of(generate.icosphere(radius_m=1.0)),
                 n_texels=0)
