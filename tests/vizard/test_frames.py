"""From Basilisk's epochs to pictures: the map, custom models, the half pixel, brightness, what is refused and why."""

from __future__ import annotations

import math
import re
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest
import vizard_peer as peer
from glrender import Body, ConfigError, State, generate
from glrender_vizard import frames
from glrender_vizard.bodies import BodyMap
from glrender_vizard.messages import read_update
from glrender_vizard.recorded import FrameFiles
from scipy.spatial.transform import Rotation

SIDE_PX = 64
DETECTOR = """
[[cameras]]
id = 1
[cameras.model]
exposure_s = 3e-6
optics = { aperture_diameter_m = 0.001 }
detector = { quantum_efficiency = 0.5, full_well_electrons = 50000.0, gain_DN_per_electron = %g, bit_depth = %d }
"""


def drawn(folder, data, text="", number=1):
    """The picture of an update, by a map of this text."""
    (folder / "map.toml").write_text(text)
    with closing(FrameFiles(folder / "out", BodyMap.load(folder / "map.toml"))) as made:
        (path,) = [each for each in made.take(data) if each.name.startswith(f"camera{number}_")]
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)


def refused(data, body_map=None, models=(), number=1):
    update = read_update(data)
    with pytest.raises(ConfigError) as error:
        order = frames.ordered(update, update.models or models, number, body_map or BodyMap())
        frames.make_scene(order.scene, body_map or BodyMap())
    return str(error.value)


def test_a_body_on_the_boresight_is_at_half_the_resolution(tmp_path):
    """Basilisk's horizonOpNav takes pixel (W/2, H/2) for the boresight, pixel centres at integers."""
    data = peer.scene(side_px=SIDE_PX, radius_m=20.0)
    np.testing.assert_allclose(peer.centroid_px(drawn(tmp_path, data)), [32.0, 32.0], atol=0.01)
    text = "[[cameras]]\nid = 1\nprincipal_point_px = [31.5, 31.5]"
    np.testing.assert_allclose(peer.centroid_px(drawn(tmp_path, data, text)), [31.5, 31.5], atol=0.01)


def test_light_is_linear_in_radf(tmp_path):
    """The sphere's albedo is 0.5: its middle, lit from behind the camera, has I/F 0.5; white is where the map says."""
    data = peer.scene(side_px=SIDE_PX, radius_m=150.0)
    middle = lambda text: int(drawn(tmp_path, data, text)[32, 32])  # noqa: E731
    assert middle("") == pytest.approx(127, abs=2)
    assert middle("white_radf = 2.0") == pytest.approx(64, abs=1)
    assert middle("white_radf = 0.4") == 255
    assert middle('[[cameras]]\nid = 1\nwhite_radf = "auto"') == pytest.approx(204, abs=2)
    assert middle('[[cameras]]\nid = 2\nwhite_radf = "auto"') == pytest.approx(127, abs=2)


def test_a_picture_does_not_depend_on_the_suns_distance(tmp_path):
    """As Vizard's light, unless a camera model with an exposure says otherwise."""
    far = peer.scene(side_px=SIDE_PX).replace(peer.doubles(2, (0.0, 0.0, -peer.AU_M)),
                                              peer.doubles(2, (0.0, 0.0, -5.0 * peer.AU_M)))
    np.testing.assert_array_equal(drawn(tmp_path, far), drawn(tmp_path, peer.scene(side_px=SIDE_PX)))
    dn = [float(drawn(tmp_path, data, DETECTOR % (0.005, 8)).max()) for data in (far, peer.scene(side_px=SIDE_PX))]
    assert 0.02 < dn[0] / dn[1] < 0.06


@pytest.mark.parametrize("n_bits, dtype", [(8, np.uint8), (12, np.uint16), (6, np.uint8)])
def test_digital_numbers_fill_the_upper_bits(tmp_path, n_bits, dtype):
    """Basilisk's imdecode keeps the upper eight."""
    gain = (2**n_bits - 1) / 50000.0
    image = drawn(tmp_path, peer.scene(side_px=SIDE_PX), DETECTOR % (gain, n_bits))
    unused = (8 if dtype == np.uint8 else 16) - n_bits
    assert image.dtype == dtype and image.max() > np.iinfo(dtype).max / 50 and not (image & (1 << unused) - 1).any()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_picture_survives_its_bytes(dtype):
    """By OpenCV, as Basilisk reads them."""
    image = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (5, 7), dtype=dtype)
    data = np.frombuffer(frames.encoded(image), np.uint8)
    np.testing.assert_array_equal(cv2.imdecode(data, cv2.IMREAD_UNCHANGED), image)
    shift = 8 * image.itemsize - 8
    np.testing.assert_array_equal(cv2.imdecode(data, cv2.IMREAD_COLOR)[..., 0], image >> shift)


