"""The page of fields has every key that scene and scenario files may have, and no other."""

from __future__ import annotations

import copy
import re
import sys
from pathlib import Path

import pytest
from glrender import ConfigError, Scene
from glrender.scenario import scenario_of_table
from glrender.scenario.files import attitude_fields, camera_fields, scenario_file
from glrender.scenario.files.fields import with_scales
from glrender.scenario.files.time_fields import SAMPLER_KEYS
from glrender.scene.formats.terrain import GeoTiff
from glrender.sequences.options import OUTPUT_KEYS
from missing import needed_module

ROOT = Path(__file__).parents[2]
UNKNOWN = "no_such_field"
BODY = {"name": "a", "generated": {"kind": "icosphere", "radius_m": 10.0, "subdivisions": 2},
        "brdf": {"law": "lambert", "normal_albedo": 0.1}}
PRESET = {"preset": "generic_navigation_camera"}
OPTICS, DETECTOR = {"aperture_diameter_m": 0.1}, {"quantum_efficiency": 0.5, "full_well_electrons": 1e4,
                                                  "gain_DN_per_electron": 0.1}
CAMERA = {"name": "c", "width_px": 8, "height_px": 8, "focal_length_px": 20.0}
ORBIT = {"epoch_tdb": "2020-01-01T00:00:00", "r_m": [1.5e11, 0.0, 0.0], "v_m_s": [0.0, 3e4, 0.0]}
SPACECRAFT = {"kind": "at_rest", "r_m": [0.0, 0.0, -1e3]}


def scene(**more):
    return {"bodies": [copy.deepcopy(BODY)], "cameras": [copy.deepcopy(CAMERA)], **copy.deepcopy(more)}


def scenario(**more):
    table = {"trajectory": SPACECRAFT, "time": {"times_s": [0.0], "start_tdb": "2020-01-01T00:00:00"}, **more}
    table = scene(**table)
    if "sun" not in more:
        table["bodies"][0]["orbit"] = copy.deepcopy(ORBIT)
    return table


def in_body(of, **more):
    table = of()
    table["bodies"][0] |= more
    return table


def in_camera(**more):
    table = scene()
    table["cameras"][0] |= more
    return table


def rigid(**more):
    return scenario(attitude={"mode": "rigid_body", "inertia_kg_m2": [1.0, 1.0, 1.0],
                              "angular_velocity_rad_s": [0.0, 0.0, 0.1], **more})


MOSAIC = {"pattern": ["RG", "GB"], "optics": {letter: OPTICS for letter in "RGB"}, "detector": DETECTOR,
          "exposure_s": 1.0}
