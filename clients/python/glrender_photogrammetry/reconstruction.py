"""A surface of a body from posed frames: sparse points, sweeps about a prior surface, each stage kept in a folder."""

from __future__ import annotations

import hashlib
import json
import logging
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from glrender_navigation.checks import refuse

from .features import needed_pycolmap
from .frames import PosedFrame, angle_rad
from .fusion import enough, fused, surface_of
from .mapping import mapped, reposed
from .mesh import Closest, HasFacets, Mesh
from .sparse import sparse_points
from .sweep import PASSES, Pass, depth_map

_log = logging.getLogger(__name__)

POSES = ("known", "prior", "free")
STAGES = ("sparse", "sweep_1", "sweep_2")
"""The stages that `progress` is called with, in their order."""
_NOTE = "made_of.json"
_LEAST_FRAMES = 3
# Features of frames further apart are right for less than 0.85 of their matches.
_WIDE_STEP_RAD = np.radians(15.0)
# Pixels that stand above so many sigmas of the noise without light; fewer of them is a dark frame.
_LEAST_LIT_PX, _N_SIGMA = 500, 6.0
_MOST_SATURATED = 0.5
# Voxels of the surface of sparse points, and how far it goes beyond them, in pixels on the ground.
_SPARSE_VOXEL_PX, _SPARSE_CUT_PX = 20.0, 26.0
# Points count as one where depths differ by fewer steps.
_N_STEPS_AGREE = 3.0

Progress = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Reconstruction:
    """A reconstructed surface.

    Attributes
    ----------
    shape : Mesh
        In `body`.
    points : (N, 3) float64 [m]
        Sparse points, of three frames or more.
    frames : list of PosedFrame
        Those that were used, with the poses that were found.
    report : dict
        `frames` used, `left_out` with reasons, `warnings`, `points`, `px_m` on the ground of the nearest frame,
        `cpu_s` by stage, of the run that made it; of free poses `datum`, RMS of the given ones about them.
    """

    shape: Mesh
    points: np.ndarray
    frames: list[PosedFrame]
    report: dict[str, Any]


def reconstruct(frames: Sequence[PosedFrame], *, body: str | None = None, poses: str = "known",
                prior: HasFacets | None = None, folder: str | Path | None = None, n_sweeps: int = len(PASSES),
                progress: Progress = lambda stage, done: None) -> Reconstruction:
    """The surface of a body from frames of it.

    Parameters
    ----------
    frames : sequence of PosedFrame
        Three or more, of one body and camera, 15 deg or less from one to the next.
    body : str, optional
        That the frames are posed about; the first frame's by default.
    poses : {"known", "prior", "free"}
        Free ones are found from the features alone; the given ones then lend turn, scale and shift of the whole. As a
        prior the given ones count too: places by the frame's `place_sigma_m`, attitudes by how well they fit.
    prior : Mesh or glrender.Shape, optional
        Where the first sweep starts; by default the surface of the sparse points.
    folder : path, optional
        Keeps each stage, and goes on from there when called again with the same frames; made if it is missing.
    n_sweeps : int, optional
        The second one makes a surface finer, in twice the time; with none it is that of the sparse points.
    progress : function of str and float, optional
        Is called with the name of the stage and the share of it that is done.

    Raises
    ------
    ValueError
        Too few frames, of other bodies or cameras, dark, saturated or too far apart, poses that contradict them, a
        prior that lies elsewhere, a folder of other things, or without pycolmap.
    """
    if poses not in POSES:
        raise refuse("poses", f"must be one of {', '.join(POSES)}", poses)
    if n_sweeps not in range(len(PASSES) + 1):
        raise refuse("n_sweeps", f"must be an integer from 0 to {len(PASSES)}", n_sweeps)
    if poses == "prior" and None in (sigmas_m := [frame.place_sigma_m for frame in frames]):
        raise refuse(f"frames[{sigmas_m.index(None)}].place_sigma_m", "must be given where poses are a prior", None,
                     'replace(frame, place_sigma_m=...), or --place-sigma-m; or poses="free"')
    needed_pycolmap()
    frames, left_out = _usable(frames, body)
    px_m = min(frame.px_m for frame in frames)
    prior = None if prior is None else Mesh.of(prior)
    stages = _Stages(folder, _sha256(frames, prior, poses, n_sweeps))
    report: dict[str, Any] = {"frames": len(frames), "left_out": left_out, "warnings": _warnings(frames), "px_m": px_m}
    for warning in report["warnings"]:
        _log.warning(warning)
    if poses != "known":
        found = stages("mapping", partial(mapped, frames, poses == "prior"))
        left_out |= {frame.name: "shares too few features with the others" for k, frame in enumerate(frames)
                     if k not in found["index"]}
        frames, points_m = reposed(frames, found), found["points_m"]
        report |= {"frames": len(frames), "datum": {"turn_deg": float(np.degrees(found["turn_rad"])),
                                                    "place_m": float(found["place_m"])}}
    else:
        points_m = stages("sparse", partial(sparse_points, frames))["points_m"]
    progress("sparse", 1.0)
    enough(points_m)
    report["points"] = len(points_m)
    if prior is None:
        surface = stages.mesh("surface", partial(surface_of, points_m, _nearest_cameras(frames, points_m),
                                                 _SPARSE_VOXEL_PX * px_m, _SPARSE_CUT_PX * px_m))
    else:
        surface = _checked_prior(prior, points_m, PASSES[0].reach_px * px_m)
    for name, plan in zip(STAGES[1:], PASSES[:n_sweeps], strict=False):
        surface = stages.mesh(name, partial(_swept, frames, surface, plan, px_m, partial(progress, name)))
        progress(name, 1.0)
    report["cpu_s"] = stages.cpu_s
    return Reconstruction(shape=surface, points=points_m, frames=frames, report=report)


