"""Frames, each the vector of one step that a Transformer reads.

Sequences of different lengths are laid end to end, and padded only where their frames look at each other.
"""

from __future__ import annotations

from functools import cached_property

import torch
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from datamodules.types import DomainSpec, Observation
from plp_lightning.methods.contextual.dropout import Dropout
from plp_lightning.networks import ImageEncoderFactory, Vision, build_vision

MOST_IMAGES = 512
"""Images whose activations training holds at a time: whole trajectories have thousands of frames."""
POSITION_SCALE = 0.02
"""Standard deviation of the positions in the beginning."""


class Packing:
    """Places of the frames of P sequences in one flat batch of F frames.

    Work on each frame alone is done for F frames and no padding; only attention needs all sequences at one length T.

    Args:
        frame: ``(P, T)`` int64: number of the frame that is step t of sequence p; anything where ``mask`` is False.
        mask: ``(P, T)`` bool: False behind the end of a sequence.
        frames: F, passed so that no device is asked for it.
    """

    def __init__(self, frame: Tensor, mask: Tensor, frames: int) -> None:
        self.mask = mask
        places = torch.arange(mask.numel(), device=mask.device)
        # Where each place has a frame of its own, it has one behind the ends too. Elsewhere one more place than there
        # are frames takes what padding would write.
        target = frame if frames == mask.numel() else torch.where(mask, frame, frames)
        self.place = places.new_empty(frames + 1).scatter_(0, target.flatten(), places)[:frames]

    @cached_property
    def lengths(self) -> list[int] | None:
        """Lengths ``(P,)`` where frames lie end to end, none missing, on a processor: a GPU is not asked for values."""
        if self.mask.device.type != "cpu" or len(self.place) == self.mask.numel():
            return None
        found: list[int] = self.mask.sum(dim=1).tolist()
        return found if bool((self.place.diff() > 0).all()) else None

    @property
    def time(self) -> Tensor:
        """Step ``(F,)`` int64 of each frame in its sequence."""
        return self.place % self.mask.shape[1]

    def pad(self, x: Tensor) -> Tensor:
        """``(F, W)`` → ``(P, T, W)``, zeros behind the ends."""
        rows = x.new_zeros(self.mask.numel(), x.shape[1]).index_copy(0, self.place, x)
        return rows.view(*self.mask.shape, -1)

    def pack(self, x: Tensor) -> Tensor:
        """``(P, T, W)`` → ``(F, W)``."""
        return x.flatten(0, 1).index_select(0, self.place)


def group(which: Tensor, count: int) -> Packing:
    """Places frames ``(F,)`` in ``count`` sequences by the number of theirs, int64, in order."""
    members = which.bincount(minlength=count)
    mask = torch.arange(int(members.max()), device=which.device) < members[:, None]
    frame = torch.zeros_like(mask, dtype=torch.int64).masked_scatter(mask, which.argsort(stable=True))
    return Packing(frame, mask, len(which))


def lay_out(mask: Tensor) -> Tensor:
    """Numbers frames ``(P, T)`` from sequence to sequence and step to step; 0 where ``mask (P, T)`` is False."""
    return torch.where(mask, mask.flatten().cumsum(0).view_as(mask) - 1, 0)


class FrameEmbedding(nn.Module):
    """State, images and, if wished, action of a step, and the step's number → W units; positions are learned.

    Args:
        spec: The domain.
        actions: Actions that are seen beside the observation; 0 for none.
        width: W.
        length: Most steps of a sequence.
        dropout: Share of units that training leaves out.
        images: Maker of the image encoders, in a domain with cameras.
    """

    def __init__(
        self, spec: DomainSpec, actions: int, width: int, length: int, dropout: float, images: ImageEncoderFactory
    ) -> None:
        super().__init__()
        self.domain, self.image_encoder = spec.name, build_vision([spec], images)
        features = 0 if self.image_encoder is None else self.image_encoder.width
        self.linear = nn.Linear(spec.state_size + actions + features, width)
        self.position = nn.Embedding(length, width)
        nn.init.normal_(self.position.weight, std=POSITION_SCALE)
        self.dropout = Dropout(dropout)

    def forward(self, observation: Observation[Tensor], time: Tensor, action: Tensor | None = None) -> Tensor:
        """States ``(F, O)``, images ``(F, H, W, C)``, steps ``(F,)``, actions ``(F, A)`` if seen → ``(F, W)``."""
        parts = [observation.state] if action is None else [observation.state, action]
        if self.image_encoder is not None:
            parts.append(self._encode_images(self.image_encoder, observation))
        embedded: Tensor = self.dropout(self.linear(torch.cat(parts, dim=1)) + self.position(time))
        return embedded

    def _encode_images(self, encoder: Vision, observation: Observation[Tensor]) -> Tensor:
        """Vectors ``(F, W)``; of many images the activations are computed again in the backward pass."""
        rows = len(observation.state)
        if torch.is_grad_enabled() and rows > MOST_IMAGES:
            parts = [observation.take(slice(i, i + MOST_IMAGES)) for i in range(0, rows, MOST_IMAGES)]
            return torch.cat([checkpoint(encoder, {self.domain: part}, use_reentrant=False) for part in parts])
        features: Tensor = encoder({self.domain: observation})
        return features
