"""What domains' cameras saw, as vectors: one pass for all domains, zeros where there is no camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from datamodules.errors import ConfigError
from datamodules.types import DomainSpec, Observation
from plp_lightning.networks.vision import ImageEncoder


def image_shape(domains: Sequence[DomainSpec]) -> tuple[int, int, int] | None:
    """Height, width and colours of the images, or None if no domain has a camera.

    Raises:
        ConfigError: If the domains' images differ in shape.
    """
    shapes = {spec.name: spec.image_key.shape for spec in domains if spec.image_key is not None}
    if len(set(shapes.values())) > 1:
        raise ConfigError(f"image shapes are {shapes}; expected one shape for all domains: set one image size")
    return next(((h, w, c) for h, w, c in shapes.values()), None)


def see(encoder: ImageEncoder | None, observation: Mapping[str, Observation[Tensor]]) -> dict[str, Tensor]:
    """Features ``(B_d, F)`` of all domains' images, by domain.

    Args:
        encoder: Makes F features of an image; without one nothing is seen and F is 0.
        observation: By domain, images ``(B_d, H, W, C)`` uint8 or None.
    """
    size = 0 if encoder is None else encoder.linear.out_features
    blank = {domain: obs.state.new_zeros(len(obs.state), size) for domain, obs in observation.items()}
    images = {domain: obs.image for domain, obs in observation.items() if obs.image is not None}
    if encoder is None or not images:
        return blank
    features = encoder(torch.cat([*images.values()]))
    return blank | dict(zip(images, features.split([len(image) for image in images.values()]), strict=True))