def _swept(frames: Sequence[PosedFrame], surface: Mesh, plan: Pass, px_m: float,
           progress: Callable[[float], None]) -> Mesh:
    depths_m = {}
    for index in range(len(frames)):
        found_m = depth_map(frames, index, surface, plan, px_m)
        if found_m is not None:
            depths_m[index] = found_m
        progress(0.8 * (index + 1) / len(frames))
    if len(depths_m) < _LEAST_FRAMES:
        raise refuse("frames", "must see the surface in light, three of them with neighbours 8 to 24 deg apart",
                     len(depths_m), "take more frames on the way")
    points_m, cameras_m = fused(frames, depths_m, _N_STEPS_AGREE * plan.step_px * px_m,
                                int(plan.voxel_px))
    progress(0.9)
    return surface_of(points_m, cameras_m, plan.voxel_px * px_m, 3.0 * plan.voxel_px * px_m)


def _usable(frames: Sequence[PosedFrame], body: str | None) -> tuple[list[PosedFrame], dict[str, str]]:
    """The frames that show something, and why others are left out."""
    if len(frames) < _LEAST_FRAMES:
        raise refuse("frames", "must be three or more", len(frames), "draw more: frames of a scenario's encounter")
    body = frames[0].body if body is None else body
    for number, frame in enumerate(frames):
        if frame.body != body:
            raise refuse(f"frames[{number}].body", f"must be {body!r}", frame.body, f"posed_frames(folder, {body!r})")
        if frame.camera != frames[0].camera:
            raise refuse(f"frames[{number}].camera", "must be the first frame's", frame.camera,
                         "reconstruct the frames of each camera apart")
    left_out = {}
    for frame in frames:
        n_lit = int((frame.signal > _N_SIGMA * frame.noise).sum())
        if n_lit < _LEAST_LIT_PX:
            left_out[frame.name] = f"dark: {n_lit} pixels are lit"
        elif frame.most is not None and (share := float((frame.image >= frame.most).sum()) / n_lit) > _MOST_SATURATED:
            left_out[frame.name] = f"saturated: {100.0 * share:.0f} % of what is lit"
    used = [frame for frame in frames if frame.name not in left_out]
    if len(used) < _LEAST_FRAMES:
        raise refuse("frames", "must be neither dark nor saturated, three or more of them", left_out,
                     "draw with another exposure, or exposure_s = \"auto\"")
    return used, left_out


