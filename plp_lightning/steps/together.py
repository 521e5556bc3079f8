"""Lightning's DDP for steps that several ranks take together, each with the whole batch in its hands."""

from __future__ import annotations

from typing import Any

import torch
from lightning.pytorch.strategies import DDPStrategy
from lightning.pytorch.utilities.types import STEP_OUTPUT
from torch import Tensor, distributed

from plp_lightning.networks.ranks import Ranks, dealing


class DealtSteps(DDPStrategy):
    """Networks deal rows out to ranks (see :mod:`plp_lightning.networks.ranks`), and gradients are averaged.

    The module is not wrapped: gradients are averaged at once when all are there, so nobody has to find out beforehand
    which parameters a phase trains. Files are rank 0's affair, which nobody waits for.
    """

    def _configure_launcher(self) -> None:
        self._launcher = None  # whoever began the run has started all of its ranks

    def setup_distributed(self) -> None:
        """Take the group that there is; Lightning would draw random numbers anew from the seed here."""
        self.set_world_ranks()

    def configure_ddp(self) -> None:
        """Leave the module as it is: every rank has made the same one."""

    def training_step(self, *args: Any, **kwargs: Any) -> STEP_OUTPUT:
        with dealing(Ranks(self.global_rank, self.world_size)):
            return super().training_step(*args, **kwargs)

    def post_backward(self, closure_loss: Tensor) -> None:
        assert self.lightning_module is not None
        found = [p.grad for p in self.lightning_module.parameters() if p.grad is not None]
        joined = torch.cat([gradient.flatten() for gradient in found]) / self.world_size
        distributed.all_reduce(joined)
        for gradient, mean in zip(found, joined.split([g.numel() for g in found]), strict=True):
            gradient.copy_(mean.view(gradient.shape))

    def barrier(self, *args: Any, **kwargs: Any) -> None:
        """Wait for nobody."""
