"""An image encoder of one's own: square patches of the image, each a few numbers, joined into a vector."""

from dataclasses import dataclass

from torch import Tensor, nn

from datamodules.settings import PositiveInt
from plp_lightning import ImageEncoderFactory


class PatchEncoder(nn.Module):
    """Makes ``features`` numbers of an image ``(H, W, C)``, which is cut into patches of ``side`` pixels."""

    def __init__(self, shape: tuple[int, int, int], side: int, width: int, features: int) -> None:
        super().__init__()
        height, wide, colours = shape
        self.patches = nn.Conv2d(colours, width, side, side)
        self.joined = nn.Linear(width * (height // side) * (wide // side), features)

    def forward(self, image: Tensor) -> Tensor:
        """Uint8 ``(B, H, W, C)`` → ``(B, F)``."""
        pixels = image.permute(0, 3, 1, 2).to(self.joined.weight.dtype) / 255
        features: Tensor = self.joined(nn.functional.gelu(self.patches(pixels)).flatten(1))
        return features


@dataclass(frozen=True)
class Patches(ImageEncoderFactory):
    """Settings of a :class:`PatchEncoder`; ``weights`` and ``freeze`` come with the base.

    Args:
        weights: File of the weights to begin with; those that are drawn if not given.
        freeze: Keep the weights as they are, in every phase.
        features: F, length of the vector that an image becomes.
        side: Height and width of a patch, pixels.
        width: Numbers that a patch becomes.
    """

    features: PositiveInt = 64
    side: PositiveInt = 4
    width: PositiveInt = 8

    def build(self, shape: tuple[int, int, int]) -> nn.Module:
        """Build the encoder of images ``(H, W, C)``."""
        return PatchEncoder(shape, self.side, self.width, self.features)
