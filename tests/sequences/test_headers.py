"""All that a reader must know is in every format and data set: one walk over formats x fields, by foreign readers.

Truth is the scenario's own table: its date, its cameras, its seeds, as they were written down.
"""

from __future__ import annotations

import json
import tarfile
from pathlib import Path

import numpy as np
import pytest
from glrender import Scene
from glrender.scenario import scenario_of_table
from glrender.sequences.dataset.dataset import DataSet
from glrender.sequences.formats import FORMATS
from glrender.sequences.header import FIELDS, camera_table
from glrender.sequences.options import FrameOptions
from glrender.sequences.sequence import FrameSequence
from glrender_camera.pattern import seed_of
from missing import needed_module
from PIL import Image

NAME = "Náv 2/\"ä\" 'q' カメラ.." + "x" * 100
BODY = "Ряд/ \"1\"."
OPTICS = {letter: {"aperture_diameter_m": 0.01, "psf_sigma_px": 0.5, "band_nm": band}
          for letter, band in (("R", [600.0, 700.0]), ("G", [500.0, 600.0]), ("B", [420.0, 500.0]))}
DETECTOR = {"quantum_efficiency": 0.5, "full_well_electrons": 31000.0, "gain_DN_per_electron": 0.125, "bit_depth": 12,
            "offset_DN": 48.0, "read_noise_electrons": 10.0,
            "nonlinearity_DN": [[0.0, 0.0], [2000.0, 1990.0], [4095.0, 4000.0]]}
LAW = {"law": "lambert", "normal_albedo": 0.05}
CAMERAS = [{"name": NAME, "width_px": 40, "height_px": 33, "focal_length_px": 150.0, "principal_point_px": [19.0, 15.5],
            "q_camera_from_spacecraft": [0.5, 0.5, 0.5, 0.5], "r_camera_spacecraft_m": [0.1, 0.2, 0.3],
            "model": {"pattern": ["RG", "GB"], "exposure_s": 0.02, "optics": OPTICS, "detector": DETECTOR}},
           {"name": "bent", "width_px": 40, "height_px": 32, "focal_length_px": 150.0,
            "distortion": {"k1": 0.1, "p1": 0.01}}]
TABLE = {"cameras": CAMERAS,
         "bodies": [{"name": BODY, "generated": {"kind": "icosphere", "radius_m": 2000.0},
                     "brdf": LAW,
                     "orbit": {"semi_major_axis_m": 5.18e11, "eccentricity": 0.64, "inclination_deg": 7.0,
                               "longitude_ascending_node_deg": 50.1, "argument_of_periapsis_deg": 12.8,
                               "mean_anomaly_deg": 302.3, "epoch_tdb": "2014-08-01T00:00:00"}}],
         "encounter": {"distance_m": 6e4, "relative_velocity_m_s": 1e4, "side": "terminator",
                       "date_tdb": "2014-08-08T12:00:00", "duration_s": 6.0, "frames": 3}}
DATES = ["2014-08-08T11:59:57.000000", "2014-08-08T12:00:00.000000", "2014-08-08T12:00:03.000000"]
FROM_HERE = {name: value for name, value in CAMERAS[0].items() if name != "model"}
EXPECTED = {"index": 1, "date_tdb": DATES[1], "inertial_axes": "ICRF", "bodies": [BODY], "unit": "DN",
            "exposure_s": 0.02, "seed": seed_of(7, 1), "faults": [], "state.date_tdb": DATES[1],
            **{f"camera.{name}": value for name, value in FROM_HERE.items()},
            "camera.distortion": None, "camera.compression": None, "camera.mosaic": ["RG", "GB"],
            "camera.aperture_diameter_m": dict.fromkeys("RGB", 0.01),
            "camera.band_nm": {letter: optics["band_nm"] for letter, optics in OPTICS.items()},
            **{f"camera.detector.{name}": value for name, value in DETECTOR.items()}}
LIBRARIES = {"fits": "astropy", "exr": "OpenEXR", "hdf5": "h5py"}
DATA_SETS = ("webdataset", "hdf5", "coco", "bop")


@pytest.fixture(scope="module")
def scenario():
    return scenario_of_table(TABLE)


@pytest.fixture(scope="module")
def written(scenario, tmp_path_factory):
    """The folder of a format or data set with the scenario's three frames, drawn once each."""
    made = {}

    def folder_of(kind, **asked):
        key = (kind, *sorted(asked.items()))
        if key not in made:
            needed_module(LIBRARIES.get(kind, "numpy"), f"pip install 'glrender[{kind}]'")
            folder = tmp_path_factory.mktemp(kind)
            options = {"camera": NAME, "output": "dn", "seed": 7, **asked}
            states = list(scenario.iter_states())
            if kind in FORMATS:
                drawn = FrameSequence(scene=scenario.scene, states=states, folder=folder,
                                      options=FrameOptions(format=kind, **options))
            else:
                drawn = DataSet(scene=scenario.scene, states=states, folder=folder, format=kind, frames_a_shard=2,
                                options=FrameOptions(**options))
            list(drawn.draw(1))
            made[key] = folder
        return made[key]

    return folder_of


def frame_of(folder, kind):
    return folder / f"frame_00001.{kind}"


