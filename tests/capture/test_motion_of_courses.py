"""What a source knows of a motion is drawn: jitter, accelerations, whole turns, attitudes without rates."""

from __future__ import annotations

import pickle
import sys
from contextlib import nullcontext
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
import views
from glrender import Body, ConfigError, State, generate, open_renderer, take_frame
from glrender.brdf import Lambert
from glrender.capture.motion_blur import MAX_POSES, plan_motion
from glrender.scenario import (
    AtRest,
    AttitudeTable,
    Epoch,
    Fixed,
    OfFunction,
    Scenario,
    Spice,
    SpiceAttitude,
    Spin,
    Times,
)
from glrender.sequences.dataset.dataset import DataSet
from glrender.sequences.options import FrameOptions, exposures_of
from glrender.sequences.processes import processes_of
from glrender.sequences.sequence import FrameSequence, digest_of_states
from glrender.view.light_time import apparent_state
from glrender_camera import CameraModel, Detector, Optics
from missing import needed_module
from scipy.spatial.transform import Rotation

FOCAL_PX, RANGE_M, EXPOSURE_S = 1000.0, 2000.0, 0.5
MODEL = CameraModel(optics=Optics(aperture_diameter_m=0.01, psf_sigma_px=0.7), exposure_s=EXPOSURE_S, detector=Detector(
    quantum_efficiency=0.5, full_well_electrons=1e12, gain_DN_per_electron=1e-8, bit_depth=16))
CAMERA = views.camera(64, FOCAL_PX, model=MODEL)
SPHERE = views.scene([views.sphere(Lambert(normal_albedo=0.4), 4, 16.0)], [CAMERA], max_error=0.02)


class Swing:
    """Turns about the camera's X by amplitude * sin(2 pi f t + phase); its rates are not known if so asked."""

    def __init__(self, amplitude_rad, frequency_hz, phase=0.3, has_rates=True, known_s=(-np.inf, np.inf)):
        self.amplitude_rad, self.omega, self.phase = amplitude_rad, 2.0 * np.pi * frequency_hz, phase
        self.has_rates, self.known_s = has_rates, known_s

    def angle(self, t):
        return self.amplitude_rad * np.sin(self.omega * t + self.phase)

    def at(self, geometry, owner):
        t = geometry.t_s
        if (t < self.known_s[0]).any() or (t > self.known_s[1]).any():
            raise ConfigError("time", "must be known", self.known_s)
        q = Rotation.from_rotvec(-self.angle(t)[:, None] * [1.0, 0.0, 0.0]).as_quat(scalar_first=True)
        rate = self.amplitude_rad * self.omega * np.cos(self.omega * t + self.phase)
        return q, rate[:, None] * [1.0, 0.0, 0.0] if self.has_rates else None


def scenario_of(attitude=None, path=None, body=None, scene=SPHERE, times_s=(100.0,)):
    """A spacecraft at rest before a body, the Sun behind it."""
    return Scenario(
        trajectories={"spacecraft": path or AtRest(r_m=[0.0, 0.0, -RANGE_M], about="body"),
                      "sun": AtRest(r_m=[0.0, 0.0, -1.5e11], about="body")},
        attitudes={"spacecraft": attitude or Fixed(), **({} if body is None else {"body": body})},
        sampler=Times(times_s=list(times_s)), origin="body", scene=scene)


def exposed(scenario, **options):
    with open_renderer(scenario.scene) as renderer:
        return take_frame(renderer, next(scenario.iter_states()), seed=1, **options)


def moments(image):
    """Centre (x, y) [px] and second central moments xx, yy, xy [px2] of the light."""
    light = image.astype(np.float64)
    y, x = np.indices(light.shape)
    cx, cy = (light * x).sum() / light.sum(), (light * y).sum() / light.sum()
    dx, dy = x - cx, y - cy
    return np.array([cx, cy]), np.array([(light * each).sum() for each in (dx * dx, dy * dy, dx * dy)]) / light.sum()


