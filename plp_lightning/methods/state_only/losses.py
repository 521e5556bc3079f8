"""One step of the dynamics: the state that it leads to, and the action."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from torch import Tensor

from plp_lightning.losses import behavioural_cloning


def one_step(
    prediction: Mapping[str, Tensor], outcome: Mapping[str, Tensor], reduction: Literal["mean", "sum"] = "mean"
) -> Tensor:
    r"""Squared distance to the known outcome of a step, mean over the steps of all domains.

    .. math::
        L_{next} &= \mathbb{E} \| \pi_z(\phi_d(s), k) - \mathrm{sg}[\phi_d(s')] \|^2 \\
        L_{IDM} &= \mathbb{E} \| \psi(\mathrm{sg}[\phi_y(s')], s) - a \|^2

    with the next latent state as the outcome in the first and the action in the second. No gradient reaches the
    outcome. See "Cross-Domain Policy Transfer by Representation Alignment via Multi-Domain Behavioral Cloning"
    (https://arxiv.org/abs/2407.16912), appendix on transfer from state-only demonstrations.

    Args:
        prediction: By domain, ``(B_d, N_d)``.
        outcome: By domain, ``(B_d, N_d)``.
        reduction: Over the N_d numbers: their ``mean``, or their ``sum`` (as printed).

    Returns:
        Scalar.

    Example:
        >>> one_step({"ant": torch.zeros(1, 2)}, {"ant": torch.tensor([[2.0, 0.0]])})
        tensor(2.)
    """
    return behavioural_cloning(prediction, {domain: found.detach() for domain, found in outcome.items()}, reduction)
