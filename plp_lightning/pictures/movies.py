"""Moving pictures: frames with a border and a caption, and the files that they go to."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from datamodules.store.atomic import locked_folder, replacing

BORDER = 4  # width of the frame around an image, pixels
LINE, LETTER = 16, 6  # height of a line of a caption, and about the width of a letter of Pillow's font, pixels
LEGIBLE = 256  # width that a caption's letters are made for: on wider paper they are larger
LAST = 1.0  # time that the last frame stays, s
CODECS = ("libx264", "mpeg4")  # of mp4 files, the best first


def framed(image: np.ndarray, least: int, colour: tuple[float, float, float]) -> np.ndarray:
    """An image ``(H, W, 3)`` enlarged by whole pixels to at least so many across, in a border of an RGB colour."""
    scale = -(-least // image.shape[1])
    large = image.repeat(scale, axis=0).repeat(scale, axis=1)
    paper = np.empty((large.shape[0] + 2 * BORDER, large.shape[1] + 2 * BORDER, 3), np.uint8)
    paper[:] = (255 * np.array(colour)).round()
    paper[BORDER:-BORDER, BORDER:-BORDER] = large
    return paper


def caption(text: str, width: int, most: int = 1) -> np.ndarray:
    """White paper ``(H, W, 3)`` uint8 with text, cut where it takes more than so many lines."""
    scale = max(1, width // LEGIBLE)
    plain = text.encode("latin-1", "replace").decode("latin-1")  # all that the smallest of Pillow's fonts has
    told = textwrap.wrap(plain, (width // scale - BORDER) // LETTER, max_lines=most, placeholder=" ...")
    paper = Image.new("RGB", (-(-width // scale), LINE * len(told)), "white")
    for i, line in enumerate(told):
        ImageDraw.Draw(paper).text((BORDER, LINE * i + 2), line, fill="black")
    return np.asarray(paper).repeat(scale, axis=0).repeat(scale, axis=1)[:, :width]


def write_gif(path: Path, frames: Sequence[np.ndarray], rate: float) -> None:
    """Write a GIF, complete or absent, that is shown again and again.

    Args:
        path: File to write; its folder is made if there is none.
        frames: One or more images ``(H, W, 3)`` uint8, all of one shape.
        rate: Frames per second; the last one stays for a second.
    """
    # One palette for all, from both ends: with one each, colours would flicker. An octree keeps those of small things.
    ends = Image.fromarray(np.concatenate([frames[0], frames[-1]]))
    palette = ends.quantize(256, method=Image.Quantize.FASTOCTREE)
    images = [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    times = [round(1000 / rate)] * (len(images) - 1) + [round(1000 * LAST)]
    path.parent.mkdir(parents=True, exist_ok=True)
    with locked_folder(path.parent), replacing(path) as temporary:
        images[0].save(temporary, "GIF", save_all=True, append_images=images[1:], duration=times, loop=0)


def makes_mp4() -> bool:
    """Tells whether the package that :func:`write_mp4` needs is installed."""
    return find_spec("av") is not None


def write_mp4(path: Path, frames: Sequence[np.ndarray], rate: float) -> None:
    """Write an mp4 file, complete or absent, from what :func:`write_gif` takes: frames ``(H, W, 3)`` uint8."""
    content = _mp4(frames, rate)  # whole, as PyAV does not say what is wrong with a disk
    path.parent.mkdir(parents=True, exist_ok=True)
    with locked_folder(path.parent), replacing(path) as temporary:
        temporary.write_bytes(content)


def _mp4(frames: Sequence[np.ndarray], rate: float) -> bytes:
    import av

    codec, content = next(name for name in CODECS if name in av.codecs_available), io.BytesIO()
    with av.open(content, "w", format="mp4") as film:
        stream = film.add_stream(codec, Fraction(rate).limit_denominator(1000))
        assert isinstance(stream, av.VideoStream)
        stream.height, stream.width = _even(frames[0]).shape[:2]
        stream.pix_fmt = "yuv420p"  # what every player knows; it wants even numbers of pixels
        for image in [*frames, *[frames[-1]] * round(LAST * rate)]:
            film.mux(stream.encode(av.VideoFrame.from_ndarray(_even(image), format="rgb24")))
        film.mux(stream.encode())
    return content.getvalue()


def _even(image: np.ndarray) -> np.ndarray:
    return np.pad(image, [(0, image.shape[0] % 2), (0, image.shape[1] % 2), (0, 0)], mode="edge")