def test_the_camera_looks_where_basilisk_points_it(tmp_path):
    """A spacecraft turned by any attitude, its camera by any mounting, both undone: the body is back in the middle."""
    attitude, mounting = Rotation.random(2, random_state=3)
    mrp = lambda q: (-q.as_quat(scalar_first=True)[1:] / (1.0 + q.as_quat(scalar_first=True)[0]))  # noqa: E731
    unity = Rotation.from_euler("ZYX", [0, 0, 0])
    # Vizard's axes of a camera: -x the boresight, z up, hence y to the right.
    unity = Rotation.from_matrix([[0, 0, -1], [1, 0, 0], [0, -1, 0]])
    camera_from_inertial = mounting * attitude
    r_m = camera_from_inertial.inv().apply([10.0, -20.0, 2000.0])
    data = peer.message(peer.body("sun", (0.0, 0.0, -peer.AU_M), 7e8), peer.body("rock", r_m, 20.0),
                        peer.craft("craft", (0.0, 0.0, 0.0), mrp(attitude)),
                        peer.record(4, peer.whole(1, 1) + peer.text(2, "craft") + peer.double(3, 20.0)
                                    + peer.record(4, peer.varint(64) * 2) + peer.doubles(7, (0.0, 0.0, 0.0))
                                    + peer.doubles(8, mrp(unity * mounting))))
    order = frames.ordered(read_update(data), (), 1, BodyMap())
    pose = order.fields["state"]["spacecraft"]
    looking = Rotation.from_quat(pose["q_from_inertial"], scalar_first=True)
    np.testing.assert_allclose(looking.apply(r_m), [10.0, -20.0, 2000.0], atol=1e-9)
    np.testing.assert_allclose((unity * Rotation.identity()).as_matrix(), frames._CU_FROM_C.as_matrix(), atol=1e-12)


def test_a_planet_is_as_flat_as_basilisk_says(tmp_path):
    """Its poles are along the body's z, here the camera's x."""
    turned = Rotation.from_euler("y", 90, degrees=True).as_matrix()
    data = peer.message(peer.body("sun", (0.0, 0.0, -peer.AU_M), 7e8),
                        peer.body("planet", (0.0, 0.0, 2000.0), 150.0, turned, 0.6),
                        peer.craft("craft", (0.0, 0.0, 0.0)), peer.camera(side_px=256))
    y, x = np.nonzero(drawn(tmp_path, data) > 3)
    assert np.ptp(x) / np.ptp(y) == pytest.approx(0.6, abs=0.02)


def test_the_map_names_shapes_and_laws(tmp_path):
    """In the body's own unit, whatever radius Basilisk sends; a spacecraft is a body like any other."""
    generate.icosphere(radius_m=0.1, subdivisions=4).to_file(tmp_path / "ball.obj")
    text = """
    [[bodies]]
    name = "moonlet"
    shape = "ball.obj"
    length_unit = "km"
    brdf = { law = "lambert", normal_albedo = 0.25 }
    [[bodies]]
    name = "other"
    shape = "ball.obj"
    length_unit = 300.0
    brdf = { law = "lambert", normal_albedo = 1.0 }
    """
    image = drawn(tmp_path, peer.scene(side_px=256, radius_m=3.0), text)
    radius_px = math.sqrt((image > 1).sum() / math.pi)
    focal_px = 128 / math.tan(math.radians(10.0))
    assert radius_px == pytest.approx(focal_px * 100.0 / math.sqrt(2000.0**2 - 100.0**2), 0.02)
    assert int(image[128, 128]) == pytest.approx(64, abs=2)
    beside = peer.craft("other", (150.0, 0.0, 1000.0))
    image = drawn(tmp_path, peer.scene(side_px=256, radius_m=3.0) + beside, text)
    assert int(image[128, 128 + round(focal_px * 0.15)]) > 200


def custom(path, *names, folder=None, radius_m=100.0, **more):
    """(update, map) of a body with a custom model."""
    data = peer.scene(radius_m=radius_m, models=[peer.model(path, *names, **more)])
    return data, BodyMap(models=folder)


def the_body(data, body_map) -> Body:
    update = read_update(data)
    return frames.make_scene(frames.ordered(update, update.models, 1, body_map).scene, body_map).bodies[0]


@pytest.mark.parametrize("path", ["/home/user/models/rock.obj", "rock.obj", "C:\\models\\rock.obj", "../../rock.obj"])
def test_a_custom_model_is_looked_up_by_name(tmp_path, path):
    """Its farthest vertex is at the radius that Basilisk sends, and its scale comes on top: no grey sphere."""
    generate.three_lobes(radius_m=3.0, subdivisions=3).to_file(tmp_path / "rock.obj")
    for scale in ((1.0, 1.0, 1.0), (2.0, 2.0, 2.0), (1.0, 0.5, 2.0)):
        body = the_body(*custom(path, "moonlet", folder=tmp_path, scale=scale))
        lobes = generate.three_lobes(radius_m=3.0, subdivisions=3).vertices_m
        lobes = lobes * (100.0 / np.linalg.norm(lobes, axis=1).max())
        np.testing.assert_allclose(np.ptp(body.shape.vertices_m, axis=0), np.ptp(lobes * scale, axis=0), rtol=1e-5)