def header_of(folder, kind):
    """The header of frame 1, by a program that knows nothing of glrender."""
    if kind == "fits":
        from astropy.io import fits
        with fits.open(frame_of(folder, kind)) as file:
            file.verify("exception")
            return json.loads(bytes(file["GLRENDER"].data))
    if kind == "npz":
        with np.load(frame_of(folder, kind)) as stored:
            return json.loads(str(stored["header"]))
    if kind == "png":
        return json.loads(Image.open(frame_of(folder, kind)).text["glrender"])
    if kind == "exr":
        import OpenEXR
        with OpenEXR.File(str(frame_of(folder, kind))) as file:
            return json.loads(file.header()["glrender"])
    if kind == "webdataset":
        with tarfile.open(folder / "shard_00000.tar") as tar:
            return json.load(tar.extractfile("000001.json"))
    if kind == "hdf5":
        import h5py
        with h5py.File(folder / "shard_00000.h5") as file:
            return json.loads(file["labels"][1])
    if kind == "coco":
        images = json.loads((folder / "annotations.json").read_text())["images"]
        return next(image["header"] for image in images if image["id"] == 1)
    return json.loads((folder / "train" / "000000" / "scene_header.json").read_text())["1"]


def at(header, path):
    for key in path.split("."):
        header = header[key]
    return header


@pytest.mark.parametrize("kind", [*FORMATS, *DATA_SETS])
def test_every_format_has_every_field(written, kind):
    header = header_of(written(kind), kind)
    for path in FIELDS:
        at(header, path)
    assert {path.split(".")[0] for path in FIELDS} | {"warning_codes", "labels"} >= set(header)
    for path, value in EXPECTED.items():
        assert at(header, path) == value, path
    assert at(header, "state.t_s") == 3.0 and at(header, "plan.asked") == {"rms": 0.02}
    assert set(header["state"]["bodies"]) == {BODY}


@pytest.mark.parametrize("compression", [
    {"codec": "jpeg_ls", "max_error_DN": 3}, {"codec": "jpeg_ls", "share_of_noise": 0.5}, {"codec": "jpeg_ls"},
    {"codec": "jpeg_2000", "rate_bpp": 2.0}, {"codec": "jpeg_xl", "psnr_db": 50.0}, {"codec": "ccsds_121"}])
def test_a_camera_has_the_compression_of_its_frames(compression):
    needed_module("imagecodecs", "pip install 'glrender[compression]'")
    efficiency = [[400.0, 0.2], [900.0, 0.4]]
    for mosaic in ({}, {"pattern": ["RG", "GB"], "optics": OPTICS}):
        table = {"exposure_s": 0.02, "optics": {"aperture_diameter_m": 0.01}, **mosaic, "compression": compression,
                 "detector": {**DETECTOR, "quantum_efficiency": efficiency}}
        rock = {"name": "rock", "generated": {"kind": "icosphere", "radius_m": 9.0, "subdivisions": 1}, "brdf": LAW}
        camera = Scene.from_dict({"bodies": [rock], "cameras": [{**CAMERAS[0], "model": table}]}).camera(NAME)
        header = json.loads(json.dumps(camera_table(camera)))
        assert header["compression"] == compression
        assert header["detector"]["quantum_efficiency"] == efficiency


def test_frames_have_their_own_dates(written):
    folder = written("npz")
    found = [json.loads(str(np.load(folder / f"frame_{index:05d}.npz")["header"]))["date_tdb"] for index in range(3)]
    assert found == DATES


@pytest.mark.parametrize("kind", ["fits", "npz", "exr"])
def test_irradiance_and_a_lens_and_products_are_told(written, kind):
    folder = written(kind, camera="bent", output="irradiance", products=("range", "facet_id", "phase", "r_body"))
    header = header_of(folder, kind)
    assert all(header[name] is None for name in ("exposure_s", "seed"))
    assert header["unit"] == "W/m2"
    assert header["units"] == {"irradiance": "W/m2", "range": "m", "body_id": "1", "facet_id": "1", "incidence": "rad",
                               "emission": "rad", "phase": "rad", "r_body": "m", "sunlit": "1", "normal": "1",
                               "tilt": "rad", "part_id": "1", "flow": "px"}
    assert header["camera"]["distortion"] == dict.fromkeys(("k2", "k3", "k4", "k5", "k6", "p2"), 0.0) | {
        "k1": 0.1, "p1": 0.01}
    assert all(header["camera"][name] is None for name in ("detector", "mosaic", "band_nm"))


def test_the_standards_own_fields_of_data_sets(written):
    """COCO's date_captured; BOP's camera from the world, in millimetres; HDF5's units."""
    image = json.loads((written("coco") / "annotations.json").read_text())["images"][1]
    assert image["date_captured"] == DATES[1]
    folder = written("bop") / "train" / "000000"
    camera, body = (json.loads((folder / f"scene_{name}.json").read_text())["1"] for name in ("camera", "gt"))
    state = json.loads((folder / "scene_header.json").read_text())["1"]["state"]
    turn, shift = np.reshape(camera["cam_R_w2c"], (3, 3)), np.array(camera["cam_t_w2c"])
    r_body = 1000.0 * np.array(state["bodies"][BODY]["r_inertial_m"])
    np.testing.assert_allclose(turn @ r_body + shift, body[0]["cam_t_m2c"], atol=1.0)
    h5py = needed_module("h5py", "pip install 'glrender[hdf5]'")
    with h5py.File(written("hdf5", products=("range", "phase")) / "shard_00000.h5") as file:
        units = {name: file[name].attrs["unit"] for name in ("image", "products/range", "products/phase", "r_camera_m")}
        assert units == {"image": "DN", "products/range": "m", "products/phase": "rad", "r_camera_m": "m"}
        assert list(file.attrs["bodies"]) == [BODY]


def test_the_page_lists_every_field():
    page = (Path(__file__).parents[2] / "docs" / "sequences.md").read_text(encoding="utf-8")
    assert [path for path in FIELDS if f"`{path}`" not in page] == []
