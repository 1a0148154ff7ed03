"""Data sets: the same bytes by any processes and sittings; formats that other programs read; what is refused."""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tarfile
import time
from dataclasses import replace

import numpy as np
import processes
import pytest
import serving
import views
from glrender import ConfigError, DeviceError, GlrenderError, Pose, frames, load_scene, open_renderer, take_frame
from glrender.sequences.dataset.bop import Outline
from glrender.sequences.dataset.coco import run_lengths
from glrender.sequences.dataset.dataset import DataSet
from glrender.sequences.dataset.read import read_frame
from glrender.sequences.options import FrameOptions
from glrender.view.view import view_bodies
from glrender_camera.pattern import seed_of
from glrender_cli.__main__ import main
from missing import needed_module
from PIL import Image

STATES = [views.state(phase_deg=20.0 + 15.0 * k, range_m=1000.0 + 100.0 * k, target=(0.0, 0.0, 20.0 * k))
          for k in range(7)]
KEYPOINTS = {"body": {"near": (-10.0, 5.0, 20.0), "far": (60.0, 0.0, 0.0)}}
# A moon hides a part of the body, and the body leaves the image.
MOON = """[[bodies]]
name = "moon"
generated = { kind = "icosphere", radius_m = 25.0, subdivisions = 3 }
brdf = { law = "lambert", normal_albedo = 0.2 }
"""


def with_moon(state):
    """A state with the moon between camera and body, a little aside."""
    towards = state.spacecraft.r_inertial_m / np.linalg.norm(state.spacecraft.r_inertial_m)
    return replace(state, bodies={**state.bodies, "moon": Pose(r_inertial_m=300.0 * towards + [20.0, 30.0, 0.0])})


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "scene.toml"
    path.write_text(serving.SCENE)
    return path


@pytest.fixture(scope="module")
def scene(file):
    return load_scene(file)


def dataset(scene, folder, states=STATES, **options):
    own = {name: options.pop(name) for name in ("format", "source") if name in options}
    return DataSet(scene=scene, states=states, folder=folder, frames_a_shard=2, options=FrameOptions(
        **{"camera": "navcam", "output": "dn", "format": "npz", "seed": 7, "keypoints": KEYPOINTS, "limb_points": 16,
           **options}), **own)


def contents(folder):
    """All files but the manifest, and the manifest without what a sitting took."""
    manifest = json.loads((folder / "manifest.json").read_text())
    took = manifest.pop("throughput")
    assert took["n_frames"] > 0 and took["frames_a_core_second"] > 0.0 and took["renderers"]
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*")
            if path.is_file() and path.name not in ("manifest.json", "contact_sheet.png")}, manifest


@pytest.fixture(scope="module")
def whole(scene, tmp_path_factory):
    """The folder of a data set that one process drew in one go."""
    made = dataset(scene, tmp_path_factory.mktemp("whole"))
    assert sorted(made.draw(1)) == [0, 1, 2, 3] and not made.missing()
    return made.folder


def test_a_frame_is_the_one_that_take_frame_gives_and_its_labels_fit(scene, whole):
    with open_renderer(scene) as renderer:
        capture = take_frame(renderer, STATES[5], "navcam", seed=seed_of(7, 5), products=["body_id"])
    frame = read_frame(whole, 5)
    np.testing.assert_array_equal(frame.image, capture.frame.dn)
    np.testing.assert_array_equal(frame.mask, capture.products["body_id"] + 1)
    body = frame.labels["labels"]["bodies"]["body"]
    y, x = np.nonzero(frame.mask)
    assert body["box_px"] == [x.min(), y.min(), x.max() + 1, y.max() + 1] and body["n_px"] == len(x)
    assert frame.labels["index"] == 5 and frame.labels["state"] == STATES[5].to_dict()
    assert set(body["keypoints"]) == {"near", "far"} and len(body["limb"]["px"]) == 16