@pytest.mark.parametrize("path", ["/etc/passwd", "..", "", "missing.obj", "link.obj", "a" * 300, "nul\0.obj"])
def test_no_custom_model_leads_out_of_the_folder(tmp_path, path):
    (tmp_path / "models").mkdir()
    generate.icosphere(radius_m=1.0, subdivisions=1).to_file(tmp_path / "outside.obj")
    (tmp_path / "models" / "link.obj").symlink_to(tmp_path / "outside.obj")
    assert refused(*custom(path, "moonlet", folder=tmp_path / "models"))


def test_a_turned_custom_model_is_refused(tmp_path):
    generate.icosphere(radius_m=1.0, subdivisions=1).to_file(tmp_path / "rock.obj")
    said = refused(*custom("rock.obj", "moonlet", folder=tmp_path, rotation=(0.0, 0.0, 90.0)))
    assert "must have no rotation" in said and "entry in the map" in said


def test_a_custom_model_without_a_folder_is_a_sphere_and_told():
    data, body_map = custom("rock.obj", "moonlet")
    order = frames.ordered(read_update(data), read_update(data).models, 1, body_map)
    assert "it is drawn as a sphere" in order.notes[0]
    assert np.ptp(the_body(data, body_map).shape.vertices_m[:, 0]) == pytest.approx(200.0, rel=1e-3)


@pytest.mark.parametrize("data, said", [
    (peer.scene().replace(peer.text(2, "craft"), peer.text(2, "ghost")), "parentName: is no spacecraft"),
    (peer.message(peer.body("sun", (1e11, 0.0, 0.0), 7e8), peer.craft("craft", (0.0, 0.0, 0.0)), peer.camera()),
     "none to draw but the Sun"),
    (peer.message(peer.body("a", (0.0, 0.0, 1e3), 1.0), peer.craft("craft", (0.0, 0.0, 0.0)), peer.camera(mode=1)),
     "renderMode: must be 0"),
    (peer.scene(side_px=20000), "width_px"), (peer.scene(side_px=0), "width_px"),
    (peer.scene().replace(peer.double(3, 20.0), peer.double(3, 190.0)), "fieldOfView: must be"),
    (peer.scene(range_m=1e17), "must be within"),
    (peer.message(peer.body("a", (0.0, 0.0, 1e3), 1.0, np.eye(3) * 2.0), peer.craft("craft", (0.0, 0.0, 0.0)),
                  peer.camera()), "rotation matrix"),
    (peer.message(*(peer.body(f"b{k}", (0.0, 0.0, 1e3 * k), 1.0) for k in range(1, 66)),
                  peer.craft("craft", (0.0, 0.0, 0.0)), peer.camera()), "at most 64"),
])
def test_what_cannot_be_drawn_is_refused_by_field_and_rule(data, said):
    update = read_update(data)
    with pytest.raises(ConfigError, match=said):
        order = frames.ordered(update, (), 1, BodyMap())
        frames.make_scene(order.scene, BodyMap())
        State.from_dict(order.fields["state"])


def test_a_camera_beyond_where_numbers_leave_room_for_the_sun_is_refused():
    """1 au added to 1e30 m is nothing in float64: the Sun would be at the camera's place."""
    update = read_update(peer.message(peer.body("a", (0.0, 0.0, 1e3), 1.0), peer.craft("craft", (1e30, 0.0, 0.0)),
                                      peer.camera()))
    with pytest.raises(ConfigError, match="must not be at the Sun's place"):
        frames.ordered(update, (), 1, BodyMap())


def test_spacecraft_count_among_the_bodies_of_a_scene(tmp_path):
    """Each that has a model of its own is drawn."""
    (tmp_path / "a.obj").write_text("v 0 0 80\nv 60 0 -40\nv -40 50 -40\nv -40 -50 -40\n"
                                    "f 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n")
    crafts = [peer.craft(f"c{k}", (0.0, 0.0, 10.0 * k)) for k in range(70)]
    update = read_update(peer.message(peer.body("a", (0.0, 0.0, 1e3), 1.0), *crafts, peer.camera(parent="c0"),
                                      models=[peer.model("a.obj", *(f"c{k}" for k in range(70)))]))
    assert len(update.spacecraft) == 70
    with pytest.raises(ConfigError, match="at most 64, spacecraft too"):
        frames.ordered(update, update.models, 1, BodyMap(models=tmp_path))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("huge", [1e155, -1e308])
