"""A mosaic of colour filters against one camera per band; lateral colour."""

from __future__ import annotations

import numpy as np
import pytest
from glrender_camera import (
    BrownConrady,
    CameraModel,
    ConfigError,
    Detector,
    DistortingLens,
    MosaicModel,
    Optics,
    PinholeCamera,
    PointSources,
)
from glrender_camera.lateral import magnified

DETECTOR = dict(quantum_efficiency=[[400.0, 0.4], [600.0, 0.6], [800.0, 0.5]], full_well_electrons=1e6,
                gain_DN_per_electron=0.05, bit_depth=16)
BANDS = (("R", (580.0, 680.0), 0.9), ("G", (500.0, 570.0), 0.8), ("B", (430.0, 500.0), 0.7))
OPTICS = {letter: Optics(aperture_diameter_m=0.01, transmission=0.8, band_nm=band, psf_sigma_px=sigma)
          for letter, band, sigma in BANDS}


def mosaic(**fields):
    return MosaicModel(**({"optics": OPTICS, "detector": Detector(**DETECTOR), "exposure_s": 0.1} | fields))


def scene(shape=(64, 80)):
    rng = np.random.default_rng(1)
    return {letter: (scale * (1.0 + rng.random(shape))).astype(np.float32)
            for letter, scale in (("R", 3e-8), ("G", 2e-8), ("B", 1e-8))}


def test_each_pixel_is_that_of_its_bands_own_camera():
    """Electrons behind each letter of RGGB are those of a camera with that filter alone: 5 sigma of the shot noise."""
    light = scene()
    frame = mosaic().expose(light, 3)
    seen = np.zeros(frame.dn.shape, bool)
    for letter, places in (("R", [(0, 0)]), ("G", [(0, 1), (1, 0)]), ("B", [(1, 1)])):
        alone = CameraModel(optics=OPTICS[letter], detector=Detector(**DETECTOR), exposure_s=0.1)
        mean = (OPTICS[letter].spread(light[letter])
                * (alone.optics.aperture_area_m2 * alone.electrons_per_joule * 0.1))
        for i, j in places:
            difference = frame.electrons[i::2, j::2] - mean[i::2, j::2]
            assert np.abs(difference / np.sqrt(mean[i::2, j::2])).max() < 6.0
            assert abs(difference.mean()) < 5.0 * np.sqrt(mean[i::2, j::2].mean() / difference.size)
            seen[i::2, j::2] = True
    assert seen.all()
    assert frame.stages["mosaic"] == "RG GB" and "0.9 px" in frame.stages["psf_R"]
    assert frame.dn.tobytes() == mosaic().expose(light, 3).dn.tobytes()


def test_the_pattern_may_be_any_and_the_exposure_automatic():
    light = scene()
    frame = mosaic(pattern=("B", "G", "R"), exposure_s="auto").expose(light, 1)
    ratio = [frame.electrons[i::3].mean() for i in range(3)]
    assert ratio[0] < ratio[1] < ratio[2]
    full = (2**16 - 1) / 0.05
    np.testing.assert_allclose(np.percentile(frame.electrons, 99.0), 0.7 * min(1e6, full), rtol=0.03)
    longer = mosaic(exposure_s="auto").expose(light, 2, previous=frame)
    np.testing.assert_allclose(longer.exposure_s, frame.exposure_s, rtol=0.05)


def test_lateral_colour_moves_the_red_image_outwards():
    """A star 30 px off axis, red magnified by 1 %: red pixels' centroid 0.3 px farther out than blue's, 0.05 px."""
    camera = PinholeCamera(name="c", width_px=96, height_px=80, focal_length_px=300.0)
    light = {}
    for letter, magnification in (("R", 1.01), ("G", 1.0), ("B", 1.0)):
        lens = DistortingLens(camera, BrownConrady(), 2, magnification)
        y, x = np.indices((lens.source.height_px, lens.source.width_px))
        place = np.array(lens.source.principal_point_px) + (60.0, 0.0)
        light[letter] = lens.apply(1e-7 * np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2.0 * 5.0**2)).astype(
            np.float32))
    frame = mosaic().expose(light, 1)
    columns = np.arange(96)[None, :]
    red, blue = (((frame.electrons * columns)[i::2, i::2]).sum() / frame.electrons[i::2, i::2].sum() for i in (0, 1))
    np.testing.assert_allclose([red, blue], [47.5 + 30.3, 47.5 + 30.0], atol=0.05)


