"""Pictures of a real close-up, which fills its frame: the body is bright behind every door that shows it."""

from __future__ import annotations

import base64
import re

import cv2
import numpy as np
import pytest
from glrender import Body, PinholeCamera, Pose, Scene, State, open_renderer, take_frame
from glrender.brdf import Lambert
from glrender.scene.shape import generate
from glrender.sequences.contact_sheet import contact_sheet
from glrender.sequences.dataset.dataset import DataSet
from glrender.sequences.dataset.sheet import label_sheet
from glrender.sequences.options import FrameOptions
from glrender.sequences.sequence import FrameSequence
from glrender.sequences.video import write_video
from glrender_camera import CameraModel
from glrender_cli.picture import write_picture

RANGE_M, OFFSET_DN = 450.0, 50.0
# Well exposed, of which noise is the most of the contrast, and saturated at the full well.
EXPOSURES_S = {"well": 8e-5, "short": 1e-6, "saturated": 1.0}


def grey_of(data):
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)


def state(phase_deg=30.0):
    angle = np.radians(phase_deg)
    return State(r_sun_inertial_m=[1.5e11 * np.sin(angle), 0.0, -1.5e11 * np.cos(angle)],
                 spacecraft=Pose(r_inertial_m=[0.0, 0.0, -RANGE_M]),
                 bodies={"rock": Pose(r_inertial_m=[0.0, 0.0, 0.0])})


@pytest.fixture(scope="module")
def scene():
    model = CameraModel.from_dict({"preset": "generic_navigation_camera", "exposure_s": 1e-4})
    rock = Body(name="rock", shape=generate.contact_binary(radius_m=250.0, seed=1, subdivisions=4),
                brdf=Lambert(normal_albedo=0.02))
    return Scene(bodies=[rock], cameras=[PinholeCamera(name="c", width_px=160, height_px=160, focal_length_px=1280.0,
                                                       model=model)])


@pytest.mark.parametrize("name", EXPOSURES_S)
def test_a_close_up_is_bright_in_every_picture(scene, tmp_path, name):
    options = FrameOptions(camera="c", output="dn", format="npz", exposure_s=EXPOSURES_S[name])
    with open_renderer(scene) as renderer:
        capture = take_frame(renderer, state(), "c", exposure_s=EXPOSURES_S[name], seed=1)
    dn = capture.frame.dn
    assert np.quantile(dn, 0.05) > OFFSET_DN + 15.0 and capture.frame.saturated.all() == (name == "saturated")
    drawn = FrameSequence(scene=scene, states=[state()], folder=tmp_path / "frames", options=options)
    data = DataSet(scene=scene, states=[state()], folder=tmp_path / "data", format="coco", options=options)
    assert [*drawn.draw(1), *data.draw(1)] == [0, 0]
    label_sheet(tmp_path / "labels.png", data)
    contact_sheet(tmp_path / "sheet.png", [("0", dn)], OFFSET_DN)
    write_video(tmp_path / "video.mp4", [drawn.path(0)], offset_DN=OFFSET_DN)
    write_picture(tmp_path / "picture.png", dn, offset_DN=OFFSET_DN)
    film = cv2.VideoCapture(str(tmp_path / "video.mp4"))
    read = lambda file: grey_of((tmp_path / file).read_bytes())  # noqa: E731
    shown = {"frame": grey_of(capture.frame._repr_png_()), "capture": grey_of(capture._repr_png_()),
             "sequence": grey_of(base64.b64decode(re.search("base64,(.*?)'", drawn._repr_html_())[1])),
             "labels": read("labels.png")[10:300, 10:300], "sheet": read("sheet.png")[10:200, 10:200],
             "picture": read("picture.png"), "video": film.read()[1][..., 0]}
    film.release()
    for door, picture in shown.items():
        assert np.median(picture) > 120.0 and np.quantile(picture, 0.99) > 170.0, (door, np.median(picture))
