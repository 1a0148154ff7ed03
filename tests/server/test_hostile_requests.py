"""Requests that would end, fill or forge something are refused by name, and the server serves on."""

from __future__ import annotations

import io
import json
import logging
import os
import time
import tomllib

import msgpack
import numpy as np
import pytest
import serving
import views
import zmq
from glb_parts import SHEET_UV, glb, material, png_head, sheet
from glrender import ConfigError
from glrender_camera import PinholeCamera
from glrender_cli.commands.top import screen
from glrender_client import Client, ServerError
from glrender_server import codec, limits, logs
from glrender_server.asked_scene import scene_asked
from PIL import Image

STATE = views.state().to_dict()
RENDER = {"v": 1, "op": "render", "id": 5, "client": "hostile", "state": STATE, "camera": "bare"}


def nested(depth):
    """MessagePack of a list in a list in a list."""
    return b"\x91" * depth + b"\xc0"


def with_raw(fields, name, raw):
    """A packed map with one more value, given as bytes."""
    packed = msgpack.packb({key: value for key, value in fields.items() if key != name})
    return bytes([packed[0] + 1]) + packed[1:] + msgpack.packb(name) + raw


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    with serving.server(tmp_path_factory.mktemp("hostile"), "--tcp", "127.0.0.1:0") as (endpoint, process):
        yield endpoint, process


@pytest.fixture
def ask(live):
    """Sends bytes over ZeroMQ and gives the reply's header."""
    with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
        socket.set(zmq.LINGER, 0)
        socket.connect(live[0])

        def asked(message):
            socket.send(message)
            assert socket.poll(30_000), "no reply"
            return msgpack.unpackb(socket.recv_multipart()[0])

        yield asked


@pytest.mark.parametrize("field", ["client", "op", "v", "id", "state", "roi", "frames", "camera"])
@pytest.mark.parametrize("depth", [20, 500, 1010])
def test_values_nested_deep_are_refused(ask, field, depth):
    reply = ask(with_raw(RENDER, field, nested(depth)))
    assert not reply["ok"] and reply["error"]["code"] == "protocol", reply
    assert ask(msgpack.packb(RENDER))["ok"]


@pytest.mark.parametrize("message, rule", [
    (with_raw(RENDER, "roi", b"\xdd" + (10**6).to_bytes(4, "big") + b"\x80" * 10**6), "msgpack"),
    (with_raw(RENDER, "roi", b"\x92" + 2 * (b"\xdc\x9c\x40" + b"\x80" * 40_000)), "at most 60000"),
    (with_raw(RENDER, "roi", nested(17)), "deeper than 16"),
    (msgpack.packb(RENDER)[:1].replace(b"\x86", b"\x87") + msgpack.packb(RENDER)[1:] + msgpack.packb("op")
     + msgpack.packb("hello"), "twice"),
])
def test_a_header_is_bounded_while_it_is_decoded(message, rule):
    began = time.process_time()
    with pytest.raises(ConfigError, match=rule):
        codec.unpack_request([message])
    assert time.process_time() - began < 0.5


def test_the_longest_request_that_is_allowed_is_decoded():
    directions = [[0.0, 0.0, 1.0]] * 10_000
    assert codec.unpack_request([msgpack.packb({**RENDER, "directions_camera": directions})])


def test_an_error_costs_no_more_than_it_says():
    for value in ("x" * 10**6, b"\xff" * 10**6, [[1] * 1000] * 1000, {str(k): k for k in range(10**5)}):
        began = time.process_time()
        text = str(ConfigError("roi", "must be four numbers", value))
        assert len(text) < 300 and time.process_time() - began < 0.05


def test_a_float_with_a_whole_value_is_an_id(ask):
    """MATLAB's numbers are floats."""
    assert ask(msgpack.packb({"v": 1, "op": "hello", "id": 7.0, "client": "m"}))["id"] == 7
    drawn = ask(msgpack.packb({**RENDER, "id": 8.0}))
    assert drawn["ok"] and drawn["id"] == 8
    reply = ask(msgpack.packb({"v": 1, "op": "hello", "id": 7.5, "client": "m"}))
    assert (reply["ok"], reply["error"]["path"]) == (False, "id")


SCENE = tomllib.loads(serving.SCENE)


def camera(number, side_px):
    return {"name": f"c{number}", "width_px": side_px, "height_px": side_px, "focal_length_px": 100.0 + number}


def body(number, **generated):
    return {**SCENE["bodies"][0], "name": f"b{number}",
            "generated": {"kind": "icosphere", "radius_m": 1.0, "subdivisions": 1, **generated}}


