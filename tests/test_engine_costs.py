"""Costs of the machine: measured once and kept, or given so that plans are the same everywhere."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest
import views
from glrender import ConfigError, Renderer
from glrender import engine_costs as module
from glrender.brdf import Lambert
from glrender.engine_costs import engine_costs
from glrender.gl.context import Context

SCENE = views.scene([views.sphere(Lambert(normal_albedo=0.4), subdivisions=2)], [views.camera(64)])


def test_measured_once_and_kept(tmp_path, monkeypatch):
    monkeypatch.delenv("GLRENDER_ENGINE_COSTS")
    with Context() as context:
        costs = engine_costs(context, True, tmp_path)
        assert all(0.1 < ns < 1e6 for ns in astuple(costs))
        quarters = 4.0 * np.log2(astuple(costs))
        np.testing.assert_allclose(quarters, np.round(quarters), atol=1e-9)
        monkeypatch.setattr(module, "_measured", None)
        assert engine_costs(context, True, tmp_path) == costs


def test_rounds_until_another_meets_the_fastest(monkeypatch, caplog):
    monkeypatch.setattr(module, "_switches", lambda: 0)
    seconds = iter([*[2.0] * 8, *[1.0] * 7, 1.5, *[3.0] * 15, 1.02, 1.0, *[2.0] * 7])
    monkeypatch.setattr(module, "_seconds", lambda draw: next(seconds) * draw())
    assert module._fastest([lambda: 1.0]) == [1.0]
    assert next(seconds, None) == 1.0 and not caplog.records
    frames = iter(range(1, 1000))
    monkeypatch.setattr(module, "_seconds", lambda draw: 1.1 ** -(next(frames) // 8))
    assert module._fastest([lambda: 1.0]) == pytest.approx([1.1**-12])
    assert "Other work slows this machine" in caplog.text and "$GLRENDER_ENGINE_COSTS" in caplog.text


def test_a_machine_that_is_busy_all_the_time_is_told_of(monkeypatch, caplog):
    """Its frames are all as slow: cores that are taken away tell of it."""
    switches = iter(range(0, 1_000_000, 1000))
    monkeypatch.setattr(module, "_switches", lambda: next(switches))
    assert module._fastest([lambda: None])[0] < 1.0
    assert "Other work slows this machine" in caplog.text


def test_given_costs_decide_and_are_told(monkeypatch):
    for text, engine in (("1 1 1e9 1e9 1e9", "raster"), ("1e9 1e9 1e-3 1e-3 1e9", "rays"),
                         ("1e9 1e9 1e9 1e9 1e-3", "areas")):
        monkeypatch.setenv("GLRENDER_ENGINE_COSTS", text)
        with Renderer(SCENE) as renderer:
            assert renderer.render(views.state(), max_error=0.01).plan.windows[0].engine == engine
            told = renderer.info["engine_costs_ns"]
        monkeypatch.setenv("GLRENDER_ENGINE_COSTS", told)
        with Renderer(SCENE) as renderer:
            assert renderer.info["engine_costs_ns"] == told


@pytest.mark.parametrize("text", ["", "1 2 3 4", "1 2 3 4 5 6", "1 2 3 4 fast", "1 2 0 4 5", "1 2 nan 4 5"])
def test_costs_that_are_none(text, monkeypatch):
    monkeypatch.setenv("GLRENDER_ENGINE_COSTS", text)
    with pytest.raises(ConfigError, match="GLRENDER_ENGINE_COSTS: must be five positive numbers"):
        Renderer(SCENE)
