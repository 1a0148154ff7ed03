"""A surface from frames that were drawn of a known one: points, depths, fusion, the whole, and what is refused."""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from arcs import state
from glrender import generate
from glrender_cli.__main__ import main
from glrender_navigation import Camera
from glrender_photogrammetry import Mesh, PosedFrame, deviation, mapping, posed_frames, reconstruct
from glrender_photogrammetry.features import shared_points
from glrender_photogrammetry.fusion import fused, surface_of
from glrender_photogrammetry.mapping import adjusted, laid, mapped, reposed
from glrender_photogrammetry.mesh import Closest
from glrender_photogrammetry.sparse import sparse_points
from glrender_photogrammetry.sweep import PASSES, depth_map
from missing import needed_module
from scipy.spatial.transform import Rotation


@pytest.fixture(scope="module")
def frames(flown):
    needed_module("pycolmap", "pip install 'glrender[reconstruction]'")
    return posed_frames(flown.folder)


@pytest.fixture(scope="module")
def truth(flown):
    return Mesh.of(flown.shape)


@pytest.fixture(scope="module")
def made(frames, tmp_path_factory):
    """The result of the first sweep alone, its folder, and the calls of its progress."""
    folder, calls = tmp_path_factory.mktemp("made"), []
    found = reconstruct(frames, body="body", folder=folder, n_sweeps=1,
                        progress=lambda stage, done: calls.append((stage, done)))
    return found, folder, calls


def turned(frame, angle_rad):
    """The frame with another attitude."""
    return replace(frame, camera_from_body=Rotation.from_rotvec(angle_rad).as_matrix() @ frame.camera_from_body)


def test_sparse_points_lie_on_the_surface(frames, truth, monkeypatch):
    """Within a pixel in the median and three at the 95th percentile; each by three frames or more, not two."""
    models = []
    monkeypatch.setattr("glrender_photogrammetry.sparse.shared_points",
                        lambda model: models.append(model) or shared_points(model))
    found = sparse_points(frames)["points_m"]
    n_frames = {tuple(point.xyz): len({part.image_id for part in point.track.elements})
                for point in models[0].points3D.values()}
    assert min(n_frames.values()) == 2 and min(n_frames[tuple(place)] for place in found) == 3
    away_px = np.abs(Closest(truth)(found)[0]) / frames[0].px_m
    assert len(found) > 500
    assert np.median(away_px) < 1.0 and np.quantile(away_px, 0.95) < 3.0


def test_poses_that_contradict_the_matches_are_refused(frames):
    """Attitudes that are wrong by 0.3 deg (6 px) in all directions; the message tells the pixels."""
    rng = np.random.default_rng(1)
    wrong = [turned(frame, np.radians(0.3) * rng.normal(size=3)) for frame in frames]
    with pytest.raises(ValueError, match=r"must have poses that the matches agree with.*px in the median.*free"):
        sparse_points(wrong)


def test_a_sweep_finds_the_depth_about_a_surface_that_is_too_low(frames, truth):
    """The true shape 6 px lower as the prior: three quarters of the pixels are found, right to 0.5 px in the median."""
    px_m = frames[4].px_m
    low = Mesh(vertices_m=truth.vertices_m * (1.0 - 6.0 * px_m / 280.0), facets=truth.facets)
    found_m = depth_map(frames, 4, low, PASSES[0], px_m)
    true_m, facet = frames[4].depth(truth)
    kept = (found_m > 0.0) & (facet >= 0)
    start_m, _ = frames[4].depth(low)
    gap_px = (found_m - true_m)[kept] / px_m
    assert kept.sum() > 0.6 * ((facet >= 0) & (frames[4].root > 0.2)).sum()
    assert np.median(np.abs(gap_px)) < 0.6 and np.quantile(np.abs(gap_px), 0.9) < 2.5
    assert np.median(np.abs(start_m - true_m)[kept]) / px_m > 5.0
    assert depth_map(frames[:1] * 3, 0, truth, PASSES[0], px_m) is None, "no neighbour 8 to 24 deg away"


