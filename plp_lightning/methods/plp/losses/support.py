"""Distance of latent actions from those that all decoders have learnt to read."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods.plp.losses.distance import full_precision


def support_distance(
    latent_action: Mapping[str, Tensor], known: Tensor, weight: Mapping[str, Tensor] | None = None
) -> Tensor:
    r"""Squared distance of latent actions to the nearest known one, a scalar, the mean over the samples of all domains.

    .. math:: L_{support} = \mathbb{E} \min_j \|a_z - a_j\|^2 / \sum_i \mathrm{Var}_j(a_j)_i

    Decoders agree on what a latent action means as far as all were trained on ones like it, and no further. Cloning in
    one domain is content with any latent action that its own decoder reads aright, however far from the others it
    lies. The paper has no such term.

    Args:
        latent_action: By domain, ``(B_d, Z)``.
        known: Latent actions ``(N, Z)``, two or more.
        weight: By domain, ``(B_d,)``: 0 for samples that don't count, 1 for all others; all count if not given.

    Returns:
        Scalar, in units of the known ones' variance; float32 whatever autocast says.

    Example:
        >>> support_distance({"point": torch.tensor([[3.0]])}, torch.tensor([[-1.0], [1.0]]))
        tensor(2.)
    """
    assert len(known) > 1, f"expected two or more known latent actions, got {len(known)}"
    own = {domain: full_precision(action) for domain, action in latent_action.items()}
    with torch.autocast(known.device.type, enabled=False):
        centre = known.mean(0)  # distances don't feel a shift, but the rounding of their matrix product does
        near = {d: torch.cdist(action.detach() - centre, known - centre).argmin(1) for d, action in own.items()}
        squared = behavioural_cloning(own, {domain: known[rows] for domain, rows in near.items()}, "sum", weight)
        return squared / known.var(0).sum().clamp(min=torch.finfo(known.dtype).tiny)
