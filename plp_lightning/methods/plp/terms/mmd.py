"""Maximum mean discrepancy as an alignment term."""

from __future__ import annotations

from torch import Tensor

from datamodules.errors import ConfigError
from datamodules.settings import NonNegativeFloat, PositiveFloat
from plp_lightning.methods.plp.losses import mmd
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.methods.plp.terms.base import AlignmentTerm, EncodedBatch


class MMD(AlignmentTerm):
    """λ_MMD L_MMD (paper, Eq. 2), see :func:`plp_lightning.methods.plp.losses.mmd`.

    Args:
        policy: The policy that is aligned.
        weight: λ_MMD.
        bandwidths: Widths of the kernels, in mean distances; the paper has one of 1.
        scale_gradient: Let the gradient flow through the mean distance that is divided by. Without, a few latent
            states can't lower the loss by running away from all others.

    Raises:
        ConfigError: If there is no kernel.
    """

    def __init__(
        self,
        policy: PortablePolicy,
        weight: NonNegativeFloat = 0.1,
        bandwidths: tuple[PositiveFloat, ...] = (1.0,),
        scale_gradient: bool = True,
    ) -> None:
        super().__init__(policy)
        if not bandwidths:
            raise ConfigError("MMD.bandwidths is empty; expected one or more widths above 0")
        self.weight, self.bandwidths, self.scale_gradient = weight, tuple(bandwidths), scale_gradient

    def forward(self, batch: EncodedBatch) -> dict[str, tuple[Tensor, float]]:
        """``mmd``, of the latent states of all domains."""
        return {"mmd": (mmd([*batch.latent.values()], self.scale_gradient, self.bandwidths), self.weight)}
