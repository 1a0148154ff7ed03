"""What notebooks show of images, plans and sequences: pictures that another program reads, and text without markup."""

from __future__ import annotations

import base64
import re

import cv2
import numpy as np
import pytest
import views
from glrender import Renderer, take_frame
from glrender.brdf import Lambert
from glrender.sequences.sequence import FrameOptions, FrameSequence
from glrender_camera import CameraModel
from glrender_camera.notebook import LARGEST_PX, png, strip, table


def read(data):
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_a_picture_is_black_at_zero_and_white_at_the_brightest(dtype):
    ramp = np.tile(np.arange(200), (40, 1)).astype(dtype)
    np.testing.assert_allclose(read(png(ramp)), ramp * 255.0 / 199.0, atol=0.6)


@pytest.mark.parametrize("image", [np.zeros((3, 5)), np.full((3, 5), np.nan), np.full((1, 1), 7.0)])
def test_flat_images_are_pictures_too(image):
    assert read(png(image)).shape == image.shape


def test_a_large_image_is_shown_small_each_pixel_a_mean():
    image = np.zeros((1500, 2048), np.float32)
    image[::2] = 1.0
    shown = read(png(image))
    assert shown.shape == (375, LARGEST_PX)
    # The mean of white and black rows is the same everywhere.
    assert shown.min() == shown.max() == 255


def test_text_is_no_markup():
    assert "<script>" not in table("<script>", [("<script>", "<script>")]) + strip([("<script>", b"")])


def test_images_plans_and_sequences_show_themselves(tmp_path):
    """Image, plan, capture, frame and sequence; irradiance where there is no detector."""
    model = CameraModel.from_dict({"preset": "generic_navigation_camera", "exposure_s": "auto"})
    scene = views.scene([views.sphere(Lambert(normal_albedo=0.1))], [views.camera(64, 400.0, model=model)])
    state = views.state()
    with Renderer(scene) as renderer:
        image = renderer.render(state)
        capture = take_frame(renderer, state, seed=1)
    picture = read(image._repr_png_())
    lit = image.irradiance_W_m2 > 0.0
    assert not picture[~lit].any() and picture[lit].mean() > 50.0
    np.testing.assert_array_equal(capture._repr_png_(), capture.frame._repr_png_())
    assert read(capture._repr_png_()).shape == (64, 64)
    assert "64 x 64" in repr(image) and "[DN]" in repr(capture) and len(repr(capture)) < 300
    assert f"{100.0 * image.plan.predicted_error:.2g} %" in image.plan._repr_html_()
    assert "body (20480 facets" in image.plan._repr_html_()
    sequence = FrameSequence(scene=scene, states=[state] * 7, folder=tmp_path / "f",
                             options=FrameOptions(camera="navcam", format="npz"))
    assert "0 of 7 drawn" in sequence._repr_html_() and "<img" not in sequence._repr_html_()
    assert len(list(sequence.draw(n_processes=1))) == 7
    shown = sequence._repr_html_()
    pictures = re.findall(r"base64,([^']+)'/><br/>(\d)", shown)
    assert "7 of 7 drawn" in shown and [name for _, name in pictures] == ["0", "2", "3", "4", "6"]
    assert all(read(base64.b64decode(data)).max() == 255 for data, _ in pictures)
