"""The plan of a frame that a camera makes of an image: its errors, and the warnings of what it misses."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from glrender.planner.account import restated
from glrender.planner.plan import RenderPlan


def image_plan(asked, rms, warnings=(), **navigation):
    """With a warning of its own, and those of its misses."""
    made = RenderPlan(camera="navcam", max_error=asked.get("rms", 1.0), roi=(0, 0, 8, 8), windows=(), bodies=(),
                      predicted_error=rms, navigation=navigation, asked=asked, promised={"limb_px": 0.012},
                      way_out="give up")
    return replace(made, warnings=("another", *made.misses().values()))


@pytest.mark.parametrize("gain, warnings", [
    (0.05, ("another",)), (0.072, ("another", "predicted error 0.0022 exceeds max_error 0.002; give up"))])
def test_a_miss_before_the_point_spread_function_that_it_cures_is_no_warning(gain, warnings):
    """0.03 before it, of 0.002 behind it; what is still missed has the frame's figures, and the image's way out."""
    image = image_plan({"rms": 0.02}, 0.03)
    assert len(image.warnings) == 2
    made = restated(image, max_error=0.002, predicted_error=gain * 0.03, asked={"rms": 0.002})
    assert made.warnings == warnings and len(made.missed) == len(warnings) - 1


def test_a_frame_is_silent_about_a_miss_where_its_image_is():
    """As with samples that were asked for, whatever their error."""
    silent = replace(image_plan({"rms": 0.02}, 0.03), warnings=("another",), way_out="")
    made = restated(silent, max_error=0.002, predicted_error=0.003, asked={"rms": 0.002})
    assert made.missed == ("rms",) and made.warnings == ("another",)


def test_lengths_in_warnings_are_pixels_of_the_frame_not_cells():
    """3 cells a pixel: places of bodies and limbs are a third; flux is as it is."""
    asked = {"flux": 0.001, "centroid_px": 0.03, "limb_px": 0.006}
    image = image_plan(asked, 0.01, flux=0.002, centroid_px=0.06, limb_px=0.012)
    made = restated(image, cells=3, asked={"flux": 0.001, "centroid_px": 0.01, "limb_px": 0.002},
                    navigation={"flux": 0.002, "centroid_px": 0.02, "limb_px": 0.004})
    assert made.warnings == (
        "another", "predicted flux 0.002 exceeds max_error 0.001; give up",
        "predicted centroid_px 0.02 exceeds max_error 0.01; give up",
        "predicted limb_px 0.004 exceeds max_error 0.002; the least predicted of any frame of this view is 0.004")


@pytest.mark.parametrize("moved", [0.03, 0.019])
def test_a_miss_by_the_light_that_a_lens_moves_has_a_way_out_of_its_own(moved):
    """0.01 before a lens; the flux, which was missed before, keeps its own way out."""
    image = image_plan({"rms": 0.02, "flux": 0.001}, 0.01, flux=0.002)
    made = restated(image, predicted_error=math.hypot(0.01, moved))
    assert made.missed == ("rms", "flux") and len(made.warnings) == 3
    rms, = (text for text in made.warnings if text.startswith("predicted error"))
    assert "a lens moves the light of a rectilinear image" in rms
    assert "predicted flux 0.002 exceeds max_error 0.001; give up" in made.warnings
