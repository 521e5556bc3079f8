"""What all phases share: a policy, an optimiser, the held-out loss and what their checkpoints hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, Generic, Literal, TypeVar

import torch
from lightning.pytorch import LightningModule
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch import Tensor, nn

from datamodules.errors import ConfigError
from datamodules.types import Batch, BatchSpec, Steps
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods.policy import Policy

P = TypeVar("P", bound=Policy)
Schedule = Literal["constant", "cosine"]


def loss_weights(weights: Mapping[str, float]) -> dict[str, float]:
    """Weights of a phase's losses, by name.

    Raises:
        ConfigError: If one is below 0: the loss would be made as large as can be.
    """
    for name, weight in weights.items():
        if weight < 0:
            raise ConfigError(f"the weight of {name} is {weight}; expected 0 or more; set alignment.{name}_weight")
    return dict(weights)


class Phase(LightningModule, Generic[P]):
    """One training stage of a method, run by its own Trainer.

    Args:
        policy: The policy to train.
        epochs: Passes over the phase's data.
        lr: Learning rate of AdamW.
        weight_decay: Weight decay of AdamW; torch's own default is not zero, the paper's is.
        lr_schedule: ``constant``, or from ``lr`` down to 0 along half a ``cosine`` over all steps of the phase.

    Raises:
        ConfigError: If it is a phase for other policies.
    """

    trains: ClassVar[type] = Policy
    """Which policies it can train."""
    batch_spec: BatchSpec = BatchSpec()
    """Which batches the DataModule shall give."""
    monitor: ClassVar[str] = "val/bc"
    """Held-out loss by which the best checkpoint is chosen."""
    policy_acts: ClassVar[bool] = True
    """Whether what acts has been trained when the phase ends; if not, its success is not evaluated."""

    def __init__(
        self, policy: P, epochs: int, lr: float, weight_decay: float = 0.0, lr_schedule: Schedule = "constant"
    ) -> None:
        super().__init__()
        if not isinstance(policy, self.trains):
            raise ConfigError(
                f"phase {type(self).__name__} trains a {self.trains.__name__}, found a {type(policy).__name__}; "
                "choose policy and phases together, as configs/methods do"
            )
        self.policy = policy
        self.epochs, self.lr, self.weight_decay, self.lr_schedule = epochs, lr, weight_decay, lr_schedule

    @property
    def frozen(self) -> dict[str, nn.Module]:
        """Parts whose parameters and buffers must not change in this phase, by name."""
        return {}

    def trained_parameters(self) -> Iterable[nn.Parameter]:
        """What the optimiser may change."""
        return (parameter for parameter in self.parameters() if parameter.requires_grad)

    def optimizer(self) -> torch.optim.Optimizer:
        """AdamW (paper, appendix), in its fused form: one pass over all parameters."""
        parameters = list(self.trained_parameters())
        return torch.optim.AdamW(parameters, lr=self.lr, weight_decay=self.weight_decay, fused=True)

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """The optimiser and, unless the rate is constant, what lowers its rate after every step."""
        optimizer = self.optimizer()
        if self.lr_schedule == "constant":
            return optimizer
        steps = int(self.trainer.estimated_stepping_batches)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def validation_step(self, batch: Batch, batch_idx: int) -> None:
        """Behavioural-cloning loss on held-out trajectories, for each domain."""
        for domain, steps in batch.steps.items():
            loss = behavioural_cloning(self.predict({domain: steps}), {domain: steps.action})
            size = len(steps.action)
            self.log(f"val/bc_{domain}", loss, batch_size=size, on_epoch=True)
            self.log("val/bc", loss, batch_size=size, on_epoch=True)

    def predict(self, steps: Mapping[str, Steps]) -> dict[str, Tensor]:
        """The policy's actions ``(B_d, A_d)`` by domain."""
        observation = {domain: s.observation for domain, s in steps.items()}
        return self.policy.predict_actions(observation, {domain: s.task for domain, s in steps.items()})

    @property
    def logs_now(self) -> bool:
        """Whether loggers write this training step down; in all others nothing is gathered for them."""
        every: int = self.trainer.log_every_n_steps  # type: ignore[attr-defined]
        return (self.trainer.global_step + 1) % every == 0

    def log_parts(self, parts: dict[str, Tensor], batch_size: int) -> None:
        """Losses of a training step, as ``train/<name>``."""
        for name, value in parts.items():
            self.log(f"train/{name}", value.detach(), batch_size=batch_size)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Add what rebuilds the policy without the configuration: plain lists, strings and numbers."""
        checkpoint["policy"] = {
            "problem": self.policy.problem.to_dict(),
            "architecture": self.policy.architecture,
        }
