"""DROPOUT: training leaves some units out ("Dropout", https://jmlr.org/papers/v15/srivastava14a.html)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

BITS = 16
"""Random bits that decide whether a unit stays: shares are met within 2⁻¹⁷."""


class Dropout(nn.Dropout):
    """Torch's dropout, which on a processor spends most of its time on random numbers longer than it takes."""

    def forward(self, x: Tensor) -> Tensor:
        """Units ``(…)`` → the same, a share ``p`` of them 0 and the rest larger by ``1 / (1 - p)``, in training."""
        if not self.training or self.p == 0 or x.device.type != "cpu":
            return super().forward(x)
        out_of, left_out = 2**BITS, min(round(self.p * 2**BITS), 2**BITS - 1)
        drawn = torch.empty(-(-x.numel() // 4), dtype=torch.int64).random_(-(2**63), None)
        kept = drawn.view(torch.int16)[: x.numel()].view_as(x) >= left_out - out_of // 2
        scale: Tensor = kept.to(x.dtype)
        return x * scale.mul_(out_of / (out_of - left_out))
