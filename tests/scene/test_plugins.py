"""Plug-ins as packages of their own: one that works, and broken ones that break nothing else."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from glrender import ConfigError, Scene, open_renderer
from glrender.base.errors import PluginError
from glrender.scene.plugins import registry as plugins
from plugin_law import EXAMPLE, GOOD, SCENE


def scene_with(law, **parameters):
    return Scene.from_dict({**SCENE, "bodies": [{**SCENE["bodies"][0], "brdf": {"law": law, **parameters}}]})


def test_the_example_installed_as_a_package_draws(tmp_path):
    """By pip, into a folder of its own; another process renders with it, and its twin agrees with its Python."""
    installed = tmp_path / "site"
    subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps",
                    "--no-build-isolation", "--target", installed, EXAMPLE], check=True, timeout=120)
    code = f"""
import sys
sys.path.append({str(Path(__file__).parents[1] / 'support')!r})
import numpy as np, views
from glrender import Renderer, Scene
from glrender.scene.plugins import registry as plugins
scene = Scene.from_dict({{**{SCENE!r}, "bodies": [{{**{SCENE["bodies"][0]!r}, "brdf":
    {{"law": "dusty_lambert", "normal_albedo": 0.4, "scale_deg": 40.0}}}}]}})
law = scene.bodies[0].brdf
plain = Scene.from_dict({SCENE!r})
with Renderer(scene) as renderer, Renderer(plain) as other:
    state = views.state(phase_deg=70.0, range_m=2e5)
    dark, bright = (r.render(state, samples=16).irradiance_W_m2.sum() for r in (renderer, other))
    v = np.random.default_rng(1).normal(size=(3, 4000, 3))
    v /= np.linalg.norm(v, axis=-1, keepdims=True)
    np.testing.assert_allclose(renderer.evaluate_brdf(law, *v), law.brdf(*v), rtol=1e-5, atol=1e-8)
assert not plugins.problems()
print(dark / bright)
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120,
                         env={**os.environ, "PYTHONPATH": str(installed)})
    assert ran.returncode == 0, ran.stderr
    # The phase at 200 km is within 0.03 deg of 70 deg all over the sphere.
    np.testing.assert_allclose(float(ran.stdout), np.exp(-70.0 / 40.0), rtol=1e-3)


def test_the_documentation_prints_the_examples_entry_point():
    page = (EXAMPLE.parent.parent / "docs" / "plugins.md").read_text(encoding="utf-8")
    assert (EXAMPLE / "pyproject.toml").read_text(encoding="utf-8").split("\n\n")[-1] in page


@pytest.mark.parametrize("text, message", [
    ("import a_missing_module", "of broken 1.5 needs 'a_missing_module', which is not installed"),
    ("raise RuntimeError('no luck')", "of broken 1.5 cannot be loaded: RuntimeError: no luck"),
    ("import sys; sys.exit(3)", "of broken 1.5 cannot be loaded: SystemExit: 3"),
    ("pass", "of broken 1.5 cannot be loaded: AttributeError: .*no attribute 'Thing'"),
    ("Thing = 5", "of broken 1.5 must be a class for version 1 .*does not say which"),
    ("class Thing: glrender_api = 7", "of broken 1.5 must be a class for version 1 .*is for version 7"),
    ("class Thing: glrender_api = 1", "of broken 1.5 must be a subclass of glrender.brdf.Law"),
    ("from glrender.brdf import Law\nclass Thing(Law): glrender_api = 1",
     "of broken 1.5 must define glsl, uniform_fields, uniforms"),
    ("from glrender.brdf import Lambert\nclass Thing(Lambert): glrender_api = 1",
     "of broken 1.5 must bring its twin"),
    ("from glrender.brdf import GlslText, Lambert\nclass Thing(Lambert):\n    glrender_api = 1\n"
     "    glsl = GlslText('other', 'float brdf();')", "must have the entry point's name .* is 'other'"),
])
def test_a_broken_law_is_named_and_breaks_nothing_else(add, monkeypatch, text, message):
    monkeypatch.delitem(sys.modules, "broken_module", raising=False)
    add("broken", plugins.BRDF_GROUP, {"broken": "broken_module:Thing"}, text)
    add("fine", plugins.BRDF_GROUP, {"dusty_lambert": "fine_module:DustyLambert"}, GOOD)
    assert scene_with("lambert", normal_albedo=0.4).bodies[0].brdf.glsl == "lambert"
    assert scene_with("dusty_lambert", normal_albedo=0.4, scale_deg=30.0).bodies[0].brdf.scale_deg == 30.0
    with pytest.raises(PluginError, match=rf"glrender\.brdf\.broken.*{message}"):
        scene_with("broken", normal_albedo=0.4)
    (problem,) = plugins.problems()
    assert "broken 1.5" in str(problem)


