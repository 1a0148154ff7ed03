"""One flight: what a wrong belief costs, what fails on board, and that nothing of the truth is there."""

from __future__ import annotations

import gc
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from glrender import Pose, Scene, State, open_renderer
from glrender_campaign import flight as flight_module
from glrender_campaign.believed_side import onboard_scene, render_of
from glrender_campaign.campaign_file import load_campaign
from glrender_campaign.flight import fly
from glrender_campaign.onboard import OF_FRAMES, OnBoard
from glrender_navigation import BelievedBody, Camera, Estimator, Measurement, Navigator

TIMES = ("processor_s", "frame_ms", "on_board_ms")


def flown(campaign, case, told=lambda frame: None):
    """A flight's result, but for how long it took."""
    truth, believed = open_renderer(campaign.setup.scene), open_renderer(onboard_scene(campaign.setup.scene,
                                                                                       case.belief))
    try:
        result = fly(campaign.setup, case, truth, believed, told).result
    finally:
        truth.close()
        believed.close()
    assert result.keys() == flight_module.RESULT_KEYS
    return {name: value for name, value in result.items() if name not in TIMES}


def of_one(campaign_file, *lines, more=""):
    campaign = load_campaign(campaign_file("scenario = 'approach.toml'\nhandover = 0.03\n[axes]\n"
                                           + "\n".join(("max_error = [0.3]", *lines)), more))
    (case,) = campaign.cases
    return campaign, case


def test_a_focal_length_that_is_believed_5_percent_longer_puts_the_body_5_percent_farther(campaign_file):
    """Range is focal length times size over its image; with the true one the error is a tenth of that."""
    campaign = load_campaign(campaign_file())
    for case in campaign.cases:
        errors = []
        result = flown(campaign, case, lambda frame, errors=errors: errors.append(frame.error_m / frame.range_m))
        assert result["status"] == "kept" and result["accepted"] == result["frames"] == 6
        if case.belief.cameras["navcam"].focal_length_factor == 1.0:
            assert errors[-1] < 0.006
        else:
            assert errors[-1] == pytest.approx(0.05, abs=0.012)
        assert result["error_over_range"]["last"] == pytest.approx(errors[-1], rel=1e-5)
        assert result["track"] == pytest.approx(errors, rel=1e-5)
    assert flown(campaign, case) == result


def test_a_distortion_that_is_believed_is_taken_out(campaign_file, tmp_path):
    """A lens that shrinks a body off the axis by 1.5 %: unknown it costs as much, known a third: edges blur."""
    lens = "distortion = { k1 = -1.0 }\n[cameras.model]"
    found = []
    for belief in ("{ k1 = -1.0 }", "{}"):
        file = campaign_file("scenario = 'approach.toml'\npointing = 'scenario'\nhandover = 0.03\n[axes]\n"
                             f"seed = [1]\nmax_error = [0.3]\nbelief.cameras.navcam.distortion = [{belief}]\n")
        text = (tmp_path / "approach.toml").read_text()
        text = text.replace("[cameras.model]", lens)
        text = text.replace("[time]", "[attitude]\nmode = 'target'\noffset_deg = [0.0, 4.0, 0.0]\n[time]")
        (tmp_path / "approach.toml").write_text(text)
        campaign = load_campaign(file)
        found.append(flown(campaign, campaign.cases[0])["error_over_range"]["last"])
    assert found[0] < 0.008 and found[1] > 0.013


class Broken(Estimator):
    """Fails at its third frame."""

    name = "broken"
    count = 0

    def measure(self, frame, believed, render):
        self.count += 1
        if self.count == 3:
            raise ZeroDivisionError("no light")
        return None


def test_what_fails_on_board_is_the_flights_result(campaign_file, monkeypatch):
    monkeypatch.setitem(OF_FRAMES, Broken.name, Broken)
    result = flown(*of_one(campaign_file, "estimator = ['broken']"))
    assert (result["status"], result["reason"]) == ("lost", "frame 2: ZeroDivisionError: no light")
    assert result["frames"] == 3


