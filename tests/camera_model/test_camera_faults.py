"""Faults of the camera: each does what its table says where its truth says, and nothing anywhere else.

Truth is the frame of the same seed without the fault, the closed form of each spot or veil, and Poisson's law.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from glrender_camera import AutoExposure, CameraModel, ConfigError, Detector, MosaicModel, Optics
from glrender_camera.faults.frame_faults import KINDS, MAX_FAULTS

DETECTOR = Detector(quantum_efficiency=0.5, full_well_electrons=1e5, gain_DN_per_electron=0.04, bit_depth=12,
                    offset_DN=50.0, read_noise_electrons=10.0, dark_current_electrons_per_s=300.0, sensor_seed=11,
                    photo_response_nonuniformity=0.01)
MODEL = CameraModel(optics=Optics(aperture_diameter_m=0.0151, psf_sigma_px=0.7), detector=DETECTOR, exposure_s=0.1)
SHAPE, CENTRE, RADIUS_PX = (300, 400), (210.0, 140.0), 80.0
SUN = np.array([-0.87, 0.0, 0.5])
OWN = {"stuck_exposure": {"exposure_s": 0.3}}
FIXED = ("dust", "dead_columns")


def light(shape=SHAPE, centre=CENTRE, radius_px=RADIUS_PX):
    """A Lambert sphere lit from the left at 60 degrees of phase, of half a full well at its brightest [W/m2]."""
    y, x = np.indices(shape)
    nx, ny = (x - centre[0]) / radius_px, (y - centre[1]) / radius_px
    nz = np.sqrt(np.maximum(1.0 - nx**2 - ny**2, 0.0))
    image = np.where(nz > 0.0, np.maximum(nx * SUN[0] + nz * SUN[2], 0.0), 0.0)
    return (image * 5e4 / electrons_per_W_m2()).astype(np.float32)


def electrons_per_W_m2(exposure_s=0.1):
    return MODEL.electrons_per_joule * MODEL.optics.aperture_area_m2 * exposure_s


def flat(mean_electrons, shape=SHAPE):
    return np.full(shape, mean_electrons / electrons_per_W_m2(), np.float32)


def table(kind, **fields):
    return {"kind": kind, **OWN.get(kind, {}), **fields}


def struck(faults, seed=5, image=None, model=MODEL, **options):
    return model.expose(light() if image is None else image, seed, faults=faults, **options)


def touched(truth, shape=SHAPE):
    """Pixels that a fault's truth names."""
    y, x = np.indices(shape)
    mask = np.zeros(shape, bool)
    match truth["kind"]:
        case "lost_lines" | "repeated_lines" | "shifted_lines":
            mask[truth["lines"]] = True
        case "lost_blocks":
            for x0, y0, x1, y1 in truth["blocks"]:
                mask[y0:y1, x0:x1] = True
        case "dead_columns":
            mask[:, truth["columns"]] = True
        case "garbled_bytes":
            for x0, y0, n in truth["runs"]:
                mask.ravel()[y0 * shape[1] + x0:][:n] = True
        case "dust":
            for x0, y0, radius in truth["spots"]:
                mask |= np.maximum(np.abs(x - x0), np.abs(y - y0)) < 4.3 * radius
        case "satellite_crossing":
            (x0, y0), (along_x, along_y) = truth["through_px"], truth["direction"]
            mask = np.abs(along_y * (x - x0) - along_x * (y - y0)) < 5.01 * truth["sigma_px"]
        case _:
            mask[:] = True
    return mask


def test_there_are_none_unless_asked_for():
    plain = MODEL.expose(light(), 5)
    assert plain.faults == () and plain.stages["faults"] == "skipped: none asked for"
    faulty = replace(MODEL, faults=[table("lost_lines")])
    without = faulty.expose(light(), 5, faults=[])
    np.testing.assert_array_equal(without.dn, plain.dn)
    assert faulty.expose(light(), 5).faults[0]["kind"] == "lost_lines"
    np.testing.assert_array_equal(faulty.expose(light(), 5).dn, struck([table("lost_lines")]).dn)


