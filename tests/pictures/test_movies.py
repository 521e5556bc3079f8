"""Moving pictures as files that others read: size, speed, captions; complete or absent."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from plp_lightning.pictures import movies
from plp_lightning.pictures.movies import BORDER, LINE, caption, framed, write_gif, write_mp4

av = pytest.importorskip("av")
RED, BLUE = (200, 30, 40), (20, 40, 220)


def film(count: int, height: int, width: int) -> list[np.ndarray]:
    """Red in the left half, blue in the right; row t is white in frame t."""
    frames = np.empty((count, height, width, 3), np.uint8)
    frames[:, :, : width // 2], frames[:, :, width // 2 :] = RED, BLUE
    for t in range(count):
        frames[t, 4 * t : 4 * t + 4] = 255
    return [*frames]


def read(path: Path) -> tuple[list[np.ndarray], float]:
    """Frames and frames per second; the last frame of a GIF is one that stays."""
    if path.suffix == ".gif":
        with Image.open(path) as image:
            duration = image.info["duration"]
            return [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(image)], 1000 / duration
    with av.open(str(path)) as container:
        rate = float(container.streams.video[0].average_rate)
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)], rate


WRITERS = {".gif": write_gif, ".mp4": write_mp4}


@pytest.mark.parametrize("form", WRITERS)
@pytest.mark.parametrize(("height", "width", "rate"), [(48, 64, 20.0), (49, 65, 12.5), (32, 33, 10.0)])
def test_films_show_every_frame_at_their_rate(form: str, height: int, width: int, rate: float, tmp_path: Path) -> None:
    path, frames = tmp_path / "new" / f"film{form}", film(6, height, width)
    WRITERS[form](path, frames, rate)
    found, speed = read(path)
    assert speed == pytest.approx(rate)
    assert len(found) == (6 if form == ".gif" else 6 + round(rate))  # the last stays for a second
    for shown, made in zip(found, frames, strict=False):
        assert np.abs(shown[:height, :width].astype(int) - made).mean() < 12
    assert all(side % 2 == 0 or form == ".gif" for side in found[0].shape[:2])


@pytest.mark.parametrize("form", WRITERS)
def test_one_frame_is_a_film(form: str, tmp_path: Path) -> None:
    WRITERS[form](tmp_path / f"film{form}", film(1, 32, 32), 10.0)
    assert read(tmp_path / f"film{form}")[0][0].shape == (32, 32, 3)


@contextmanager
def little_room(size: int) -> Iterator[None]:
    """Let no file grow beyond so many bytes, as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("size", [0, 100, 4096])
@pytest.mark.parametrize("form", WRITERS)
def test_a_film_that_does_not_fit_leaves_the_one_before(form: str, size: int, tmp_path: Path) -> None:
    path, noise = tmp_path / f"film{form}", np.random.default_rng(0).integers(0, 256, (40, 128, 128, 3), np.uint8)
    WRITERS[form](path, film(3, 32, 32), 10.0)
    before = path.read_bytes()
    with pytest.raises(OSError, match="File too large") as caught, little_room(size):
        WRITERS[form](path, [*noise], 10.0)
    assert caught.value.filename == str(path)
    assert path.read_bytes() == before
    assert [*tmp_path.iterdir()] == [path]


def test_small_images_are_enlarged_by_whole_pixels_and_framed() -> None:
    image = np.arange(4 * 5 * 3, dtype=np.uint8).reshape(4, 5, 3)
    shown = framed(image, 12, (1.0, 0.0, 0.0))
    assert shown.shape == (12 + 2 * BORDER, 15 + 2 * BORDER, 3)
    np.testing.assert_array_equal(shown[BORDER:-BORDER:3, BORDER:-BORDER:3], image)
    assert (shown[:BORDER] == (255, 0, 0)).all()


@pytest.mark.parametrize(
    ("text", "most", "lines"),
    [
        ("short", 1, 1),
        ("short", 2, 1),
        ("word " * 20, 1, 1),
        ("word " * 20, 3, 3),
        ("x" * 400, 2, 2),
        ("叠红块 ů", 1, 1),
    ],
)
def test_captions_take_the_lines_that_they_may(text: str, most: int, lines: int) -> None:
    paper = caption(text, 200, most)
    assert paper.shape == (LINE * lines, 200, 3)
    for line in np.split(paper, lines):
        assert (line < 128).any()
    assert (paper[:, -2:] == 255).all()


@pytest.mark.parametrize("width", [64, 264, 529, 1032])
def test_letters_grow_with_the_paper(width: int) -> None:
    paper = caption("seed 0", width)
    assert paper.shape == (LINE * max(1, width // 256), width, 3)


def test_without_the_package_for_it_no_mp4_is_promised(monkeypatch: pytest.MonkeyPatch) -> None:
    assert movies.makes_mp4()
    monkeypatch.setattr(movies, "find_spec", lambda name: None)
    assert not movies.makes_mp4()
