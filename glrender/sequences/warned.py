"""Warnings of many frames, counted by their kind."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any


def counted(headers: Iterable[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """The warnings of frames, for a manifest: by their code the number of frames (`n_frames`) and the first text.

    Parameters
    ----------
    headers : iterable of mapping
        As of `frame_header`, in the order of the frames.
    """
    found: dict[str, dict[str, Any]] = {}
    for header in headers:
        for code, text in dict(zip(header["warning_codes"], header["warnings"], strict=True)).items():
            entry = found.setdefault(code, {"n_frames": 0, "first": f"frame {header['index']}: {text}"})
            entry["n_frames"] += 1
    return dict(sorted(found.items()))


def in_words(warnings: Mapping[str, Mapping[str, Any]], n_frames: int) -> list[str]:
    """A sentence for each kind of warning: that of the first frame, and the number of frames that have one."""
    return [f"{entry['first']} ({entry['n_frames']} of {n_frames} frames: {code})" for code, entry in warnings.items()]