@pytest.fixture(scope="module")
def still():
    """Moments of the sphere that does not move."""
    return moments(exposed(scenario_of()).irradiance_W_m2)


@pytest.mark.parametrize("frequency_hz", [0.01, 0.1, 1.0, 3.7, 10.0, 32.0, 64.0, 100.0, 130.0])
@pytest.mark.parametrize("amplitude_px", [0.5, 3.0])
def test_a_swing_has_its_mean_and_its_spread(still, frequency_hz, amplitude_px):
    """The mean and the variance of the sine over the exposure: 0.05 px, and 0.05 px2 with 8 % of the variance.

    Of 32 to 130 Hz the exposure has whole numbers of periods, with which evenly spaced poses would be in step.
    """
    swing = Swing(amplitude_px / FOCAL_PX, frequency_hz)
    made = exposed(scenario_of(swing))
    t = 100.0 + EXPOSURE_S * (np.arange(20_000) / 20_000 - 0.5)
    # A turn about +X lifts the view: what is ahead moves down.
    place = FOCAL_PX * np.tan(swing.angle(t))
    centre, spread = moments(made.irradiance_W_m2)
    np.testing.assert_allclose(centre - still[0], [0.0, place.mean()], atol=0.05)
    np.testing.assert_allclose(spread - still[1], [0.0, place.var(), 0.0], atol=0.05 + 0.08 * place.var())
    assert "motion" not in {advice.code for advice in made.warnings}
    if frequency_hz >= 10.0 and amplitude_px == 3.0:
        assert "back and forth over" in made.stages["motion_blur"]


class Pulses:
    """Turns of some angles about the camera's X, 1 ms to 20 ms wide, at places that few instants meet."""

    CENTRES_S = (0.18844673, -0.11107858, -0.36490349, 0.22148834, 0.02535432, -0.18975812, -0.01416464)
    HALF_S = (0.01, 0.01, 0.02, 0.003, 0.02, 0.01, 0.006)

    def __init__(self, heights_px):
        self.heights_rad = np.asarray(heights_px) / FOCAL_PX

    def at(self, geometry, owner):
        off = np.abs(geometry.t_s[:, None] - 100.0 - self.CENTRES_S) < self.HALF_S
        angle = (off * self.heights_rad).sum(axis=1)
        q = Rotation.from_rotvec(angle[:, None] * [1.0, 0.0, 0.0]).as_quat(scalar_first=True)
        return q, np.zeros((len(off), 3))


@pytest.mark.parametrize("scale", [0.8, 1.0, 2.0, 12.0])
def test_pulses_of_a_small_part_of_a_pixel_are_drawn(scale):
    """Few poses are enough for their length, which grows with the instants: they are enough for their spread too."""
    heights = scale * np.array([0.0586, 0.0461, 0.0597, 0.0469, 0.0458, 0.0745, 0.0414])
    state = next(scenario_of(Pulses(heights)).iter_states())
    made = plan_motion(SPHERE, state, CAMERA, 1.0, 0.0, 0)
    assert "back and forth" in made.text and made.warning == ""
    assert len(made.states) == len(made.times_s) >= 9 and (np.diff(made.times_s) > 0.0).all()
    assert made.times_s[[0, -1]].tolist() == [-0.5, 0.5] and 0.0 in made.times_s


def test_fast_jitter_beyond_the_poses_is_warned_of(still):
    """40 px back and forth: the spread within a tenth, in the poses that a frame may have, and a warning."""
    made = exposed(scenario_of(Swing(20.0 / FOCAL_PX, 90.0)))
    told = [advice for advice in made.warnings if advice.code == "motion"]
    assert len(told) == 1 and "faster than the exposure" in str(told[0]) and told[0].path == "exposure_s"
    assert made.stages["motion_blur"].startswith(f"{MAX_POSES} poses, back and forth over 4")
    np.testing.assert_allclose(moments(made.irradiance_W_m2)[1][1] - still[1][1], 200.0, rtol=0.1)