def test_a_body_that_is_out_of_the_frame_is_lost_with_the_reason(campaign_file):
    """The camera looks away: there is no measurement, and the estimate stays off."""
    more = ("[attitude]\nmode = 'target'\noffset_deg = [0.0, 90.0, 0.0]\n"
            "[belief.spacecraft]\nr_offset_m = [300.0, 0.0, 0.0]\n")
    campaign = load_campaign(campaign_file("scenario = 'approach.toml'\npointing = 'scenario'\n[axes]", more))
    result = flown(campaign, campaign.cases[0])
    assert result["status"] == "lost" and result["accepted"] == 0
    told = "% of the range, above 10 %; none of the last 4 frames gave a measurement that the filter accepted; "
    assert told in result["reason"]


@pytest.mark.parametrize("measured, told", [
    (lambda found: None, "; the last frame: dark"),
    (lambda found: replace(found, direction_camera=-found.direction_camera),
     "; the last frame: the filter refused the measurement")])
def test_a_flight_that_never_measures_the_body_has_lost_it(campaign_file, monkeypatch, measured, told):
    """The first estimate is good enough to end within 10 %: yet nothing was navigated."""
    class Blind(OF_FRAMES["model"]):
        name = "blind"

        def measure(self, frame, believed, render):
            found = measured(super().measure(frame, believed, render))
            self.reason = "" if found else "dark"
            return found

    monkeypatch.setitem(OF_FRAMES, Blind.name, Blind)
    result = flown(*of_one(campaign_file, "estimator = ['blind']"))
    assert (result["status"], result["accepted"]) == ("lost", 0) and result["error_over_range"]["last"] < 0.1
    assert result["reason"] == "none of the last 4 frames gave a measurement that the filter accepted" + told


@pytest.mark.parametrize("doubt", ["", "the believed shape may be wrong"])
def test_a_doubtful_measurement_is_left_out_and_its_doubt_is_the_reason(doubt):
    camera, body = Camera(width_px=8, height_px=8, focal_length_px=100.0), BelievedBody(name="rock", mean_radius_m=1.0)
    found = replace(Measurement.of_place(camera, np.array([0.0, 0.0, 1001.0]), np.eye(3)), doubt=doubt)
    estimator = SimpleNamespace(camera=camera, body=body, reason="", measure=lambda *given: found)
    navigator = Navigator([0.0, 0.0, -1000.0], np.zeros(3), sigma_r_m=1.0, sigma_v_m_s=1e-3)
    board = OnBoard(estimator, navigator, None)
    state = State(r_sun_inertial_m=[1.5e11, 0.0, 0.0], spacecraft=Pose(r_inertial_m=[0.0, 0.0, -1000.0]),
                  bodies={"rock": Pose(r_inertial_m=np.zeros(3))})
    assert board.take(np.zeros((8, 8), np.uint16), state) is found
    assert (board.is_accepted, board.reason) == (not doubt, doubt)
    assert board.r_m[2] == pytest.approx(-1000.0 if doubt else -1000.5)


def test_faults_are_the_scenes_own_unless_the_axis_says_others(campaign_file, tmp_path):
    """The scene's frames are black: `[[]]` flies without, and no default or belief hides them."""
    found = {}
    for name, axis in (("own", "seed = [1]"), ("none", "faults = [[]]")):
        file = campaign_file(f"scenario = 'approach.toml'\nhandover = 0.03\n[axes]\nmax_error = [0.3]\n{axis}\n")
        text = (tmp_path / "approach.toml").read_text()
        (tmp_path / "approach.toml").write_text(text.replace(
            "[cameras.model]", "[cameras.model]\nfaults = [{ kind = 'stuck_exposure', exposure_s = 1e-9 }]"))
        (case,) = (campaign := load_campaign(file)).cases
        assert campaign.setup.scene.cameras[0].model.faults
        assert onboard_scene(campaign.setup.scene, case.belief).cameras[0].model.faults == ()
        brightest = found[name] = []
        flown(campaign, case, lambda frame, brightest=brightest: brightest.append(frame.pixels.max()))
    assert max(found["own"]) < 10 and min(found["none"]) > 100
    assert [fault["kind"] for fault in load_campaign(campaign_file()).axes["faults"][0]] == []


