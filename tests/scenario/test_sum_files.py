"""SUM files of stereophotoclinometry: camera, pose and light of an image, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
from glrender import ConfigError, frames
from glrender.base.constants import AU_M
from glrender.scenario import Epoch, image_of_sum

# Dawn's Framing Camera at Vesta, as SPC's wiki prints it (page do_make_sumfiles).
VESTA = """FC21A0023451
2012 MAR 25 23:39:03.808
  1024  1024   300 16383                                       NPX, NLN, THRSH
    0.1500732773D+03    0.5125000000D+03    0.5125000000D+03   MMFL, CTR
    0.4675316063D+03    0.7650238938D+02   -0.8860865402D+02   SCOBJ
    0.3331488499D-01   -0.8781311273D+00   -0.4772586737D+00   CX
   -0.2747849082D+00    0.4510732595D+00   -0.8491325979D+00   CY
    0.9609283910D+00    0.1594322357D+00   -0.2262697274D+00   CZ
   -0.5187801868D+00   -0.8129191206D+00   -0.2646311039D+00   SZ
  71.42860   0.00000   0.00000   0.00386 -71.44341   0.00000   K-MATRIX
    0.00000D+00    0.00000D+00    0.00000D+00    0.00000D+00   DISTORTION
    0.2000000000D+00    0.2000000000D+00    0.2000000000D+00   SIGMA_VSO
    0.1000000000D-03    0.1000000000D-03    0.1000000000D-03   SIGMA_PTG
LANDMARKS
LIMB FITS
END FILE
"""


@pytest.fixture
def image(tmp_path):
    def read(text=VESTA, **more):
        (tmp_path / "A.SUM").write_text(text)
        return image_of_sum(tmp_path / "A.SUM", body="vesta", **more)
    return read


def test_vestas_image_is_dawns(image):
    """482 km from Vesta, its centre in the field; the optical axis in the middle of 1024 pixels."""
    made = image(camera="fc2")
    assert (made.name, made.camera.name, made.camera.width_px) == ("FC21A0023451", "fc2", 1024)
    assert made.epoch == Epoch.from_utc("2012-03-25T23:39:03.808")
    np.testing.assert_allclose(made.camera.focal_length_px, 150.0732773 * 71.436, rtol=1e-5)
    np.testing.assert_array_equal(made.camera.principal_point_px, (511.5, 511.5))
    state = made.state
    r = state.spacecraft.r_inertial_m
    np.testing.assert_allclose(r, [-467531.6063, -76502.38938, 88608.65402], rtol=1e-12)
    x, y, z = frames.dcm(state.spacecraft.q_from_inertial) @ -r
    assert z > 0.99 * np.linalg.norm(r) and max(abs(x), abs(y)) / z < 512 / made.camera.focal_length_px
    np.testing.assert_allclose(np.linalg.norm(state.r_sun_inertial_m), AU_M, rtol=1e-12)
    assert np.linalg.norm(image(sun_distance_m=3e11).state.r_sun_inertial_m) == pytest.approx(3e11)


@pytest.mark.parametrize("date, iso", [
    ("2012 MAR 25 23:39:03", "2012-03-25T23:39:03"), ("2012 MAR 25 23:39:03.", "2012-03-25T23:39:03"),
    ("2012 mar  5 23:39:03.80812345", "2012-03-05T23:39:03.80812345"), ("2000 Feb 12 00:00:00", "2000-02-12T00:00:00")])
def test_dates_may_have_any_fraction_of_a_second_or_none(image, date, iso):
    assert image(VESTA.replace("2012 MAR 25 23:39:03.808", date)).epoch == Epoch.from_utc(iso)


def test_lines_are_counted_from_below_where_k22_is_negative(image):
    """CTR is of pixel centres from 1: (513, 513) is column 512, and row 511 from above or 512."""
    moved = VESTA.replace("0.5125000000D+03    0.5125000000D+03", "0.5130000000D+03    0.5130000000D+03")
    np.testing.assert_array_equal(image(moved).camera.principal_point_px, (512.0, 511.0))
    downwards = moved.replace("-71.44341", " 71.44341")
    np.testing.assert_array_equal(image(downwards).camera.principal_point_px, (512.0, 512.0))
    np.testing.assert_array_equal(image(downwards).state.spacecraft.q_from_inertial,
                                  image(moved).state.spacecraft.q_from_inertial)


def test_a_turned_detector_is_the_same_image(image):
    """CX, CY and both rows of K with the other sign: half a turn twice."""
    turned = (VESTA.replace("  71.42860   0.00000   0.00000   0.00386 -71.44341",
                            " -71.42860   0.00000   0.00000  -0.00386  71.44341")
              .replace("0.3331488499D-01   -0.8781311273D+00   -0.4772586737D+00",
                       "-0.3331488499D-01  0.8781311273D+00    0.4772586737D+00")
              .replace("-0.2747849082D+00    0.4510732595D+00   -0.8491325979D+00",
                       " 0.2747849082D+00   -0.4510732595D+00    0.8491325979D+00"))
    one, other = image(), image(turned)
    np.testing.assert_allclose(one.state.spacecraft.q_from_inertial, other.state.spacecraft.q_from_inertial, atol=1e-12)
    assert one.camera.principal_point_px == other.camera.principal_point_px


def test_bennus_image_is_as_others_read_it(shared):
    """Another reading of the same file, `poses.json`, but for the principal point: that one has the image's middle."""
    made = image_of_sum(shared / "bennu" / "M605862153F5.SUM", body="bennu")
    (pose,) = json.loads((shared / "bennu" / "poses.json").read_text())["images"].values()
    np.testing.assert_allclose(frames.dcm(made.state.spacecraft.q_from_inertial), pose["R_body_to_cam"], atol=1e-9)
    np.testing.assert_allclose(made.state.spacecraft.r_inertial_m, np.array(pose["pos_body_km"]) * 1e3, rtol=1e-12)
    np.testing.assert_allclose(made.state.r_sun_inertial_m / AU_M, pose["sun_body"], atol=1e-9)
    np.testing.assert_allclose(made.camera.focal_length_px, pose["fx"], rtol=1e-4)
    assert made.camera.principal_point_px == (512.0, 511.0)


