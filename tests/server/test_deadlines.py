"""`deadline_s` of a frame on the wire: the best frame so far, its predicted error, and whether it was late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import serving
import views
from glrender import Renderer, load_scene, take_frame
from glrender_client import Client, ServerError

STATE = views.state(phase_deg=70.0, range_m=900.0).to_dict()


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    with serving.server(tmp_path_factory.mktemp("server")) as (endpoint, _), Client(endpoint) as client:
        yield client


@pytest.mark.parametrize("output", ["irradiance", "dn"])
def test_a_deadline_that_is_kept_changes_no_byte(client, output):
    seed = {"seed": 3} if output == "dn" else {}
    usual, kept = (client.render(STATE, "navcam", output=output, **seed, **deadline)
                   for deadline in ({}, {"deadline_s": 1000.0}))
    assert usual.pixels.tobytes() == kept.pixels.tobytes()
    assert "is_late" not in usual.header and kept.header["is_late"] is False


def test_a_late_frame_is_lit_and_its_predicted_error_holds(client):
    """Against the frame without a deadline, whose own error is 10 times smaller than the late one's."""
    usual = client.render(STATE, "navcam", max_error=1e-3)
    late = client.render(STATE, "navcam", max_error=1e-3, deadline_s=1e-6)
    assert late.header["is_late"] is True
    error = views.relative_rms(late.pixels.astype(float), usual.pixels.astype(float))
    assert error <= late.header["plan"]["predicted_error"] + usual.header["plan"]["predicted_error"]
    assert late.pixels.sum(dtype=float) == pytest.approx(usual.pixels.sum(dtype=float), rel=0.02)


def test_frames_of_one_request_have_deadlines_of_their_own(client):
    frames = [{"camera": "navcam", "deadline_s": 1e-6}, {"camera": "bare"}, {"camera": "bare", "deadline_s": 1000.0}]
    late, none, kept = client.render_frames(STATE, frames)
    assert (late.header["is_late"], none.header.get("is_late"), kept.header["is_late"]) == (True, None, False)


@pytest.mark.parametrize("value, rule", [(0.0, "between 1e-06 and 1e"), (float("nan"), "finite"), ("soon", "number"),
                                         (1e9, "between")])
def test_what_is_no_deadline_is_refused_by_its_field(client, value, rule):
    with pytest.raises(ServerError, match=f"deadline_s: .*{rule}"):
        client.render(STATE, "navcam", deadline_s=value)
    with pytest.raises(ServerError, match=r"frames\[1\]\.deadline_s"):
        client.render_frames(STATE, [{"camera": "bare"}, {"camera": "bare", "deadline_s": value}])


def test_a_backend_without_deadlines_says_so(client):
    with pytest.raises(ServerError, match="deadline_s: is no option"):
        client.render(STATE, "bare", backend="raytrace", deadline_s=0.1)


def test_the_poses_of_a_blurred_frame_share_one_deadline(tmp_path, monkeypatch):
    (tmp_path / "scene.toml").write_text(serving.SCENE)
    left, render = [], Renderer.render

    def noted(self, *arguments, deadline_s=None, **options):
        left.append(deadline_s)
        return render(self, *arguments, deadline_s=deadline_s, **options)

    monkeypatch.setattr(Renderer, "render", noted)
    state = views.state(phase_deg=70.0, range_m=900.0)
    moving = replace(state, spacecraft=replace(state.spacecraft, angular_velocity_rad_s=np.array([0.0, 2.0, 0.0])))
    with Renderer(load_scene(tmp_path / "scene.toml")) as renderer:
        take_frame(renderer, moving, "navcam", exposure_s=0.02, deadline_s=100.0)
    assert len(left) > 2 and all(b < a <= 100.0 for a, b in zip(left, left[1:], strict=False)), left
