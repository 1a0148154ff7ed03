"""What is senseless is refused with its field, before it becomes an estimate."""

from __future__ import annotations

import copy
from functools import partial

import numpy as np
import pytest
from glrender import generate
from glrender_navigation import ESTIMATORS, BelievedBody, Camera, Measurement, Navigator, moved, sight

NAN, INF = float("nan"), float("inf")
CAMERA = partial(Camera, width_px=64, height_px=48, focal_length_px=100.0)
BODY = partial(BelievedBody, name="b", mean_radius_m=10.0)
NAVIGATOR = partial(Navigator, [1000.0, 0.0, 0.0], [0.0, 0.0, 0.0], sigma_r_m=1.0, sigma_v_m_s=1.0)
STATE = {"r_sun_inertial_m": [0.0, 1e11, -1e11], "spacecraft": {"r_inertial_m": [0.0, 0.0, -500.0]},
         "bodies": {"b": {"r_inertial_m": [0.0, 0.0, 0.0]}}}
BALL = generate.icosphere(radius_m=10.0, subdivisions=2)


@pytest.mark.parametrize("made, field, values", [
    (CAMERA, "width_px", (-1, 0, 1.5, NAN, "64", None, True)), (CAMERA, "height_px", (0,)),
    (CAMERA, "focal_length_px", (NAN, 0.0, -3.0, INF, "100")), (CAMERA, "psf_sigma_px", (-1.0, NAN)),
    (CAMERA, "principal_point_px", ((1.0,), (NAN, 0.0), 3)), (CAMERA, "r_camera_spacecraft_m", ((0.0, INF, 0.0),)),
    (CAMERA, "q_camera_from_spacecraft", ((0.0,) * 4, (NAN, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0))),
    (BODY, "mean_radius_m", (0.0, NAN, "10")), (BODY, "ellipsoid_m", (np.zeros((3, 3)), np.eye(2), NAN * np.eye(3))),
    (BODY, "ellipsoid_center_m", ((0.0, 0.0),)), (BODY, "shape_error_m", (-1.0, NAN)),
    (BODY, "bounding_radius_m", (0.0,)),
    (NAVIGATOR, "sigma_r_m", (-1.0, NAN)), (NAVIGATOR, "sigma_v_m_s", (-1.0,)), (NAVIGATOR, "sigma_size", (NAN,)),
    (NAVIGATOR, "gm_m3_s2", (-1.0,)), (NAVIGATOR, "thruster_error", (INF,)),
    (NAVIGATOR, "process_acceleration_m_s2", (-1e-6,)),
    (partial(ESTIMATORS["altimeter"], CAMERA(), BODY()), "beams_px", ([[64, 0]], [[-1, 0]], [[NAN, 0]], [3, 4], [])),
    (partial(ESTIMATORS["altimeter"], CAMERA(), BODY()), "sigma_m", (0.0, NAN)),
    (partial(ESTIMATORS["altimeter"], CAMERA(), BODY()), "reach_px", (0, 1.5))])
def test_a_constructor_refuses_what_is_senseless(made, field, values):
    made()
    for value in values:
        with pytest.raises(ValueError, match=rf"^{field}: must .*, got .*; \w+"):
            made(**{field: value})


def test_a_filter_keeps_its_estimate_where_it_refuses():
    for r_m, v_m_s, field in (([1, 2], [0, 0, 0], "r_m"), ([0, 0, 0], [0, 0, 0], "r_m"),
                              ([1, 2, 3], [NAN] * 3, "v_m_s")):
        with pytest.raises(ValueError, match=f"^{field}: must"):
            Navigator(r_m, v_m_s, sigma_r_m=1.0, sigma_v_m_s=1.0)
    navigator = NAVIGATOR()
    for acceleration, step_s, field in (([NAN] * 3, 1.0, "acceleration_m_s2"), ([0.0] * 2, 1.0, "acceleration_m_s2"),
                                        ([0.0] * 3, -1.0, "step_s"), ([0.0] * 3, NAN, "step_s")):
        with pytest.raises(ValueError, match=f"^{field}: must .* got"):
            navigator.predict(acceleration, step_s)
    found = Measurement.of_center(CAMERA(), np.array([3.0, 4.0]), 0.1)
    for turn, mount, field in ((np.eye(2), [0.0] * 3, "camera_from_inertial"),
                               (np.eye(3), [NAN] * 3, "r_camera_inertial_m")):
        with pytest.raises(ValueError, match=f"^{field}"):
            navigator.update(found, turn, mount)
    np.testing.assert_array_equal(navigator.r_m, [1000.0, 0.0, 0.0])
    assert not navigator.innovations
    navigator.predict([0.0] * 3, 1.0)