@pytest.mark.parametrize("changes, path, rule", [
    ({"cameras": [camera(k, 4096) for k in range(5)]}, "scene.cameras", "67108864 pixels together"),
    ({"cameras": [camera(k, 8) for k in range(65)]}, "scene.cameras", "at most 64"),
    ({"bodies": [body(k) for k in range(1500)]}, "scene.bodies", "at most 64"),
    ({"bodies": [body(k, subdivisions=9) for k in range(3)]}, "scene.bodies", "10000000 facets together"),
    ({"bodies": [body(k, subdivisions=9.0) for k in range(3)]}, "scene.bodies", "10000000 facets together"),
    ({"bodies": [{**body(0, subdivisions=0), "regions": [body(k, subdivisions=9) for k in range(3)]}]}, "scene.bodies",
     "10000000 facets together"),
    ({"bodies": [{**body(0, subdivisions=0), "regions": [body(k, subdivisions=0) for k in range(200)]}]},
     "scene.bodies", "with their regions, at most"),
])
def test_the_sums_of_a_scene_are_bounded_before_it_is_made(changes, path, rule):
    began = time.process_time()
    with pytest.raises(ConfigError, match=rule) as caught:
        scene_asked({"v": 1, "op": "load_scene", "id": 1, "client": "c", "scene": {**SCENE, **changes}}, None)
    assert caught.value.path == path and time.process_time() - began < 0.5


def coma(*sources):
    return {"kind": "coma", "body": "body", "dust": {"geometric_albedo": 0.05, "phase_function": "marcus"},
            "sources": list(sources)}


def tail(**changes):
    return {"model": "tail", "afrho_m": 1.0, "perihelion_au": 1.2, "eccentricity": 0.6, "true_anomaly_deg": 10.0,
            "pole_inertial": [0.0, 0.0, 1.0], "oldest_s": 1e6, "length_m": 1e7, **changes}


@pytest.mark.parametrize("emission, rule", [
    ([coma(*[tail(particles=1000)] * 65)], "64 sources together"),
    ([coma(tail(particles=1000))] * 65, "64 sources together"),
    ([coma({"model": "haser", "afrho_m": 1.0})] * 65, "64 sources together"),
    ([coma(tail(particles=5_000_000), tail())], "5000000 grains together"),
    ([coma(*[tail()] * 42)], "5000000 grains together"),  # of 120,000 each, unless something else is said
    ([coma(*[tail(particles=1000, cells=160)] * 5)], "16777216 cells of dust together"),
    ([coma(*[tail(particles=1000)] * 19)], "16777216 cells of dust together"),  # of 96 along a side
])
def test_sources_of_dust_are_bounded_by_their_sums(emission, rule):
    header = {"v": 1, "op": "load_scene", "id": 1, "client": "c", "scene": {**SCENE, "emission": emission}}
    began = time.process_time()
    with pytest.raises(ConfigError, match=rule) as caught:
        scene_asked(header, None)
    assert caught.value.path == "scene.emission" and time.process_time() - began < 0.5


def test_sources_within_the_bounds_are_made():
    header = {"v": 1, "op": "load_scene", "id": 1, "client": "c",
              "scene": {**SCENE, "emission": [coma(*[tail(particles=1000, cells=8, seed=k) for k in range(64)])]}}
    assert len(scene_asked(header, None).emission[0].sources) == 64


def test_a_grid_of_dust_counts_with_its_refinement(tmp_path):
    np.savez(tmp_path / "dust.npz", density=np.ones((40, 40, 40), np.float32), low_m=[-1e4] * 3, high_m=[1e4] * 3)
    grid = {"model": "grid", "file": "dust.npz", "particle_cross_section_m2": 1e-9, "refine": 4}
    header = {"v": 1, "op": "load_scene", "id": 1, "client": "c", "scene": {**SCENE, "emission": [coma(*[grid] * 5)]}}
    with pytest.raises(ConfigError, match="16777216 cells of dust together, got 20480000"):
        scene_asked(header, tmp_path)


def test_textures_are_bounded_by_their_sum_before_a_pixel_is_read(tmp_path):
    """Each of 67 megapixels: the third is too many."""
    Image.fromarray(np.zeros((8192, 8192), np.uint8)).save(tmp_path / "map.png")
    os.mkfifo(tmp_path / "pipe.png")
    bodies = [{**body(0), "albedo_texture": "pipe.png"}, *({**body(k), "albedo_texture": "map.png"} for k in (1, 2, 3))]
    header = {"v": 1, "op": "load_scene", "id": 1, "client": "c", "scene": {**SCENE, "bodies": bodies}}
    began = time.process_time()
    with pytest.raises(ConfigError, match="134217728 pixels of textures together, got 201326592"):
        scene_asked(header, tmp_path)
    assert time.process_time() - began < 0.5

