"""Bodies of a few pixels and less have labels: where their light is, by the geometry that the state gives.

Truth is the projection of the sphere's middle; its light is inside its disc.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
from glrender import Pose, Scene, State, open_renderer, take_frame
from glrender.sequences.dataset.dataset import DataSet
from glrender.sequences.labels import PRODUCTS, frame_labels
from glrender.sequences.options import FrameOptions
from missing import needed_module

FOCAL_PX, RADIUS_M, SIZE = 200.0, 100.0, (96, 80)
RADII_M = {"moon": RADIUS_M, "other": 1.5 * RADIUS_M}
DETECTOR = {"quantum_efficiency": 0.5, "full_well_electrons": 3e6, "gain_DN_per_electron": 0.002, "bit_depth": 12,
            "offset_DN": 20.0, "read_noise_electrons": 500.0}
MIDDLE = np.array([47.5, 39.5])


def scene_of(names=("moon",), **camera):
    model = {"exposure_s": 5e-3, "optics": {"aperture_diameter_m": 0.0006, "psf_sigma_px": 0.7}, "detector": DETECTOR}
    return Scene.from_dict({
        "bodies": [{"name": name, "generated": {"kind": "icosphere", "radius_m": RADII_M[name]},
                    "brdf": {"law": "lambert", "normal_albedo": 0.1}} for name in names],
        "cameras": [{"name": "c", "width_px": SIZE[0], "height_px": SIZE[1], "focal_length_px": FOCAL_PX,
                     "model": model, **camera}]})


def at(*places, r_sun_m=(0.3e11, 0.0, -1.4e11)):
    """The state of bodies at (x [px], y [px], range [m]), and their names."""
    bodies = {}
    for name, (x, y, z) in zip(("moon", "other"), places, strict=False):
        bodies[name] = Pose(r_inertial_m=[(x - MIDDLE[0]) * z / FOCAL_PX, (y - MIDDLE[1]) * z / FOCAL_PX, z])
    return State(r_sun_inertial_m=r_sun_m, spacecraft=Pose(r_inertial_m=[0.0, 0.0, 0.0]), bodies=bodies)


def labels_of(scene, state, **options):
    with open_renderer(scene) as renderer:
        made = take_frame(renderer, state, "c", products=PRODUCTS, seed=1, **options)
    return frame_labels(scene, state, scene.cameras[0], made.frame.dn, made.products,
                        irradiance_W_m2=made.irradiance_W_m2)["bodies"]


@pytest.mark.parametrize("size_px", [2.8, 1.4, 0.9, 0.5, 0.2])
@pytest.mark.parametrize("place", [(47.5, 39.5), (50.9, 37.3), (49.0, 40.0), (0.1, 0.2), (95.2, 79.1)])
def test_a_small_body_has_the_place_of_its_light(size_px, place):
    z = 2.0 * RADIUS_M * FOCAL_PX / size_px
    found = labels_of(scene_of(), at((*place, z)), exposure_s=5e-3 * max(1.0, size_px**-2))["moon"]
    off = np.subtract(found["centre_of_brightness_px"], place)
    assert np.hypot(*off) < 0.1 + 0.5 * size_px
    x0, y0, x1, y1 = found["light_box_px"]
    assert x0 - 0.5 <= place[0] <= x1 - 0.5 and y0 - 0.5 <= place[1] <= y1 - 0.5 and max(x1 - x0, y1 - y0) <= 12
    assert 0 <= x0 < x1 <= SIZE[0] and 0 <= y0 < y1 <= SIZE[1]


def test_a_lens_moves_the_label_with_the_light():
    """At 42 px off axis it moves by 42 px k1 r^2 = 3.7 px outwards."""
    scene = scene_of(distortion={"k1": 2.0})
    found = labels_of(scene, at((89.5, 39.5, 5e4)))["moon"]
    expected = MIDDLE[0] + 42.0 * (1.0 + 2.0 * (42.0 / FOCAL_PX) ** 2)
    np.testing.assert_allclose(found["centre_of_brightness_px"], (expected, 39.5), atol=0.5)
    assert found["light_box_px"][0] - 0.5 <= expected <= found["light_box_px"][2] - 0.5


@pytest.mark.parametrize("apart_px", [2.5, 4.0])
def test_two_small_bodies_beside_each_other_have_each_their_own(apart_px):
    places = ((40.2, 40.0), (40.2 + apart_px, 40.0))
    found = labels_of(scene_of(("moon", "other")), at(*((*place, 5e4) for place in places)))
    for name, place in zip(("moon", "other"), places, strict=True):
        assert np.hypot(*np.subtract(found[name]["centre_of_brightness_px"], place)) < 0.5


@pytest.mark.parametrize("state", [
    at((47.5, 39.5, 1e5), (47.5, 39.5, 1e3)), at((-3.0, 39.5, 5e4)),
    at((47.5, 39.5, 5e4), (49.9, 39.5, 5e4), r_sun_m=(1e11, 0.0, 5e4))], ids=["hidden", "beside", "eclipsed"])
def test_what_is_hidden_dark_or_out_of_the_frame_has_no_light(state):
    found = labels_of(scene_of(("moon", "other")[:len(state.bodies)]), state)["moon"]
    assert found["n_px"] == 0 and found["centre_of_brightness_px"] is None and found["light_box_px"] is None


def test_what_is_below_the_noise_is_not_seen():
    found = labels_of(scene_of(), at((47.5, 39.5, 4e6)))["moon"]
    assert found["light_box_px"] is None and found["centre_of_brightness_px"] == pytest.approx(list(MIDDLE), abs=0.01)


def test_a_body_of_more_pixels_has_its_own():
    found = labels_of(scene_of(), at((47.5, 39.5, 4e3)))["moon"]
    assert found["light_box_px"] is None and found["n_px"] == pytest.approx(np.pi * 25.0, rel=0.2)


def test_coco_annotates_what_is_seen_as_a_point(tmp_path):
    coco = needed_module("pycocotools.coco", "pip install pycocotools")
    states = [at((50.2, 37.3, z)) for z in (4e3, 2e4, 1e5, 4e6)]
    data = DataSet(scene=scene_of(), states=states, folder=tmp_path, format="coco",
                   options=FrameOptions(camera="c", output="dn", has_labels=True))
    list(data.draw(n_processes=1))
    read = coco.COCO(str(tmp_path / "annotations.json"))
    found = [read.loadAnns(read.getAnnIds(imgIds=[k])) for k in range(len(states))]
    assert [len(each) for each in found] == [1, 1, 1, 0]
    for (each,) in found[:3]:
        x, y, width, height = each["bbox"]
        mask = read.annToMask(each)
        rows, columns = np.nonzero(mask)
        assert mask.sum() == each["area"] > 0
        assert (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1) == (x, y, x + width, y + height)
        assert x - 0.5 <= 50.2 <= x + width - 0.5 and y - 0.5 <= 37.3 <= y + height - 0.5
    line = json.loads((tmp_path / "labels" / "00000.jsonl").read_text().splitlines()[2])
    assert line["labels"]["bodies"]["moon"]["n_px"] == 0
