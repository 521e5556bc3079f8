"""Image reconstruction: how much of what a camera saw is still in the latent state."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor


def reconstruction(prediction: Mapping[str, Tensor], image: Mapping[str, Tensor]) -> Tensor:
    r"""Squared error of a pixel's colours in [0, 1], mean over pixels, colours and the samples of all domains.

    .. math:: L_{rec} = \mathbb{E}_{(s,d)} \frac{1}{HWC} \| \rho_d(\phi_d(s)) - o / 255 \|^2

    with o the image that belongs to the state s. See "Cross-Domain Policy Transfer by Representation Alignment
    via Multi-Domain Behavioral Cloning" (https://arxiv.org/abs/2407.16912), appendix on architectures, which
    names the loss and leaves its form open.

    Args:
        prediction: By domain, floats in [0, 1], ``(B_d, H, W, C)``.
        image: By domain, uint8, same shape.

    Returns:
        Scalar; float32 whatever autocast says.

    Example:
        >>> reconstruction({"left": torch.full((1, 2, 2, 3), 0.5)}, {"left": torch.zeros(1, 2, 2, 3).byte()})
        tensor(0.2500)
    """
    assert prediction, "expected at least one domain"
    assert prediction.keys() == image.keys(), f"predictions of {[*prediction]}, images of {[*image]}"
    for domain, predicted in prediction.items():
        shape = tuple(image[domain].shape)
        assert len(shape) == 4, f"expected images (B, H, W, C) in domain {domain!r}, got {shape}"
        assert image[domain].dtype is torch.uint8, f"expected uint8 images, got {image[domain].dtype}"
        assert predicted.shape == shape, (
            f"expected predictions {shape} in domain {domain!r}, got {tuple(predicted.shape)}"
        )
    errors = [(predicted - image[domain].float() / 255).square().sum() for domain, predicted in prediction.items()]
    return torch.stack(errors).sum() / sum(predicted.numel() for predicted in prediction.values())
