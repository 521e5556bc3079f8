"""Feature points: an image becomes a few places in it, found without any action by drawing the image again."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from datamodules.errors import ConfigError
from plp_lightning.networks.perceptrons import mlp
from plp_lightning.networks.vision import initialise, pixel_coordinates


class SpatialEncoder(nn.Module):
    """Image → where in it each of some features is: convolutions, a softmax over pixels, expected coordinates.

    See "Deep Spatial Autoencoders for Visuomotor Learning" (https://arxiv.org/abs/1509.06113), Section V. The first
    convolution halves the image's sides.

    Args:
        shape: Height, width and colours of an image.
        channels: Of each convolution; each of the last one's becomes a point.

    Raises:
        ConfigError: If a size is not positive.
    """

    coordinates: Tensor

    def __init__(self, shape: Sequence[int], channels: Sequence[int]) -> None:
        super().__init__()
        if min(channels) < 1:
            raise ConfigError(f"image_channels is {list(channels)}; expected at least 1 each")
        height, width, colours = shape
        self.size = 2 * channels[-1]
        grid = pixel_coordinates((height + 1) // 2, (width + 1) // 2)
        self.register_buffer("coordinates", grid.flatten(0, 1), persistent=False)
        layers: list[nn.Module] = [nn.Conv2d(colours, channels[0], 5, 2, 2)]
        for size_in, size_out in pairwise(channels):
            layers += [nn.GELU(), nn.Conv2d(size_in, size_out, 3, 1, 1)]
        self.convolutions = nn.Sequential(*layers)
        self.sharpness = nn.Parameter(torch.zeros(()))
        initialise(self)

    def forward(self, image: Tensor) -> Tensor:
        """Uint8 ``(B, H, W, C)`` → points ``(B, 2 P)`` in [-1, 1]: row and column of each in turn."""
        pixels = image.to(self.coordinates.dtype) / 255
        maps: Tensor = self.convolutions(pixels.permute(0, 3, 1, 2))
        where = (self.sharpness.exp() * maps.flatten(2)).softmax(dim=2)
        return (where @ self.coordinates).flatten(1)


class PointDecoder(nn.Module):
    """Feature points → the image that they came from, a quarter as high and wide.

    Args:
        size: Length of the points' vector.
        shape: Height, width and colours of an image.
        hidden: Units of its hidden layer.
    """

    def __init__(self, size: int, shape: Sequence[int], hidden: int) -> None:
        super().__init__()
        height, width, colours = shape
        self.shape = (-(-height // 4), -(-width // 4), colours)
        self.net = mlp(size, hidden, 1, self.shape[0] * self.shape[1] * colours)

    def forward(self, points: Tensor) -> Tensor:
        """``(B, 2 P)`` → ``(B, H/4, W/4, C)`` in (0, 1)."""
        image: Tensor = self.net(points).unflatten(1, self.shape)
        return image.sigmoid()
