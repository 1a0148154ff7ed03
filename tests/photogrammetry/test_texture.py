"""Brightness of vertices: a ball of two materials, drawn in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from arcs import ball_frames
from glrender import generate
from glrender_photogrammetry import Mesh, vertex_brightness


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
