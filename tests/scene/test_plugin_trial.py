"""Plug-ins that load and then fail: named, before their scene serves, and nothing else breaks."""

from __future__ import annotations

import msgpack
import numpy as np
import pytest
import views
from glrender import Renderer, Scene
from glrender.base.errors import PluginError
from glrender.scene.plugins import registry as plugins
from glrender_server.operations import Operations
from plugin_law import GOOD, SCENE

VALUE = "return self.normal_albedo / np.pi * np.exp(-geometry.phase / np.radians(self.scale_deg))"
UNIFORM = '"law_per_rad": 1.0 / np.radians(self.scale_deg)'


def table(law):
    return {**SCENE, "bodies": [{**SCENE["bodies"][0], "brdf": {
        "law": law, "normal_albedo": 0.4, "scale_deg": 30.0}}]}


def ask(operations, op, **fields):
    parts, code, *_ = operations.answer({"v": 1, "id": 1, "client": "test", "op": op, **fields})
    return msgpack.unpackb(bytes(parts[0])), code


@pytest.mark.parametrize("name, good, bad, message", [
    ("raises", VALUE, 'raise RuntimeError("oops")', "failed: RuntimeError: oops"),
    ("made", 'positive("scale_deg", self.scale_deg)', 'raise KeyError("x")', "failed: KeyError"),
    ("shape", VALUE, "return np.ones((3, 3, 3))", "failed: ValueError|one value for each direction"),
    ("nan", VALUE, "return np.nan * geometry.phase", "finite values >= 0 .* in its brdf, got .*nan"),
    ("lacks", f", {UNIFORM}", "", "must give finite numbers for law_per_rad in uniforms"),
    ("text", UNIFORM, '"law_per_rad": "a"', "must give finite numbers for law_per_rad in uniforms"),
    ("infinite", UNIFORM, '"law_per_rad": np.inf', "must give finite numbers for law_per_rad in uniforms"),
    ("glsl", "? albedo", "? albedoo", "must have a twin that compiles.*albedoo"),
    ("unnamed", "float brdf(", "float other(", "must have a twin that compiles.*brdf"),
    ("include", "brdf/angles.glsl", "brdf/none.glsl", "must have a twin that compiles.*brdf/none.glsl"),
    ("negative", "albedo / PI *", "-albedo *", "finite values >= 0 .* in its twin in GLSL"),
    ("dark", "albedo / PI *", "sqrt(-1.0 - albedo) *", "finite values >= 0 .* in its twin in GLSL"),
    ("other", "albedo / PI *", "0.9 * albedo / PI *", "within 1% RMS of its Python"),
])
def test_a_law_that_fails_is_named_before_its_scene_serves(add, name, good, bad, message):
    """Before, `internal` without a name, or frames of NaN and of negative light; the server's old scene was lost."""
    text = GOOD.replace('"dusty_lambert"', f'"{name}"')
    assert good in text
    add(name, plugins.BRDF_GROUP, {name: f"{name}_module:DustyLambert"}, text.replace(good, bad))
    operations = Operations(Scene.from_dict(SCENE))
    try:
        state = views.state(range_m=2e5).to_dict()
        before = bytes(operations.answer({"v": 1, "id": 1, "client": "test", "op": "render", "state": state})[0][1])
        reply, code = ask(operations, "load_scene", scene=table(name))
        assert code == "config", reply
        with pytest.raises(PluginError, match=f"(?s){name}_module.DustyLambert: .*({message})"), \
                Renderer(Scene.from_dict(table(name))):
            pass
        assert f"{name}_module.DustyLambert" in reply["error"]["message"]
        after = operations.answer({"v": 1, "id": 2, "client": "test", "op": "render", "state": state})[0][1]
        assert bytes(after) == before
    finally:
        operations.close()


EMISSION = """
from glrender.engines.emission_interface import EmissionPlan
class Pass:
    def __enter__(self): return self
    def __exit__(self, *exception): pass
    def add(self, irradiance, frame):
        {add}
        return EmissionPlan(kind="glow", body="body", modelled={{}}, predicted_error=0.0, milliseconds=0.0)
class Glow:
    glrender_api, body = 1, "body"
    @classmethod
    def from_table(cls, table, resolve, bodies): {table}; return cls()
    def open(self, context, scene): {open}; return Pass()
"""


@pytest.mark.parametrize("name, parts, message", [
    ("glow_table", {"table": "table['x']"}, "failed: KeyError: 'x'"),
    ("glow_none", {"table": "return None"}, "must return something with body and open"),
    ("glow_open", {"open": "raise RuntimeError('o')"}, "failed: RuntimeError: o"),
    ("glow_add", {"add": "raise RuntimeError('a')"}, "failed: RuntimeError: a"),
    ("glow_plan", {"add": "return None"}, "must return an EmissionPlan"),
    ("glow_nan", {"add": "irradiance[3, 4] = float('nan')"}, "must leave irradiance finite and >= 0, got '1 pixels"),
    ("glow_negative", {"add": "irradiance -= 1.0"}, "must leave irradiance finite and >= 0"),
])
def test_an_emission_that_fails_is_named(add, name, parts, message):
    text = EMISSION.format(**{"add": "irradiance += 1e-9", "table": "pass", "open": "pass", **parts})
    add(name, plugins.EMISSION_GROUP, {name: f"{name}_module:Glow"}, text)
    given = {**SCENE, "emission": [{"kind": name}]}
    with pytest.raises(PluginError, match=f"{name}_module.Glow: {message}"):
        with Renderer(Scene.from_dict(given)) as renderer:
            renderer.render(views.state(range_m=2e5))


def test_an_emission_that_does_not_fail_shines(add):
    add("glow", plugins.EMISSION_GROUP, {"glow": "glow_module:Glow"},
        EMISSION.format(add="irradiance += 1e-9", table="pass", open="pass"))
    given = Scene.from_dict({**SCENE, "emission": [{"kind": "glow"}]})
    with Renderer(given) as renderer:
        assert renderer.render(views.state(range_m=2e5)).irradiance_W_m2.min() == np.float32(1e-9)
