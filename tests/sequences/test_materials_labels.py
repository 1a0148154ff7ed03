"""Data sets of a body of several materials: one label, mask and outline. Truth: float64 rays of this test."""

from __future__ import annotations

import json

import numpy as np
import pytest
from glb_parts import glb, material, sheet
from glrender import ConfigError, Pose, Scene, State, frames
from glrender.base.constants import AU_M
from glrender.sequences.dataset.dataset import DataSet
from glrender.sequences.dataset.read import read_frame
from glrender.sequences.options import FrameOptions
from glrender.sequences.sequence import FrameSequence
from missing import needed_module
from PIL import Image
from scipy.spatial.transform import Rotation
from solids import box

SIZE, FOCAL_PX, R_CAMERA = (90, 70), 300.0, np.array([8.0, -9.0, 7.0])
DETECTOR = {"quantum_efficiency": 0.5, "full_well_electrons": 3e6, "gain_DN_per_electron": 0.002, "bit_depth": 12,
            "offset_DN": 20.0, "read_noise_electrons": 50.0}


def scene_of(folder):
    """A bus of paint, of which the lid is gold, and a panel: cells before, paint behind."""
    places, facets = box((-0.5,) * 3, (0.5,) * 3)
    is_lid = (places[facets][..., 2] > 0.4).all(axis=1)
    node = {"translation": [1.5, 0.0, 0.0], "scale": [1.6, 1.0, 1.0]}
    glb(folder / "sat.glb", [(places, facets[~is_lid], 0, None, None), (places, facets[is_lid], 1, None, None),
                             sheet(2, node), sheet(0, node, turned=True)],
        [material("paint", 0.8), material("gold", 0.9, metal=1.0, rough=0.5), material("cells", 0.05)])
    model = {"exposure_s": 1e-4, "optics": {"aperture_diameter_m": 0.01, "psf_sigma_px": 0.7}, "detector": DETECTOR}
    return Scene.from_dict({"bodies": [{"name": "sat", "shape": "sat.glb", "length_unit": "m"}], "cameras": [{
        "name": "c", "width_px": SIZE[0], "height_px": SIZE[1], "focal_length_px": FOCAL_PX, "model": model}]},
        shape_dir=folder)


STATE = State(r_sun_inertial_m=AU_M * np.array([0.5, -0.3, 0.8]), bodies={"sat": Pose(r_inertial_m=np.zeros(3))},
              spacecraft=Pose(r_inertial_m=R_CAMERA, q_from_inertial=frames.look_at(R_CAMERA, np.array([0.7, 0, 0]))))


def is_met(corners):
    """Pixels (H, W) whose middle sees a triangle (F, 3, 3) from its front or its back."""
    y, x = np.indices(SIZE[::-1])
    ray = np.stack([x - 0.5 * (SIZE[0] - 1), y - 0.5 * (SIZE[1] - 1), np.full(x.shape, FOCAL_PX)], axis=-1)
    ray = ray @ frames.dcm(STATE.spacecraft.q_from_inertial)
    a, b, c = (corner - R_CAMERA for corner in np.moveaxis(corners, 1, 0))
    side = np.stack([ray @ np.cross(one, other).T for one, other in ((a, b), (b, c), (c, a))])
    return ((side > 0.0).all(axis=0) | (side < 0.0).all(axis=0)).any(axis=-1)


@pytest.mark.parametrize("format", ["webdataset", "coco", "bop"])
def test_a_body_of_materials_has_one_mask(tmp_path, format):
    """But for two pixels, whose middle is on an edge to float32; the box is exact."""
    scene = scene_of(tmp_path)
    made = DataSet(scene=scene, states=[STATE], folder=tmp_path / "out", frames_a_shard=1, format=format,
                   options=FrameOptions(camera="c", output="dn", format="npz", seed=7))
    list(made.draw(1))
    shape = scene.bodies[0].shape
    truth = is_met(shape.vertices_m[shape.facets])
    y, x = np.nonzero(truth)
    low, size = (x.min(), y.min()), (np.ptp(x) + 1, np.ptp(y) + 1)
    out = tmp_path / "out"
    if format == "webdataset":
        frame = read_frame(out, 0)
        mask, label = frame.mask, frame.labels["labels"]["bodies"]
        assert list(label) == ["sat"] and label["sat"]["box_px"] == [*low, *np.add(low, size)]
    elif format == "coco":
        needed_module("pycocotools", "pip install pycocotools")
        from pycocotools.coco import COCO

        coco = COCO(out / "annotations.json")
        annotation, = coco.loadAnns(coco.getAnnIds())
        assert [each["name"] for each in coco.loadCats(coco.getCatIds())] == ["sat"]
        assert annotation["bbox"] == [*low, *size]
        mask = coco.annToMask(annotation)
    else:
        part = out / "train" / "000000"
        pose, = json.loads((part / "scene_gt_info.json").read_text())["0"]
        assert pose["bbox_obj"] == pose["bbox_visib"] == [*low, *size] and pose["visib_fract"] == 1.0
        paths = sorted(part.glob("mask*/*.png"))
        assert len(paths) == 2
        mask, whole = (np.asarray(Image.open(path)) for path in paths)
        np.testing.assert_array_equal(mask, whole)
    assert set(np.unique(mask)) <= {0, 1, 255} and len(np.unique(mask)) == 2
    assert np.count_nonzero((mask > 0) != truth) <= 2


