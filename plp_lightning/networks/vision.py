"""Networks that see: an image becomes a vector, and a latent state an image again (paper, appendix).

Outside of these modules images are ``(B, H, W, C)``, as cameras and files have them. In memory that is torch's
``channels_last``, so no image is ever transposed.
"""

# No annotations from __future__ here: the parser evaluates none in the constructors that dataclasses generate.
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import prod

import torch
from torch import Tensor, nn

from datamodules.settings import PositiveInt
from plp_lightning.networks.image_encoders import ImageEncoderFactory, ImageShape
from plp_lightning.networks.ranks import dealt

KERNEL, STRIDE, PADDING = 3, 2, 1
UNTRAINED_BYTES = 64 * 2**20
"""Activations of one layer that are held at a time where no gradient asks for all of them."""


@dataclass(frozen=True)
class ImageEncoding(ImageEncoderFactory):
    """Sizes of the strided CoordConv network, see :class:`ImageEncoder`.

    Args:
        weights: File of the weights to begin with; those that are drawn if not given.
        freeze: Keep the weights as they are, in every phase.
        channels: Channels of each convolution, which halves the image's sides; without any, images are left aside.
        features: F, length of the vector that an image becomes.
    """

    channels: tuple[PositiveInt, ...] = (64, 64, 128, 128, 128)
    features: PositiveInt = 1024

    @property
    def blind(self) -> bool:
        return not self.channels

    def build(self, shape: ImageShape) -> "ImageEncoder":
        return ImageEncoder(shape, self.channels, self.features)


class ImageEncoder(nn.Module):
    """Strided CoordConv network: an image and the places of its pixels → a vector.

    The coordinates come in at the input alone: "An Intriguing Failing of Convolutional Neural Networks and the
    CoordConv Solution" (https://arxiv.org/abs/1807.03247), without its radius channel. Arguments are those of
    :class:`ImageEncoding`, for images of ``shape (H, W, C)``.
    """

    coordinates: Tensor

    def __init__(self, shape: Sequence[int], channels: Sequence[int], features: int) -> None:
        super().__init__()
        height, width, colours = shape
        self.register_buffer("coordinates", pixel_coordinates(height, width), persistent=False)
        layers: list[nn.Module] = []
        for size_in, size_out in pairwise([colours + 2, *channels]):
            layers += [nn.Conv2d(size_in, size_out, KERNEL, STRIDE, PADDING), nn.GELU()]
        self.convolutions = nn.Sequential(*layers)
        sizes = downsampled_sizes((height, width), len(channels))
        self.linear = nn.Linear(channels[-1] * prod(sizes[-1]), features)
        self.most_rows = max(1, UNTRAINED_BYTES // (4 * channels[0] * prod(sizes[1])))
        initialise(self)
        _lay_out(self)

    def forward(self, image: Tensor) -> Tensor:
        """Uint8 ``(B, H, W, C)`` → ``(B, F)``; without gradients a few images at a time."""
        return dealt(self._features if torch.is_grad_enabled() else self._few_at_a_time, image)

    def _few_at_a_time(self, image: Tensor) -> Tensor:
        return torch.cat([self._features(part) for part in image.split(self.most_rows)])

    def _features(self, image: Tensor) -> Tensor:
        place = self.coordinates.expand(image.shape[0], -1, -1, -1)
        pixels = torch.cat([image.to(place.dtype) / 255, place], dim=-1)
        maps: Tensor = self.convolutions(pixels.permute(0, 3, 1, 2))
        features: Tensor = self.linear(maps.flatten(1))
        return features


class ImageDecoder(nn.Module):
    """The encoder's mirror image: Z ``latent`` numbers and one of D ``places`` of cameras → its image ``(H, W, C)``.

    ``channels`` are those of the encoder's convolutions, in the encoder's order.
    """

    def __init__(self, latent: int, places: int, shape: Sequence[int], channels: Sequence[int]) -> None:
        super().__init__()
        height, width, colours = shape
        sizes = downsampled_sizes((height, width), len(channels))[::-1]
        self.places, self.start = places, (channels[-1], *sizes[0])
        self.linear = nn.Linear(latent + places, prod(self.start))
        layers: list[nn.Module] = []
        for (size_in, size_out), (small, large) in zip(
            pairwise([*reversed(channels), colours]), pairwise(sizes), strict=True
        ):
            # Where the encoder rounded a half up, the plain size is right; elsewhere it is one short.
            short = [b - (2 * a - 1) for a, b in zip(small, large, strict=True)]
            layers += [nn.GELU(), nn.ConvTranspose2d(size_in, size_out, KERNEL, STRIDE, PADDING, (short[0], short[1]))]
        self.convolutions = nn.Sequential(*layers)
        initialise(self)
        _lay_out(self)

    def forward(self, latent: Tensor, place: Tensor) -> Tensor:
        """``(B, Z)`` and int64 ``(B,)`` → ``(B, H, W, C)`` in (0, 1)."""
        return dealt(self._draw, latent, place)

    def _draw(self, latent: Tensor, place: Tensor) -> Tensor:
        one_hot = nn.functional.one_hot(place, self.places).to(latent.dtype)
        maps = self.linear(torch.cat([latent, one_hot], dim=-1)).unflatten(1, self.start)
        image: Tensor = self.convolutions(maps.contiguous(memory_format=torch.channels_last))
        return image.permute(0, 2, 3, 1).sigmoid()


def pixel_coordinates(height: int, width: int) -> Tensor:
    """Row and column of each pixel, from -1 to 1, ``(H, W, 2)``; 0 along a side of one pixel."""
    rows, columns = (torch.linspace(-1, 1, n) if n > 1 else torch.zeros(1) for n in (height, width))
    return torch.stack(torch.meshgrid(rows, columns, indexing="ij"), dim=-1)


def downsampled_sizes(sides: tuple[int, int], count: int) -> list[tuple[int, int]]:
    """Sides of an image before and after each of ``count`` convolutions, which round halves up."""
    sizes = [sides]
    for _ in range(count):
        height, width = sizes[-1]
        sizes.append(((height + 1) // 2, (width + 1) // 2))
    return sizes


def initialise(network: nn.Module) -> None:
    """Sets weights that keep the size of activations from layer to layer, and biases of zero.

    Torch's own let it shrink. See "Delving Deep into Rectifiers" (https://arxiv.org/abs/1502.01852), Eq. 10.
    """
    for module in network.modules():
        if isinstance(module, nn.Conv2d | nn.ConvTranspose2d | nn.Linear):
            # A strided transposed convolution uses one of STRIDE² weights for a pixel, and stores inputs first.
            flipped = isinstance(module, nn.ConvTranspose2d)
            fan_in = module.weight[:, 0].numel() / STRIDE**2 if flipped else module.weight[0].numel()
            nn.init.normal_(module.weight, std=(2 / fan_in) ** 0.5)
            if module.bias is not None:
                nn.init.zeros_(module.bias)


def _lay_out(network: nn.Module) -> None:
    """Lays the weights of convolutions out in memory as images come."""
    for parameter in network.parameters():
        if parameter.ndim == 4:
            parameter.data = parameter.data.contiguous(memory_format=torch.channels_last)
