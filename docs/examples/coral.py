"""CORAL as an alignment term: covariances of the domains' latent states shall agree."""

import itertools

import torch
from torch import Tensor

from datamodules.settings import NonNegativeFloat
from plp_lightning import AlignmentTerm, EncodedBatch, PortablePolicy


def coral(first: Tensor, second: Tensor) -> Tensor:
    """Squared distance of two covariances: "Deep CORAL" (https://arxiv.org/abs/1607.01719), Eq. 1.

    Args:
        first: ``(B, Z)``.
        second: ``(B', Z)``.

    Returns:
        Scalar.

    Example:
        >>> coral(torch.tensor([[0.0], [2.0]]), torch.tensor([[0.0], [0.0]]))
        tensor(1.)
    """
    gap = torch.cov(first.T) - torch.cov(second.T)
    return gap.square().sum() / (4 * first.shape[1] ** 2)


class Coral(AlignmentTerm):
    """λ L_CORAL, mean over all pairs of domains.

    Args:
        policy: The policy that is aligned.
        weight: λ.
    """

    def __init__(self, policy: PortablePolicy, weight: NonNegativeFloat = 1.0) -> None:
        super().__init__(policy)
        self.weight = weight

    def forward(self, batch: EncodedBatch) -> dict[str, tuple[Tensor, float]]:
        """``coral``, of the latent states."""
        pairs = itertools.combinations(batch.latent.values(), 2)
        return {"coral": (torch.stack([coral(*pair) for pair in pairs]).mean(), self.weight)}
