"""Frames of a sequence with their poses: against the states, the renderer's own ranges, and closed forms."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from arcs import STEP_DEG, state
from glrender import generate
from glrender_navigation import Camera
from glrender_photogrammetry import Mesh, PosedFrame, posed_frames
from glrender_photogrammetry.frames import angle_rad, seen_in_light


def test_poses_are_those_of_the_states(flown):
    """The body's axes are the inertial ones here; the Sun and the steps between the frames too."""
    frames = posed_frames(flown.folder)
    assert [frame.name for frame in frames] == [f"frame_{k:05d}.npz" for k in range(len(flown.states))]
    for frame, true in zip(frames, flown.states, strict=True):
        np.testing.assert_allclose(frame.r_camera_body_m, true.spacecraft.r_inertial_m, rtol=1e-12)
        sun = true.r_sun_inertial_m / np.linalg.norm(true.r_sun_inertial_m)
        np.testing.assert_allclose(frame.sun_direction_body, sun, atol=1e-12)
        np.testing.assert_allclose(frame.camera.project(frame.to_camera(np.zeros(3))), [127.5, 127.5], atol=1e-6)
    up = np.array([300.0, 3000.0]) / np.hypot(300.0, 3000.0)
    step = np.arccos(up[0] ** 2 + up[1] ** 2 * np.cos(np.radians(STEP_DEG)))
    np.testing.assert_allclose(angle_rad(frames[0], frames[1]), step, rtol=1e-6)


def test_a_body_that_turned_is_seen_from_another_side(flown):
    """A body turned by 30 deg about its pole has the camera at a longitude 30 deg less; FITS tells the same as NPZ."""
    states = [state(0.0, spin_deg=30.0)]
    frame, = posed_frames(flown.drawn(states, "fits"), "body")
    same, = posed_frames(flown.drawn(states))
    lon = np.arctan2(*frame.r_camera_body_m[1::-1])
    np.testing.assert_allclose(np.degrees(lon), -30.0, atol=1e-9)
    np.testing.assert_array_equal(frame.image, same.image)
    np.testing.assert_array_equal(frame.camera_from_body, same.camera_from_body)
    assert (frame.most, frame.offset) == (same.most, same.offset)


def test_depths_of_the_shape_are_the_renderers_ranges(flown):
    """Of another program part: area coverage in float64. Facets at the limb may be a pixel more or less."""
    for index in (0, 5):
        frame = posed_frames(flown.folder)[index]
        with np.load(flown.folder / f"frame_{index:05d}.npz") as stored:
            range_m = stored["range"]
        depth_m, facet = frame.depth(Mesh.of(flown.shape))
        y, x = np.indices(facet.shape)
        along = frame.camera.direction(np.stack([x, y], axis=-1))[..., 2]
        both = (facet >= 0) & np.isfinite(range_m)
        assert both.sum() > 0.99 * np.isfinite(range_m).sum() and both.sum() > 0.99 * (facet >= 0).sum()
        np.testing.assert_allclose(np.median(np.abs(depth_m / along - range_m)[both]), 0.0, atol=0.01)


def one(place_m, sun, size_px=512):
    """A frame from a place, with its boresight on the origin."""
    back = np.asarray(place_m, float) / np.linalg.norm(place_m)
    right = np.cross([0.3, 0.5, 0.8], back)
    right /= np.linalg.norm(right)
    return PosedFrame(name="frame", image=np.zeros((size_px, size_px)), body="body", sun_direction_body=sun,
                      camera=Camera(width_px=size_px, height_px=size_px, focal_length_px=1000.0),
                      camera_from_body=np.array([right, np.cross(right, back), -back]), r_camera_body_m=place_m)