@pytest.mark.slow
def test_a_killed_command_goes_on_and_two_processes_write_the_same_bytes(file, whole, tmp_path):
    scenario, states = tmp_path / "scenario.toml", tmp_path / "states.jsonl"
    keypoints = "".join(f"\n{name} = {list(place)}" for name, place in KEYPOINTS["body"].items())
    scenario.write_text(serving.SCENE.replace("[[cameras]]", f"[bodies.keypoints]{keypoints}\n[[cameras]]", 1))
    states.write_text("".join(json.dumps(state.to_dict()) + "\n" for state in STATES))
    out = tmp_path / "out"
    command = [sys.executable, "-m", "glrender_cli", "dataset", scenario, "--states", states, "--out", out,
               "--seed", "7", "--limb-points", "16", "--shard-frames", "2", "--processes", "2"]
    for _ in range(5):  # until it is killed before all is done
        with subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as first:
            deadline = time.monotonic() + 90.0
            while not list(out.glob("shard_*")) and time.monotonic() < deadline:
                time.sleep(0.001)
            first.send_signal(signal.SIGKILL)
        time.sleep(0.5)  # its processes end with it
        there = list(out.glob("shard_*"))
        if len(there) < 4:
            break
        shutil.rmtree(out)
    assert 0 < len(there) < 4
    n_left = 7 - sum(1 if path.name == "shard_00003.tar" else 2 for path in there)
    told = subprocess.run(command, capture_output=True, text=True, timeout=180, check=True)
    assert f"7 frames in 4 shards, {n_left} drawn now" in told.stdout and "a second a core" in told.stdout
    files, manifest = contents(out)
    ours, expected = contents(whole)
    assert {**manifest, "source": None, "scenario": None} == {**expected, "source": None, "scenario": None}
    assert {name: content for name, content in files.items() if not name.endswith(".part")} == ours
    assert Image.open(out / "contact_sheet.png").size[0] > 500


def test_a_shard_that_is_lost_is_drawn_anew(scene, whole, tmp_path):
    made = dataset(scene, tmp_path)
    drawing = made.draw(1)
    next(drawing)
    drawing.close()
    assert made.missing() == [1, 2, 3]
    list(made.draw(1))
    made.path(2).unlink()
    made.path(3).unlink()
    assert list(made.draw(1)) == [2, 3]
    assert contents(tmp_path) == contents(whole)


def test_a_process_that_is_killed_is_told_and_costs_nothing(scene, whole, tmp_path):
    made = dataset(scene, tmp_path)
    drawing = made.draw(2)
    next(drawing)
    for pid in processes.children(os.getpid(), b"spawn_main"):
        os.kill(pid, signal.SIGKILL)
    with pytest.raises(DeviceError, match="a process that draws was killed.*finished work stays: start again"):
        for _ in drawing:
            pass
    list(made.draw(1))
    assert contents(tmp_path) == contents(whole)


def test_a_tar_shard_is_what_webdataset_reads(whole):
    """Samples follow one another, each with one name before the first dot; no owner, no date."""
    with tarfile.open(whole / "shard_00003.tar") as tar:
        members = tar.getmembers()
    assert [member.name for member in members] == ["000006.png", "000006.mask.png", "000006.json"]
    assert all((member.mtime, member.uid, member.uname) == (0, 0, "") for member in members)


@pytest.mark.parametrize("format", ["hdf5", "coco", "bop"])
def test_formats_give_the_same_frames(scene, whole, tmp_path, format):
    if format == "hdf5":
        needed_module("h5py", "pip install h5py")
    made = dataset(scene, tmp_path / "a", states=STATES[:3], format=format)
    list(made.draw(1))
    for index in range(3):
        frame, expected = read_frame(made.folder, index), read_frame(whole, index)
        np.testing.assert_array_equal(frame.image, expected.image)
        np.testing.assert_array_equal(frame.mask, expected.mask)
        assert frame.labels == expected.labels
    again = dataset(scene, tmp_path / "b", states=STATES[:3], format=format)
    list(again.draw(1))
    assert contents(made.folder) == contents(again.folder)


def test_products_are_kept(scene, tmp_path):
    for format in ("webdataset", "hdf5", "coco"):
        if format == "hdf5":
            needed_module("h5py", "pip install h5py")
        made = dataset(scene, tmp_path / format, states=STATES[:1], format=format, products=("range", "incidence"))
        list(made.draw(1))
        products = read_frame(made.folder, 0).products
        with open_renderer(scene) as renderer:
            expected = take_frame(renderer, STATES[0], "navcam", seed=seed_of(7, 0),
                                  products=["range", "incidence"]).products
        for name, values in products.items():
            assert values.dtype == np.float32
            np.testing.assert_array_equal(values, expected[name].astype(np.float32))
        assert set(products) == {"range", "incidence"}


def test_irradiance_is_kept_as_float32(scene, tmp_path):
    made = dataset(scene, tmp_path, states=STATES[:1], output="irradiance", camera="bare")
    list(made.draw(1))
    assert read_frame(tmp_path, 0).image.dtype == np.float32 and read_frame(tmp_path, 0).image.max() > 0.0


