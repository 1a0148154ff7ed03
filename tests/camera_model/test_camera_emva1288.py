"""EMVA 1288 measured on the camera model's own flat frames: it must give back the sensor's data sheet.

The estimates are the standard's (release 4.0, linear model): gain from the photon transfer curve,
quantum efficiency from the responsivity, dark noise and dark current from dark frames, DSNU and
PRNU from averaged stacks with the temporal remainder subtracted. Tolerances are issue 5's: 1 %
for gain and quantum efficiency, 3 % for the rest. The `emva1288` package does the same by code of
others.
"""

from __future__ import annotations

import numpy as np
from glrender_camera import CameraModel, Detector, Optics

GAIN, QE, READ, DSNU, PRNU, DARK = 0.25, 0.55, 9.0, 3.0, 0.01, 40.0
SHAPE = (384, 384)
EXPOSURE_S = 0.01
PLANCK_J_S, LIGHT_M_S = 6.62607015e-34, 299792458.0


def sensor(**changes):
    detector = Detector(**(dict(
        quantum_efficiency=QE, full_well_electrons=14000.0, gain_DN_per_electron=GAIN, bit_depth=12,
        offset_DN=100.0, read_noise_electrons=READ, dark_signal_nonuniformity_electrons=DSNU,
        photo_response_nonuniformity=PRNU, dark_current_electrons_per_s=DARK) | changes))
    # One nanometre of band: the photons of an irradiance are then known without a spectrum.
    optics = Optics(aperture_diameter_m=0.02, band_nm=(549.5, 550.5), transmission=0.9)
    return CameraModel(optics=optics, detector=detector, exposure_s=EXPOSURE_S)


def irradiance_of_photons(photons):
    """[W/m2] that brings so many 550 nm photons through aperture and optics in one exposure."""
    area = np.pi / 4.0 * 0.02**2
    return photons * PLANCK_J_S * LIGHT_M_S / 550e-9 / (area * 0.9 * EXPOSURE_S)


def pair(model, photons, seed):
    """Mean and temporal variance [DN, DN2] from two frames, as the standard takes them."""
    image = np.full(SHAPE, irradiance_of_photons(photons), np.float32)
    first, second = (model.expose(image, seed + i).dn.astype(np.float64) for i in (0, 1))
    return 0.5 * (first.mean() + second.mean()), 0.5 * np.mean((first - second) ** 2) \
        - 0.5 * (first.mean() - second.mean()) ** 2


def spatial_variance(model, photons, seed, n_frames=32):
    """Of the averaged stack, without the temporal noise that the average still holds [DN2], and mean."""
    image = np.full(SHAPE, irradiance_of_photons(photons), np.float32)
    total, squares = np.zeros(SHAPE), np.zeros(SHAPE)
    for i in range(n_frames):
        dn = model.expose(image, seed + i).dn.astype(np.float64)
        total += dn
        squares += dn**2
    mean = total / n_frames
    temporal = np.mean(squares / n_frames - mean**2) * n_frames / (n_frames - 1)
    return mean.var(ddof=1) - temporal / n_frames, mean.mean()


def photon_transfer(model, frame_pair=pair):
    """Gain [DN/e-], quantum efficiency [1] and dark noise [e-]."""
    photons = np.linspace(0.0, 0.7 * 14000.0 / QE, 15)
    means, variances = np.array([frame_pair(model, p, 100 * i) for i, p in enumerate(photons)]).T
    signal, noise = means - means[0], variances - variances[0]
    gain = np.sum(signal * noise) / np.sum(signal**2)
    responsivity = np.sum(photons * signal) / np.sum(photons**2)
    return gain, responsivity / gain, np.sqrt(variances[0] - 1.0 / 12.0) / gain


def test_the_photon_transfer_curve_gives_back_gain_efficiency_and_dark_noise():
    gain, efficiency, dark_noise = photon_transfer(sensor())
    np.testing.assert_allclose(gain, GAIN, rtol=0.01)
    np.testing.assert_allclose(efficiency, QE, rtol=0.01)
    np.testing.assert_allclose(dark_noise, np.sqrt(READ**2 + DARK * EXPOSURE_S), rtol=0.03)


