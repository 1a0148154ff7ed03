"""The MEX client, built by Octave's mkoctfile as documented: pixels exactly those of the Python client."""

from __future__ import annotations

import json
import socket

import numpy as np
import pytest
import serving
import views
from glrender_client import Client
from octave_runner import SCENE, mkoctfile, octave

STATE = views.state().to_dict()
PRODUCTS = ["range", "body_id", "facet_id", "incidence", "emission", "phase", "r_body", "sunlit"]


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    mkoctfile()
    folder = tmp_path_factory.mktemp("mex")
    octave("build_script.m", folder, environment={"CFLAGS": "-O1 -g -fPIC -Wall -Wextra -Werror"})
    return folder


def test_the_mex_function_gets_the_pixels_that_python_gets(built, tmp_path):
    (tmp_path / "state.json").write_text(json.dumps(STATE))
    with serving.server(tmp_path, "--tcp", "127.0.0.1:0", scene=SCENE) as (endpoint, process), \
            socket.create_server(("127.0.0.1", 0)) as mute, Client(endpoint) as client:
        host, port = serving.tcp_address(process)
        octave("mex_script.m", host, port, mute.getsockname()[1], tmp_path, tmp_path / "state.json", paths=[built])
        frame = client.render(STATE, "navcam", products=PRODUCTS)
        dn = {"output": "dn", "exposure_s": 0.02}
        arrays = {**frame.arrays, "dn": client.render(STATE, "navcam", **dn, seed=7).pixels,
                  "dn_largest_seed": client.render(STATE, "navcam", **dn, seed=2**64 - 1).pixels,
                  "dn_auto": client.render(STATE, "navcam", output="dn", exposure_s="auto", seed=2**64 - 1).pixels,
                  "samples": client.render(STATE, "navcam", samples=11).pixels,
                  "fine": client.render(STATE, "navcam", max_error=0.001).pixels,
                  "by_unit": client.render(STATE, "navcam", max_error={"centroid_px": 0.004, "flux": 5e-4}).pixels,
                  "region": client.render(STATE, "navcam", products=["r_body"], roi=[30, 20, 71, 45]).pixels}
    # Where coverage meets both tolerances at once, the finer frame is the same.
    assert len({array.tobytes() for name, array in arrays.items()
                    if name not in ("fine", "by_unit")}) == len(arrays) - 2
    for name, array in arrays.items():
        kept = np.fromfile(tmp_path / name, array.dtype).reshape(array.shape, order="F")
        np.testing.assert_array_equal(kept, array, err_msg=name)


@pytest.mark.slow
def test_another_backend_draws_and_tells_how_far_it_is(built, tmp_path):
    """By the class and the MEX function: `raytrace`."""
    (tmp_path / "state.json").write_text(json.dumps(views.state(range_m=600.0).to_dict()))
    with serving.server(tmp_path, "--tcp", "127.0.0.1:0", "--workers", "1", "--deadline", "60") as (_, process):
        octave("slow_script.m", *serving.tcp_address(process), tmp_path / "state.json", paths=[built])
