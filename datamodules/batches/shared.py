"""Images that runs on one machine share: decoded once, into a file beside the demonstrations that each of them maps."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from datamodules.errors import UserError
from datamodules.store import schema
from datamodules.store.atomic import final_path, locked_folder, replacing
from datamodules.store.reader import TrajectoryFile

LEAST_BYTES = 2**24  # of a camera's images; smaller ones are held by every run
MOST_TIMES = 2  # as many images as a run asks for may be decoded for it
ROWS = 1024  # decoded at a time


class SharedImages:
    """Images ``(N + L, H, W, C)`` of one camera, as pages of a file; asked for rows as a tensor would be.

    Args:
        stored: All images of the camera ``(M, H, W, C)`` uint8, mapped.
        place: The row ``(N + L,)`` of each image in them.
    """

    def __init__(self, stored: Tensor, place: np.ndarray) -> None:
        self.stored, self.place = stored, torch.from_numpy(place)
        self.shape = (len(place), *stored.shape[1:])
        self.nbytes = len(place) * stored[0].nbytes

    def __len__(self) -> int:
        return len(self.place)

    def __getitem__(self, rows: Any) -> Tensor:
        """Uint8 ``(B, H, W, C)`` at ``rows``: an index array or tensor ``(B,)``, or a slice."""
        return self.stored[self.place[rows]]

    def to(self, device: torch.device) -> Tensor | SharedImages:
        """The same on a device: nothing changes on the processor, another has a copy ``(N + L, H, W, C)``."""
        return self if device.type == "cpu" else self[:].to(device)


def images_folder(path: Path) -> Path:
    """Folder of the decoded images of the trajectory file at ``path``; it can be removed at any time."""
    path = final_path(path)
    return path.with_name(f"{path.name}.images")


def shared_images(file: TrajectoryFile, domain: str, camera: str, rows: np.ndarray) -> SharedImages | None:
    """Images ``(N + L, H, W, C)`` at ``rows (N + L,)`` of a camera's; None if they are few, or can't be shared.

    Decoded images are named by the hash that the trajectory file has of them, and compared with it before they are
    used: what is damaged is decoded anew.
    """
    digest, shape = file.image_hash(domain, camera), file.image_shape(domain, camera)
    if digest is None or np.prod(shape) < LEAST_BYTES or MOST_TIMES * len(rows) < shape[0]:
        return None
    try:
        path = images_folder(file.path) / digest
        stored = _mapped(path, shape)
        if stored is None:
            _decode(file, domain, camera, path)
            stored = _mapped(path, shape)
    except (OSError, UserError):  # no room, no right; whether the rows can be read at all is told by who reads them
        return None
    return None if stored is None else SharedImages(stored, rows)


def _mapped(path: Path, shape: tuple[int, ...]) -> Tensor | None:
    """Images ``shape`` of a file whose name is their hash; None if they are not in it."""
    try:
        # A private mapping shares its pages until somebody writes into them, which nobody does.
        images = np.memmap(path, np.uint8, "c", shape=shape)
    except (OSError, ValueError):
        return None
    blocks = (images[start : start + ROWS] for start in range(0, len(images), ROWS))
    whole = path.stat().st_size == images.nbytes and schema.digest(images.dtype, shape, blocks) == path.name
    return torch.from_numpy(images) if whole else None


def _decode(file: TrajectoryFile, domain: str, camera: str, path: Path) -> None:
    """Write all images of a camera to ``path``, and remove what the trajectory file holds no more."""
    path.parent.mkdir(exist_ok=True)
    shape = file.image_shape(domain, camera)
    with locked_folder(path.parent):
        if _mapped(path, shape) is not None:  # another run has decoded them while this one waited
            return
        for other in path.parent.iterdir():
            if other.name not in file.hashes.values():
                with suppress(OSError):
                    other.unlink()
        with replacing(path) as temporary, temporary.open("wb") as decoded:
            for start in range(0, shape[0], ROWS):
                decoded.write(file.image_range(domain, start, start + ROWS, camera).data)
