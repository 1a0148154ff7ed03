"""Both cases of the SISPO paper: frames, codecs, the surface from them, and its deviation from the shape drawn.

Everything goes to out/paper: started again, it goes on where it was stopped. `summary.json` has the numbers.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import resource
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
from glrender import ConfigError, Shape, generate
from glrender_camera.compression import Compression, decode
from glrender_cli.__main__ import main as glrender
from glrender_cli.deviation_picture import write_picture
from glrender_photogrammetry import Mesh, deviation, posed_frames, reconstruct

HERE = Path(__file__).parent
OUT = HERE.parents[1] / "out" / "paper"
# Poses of the fly-by are those of its frames, those of the orbit are found from features alone.
POSES = {"flyby": "known", "orbit": "free"}
CODECS = {"compressed": Compression(codec="jpeg_ls", max_error_DN=10),
          "compressed_jpeg_2000": Compression(codec="jpeg_2000", rate_bpp=1.0)}


def fine_shape(coarse: Path, out: Path) -> Mesh:
    """The shape with 16 facets for each of the file's and relief of them, in metres; made once for each file."""
    if not coarse.is_file():
        raise ConfigError("--shape", "must be a file of comet 67P in km", str(coarse),
                          "set GLRENDER_SHARED to the folder that has data/67p, or name a file")
    note, made_of = out.with_suffix(".json"), {"sha256": hashlib.sha256(coarse.read_bytes()).hexdigest()}
    if not out.is_file() or _read(note) != made_of:
        note.unlink(missing_ok=True)
        out.parent.mkdir(parents=True, exist_ok=True)
        shape = generate.subdivide_with_relief(Shape.from_file(coarse, length_unit="km"), levels=2, relief=0.06, seed=3)
        part = out.with_name(f".part.{out.name}")
        shape.to_file(part)
        part.replace(out)
        note.write_text(json.dumps(made_of) + "\n")
    return Mesh.from_file(out)


def drawn(scenario: Path, name: str, out: Path, truth: Mesh) -> float:
    """Draw the frames of a case that are not there; all processor time [s] that they took.

    All folders of the case are deleted first if they are of another scenario or shape.
    """
    note = out / f"{name}.json"
    made_of = {"sha256": hashlib.sha256(scenario.read_bytes() + truth.corners_m.tobytes()).hexdigest()}
    kept = _read(note)
    if kept.get("sha256") != made_of["sha256"]:
        note.unlink(missing_ok=True)
        for folder in (path for path in out.glob(f"{name}*") if path.is_dir()):
            shutil.rmtree(folder)
        kept = made_of
        note.write_text(json.dumps(kept) + "\n")
    if "cpu_s" not in kept:
        begin = _cpu_s()
        if glrender(["sequence", str(scenario), "--out", str(out / f"{name}_frames"), "--processes", "1"]) != 0:
            raise SystemExit(1)
        kept |= {"cpu_s": round(_cpu_s() - begin, 1)}
        note.write_text(json.dumps(kept) + "\n")
    return float(kept["cpu_s"])


def recoded(frames: Path, folder: Path, compression: Compression) -> float:
    """The frames as the ground decodes them, in a new folder of the same kind; mean rate [bit/px]."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    rates = []
    for path in sorted(frames.glob("frame_*.npz")):
        with np.load(path) as stored:
            dn, header = stored["image"], str(stored["header"])
        bit_depth = json.loads(header)["camera"]["detector"]["bit_depth"]
        stream = compression.encode(dn, bit_depth)
        rates.append(8.0 * len(stream) / dn.size)
        np.savez_compressed(folder / path.name, image=decode(stream, compression.codec, dn.shape, bit_depth),
                            header=header)
    shutil.copy(frames / "manifest.json", folder)
    return float(np.mean(rates))


def compared(frames: Path, folder: Path, poses: str, truth: Mesh, drawn_s: float) -> dict[str, float]:
    """Reconstruct a folder of frames, write a picture of its deviation from the truth, and return the numbers."""
    posed = posed_frames(frames)
    model = reconstruct(posed, poses=poses, folder=folder)
    px_m = model.report["px_m"]
    found = deviation(model.shape, truth, px_m=px_m, align="similarity", frames=posed)
    write_picture(folder.with_suffix(".png"), found, folder.name)
    return {"mean_m": found.mean_m, "sigma_m": found.sigma_m, "max_m": found.max_m, "px_m": px_m,
            "complete_2px": found.complete_2px, "cpu_s": round(drawn_s + sum(model.report["cpu_s"].values()), 1)}


def case(name: str, scenario: Path, out: Path, truth: Mesh) -> dict[str, object]:
    """The numbers of a case: of its frames, and of the same after each codec."""
    frames = out / f"{name}_frames"
    drawn_s = drawn(scenario, name, out, truth)
    summary: dict[str, object] = dict(compared(frames, out / name, POSES[name], truth, drawn_s))
    for key, compression in CODECS.items():
        decoded = out / f"{name}_{key}_frames"
        rate_bpp = recoded(frames, decoded, compression)
        summary[key] = {**compression.to_dict(), "bits_per_pixel": round(rate_bpp, 3),
                        **compared(decoded, out / f"{name}_{key}", POSES[name], truth, drawn_s)}
    return summary


def main() -> int:
    """Run both cases, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    shared = Path(os.environ.get("GLRENDER_SHARED", HERE.parents[2] / "shared"))
    parser.add_argument("cases", nargs="*", default=list(POSES), metavar="CASE", help="flyby, orbit; default: both")
    parser.add_argument("--shape", type=Path, default=shared / "data" / "67p" / "67p-16k.obj", metavar="FILE")
    arguments = parser.parse_args()
    if unknown := set(arguments.cases) - set(POSES):
        parser.error(f"CASE: must be one of {', '.join(POSES)}, got {unknown.pop()!r}")
    try:
        truth = fine_shape(arguments.shape, OUT / "67p.obj")
    except ConfigError as error:
        parser.error(str(error))
    kept = OUT / "summary.json"
    for name in arguments.cases:
        found = case(name, HERE / f"{name}.toml", OUT, truth)
        # Another process may have written the other case.
        summary = _read(kept) | {name: found}
        kept.write_text(json.dumps(summary, indent=1) + "\n")
        sys.stdout.write(f"{name}: {json.dumps(summary[name])}\n")
    return 0


def _read(note: Path) -> dict[str, Any]:
    """Entries of a note; none if it is not there."""
    return json.loads(note.read_text()) if note.is_file() else {}


def _cpu_s() -> float:
    """Processor time [s] of this process and its children."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


if __name__ == "__main__":
    raise SystemExit(main())
