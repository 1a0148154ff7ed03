"""`glrender compress`: what each codec does to a frame, before one is chosen for a camera."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from glrender import ConfigError
from glrender.base.errors import error_path
from glrender.sequences.read import read_header, read_image
from glrender_camera.codec_table import CodecRow, codec_rows
from glrender_camera.compression import noise_DN
from glrender_camera.validate import finite, integer, positive

_HEAD = "codec      loss                bit/px  PSNR dB  max DN  body DN  centre px  features  by px  encode, decode ms"
_LOSSES = {"max_error_DN": "within {:g} DN", "share_of_noise": "{:g} of the noise", "rate_bpp": "{:g} bit/px",
           "psnr_db": "{:g} dB"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender compress`."""
    parser.add_argument("frame", type=Path, metavar="FRAME",
                        help="digital numbers: a file of `render --output dn` or `sequence` (NPZ, FITS, PNG, EXR)")
    parser.add_argument("--bit-depth", type=int, metavar="N", help="of a frame without a header; the detector's")
    parser.add_argument("--json", action="store_true", help="the rows, as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Compress a frame by each codec, and print what that does to it."""
    dn, bit_depth, noise, offset_DN = _read(arguments)
    rows = codec_rows(dn, bit_depth, noise, offset_DN)
    if arguments.json:
        made = [{**row.compression.to_dict(), **{name: value for name, value in asdict(row).items()
                                                 if name != "compression"}} for row in rows]
        sys.stdout.write(json.dumps({"frame": str(arguments.frame), "bit_depth": bit_depth, "noise_DN": noise,
                                     "rows": made}) + "\n")
        return 0
    noise_text = "" if noise is None else f", noise of the lit pixels {noise:.3g} DN"
    sys.stdout.write(f"{arguments.frame}: {dn.shape[1]} x {dn.shape[0]}, {bit_depth} bit{noise_text}\n{_HEAD}\n")
    for row in rows:
        sys.stdout.write(_line(row) + "\n")
        sys.stdout.flush()
    return 0


def _read(arguments: argparse.Namespace) -> tuple[Any, int, float | None, float | None]:
    """Digital numbers, their depth [bit], and the detector's noise and offset [DN]: None where no header has them."""
    path = arguments.frame
    if not path.is_file():
        raise ConfigError(str(path), "is no file", hint="draw one by `glrender render --output dn --out frame.npz`")
    dn, header = read_image(path), read_header(path)
    if dn.dtype.kind != "u" or dn.ndim != 2 or not dn.size:
        raise ConfigError(str(path), "must hold digital numbers", f"{dn.dtype} of shape {dn.shape}",
                          "draw it with --output dn")
    camera = _table(header or {}, "camera")
    detector, compression = _table(camera, "detector"), _table(camera, "compression")
    if len(compression) > 1:
        sys.stderr.write(f"glrender: warning: the frame is decoded from {compression.get('codec')} with loss, and the "
                         "rows show the effect of a second loss; draw it by a camera without `compression`\n")
    bit_depth = detector.get("bit_depth") if arguments.bit_depth is None else arguments.bit_depth
    if bit_depth is None:
        raise ConfigError("--bit-depth", "missing: the frame has no header of a camera", hint="--bit-depth 12")
    integer("--bit-depth", bit_depth, 1, 16)
    if dn.max() > 2**bit_depth - 1:
        raise ConfigError("--bit-depth", f"must hold the frame's largest number, {dn.max()}", bit_depth)
    dn = dn.astype("u1" if bit_depth <= 8 else "u2")
    if not detector:
        return dn, bit_depth, None, None
    with error_path(f"{path}: header.camera.detector"):
        rules = {"offset_DN": finite, "gain_DN_per_electron": positive, "read_noise_electrons": finite}
        numbers = {name: rule(name, detector.get(name)) for name, rule in rules.items()}
    return dn, bit_depth, noise_DN(dn, **numbers), numbers["offset_DN"]


def _table(header: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """A table of a header, empty where it is null or missing."""
    table = header.get(name)
    if table is not None and not isinstance(table, dict):
        raise ConfigError(f"header.{name}", "must be a table", table, "draw the frame anew")
    return table or {}


def _line(row: CodecRow) -> str:
    codec, *losses = row.compression.to_dict().items()
    loss = _LOSSES[losses[0][0]].format(losses[0][1]) if losses else "none"
    kept = "-" if row.features_kept is None else f"{100.0 * row.features_kept:.0f} %"
    return (f"{codec[1]:<10} {loss:<17} {row.bits_per_pixel:8.3f} {_number(row.psnr_db, '8.1f')} "
            f"{row.largest_error_DN:7d} {_number(row.body_rms_DN, '8.2f')} {_number(row.centre_px, '10.4f')} {kept:>9} "
            f"{_number(row.features_px, '6.3f')} {1e3 * row.encode_s:8.0f}, {1e3 * row.decode_s:.0f}")


def _number(value: float | None, form: str) -> str:
    return f"{'-':>{form.split('.')[0]}}" if value is None else f"{value:{form}}"