@pytest.mark.parametrize("vertices, facets, message", [
    (BALL.vertices_m, BALL.facets + 1, "facets: must be integers from 0 to 161, one for each vertex, got 162"),
    (BALL.vertices_m, BALL.facets - 1, "facets: must be integers from 0"),
    (BALL.vertices_m, BALL.facets + 0.5, "facets: must be integers from 0"),
    (BALL.vertices_m, BALL.facets[:, :2], r"facets: must be finite numbers of shape \(N, 3\)"),
    (NAN * BALL.vertices_m, BALL.facets, "vertices_m: must be finite numbers"),
    (np.zeros((0, 3)), BALL.facets, "vertices_m: must be finite numbers"),
    (0.0 * BALL.vertices_m, BALL.facets, "facets: must enclose a volume, got 0.0"),
    (BALL.vertices_m * [1.0, 1.0, 0.0], BALL.facets, "facets: must enclose a volume")])
def test_a_mesh_that_is_none(vertices, facets, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        BelievedBody.from_mesh("b", vertices, facets)


def changed(path, value):
    state = copy.deepcopy(STATE)
    *way, last = path.split(".")
    table = state
    for part in way:
        table = table[part]
    table[last] = value
    return state


@pytest.mark.parametrize("state, field", [
    (changed("bodies", {"c": STATE["bodies"]["b"]}), r"state.bodies.b: is missing, got \['c'\]; a state names"),
    (changed("bodies", [1]), "state.bodies: must be a mapping, got"), ([], "state: must be a mapping, got"),
    ({}, "state.spacecraft: is missing"), (changed("spacecraft", {}), "state.spacecraft.r_inertial_m: is missing"),
    (changed("spacecraft.r_inertial_m", [NAN] * 3), "state.spacecraft.r_inertial_m: must be finite"),
    (changed("spacecraft.r_inertial_m", [0, 0, 0]), "state.spacecraft.r_inertial_m: must not put the camera into"),
    (changed("spacecraft.q_from_inertial", [0, 0, 0, 0]), "state.spacecraft.q_from_inertial: must not be of length"),
    (changed("bodies.b.r_inertial_m", [1, 2]), "state.bodies.b.r_inertial_m: must be finite"),
    (changed("bodies.b.q_from_inertial", [NAN, 0, 0, 1]), "state.bodies.b.q_from_inertial: must be finite"),
    (changed("r_sun_inertial_m", None), "state.r_sun_inertial_m: must be finite"),
    (changed("r_sun_inertial_m", [0, 0, 0]), "state.r_sun_inertial_m: must not be the place of 'b'")])
def test_a_senseless_state_is_refused_by_every_estimator(state, field):
    """And by `sight` and `moved`; nothing is drawn of it."""
    camera, body, frame = CAMERA(), BODY(), np.random.default_rng(0).integers(0, 4096, (48, 64)).astype(np.uint16)
    for made in ESTIMATORS.values():
        estimator = made(camera, body)
        with pytest.raises(ValueError, match=f"^{field}"):
            estimator.measure([500.0] if estimator.name == "altimeter" else frame, state, None)
    with pytest.raises(ValueError, match=f"^{field}"):
        sight(state, camera, "b")
    with pytest.raises(ValueError, match=f"^{field}"):
        moved(state, camera, "b", [0.0, 0.0, 1.0])