@pytest.mark.parametrize("fields, path", [
    (dict(pattern=("RG", "B")), "pattern"), (dict(pattern=()), "pattern"), (dict(pattern=("RX",)), "optics.G"),
    (dict(optics={"R": OPTICS["R"], "G": OPTICS["G"]}), "optics.B"),
    (dict(optics=OPTICS | {"R": 3}), "optics.R.optics"), (dict(exposure_s=-1.0), "optics.R.exposure_s")])
def test_a_bad_mosaic_is_refused_by_field(fields, path):
    with pytest.raises(ConfigError) as error:
        mosaic(**fields)
    assert error.value.path == path


def test_bad_light_is_refused_with_its_band():
    light = scene()
    with pytest.raises(ConfigError, match="irradiance_W_m2.B: missing"):
        mosaic().expose({"R": light["R"], "G": light["G"]}, 1)
    light["G"] = light["G"].copy()
    light["G"][3, 4] = np.nan
    with pytest.raises(ConfigError, match=r"G.irradiance_W_m2\[3, 4\]: must be finite"):
        mosaic().expose(light, 1)
    with pytest.raises(ConfigError, match=r"irradiance_W_m2: must have shape"):
        mosaic().expose(scene() | {"R": np.zeros((3, 3), np.float32)}, 1)


# Lateral colour


@pytest.mark.parametrize("magnification", [1.01, 0.985, 1.0003])
def test_a_bands_image_is_larger_about_the_principal_point(magnification):
    """A smooth blob: centre of light scaled, 0.01 px; flux 1e-6; nothing negative; an even sky stays even."""
    y, x = np.mgrid[:90, :110].astype(float)
    image = np.exp(-0.5 * ((x - 80.3) ** 2 + (y - 20.6) ** 2) / 9.0).astype(np.float32)
    middle = (50.0, 47.0)
    larger = magnified(image, magnification, middle)
    total = larger.sum(dtype=np.float64)
    np.testing.assert_allclose(total, image.sum(dtype=np.float64), rtol=1e-6)
    centre = np.array([(larger * x).sum(), (larger * y).sum()]) / total
    expected = middle + (np.array([80.3, 20.6]) - middle) * magnification
    np.testing.assert_allclose(centre, expected, atol=0.01)
    assert larger.min() >= 0.0
    even = magnified(np.ones((40, 40), np.float32), magnification, (19.5, 19.5))[5:-5, 5:-5]
    np.testing.assert_allclose(even, magnification**-2, rtol=1e-5)


def test_a_scene_file_tells_each_bands_magnification():
    """Stars and images behind R lie farther out by its factor, behind G and B not; bad ones are refused by name."""
    optics = {letter: {"aperture_diameter_m": 0.01, "band_nm": list(band), "psf_sigma_px": 1.2}
              for letter, band, _ in BANDS}
    table = {"pattern": ["RG", "GB"], "optics": optics, "exposure_s": 1.0, "magnification": {"R": 1.02},
             "detector": {"quantum_efficiency": 0.5, "full_well_electrons": 1e12, "gain_DN_per_electron": 1e-8,
                          "bit_depth": 16}}
    camera = PinholeCamera(name="c", width_px=120, height_px=120, focal_length_px=3e4,
                           model=MosaicModel.from_dict(table))
    y, x = np.indices((120, 120)) - 59.5
    blob = (1e-6 * np.exp(-0.5 * ((x - 30.0) ** 2 + (y - 10.0) ** 2) / 16.0)).astype(np.float32)
    dark = {letter: 0.0 * blob for letter in "RGB"}
    point = PointSources([[59.5 + 30.0, 59.5 + 10.0]], [1e-5])
    for frame in (camera.expose(dict.fromkeys("RGB", blob)), camera.expose(dark, points=dict.fromkeys("RGB", point))):
        for (i, j), factor in (((0, 0), 1.02), ((0, 1), 1.0), ((1, 1), 1.0)):
            seen = frame.electrons[i::2, j::2].astype(np.float64)
            centre = np.array([(seen * x[i::2, j::2]).sum(), (seen * y[i::2, j::2]).sum()]) / seen.sum()
            np.testing.assert_allclose(centre, np.array([30.0, 10.0]) * factor, atol=0.03)
    for bad, path in (({"R": 1.2}, "magnification.R"), ({"X": 1.0}, "magnification.X")):
        with pytest.raises(ConfigError) as error:
            MosaicModel.from_dict(table | {"magnification": bad})
        assert error.value.path == path