def test_averaged_stacks_give_back_dsnu_and_prnu():
    model = sensor()
    dark_variance, dark_mean = spatial_variance(model, 0.0, 5000)
    half_variance, half_mean = spatial_variance(model, 0.5 * 14000.0 / QE, 6000)
    np.testing.assert_allclose(np.sqrt(dark_variance) / GAIN, DSNU, rtol=0.03)
    prnu = np.sqrt(half_variance - dark_variance) / (half_mean - dark_mean)
    np.testing.assert_allclose(prnu, PRNU, rtol=0.03)


def test_the_standards_reference_implementation_agrees(monkeypatch):
    """The `emva1288` package on stacks of our frames, dark to saturated: 1 % and 3 %."""
    # Its release 1.0.2 calls a function that NumPy 2 dropped.
    monkeypatch.setattr(np, "asfarray", lambda array: np.asarray(array, float), raising=False)
    from emva1288.process.data import Data1288
    from emva1288.process.results import Results1288
    from emva1288.process.routines import get_int_imgs

    model = sensor()

    def stack(photons, n_frames, seed):
        image = np.full(SHAPE, irradiance_of_photons(photons), np.float32)
        return get_int_imgs([model.expose(image, seed + i).dn for i in range(n_frames)])

    def sums(photons, seed):
        images = stack(photons, 2, seed)
        return {"sum": images["sum"].sum(), "pvar": images["pvar"].sum(), "dmean": images["dmean"]}

    # Up to 1.2 of the full well, so that the variance's maximum, which the standard calls saturation, is seen.
    photons = np.linspace(0.0, 1.2 * 14000.0 / QE, 31)
    half = 0.5 * 14000.0 / QE
    results = Results1288(Data1288({
        "width": SHAPE[1], "height": SHAPE[0],
        "temporal": {EXPOSURE_S: {float(p): sums(p, 100 * i) for i, p in enumerate(photons)}},
        "spatial": {EXPOSURE_S: {0.0: stack(0.0, 32, 5000), half: stack(half, 32, 6000)}}}).data)
    np.testing.assert_allclose(results.K, GAIN, rtol=0.01)
    np.testing.assert_allclose(results.QE / 100.0, QE, rtol=0.01)
    np.testing.assert_allclose(results.sigma_d, np.sqrt(READ**2 + DARK * EXPOSURE_S), rtol=0.03)
    np.testing.assert_allclose(results.DSNU1288, DSNU, rtol=0.03)
    np.testing.assert_allclose(results.PRNU1288 / 100.0, PRNU, rtol=0.03)


def test_dark_current_by_mean_and_by_variance():
    """Slopes of mean and variance against exposure: mu_I = DARK from both, 1 % and 3 %."""
    model = sensor(read_noise_electrons=3.0, dark_signal_nonuniformity_electrons=0.0)
    exposures_s = np.array([1.0, 10.0, 40.0, 100.0])
    dark = np.zeros(SHAPE, np.float32)
    frames = [[model.expose(dark, 10 * i + j, exposure_s=t).dn.astype(float) for j in (0, 1)]
              for i, t in enumerate(exposures_s)]
    mean_slope = np.polyfit(exposures_s, [np.mean(pair) for pair in frames], 1)[0]
    variance_slope = np.polyfit(exposures_s, [0.5 * np.var(a - b) for a, b in frames], 1)[0]
    np.testing.assert_allclose(mean_slope / GAIN, DARK, rtol=0.01)
    np.testing.assert_allclose(variance_slope / GAIN**2, DARK, rtol=0.03)


def test_the_method_sees_noise_that_is_added_twice():
    """`img += poisson(img)`, as SISPO had it: gain halves, efficiency rises (photometry.md 4.6)."""
    rng = np.random.default_rng(1)

    def doubled(model, photons, seed):
        frames = []
        for _ in range(2):
            electrons = np.full(SHAPE, QE * photons)
            electrons += rng.poisson(electrons)
            frames.append(np.rint(GAIN * (electrons + rng.normal(0.0, READ, SHAPE)) + 100.0))
        return np.mean(frames), 0.5 * np.var(frames[0] - frames[1])

    gain, efficiency, _ = photon_transfer(None, doubled)
    np.testing.assert_allclose(gain, 0.5 * GAIN, rtol=0.02)
    np.testing.assert_allclose(efficiency, 4.0 * QE, rtol=0.03)
