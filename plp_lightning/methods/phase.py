"""PHASE: the part that all training stages share: cloning and its held-out loss, the optimizer and checkpoints."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, Literal, TypeVar

import torch
from lightning.pytorch import LightningModule
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch import Tensor, nn

from datamodules.batches.dataset import DomainDataset
from datamodules.errors import ConfigError
from datamodules.settings import Configured, blueprint
from datamodules.types import Batch, BatchSpec, Observation, Steps
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods.optimization import OptimizerFactory, PhaseSchedule, SchedulerFactory, let_clip
from plp_lightning.methods.policy import Policy
from plp_lightning.methods.upgrade import upgrade_checkpoint
from plp_lightning.networks import Adversary

P = TypeVar("P", bound=Policy)
ROWS_AT_A_TIME = 8192


class Phase(Configured, LightningModule, Generic[P]):
    """One training stage of a method, run by its own Trainer.

    Args:
        policy: The policy to train.
        epochs: Passes over the phase's data.
        optimizer: Makes the optimizer of the trained parameters; the paper's is AdamW.
        lr_scheduler: Makes the schedule of the learning rate, such as :class:`CosineDecay`; None keeps it constant.

    Raises:
        ConfigError: If it is a phase for other policies.
    """

    trains: ClassVar[type] = Policy
    """Class of the policies that it can train."""
    batch_spec: BatchSpec = BatchSpec()
    """Batches that the DataModule shall give."""
    monitor: ClassVar[str] = "val/bc"
    """Held-out loss by which the best checkpoint is chosen."""
    policy_acts: ClassVar[bool] = True
    """True if the acting parts are trained when the phase ends; if not, success is not evaluated."""
    logs_always: bool = False
    """True while a step is captured: it is logged whenever it is replayed for a logger."""
    bc_reduction: Literal["mean", "sum"] = "mean"
    """Reduction of behavioural cloning over action dimensions, in training; held-out losses are means."""

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
        """Parts whose parameters and buffers must not change in this phase, by name, beside the policy's own."""
        return {}

    def parameter_groups(self) -> list[Any]:
        """Gives the parameters that the optimizer may change, or groups of them with rates of their own."""
        return [parameter for parameter in self.parameters() if parameter.requires_grad]

    def averaged_parameters(self) -> dict[str, Tensor]:
        """Gives the parameters that are trained, by name, without those of adversaries: what an average is made of."""
        against = {own for part in self.modules() if isinstance(part, Adversary) for own in part.parameters()}
        found = self.named_parameters(remove_duplicate=False)  # a checkpoint holds every name
        return {name: own.detach() for name, own in found if own.requires_grad and own not in against}

    def configure_optimizers(self) -> OptimizerLRScheduler:
        optimizer = self.optimizer(self.parameter_groups())
        if self._trainer is not None and self._trainer.gradient_clip_val:
            let_clip(optimizer)
        if self.lr_scheduler is None:
            return optimizer
        schedule, interval = self.lr_scheduler(optimizer), "epoch"
        if isinstance(schedule, PhaseSchedule) and self._trainer is not None:
            schedule.span(int(self.trainer.estimated_stepping_batches), self.trainer.max_epochs or self.epochs)
            interval = schedule.interval
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": schedule, "interval": interval, "monitor": self.monitor},
        }

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        """Behavioural-cloning loss of a batch's steps, a scalar."""
        loss = self.cloning_loss(batch.steps, self.bc_reduction)
        self.log_parts({"bc": loss}, step_count(batch.steps))
        return loss

    def validation_step(self, batch: Batch, batch_idx: int) -> None:
        """Behavioural-cloning loss on held-out trajectories, for each domain."""
        for domain, steps in batch.steps.items():
            loss = self.cloning_loss({domain: steps})
            for name in (f"val/bc_{domain}", "val/bc"):
                self.log(name, loss, batch_size=len(steps.action), on_epoch=True)

    def proxy_loss(self, batch: Batch) -> Tensor:
        """Loss on proxy tasks that are held out in the target domain, a scalar: of behavioural cloning.

        It tells the best epoch where that is handed on; no batch holds a target task.
        """
        return self.cloning_loss(batch.steps)

    def predict(self, steps: Mapping[str, Steps]) -> dict[str, Tensor]:
        """The policy's actions ``(B_d, A_d)`` by domain."""
        return self.policy.predict_actions({d: s.observation for d, s in steps.items()}, tasks_of(steps))

    def cloning_loss(self, steps: Mapping[str, Steps], reduction: Literal["mean", "sum"] = "mean") -> Tensor:
        """Scalar distance of the policy's actions to demonstrated ones ``(B_d, A_d)``, all domains together."""
        actions = {d: s.action for d, s in steps.items()}
        return behavioural_cloning(self.predict(steps), actions, reduction, weights_of(steps))

    @property
    def logs_now(self) -> bool:
        """True in training steps that loggers write down; in all others nothing is gathered for them."""
        return self.logs_always or (self.trainer.global_step + 1) % int(self.trainer.log_every_n_steps) == 0  # type: ignore[attr-defined]

    def log_parts(self, parts: dict[str, Tensor], batch_size: int) -> None:
        """Logs the scalar losses of a training step as ``train/<name>``, if loggers write it down."""
        for name, value in parts.items() if self.logs_now else ():
            self.log(f"train/{name}", value.detach(), batch_size=batch_size)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Adds a blueprint of the policy that needs no configuration: plain lists, strings and numbers."""
        checkpoint["policy"] = {"problem": self.policy.problem.to_dict(), **blueprint(self.policy, ["problem"])}

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Brings checkpoints of earlier versions up to date."""
        upgrade_checkpoint(checkpoint)


