"""Image reconstruction: a measure of how much of an image is still in the latent state."""

from __future__ import annotations

from collections.abc import Mapping
from operator import sub
from typing import TypeVar

import torch
from torch import Tensor
from torch.nn import functional

K = TypeVar("K")


def reconstruction(prediction: Mapping[K, Tensor], image: Mapping[K, Tensor]) -> Tensor:
    r"""Squared error of a pixel's colours in [0, 1], a scalar, the mean over pixels, colours and all cameras' samples.

    .. math:: L_{rec} = \mathbb{E}_{(s,d)} \frac{1}{HWC} \| \rho_d(\phi_d(s)) - o / 255 \|^2

    with o the image that belongs to the state s, averaged over squares of pixels if the prediction is smaller.
    See "Cross-Domain Policy Transfer by Representation Alignment via Multi-Domain Behavioral Cloning"
    (https://arxiv.org/abs/2407.16912), appendix on architectures, which names the loss and leaves its form open.
    Computed in float32 whatever autocast says.

    Args:
        prediction: By camera, floats in [0, 1], ``(B_d, H, W, C)``.
        image: By camera, uint8, ``(B_d, H', W', C)``, at least as large.

    Example:
        >>> reconstruction({"left": torch.full((1, 2, 2, 3), 0.5)}, {"left": torch.zeros(1, 2, 2, 3).byte()})
        tensor(0.2500)
    """
    assert prediction, "expected at least one camera"
    assert prediction.keys() == image.keys(), f"predictions of {[*prediction]}, images of {[*image]}"
    errors = [(predicted - _target(predicted, image[d])).square().sum() for d, predicted in prediction.items()]
    return torch.stack(errors).sum() / sum(predicted.numel() for predicted in prediction.values())


def _target(prediction: Tensor, image: Tensor) -> Tensor:
    """The image in [0, 1], in the shape of the prediction."""
    found, wanted = tuple(image.shape), tuple(prediction.shape)
    fits = len(found) == len(wanted) == 4 and found[::3] == wanted[::3] and min(map(sub, found, wanted)) >= 0
    assert fits, f"expected images (B, H, W, C) for predictions {wanted}, got {found}"
    assert image.dtype is torch.uint8, f"expected uint8 images, got {image.dtype}"
    pixels = image.float() / 255
    if found == wanted:
        return pixels
    return functional.adaptive_avg_pool2d(pixels.permute(0, 3, 1, 2), (wanted[1], wanted[2])).permute(0, 2, 3, 1)