@pytest.mark.parametrize("kind, place", [(kind, place) for kind in KINDS for place in ("random", "limb")
                                         if place == "random" or kind not in FIXED])
def test_a_fault_is_where_its_truth_says_and_nowhere_else(kind, place):
    """The same seed's other pixels keep every byte: noise does not know of the fault."""
    plain, frame = MODEL.expose(light(), 5), struck([table(kind, place=place)])
    again = struck([table(kind, place=place)])
    np.testing.assert_array_equal(frame.dn, again.dn)
    assert frame.faults == again.faults and frame.stages["faults"].startswith(f"{kind}: ")
    (truth,) = frame.faults
    assert truth["kind"] == kind and truth.get("place", place) == place
    mask = touched(truth)
    np.testing.assert_array_equal(frame.dn[~mask], plain.dn[~mask])
    np.testing.assert_array_equal(frame.electrons[~mask], plain.electrons[~mask])
    if place == "limb" or kind not in ("dust", "dead_columns", "lost_blocks"):  # which may be in the dark
        assert (frame.dn != plain.dn)[mask].any()


@pytest.mark.parametrize("kind", KINDS)
def test_the_seed_chooses_the_place(kind):
    """The frame's; of what is fixed to the sensor, the sensor's. The fault's own seed moves either."""
    other_sensor = replace(MODEL, detector=replace(DETECTOR, sensor_seed=12))
    (one,), (next_frame,), (own,), (sensor,) = (frame.faults for frame in (
        struck([table(kind)]), struck([table(kind)], seed=6), struck([table(kind, seed=1)]),
        struck([table(kind)], model=other_sensor)))
    if kind == "stuck_exposure":
        assert one == next_frame == own == sensor
    else:
        assert own != one and (next_frame == one) == (kind in FIXED) and (sensor == one) == (kind not in FIXED)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "stuck_exposure"])
def test_no_fault_moves_another(kind):
    faults = [table(other) for other in KINDS if other not in ("stuck_exposure", kind)]
    alone, among = struck([table(kind)]), struck([*faults, table(kind)])
    assert among.faults[-1] == alone.faults[0] and len(among.faults) == len(faults) + 1
    twice = struck([table(kind), table(kind)]).faults
    assert twice[0] == alone.faults[0] != twice[1], "a second one of a kind has a place of its own"


def test_lines_blocks_and_bytes_on_their_way():
    plain = MODEL.expose(light(), 5).dn
    lines = lambda kind, **fields: struck([table(kind, n_lines=9, n_gaps=2, **fields)])  # noqa: E731
    lost = lines("lost_lines")
    assert len(lost.faults[0]["lines"]) in range(9, 19) and not lost.dn[lost.faults[0]["lines"]].any()
    repeated = struck([table("repeated_lines", n_lines=9)])
    rows = repeated.faults[0]["lines"]
    np.testing.assert_array_equal(repeated.dn[rows], np.tile(plain[rows[0] - 1], (9, 1)))
    shifted = lines("shifted_lines", shift_px=-7)
    rows = shifted.faults[0]["lines"]
    np.testing.assert_array_equal(shifted.dn[rows][:, :-7], plain[rows][:, 7:])
    np.testing.assert_array_equal(shifted.dn[rows][:, -7:], plain[rows][:, :7])
    blocks = struck([table("lost_blocks", size_px=64, n_blocks=40)])
    assert all(x0 % 64 == y0 % 64 == 0 and x1 <= 400 and y1 <= 300 for x0, y0, x1, y1 in blocks.faults[0]["blocks"])
    assert not blocks.dn[touched(blocks.faults[0])].any()
    garbled = struck([table("garbled_bytes", n_bytes=101, n_runs=9)])
    changed = np.count_nonzero(garbled.dn != plain)
    assert 0.95 * 9 * 51 < changed <= 9 * 51 and garbled.dn.max() <= 4095
    np.testing.assert_array_equal(garbled.electrons, MODEL.expose(light(), 5).electrons)