def test_cocos_own_reader_finds_boxes_masks_and_keypoints(scene, tmp_path):
    needed_module("pycocotools", "pip install pycocotools")
    from pycocotools import mask as masks
    from pycocotools.coco import COCO

    made = dataset(scene, tmp_path, states=STATES[:3], format="coco")
    list(made.draw(1))
    coco = COCO(tmp_path / "annotations.json")
    assert coco.getImgIds() == [0, 1, 2] and coco.loadCats(1)[0]["keypoints"] == ["near", "far"]
    for index in range(3):
        frame = read_frame(tmp_path, index)
        assert np.asarray(Image.open(tmp_path / coco.loadImgs(index)[0]["file_name"])).shape == frame.mask.shape
        annotation, = coco.loadAnns(coco.getAnnIds(imgIds=index))
        np.testing.assert_array_equal(coco.annToMask(annotation), frame.mask)
        assert masks.toBbox(coco.annToRLE(annotation)).tolist() == annotation["bbox"]
        for (name, point), (x, y, v) in zip(frame.labels["labels"]["bodies"]["body"]["keypoints"].items(),
                                            np.reshape(annotation["keypoints"], (-1, 3)), strict=True):
            assert v == (0 if not point["is_in_view"] else 2 if point["is_seen"] else 1), name
            assert v == 0 or [x, y] == point["px"]


def test_run_lengths_begin_with_what_is_not_in_the_mask():
    for mask in ([[1, 0], [1, 1]], [[0, 0], [0, 1]], [[0, 0]], [[1, 1]]):
        runs = run_lengths(np.array(mask, bool))
        assert np.repeat(np.arange(len(runs)) % 2, runs).tolist() == np.array(mask).ravel(order="F").tolist()


@pytest.fixture(scope="module")
def bop(tmp_path_factory):
    """A data set of BOP's with two bodies; the scene."""
    folder = tmp_path_factory.mktemp("bop")
    (folder / "scene.toml").write_text(serving.SCENE + MOON)
    scene = load_scene(folder / "scene.toml")
    # The body is off the middle, hidden by the moon, and partly out of the image.
    states = [with_moon(state) for state in (STATES[0], views.state(range_m=900.0, target=(130.0, 0.0, 60.0)))]
    made = dataset(scene, folder / "out", states=states, format="bop", keypoints={})
    list(made.draw(1))
    return folder / "out", scene, states


def test_bops_poses_and_depths_are_those_of_the_scene(bop):
    """By BOP's own rules: K (R x + t) in mm; a depth's pixel (u, v) is at ((u - cx) / fx, (v - cy) / fy, 1) of it."""
    folder, scene, states = bop
    part = folder / "train" / "000000"
    cameras, poses = (json.loads((part / f"{name}.json").read_text()) for name in ("scene_camera", "scene_gt"))
    models = json.loads((folder / "models" / "models_info.json").read_text())
    with open_renderer(scene) as renderer:
        for index, state in enumerate(states):
            products = renderer.render(state, camera="navcam", products=["r_body", "body_id"]).products
            k = np.reshape(cameras[str(index)]["cam_K"], (3, 3))
            depth_mm = np.asarray(Image.open(part / "depth" / f"{index:06d}.png")) * cameras[str(index)]["depth_scale"]
            v, u = np.nonzero(products["body_id"] >= 0)
            np.testing.assert_array_equal(depth_mm > 0.0, products["body_id"] >= 0)
            at_mm = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones(len(u))]) * depth_mm[v, u]
            for pose in poses[str(index)]:
                here = products["body_id"][v, u] == pose["obj_id"] - 1
                model_mm = 1e3 * products["r_body"][v, u][here].astype(float)
                placed = np.reshape(pose["cam_R_m2c"], (3, 3)) @ model_mm.T + np.reshape(pose["cam_t_m2c"], (3, 1))
                # Depths have 16 bits.
                np.testing.assert_allclose(placed, at_mm[:, here], atol=2.0 * cameras[str(index)]["depth_scale"])
    vertices = 1e3 * scene.bodies[0].shape.vertices_m
    assert models["1"]["min_x"] == vertices[:, 0].min() and models["1"]["size_z"] == np.ptp(vertices[:, 2])
    assert models["2"]["diameter"] == pytest.approx(50e3, rel=2e-3)
    ply = (folder / "models" / "obj_000001.ply").read_text().splitlines()
    assert ply[2] == f"element vertex {len(vertices)}"
    np.testing.assert_allclose([float(x) for x in ply[9].split()], vertices[0], rtol=1e-8)