def reached(start):
    """All objects that an object leads to, but for modules, classes and what these lead to."""
    seen, left = {id(start): start}, [start]
    while left:
        here = left.pop()
        if isinstance(here, type) or type(here).__name__ in ("module", "builtin_function_or_method"):
            continue
        # A function leads to its closure and its defaults; what its module holds belongs to nobody.
        inside = [*(here.__closure__ or ()), *(here.__defaults__ or ())] if hasattr(here, "__closure__") else \
            gc.get_referents(here)
        for each in inside:
            if id(each) not in seen:
                seen[id(each)] = each
                left.append(each)
    return list(seen.values())


def test_the_on_board_side_holds_nothing_of_the_truth(campaign_file, monkeypatch):
    """No true scene, shape, state or place can be reached from it at any frame; its own scene and shape can."""
    campaign, case = of_one(campaign_file, "belief.bodies.rock.facets = [0.1]",
                            "belief.cameras.navcam.focal_length_factor = [1.01]",
                            "belief.bodies.rock.r_offset_m = [[1.0, 2.0, 3.0]]")
    truth, looked_at = campaign.setup, []
    true_arrays = [truth.scene.bodies[0].shape.vertices_m, *(state.spacecraft.r_inertial_m for state in truth.states)]
    real = OnBoard.take

    def looked(self, frame, believed):
        found = reached([self, believed])
        looked_at.append(len(found))
        scenes = [each for each in found if isinstance(each, Scene)]
        assert scenes and truth.scene not in scenes
        assert not any(each is own for each in found for own in (*truth.scene.bodies, *truth.scene.cameras, truth))
        for each in found:
            if isinstance(each, np.ndarray) and each.dtype == np.float64:
                assert not any(np.shares_memory(each, own) for own in true_arrays)
                assert not any(each.shape == own.shape and (each == own).all() for own in true_arrays)
        for each in found:
            if isinstance(each, Pose | State):
                assert each is believed or each in (believed.spacecraft, *believed.bodies.values())
        return real(self, frame, believed)

    told = OnBoard(None, None, render_of(SimpleNamespace(scene=truth.scene), "navcam", 0.1))
    assert truth.scene in [each for each in reached(told) if isinstance(each, Scene)], "it would be seen"
    monkeypatch.setattr(OnBoard, "take", looked)
    assert flown(campaign, case)["status"] == "kept"
    assert len(looked_at) == 6 and min(looked_at) > 100


def test_the_truth_reaches_the_estimate_by_frames_alone(campaign_file, tmp_path, monkeypatch):
    """Two true places, one first estimate, and the same frame sent from both: the estimates are equal."""
    real, estimates = flight_module._taken, {}
    frame = np.zeros((96, 96), np.uint8)
    frame[30:60, 40:70] = np.random.default_rng(1).integers(50, 200, (30, 30))

    def taken(onboard, pixels, *rest):
        found = real(onboard, frame, *rest)
        estimates.setdefault(moved_m, []).append(onboard.r_m)
        return found

    monkeypatch.setattr(flight_module, "_taken", taken)
    for moved_m in (-10.0, 10.0):
        file = campaign_file("scenario = 'approach.toml'\nhandover = 0.0\n[axes]\nmax_error = [0.3]\n",
                             f"[belief.spacecraft]\nr_offset_m = [{-moved_m}, 0.0, 0.0]\n")
        text = (tmp_path / "approach.toml").read_text().replace("r_m = [900.0,", f"r_m = [{900.0 + moved_m},")
        (tmp_path / "approach.toml").write_text(text)
        campaign = load_campaign(file)
        flown(campaign, campaign.cases[0])
    first, second = estimates.values()
    assert len(first) == 6 and np.linalg.norm(first[-1] - first[0]) > 1.0
    np.testing.assert_allclose(second, first, atol=1e-6)
