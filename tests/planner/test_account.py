"""The plan of a frame that a camera makes of an image: its errors, and the warnings of what it misses."""

from __future__ import annotations

from dataclasses import replace

import pytest
from glrender.planner.account import missed, restated
from glrender.planner.plan import RenderPlan


def image_plan(asked, rms, warnings=(), **navigation):
    """With a warning of its own, and those of its misses."""
    made = RenderPlan(camera="navcam", max_error=asked.get("rms", 1.0), roi=(0, 0, 8, 8), windows=(), bodies=(),
                      predicted_error=rms, navigation=navigation, asked=asked)
    return RenderPlan(**{**vars(made), "warnings": ("another", *missed(made, {"limb_px": 0.012}, "give up"))})


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
    silent = replace(image_plan({"rms": 0.02}, 0.03), warnings=("another",))
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
        "predicted limb_px 0.004 exceeds max_error 0.002; no frame of this view is promised less than 0.004")