def test_bops_outlines_are_whole_where_the_moon_hides_the_body_or_the_image_ends(bop):
    """Against the body drawn alone, by a camera with a field of three images."""
    folder, scene, states = bop
    infos = json.loads((folder / "train" / "000000" / "scene_gt_info.json").read_text())
    camera = scene.camera("navcam")
    wide = replace(camera, width_px=3 * camera.width_px, height_px=3 * camera.height_px, model=None,
                   principal_point_px=tuple(np.add(camera.principal_point_px, (camera.width_px, camera.height_px))))
    alone = replace(scene, bodies=scene.bodies[:1], cameras=(wide,))
    with open_renderer(alone) as renderer:
        for index, state in enumerate(states):
            state = replace(state, bodies={"body": state.bodies["body"]})
            mask = renderer.render(state, products=["body_id"]).products["body_id"] == 0
            info = infos[str(index)][0]
            in_image = mask[camera.height_px:2 * camera.height_px, camera.width_px:2 * camera.width_px]
            drawn = np.asarray(Image.open(folder / "train" / "000000" / "mask" / f"{index:06d}_000000.png")) > 0
            assert (drawn != in_image).sum() <= 2 and (mask.sum() > in_image.sum()) == (index == 1)
            y, x = np.nonzero(mask)
            box = [x.min() - camera.width_px, y.min() - camera.height_px, np.ptp(x) + 1, np.ptp(y) + 1]
            np.testing.assert_allclose(info["bbox_obj"], box, atol=2)
            assert info["px_count_all"] == pytest.approx(mask.sum(), rel=5e-3)
            seen = read_frame(folder, index).mask == 1
            assert info["px_count_visib"] == seen.sum() < in_image.sum()
            assert info["visib_fract"] == pytest.approx(seen.sum() / mask.sum(), rel=5e-3)


def test_a_body_behind_the_camera_has_no_outline(scene):
    state = views.state(range_m=900.0, target=(0.3 * 2e3, -0.8 * 2e3, 0.4 * 2e3))
    camera = scene.camera("navcam")
    views_of = view_bodies(state, camera, scene.hulls)
    outline = Outline(scene.bodies[0], views_of[0], views_of, camera, np.zeros((64, 96), bool))
    assert (outline.n_px, outline.box) == (0, [-1, -1, -1, -1])


@pytest.mark.parametrize("options, message", [
    ({"format": "tfrecord"}, "format: must be one of 'webdataset'"),
    ({"format": "coco", "output": "irradiance"}, "coco holds digital numbers alone"),
    ({"format": "bop", "products": ("range",)}, "products: must be none with bop"),
    ({"output": "dn", "camera": "bare"}, "has no optics"), ({"keypoints": {"moon": {}}}, "moon: is no body"),
    ({"limb_points": 2000}, "limb_points"), ({"products": ("depth",)}, r"products\[0\]: must be one of")])
def test_options_that_are_none(scene, tmp_path, options, message):
    with pytest.raises(ConfigError, match=message):
        dataset(scene, tmp_path, **options)


def test_a_folder_with_another_data_set_is_refused(scene, whole, tmp_path):
    for changes, told in (({"seed": 8}, "options.seed differ"), ({"format": "coco"}, "format differ"),
                          ({"states": STATES[:6]}, "n_frames, states_sha256 differ"),
                          ({"source": {"seed": 3}}, "source.seed differ")):
        with pytest.raises(ConfigError, match=f"another sequence: {told}.*choose another folder"):
            list(dataset(scene, whole, **changes).draw(1))
    (tmp_path / "manifest.json").write_text("[]")
    with pytest.raises(ConfigError, match="another sequence: glrender, n_frames"):
        list(dataset(scene, tmp_path).draw(1))


def test_a_disk_that_is_full_leaves_what_is_done(scene, whole, tmp_path):
    """The system refuses to write as much, as a full disk does."""
    made = dataset(scene, tmp_path)
    drawing = made.draw(1)
    next(drawing)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, hard))
    try:
        with pytest.raises(GlrenderError, match="cannot be written: File too large; 1 of 4 shards are there and stay"):
            list(drawing)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert len(list(tmp_path.glob("shard_*"))) == 1 and not list(tmp_path.rglob(".*"))
    list(made.draw(1))
    assert contents(tmp_path) == contents(whole)


def test_a_frame_that_cannot_be_drawn_is_told_with_its_number(scene, tmp_path):
    made = dataset(scene, tmp_path, states=[*STATES[:2], views.state(range_m=10.0)])
    with pytest.raises(ConfigError, match=r"states\[2\]"):
        list(made.draw(1))
    assert made.missing() == [1]


def test_reading_what_is_no_data_set_is_told(whole, tmp_path):
    with pytest.raises(ConfigError, match="is no data set"):
        read_frame(tmp_path, 0)
    with pytest.raises(ConfigError, match="index: must be 0 to 6"):
        read_frame(whole, 7)