def test_images_in_shape_files_are_counted_before_they_are_unpacked(tmp_path):
    """Three bodies of one file with an image of 16384 x 4096, of which only the header is there."""
    head = png_head(16384, 4096)
    glb(tmp_path / "sat.glb", [sheet(0, uv=SHEET_UV)], [material("m", baseColorTexture={"index": 0})], [head])
    bodies = [{"name": f"b{k}", "shape": "sat.glb", "length_unit": "m"} for k in range(3)]
    header = {"v": 1, "op": "load_scene", "id": 1, "client": "c", "scene": {**SCENE, "bodies": bodies}}
    with pytest.raises(ConfigError, match="134217728 pixels of textures together, got 201326592"):
        scene_asked(header, tmp_path)


@pytest.mark.parametrize("changes, message", [
    ({"shape": "../out.glb"}, r"shape: must be a bare file name in the server's shape directory, got '\.\./out\.glb'"),
    ({"shape": "a.gltf"}, r"shape\.a\.gltf: must end in one of .*; export it as \.glb"),
    ({"shape": "image.glb"}, r"images\.uri: must not be there.*got 'map\.png'; export it as one \.glb"),
    ({"shape": "a.obj"}, r"materials\.m: missing: mtllib \.\./out\.mtl must be a bare name.*; give its law"),
    ({"materials": {"cell": {"law": "lambert", "normal_albedo": 0.3}}},
     "materials: must be names of the file's materials, got 'cell'; did you mean 'cells'.*paint, cells"),
    ({"materials": {"cells": {"law": "microfacet", "base_albedo": 0.1, "metalness": 0.0, "roughness": 0.01}}},
     r"materials\.cells\.roughness: must be between 0\.1 and 1, got 0\.01"),
    ({"materials": []}, "materials: must map names"), ({"sides": ["both"]}, "sides: must be one of 'file', .*'both'")])
def test_files_with_materials_are_those_of_the_folder_alone(tmp_path, changes, message):
    """Next to the folder lie files of the same kinds, which would be taken were a name more than a bare one."""
    folder = tmp_path / "shapes"
    folder.mkdir()
    given = [material("paint", 0.8), material("cells", 0.1)]
    for path in (folder / "sat.glb", tmp_path / "out.glb"):
        glb(path, [sheet(0), sheet(1, {"translation": [2.0, 0.0, 0.0]})], given)
    Image.fromarray(np.zeros((2, 2), np.uint8)).save(folder / "map.png")
    glb(folder / "image.glb", [sheet(0, uv=SHEET_UV)], [material("m", baseColorTexture={"index": 0})],
        [{"uri": "map.png"}])
    (folder / "a.gltf").write_text("{}")
    (folder / "a.obj").write_text("mtllib ../out.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n")
    (tmp_path / "out.mtl").write_text("newmtl m\nKd 0.1 0.1 0.1\n")

    def asked(**more):
        table = {"name": "body", "shape": "sat.glb", "length_unit": "m", **more}
        return scene_asked({"v": 1, "op": "load_scene", "id": 1, "client": "c", "scene": {**SCENE, "bodies": [table]}},
                           folder)

    grey = {"law": "lambert", "normal_albedo": 0.3}
    assert asked(materials={"cells": grey}).bodies[0].materials["cells"].normal_albedo == 0.3
    with pytest.raises(ConfigError, match=rf"scene\.bodies\[0\]\..*{message}"):
        asked(**changes)


@pytest.mark.parametrize("ground, n, message", [
    ({"site_deg": [0.0, 0.0], "rings": [[13_000.0, 10.0]]}, 1, "bodies: must have at most 10000000 .*got 13520000"),
    ({"site_deg": [0.0, 0.0], "rings": [[9000.0, 10.0]]}, 2, "bodies: must have at most 10000000 .*got 12960000"),
    ({"facets": 6_000_000}, 2, "bodies: must have at most 10000000 .*got 12000000"),
    ({}, 11, "bodies: must have at most 10000000 .*got 11000000"),
    ({"site_deg": [0.0, 0.0], "rings": [[1e9, 1.0]]}, 1, r"bodies\[0\].terrain.heights: is no readable|.*rings: must"),
    ({"orthophoto": "large.png"}, 2, "134217728 pixels of textures together, got 268435456"),
    ({"rings": "many"}, 1, "terrain"), ({"facets": "many"}, 1, "terrain")])
def test_terrain_that_is_too_large_is_refused_before_a_map_is_opened(tmp_path, ground, n, message):
    """There is no map, and none is missed; an orthophoto too large for a texture counts as the largest."""
    (tmp_path / "large.png").write_bytes(png_head(200_000, 200_000))
    bodies = [{"name": f"b{k}", "terrain": {"heights": "none.tif", **ground}, "brdf": SCENE["bodies"][0]["brdf"]}
              for k in range(n)]
    with pytest.raises(ConfigError, match=message):
        scene_asked({"v": 1, "op": "load_scene", "id": 1, "client": "c", "scene": {**SCENE, "bodies": bodies}},
                    tmp_path)


