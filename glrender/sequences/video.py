"""A video for the eye of a sequence's frames."""

from __future__ import annotations

import errno
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from glrender_camera.levels import black_and_white
from glrender_camera.validate import within

from ..base.errors import ConfigError
from .contact_sheet import grey_levels
from .folder import whole
from .read import read_image

# VP9 plays in browsers, MPEG-4 part 2 in players alone; OpenCV's wheels have no H.264.
_CODECS = ("vp09", "mp4v")


def check_video(path: Path, rate_hz: float) -> None:
    """Refuse a video that cannot be written, before the frames are drawn.

    Raises
    ------
    ConfigError
        Another ending than .mp4, a folder that is not there, a rate beyond 1..240 Hz.
    """
    if path.suffix.lower() != ".mp4":
        raise ConfigError("video", "must end in .mp4", str(path))
    if not path.absolute().parent.is_dir():
        raise ConfigError("video", "must be in a folder that is there", str(path), "make the folder first")
    within("video_rate_hz", rate_hz, 1.0, 240.0)


def write_video(path: Path, frames: Sequence[Path], rate_hz: float = 25.0, offset_DN: float | None = None) -> None:
    """Write an MP4 of frames' files, grey levels of one scale for all as of `black_and_white`, gamma 2.2.

    A process that is killed meanwhile leaves no such file; the frames are read twice. An odd size gets its last row or
    column twice.

    Parameters
    ----------
    path : path
        Ends in .mp4.
    frames : sequence of path
        As `read_image` reads them, in their order, all of one size.
    rate_hz : float [1/s], 1..240
    offset_DN : float [DN], optional
        As of `black_and_white`.

    Raises
    ------
    ConfigError
        As of `check_video`; an OpenCV without a codec.
    """
    check_video(path, rate_hz)
    black, white = black_and_white((read_image(frame) for frame in frames), offset_DN)
    height, width = read_image(frames[0]).shape
    # Codecs have even sizes; OpenCV would cut the last row off.
    beyond = [(0, height % 2), (0, width % 2)]
    size = width + beyond[1][1], height + beyond[0][1]
    with whole(path) as apart:
        writer = _writer(apart, rate_hz, size)
        for frame in frames:
            writer.write(np.pad(grey_levels(read_image(frame), white, black=black), beyond, mode="edge"))
        writer.release()
        # OpenCV does not say that a disk is full.
        n_written = max(int(cv2.VideoCapture(str(apart)).get(cv2.CAP_PROP_FRAME_COUNT)), 0)
        if n_written != len(frames):
            raise OSError(errno.EIO, f"{n_written} of {len(frames)} frames could be written: is the disk full?")


def _writer(path: Path, rate_hz: float, size: tuple[int, int]) -> cv2.VideoWriter:
    for codec in _CODECS:
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), rate_hz, size, isColor=False)
        if writer.isOpened():
            return writer
    raise ConfigError("video", f"needs an OpenCV with one of {', '.join(_CODECS)}",
                      hint="pip install opencv-python-headless, or make one of the frames by ffmpeg")
