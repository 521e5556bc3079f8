"""One step of the dynamics: where it leads, and by which action."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import torch
from torch import Tensor


def one_step(
    prediction: Mapping[str, Tensor],
    outcome: Mapping[str, Tensor],
    last: Mapping[str, Tensor],
    reduction: Literal["mean", "sum"] = "mean",
) -> Tensor:
    r"""Squared distance to what is known about a step, mean over the steps of all domains that something follows.

    .. math::
        L_{next} &= \mathbb{E} \| \pi_z(\phi_d(s), k) - \mathrm{sg}[\phi_d(s')] \|^2 \\
        L_{IDM} &= \mathbb{E} \| \psi(\mathrm{sg}[\phi_y(s')], s) - a \|^2

    with the next latent state as the outcome in the first and the action in the second. No gradient reaches the
    outcome. See "Cross-Domain Policy Transfer by Representation Alignment via Multi-Domain Behavioral Cloning"
    (https://arxiv.org/abs/2407.16912), appendix on transfer from state-only demonstrations.

    Args:
        prediction: By domain, ``(B_d, N_d)``.
        outcome: By domain, ``(B_d, N_d)``.
        last: By domain, ``(B_d,)`` bool: steps that end their trajectory, whose outcome nobody saw. They count for
            nothing.
        reduction: Over the N_d numbers: their ``mean``, or their ``sum`` (as printed).

    Returns:
        Scalar; 0 if nothing follows any step.

    Example:
        >>> seen = {"ant": torch.tensor([[2.0, 0.0], [9.0, 9.0]])}
        >>> one_step({"ant": torch.zeros(2, 2)}, seen, {"ant": torch.tensor([False, True])})
        tensor(2.)
    """
    assert prediction, "expected at least one domain"
    assert prediction.keys() == outcome.keys() == last.keys(), f"{[*prediction]}, {[*outcome]} and {[*last]} differ"
    for domain, predicted in prediction.items():
        found, ends = tuple(outcome[domain].shape), tuple(last[domain].shape)
        shape = tuple(predicted.shape)
        assert len(shape) == 2, f"expected predictions (B, N) in domain {domain!r}, got {shape}"
        assert (found, ends) == (shape, shape[:1]), f"expected {shape} and {shape[:1]}, got {found} and {ends}"
    share = {domain: predicted.shape[1] if reduction == "mean" else 1 for domain, predicted in prediction.items()}
    errors = [
        (predicted - outcome[d].detach()).masked_fill(last[d][:, None], 0).square().sum() / share[d]
        for d, predicted in prediction.items()
    ]
    counted = torch.stack([(~ends).sum() for ends in last.values()]).sum()
    return torch.stack(errors).sum() / counted.clamp(min=1)