def test_many_lamps_are_refused():
    lamps = [{"name": f"l{k}", "intensity_W_sr": 1.0} for k in range(65)]
    with pytest.raises(ConfigError, match=r"scene.lamps: must be at most 64, got 65"):
        scene_asked({"v": 1, "op": "load_scene", "id": 1, "client": "c", "scene": {**SCENE, "lamps": lamps}}, None)



@pytest.mark.parametrize("name", ["cam\x1b[2J", "two\nlines", "x" * 129, ""])
def test_names_are_printable_text(name):
    with pytest.raises(ConfigError, match="printable"):
        PinholeCamera(**{**camera(0, 8), "name": name})
    with pytest.raises(ConfigError, match="printable"):
        scene_asked({"v": 1, "op": "load_scene", "id": 1, "client": "c",
                     "scene": {**SCENE, "bodies": [{**SCENE["bodies"][0], "name": name}]}}, None)


def test_messages_about_shapes_do_not_tell_the_servers_folders(tmp_path):
    (tmp_path / "bad.obj").write_text("v 1 2 nan\nf 1 2 3\n")
    for name in ("bad.obj", "none.obj"):
        named = {"name": "b", "shape": name, "length_unit": "m", "brdf": SCENE["bodies"][0]["brdf"]}
        with pytest.raises(ConfigError) as caught:
            scene_asked({"v": 1, "op": "load_scene", "id": 1, "client": "c",
                         "scene": {**SCENE, "bodies": [named]}}, tmp_path)
        assert name in str(caught.value) and str(tmp_path) not in str(caught.value)


EVIL = "a\n2031-01-01 00:00:00,000 ERROR glrender_server[1]: forged\x1b[2J\x1b]0;owned\x07\u2028\x9b1m"


@pytest.mark.parametrize("form", logs.FORMATS)
def test_a_log_record_is_one_line_without_control_characters(form):
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    handler.setFormatter(logs.formatter(form))
    logger = logging.Logger("test")
    logger.addHandler(handler)
    logger.error("poison: request of %s", EVIL)
    line, = stream.getvalue().splitlines()
    assert not any(ord(character) < 32 or 127 <= ord(character) < 160 for character in line) and "forged" in line
    try:
        raise ValueError(EVIL)
    except ValueError:
        logger.exception("request failed")
    if form == "text":
        first, *others = stream.getvalue().split("\n")[1:-1]
        assert "request failed" in first and others and all(other.startswith("    ") for other in others)
    else:
        assert "forged" in json.loads(stream.getvalue().splitlines()[1])["traceback"]
    assert "\x1b" not in stream.getvalue()


def test_lines_of_one_kind_are_counted_rather_than_written(monkeypatch):
    clock, sparing = [0.0], logs.Sparing()
    monkeypatch.setattr(logs.time, "monotonic", lambda: clock[0])

    def record(level, form, *values):
        return logging.LogRecord("server", level, "", 0, form, values, None)

    passed = [sparing.filter(record(logging.WARNING, "client %s takes nothing", k)) for k in range(1000)]
    assert sum(passed) == limits.LOG_LINES
    assert sparing.filter(record(logging.WARNING, "another kind"))
    assert all(sparing.filter(record(logging.DEBUG, "request")) for _ in range(1000)), "asked for by --verbose"
    clock[0] += 1.1 * limits.LOG_PERIOD_S
    last = record(logging.WARNING, "client %s takes nothing", 1000)
    assert sparing.filter(last) and last.getMessage() == "client 1000 takes nothing (990 more like it were left out)"


def test_top_shows_what_a_server_says_without_control_characters():
    status = {"uptime_s": 1.0, "gl_renderer": EVIL, "backend": EVIL, "requests": {EVIL: 1}, "errors": {}, "waiting": 0,
              "clients": 0, "last_timings_ms": {}, "bodies": [],
              "cameras": [{"name": EVIL, "width_px": 1, "height_px": 1}]}
    for line in screen("tcp://127.0.0.1:5555", status):
        assert not any(ord(character) < 32 or 127 <= ord(character) < 160 for character in line)


def test_a_scene_that_nobody_may_replace(tmp_path):
    with serving.server(tmp_path, "--no-load-scene") as (endpoint, _), Client(endpoint, timeout_s=30.0) as client:
        with pytest.raises(ServerError, match="--no-load-scene") as caught:
            client.load_scene(SCENE)
        assert caught.value.code == "forbidden" and client.render(STATE, "bare").pixels.any()
