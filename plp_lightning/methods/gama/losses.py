"""Losses of GAMA: a dynamics model, and transitions that shall pass for those of another domain.

See "Domain Adaptive Imitation Learning" (https://arxiv.org/abs/1910.00105), Section 5.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional


def normalised_prediction_error(prediction: Tensor, state: Tensor, following: Tensor) -> Tensor:
    r"""Squared error of the predicted next state, for each column as a share of the change to predict.

    .. math:: \frac{1}{S} \sum_i \frac{\sum_b (\hat{s}'_{bi} - s'_{bi})^2}{\sum_b (s'_{bi} - s_{bi})^2}

    So every column counts, whatever its unit and however little it moves in one step. The scalar is 1 for the
    prediction that nothing changes, 0 for a perfect one.

    Args:
        prediction: ``(B, S)``.
        state: ``(B, S)``, before the step.
        following: ``(B, S)``, after it.

    Example:
        >>> nothing, moved = torch.zeros(1, 2), torch.tensor([[1.0, 100.0]])
        >>> normalised_prediction_error(moved * 0.5, nothing, moved)
        tensor(0.2500)
    """
    assert prediction.shape == state.shape == following.shape, f"{prediction.shape}, {state.shape}, {following.shape}"
    error = (prediction - following).square().sum(dim=0)
    change = (following - state).square().sum(dim=0)
    return (error / change.clamp(min=torch.finfo(change.dtype).tiny ** 0.5)).mean()


def transition_discriminator_loss(real: Tensor, fake: Tensor) -> Tensor:
    r"""The discriminator's loss, a scalar: binary cross-entropy of real transitions as 1 and translated ones as 0.

    .. math:: \mathbb{E}_{real}[-\log D] + \mathbb{E}_{fake}[-\log(1 - D)]

    Args:
        real: Logits ``(B_x,)`` of source transitions.
        fake: Logits ``(B_y,)`` of translated ones, from inputs without a gradient.

    Example:
        >>> transition_discriminator_loss(torch.zeros(3), torch.zeros(3))  # 2 log 2: it can't tell
        tensor(1.3863)
    """
    return functional.softplus(-real).mean() + functional.softplus(fake).mean()


def transition_generator_loss(fake: Tensor) -> Tensor:
    r"""The translators' loss, a scalar: :math:`\mathbb{E}_{fake}[-\log D]`, small if translations pass for real ones.

    Args:
        fake: Logits ``(B_y,)`` of translated transitions, by a discriminator whose parameters are held fixed.

    Example:
        >>> transition_generator_loss(torch.tensor([9.0, 9.0]))
        tensor(0.0001)
    """
    return functional.softplus(-fake).mean()
