"""SPICE's one pool of a process: each scenario has its own kernels in their own order, whatever was loaded before."""

from __future__ import annotations

import os

import numpy as np
import pytest
from glrender import ConfigError, frames
from glrender.scenario import Epoch, Spice, SpiceTrajectory, scenario_of_table
from missing import needed_module

START = Epoch.from_et(0.0)
FRAME = """KPL/FK
\\begindata
FRAME_ROCK_FIXED = 1400001
FRAME_1400001_NAME = 'ROCK_FIXED'
FRAME_1400001_CLASS = 4
FRAME_1400001_CLASS_ID = 1400001
FRAME_1400001_CENTER = 2099942
TKFRAME_1400001_RELATIVE = 'J2000'
TKFRAME_1400001_SPEC = 'ANGLES'
TKFRAME_1400001_UNITS = 'DEGREES'
TKFRAME_1400001_AXES = (3, 2, 1)
TKFRAME_1400001_ANGLES = ({angle}, 0.0, 0.0)
\\begintext
"""


@pytest.fixture
def tool():
    """spiceypy with an empty pool, before and after."""
    spiceypy = needed_module("spiceypy", "pip install -e '.[test]'")
    spiceypy.kclear()
    yield spiceypy
    spiceypy.kclear()


def spk(tool, path, x_km):
    """A spacecraft -999 at rest about 2099942, which is at rest about the Sun, for a day."""
    path.unlink(missing_ok=True)
    handle = tool.spkopn(str(path), "test", 0)
    for target, centre, place in ((-999, 2099942, [x_km, 0.0, 0.0]), (2099942, 10, [1.5e8, 0.0, 0.0])):
        states = np.tile([*place, 0.0, 0.0, 0.0], (10, 1))
        tool.spkw13(handle, target, centre, "J2000", 0.0, 86400.0, "s", 1, 10, states, np.linspace(0.0, 86400.0, 10))
    tool.spkcls(handle)
    return path


def meta(path, *members):
    # A text of a kernel has 80 characters at most; a plus goes on with it.
    parts = [[str(member)[k:k + 60] for k in range(0, len(str(member)), 60)] for member in members]
    names = "\n".join("+'\n'".join(part).join("''") for part in parts)
    path.write_text(f"KPL/MK\n\\begindata\nKERNELS_TO_LOAD = ( {names} )\n\\begintext\n")
    return path


def x_m(spice):
    path = SpiceTrajectory(spice=spice, target="spacecraft", about="2099942")
    return float(path.at(START, np.array([600.0]))[0][0, 0])


def test_of_kernels_with_the_same_data_the_last_of_the_list_counts(tool, tmp_path):
    """NAIF's KERNEL required reading; asked forwards and backwards, with meta-kernels, and a file that comes twice."""
    a, b = spk(tool, tmp_path / "a.bsp", 1.0), spk(tool, tmp_path / "b.bsp", 2.0)
    ab, only_a = meta(tmp_path / "ab.tm", a, b), meta(tmp_path / "a.tm", a)
    lists = [([a], 1.0), ([b, a], 1.0), ([a, b], 2.0), ([ab], 2.0), ([ab, a], 1.0), ([b, only_a], 1.0),
             ([a, b, a], 1.0), ([b], 2.0)]
    made = [(Spice(kernels=kernels, observer="-999"), km) for kernels, km in lists]
    for spice, km in (*made, *reversed(made)):
        assert x_m(spice) == 1e3 * km


def test_frames_of_two_lists_keep_apart(tool, tmp_path):
    """Two frame kernels of one frame, turned by 10 and 40 degrees: SPICE's own matrix of each alone."""
    kernel = spk(tool, tmp_path / "a.bsp", 1.0)
    made = []
    for angle in (10.0, 40.0):
        (tmp_path / f"{angle}.tf").write_text(FRAME.format(angle=angle))
        made.append((angle, Spice(kernels=[kernel, tmp_path / f"{angle}.tf"], observer="-999")))
    for angle, spice in (*made, *made):
        rotation, _ = spice.turned("ROCK_FIXED", 0.0)
        # SPICE's ANGLES take the frame to the one it is relative to.
        np.testing.assert_allclose(rotation, tool.rotate(-np.radians(angle), 3), atol=1e-15)


