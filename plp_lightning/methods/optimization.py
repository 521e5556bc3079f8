"""Optimizers and learning rates of phases: injected, so that any of torch's may stand in their place."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, Literal

from torch.optim import AdamW, Optimizer
from torch.optim.lr_scheduler import CosineAnnealingLR, LambdaLR, LRScheduler

from datamodules.settings import Configured, Fraction, NonNegativeFloat, Share

OptimizerFactory = Callable[[Iterable[Any]], Optimizer]
"""Makes an optimizer of parameters, or of groups of them."""
SchedulerFactory = Callable[[Optimizer], LRScheduler]
"""Makes a schedule of an optimizer's rates: one of the two below, or any of torch's."""


class FusedAdamW(Configured, AdamW):
    """AdamW (paper, appendix) in its fused form, one pass over all parameters, and without torch's own weight decay.

    See "Decoupled Weight Decay Regularization" (https://arxiv.org/abs/1711.05101).

    Args:
        params: Parameters, or groups of them.
        lr: Learning rate.
        weight_decay: Weight decay; the paper's is 0.
        first_moment: β₁, decay of the mean of gradients.
    """

    def __init__(
        self,
        params: Iterable[Any],
        lr: NonNegativeFloat = 1e-4,
        weight_decay: NonNegativeFloat = 0.0,
        first_moment: Fraction = 0.9,
    ) -> None:
        super().__init__(params, lr=lr, betas=(first_moment, 0.999), weight_decay=weight_decay, fused=True)


def let_clip(optimizer: Optimizer) -> None:
    """Leaves it to the trainer to bring gradients of half precision to scale, so that it can clip them before a step.

    Fused optimizers do so themselves, within the step, unless they say that they can't.
    """
    optimizer._step_supports_amp_scaling = False  # type: ignore[attr-defined]


class PhaseSchedule(ABC):
    """A schedule that spans a phase, and is told how long that is."""

    interval: ClassVar[Literal["step", "epoch"]]
    """Unit of time after which the rate changes."""

    @abstractmethod
    def span(self, steps: int, epochs: int) -> None:
        """Takes the length of the phase, before its first step."""


class CosineDecay(CosineAnnealingLR, PhaseSchedule):
    """Lowers the rate to 0 along half a cosine over all steps of the phase.

    See "SGDR: Stochastic Gradient Descent with Warm Restarts" (https://arxiv.org/abs/1608.03983), Eq. 5.
    """

    interval = "step"

    def __init__(self, optimizer: Optimizer) -> None:
        super().__init__(optimizer, T_max=1)

    def span(self, steps: int, epochs: int) -> None:
        self.T_max = steps


class LinearDecay(LambdaLR, PhaseSchedule):
    """Keeps the rate, then lowers it in a line that meets 0 after the last epoch.

    See "Unpaired Image-to-Image Translation using Cycle-Consistent Adversarial Networks"
    (https://arxiv.org/abs/1703.10593), appendix on training details, where the share is 1/2.

    Args:
        optimizer: The optimizer.
        share: Part of the epochs, at the end, over which the rate falls.
    """

    interval = "epoch"

    def __init__(self, optimizer: Optimizer, share: Share = 0.5) -> None:
        self.share, self.epochs = share, 1
        super().__init__(optimizer, self._factor)

    def span(self, steps: int, epochs: int) -> None:
        self.epochs = epochs

    def _factor(self, epoch: int) -> float:
        return slowed(epoch, self.epochs, self.share)


def slowed(epoch: int, epochs: int, share: float) -> float:
    """Factor of the learning rate in an epoch, from 0 on: 1, but falling in a line to 0 over the last ``share``.

    Example:
        >>> [slowed(epoch, 4, 0.5) for epoch in range(4)]
        [1.0, 1.0, 1.0, 0.5]
    """
    return min(1.0, (epochs - epoch) / (share * epochs)) if share > 0 else 1.0