# A file with each table, and the way to it.
FILES = {
    "the file": (scene(), ()), "bodies": (scene(), ("bodies", 0)),
    "bodies.brdf, preset": (in_body(scene, brdf={"preset": "eros_550nm"}), ("bodies", 0, "brdf")),
    "bodies.regions": (in_body(scene, regions=[{}]), ("bodies", 0, "regions", 0)),
    "bodies.detail": (in_body(scene, detail={}), ("bodies", 0, "detail")),
    **{f"bodies.detail.{kind}": (in_body(scene, detail={kind: {}}), ("bodies", 0, "detail", kind))
       for kind in ("noise", "craters", "boulders")},
    **{f'bodies.generated, kind = "{kind}"': (in_body(scene, generated={"kind": kind, "radius_m": 1.0}),
                                              ("bodies", 0, "generated"))
       for kind in ("icosphere", "contact_binary", "gaussian_random_sphere", "three_lobes")},
    **{f'bodies.brdf, law = "{law}"': (in_body(scene, brdf={"law": law}), ("bodies", 0, "brdf"))
       for law in ("akimov", "hapke", "lambert", "lommel_seeliger", "lunar_lambert", "microfacet", "minnaert",
                   "oren_nayar", "rolo")},
    "cameras": (scene(), ("cameras", 0)),
    "cameras.model": (in_camera(model=PRESET), ("cameras", 0, "model")),
    "cameras.model, with a pattern": (in_camera(model=MOSAIC), ("cameras", 0, "model")),
    **{f"cameras.model.{part}": (in_camera(model={**PRESET, part: {}}), ("cameras", 0, "model", part))
       for part in ("optics", "detector", "auto_exposure")},
    **{f"cameras.model.optics.{part}": (in_camera(model={**PRESET, "optics": {part: {}}}),
                                        ("cameras", 0, "model", "optics", part))
       for part in ("aberrations", "stray_light")},
    "cameras.distortion": (in_camera(distortion={}), ("cameras", 0, "distortion")),
    "stars": (scene(stars={}), ("stars",)), "lamps": (scene(lamps=[{}]), ("lamps", 0)),
    "bodies.orbit, of elements": (in_body(scenario, orbit={"epoch_tdb": "2020-01-01"}), ("bodies", 0, "orbit")),
    "bodies.orbit, of its periapsis": (
        in_body(scenario, orbit={"periapsis_distance_m": 1e11, "periapsis_tdb": "2020-01-01"}), ("bodies", 0, "orbit")),
    "bodies.orbit, of a state": (in_body(scenario, orbit=ORBIT), ("bodies", 0, "orbit")),
    "bodies.spin": (in_body(scenario, spin={}), ("bodies", 0, "spin")),
    "encounter": (scene(bodies=[{**BODY, "orbit": ORBIT}], encounter={"date_tdb": "2020-01-01"}), ("encounter",)),
    'trajectory, kind = "kepler"': (scenario(trajectory={"kind": "kepler", "epoch_tdb": "2020-01-01"}),
                                    ("trajectory",)),
    **{f'trajectory, kind = "{kind}"': (scenario(trajectory={"kind": kind}), ("trajectory",))
       for kind in ("at_rest", "hovering", "circular", "csv", "parquet", "oem", "horizons")},
    'trajectory, kind = "isd"': (scenario(trajectory={"kind": "isd"}), ("trajectory",)),
    **{f'attitude, mode = "{mode}"': (scenario(attitude={"mode": mode}), ("attitude",))
       for mode in ("target", "nadir", "fixed", "spin", "csv", "parquet", "aem", "rigid_body")},
    "attitude.gas_drag": (rigid(gas_drag={}), ("attitude", "gas_drag")),
    "attitude.gas_drag.plates": (rigid(gas_drag={"plates": [{}]}), ("attitude", "gas_drag", "plates", 0)),
    "attitude.dust_impacts": (rigid(dust_impacts={}), ("attitude", "dust_impacts")),
    "attitude.thrusters": (rigid(thrusters=[{}]), ("attitude", "thrusters", 0)),
    "attitude.wheels": (rigid(wheels={}), ("attitude", "wheels")),
    "attitude.jitter": (scenario(attitude={"mode": "target", "jitter": {}}), ("attitude", "jitter")),
    "time": (scenario(), ("time",)), "sun": (scenario(sun={}), ("sun",)),
    "spice": (scenario(spice={"kernels": ["k.bsp"]}), ("spice",)),
    "random": (scene(random={}), ("random",))}
# Fields that a reader takes out of a table before it looks at the rest.
EPOCH = set(with_scales("epoch"))
TAKEN = {**dict.fromkeys(("bodies.orbit, of elements", "bodies.orbit, of a state", "bodies.spin",
                          'trajectory, kind = "kepler"', 'trajectory, kind = "circular"', 'attitude, mode = "spin"'),
                         EPOCH),
         "bodies.orbit, of its periapsis": set(with_scales("periapsis")),
         "encounter": {*with_scales("date"), *SAMPLER_KEYS}}
# Tables that other code reads, and those whose every value the tests of scenarios refuse by name.
ELSEWHERE = {"a body of a scenario", "bodies.terrain", "attitude, in all modes of the spacecraft",
             'trajectory, kind = "spice"', 'attitude, mode = "spice"', "output", "cameras, of an instrument kernel",
             "cameras, of an ISD"}