@pytest.mark.parametrize("change", ["unloaded", "more", "others"])
def test_what_others_do_to_the_pool_is_undone(tool, tmp_path, change):
    a, b = spk(tool, tmp_path / "a.bsp", 1.0), spk(tool, tmp_path / "b.bsp", 2.0)
    spice = Spice(kernels=[a], observer="-999")
    assert x_m(spice) == 1e3
    if change != "more":
        tool.kclear()
    if change in ("more", "others"):
        tool.furnsh(str(b))
    assert x_m(spice) == 1e3
    assert tool.ktotal("ALL") == 1


def test_a_kernel_that_is_written_anew_is_read_anew(tool, tmp_path):
    path = spk(tool, tmp_path / "a.bsp", 1.0)
    os.utime(path, (1.0, 1.0))
    assert x_m(Spice(kernels=[path], observer="-999")) == 1e3
    assert x_m(Spice(kernels=[spk(tool, path, 7.0)], observer="-999")) == 7e3


def test_a_list_that_is_refused_leaves_the_others(tool, tmp_path):
    spice = Spice(kernels=[spk(tool, tmp_path / "a.bsp", 1.0)], observer="-999")
    (tmp_path / "none.bsp").write_bytes(b"DAF/SPK " + bytes(2000))
    with pytest.raises(ConfigError, match=r"kernels\[0\]: is refused by SPICE"):
        Spice(kernels=[tmp_path / "none.bsp"], observer="-999")
    assert x_m(spice) == 1e3
    spice.close()
    assert tool.ktotal("ALL") == 0
    assert x_m(spice) == 1e3


def test_states_of_two_scenarios_may_be_taken_in_turns(tool, tmp_path):
    """Attitudes too, which are asked after the places of another scenario."""
    taken = []
    for name, km in (("a", 1.0), ("b", 2.0)):
        spk(tool, tmp_path / f"{name}.bsp", km)
        (tmp_path / f"{name}.tf").write_text(FRAME.format(angle=30.0 * km))
        taken.append(scenario_of_table({
            "bodies": [{"name": "rock", "generated": {"kind": "icosphere", "radius_m": 9.0, "subdivisions": 1},
                        "brdf": {"law": "lambert", "normal_albedo": 0.1},
                        "attitude": {"mode": "spice", "frame": "ROCK_FIXED"}}],
            "cameras": [{"name": "c", "width_px": 8, "height_px": 8, "focal_length_px": 10.0}],
            "spice": {"kernels": [f"{name}.bsp", f"{name}.tf"], "observer": "-999", "ids": {"rock": "2099942"}},
            "trajectory": {"kind": "spice"}, "time": {"start_et_s": 0.0, "times_s": [0.0, 60.0]}}, folder=tmp_path))
    first, second = taken[0].iter_states(), taken[1].iter_states()
    for _ in range(2):
        for km, states in ((1.0, first), (2.0, second)):
            state = next(states)
            assert state.spacecraft.r_inertial_m[0] == 1e3 * km
            turned = frames.dcm(state.bodies["rock"].q_from_inertial)
            np.testing.assert_allclose(turned, tool.rotate(-np.radians(30.0 * km), 3), atol=1e-15)


@pytest.mark.parametrize("is_member", [False, True])
def test_the_coverage_is_told_of_members_of_meta_kernels(tool, tmp_path, is_member):
    kernel = spk(tool, tmp_path / "a.bsp", 1.0)
    kernel = meta(tmp_path / "a.tm", kernel) if is_member else kernel
    path = SpiceTrajectory(spice=Spice(kernels=[kernel], observer="-999"), target="spacecraft", about="2099942")
    with pytest.raises(ConfigError) as caught:
        path.at(START, np.array([1e6]))
    assert "a.bsp has -999 from 2000-01-01T12:00:00 TDB to 2000-01-02T12:00:00 TDB" in str(caught.value)