def test_more_lines_than_the_frame_has():
    for kind in ("lost_lines", "repeated_lines", "shifted_lines"):
        assert struck([table(kind, n_lines=16384)]).faults[0]["lines"] == list(range(300))
    whole = struck([table("garbled_bytes", n_bytes=65536, n_runs=20)], image=light((40, 40), (20.0, 20.0), 10.0))
    assert whole.dn.shape == (40, 40) and whole.faults[0]["runs"] == [[0, 0, 32768]]


def test_dead_columns_keep_their_dark_current():
    """Photo-electrons are gone; 30 e- of dark current stay, Poisson, with 10 e- of read noise: 4 sigma."""
    frame = struck([table("dead_columns", n_columns=20)], image=flat(2e4))
    dead = frame.electrons[:, frame.faults[0]["columns"]]
    assert abs(dead.mean() - 30.0) < 4.0 * np.sqrt(130.0 / dead.size)
    np.testing.assert_allclose(dead.var(), 130.0, rtol=4.0 * np.sqrt(2.0 / dead.size))


def test_light_is_added_before_it_is_taken_whatever_the_order():
    """Dead columns stay at 30 e- of dark current and 10 e- of read noise, 6 sigma, in the Sun's veil of a full well."""
    faults = [table("dead_columns", n_columns=20), table("sun_blinding", radius_px=100.0), table("satellite_crossing")]
    frame, other = (struck(each, image=flat(2e4)) for each in (faults, faults[::-1]))
    assert frame.electrons[:, frame.faults[0]["columns"]].max() < 30.0 + 6.0 * np.sqrt(130.0)
    np.testing.assert_array_equal(frame.dn, other.dn)


def test_dust_takes_its_share_of_the_light_and_leaves_poissons_noise():
    """500 frames: mean and variance of the electrons in a spot are those of a Poisson number of the dimmed light."""
    model = replace(MODEL, optics=replace(MODEL.optics, psf_sigma_px=0.0), detector=replace(
        DETECTOR, read_noise_electrons=0.0, photo_response_nonuniformity=0.0))
    fault, shape = [table("dust", n_spots=1, radius_px=6.0, depth=0.6)], (64, 64)
    frames = [struck(fault, seed, flat(800.0, shape), model) for seed in range(500)]
    (x0, y0, radius), = frames[0].faults[0]["spots"]
    y, x = np.indices(shape)
    kept = 1.0 - 0.6 * np.exp(-0.5 * ((x - x0) ** 2 + (y - y0) ** 2) / radius**2)
    electrons = np.array([frame.electrons for frame in frames])
    expected = 800.0 * kept + 30.0
    np.testing.assert_allclose(electrons.mean(axis=0), expected, atol=5.0 * np.sqrt(830.0 / 500))
    inner = kept < 0.7
    assert inner.sum() > 20
    np.testing.assert_allclose((electrons.var(axis=0) / expected)[inner].mean(), 1.0,
                               atol=4.0 * np.sqrt(2.0 / 500 / inner.sum()))


def test_the_suns_veil_falls_with_the_distance_squared_and_saturates_within_its_radius():
    fault = [table("sun_blinding", place="limb", radius_px=25.0, bloom_px=60.0)]
    plain, frame = MODEL.expose(light(), 5), struck(fault)
    x0, y0 = frame.faults[0]["centre_px"]
    y, x = np.indices(SHAPE)
    r = np.hypot(x - x0, y - y0)
    assert frame.saturated[r < 22.0].all() and frame.saturated[max(0, y0 - 50):y0 + 50, x0].all()
    far = (r > 100.0) & (np.abs(x - x0) > 15) & ~plain.saturated
    added = (frame.electrons - plain.electrons)[far]
    expected = 1e5 * 25.0**2 / r[far] ** 2
    # The veil's own shot noise, and the pixels' response.
    assert abs(np.mean(added / expected - 1.0)) < 0.005
    np.testing.assert_allclose(np.var(added - expected), np.mean(expected + (0.01 * expected) ** 2), rtol=0.05)