class CachedStates(Phase[P]):
    """A phase during which states do not change: each is computed once and looked up by row from then on."""

    states: dict[str, Tensor]
    """State ``(N, S_d)`` of every observation, by domain."""
    next_row: dict[str, Tensor]
    """Row ``(N,)`` of the observation after each step, by domain."""

    @abstractmethod
    def state_of(self, domain: str, observation: Observation[Tensor]) -> Tensor:
        """State ``(B, S_d)`` of a domain's observation, ``(B, O)`` and ``(B, H, W, C)``."""

    def on_fit_start(self) -> None:
        self._cache_all()

    def on_validation_start(self) -> None:
        if not hasattr(self, "states"):  # without training before
            self._cache_all()

    def before_and_after(self, domain: str, rows: Tensor) -> tuple[Tensor, Tensor]:
        """States ``(B, S_d)`` before and after the steps at ``rows (B,)``, all of which have a next observation."""
        states = self.states[domain]
        return states[rows], states[self.next_row[domain][rows]]

    def _rows_to_cache(self, dataset: DomainDataset) -> int:
        return len(dataset.observation)  # last observations too, which follow steps

    @torch.no_grad()
    def _cache_all(self) -> None:
        self.states, self.next_row = {}, {}
        for domain, dataset in self.trainer.datamodule.datasets.items():  # type: ignore[attr-defined]
            chunks = torch.arange(self._rows_to_cache(dataset)).split(dataset.rows_at_a_time(ROWS_AT_A_TIME))
            seen = (dataset.observation.take(rows).map(lambda x: x.to(self.device)) for rows in chunks)
            self.states[domain] = torch.cat([self.state_of(domain, observation) for observation in seen])
            self.next_row[domain] = dataset.next_row.to(self.device)


def step_count(steps: Mapping[str, Steps]) -> int:
    """Number of steps ``Σ B_d`` in all domains together."""
    return sum(len(s.action) for s in steps.values())


def weights_of(steps: Mapping[str, Steps]) -> dict[str, Tensor] | None:
    """Weights ``(B_d,)`` of the steps, by domain; None if all count."""
    found = {domain: s.weight for domain, s in steps.items() if s.weight is not None}
    return found or None


def tasks_of(steps: Mapping[str, Steps]) -> dict[str, Tensor]:
    """Task indices ``(B_d,)`` of the steps, by domain."""
    return {domain: s.task for domain, s in steps.items()}
