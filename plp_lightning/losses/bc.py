"""Behavioural cloning."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import torch
from torch import Tensor


def behavioural_cloning(
    prediction: Mapping[str, Tensor],
    action: Mapping[str, Tensor],
    reduction: Literal["mean", "sum"] = "mean",
    weight: Mapping[str, Tensor] | None = None,
) -> Tensor:
    r"""Squared distance to the demonstrated action, a scalar, the mean over the samples of all domains.

    .. math:: L_{BC} = \mathbb{E}_{(s,a,d,k)} \| \psi_d(\pi_z(\phi_d(s), k), s) - a \|^2

    Every sample counts once, whichever its domain. The reduction over action dimensions decides how much the
    alignment terms weigh beside this one. See "Cross-Domain Policy Transfer by Representation Alignment via
    Multi-Domain Behavioral Cloning" (https://arxiv.org/abs/2407.16912), Eq. 1.

    Args:
        prediction: By domain, ``(B_d, A_d)``; both sizes may differ between domains.
        action: By domain, what the expert did, ``(B_d, A_d)``.
        reduction: Over the action dimensions of a domain: their ``mean``, so that domains weigh alike whatever the
            size of their actions, or their ``sum`` (as printed).
        weight: By domain, ``(B_d,)``: 0 for samples that don't count, 1 for all others; all count if not given.

    Example:
        >>> behavioural_cloning({"point": torch.tensor([[1.0, 2.0]])}, {"point": torch.zeros(1, 2)})
        tensor(2.5000)
    """
    assert prediction, "expected at least one domain"
    assert prediction.keys() == action.keys(), f"predictions of {[*prediction]}, actions of {[*action]}"
    for domain, predicted in prediction.items():
        shape, found = tuple(action[domain].shape), tuple(predicted.shape)
        assert len(shape) == 2, f"expected actions (B, A) in domain {domain!r}, got {shape}"
        assert found == shape, f"expected predictions {shape} in domain {domain!r}, got {found}"
    squared = {domain: (predicted - action[domain]).square() for domain, predicted in prediction.items()}
    if weight is not None:
        squared = {domain: error * weight[domain][:, None] for domain, error in squared.items()}
    errors = [error.sum() / (error.shape[1] if reduction == "mean" else 1) for error in squared.values()]
    if weight is None:
        return torch.stack(errors).sum() / sum(len(predicted) for predicted in prediction.values())
    return torch.stack(errors).sum() / torch.stack([weight[domain].sum() for domain in squared]).sum().clamp(min=1)