RANDOM = """[random]
range_m = [700.0, 1500.0]
frames = 4
seed = 3
"""


def test_the_command_draws_random_states(tmp_path, capsys):
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(serving.SCENE + RANDOM)
    assert main(["check", str(scenario)]) == 0
    out = capsys.readouterr().out
    assert "random: range_m 700 to 1500, uniform" in out and "tried: 4 of 4 frames: " in out
    command = ["dataset", str(scenario), "--out", str(tmp_path / "out"), "--frames", "5", "--processes", "1"]
    assert main(command) == 0 and "5 frames in 1 shards, 5 drawn now" in capsys.readouterr().out
    assert main(command) == 0 and "0 drawn now" in capsys.readouterr().out
    source = json.loads((tmp_path / "out" / "manifest.json").read_text())["source"]
    assert (source["seed"], source["frames"], source["sampler"]) == (3, 5, "latin_hypercube")
    ranges = [read_frame(tmp_path / "out", index).labels["labels"]["bodies"]["body"]["range_m"] for index in range(5)]
    assert np.histogram(ranges, np.linspace(700.0, 1500.0, 6))[0].tolist() == [1, 1, 1, 1, 1]
    assert main([*command, "--seed", "4"]) == 1 and "another sequence" in capsys.readouterr().err
    assert main([*command[:4], "--states", str(scenario), "--frames", "5"]) == 1
    assert "--frames: is given with --states" in capsys.readouterr().err


def test_the_command_follows_output_and_options_override_it(tmp_path, capsys):
    scenario, out = tmp_path / "scenario.toml", tmp_path / "out"
    table = 'output = "dn"\nexposure_s = 0.01\nseed = 77\nmax_error = 0.1\nproducts = ["range"]\nformat = "fits"\n'
    scenario.write_text(f"{serving.SCENE}{RANDOM}[output]\n{table}")
    assert main(["check", str(scenario)]) == 0
    assert "exposure 0.01 s, " in capsys.readouterr().out
    command = ["dataset", str(scenario), "--frames", "2", "--processes", "1", "--out"]
    assert main([*command, str(out)]) == 0
    frame = read_frame(out, 1)
    assert (frame.labels["exposure_s"], frame.labels["seed"], list(frame.products)) == (0.01, seed_of(77, 1), ["range"])
    assert frame.labels["plan"]["max_error"] == 0.1
    assert main([*command, str(tmp_path / "own"), "--exposure-s", "0.02", "--seed", "5", "--products"]) == 0
    frame = read_frame(tmp_path / "own", 0)
    assert (frame.labels["exposure_s"], frame.labels["seed"], list(frame.products)) == (0.02, seed_of(5, 0), [])
    (tmp_path / "states.jsonl").write_text(json.dumps(STATES[0].to_dict()) + "\n")
    assert main(["dataset", str(scenario), "--processes", "1", "--states", str(tmp_path / "states.jsonl"), "--out",
                 str(tmp_path / "states")]) == 0
    frame = read_frame(tmp_path / "states", 0)
    assert (frame.labels["exposure_s"], frame.labels["seed"], list(frame.products)) == (0.01, seed_of(77, 0), ["range"])
    scenario.write_text(f"{serving.SCENE}{RANDOM}[output]\nsed = 3\n")
    assert main([*command, str(tmp_path / "no")]) == 1 and "output.sed: unknown key" in capsys.readouterr().err


def test_files_that_hold_no_states_and_places_of_no_folder_are_told(file, tmp_path, capsys):
    (tmp_path / "bytes").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "nested").write_text('{"t_s": ' + 9000 * "[" + "\n")
    (tmp_path / "states").write_text(json.dumps(STATES[0].to_dict()))
    for name, message in (("bytes", "is no UTF-8 text"), ("none", "No such file"), ("nested", "line 1: is not JSON"),
                          ("states", "out: must be a folder, or not be there yet")):
        for command in ("sequence", "dataset"):
            assert main([command, str(file), "--states", str(tmp_path / name), "--out", str(tmp_path / "bytes"),
                         "--processes", "1"]) == 1
            told = capsys.readouterr().err
            assert message in told and told.count("\n") == 1


def test_quaternions_of_labels_are_the_states(whole):
    body = read_frame(whole, 3).labels["labels"]["bodies"]["body"]
    expected = frames.dcm(STATES[3].spacecraft.q_from_inertial)
    np.testing.assert_allclose(frames.dcm(np.array(body["q_camera_from_body"])), expected, atol=1e-12)
