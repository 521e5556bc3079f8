"""Images of demonstrations: in memory if they fit, one copy for all runs, else in their file until a batch asks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from datamodules.batches.shared import SharedImages, shared_images
from datamodules.store.reader import TrajectoryFile
from datamodules.types import ObservationKey

GIBIBYTE = 2**30


class ImageFile:
    """Images ``(N + L, H, W, C)`` of one camera that stay in their file; asked for rows as a tensor would be.

    The file is read in its own compressed blocks. Blocks that were read are kept until ``kept_bytes`` are spent,
    and then for good: rows come in random order, so no block is likelier than another to be asked for next.

    Args:
        file: File of the images; it may have been closed.
        domain: Domain of the images.
        key: Their camera.
        episodes: Numbers ``(E,)`` of episodes; their steps are the rows, then their last observations, as far as known.
        kept_bytes: Bytes of the images that may be held in memory.
    """

    def __init__(
        self, file: TrajectoryFile, domain: str, key: ObservationKey, episodes: np.ndarray, kept_bytes: int
    ) -> None:
        self.file, self.domain, self.camera, self.kept_bytes = file, domain, key.name, kept_bytes
        self.place = file.rows(domain, episodes)
        self.block_length = file.image_block(domain, key.name)
        self.shape = (len(self.place), *key.shape)
        self.blocks: dict[int, np.ndarray] = {}
        self.held_bytes = 0

    def __len__(self) -> int:
        return len(self.place)

    def __getitem__(self, rows: Any) -> Tensor:
        """Uint8 ``(B, H, W, C)`` at ``rows``: an index array or tensor ``(B,)``, or a slice."""
        # numpy takes a tensor of one element for a number.
        places = self.place[rows if isinstance(rows, slice) else np.asarray(rows)]
        images = np.empty((len(places), *self.shape[1:]), np.uint8)
        numbers = places // self.block_length
        for number in np.unique(numbers):
            wanted = numbers == number
            images[wanted] = self._block(int(number))[places[wanted] - number * self.block_length]
        return torch.from_numpy(images)

    def _block(self, number: int) -> np.ndarray:
        if number in self.blocks:
            return self.blocks[number]
        start = number * self.block_length
        block = self.file.image_range(self.domain, start, start + self.block_length, self.camera)
        if self.held_bytes + block.nbytes <= self.kept_bytes:
            self.blocks[number] = block
            self.held_bytes += block.nbytes
        return block


Images = Tensor | SharedImages | ImageFile
"""Images of one camera at all steps of a domain and those seen last, ``(N + L, H, W, C)`` uint8, wherever they are."""


def stored_images(
    file: TrajectoryFile, episodes: Mapping[str, np.ndarray], memory: float
) -> dict[str, dict[str, Images]]:
    """Images ``(N + L, H, W, C)`` of chosen episodes, by domain and camera.

    Args:
        file: File of the images.
        episodes: Numbers ``(E,)`` of the chosen episodes in their file, by domain.
        memory: GiB that the images of all cameras together may take; if they need more, they stay in the file,
            and as much of them is kept once it was read.
    """
    rows = {domain: len(file.rows(domain, chosen)) for domain, chosen in episodes.items()}
    keys = [(domain, key) for domain in episodes for key in file.spec(domain).image_keys]
    sizes = [rows[domain] * math.prod(key.shape) for domain, key in keys]
    needed, budget = sum(sizes), int(memory * GIBIBYTE)
    found: dict[str, dict[str, Images]] = {domain: {} for domain in episodes}
    for (domain, key), size in zip(keys, sizes, strict=True):
        if size and needed <= budget:
            found[domain][key.name] = _in_memory(file, domain, episodes[domain], key.name)
        elif size:
            found[domain][key.name] = ImageFile(file, domain, key, episodes[domain], budget * size // needed)
    return found


def _in_memory(file: TrajectoryFile, domain: str, episodes: np.ndarray, camera: str) -> Tensor | SharedImages:
    """Images ``(N + L, H, W, C)`` of episodes ``(E,)`` in memory, that of all runs if they can be shared."""
    shared = shared_images(file, domain, camera, file.rows(domain, episodes))
    return torch.from_numpy(file.images(domain, episodes, camera)) if shared is None else shared
