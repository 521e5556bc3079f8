"""Translation of states between two domains: adversarial, cycle and position consistency.

CycleGAN is "Unpaired Image-to-Image Translation using Cycle-Consistent Adversarial Networks"
(https://arxiv.org/abs/1703.10593), LSGAN "Least Squares Generative Adversarial Networks"
(https://arxiv.org/abs/1611.04076).
"""

from __future__ import annotations

from torch import Tensor

from plp_lightning.losses import weighted_mean


def translation_discriminator_loss(real: Tensor, made: Tensor, real_weight: Tensor, made_weight: Tensor) -> Tensor:
    r"""The discriminator's least-squares loss, a scalar: real samples shall be judged 1, translated ones 0.

    .. math:: L_D = \frac{1}{2} \left( \mathbb{E} (D(x) - 1)^2 + \mathbb{E} D(\Psi(y))^2 \right)

    See LSGAN, Eq. 2 with a = 0, b = 1.

    Args:
        real: Judgements ``(B,)`` of samples of the domain itself.
        made: Judgements ``(B',)`` of samples that were translated into the domain.
        real_weight: ``(B,)``, at least 0; samples of weight 0 don't count.
        made_weight: ``(B',)``.

    Example:
        >>> one = torch.ones(1)
        >>> translation_discriminator_loss(torch.tensor([0.5]), torch.tensor([0.5]), one, one)
        tensor(0.2500)
    """
    return (weighted_mean((real - 1).square(), real_weight) + weighted_mean(made.square(), made_weight)) / 2


def translation_generator_loss(made: Tensor, weight: Tensor) -> Tensor:
    r"""The translator's least-squares loss, a scalar: translated samples shall be judged 1.

    .. math:: L_G = \mathbb{E} (D(\Psi(y)) - 1)^2

    See LSGAN, Eq. 2 with c = 1, and CycleGAN, Section 4, which leaves out the factor 1/2.

    Args:
        made: Judgements ``(B,)`` of translated samples, by a discriminator whose parameters are held fixed.
        weight: ``(B,)``.

    Example:
        >>> translation_generator_loss(torch.tensor([0.0, 1.0]), torch.ones(2))
        tensor(0.5000)
    """
    return weighted_mean((made - 1).square(), weight)


def cycle(original: Tensor, returned: Tensor) -> Tensor:
    r"""Absolute difference of originals and their returns, a scalar, the mean over numbers and samples.

    .. math:: L_{cyc} = \mathbb{E}_x \| \Psi(\Phi(x)) - x \|_1 / O

    See CycleGAN, Eq. 2; the mean over dimensions is that of its authors' code. The same serves the latent cycle
    ``E_x(x)`` and ``E_y(Φ(x))``.

    Args:
        original: ``(..., O)``.
        returned: ``(..., O)``.

    Example:
        >>> cycle(torch.tensor([[1.0, 2.0]]), torch.tensor([[1.0, 0.0]]))
        tensor(1.)
    """
    assert original.shape == returned.shape, f"expected {tuple(original.shape)}, got {tuple(returned.shape)}"
    return (original - returned).abs().mean()


def position_gap(here: Tensor, abroad: Tensor, weight: Tensor) -> Tensor:
    r"""Squared difference of the temporal positions of a state and of its translation, a scalar.

    .. math:: L_{pos} = \mathbb{E}_{(s,k)} \left( P_y(\Phi(s), k) - P_x(s, k) \right)^2

    See "Cross-domain Imitation from Observations" (https://arxiv.org/abs/2105.10037); that it is squared is a
    reading, see ``docs/methods/cdil.md``.

    Args:
        here: Positions ``(B,)`` of states in their own domain, in [0, 1].
        abroad: Positions ``(B,)`` of their translations.
        weight: ``(B,)``; 0 where the task has no position model in the other domain.

    Example:
        >>> position_gap(torch.tensor([0.0, 0.5]), torch.tensor([1.0, 0.5]), torch.ones(2))
        tensor(0.5000)
    """
    return weighted_mean((abroad - here).square(), weight)