def test_a_long_streak_is_warned_of():
    """100 px in 65 poses are steps of 1.5 px."""
    made = exposed(scenario_of(Spin(angular_velocity_rad_s=[100.0 / FOCAL_PX / EXPOSURE_S, 0.0, 0.0], epoch=None),
                               times_s=(0.0,)))
    (told,) = [advice for advice in made.warnings if advice.code == "motion"]
    assert "65 poses, 1.6" in str(told)


def test_an_acceleration_from_rest_is_drawn(still):
    """x = a t^2 / 2 about the middle of the exposure: no rate there, a mean of a T^2 / 24, a variance of it squared/5.

    Mean of t^2 over +-h is h^2 / 3, of t^4 h^4 / 5: variance 4 / 45 (a h^2 / 2)^2.
    """
    a_px_s2 = 96.0
    a_m_s2 = a_px_s2 * RANGE_M / FOCAL_PX
    path = OfFunction(function=lambda t: [-0.5 * a_m_s2 * (t - 100.0)**2, 0.0, -RANGE_M], about="body")
    centre, spread = moments(exposed(scenario_of(path=path)).irradiance_W_m2)
    reach = 0.5 * a_px_s2 * (0.5 * EXPOSURE_S)**2
    np.testing.assert_allclose(centre - still[0], [reach / 3.0, 0.0], atol=0.03)
    np.testing.assert_allclose(spread - still[1], [4.0 / 45.0 * reach**2, 0.0, 0.0], atol=0.06)


# Whole turns


LONG = Body(name="body", shape=generate.contact_binary(radius_m=20.0, seed=1, subdivisions=3),
            brdf=Lambert(normal_albedo=0.3))


@pytest.mark.parametrize("turns", [8.0, 64.0, 75.0])
@pytest.mark.parametrize("has_course", [True, False])
def test_a_body_that_turns_many_times_is_round(turns, has_course):
    """About the boresight, the Sun behind: its moments are the still ones' mean, 5 %, however many turns there are."""
    scene = views.scene([LONG], [CAMERA], max_error=0.02)
    rate = 2.0 * np.pi * turns / EXPOSURE_S
    scenario = scenario_of(scene=scene, body=Spin(angular_velocity_rad_s=[0.0, 0.0, rate]))
    before = moments(exposed(scenario_of(scene=scene)).irradiance_W_m2)[1]
    assert before[:2].max() > 1.5 * before[:2].min() or abs(before[2]) > 0.2 * before[:2].max()
    state = next(scenario.iter_states())
    with open_renderer(scene) as renderer:
        made = take_frame(renderer, state if has_course else replace(state), seed=1)
    spread = moments(made.irradiance_W_m2)[1]
    mean = before[:2].mean()
    np.testing.assert_allclose(spread, [mean, mean, 0.0], atol=0.05 * mean)
    (told,) = [advice for advice in made.warnings if advice.code == "motion"]
    assert "faster than the exposure" in str(told)


# Sources without rates


def test_attitudes_without_rates_blur_by_their_differences(still):
    swing = Swing(40.0 / FOCAL_PX, 0.05, has_rates=False)
    made = exposed(scenario_of(swing))
    t = 100.0 + EXPOSURE_S * (np.arange(20_000) / 20_000 - 0.5)
    place = FOCAL_PX * np.tan(swing.angle(t))
    assert next(scenario_of(swing).iter_states()).spacecraft.angular_velocity_rad_s is None and place.var() > 0.5
    np.testing.assert_allclose(moments(made.irradiance_W_m2)[1][1] - still[1][1], place.var(), atol=0.05)