@pytest.mark.parametrize("old, new, message", [
    ("0.9609283910D+00 ", "0.9509283910D+00 ", "A.SUM.CX: and CY, CZ must be orthonormal within 1e-6"),
    ("-0.2747849082D+00    0.4510732595D+00   -0.8491325979D+00",
     " 0.2747849082D+00   -0.4510732595D+00    0.8491325979D+00", "A.SUM.CX: CY and CZ must be right-handed"),
    ("0.4675316063D+03", "none", "A.SUM:5.SCOBJ: must be finite numbers, got ['none', "),
    ("0.4675316063D+03", "nan", "A.SUM:5.SCOBJ: must be finite numbers, got ['nan', "),
    ("SCOBJ", "", "A.SUM:5: must have 3 numbers and then SCOBJ, got '0.4675"),
    ("0.00386", "0.20000", "A.SUM.K-MATRIX: must be of square pixels without skew within 0.5 px at a corner"),
    ("-71.44341", "-71.64341", "A.SUM.K-MATRIX: must be of square pixels without skew within 0.5 px at a corner"),
    ("0.1500732773D+03", "0.0", "A.SUM.K-MATRIX: must give a focal length"),
    ("0.00000D+00    0.00000D+00    0.00000D+00    0.00000D+00", "0.0 0.1 0.0 0.0", "A.SUM.DISTORTION: must be 0"),
    ("03.808", "03.8x", "A.SUM:2: must be a date"),
    ("2012 MAR 25 23", "2012 MAR 32 23", "A.SUM:2: must be a date"),
    ("39:03.808", "39.808", "A.SUM:2: must be a date"),
    ("2012 MAR 25", "2012-03-25", "A.SUM:2: must be a date in UTC as 2019 MAR 14 19:01:23.961"),
    ("  1024  1024", "     0  1024", "A.SUM.width_px: must be"),
])
def test_what_is_wrong_is_told_with_its_line(image, old, new, message):
    text = VESTA.replace(old, new)
    assert text != VESTA
    with pytest.raises(ConfigError) as caught:
        image(text)
    assert message in str(caught.value)


def test_what_is_no_sum_file_is_told(tmp_path):
    (tmp_path / "short.SUM").write_text("M605862153F5\n")
    with pytest.raises(ConfigError, match="short.SUM: must have 11 lines at least, got 1; give a SUM file of SPC"):
        image_of_sum(tmp_path / "short.SUM", body="bennu")
    with pytest.raises(ConfigError, match="none.SUM: cannot be read"):
        image_of_sum(tmp_path / "none.SUM", body="bennu")