def test_two_owners_of_a_name_are_both_named_and_only_that_name_is_lost(add):
    for name in ("first", "second"):
        add(name, plugins.BRDF_GROUP, {"dusty_lambert": f"{name}_module:DustyLambert"}, GOOD)
    assert scene_with("lambert", normal_albedo=0.4)
    with pytest.raises(PluginError, match="has two owners: (second 1.5 and first 1.5|first 1.5 and second 1.5)"):
        scene_with("dusty_lambert", normal_albedo=0.4, scale_deg=30.0)


def test_glrenders_own_names_cannot_be_taken(add):
    add("thief", plugins.BRDF_GROUP, {"lambert": "thief_module:DustyLambert"}, GOOD)
    add("bandit", plugins.BACKEND_GROUP, {"egl": "bandit_module:X"}, "class X: glrender_api = 1")
    assert scene_with("lambert", normal_albedo=0.4).bodies[0].brdf.__class__.__module__ == "glrender.brdf.lambert"
    assert {str(problem).split(":")[0] for problem in plugins.problems()} == {
        "glrender.brdf.lambert", "glrender.backend.egl"}


BACKEND = """
class Blank:
    glrender_api = 1
    settings, options = ("level",), ()
    def __init__(self, scene, *, level=0.5): self.scene, self.level = scene, level
    info = {"backend": "blank", "gl_renderer": "", "gl_version": ""}
    def render(self, state, camera=None, *, max_error=None, products=(), samples=None): return self.level
    def close(self): pass
    def __enter__(self): return self
    def __exit__(self, *exception): self.close()
"""


def test_a_backend_from_outside_with_options_of_its_own(add):
    add("blank", plugins.BACKEND_GROUP, {"blank": "blank_module:Blank"}, BACKEND)
    scene = Scene.from_dict(SCENE)
    with open_renderer(scene, "blank", level=0.25) as renderer:
        assert renderer.render(None) == 0.25
    with pytest.raises(ConfigError, match="bounces: is no option of backend 'blank'; it has level"):
        open_renderer(scene, "blank", bounces=3)
    with pytest.raises(ConfigError, match="level: is no option of backend 'auto'; it has none"):
        open_renderer(scene, level=0.5)


def test_a_backend_that_lacks_a_method(add):
    add("half", plugins.BACKEND_GROUP, {"half": "half_module:X"}, "class X: glrender_api = 1")
    assert {"raytrace", "cycles", "half"} <= set(plugins.backends())
    with pytest.raises(PluginError, match="of half 1.5 must have settings, options, render, info, close, __enter__"):
        open_renderer(Scene.from_dict(SCENE), "half")
    assert plugins.backends()["raytrace"]


def test_an_emission_that_lacks_a_method(add):
    add("fog", plugins.EMISSION_GROUP, {"fog": "fog_module:X"}, "class X: glrender_api = 1")
    with pytest.raises(PluginError, match="of fog 1.5 must have from_table, open"):
        plugins.emissions()["fog"]


def test_a_law_from_outside_survives_a_pickle(add):
    """Worker processes get the scene so."""
    import pickle

    add("fine", plugins.BRDF_GROUP, {"dusty_lambert": "fine_module:DustyLambert"}, GOOD)
    law = scene_with("dusty_lambert", normal_albedo=0.4, scale_deg=30.0).bodies[0].brdf
    again = pickle.loads(pickle.dumps(law))
    assert again == law and again.glsl.text == law.glsl.text
    assert pickle.loads(pickle.dumps(law.glsl)).text == law.glsl.text
