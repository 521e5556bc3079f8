"""PackedTrajectories of different lengths, laid end to end, and padded only where their frames look at each other."""

from __future__ import annotations

import torch
from torch import Tensor


class Packing:
    """How the frames of P sequences lie in one flat batch of F frames.

    What is done to each frame alone is done to F frames and to no padding; only attention needs all sequences at
    one length T.

    Args:
        frame: ``(P, T)`` int64: which frame is step t of sequence p; anything where ``mask`` is False.
        mask: ``(P, T)`` bool: False behind the end of a sequence.
        frames: F. Known to who laid the frames, so that no device is asked for it.
    """

    def __init__(self, frame: Tensor, mask: Tensor, frames: int) -> None:
        self.mask = mask
        places = torch.arange(mask.numel(), device=mask.device)
        # One more place than there are frames takes what padding would write.
        target = torch.where(mask, frame, frames).flatten()
        self.place = places.new_empty(frames + 1).scatter_(0, target, places)[:frames]

    @property
    def time(self) -> Tensor:
        """``(F,)`` int64: which step of its sequence each frame is."""
        return self.place % self.mask.shape[1]

    def pad(self, x: Tensor) -> Tensor:
        """``(F, W)`` → ``(P, T, W)``, zeros behind the ends."""
        rows = x.new_zeros(self.mask.numel(), x.shape[1]).index_copy(0, self.place, x)
        padded: Tensor = rows.unflatten(0, self.mask.shape)
        return padded

    def pack(self, x: Tensor) -> Tensor:
        """``(P, T, W)`` → ``(F, W)``."""
        return x.flatten(0, 1).index_select(0, self.place)
