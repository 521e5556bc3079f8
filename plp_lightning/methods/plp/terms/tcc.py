"""Temporal cycle-consistency as an alignment term."""

from __future__ import annotations

from typing import Literal

from torch import Tensor

from datamodules.settings import NonNegativeFloat
from plp_lightning.methods.plp.losses import tcc
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.methods.plp.terms.base import AlignmentTerm, EncodedBatch


class TCC(AlignmentTerm):
    """λ_TCC L_TCC (paper, Section 4.1), see :func:`plp_lightning.methods.plp.losses.tcc`.

    Args:
        policy: The policy that is aligned.
        weight: λ_TCC.
        similarity: First softmax: distances as printed in the paper, squared, or squared and scaled.
    """

    needs_pairs = True

    def __init__(
        self,
        policy: PortablePolicy,
        weight: NonNegativeFloat = 0.2,
        similarity: Literal["distance", "squared", "scaled"] = "distance",
    ) -> None:
        super().__init__(policy)
        self.weight, self.similarity = weight, similarity

    def forward(self, batch: EncodedBatch) -> dict[str, tuple[Tensor, float]]:
        """``tcc``, of the two domains whose trajectories are paired."""
        (first, one), (second, other) = ((batch.pair_latent[d], pairs) for d, pairs in batch.pairs.items())
        loss = tcc(first[one.frame], one.mask, second[other.frame], other.mask, self.similarity)
        return {"tcc": (loss, self.weight)}