def nearest(corners):
    """The triangle (H, W) before each pixel's middle, of those that face it, -1 on the sky; the point there."""
    y, x = np.indices(SIZE[::-1])
    ray = np.stack([x - 0.5 * (SIZE[0] - 1), y - 0.5 * (SIZE[1] - 1), np.full(x.shape, FOCAL_PX)], axis=-1)
    ray = ray @ frames.dcm(STATE.spacecraft.q_from_inertial)
    a, b, c = (corner - R_CAMERA for corner in np.moveaxis(corners, 1, 0))
    normal = np.cross(b - a, c - a)
    side = np.stack([ray @ np.cross(one, other).T for one, other in ((a, b), (b, c), (c, a))])
    far = (normal * a).sum(axis=1) / (ray @ normal.T)
    far[~(side < 0.0).all(axis=0)] = np.inf
    found = far.argmin(axis=-1)
    is_met = np.isfinite(far.min(axis=-1))
    return np.where(is_met, found, -1), R_CAMERA + np.where(is_met, far.min(axis=-1), np.nan)[..., None] * ray


@pytest.mark.parametrize("format", ["npz", "fits", "exr"])
def test_frames_have_normals_tilts_parts_and_flow(tmp_path, format):
    """By rays through facets; the flow by the turned body and the moved camera, to 1e-3 px but for pixels on edges."""
    scene = scene_of(tmp_path)
    shape, turn, r = scene.bodies[0].shape, Rotation.from_rotvec([0.02, -0.01, 0.03]), R_CAMERA + [0.05, 0.02, -0.04]
    later = State(r_sun_inertial_m=STATE.r_sun_inertial_m, bodies={"sat": Pose(
        r_inertial_m=[0.01, 0.0, 0.02], q_from_inertial=turn.inv().as_quat(scalar_first=True))},
        spacecraft=Pose(r_inertial_m=r, q_from_inertial=STATE.spacecraft.q_from_inertial))
    sequence = FrameSequence(scene=scene, states=[STATE, later], folder=tmp_path / "out", options=FrameOptions(
        camera="c", format=format, products=("flow", "normal", "tilt", "part_id")))
    assert list(sequence.draw(1)) == [0, 1]
    first, last = (products_of(sequence.path(index)) for index in (0, 1))
    facet, place = nearest(shape.vertices_m[shape.facets])
    seen, to_camera = (facet >= 0) & (first["part_id"] >= 0), frames.dcm(STATE.spacecraft.q_from_inertial)
    assert seen.sum() > 1000 and ((facet >= 0) != (first["part_id"] >= 0)).sum() <= 8
    a, b, c = np.moveaxis(shape.vertices_m[shape.facets[facet[seen]]], 1, 0)
    normal = np.cross(b - a, c - a) / np.linalg.norm(np.cross(b - a, c - a), axis=1)[:, None]
    x, y, z = (to_camera @ (turn.apply(place[seen]) + [0.01, 0.0, 0.02] - r).T)
    then = np.stack([FOCAL_PX * x / z + 0.5 * (SIZE[0] - 1), FOCAL_PX * y / z + 0.5 * (SIZE[1] - 1)], axis=1)
    same = np.abs(first["normal"][seen] - normal @ to_camera.T).max(axis=1) < 1e-6
    assert (~same).sum() <= 8 and len(np.unique(first["part_id"][seen])) == 3
    np.testing.assert_allclose(first["flow"][seen][same], (then - np.argwhere(seen)[:, ::-1])[same], atol=1e-3)
    cosine = (normal * place[seen]).sum(axis=1) / np.linalg.norm(place[seen], axis=1)
    np.testing.assert_allclose(np.cos(first["tilt"][seen][same]), cosine[same], atol=1e-6)
    np.testing.assert_array_equal(first["part_id"][seen][same], shape.material[facet[seen]][same])
    assert np.isnan(last["flow"]).all() and np.isnan(first["normal"][first["part_id"] < 0]).all()


def products_of(path):
    """Arrays of a frame's file, rows from the top."""
    if path.suffix == ".npz":
        return dict(np.load(path))
    if path.suffix == ".exr":
        channels = {name: channel.pixels for name, channel in needed_module(
            "OpenEXR", "pip install -e '.[test]'").File(str(path), separate_channels=True).channels().items()}
        return {"tilt": channels["tilt"], "part_id": channels["part_id"].astype(np.int32), **{
            name: np.stack([channels[f"{name}.{axis}"] for axis in axes], axis=-1)
            for name, axes in (("flow", "XY"), ("normal", "XYZ"))}}
    with needed_module("astropy.io.fits", "pip install -e '.[test]'").open(path) as file:
        arrays = {part.name.lower(): np.flipud(np.moveaxis(part.data, 0, -1) if part.data.ndim == 3 else part.data)
                  for part in file[1:5]}
    return arrays


def test_a_frame_on_its_own_has_no_flow(tmp_path):
    with pytest.raises(ConfigError, match="products: must be without flow but in a sequence"):
        DataSet(scene=scene_of(tmp_path), states=[STATE], folder=tmp_path / "out", frames_a_shard=1,
                format="webdataset", options=FrameOptions(camera="c", output="dn", format="npz", products=("flow",)))