def test_depths_that_agree_are_averaged_and_others_dropped(frames, truth):
    """Depths of the truth, one frame's wrong by more than the tolerance: its points are gone, the rest lie on it."""
    depths = {}
    for index in range(6):
        depth_m, facet = frames[index].depth(truth)
        depths[index] = np.where(facet >= 0, depth_m, 0.0).astype(np.float32)
    right, _ = fused(frames, depths, 3.0)
    assert np.quantile(np.abs(Closest(truth)(right[::20])[0]), 0.95) < 1.0
    depths[2] = np.where(depths[2] > 0.0, depths[2] + 40.0, 0.0).astype(np.float32)
    points_m, cameras_m = fused(frames, depths, 3.0)
    assert (np.linalg.norm(cameras_m - frames[2].r_camera_body_m, axis=1) < 1.0).mean() < 0.02
    assert np.quantile(np.abs(Closest(truth)(points_m[::20])[0]), 0.95) < 1.0


def test_the_surface_of_points_is_cut_where_there_are_none(frames):
    """Points of a half sphere: its surface within a tenth of their distance, and no cap over the open side."""
    sphere = generate.icosphere(radius_m=100.0, subdivisions=6)
    half = sphere.vertices_m[sphere.vertices_m[:, 2] > 0.0]
    found = surface_of(half, 10.0 * half, voxel_m=3.0, cut_m=6.0)
    radius_m = np.linalg.norm(found.vertices_m, axis=1)
    assert np.quantile(np.abs(radius_m - 100.0), 0.99) < 0.5 and found.vertices_m[:, 2].min() > -8.0
    up = (found.facet_normals * found.corners_m.mean(axis=1)).sum(axis=1)
    assert (up > 0.0).mean() > 0.999, "outward"


def test_one_sweep_is_right_to_a_pixel_or_two(made, truth, frames):
    found, _, calls = made
    told = deviation(found.shape, truth, px_m=found.report["px_m"], frames=frames)
    assert abs(told.mean_m) < 0.4 * frames[0].px_m and told.sigma_m < 1.2 * frames[0].px_m
    assert told.max_m < 15.0 * frames[0].px_m and told.complete_2px > 0.6
    assert found.report["frames"] == len(found.frames) == 10 and found.report["points"] == len(found.points) > 500
    assert found.report["left_out"] == {} and found.report["warnings"] == []
    assert set(found.report["cpu_s"]) == {"sparse", "surface", "sweep_1"}
    assert [stage for stage, done in calls if done == 1.0] == ["sparse", "sweep_1"]
    assert all(a <= b for (_, a), (_, b) in zip(calls, calls[1:], strict=False) if b > 0.1)


def test_a_sigma_that_is_not_used_changes_no_folder(made, frames):
    given = [replace(frame, place_sigma_m=2.0) for frame in frames]
    again = reconstruct(given, folder=made[1], n_sweeps=1)
    np.testing.assert_array_equal(again.shape.vertices_m, made[0].shape.vertices_m)


@pytest.mark.parametrize("poses", [[], ["--poses", "free"]])
def test_a_sigma_of_places_without_a_prior_is_refused(poses, tmp_path, capsys):
    """Before the frames are read."""
    out = tmp_path / "made"
    assert main(["reconstruct", str(tmp_path / "none"), "--out", str(out), "--place-sigma-m", "20", *poses]) == 1
    assert "--place-sigma-m: must be left out without --poses prior, got 20.0; add --poses prior" in (
        capsys.readouterr().err) and not out.exists()


