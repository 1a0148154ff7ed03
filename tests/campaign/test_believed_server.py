"""The server of the believed side: what its clients can ask for is the belief, and nothing of the truth."""

from __future__ import annotations

import numpy as np
import pytest
from glrender import Pose, State, frames, generate
from glrender_cli.own_server import OwnServer
from glrender_client import Client, ServerError
from glrender_server.__main__ import main

# The true rock is twice as large as it is believed to be.
TRUTH = """
[[bodies]]
name = "rock"
generated = { kind = "icosphere", radius_m = 100.0, subdivisions = 4 }
brdf = { law = "lambert", normal_albedo = 0.4 }
[[cameras]]
name = "navcam"
width_px = 65
height_px = 65
focal_length_px = 200.0
"""
STATE = State(r_sun_inertial_m=[-1.5e11, 0.0, 0.0], bodies={"rock": Pose(r_inertial_m=[0.0, 0.0, 0.0])},
              spacecraft=Pose(r_inertial_m=[-1000.0, 0.0, 0.0],
                              q_from_inertial=frames.look_at([-1000.0, 0.0, 0.0], [0.0, 0.0, 0.0])))


def test_the_believed_endpoint_serves_no_truth(tmp_path):
    """Range, size, light, facets and camera of its frames are the believed ones; nobody may load another scene."""
    generate.icosphere(radius_m=50.0, subdivisions=3).to_file(tmp_path / "small.obj")
    (tmp_path / "scene.toml").write_text(TRUTH)
    belief = ('scene = "scene.toml"\n[belief.bodies.rock]\nshape = "small.obj"\nlength_unit = "m"\n'
              "albedo_factor = 0.5\n[belief.cameras.navcam]\nfocal_length_factor = 1.5\n")
    (tmp_path / "belief.toml").write_text(belief)
    found = {}
    with OwnServer([tmp_path / "scene.toml"]) as true, \
            OwnServer([tmp_path / "belief.toml", "--belief", "--no-load-scene"]) as believed:
        for name, server in (("true", true), ("believed", believed)):
            with Client(server.endpoint(), timeout_s=60.0) as client:
                hello = client.hello()
                reply = client.render(STATE, products=["range", "facet_id"], max_error=0.02)
                found[name] = (hello, reply)
                if name == "believed":
                    with pytest.raises(ServerError, match="forbidden"):
                        client.load_scene({"bodies": [], "cameras": []})
    (_, of_truth), (hello, of_belief) = found["true"], found["believed"]
    for reply, radius_m, focal_px, n_facets in ((of_truth, 100.0, 200.0, 5120), (of_belief, 50.0, 300.0, 1280)):
        assert reply.arrays["range"][32, 32] == pytest.approx(1000.0 - radius_m, abs=0.5)
        width_px = 2.0 * focal_px * radius_m / np.sqrt(1000.0**2 - radius_m**2)
        assert np.isfinite(reply.arrays["range"][32]).sum() == pytest.approx(width_px, abs=1.5)
        assert reply.arrays["facet_id"].max() < n_facets
    assert hello["cameras"][0]["focal_length_px"] == 300.0
    # Half the albedo, and a pixel of 1 / 1.5 squared of the solid angle.
    ratio = of_belief.pixels[32, 32] / of_truth.pixels[32, 32]
    assert ratio == pytest.approx(0.5 / 1.5**2, rel=0.05)
    assert "small" not in str(hello) and "belief.toml" not in str(hello)


@pytest.mark.slow
def test_the_believed_endpoint_draws_no_true_faults(tmp_path):
    """The true camera's shutter is stuck at next to no light; the believed one's is not."""
    model = ('[cameras.model]\nexposure_s = 1.0\nfaults = [{ kind = "stuck_exposure", exposure_s = 1e-9 }]\n'
             "optics = { aperture_diameter_m = 0.005 }\ndetector = { quantum_efficiency = 0.5, "
             "full_well_electrons = 30000.0, gain_DN_per_electron = 0.008, bit_depth = 8 }\n")
    (tmp_path / "scene.toml").write_text(TRUTH + model)
    (tmp_path / "belief.toml").write_text('scene = "scene.toml"\n[belief.bodies.rock]\nalbedo_factor = 0.5\n')
    brightest = []
    for arguments in ([tmp_path / "scene.toml"], [tmp_path / "belief.toml", "--belief"]):
        with OwnServer(arguments) as server, Client(server.endpoint(), timeout_s=60.0) as client:
            brightest.append(client.render(STATE, output="dn", max_error=0.02).pixels.max())
    assert brightest[0] < 5 and brightest[1] > 50


def test_a_scene_without_a_belief_is_refused(tmp_path, capsys):
    (tmp_path / "scene.toml").write_text(TRUTH)
    assert main([str(tmp_path / "scene.toml"), "--belief", "--zmq", "tcp://127.0.0.1:*", "--in-process"]) == 1
    assert "scene.toml.belief: missing; describe the on-board scene in [belief]" in capsys.readouterr().err
