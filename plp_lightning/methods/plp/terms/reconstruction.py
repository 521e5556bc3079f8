"""Image reconstruction as an alignment term."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from datamodules.errors import ConfigError
from datamodules.settings import NonNegativeFloat, NonNegativeInt
from plp_lightning.losses import reconstruction
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.methods.plp.terms.base import AlignmentTerm, EncodedBatch
from plp_lightning.networks import ImageDecoder
from plp_lightning.networks.vision import downsampled_sizes


class ImageReconstruction(AlignmentTerm):
    """An image decoder that mirrors the policy's image encoder and learns along; nothing where there is no camera.

    Latent states must keep what there was to see, so that a task to come finds it there (paper, appendix on
    architectures).

    Args:
        policy: The policy that is aligned.
        weight: Weight of the loss; 0 leaves the image decoder away.
        downsampling: How often images are halved before; each makes the image decoder, the costliest part of a step
            with images, a layer shorter.

    Raises:
        ConfigError: If no layer would be left.
    """

    def __init__(
        self, policy: PortablePolicy, weight: NonNegativeFloat = 1.0, downsampling: NonNegativeInt = 0
    ) -> None:
        super().__init__(policy)
        self.weight, self.order = weight, {domain: i for i, domain in enumerate(policy.domains)}
        self.image_decoder = _image_decoder(policy, downsampling) if weight > 0 else None

    def forward(self, batch: EncodedBatch) -> dict[str, tuple[Tensor, float]]:
        """``reconstruction``, of the steps' images."""
        if self.image_decoder is None:
            return {}
        images = {d: s.observation.image for d, s in batch.steps.items() if s.observation.image is not None}
        loss = reconstruction(self.reconstruct({domain: batch.latent[domain] for domain in images}), images)
        return {"reconstruction": (loss, self.weight)}

    def reconstruct(self, latent: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Images as far as latent states tell of them: ``(B_d, Z)`` → ``(B_d, H, W, C)`` in (0, 1), by domain."""
        assert self.image_decoder is not None, "expected a policy that sees and a weight above 0"
        joined, sizes = torch.cat([*latent.values()]), [len(part) for part in latent.values()]
        numbers = torch.tensor([self.order[domain] for domain in latent])
        domain = torch.repeat_interleave(numbers, torch.tensor(sizes)).to(joined.device)
        return dict(zip(latent, self.image_decoder(joined, domain).split(sizes), strict=True))


def _image_decoder(policy: PortablePolicy, downsampling: int) -> ImageDecoder | None:
    if policy.image_shape is None:
        return None
    channels = policy.image_channels
    if downsampling >= len(channels):
        raise ConfigError(
            f"ImageReconstruction.downsampling is {downsampling}; expected 0 to {len(channels) - 1}; lower it"
        )
    height, width, colours = policy.image_shape
    shape = (*downsampled_sizes((height, width), downsampling)[-1], colours)
    return ImageDecoder(policy.latent_size, len(policy.domains), shape, channels[downsampling:])