def test_stages_are_kept_and_taken_up(made, frames, tmp_path):
    """The same call reads what is there, with the seconds that it took; a stage that is gone is made as it was."""
    found, folder, _ = made
    assert {path.name for path in folder.iterdir()} == {"made_of.json", "sparse.npz", "surface.npz", "sweep_1.npz"}
    before = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    again = reconstruct(frames, folder=folder, n_sweeps=1)
    np.testing.assert_array_equal(again.shape.vertices_m, found.shape.vertices_m)
    assert before == {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert again.report["cpu_s"] == found.report["cpu_s"] and found.report["cpu_s"]["sparse"] > 0.2
    own = shutil.copytree(folder, tmp_path / "own")
    (own / "sweep_1.npz").unlink()
    again = reconstruct(frames, folder=own, n_sweeps=1)
    np.testing.assert_array_equal(again.shape.vertices_m, found.shape.vertices_m)
    np.testing.assert_array_equal(again.shape.facets, found.shape.facets)
    assert (own / "sparse.npz").stat().st_mtime_ns == before["sparse.npz"]


@pytest.mark.parametrize("change", [
    {"frames": lambda f: f[:-1]}, {"poses": "free"}, {"poses": "prior", "frames": lambda f: [
        replace(x, place_sigma_m=1.0) for x in f]}, {"n_sweeps": 2},
    {"prior": Mesh.of(generate.icosphere(radius_m=280.0))},
    *({"frames": lambda f, made=made: [made(f[0]), *f[1:]]} for made in (
        lambda f: replace(f, image=f.image + np.pad([[1]], ((9, 246), (7, 248)))),
        lambda f: replace(f, name="other"), lambda f: replace(f, offset=f.offset + 1e-6),
        lambda f: replace(f, r_camera_body_m=f.r_camera_body_m + [1e-6, 0.0, 0.0]), lambda f: turned(f, [1e-9, 0, 0]))),
    {"frames": lambda f: [replace(x, camera=replace(x.camera, focal_length_px=1152.1)) for x in f]},
])
def test_a_folder_of_anything_else_is_refused(made, frames, change):
    options = {"folder": made[1], "n_sweeps": 1} | change
    with pytest.raises(ValueError, match="must be empty, or made of the same frames and settings.*'made_of.json'"):
        reconstruct(options.pop("frames", lambda f: f)(frames), **options)


def test_a_folder_of_another_version_or_of_ones_own_files_is_refused(made, frames, tmp_path, monkeypatch):
    (tmp_path / "surface.npz").write_bytes((made[1] / "surface.npz").read_bytes())
    with pytest.raises(ValueError, match="must be empty, or made of the same.*, got 'surface.npz'"):
        reconstruct(frames, folder=tmp_path, n_sweeps=1)
    (tmp_path / "surface.npz").unlink()
    (tmp_path / ".hidden").touch()
    for place, name in (("pycolmap", "__version__"), ("glrender_photogrammetry.reconstruction", "version")):
        with monkeypatch.context() as other:
            other.setattr(f"{place}.{name}", "0.1" if name == "__version__" else lambda package: "0.2")
            with pytest.raises(ValueError, match="by this version, got 'made_of.json'"):
                reconstruct(frames, folder=made[1], n_sweeps=1)


def test_a_moon_in_view_is_reported(frames):
    given = [replace(frame, others=("moon",)) for frame in frames[:4]] + frames[4:]
    assert reconstruct(given, n_sweeps=0).report["warnings"] == [
        "moon is in view of 4 frames: the surface may have pieces of it"]


@pytest.mark.parametrize("n", [0, 1, 5, 99, 200])
def test_too_few_points_make_no_surface(n):
    """The last ones are enough, but all in one voxel."""
    points_m = np.random.default_rng(n).normal(size=(n, 3))
    with pytest.raises(ValueError, match="frames: must agree in threes on .* points of the surface or more, got"):
        surface_of(points_m, 100.0 * points_m, voxel_m=20.0, cut_m=30.0)


def test_too_few_points_of_free_poses_are_refused(frames, truth, monkeypatch):
    """With a prior too, which needs no surface of theirs."""
    few = {"index": np.arange(10), "camera_from_body": np.array([frame.camera_from_body for frame in frames]),
           "r_camera_body_m": np.array([frame.r_camera_body_m for frame in frames]), "points_m": np.zeros((0, 3)),
           "turn_rad": np.array(0.01), "place_m": np.array(2.0)}
    monkeypatch.setattr("glrender_photogrammetry.reconstruction.mapped", lambda frames, is_prior: few)
    for prior in (None, truth):
        with pytest.raises(ValueError, match="frames: must agree in threes on 100 points"):
            reconstruct(frames, poses="free", prior=prior)


@pytest.mark.parametrize("given, message", [
    (lambda f: [replace(x, r_camera_body_m=-x.r_camera_body_m) for x in f], "at a scale above 0, got '0.0 deg, .* -1'"),
    (lambda f: [replace(x, r_camera_body_m=f[0].r_camera_body_m) for x in f], "at a scale above 0"),
    (lambda f: [replace(x, r_camera_body_m=y.r_camera_body_m) for x, y in zip(f, f[::3] + f[1::3] + f[2::3],
                                                                             strict=True)], "half of their spread"),
    (lambda f: [turned(x, np.radians(25.0) * np.eye(3)[k % 3]) for k, x in enumerate(f)], "attitudes within 10 deg"),
])
def test_given_poses_that_are_no_datum_are_refused(frames, given, message):
    """Found ones in units of the range; the right ones are laid back with no residual."""
    rotations, places = (np.array([getattr(frame, name) for frame in frames]) for name in (
        "camera_from_body", "r_camera_body_m"))
    found = laid(frames, rotations, places / 3000.0, np.eye(3))
    np.testing.assert_allclose(found["points_m"], 3000.0 * np.eye(3), atol=1e-6)
    assert found["turn_rad"] < 1e-7 and found["place_m"] < 1e-6
    found = laid([turned(x, np.radians(2.0 * (-1) ** k) * np.eye(3)[0]) for k, x in enumerate(frames)], rotations,
                 places, np.eye(3))
    np.testing.assert_allclose(np.degrees(found["turn_rad"]), 2.0, rtol=0.2)
    with pytest.raises(ValueError, match=message):
        laid(given(frames), rotations, places, np.eye(3))


def test_free_poses_are_found_from_features(frames, truth, capfd):
    """Given poses that are off in turn, scale and shift as a whole are found as they are, but for just these.

    Within 0.2 % of the range (3 px) and 0.3 deg: a turn of a narrow field is a shift; points are off by that turn."""
    turn, scale, shift_m = Rotation.from_rotvec([0.2, -0.1, 0.3]).as_matrix(), 1.1, np.array([50.0, -20.0, 30.0])
    off = [replace(frame, camera_from_body=frame.camera_from_body @ turn.T,
                   r_camera_body_m=scale * turn @ frame.r_camera_body_m + shift_m) for frame in frames]
    found = mapped(off)
    assert found["index"].tolist() == list(range(len(frames))) and len(found["points_m"]) > 500
    assert capfd.readouterr().err == "", "COLMAP's log"
    for frame, own in zip(reposed(off, found), off, strict=True):
        assert np.linalg.norm(frame.r_camera_body_m - own.r_camera_body_m) < 0.002 * 3000.0 * scale
        angle = Rotation.from_matrix(frame.camera_from_body @ own.camera_from_body.T).magnitude()
        assert np.degrees(angle) < 0.3
    back_m = (found["points_m"] - shift_m) @ turn / scale
    assert np.median(np.abs(Closest(truth)(back_m)[0])) < 6.0 * frames[0].px_m


def test_places_and_attitudes_that_are_a_prior_hold_the_found_ones(frames, truth):
    """Places known to 1 m, of poses that features leave 2 m off: a tenth of that, and a fifth of the points' error.

    Points are off by a turn of all cameras, which in a narrow field is a shift of them: 0.2 deg, 12 m, here.
    """
    given = [replace(frame, place_sigma_m=1.0) for frame in frames]
    away_m, error_m = {}, {}
    for is_prior in (False, True):
        found = mapped(given, is_prior)
        away_m[is_prior] = np.median([np.linalg.norm(a.r_camera_body_m - b.r_camera_body_m) for a, b in zip(
            reposed(given, found), frames, strict=True)])
        error_m[is_prior] = np.median(np.abs(Closest(truth)(found["points_m"])[0]))
    assert away_m[True] < 0.1 * away_m[False] and error_m[True] < 0.2 * error_m[False]


def line(turned_rad=0.0):
    """Nine views 3 km off a ball of points on its way along a straight line: true frames, given ones, points and what
    is seen (pixels to 0.3 px)."""
    rng, camera = np.random.default_rng(1), Camera(width_px=512, height_px=512, focal_length_px=2000.0)
    points_m = rng.normal(size=(300, 3))
    points_m *= 200.0 / np.linalg.norm(points_m, axis=1, keepdims=True)
    true, given, seen = [], [], []
    for k, x in enumerate(np.linspace(-1500.0, 1500.0, 9)):
        place_m = np.array([x, -3000.0, 0.0])
        ahead = -place_m / np.linalg.norm(place_m)
        right = np.array([ahead[1], -ahead[0], 0.0])
        true.append(PosedFrame(name=str(k), image=np.zeros((512, 512)), camera=camera, body="ball",
                               camera_from_body=np.array([right, np.cross(ahead, right), ahead]),
                               r_camera_body_m=place_m, sun_direction_body=np.eye(3)[0], place_sigma_m=1.0))
        given.append(replace(turned(true[-1], turned_rad * rng.normal(size=3)),
                             r_camera_body_m=place_m + rng.normal(size=3)))
        visible = np.flatnonzero(points_m @ -ahead > 40.0)
        at_px = camera.project(true[-1].to_camera(points_m[visible])) + 0.3 * rng.normal(size=(len(visible), 2))
        seen.append(np.column_stack([np.full(len(visible), k), visible, at_px]))
    seen = np.vstack(seen)
    often = np.flatnonzero(np.bincount(seen[:, 1].astype(int), minlength=300) >= 3)
    seen = seen[np.isin(seen[:, 1], often)]
    seen[:, 1] = np.searchsorted(often, seen[:, 1])
    return true, given, points_m[often], seen


@pytest.mark.parametrize("turned_deg, bounds", [(0.0, (2.0, 1.0, 0.05)), (0.1, (10.0, 1.0, 0.15))])
def test_a_straight_line_holds_by_attitudes(turned_deg, bounds, monkeypatch, caplog):
    """Points, places [m] and attitudes [deg] from 20 m, 5 m and 0.3 deg off; places are given to 1 m.

    A pixel is 1.5 m, which attitudes hold the points to. Errors of theirs of 0.1 deg are 5 m of each frame.
    """
    true, given, points_m, seen = line(np.radians(turned_deg))
    rng = np.random.default_rng(5)
    start = {"camera_from_body": np.array([turned(frame, np.radians(0.3) * (
        [1.0, 0.5, 0.2] + 0.1 * rng.normal(size=3))).camera_from_body for frame in true]),
        "r_camera_body_m": np.array([frame.r_camera_body_m + 5.0 * rng.normal(size=3) for frame in true]),
        "points_m": points_m + [0.0, 0.0, 15.0] + 10.0 * rng.normal(size=points_m.shape)}
    monkeypatch.setattr(mapping, "_MOST_STEPS", 1)
    adjusted(given, start, seen)
    assert "still turn by" in caplog.text
    monkeypatch.undo()
    caplog.clear()
    found = adjusted(given, start, seen)
    assert not caplog.text
    off_m = np.sqrt(np.mean((found["r_camera_body_m"] - [frame.r_camera_body_m for frame in true])**2))
    turn = Rotation.from_matrix(found["camera_from_body"] @ [frame.camera_from_body.T for frame in true])
    off = np.median(np.linalg.norm(found["points_m"] - points_m, axis=1)), off_m, np.degrees(turn.magnitude().max())
    assert (np.array(off) < bounds).all(), off
    np.testing.assert_allclose(np.degrees(found["turn_rad"]), 3.0**0.5 * turned_deg, rtol=0.3, atol=0.05)


@pytest.mark.slow
def test_poses_that_are_off_one_by_one_are_mended_by_free_ones(frames, truth):
    """Attitudes wrong by 0.3 deg each: refused as known, reconstructed as free, right to a pixel after alignment."""
    rng = np.random.default_rng(1)
    wrong = [turned(frame, np.radians(0.3) * rng.normal(size=3)) for frame in frames]
    found = reconstruct(wrong, poses="free")
    told = deviation(found.shape, truth, px_m=found.report["px_m"], align="similarity")
    assert told.sigma_m < frames[0].px_m and abs(told.mean_m) < 0.3 * frames[0].px_m
    assert found.report["frames"] == 10 and found.report["left_out"] == {}
    assert 0.2 < found.report["datum"]["turn_deg"] < 1.0 and found.report["datum"]["place_m"] < 20.0


@pytest.mark.slow
def test_the_whole_reaches_the_bounds_of_the_issue(frames, truth, flown, tmp_path, capsys, monkeypatch):
    """By the command, both sweeps: mean 0.3 px, sigma 1 px, max 15 px after alignment."""
    monkeypatch.chdir(tmp_path)
    assert main(["reconstruct", str(flown.folder), "--out", "made", "--texture", "--map"]) == 0
    assert "m a pixel" in capsys.readouterr().out and (tmp_path / "made" / "report.json").is_file()
    mapped_m = Mesh.from_file("made/shape.obj").corners_m
    np.testing.assert_allclose(mapped_m, Mesh.from_file("made/shape.ply").corners_m, atol=1e-3)
    np.testing.assert_allclose(mapped_m, Mesh.from_file("made/shape.glb").corners_m, atol=1e-3)
    px_m = frames[0].px_m
    found = deviation(Mesh.from_file("made/shape.ply"), truth, px_m=px_m, align="similarity", frames=frames)
    assert abs(found.mean_m) <= 0.3 * px_m and found.sigma_m <= px_m and found.max_m <= 15.0 * px_m
    assert found.complete_2px > 0.7


def dark(frame):
    return replace(frame, image=np.full_like(frame.image, frame.offset))


def saturated(frame):
    return replace(frame, image=np.where(frame.image > frame.offset + 20, 4095, frame.image))


def test_frames_that_show_nothing_are_left_out_and_told(made, frames):
    """By a look at the frames alone: the stages are those of the eight others."""
    given = [dark(frames[0]), *frames[1:-1], saturated(frames[-1])]
    found = reconstruct(given, n_sweeps=0, folder=None)
    assert found.report["left_out"][frames[0].name] == "dark: 0 pixels are lit"
    assert found.report["left_out"][frames[-1].name].startswith("saturated: 9")
    assert found.report["frames"] == 8


def test_wide_steps_are_told(frames):
    found = reconstruct([*frames[:5], *frames[8:]], n_sweeps=0)
    assert len(found.report["warnings"]) == 1 and "frame_00004.npz to frame_00008.npz: 27.9 deg" in found.report[
        "warnings"][0]


@pytest.mark.parametrize("change, options, message", [
    (lambda f: f[:2], {}, "frames: must be three or more, got 2"),
    (lambda f: f[::9] * 2, {}, "frames: must have neighbours 0.5 to 16 deg apart about the body, got '62.7 deg"),
    (lambda f: f[::3], {}, "frames: must have neighbours 0.5 to 16 deg apart about the body, got '20.9 deg"),
    (lambda f: [dark(x) for x in f], {}, "must be neither dark nor saturated.*dark: 0 pixels"),
    (lambda f: [saturated(x) for x in f], {}, "must be neither dark nor saturated.*saturated: 98 %"),
    (lambda f: [*f[:3], replace(f[3], body="moon")], {}, r"frames\[3\].body: must be 'body', got 'moon'"),
    (lambda f: f, {"body": "moon"}, r"frames\[0\].body: must be 'moon', got 'body'; posed_frames"),
    (lambda f: [*f[:3], replace(f[3], camera=Camera(width_px=256, height_px=256, focal_length_px=1000.0))], {},
     r"frames\[3\].camera: must be the first frame's"),
    (lambda f: f, {"n_sweeps": 3}, "n_sweeps: must be an integer from 0 to 2, got 3"),
    (lambda f: f, {"n_sweeps": 0.5}, "n_sweeps: must be an integer from 0 to 2, got 0.5"),
    (lambda f: f, {"poses": "guessed"}, "poses: must be one of known, prior, free, got 'guessed'"),
    (lambda f: [replace(f[0], place_sigma_m=3.0), *f[1:]], {"poses": "prior"},
     r"frames\[1\].place_sigma_m: must be given where poses are a prior, got None; replace\(frame, place"),
])
def test_bad_input_is_refused_with_field_rule_and_value(frames, change, options, message):
    with pytest.raises(ValueError, match=message):
        reconstruct(change(frames), **options)


@pytest.mark.parametrize("prior", [
    lambda m: Mesh(vertices_m=1e-3 * m.vertices_m, facets=m.facets),
    lambda m: Mesh(vertices_m=m.vertices_m + [0.0, 0.0, 300.0], facets=m.facets)])
def test_a_prior_of_another_size_or_place_is_refused(frames, truth, prior, tmp_path):
    """What was found before stays."""
    with pytest.raises(ValueError, match="prior: must lie within .* of half of the sparse points.*in metres"):
        reconstruct(frames, prior=prior(truth), n_sweeps=1, folder=tmp_path)
    assert (tmp_path / "sparse.npz").is_file()


def test_without_pycolmap_the_extra_is_named(tmp_path):
    code = ("import sys; sys.modules['pycolmap'] = None\n"
            "from glrender_photogrammetry import reconstruct\n"
            "try: reconstruct([])\nexcept ValueError as error: print(error)")
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert "needs pycolmap" in run.stdout and "pip install 'glrender[reconstruction]'" in run.stdout, run.stderr


def test_the_command_refuses_in_one_line(tmp_path, flown, capsys):
    for arguments, message in (([str(tmp_path)], "must be a folder of `glrender sequence`"),
                               ([str(flown.folder), "--body", "moon"], "body: must be one of body, got 'moon'"),
                               ([str(flown.drawn([state(0.0), state(5.0)]))], "frames: must be three or more, got 2")):
        assert main(["reconstruct", *arguments, "--out", str(tmp_path / "out")]) == 1
        told = capsys.readouterr().err
        assert message in told.splitlines()[-1] and "Traceback" not in told
    file = tmp_path / "a.txt"
    file.write_text("")
    for arguments in (["reconstruct", str(flown.folder)], ["demo"]):
        assert main([*arguments, "--out", str(file)]) == 1
        assert "out: must be a folder, or not be there yet" in capsys.readouterr().err