def test_a_satellites_trail():
    """Its charge across, summed, is that of a Gaussian: peak times sigma times the root of 2 pi, 2 % of shot noise."""
    fault = [table("satellite_crossing", sigma_px=2.0, peak_full_wells=0.3)]
    plain, frame = struck([], image=flat(0.0)), struck(fault, image=flat(0.0))
    truth = frame.faults[0]
    y, x = np.indices(SHAPE)
    aside = truth["direction"][1] * (x - truth["through_px"][0]) - truth["direction"][0] * (y - truth["through_px"][1])
    profile = 3e4 * np.exp(-0.5 * (aside / 2.0) ** 2)
    trail = frame.electrons - plain.electrons
    np.testing.assert_allclose(trail.sum(), profile.sum(), rtol=0.02)
    np.testing.assert_allclose(np.average(aside, weights=np.maximum(trail, 0.0)), 0.0, atol=0.02)


@pytest.mark.parametrize("exposure_s", [None, "auto", 0.02])
def test_a_shutter_that_is_stuck(exposure_s):
    model = replace(MODEL, exposure_s="auto", auto_exposure=AutoExposure())
    frame = struck([table("stuck_exposure", exposure_s=0.3)], model=model, exposure_s=exposure_s)
    assert frame.exposure_s == 0.3
    np.testing.assert_array_equal(frame.dn, model.expose(light(), 5, exposure_s=0.3).dn)
    assert struck([table("stuck_exposure", exposure_s=0.3)], model=model, previous=frame).exposure_s == 0.3


@pytest.mark.parametrize("probability", [0.0, 0.1, 0.7, 1.0])
def test_each_frames_seed_decides_whether_it_has_the_fault(probability):
    """Of 400 frames, within 4 sigma of the binomial."""
    small = flat(100.0, (8, 8))
    had = [struck([table("lost_lines", probability=probability)], seed, small).faults for seed in range(400)]
    sigma = np.sqrt(400 * probability * (1.0 - probability))
    assert abs(sum(map(len, had)) - 400 * probability) <= 4.0 * sigma
    if probability == 0.0:
        assert struck([table("dust", probability=0.0)]).stages["faults"] == "none of 1 in this frame"


@pytest.mark.parametrize("centre", [CENTRE, (20.0, 150.0), (390.0, 10.0)])
def test_the_limb_is_the_bright_edge_and_not_the_terminator(centre):
    """A sphere lit from the left: chosen places are within 2 px of its circle, on the Sun's side, in the frame."""
    places = []
    for seed in range(60):
        truth = struck([table("sun_blinding", place="limb")], seed, light(centre=centre)).faults[0]
        assert truth["place"] == "limb"
        places.append(truth["centre_px"])
    offset = np.array(places) - centre
    np.testing.assert_allclose(np.linalg.norm(offset, axis=1), RADIUS_PX, atol=2.0)
    assert offset[:, 0].max() < 0.1 * RADIUS_PX and len(np.unique(places, axis=0)) > 30


def test_without_a_limb_places_are_random_and_say_so():
    for image in (flat(0.0), flat(2e4)):
        assert struck([table("lost_lines", place="limb")], image=image).faults[0]["place"] == "random"