@pytest.mark.parametrize("phase_deg, share", [(0.0, 0.415), (180.0, 0.0)])
def test_what_a_frame_sees_in_light_of_a_sphere(phase_deg, share):
    """A cap of all emission angles below arccos 0.17 at no phase: (1 - 0.17) / 2 of a sphere; nothing against the Sun.

    At 90 deg: the directions that are in both caps, by a sum over even points of another sample."""
    mesh = Mesh.of(generate.icosphere(radius_m=1.0, subdivisions=5))
    points_m, facet = mesh.sample(20_000)
    sun = np.array([np.cos(np.radians(phase_deg)), np.sin(np.radians(phase_deg)), 0.0])
    np.testing.assert_allclose(seen_in_light([one([1e3, 0.0, 0.0], sun)], mesh, points_m, facet).mean(), share,
                               atol=0.01)
    found = seen_in_light(2 * [one([1e3, 0.0, 0.0], np.array([0.0, 1.0, 0.0]))], mesh, points_m, facet)
    up = np.random.default_rng(3).normal(size=(100_000, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    np.testing.assert_allclose((found == 2).mean(), ((up[:, 0] > 0.17) & (up[:, 1] > 0.05)).mean(), atol=0.01)


def test_what_hides_or_shades_is_before_it():
    """A small square above a large one: half of what lies under it is hidden from above, and shade falls beside."""
    def square(half, x, z):
        return np.array([[x - half, -half, z], [x + half, -half, z], [x + half, half, z], [x - half, half, z]])

    mesh = Mesh(vertices_m=np.vstack([square(4.0, 0.0, 0.0), square(1.0, 0.0, 2.0)]),
                facets=[[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    points_m, facet = mesh.sample(40_000)
    ground = facet < 2
    sun = np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0)
    seen = seen_in_light([one([0.0, 0.0, 1000.0], sun)], mesh, points_m, facet)[ground] > 0
    x, y = points_m[ground, 0], points_m[ground, 1]
    hidden, shaded = (np.abs(x) < 1.0) & (np.abs(y) < 1.0), (np.abs(x + 2.0) < 1.0) & (np.abs(y) < 1.0)
    assert (seen == ~(hidden | shaded)).mean() > 0.99 and 0.8 < seen.mean() < 0.95


def test_a_lens_that_distorts_is_undone(flown):
    """A header with a lens moves pixels as that lens did: a point at the edge goes back inwards or outwards."""
    frame = posed_frames(flown.folder)[0]
    with np.load(flown.folder / "frame_00000.npz") as stored:
        header = json.loads(str(stored["header"]))
    image = np.zeros((256, 256), np.uint16)
    # Radial k1: a ray at r lands at r (1 + k1 r^2), r in focal lengths.
    r = 100.0 / 1152.0
    at = 127.5 + 1152.0 * r * (1.0 - 2.0 * r**2)
    image[126:130, int(at) - 1:int(at) + 3] = 1000
    header["camera"]["distortion"] = {"k1": -2.0}
    undone = PosedFrame.from_header("frame", image, header, "body").image
    x = (undone.sum(axis=0) * np.arange(256)).sum() / undone.sum()
    assert abs(x - (227.5 + int(at) + 0.5 - at)) < 0.3 and frame.image.dtype == np.uint16


@pytest.mark.parametrize("change, message", [
    (lambda folder: (folder / "manifest.json").unlink(), "must be a folder of `glrender sequence`"),
    (lambda folder: [path.unlink() for path in folder.glob("*.npz")], "with frames as npz or fits"),
])
def test_a_folder_that_is_no_sequence_is_refused(tmp_path, flown, change, message):
    for path in flown.folder.glob("*"):
        if path.name == "manifest.json" or path.name.endswith("00000.npz"):
            (tmp_path / path.name).write_bytes(path.read_bytes())
    assert len(posed_frames(tmp_path)) == 1
    with pytest.raises(ValueError, match="body: must be one of body, got 'moon'"):
        posed_frames(tmp_path, "moon")
    change(tmp_path)
    with pytest.raises(ValueError, match=message):
        posed_frames(tmp_path)


def rewritten(path, change):
    with np.load(path) as stored:
        image, header = stored["image"], json.loads(str(stored["header"]))
    np.savez(path, image=image, header=json.dumps(change(header)))


@pytest.mark.parametrize("change, message", [
    (lambda path: path.write_bytes(b""), "EOFError"),
    (lambda path: path.write_bytes(path.read_bytes()[:5000]), "BadZipFile"),
    (lambda path: path.write_bytes(b"no frame"), "ValueError"),
    (lambda path: np.savez(path, image=np.zeros((256, 256))), "'KeyError'; 'header"),
    (lambda path: rewritten(path, lambda header: {"bodies": header["bodies"]}), "'KeyError'; 'camera'"),
    (lambda path: rewritten(path, lambda header: header | {"state": {}}), "'ValueError'; state.spacecraft: is missing"),
    (lambda path: rewritten(path, lambda header: header | {"bodies": []}), "IndexError"),
    (lambda path: rewritten(path, lambda header: header | {"camera": header["camera"] | {"mosaic": "rggb"}}),
     "camera.mosaic: must be none, got 'rggb'; draw the sequence by one band"),
])
def test_a_broken_frame_is_refused_by_its_name(tmp_path, flown, change, message):
    for name in ("manifest.json", "frame_00000.npz"):
        (tmp_path / name).write_bytes((flown.folder / name).read_bytes())
    change(tmp_path / "frame_00000.npz")
    with pytest.raises(ValueError, match=rf"frame_00000.npz: must be a frame of a sequence, got .*{message}"):
        posed_frames(tmp_path)


def test_other_bodies_in_view_are_named(flown):
    """A moon 500 m (190 px) to the side of 256 px is out, one 300 m (115 px) away is in."""
    with np.load(flown.folder / "frame_00000.npz") as stored:
        image, header = stored["image"], json.loads(str(stored["header"]))
    own = header["state"]["bodies"]["body"]
    header["state"]["bodies"] |= {f"moon_{y}": own | {"r_inertial_m": [0.0, y, 0.0]} for y in (300.0, 500.0)}
    frame = PosedFrame.from_header("frame", image, header, "body")
    assert frame.others == ("moon_300.0",) and frame.exposure_s == header["exposure_s"] == 5e-5
    assert PosedFrame.from_header("frame", image, header | {"exposure_s": None}, "body").exposure_s == 1.0


def test_a_frame_checks_its_pose_and_size(flown):
    frame = posed_frames(flown.folder)[0]
    with pytest.raises(ValueError, match="r_camera_body_m: must be finite numbers.*give the pose"):
        replace(frame, r_camera_body_m=[np.nan, 0.0, 0.0])
    with pytest.raises(ValueError, match="place_sigma_m: must be > 0 and finite, got 0.0; give metres"):
        replace(frame, place_sigma_m=0.0)
    with pytest.raises(ValueError, match=r"image: must be finite numbers of shape \(256, 256\)"):
        replace(frame, image=frame.image[:-1])