@pytest.mark.parametrize("known_s", [(100.0, np.inf), (-np.inf, 100.0), (99.9, 100.05)])
@pytest.mark.parametrize("has_rates", [True, False])
def test_the_first_and_the_last_frame_of_a_source_are_blurred(still, known_s, has_rates):
    """Beyond its ends the motion goes on at the rate there: of a slow swing the same blur, 0.1 px2 of 3.3."""
    swing = Swing(40.0 / FOCAL_PX, 0.05, phase=0.0, has_rates=has_rates, known_s=known_s)
    if not has_rates and known_s[0] == 99.9:
        made = exposed(scenario_of(swing))
        (told,) = [str(advice) for advice in made.warnings if advice.code == "motion"]
        assert "only known rates blur the frame" in told and "must be known" in told
        return
    made = exposed(scenario_of(swing))
    length = 40.0 * 2.0 * np.pi * 0.05 * EXPOSURE_S
    np.testing.assert_allclose(moments(made.irradiance_W_m2)[1][1] - still[1][1], length**2 / 12.0, atol=0.1)
    assert "motion" not in {advice.code for advice in made.warnings}


def test_a_ck_without_angular_velocity_blurs(still, tmp_path):
    """A turn of 8 px in the exposure about +X, written by SPICE's own routine without rates: variance 64 / 12."""
    tool = needed_module("spiceypy", "pip install -e '.[test]'")
    tool.kclear()
    (tmp_path / "c.tsc").write_text("""KPL/SCLK
\\begindata
SCLK_KERNEL_ID = ( @2000-01-01 )
SCLK_DATA_TYPE_999 = ( 1 )
SCLK01_TIME_SYSTEM_999 = ( 1 )
SCLK01_N_FIELDS_999 = ( 2 )
SCLK01_MODULI_999 = ( 4294967296 1000 )
SCLK01_OFFSETS_999 = ( 0 0 )
SCLK01_OUTPUT_DELIM_999 = ( 1 )
SCLK_PARTITION_START_999 = ( 0.0 )
SCLK_PARTITION_END_999 = ( 4.0E+12 )
SCLK01_COEFFICIENTS_999 = ( 0.0 0.0 1.0 )
\\begintext
""")
    (tmp_path / "c.tf").write_text("""KPL/FK
\\begindata
FRAME_CRAFT = -999000
FRAME_-999000_NAME = 'CRAFT'
FRAME_-999000_CLASS = 3
FRAME_-999000_CLASS_ID = -999000
FRAME_-999000_CENTER = -999
CK_-999000_SCLK = -999
CK_-999000_SPK = -999
\\begintext
""")
    tool.furnsh(str(tmp_path / "c.tsc"))
    times = np.arange(0.0, 400.0, 10.0)
    rate = 8.0 / FOCAL_PX / EXPOSURE_S
    # The matrices take J2000's components to the frame's: at 100 s the axes are J2000's.
    quaternions = np.array([tool.m2q(tool.rotate(rate * (t - 100.0), 1)) for t in times])
    ticks = np.array([tool.sce2c(-999, t) for t in times])
    handle = tool.ckopn(str(tmp_path / "c.bc"), "test", 0)
    tool.ckw03(handle, ticks[0], ticks[-1], -999000, "J2000", False, "s", len(times), ticks, quaternions,
               np.zeros((len(times), 3)), 1, [ticks[0]])
    tool.ckcls(handle)
    spice = Spice(kernels=[tmp_path / name for name in ("c.tsc", "c.tf", "c.bc")], observer="-999")
    scenario = replace(scenario_of(SpiceAttitude(spice=spice, frame="CRAFT")), start=Epoch.from_et(0.0))
    state = next(scenario.iter_states())
    assert state.spacecraft.angular_velocity_rad_s is None
    np.testing.assert_allclose(np.abs(state.spacecraft.q_from_inertial), [1.0, 0.0, 0.0, 0.0], atol=1e-6)
    centre, spread = moments(exposed(scenario).irradiance_W_m2)
    np.testing.assert_allclose(centre, still[0], atol=0.03)
    np.testing.assert_allclose(spread - still[1], [0.0, 64.0 / 12.0, 0.0], atol=0.06)
    tool.kclear()