def test_a_large_frame_is_one_whatever_its_blocks():
    """Two blocks of rows are read by two threads: the veil has no step where they meet."""
    image = flat(0.0, (1000, 400))
    fault = [table("sun_blinding", radius_px=60.0, bloom_px=0.0, seed=3)]
    frame = struck(fault, 2, image)
    np.testing.assert_array_equal(frame.dn, struck(fault, 2, image).dn)
    x0, y0 = frame.faults[0]["centre_px"]
    y, x = np.indices(image.shape)
    expected = 1e5 * 60.0**2 / np.maximum((x - x0) ** 2 + (y - y0) ** 2, 1.0)
    rows = np.where(expected < 5e4, frame.electrons / (expected + 30.0), np.nan)
    assert np.nanmax(np.abs(np.nanmean(rows, axis=1) - 1.0)) < 0.02


def test_behind_a_mosaic():
    optics = replace(MODEL.optics, band_nm=(500.0, 600.0))
    model = MosaicModel(optics={"R": optics, "G": optics, "B": optics}, detector=DETECTOR, exposure_s=0.1,
                        faults=[table("lost_lines", place="limb"), table("dead_columns")])
    image = dict.fromkeys("RGB", light())
    frame = model.expose(image, 5)
    assert [truth["kind"] for truth in frame.faults] == ["lost_lines", "dead_columns"]
    assert not frame.dn[frame.faults[0]["lines"]].any() and model.expose(image, 5, faults=()).faults == ()


@pytest.mark.parametrize("faults, message", [
    ("lost_lines", r"^faults: must be a list of at most 16 tables, each with a `kind`, got 'lost_lines'"),
    ({"kind": "dust"}, r"^faults: must be a list"),
    ([table("dust")] * (MAX_FAULTS + 1), r"^faults: must be a list of at most 16"),
    (["dust"], r"^faults\[0\]: must be a table, got 'dust'"),
    ([{}], r"^faults\[0\].kind: missing"),
    ([table("dust"), {"kind": "lost_line"}], r"^faults\[1\].kind: must be one of .*; did you mean 'lost_lines'\?"),
    ([{"kind": ["dust"]}], r"^faults\[0\].kind: must be one of"),
    ([table("lost_lines", n_line=3)], r"^faults\[0\].n_line: unknown key; did you mean 'n_lines'\? known keys are"),
    ([table("lost_lines", n_lines=0)], r"^faults\[0\].n_lines: must be an integer between 1 and 16384, got 0"),
    ([table("lost_lines", n_lines=2.5)], r"^faults\[0\].n_lines: must be an integer"),
    ([table("lost_lines", probability=1.5)], r"^faults\[0\].probability: must be between 0 and 1, got 1.5"),
    ([table("lost_lines", probability=float("nan"))], r"^faults\[0\].probability: must be a finite number"),
    ([table("lost_lines", place="limbo")], r"^faults\[0\].place: must be one of .*; did you mean 'limb'\?"),
    ([table("dust", place="limb")], r"^faults\[0\].place: must be \"random\": dust stays .* got 'limb'; leave `place`"),
    ([table("dead_columns", place="limb")], r"^faults\[0\].place: must be \"random\": dead_columns stays"),
    ([table("lost_lines", seed=-1)], r"^faults\[0\].seed: must be an integer"),
    ([{"kind": "stuck_exposure"}], r"^faults\[0\].exposure_s: missing"),
    ([table("stuck_exposure", exposure_s=0.0)], r"^faults\[0\].exposure_s: must be > 0, got 0.0"),
    ([table("stuck_exposure", exposure_s=1e9)], r"^faults\[0\].exposure_s: must be between 0 and 1e\+06"),
    ([table("dust", depth=2)], r"^faults\[0\].depth: must be between 0 and 1, got 2")])
def test_what_is_wrong_is_told_with_its_field(faults, message):
    with pytest.raises(ConfigError, match=message):
        struck(faults)
    with pytest.raises(ConfigError, match=message):
        replace(MODEL, faults=faults)


def test_a_number_with_a_whole_value_counts():
    """MATLAB sends doubles."""
    assert struck([table("lost_lines", n_lines=8.0, seed=0.0)]).faults == struck([table("lost_lines")]).faults
