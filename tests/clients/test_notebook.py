"""What a notebook shows: pictures that another program reads, and text that cannot become markup."""

from __future__ import annotations

import base64

import cv2
import numpy as np
import pytest
import serving
import views
from glrender.sequences.contact_sheet import STRETCHES as OURS
from glrender.sequences.contact_sheet import grey_levels
from glrender_client import Client
from glrender_client.notebook import LARGEST_PX, STRETCHES, described, png, stretched
from missing import needed_module


def read(data):
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_a_picture_is_black_at_zero_and_white_at_the_brightest(dtype):
    ramp = np.tile(np.arange(200), (40, 1)).astype(dtype)
    shown = read(png(ramp))
    assert shown.shape == (40, 200) and shown.dtype == np.uint8
    np.testing.assert_allclose(shown, ramp * 255.0 / 199.0, atol=1.5)


def test_the_offset_of_digital_numbers_is_black():
    """Above it white is as far as without an offset."""
    dn = np.full((40, 200), 500, np.uint16)
    dn[10:30, 50:100] += 1000
    shown = read(png(dn))
    assert not shown[:10].any() and (shown[10:30, 50:100] == 255).all()
    dn[0, 0] = 2500
    shown = read(png(dn, white=2500))
    assert shown[0, 0] == 255 and (shown[10:30, 50:100] == 127).all()


@pytest.mark.parametrize("image", [np.zeros((3, 5)), np.full((3, 5), np.nan), np.full((1, 1), 7.0)])
def test_flat_images_are_pictures_too(image):
    assert read(png(image)).shape == image.shape


def test_a_large_image_is_shown_small():
    shown = read(png(np.ones((1500, 2048), np.uint8)))
    assert max(shown.shape) <= LARGEST_PX and shown.shape == (375, 512)


def test_frames_and_clients_show_themselves(tmp_path):
    with serving.server(tmp_path) as (endpoint, _), Client(endpoint) as client:
        assert endpoint in client._repr_html_()
        client.hello()
        shown = client._repr_html_()
        assert "navcam: 96 x 64 px" in shown and "body: 5120 facets" in shown
        reply = client.render(views.state().to_dict(), "navcam", products=["range"])
        picture = read(reply._repr_png_())
        assert picture.shape == (64, 96)
        lit = reply.pixels > 0.0
        assert not picture[~lit].any() and picture[lit].mean() > 50.0
        assert client.range(views.state().to_dict(), [[0.0, 0.0, 1.0]], "navcam")._repr_png_() is None
    assert "closed" in client._repr_html_()


def test_names_are_no_markup():
    hello = {"gl_renderer": "a<b", "cameras": [], "bodies": [{"name": "<script>", "n_facets": 1, "law": "lambert"}]}
    assert "<script>" not in described("<i>", hello) and "a&lt;b" in described("", hello)


def test_stretches_are_those_of_the_command_line(rng):
    """The client has copies of its own, as it imports nothing of the renderer."""
    image = 5.0 * rng.random((30, 40))
    assert set(STRETCHES) == set(OURS)
    for name in STRETCHES:
        np.testing.assert_allclose(read(png(image, name, 4.0)), grey_levels(image, 4.0, name), atol=1)


def test_a_stretch_is_set_by_hand():
    """The picture follows both controls; least is black; where no widgets are, the picture stands still."""
    needed_module("ipywidgets", "pip install -e '.[test]'")
    ramp = 100.0 + np.tile(np.arange(200.0), (40, 1))
    box = stretched(ramp)
    (choice, share), picture = box.children[0].children, box.children[1]
    np.testing.assert_allclose(read(picture.value)[0], np.arange(200) * 255.0 / 199.0, atol=1.0)
    choice.value = "log"
    assert read(picture.value)[0, 20] > 150
    choice.value, share.value = "linear", 0.1
    assert (read(picture.value)[0, 20:] == 255).all() and read(picture.value)[0, 0] == 0
    assert read(base64.b64decode(box._repr_mimebundle_()["image/png"])).shape == (40, 200)