def test_a_slew_that_begins_in_the_exposure_is_drawn(still):
    """A table holds until the middle of the exposure and turns then: half of the light stays, half is a streak."""
    t = np.array([0.0, 50.0, 100.0, 150.0, 200.0])
    angle = np.array([0.0, 0.0, 0.0, 1.6, 3.2])  # 0.032 rad/s: 8 px in a quarter of a second
    q = Rotation.from_rotvec(-angle[:, None] * [0.0, 1.0, 0.0]).as_quat(scalar_first=True)
    table = AttitudeTable(times_s=t, q_from_inertial=q, interpolation="linear")
    centre, spread = moments(exposed(scenario_of(table)).irradiance_W_m2)
    # Places are x = 0 in one half and 0 to 8 px in the other: mean 2, mean square 64 / 6.
    np.testing.assert_allclose(abs(centre[0] - still[0][0]), 2.0, atol=0.05)
    np.testing.assert_allclose(spread[0] - still[1][0], 64.0 / 6.0 - 4.0, atol=0.1)


# States and their courses


def test_a_state_carries_its_course_and_a_changed_one_does_not():
    """What another pose would do is not known; neither the wire nor `replace` has it."""
    state = next(scenario_of(Swing(0.001, 3.0)).iter_states())
    later = state.at([-0.1, 0.0, 0.1])
    assert later[1] is state and [round(each.t_s, 6) for each in later] == [99.9, 100.0, 100.1]
    assert replace(state, t_s=3.0).course is None and State.from_dict(state.to_dict()).course is None
    assert [each.t_s for each in replace(state).at([0.5])] == [100.5]
    again = pickle.loads(pickle.dumps(state)).at([0.1])[0]
    np.testing.assert_array_equal(again.spacecraft.q_from_inertial, later[2].spacecraft.q_from_inertial)


def test_an_apparent_state_keeps_its_course():
    state = next(scenario_of(Swing(0.001, 3.0)).iter_states())
    seen = apparent_state(state)
    (later,), (truth,) = seen.at([0.1]), [apparent_state(each) for each in state.at([0.1])]
    assert later.to_dict() == truth.to_dict()


def test_a_scenario_at_rest_stands_still():
    made = exposed(scenario_of())
    assert made.stages["motion_blur"] == "skipped: the state does not move"
    assert made.stages["margin"].startswith("skipped")


def test_a_sequence_has_the_same_bytes_from_any_number_of_processes(tmp_path):
    """Jitter of 30 Hz; courses that cannot be sent are refused, and irradiance needs none."""
    states = list(scenario_of(Swing(0.002, 30.0), times_s=(1.0, 2.0, 3.0)).iter_states())
    options = FrameOptions(camera="navcam", output="dn", format="npz", backend="auto")
    found = []
    for n in (1, 2):
        sequence = FrameSequence(scene=SPHERE, states=states, folder=tmp_path / str(n), options=options)
        assert len(list(sequence.draw(n))) == 3
        found.append([sequence.path(k).read_bytes() for k in range(3)])
    assert found[0] == found[1]
    path = OfFunction(function=lambda t: [t, 0.0, -RANGE_M], about="body")
    moving = list(scenario_of(path=path, times_s=(1.0, 2.0)).iter_states())
    with pytest.raises(ConfigError, match="processes: must be 1: the motion of the states cannot be sent"):
        list(FrameSequence(scene=SPHERE, states=moving, folder=tmp_path / "a", options=options).draw(2))
    with pytest.raises(ConfigError, match="pool: must be none: the motion of the states cannot be sent"):
        list(DataSet(scene=SPHERE, states=moving, folder=tmp_path / "c", format="coco", options=options).draw(
            pool=nullcontext()))
    options = replace(options, output="irradiance")
    assert len(list(FrameSequence(scene=SPHERE, states=moving, folder=tmp_path / "b", options=options).draw(2))) == 2


