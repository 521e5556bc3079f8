"""Pictures that runs have left in their phases' folders, side by side."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

from PIL import Image as Raster

from plp_lightning.report.charts import slug
from plp_lightning.report.document import Figure, Image
from plp_lightning.report.summaries import Group

KINDS = {
    "latents": (
        "Latent states",
        "t-SNE of latent states of proxy tasks; lines join corresponding states of both domains.",
    ),
    "neighbours": ("Nearest states", "States of both domains that are nearest to each other in the latent space."),
    "paths": ("Trajectories", "Episodes of the target task over the walls."),
    "film": ("Films", "Episodes of the target task in both domains, failures first."),
    "reconstructions": ("Reconstructions", "Images beside what latent states have kept of them."),
}
"""Titles and texts of the pictures of the paper's kinds; others are shown under their own names."""
PAPER = ("latents", "neighbours", "paths", "film")  # Kinds that are told if not run
WIDEST, LARGEST = 1400, 100_000_000  # Pixels across of a picture that is shown, and of one that is opened at all
SHARPNESS = 2  # Pixels of a picture to one of a screen
Tell = Callable[[str], None]


def snapshots(groups: Sequence[Group], wanted: bool, tell: Tell) -> list[Figure]:
    """A figure for each kind of picture, with one of each group: of its first run, by its last phase that has one."""
    found: dict[str, list[Image]] = {name: [] for name in KINDS if wanted and name in PAPER}
    for group in groups:
        for file in _files(group):
            if image := _image(group, file, tell):
                found.setdefault(file.stem, []).append(image)
    order = [*(name for name in KINDS if name in found), *sorted({*found} - {*KINDS})]
    return [Figure(*KINDS.get(name, (name, "Pictures of that name.")), found[name]) for name in order]


def _files(group: Group) -> list[Path]:
    """The newest picture of each kind in the folders of a group's first run."""
    first = group.records[0]
    folders = [first.folder / phase for phase in first.phases] if first.folder else []
    files = {
        file.stem: file
        for folder in folders
        if folder.is_dir()
        for file in sorted(folder.glob("*.png"))
        if file.is_file()
    }
    return [*files.values()]


def _image(group: Group, file: Path, tell: Tell) -> Image | None:
    """A picture, drawn anew and not larger than a page; None if it is none, which is told."""
    try:
        content, width = _redrawn(file)
    except (OSError, ValueError, SyntaxError, Raster.DecompressionBombError) as error:
        tell(f"{file}: no picture ({error}); it is left away")
        return None
    run = group.records[0].run
    name, caption = slug(file.stem, *run[:3], group.anchor), " · ".join([*run[:3], f"seed {run.seed}"])
    return Image(name, caption, content, width, runs=group.anchor)


def _redrawn(file: Path) -> tuple[bytes, int]:
    """A picture's bytes, and its width on a screen."""
    with warnings.catch_warnings(), Raster.open(file, formats=["PNG"]) as picture:
        warnings.simplefilter("ignore", Raster.DecompressionBombWarning)
        if picture.width * picture.height > LARGEST:
            raise ValueError(f"{picture.width} × {picture.height} pixels")
        plain = picture.convert("RGB")
    plain.thumbnail((WIDEST, LARGEST))
    written = io.BytesIO()
    plain.save(written, "PNG", optimize=True)
    return written.getvalue(), round(plain.width / SHARPNESS)
