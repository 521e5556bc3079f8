"""Frames of a video by their time stamps, with PyAV, which comes with the extra ``lerobot``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from datamodules.formats.parquet import extra
from datamodules.formats.source import refuse_source


class Clip(NamedTuple):
    """A part of a video: one episode."""

    path: Path
    start: float  # Time stamp of its first frame, in seconds
    fps: float
    frames: int


def read_clip(clip: Clip, shape: tuple[int, ...], place: str) -> Iterator[np.ndarray]:
    """Decode the frames ``(H, W, C)`` uint8 of a clip one by one.

    Raises:
        TrajectoryFileError: Naming the step at which the video is damaged, ends or lacks a frame.
    """
    if not clip.path.is_file():
        refuse_source(place, f"no file {clip.path}", "a video")
    step = 0
    try:
        # As an open file of a named kind it can't refer to other files or addresses.
        with clip.path.open("rb") as content, extra("av").open(content, "r", format="mp4") as container:
            for number, image in _decoded(container, clip, shape, place):
                if number > step:
                    break
                if number == step:
                    yield image
                    step += 1
                if step == clip.frames:
                    return
    except extra("av").FFmpegError as error:
        refuse_source(f"{place}, step {step}", f"a damaged video, {clip.path.name} ({error})", "an undamaged one")
    refuse_source(f"{place}, step {step}", f"no frame in {clip.path.name}", f"{clip.frames}, as the table has rows")


def _decoded(container: Any, clip: Clip, shape: tuple[int, ...], place: str) -> Iterator[tuple[int, np.ndarray]]:
    """Frames from the last key frame before the clip on, with their steps in it."""
    if not container.streams.video:
        refuse_source(place, f"no video in {clip.path.name}", "one")
    stream = container.streams.video[0]
    if (stream.height, stream.width) != shape[:2]:
        found = f"{clip.path.name} of {stream.height} × {stream.width} pixels"
        refuse_source(place, found, f"{shape[0]} × {shape[1]}")
    if clip.start > 0:
        container.seek(int(clip.start / stream.time_base), stream=stream)
    for frame in container.decode(stream):
        number = -1 if frame.pts is None else round((float(frame.pts * stream.time_base) - clip.start) * clip.fps)
        if number >= 0:
            pixels = frame.to_ndarray(format="gray" if shape[2] == 1 else "rgb24")
            yield number, pixels.reshape(shape)
