"""Tables and files of a coma that are none: told by their field, before they take memory or time."""

from __future__ import annotations

import json
import resource
import sys

import comae as coma
import numpy as np
import OpenEXR
import pytest
from glrender import Renderer, Scene
from glrender.base.errors import ConfigError
from glrender.emission.grid_files import Grid, read_grid, write_grid
from glrender.emission.sources.facets import Facets
from glrender.scene.shape.generate import icosphere

SOURCE = "scene.emission[0].sources[0]"


def haser(**changes):
    return {"sources": [{"model": "haser", "afrho_m": 1.0, **changes}]}


@pytest.mark.parametrize("changes, path", [
    ({"sources": [{"model": []}]}, f"{SOURCE}.model"),
    (haser(reach_m=1e300), f"{SOURCE}.reach_m"),
    # Everything was NaN: 0 / 0 in float32.
    ({"dust": {"extinction_efficiency": 1e-300}}, "scene.emission[0].dust.extinction_efficiency"),
    ({"sources": [{"model": "grid", "file": "coma.npz", "cross_section_per_m": 1.0, "channel": "x"}]},
     f"{SOURCE}.channel"),
    ({"sources": [{"model": "grid", "file": "far.npz", "cross_section_per_m": 1.0}]}, f"{SOURCE}.low_m"),
])
def test_a_bad_table_is_told_by_its_field(changes, path, tmp_path):
    density = np.ones((4, 4, 4), np.float32)
    for name, half in (("coma", 1e4), ("far", 1e300)):
        write_grid(tmp_path / f"{name}.npz", Grid(density=density, low_m=np.full(3, -half), high_m=np.full(3, half)))
    with pytest.raises(ConfigError) as caught:
        Scene.from_dict(coma.coma_table(**changes), shape_dir=tmp_path, restricted=True)
    assert str(caught.value).startswith(f"{path}: "), str(caught.value)


@pytest.mark.parametrize("source", [{"afrho_m": 1e300}, {"afrho_m": 1e38},
                                    {"afrho_m": 1.0, "exponent": 4.0, "reference_radius_m": 1e40}])
def test_more_dust_than_float32_holds_is_refused(source):
    """Such a coma was left out, and no error told."""
    scene = Scene.from_dict(coma.coma_table(**haser(**source)))
    with pytest.raises(ConfigError, match="k r\\^2 of at most 1e\\+20 m"):
        Renderer(scene)


def test_strengths_of_facets_have_any_scale():
    """Their sum was infinite, and so the coma empty."""
    shape = icosphere(radius_m=1000.0, subdivisions=2)
    strength, r = np.linspace(1.0, 2.0, len(shape.facets)), np.array([[5e3, 1e3, 0.0], [0.0, -3e3, 2e3]])
    made = [Facets(shape=shape, strength=strength * scale, weight_m=1.0).components(r) for scale in (1.0, 8e307)]
    assert made[0].sum() > 0.0
    np.testing.assert_allclose(made[1], made[0], rtol=1e-5)


def peak_mib():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024.0 if sys.platform == "linux" else 1024.0**2)


def test_a_small_file_that_unpacks_to_a_gibibyte_is_not_unpacked(tmp_path):
    """5.8 MB of such an archive took 5.7 GB and 31 s before it was refused."""
    before = peak_mib()
    np.savez_compressed(tmp_path / "bomb.npz", density=np.zeros((640, 640, 640), np.uint8), low_m=-np.ones(3),
                        high_m=np.ones(3))
    written = peak_mib()
    with pytest.raises(ConfigError, match="at most 16777216 cells"):
        read_grid(tmp_path / "bomb.npz")
    assert peak_mib() - written < 32.0, (before, written, peak_mib())


def sheet(folder, image=None, **changes):
    coma.write_tile_sheet(folder / "coma.json", np.ones((4, 4, 4), np.float32), np.full(3, 1e4))
    if image is not None:
        (folder / "coma.exr").write_bytes(image((folder / "coma.exr").read_bytes()))
    about = {**json.loads((folder / "coma.json").read_text()), **changes}
    (folder / "coma.json").write_text(json.dumps(about))
    return folder / "coma.json"


@pytest.mark.parametrize("image", [lambda data: b"", lambda data: data[:len(data) // 2], lambda data: data[:-20],
                                   lambda data: data[:300] + bytes(40) + data[340:]])
def test_a_broken_image_is_told(image, tmp_path):
    with pytest.raises(ConfigError, match="^tiles_file: is no readable OpenEXR image"):
        read_grid(sheet(tmp_path, image))


def test_an_image_of_another_size_is_not_unpacked(tmp_path, monkeypatch):
    path, opened, original = sheet(tmp_path), [], OpenEXR.File
    coma.write_exr(tmp_path / "coma.exr", {name: np.zeros((64, 96), np.float32) for name in "RGB"})
    monkeypatch.setattr(OpenEXR, "File", lambda *given, **how: opened.append(how) or original(*given, **how))
    with pytest.raises(ConfigError, match=r"^tiles_file: must be an image of 8 x 8 pixels, got \(96, 64\)"):
        read_grid(path)
    assert opened == [{"header_only": True}]


def test_json_without_an_end_of_its_depth_is_told(tmp_path):
    (tmp_path / "deep.json").write_text("[" * 100_000)
    with pytest.raises(ConfigError, match="is no readable JSON"):
        read_grid(tmp_path / "deep.json")
