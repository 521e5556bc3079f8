"""Makes the pictures of the quick start's example again: ``python docs/pictures/make.py FOLDER``.

FOLDER is where its five steps were taken. Chromium has to be there for TensorBoard and the report.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageSequence

HERE = Path(__file__).parent
RUN = Path("runs/two_robots/plp/high_centre/seed_0")
WAIT = 20_000  # ms that a page has for its scripts
MOMENTS = 5


def keep(image: Image.Image, name: str, width: int) -> None:
    """Write a picture in few colours, so that it is small."""
    size = (width, round(image.height * width / image.width))
    colours = image.convert("RGB").resize(size, Image.Resampling.LANCZOS).quantize(64, dither=Image.Dither.NONE)
    colours.save(HERE / name, optimize=True)


def film(path: Path) -> Image.Image:
    """Moments of a film side by side."""
    with Image.open(path) as opened:
        frames = [frame.convert("RGB") for frame in ImageSequence.Iterator(opened)]
    chosen = [frames[round(at)] for at in np.linspace(0, len(frames) - 1, MOMENTS)]
    return Image.fromarray(np.concatenate([np.asarray(frame) for frame in chosen], axis=1))


def page(address: str, size: str) -> Image.Image:
    """A page as Chromium shows it once its scripts have run."""
    with tempfile.TemporaryDirectory() as folder:
        quiet = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
        shot = [f"--user-data-dir={folder}/profile", f"--screenshot={folder}/shot.png", f"--window-size={size}"]
        waiting = f"--virtual-time-budget={WAIT}"
        subprocess.run(["chromium", *quiet, *shot, waiting, address], check=True, capture_output=True, timeout=300)
        return Image.open(f"{folder}/shot.png").convert("RGB")


def board(folder: Path) -> Image.Image:
    """TensorBoard's main charts; the folder's place isn't shown."""
    words = ["-m", "tensorboard.main", "--logdir", "runs", "--host", "127.0.0.1", "--port", "0", "--load_fast=false"]
    server = subprocess.Popen([sys.executable, *words], cwd=folder, stderr=subprocess.PIPE, text=True)
    try:
        assert server.stderr is not None
        found = next(m[0] for line in server.stderr if (m := re.search(r"http://127\.0\.0\.1:\d+/", line)))
        time.sleep(10)  # it reads runs after it has begun to answer
        return page(f"{found}#custom_scalars", "1400,780")
    finally:
        server.kill()
        server.wait()


def main(arguments: Sequence[str]) -> None:
    """Make all pictures of a run in a folder."""
    folder = Path(arguments[0]).resolve()
    keep(film(sorted((folder / RUN / "rollouts").glob("*.gif"))[0]), "film.png", 960)
    keep(Image.open(folder / RUN / "adaptation" / "latents.png"), "latents.png", 720)
    keep(page((folder / "report" / "report.html").as_uri(), "1200,800"), "report.png", 900)
    keep(board(folder), "tensorboard.png", 960)


if __name__ == "__main__":
    main(sys.argv[1:])
