"""FITS files as astropy reads them: dates, units, mosaics, names; sky coordinates against the camera's projection."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from glrender import PinholeCamera, Pose, State, frames
from glrender.sequences.fits_cards import cards_of, sky_cards
from glrender.sequences.header import camera_table
from glrender_camera import BrownConrady, CameraModel, MosaicModel
from missing import needed_module
from scipy.spatial.transform import Rotation

try:
    from astropy import units
    from astropy.io import fits
    from astropy.time import Time
    from astropy.wcs import WCS
except ImportError:
    # Without it the tests are skipped by name, or fail where nothing may be missing.
    pass

DATE = "2014-08-08T12:00:00.250000"
SHAPES = {"wide": (64, 48, 60.0, None), "narrow": (101, 55, 9000.0, (20.25, 61.5))}


@pytest.fixture(autouse=True)
def astropy_is_there():
    needed_module("astropy", "pip install 'glrender[fits]'")


def camera_of(name="navcam", kind="wide", **more):
    width_px, height_px, focal_px, centre_px = SHAPES[kind]
    return PinholeCamera(name=name, width_px=width_px, height_px=height_px, focal_length_px=focal_px,
                         principal_point_px=centre_px, q_camera_from_spacecraft=Rotation.random(
                             rng=np.random.default_rng(4)).as_quat(scalar_first=True), **more)


def header_of(camera, q=(1.0, 0.0, 0.0, 0.0), **more):
    state = State(r_sun_inertial_m=[1e11, 0.0, 0.0], bodies={}, date_tdb=DATE,
                  spacecraft=Pose(r_inertial_m=[1.0, 2.0, 3.0], q_from_inertial=q))
    return {"glrender": "1", "index": 3, "date_tdb": DATE, "inertial_axes": "ICRF", "state": state.to_dict(),
            "exposure_s": None, "seed": None, "camera": camera_table(camera),
            "plan": {"asked": {"rms": 0.02}, "max_error": 0.02, "predicted_error": 0.01}, **more}


def cards(*tables):
    header = fits.Header()
    for table in tables:
        for name, card in table.items():
            header[name] = card
    # As a file has them: long strings and quotes are cut and joined.
    return fits.Header.fromstring(header.tostring())


def towards(longitude_deg, latitude_deg, roll_deg):
    """Camera from inertial with the boresight there, by SciPy: +Z to the place, turned by the roll."""
    boresight = Rotation.from_euler("zy", [longitude_deg, 90.0 - latitude_deg], degrees=True)
    return (boresight * Rotation.from_euler("z", roll_deg, degrees=True)).inv()


PLACES = [(0.0, 0.0, 0.0), (123.4, -56.7, 33.0), (359.9, 12.0, 180.0), (210.0, 89.99, 70.0), (77.0, 90.0, 20.0),
          (10.0, -90.0, 200.0)]


@pytest.mark.parametrize("kind", SHAPES)
@pytest.mark.parametrize("place", PLACES)
def test_pixels_have_the_sky_coordinates_of_their_directions(kind, place):
    """astropy's pixels of directions are the camera's, and back, to 1e-6 px: FITS counts rows from below."""
    camera = camera_of(kind=kind)
    camera_from_inertial = towards(*place)
    mounting = Rotation.from_quat(camera.q_camera_from_spacecraft, scalar_first=True)
    q = (mounting.inv() * camera_from_inertial).as_quat(scalar_first=True)
    wcs = WCS(cards(sky_cards(header_of(camera, q))))
    assert wcs.has_celestial and list(wcs.wcs.ctype) == ["RA---TAN", "DEC--TAN"] and wcs.wcs.radesys == "ICRS"
    x, y = (axis.ravel().astype(float) for axis in np.meshgrid(np.linspace(-0.5, camera.width_px - 0.5, 5),
                                                               np.linspace(-0.5, camera.height_px - 0.5, 5)))
    r = camera_from_inertial.inv().apply(camera.directions(np.stack([x, y], axis=1)))
    longitude = np.degrees(np.arctan2(r[:, 1], r[:, 0]))
    latitude = np.degrees(np.arctan2(r[:, 2], np.hypot(r[:, 0], r[:, 1])))
    column, row = wcs.all_world2pix(longitude, latitude, 0)
    np.testing.assert_allclose(column, x, atol=1e-6)
    np.testing.assert_allclose(camera.height_px - 1.0 - row, y, atol=1e-6)
    told = wcs.pixel_to_world(x, camera.height_px - 1.0 - y)
    np.testing.assert_allclose(told.cartesian.xyz.value.T, r, atol=1e-9)


def test_without_a_known_frame_they_are_of_the_states_own():
    header = header_of(camera_of(), inertial_axes="unknown")
    wcs = WCS(cards(sky_cards(header)))
    assert list(wcs.wcs.ctype) == ["INLN-TAN", "INLT-TAN"] and wcs.wcs.radesys == ""
    ahead = frames.dcm(camera_of().q_camera_from_spacecraft)[2]
    x, y = camera_of().principal_point_px
    longitude, latitude = np.radians(wcs.all_pix2world(x, 47.0 - y, 0))
    np.testing.assert_allclose([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude),
                                np.sin(latitude)], ahead, atol=1e-9)


def test_a_distorted_image_has_no_wrong_projection():
    camera = camera_of(distortion=BrownConrady(k1=0.1))
    found = sky_cards(header_of(camera))
    assert "CTYPE1" not in found and found["CRPIX1"][0] == camera.principal_point_px[0] + 1.0


@pytest.mark.parametrize("exposure_s", [None, 0.5, 3600.0])
def test_dates_are_those_of_the_exposure_in_tdb(exposure_s):
    model = CameraModel.from_dict({"preset": "generic_navigation_camera", "exposure_s": 0.5})
    found = cards(cards_of(header_of(camera_of(model=model), exposure_s=exposure_s, seed=5)))
    scale, middle = found["TIMESYS"].lower(), Time(DATE, scale="tdb")
    half_s = 0.5 * (exposure_s or 0.0)
    for name, offset_s in (("DATE-OBS", -half_s), ("DATE-BEG", -half_s), ("DATE-AVG", 0.0), ("DATE-END", half_s)):
        assert abs((Time(found[name], scale=scale) - middle).sec - offset_s) < 2e-6, name
        days = Time(found[name.replace("DATE", "MJD")], format="mjd", scale=scale)
        assert abs((days - middle).sec - offset_s) < 1e-4, name
    assert found.get("EXPTIME") == exposure_s


def test_without_a_date_there_is_none():
    header = header_of(camera_of())
    found = cards_of({**header, "date_tdb": None, "state": {**header["state"], "date_tdb": None}})
    assert not [name for name in found if "DATE" in name or "MJD" in name or name == "TIMESYS"]


@pytest.mark.parametrize("name", ["Náv 2", "カメラ", "O'Neill's \"cam\"", "a/b\\c.d", "x" * 128, "é" * 128, "'", "&",
                                  " a "])
def test_any_name_is_a_card(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = cards(cards_of(header_of(camera_of(name=name))))["INSTRUME"]
    assert found.encode().decode("unicode_escape" if not name.isascii() else "ascii").rstrip() == name.rstrip()


@pytest.mark.parametrize("long", range(40, 75))
def test_a_long_string_has_no_cut_comment(long):
    """Names, also of quotes, that fill a card's 80 characters with their comment or without."""
    asked = dict.fromkeys(("rms", "total_flux", "centroid_px", "limb_px", "landmark_px"), 0.000123457)
    for name in ("x" * long, "'" * (long // 2), "é" * (long // 4)):
        header = header_of(camera_of(name=name), plan={"asked": asked, "max_error": 0.02, "predicted_error": 0.01})
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = cards(cards_of(header))
        assert found.comments["INSTRUME"] in ("camera", "") and found.comments["FOCALPX"] == "[px] focal length"
        assert found["ASKED"] == ",".join(f"{unit}={most:g}" for unit, most in asked.items())
    assert cards(cards_of(header_of(camera_of()))).comments["INSTRUME"] == "camera"


@pytest.mark.parametrize("pattern", [("RG", "GB"), ("GR", "BG"), ("RGB",), ("RG", "GB", "GR")])
@pytest.mark.parametrize("height_px", [32, 33, 35])
def test_a_mosaics_pattern_is_that_of_the_rows_as_the_file_has_them(pattern, height_px):
    model = CameraModel.from_dict({"preset": "generic_navigation_camera", "exposure_s": 0.5})
    letters = sorted(set("".join(pattern)))
    mosaic = MosaicModel(optics={letter: replace(model.optics, band_nm=(400.0, 700.0)) for letter in letters},
                         detector=model.detector, exposure_s=0.1, pattern=pattern)
    camera = replace(camera_of(model=mosaic), height_px=height_px)
    found = cards(cards_of(header_of(camera, exposure_s=0.1, seed=1)))
    columns = len(pattern[0])
    image = np.array([[pattern[i % len(pattern)][j % columns] for j in range(6)] for i in range(height_px)])
    rows = found["BAYERPAT"]
    assert found["ROWORDER"] == "BOTTOM-UP" and found["BAYERROW"] == len(pattern)
    for k, row in enumerate(np.flipud(image)):
        start = k % found["BAYERROW"] * columns
        assert "".join(row[:columns]) == rows[start:start + columns]


def test_the_detectors_numbers():
    """Of 16 bits: the gain in electrons for a digital number, as astronomers have it."""
    model = CameraModel.from_dict({"preset": "generic_navigation_camera", "exposure_s": 0.5})
    found, detector = cards(cards_of(header_of(camera_of(model=model), exposure_s=0.5, seed=2**53 - 1))), model.detector
    assert found["GAIN"] * detector.gain_DN_per_electron == pytest.approx(1.0)
    assert (found["OFFSET"], found["BITDEPTH"]) == (detector.offset_DN, detector.bit_depth)
    assert found["SEED"] == 2**53 - 1 and found["SATURATE"] == detector.max_DN


def test_every_part_of_a_file_has_its_unit(tmp_path):
    from glrender.sequences.formats import FrameFile, write

    shape = (48, 64)
    products = {"range": (np.ones(shape), "m"), "body_id": (np.zeros(shape, np.int32), ""),
                "facet_id": (np.full(shape, 2**24 + 1, np.int32), ""), "phase": (np.ones(shape, np.float32), "rad"),
                "r_body": (np.ones((*shape, 3), np.float32), "m"), "sunlit": (np.ones(shape, np.float32), "")}
    for unit, pixels in (("DN", np.ones(shape, np.uint16)), ("W/m2", np.ones(shape, np.float32))):
        path = tmp_path / f"{len(unit)}.fits"
        write(path, FrameFile(pixels=pixels, unit=unit, header=header_of(camera_of()),
                              products={name: array for name, (array, _) in products.items()}))
        with fits.open(path) as file:
            file.verify("exception")
            assert units.Unit(file[0].header["BUNIT"]) == units.Unit(unit)
            for name, (array, unit_of) in products.items():
                assert units.Unit(file[name].header["BUNIT"]) == units.Unit(unit_of), name
                assert (file[name].header.get("CTYPE1") == "RA---TAN") == (array.ndim == 2)
            assert (file["FACET_ID"].data == 2**24 + 1).all()
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                assert WCS(file[0].header).wcs.dateavg == DATE
            assert all(part.header["BUNIT"] for part in file)