def test_huge_numbers_are_refused_without_a_warning(huge):
    """Their squares are infinite."""
    sun, rock = peer.body("sun", (0.0, 0.0, -peer.AU_M), 7e8), peer.body("rock", (0.0, 0.0, 1e3), 10.0)
    craft, camera = peer.craft("craft", (0.0, 0.0, 0.0)), peer.camera()
    for parts in ((peer.body("sun", (huge, huge, 0.0), 7e8), rock, craft),
                  (sun, peer.body("rock", (huge, 0.0, huge), 10.0), craft),
                  (sun, rock, peer.craft("craft", (huge, 0.0, huge))),
                  (sun, peer.body("rock", (0.0, 0.0, 1e3), 10.0, np.full((3, 3), huge)), craft)):
        update = read_update(peer.message(*parts, camera))
        with pytest.raises(ConfigError, match="must be"):
            State.from_dict(frames.ordered(update, (), 1, BodyMap()).fields["state"])


@pytest.mark.parametrize("name, is_sun", [("sun", True), ("Sun", True), ("sun_planet_data", True),
                                          ("sunflower", False), ("sun_orbiter", False), ("my sun", False)])
def test_the_sun_is_known_by_basilisks_own_names(name, is_sun):
    """simIncludeGravBody.createSun: "sun", of older scripts "sun_planet_data"; another body is drawn."""
    data = peer.message(peer.body(name, (0.0, 0.0, -peer.AU_M), 7e8), peer.body("rock", (0.0, 0.0, 2e3), 10.0),
                        peer.craft("craft", (0.0, 0.0, 0.0)), peer.camera())
    order = frames.ordered(read_update(data), (), 1, BodyMap())
    assert (len(order.scene.bodies) == 1) == is_sun and ("has no Sun" in "".join(order.notes)) != is_sun


def test_a_camera_that_is_not_there_is_named():
    assert "unknown" in refused(peer.scene(), number=7) or "it has 1" in refused(peer.scene(), number=7)


def test_without_a_sun_light_comes_from_the_map(tmp_path):
    """Bodies without SPICE messages are all at the origin: a Sun inside a planet is none either."""
    parts = peer.body("moonlet", (0.0, 0.0, 2000.0), 100.0), peer.craft("craft", (0.0, 0.0, 0.0)), peer.camera()
    for more in ((), (peer.body("sun", (0.0, 0.0, 2000.0), 6.95e8),)):
        data = peer.message(*parts, *more)
        order = frames.ordered(read_update(data), (), 1, BodyMap())
        assert "has no Sun" in order.notes[0]
        for sign in (1.0, -1.0):
            image = drawn(tmp_path, data, f"sun_direction_inertial = [{sign}, 0.0, 0.0]")
            assert sign * (peer.centroid_px(image)[0] - 32.0) > 2.0


def test_the_map_of_the_page_loads(tmp_path):
    """docs/basilisk.md: its table, with a shape in the place of Itokawa's."""
    page = (Path(__file__).parents[2] / "docs" / "basilisk.md").read_text(encoding="utf-8")
    (tmp_path / "shapes").mkdir()
    generate.three_lobes(radius_m=0.3, subdivisions=2).to_file(tmp_path / "shapes" / "itokawa.obj")
    (tmp_path / "map.toml").write_text(re.findall(r"```toml\n(.*?)```", page, re.S)[0])
    loaded = BodyMap.load(tmp_path / "map.toml")
    assert loaded.bodies["itokawa"].shape.radius_m > 100.0 and loaded.models == tmp_path / "shapes"
    assert loaded.cameras[1].fields["model"] and loaded.white_radf == 1.0


@pytest.mark.parametrize("text, said", [
    ("bodys = 1", "bodys"), ("cameras = 3", "cameras: must be a list"), ("[[cameras]]\nwhite_radf = 1.0", "id"),
    ("[[cameras]]\nid = 1\nwhite_radf = -1.0", r"cameras\[0\].white_radf"), ("models = 'nowhere'", "must be a folder"),
    ("sun_direction_inertial = [0.0, 0.0, 0.0]", "sun_direction_inertial"), ("white_radf = 'bright'", "white_radf"),
    ("[[cameras]]\nid = 1\nwidth_px = 3", "width_px"), ("[[cameras]]\nid = 1\n" * 2, "each id once"),
    ("x = ", "is not TOML"),
    ("[[bodies]]\nname = 'a'\nshape = 'b.obj'\nlength_unit = 'm'\nbrdf = { law = 'lambert' }", r"bodies\[0\]")])
def test_a_wrong_map_is_refused_by_name(tmp_path, text, said):
    (tmp_path / "map.toml").write_text(text)
    with pytest.raises(ConfigError, match=said):
        BodyMap.load(tmp_path / "map.toml")
