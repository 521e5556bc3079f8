"""What happened in one step, as a vector that a Transformer reads."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from datamodules.types import DomainSpec, Observation
from plp_lightning.networks import ImageEncoder, ImageEncoding

MOST_IMAGES = 512
"""Images whose activations training holds at a time: whole trajectories have thousands of frames."""
POSITION_SCALE = 0.02
"""Standard deviation of the positions in the beginning."""


class FrameEmbedding(nn.Module):
    """State, image and, if wished, action of a step, and which step it is → W units; positions are learned.

    Args:
        spec: The domain.
        actions: Actions that are seen beside the observation; 0 for none.
        width: W.
        length: Most steps of a sequence.
        dropout: Share of units that training leaves out.
        images: Sizes of the image encoder, in a domain with a camera.
    """

    def __init__(
        self, spec: DomainSpec, actions: int, width: int, length: int, dropout: float, images: ImageEncoding
    ) -> None:
        super().__init__()
        camera = spec.image_key if images.channels else None
        shape = None if camera is None else camera.shape
        self.image_encoder = None if shape is None else images.build(shape)
        inputs = spec.state_size + actions + (0 if camera is None else images.features)
        self.linear = nn.Linear(inputs, width)
        self.position = nn.Embedding(length, width)
        nn.init.normal_(self.position.weight, std=POSITION_SCALE)
        self.dropout = nn.Dropout(dropout)

    def forward(self, observation: Observation[Tensor], time: Tensor, action: Tensor | None = None) -> Tensor:
        """``(F, W)``.

        Args:
            observation: Scaled states ``(F, O)``, images ``(F, H, W, C)``.
            time: ``(F,)`` int64, step within the sequence.
            action: ``(F, A)``, where actions are seen.
        """
        parts = [observation.state] if action is None else [observation.state, action]
        if self.image_encoder is not None:
            assert observation.image is not None, "expected images"
            parts.append(self._encode_images(self.image_encoder, observation.image))
        embedded: Tensor = self.dropout(self.linear(torch.cat(parts, dim=1)) + self.position(time))
        return embedded

    def _encode_images(self, encoder: ImageEncoder, image: Tensor) -> Tensor:
        """Features ``(F, features)``; of many images the activations are computed again in the backward pass."""
        if not torch.is_grad_enabled() or len(image) <= MOST_IMAGES:
            features: Tensor = encoder(image)
            return features
        parts = [checkpoint(encoder, part, use_reentrant=False) for part in image.split(MOST_IMAGES)]
        return torch.cat(parts)