def _warnings(frames: Sequence[PosedFrame]) -> list[str]:
    """A sentence for each step between frames that is too wide, and for each other body that is in view."""
    found = [f"{one.name} to {other.name}: {np.degrees(step):.1f} deg about the body; steps of more than 15 deg lose "
             "matches" for one, other in pairwise(frames) if (step := angle_rad(one, other)) > _WIDE_STEP_RAD]
    n_views = Counter(name for frame in frames for name in frame.others)
    return found + [f"{name} is in view of {n} frames: the surface may have pieces of it" for name, n in
                    n_views.items()]


def _nearest_cameras(frames: Sequence[PosedFrame], points_m: np.ndarray) -> np.ndarray:
    """Places (N, 3) [m] of the cameras most nearly above points."""
    cameras_m = np.array([frame.r_camera_body_m for frame in frames])
    up = cameras_m / np.linalg.norm(cameras_m, axis=1, keepdims=True)
    return cameras_m[np.argmax(points_m @ up.T, axis=1)]


def _sha256(frames: Sequence[PosedFrame], prior: Mesh | None, poses: str, n_sweeps: int) -> str:
    """Hash of all that a reconstruction is made of."""
    digest = hashlib.sha256(json.dumps([version("glrender"), needed_pycolmap().__version__, poses, PASSES[:n_sweeps], [
        [frame.name, frame.body, asdict(frame.camera), frame.offset, frame.place_sigma_m if poses == "prior" else None]
        for frame in frames]]).encode())
    for frame in frames:
        for array in (frame.image, frame.camera_from_body, frame.r_camera_body_m):
            digest.update(np.ascontiguousarray(array).tobytes())
    if prior is not None:
        digest.update(prior.corners_m.tobytes())
    return digest.hexdigest()


def _checked_prior(prior: Mesh, points_m: np.ndarray, reach_m: float) -> Mesh:
    away_m = float(np.median(np.abs(Closest(prior)(points_m[:: len(points_m) // 2000 + 1])[0])))
    if away_m > reach_m:
        raise refuse("prior", f"must lie within {reach_m:.4g} m of half of the sparse points", round(away_m, 1),
                     "give it in metres and in the body's axes, or leave it out")
    return prior


class _Stages:
    """Arrays of each stage, kept in a folder that says what it was made of."""

    def __init__(self, folder: str | Path | None, sha256: str):
        self._folder, self.cpu_s = None if folder is None else Path(folder), dict[str, float]()
        if self._folder is None:
            return
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError):
            raise refuse("out", "must be a folder, or not be there yet", str(self._folder), "name another") from None
        note, made_of = self._folder / _NOTE, json.dumps({"sha256": sha256}) + "\n"
        if not note.is_file() or note.read_text(encoding="utf-8") != made_of:
            if there := sorted(self._folder.glob("[!.]*")):
                raise refuse(str(self._folder), "must be empty, or made of the same frames and settings by this "
                             "version", there[0].name, "name another folder, or delete this one")
            note.write_text(made_of, encoding="utf-8")

    def __call__(self, name: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """Arrays of an NPZ file, made if it is missing."""
        path = None if self._folder is None else self._folder / f"{name}.npz"
        if path is not None and path.is_file():
            found = dict(np.load(path))
        else:
            begin = time.process_time()
            found = make()
            found["cpu_s"] = np.array(round(time.process_time() - begin, 2))
            if path is not None:
                part = path.with_name(f".part.{path.name}")
                np.savez(part, **found)
                part.replace(path)
        self.cpu_s[name] = float(found.pop("cpu_s"))
        return found

    def mesh(self, name: str, make: Callable[[], Mesh]) -> Mesh:
        """A surface of an NPZ file, made if it is missing."""
        def arrays() -> dict[str, Any]:
            mesh = make()
            return {"vertices_m": mesh.vertices_m, "facets": mesh.facets}

        return Mesh(**self(name, arrays))