@pytest.mark.parametrize("kind", [FrameSequence, DataSet])
@pytest.mark.parametrize("n_processes", [{}, {"n_processes": 0}])
def test_by_default_one_process_draws_what_cannot_be_sent(tmp_path, caplog, kind, n_processes):
    """A lambda for one of the states alone: the last."""
    at = lambda path: list(scenario_of(path=path, times_s=(1.0,)).iter_states())  # noqa: E731
    states = [*at(OfFunction(function=standing, about="body")),
              *at(OfFunction(function=lambda t: standing(t), about="body"))]
    more = {"format": "coco"} if kind is DataSet else {}
    made = kind(scene=SPHERE, states=states, folder=tmp_path, **more, options=FrameOptions(
        camera="navcam", output="dn", format="npz"))
    assert list(made.draw(**n_processes)) and made.missing() == []
    assert "one process draws: the motion of the states cannot be sent" in caplog.text


def standing(t_s):
    return [0.0, 0.0, -RANGE_M]


def test_a_notebooks_own_functions_are_not_sent(monkeypatch, caplog):
    """Its `__main__` has no file that another process could import."""
    def course(dt_s):
        return []
    course.__module__, course.__qualname__ = "__main__", "course"
    main = ModuleType("__main__")
    main.course = course
    monkeypatch.setitem(sys.modules, "__main__", main)
    state = next(scenario_of().iter_states()).with_course(course)
    options = FrameOptions(camera="navcam", output="dn", format="npz")
    assert processes_of([state], options, None) == 1 and "a notebook" in caplog.text
    main.__file__ = "script.py"
    assert processes_of([state], options, None) is None


def shaken(frequency_hz):
    """The same two states whatever the frequency, that turn by 2 mrad about the camera's X before and after."""
    def course_of(state):
        def course(dt_s):
            q = Rotation.from_rotvec(0.002 * np.sin(2.0 * np.pi * frequency_hz * dt_s)[:, None] * [1.0, 0.0, 0.0])
            return [replace(state, t_s=state.t_s + dt, spacecraft=replace(state.spacecraft, q_from_inertial=each))
                    for dt, each in zip(dt_s.tolist(), q.as_quat(scalar_first=True), strict=True)]
        return course
    return [state.with_course(course_of(state)) for state in scenario_of(times_s=(1.0, 2.0)).iter_states()]


@pytest.mark.parametrize("kind, exposure_s", [
    (FrameSequence, None), (DataSet, None), (FrameSequence, 0.05), (FrameSequence, "auto")])
def test_a_folder_is_not_filled_up_with_frames_of_another_motion(tmp_path, kind, exposure_s):
    """Jitter of 20 Hz instead of 30 Hz about the same states; irradiance does not depend on it."""
    more = {"format": "coco"} if kind is DataSet else {}
    made = lambda states, **options: kind(  # noqa: E731
        scene=SPHERE, states=states, folder=tmp_path / options.get("output", "dn"), **more,
        options=FrameOptions(**{"camera": "navcam", "output": "dn", "format": "npz", "exposure_s": exposure_s,
                                **options}))
    assert list(made(shaken(30.0)).draw(1)) and list(made(shaken(30.0)).draw(1)) == []
    with pytest.raises(ConfigError, match="another sequence: states_sha256 differ"):
        list(made(shaken(20.0)).draw(1))
    if kind is FrameSequence:
        still = {"output": "irradiance", "exposure_s": None}
        assert list(made(shaken(30.0), **still).draw(1)) and list(made(shaken(20.0), **still).draw(1)) == []


def test_a_late_rows_motion_counts():
    """A turn that begins after the exposure of the middle row, within that of the last."""
    camera = replace(CAMERA, model=replace(MODEL, exposure_s=0.01, detector=replace(
        MODEL.detector, rolling_shutter_row_s=0.01)))
    scene = replace(SPHERE, cameras=[camera])
    options = FrameOptions(camera="navcam", output="dn", format="npz")
    state = shaken(30.0)[0]
    later = state.with_course(lambda dt_s: [state if dt < 0.1 else shaken(20.0)[1] for dt in dt_s])
    digests = {digest_of_states([each], exposures_of(scene, options)) for each in (
        state.with_course(lambda dt_s: [state] * len(dt_s)), later)}
    assert len(digests) == 2
    assert digest_of_states([later], (0.01,)) == digest_of_states([state.with_course(
        lambda dt_s: [state] * len(dt_s))], (0.01,))
