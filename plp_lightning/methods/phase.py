"""What all phases share: a policy, an optimiser, the held-out loss and what their checkpoints hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, Generic, TypeVar

from lightning.pytorch import LightningModule
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch import Tensor, nn

from datamodules.errors import ConfigError
from datamodules.settings import Configured, recipe
from datamodules.types import Batch, BatchSpec, Steps
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods.optimization import OptimizerFactory, PhaseSchedule, SchedulerFactory
from plp_lightning.methods.policy import Policy
from plp_lightning.methods.upgrade import upgrade_checkpoint

P = TypeVar("P", bound=Policy)


class Phase(Configured, LightningModule, Generic[P]):
    """One training stage of a method, run by its own Trainer.

    Args:
        policy: The policy to train.
        epochs: Passes over the phase's data.
        optimizer: Makes the optimizer of the trained parameters; the paper's is AdamW.
        lr_scheduler: Makes what changes the learning rate, :class:`CosineDecay` for instance; a constant rate if not
            given.

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
        self, policy: P, epochs: int, optimizer: OptimizerFactory, lr_scheduler: SchedulerFactory | None = None
    ) -> None:
        super().__init__()
        if not isinstance(policy, self.trains):
            raise ConfigError(
                f"phase {type(self).__name__} trains a {self.trains.__name__}, found a {type(policy).__name__}; "
                "choose policy and phases together, as configs/methods do"
            )
        self.policy, self.epochs, self.optimizer, self.lr_scheduler = policy, epochs, optimizer, lr_scheduler

    @property
    def frozen(self) -> dict[str, nn.Module]:
        """Parts whose parameters and buffers must not change in this phase, by name."""
        return {}

    def trained_parameters(self) -> Iterable[nn.Parameter]:
        """What the optimizer may change."""
        return (parameter for parameter in self.parameters() if parameter.requires_grad)

    def parameter_groups(self) -> list[Any]:
        """What the optimizer is made of: the trained parameters, or groups of them with rates of their own."""
        return list(self.trained_parameters())

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Make the optimizer and, unless the rate is constant, what changes its rate."""
        optimizer = self.optimizer(self.parameter_groups())
        if self.lr_scheduler is None:
            return optimizer
        schedule, interval = self.lr_scheduler(optimizer), "epoch"
        if isinstance(schedule, PhaseSchedule):
            steps, epochs = self.trainer.estimated_stepping_batches, self.trainer.max_epochs
            schedule.span(int(steps), epochs or self.epochs)
            interval = schedule.interval
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": schedule, "interval": interval, "monitor": self.monitor},
        }

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
        checkpoint["policy"] = {"problem": self.policy.problem.to_dict(), **recipe(self.policy, ["problem"])}

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Understand what earlier versions saved."""
        upgrade_checkpoint(checkpoint)