@pytest.fixture(scope="module")
def page():
    """The module that makes the page: no package, it lies beside the page."""
    needed_module("numpydoc", "pip install -e '.[docs]'")
    sys.path.insert(0, str(ROOT / "docs" / "reference"))
    try:
        import scene_fields
    finally:
        sys.path.pop(0)
    return scene_fields


@pytest.fixture(scope="module")
def tables(page):
    return {table.name: table for table in (*page.SCENE, *page.SCENARIO)}


def known_fields(table: dict, way: tuple) -> set[str]:
    """Those that the error for an unknown field tells."""
    table = copy.deepcopy(table)
    at = table
    for step in way:
        at = at[step]
    at[UNKNOWN] = 1.0
    with pytest.raises(ConfigError) as raised:
        # Tables that no scene has are a scenario's.
        (scenario_of_table if {"trajectory", "encounter", "random"} & set(table) else Scene.from_dict)(table)
    known = re.search(rf"{UNKNOWN}: unknown key.*known keys are ([\w, ]+)", str(raised.value))
    assert known, raised.value
    return set(known[1].split(", "))


@pytest.mark.parametrize("name", FILES)
def test_the_page_has_every_field_of_a_table_and_no_other(name, tables):
    assert set(tables[name].fields()) == known_fields(*FILES[name]) - {"kind"} | TAKEN.get(name, set())


@pytest.mark.parametrize("name", TAKEN)
def test_fields_that_are_taken_before_are_no_unknown_ones(name):
    file, way = FILES[name]
    for key in TAKEN[name]:
        table = copy.deepcopy(file)
        at = table[way[0]] if len(way) == 1 else table[way[0]][way[1]][way[2]]
        for other in EPOCH | set(with_scales("date")):
            at.pop(other, None)
        at[key] = []
        with pytest.raises(ConfigError) as raised:
            scenario_of_table(table)
        assert "unknown key" not in str(raised.value), raised.value


def test_every_table_is_compared(tables):
    assert set(FILES) | ELSEWHERE == set(tables) and not set(FILES) & ELSEWHERE


def test_the_tables_that_no_error_tells(tables):
    def fields(name):
        return set(tables[name].fields())

    with pytest.raises(ConfigError) as raised:
        GeoTiff.from_table({UNKNOWN: 1.0}, lambda field, name: Path(name))
    assert fields("bodies.terrain") == set(re.search(r"known keys are ([\w, ]+)", str(raised.value))[1].split(", "))
    assert fields("output") == set(OUTPUT_KEYS)
    assert fields("a body of a scenario") == set(scenario_file._BODY_KEYS)
    assert fields("cameras, of an instrument kernel") == {*camera_fields._KERNEL_KEYS, "name"}
    assert fields("cameras, of an ISD") == {*camera_fields._ISD_KEYS, "name", "model"}
    assert fields('attitude, mode = "spice"') == {"frame"} and fields('trajectory, kind = "spice"') == {"about"}
    # Every mode has its table but `isd`, whose files have all.
    modes = {name.split('"')[1] for name in tables if name.startswith("attitude, mode")}
    assert modes | {"isd"} == {"target", "nadir", *attitude_fields._MODES}
    assert {name for name in fields("attitude, in all modes of the spacecraft")} == {"camera", "offset_deg", "jitter"}


def test_every_field_has_its_type_and_the_defaults_are_the_classes(page, tables):
    for table in tables.values():
        assert all(entry.type for entry in table.fields().values()), table.name
    fields = tables["cameras.model.optics"].fields()
    assert fields["aperture_diameter_m"].default == "required" and fields["transmission"].default == "1.0"
    assert tables["the file"].fields()["max_error"].default == "0.02"
    text = page.markdown()
    assert page.PAGE.read_text(encoding="utf-8") == page.page(), "python docs/reference/scene_fields.py writes it anew"
    assert text.count("\n### ") == len(tables) and "| `roughness_deg` | float [deg], 0..75 | `0.0` |" in text

