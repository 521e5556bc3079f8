"""CDIL step by step: temporal positions, inverse dynamics and, at the end, cloning; the translation is in between."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from datamodules.settings import PositiveInt
from datamodules.types import Batch, BatchSpec, Steps
from plp_lightning.losses import weighted_mean
from plp_lightning.methods.cdil.policy import CdilPolicy
from plp_lightning.methods.optimization import FusedAdamW, OptimizerFactory, SchedulerFactory
from plp_lightning.methods.phase import Phase, step_count
from plp_lightning.methods.translation import CachedFeatures, PointReconstruction


class CdilPhase(Phase[CdilPolicy]):
    """A phase of CDIL: it freezes parts of the policy by name, and has held-out losses of its own.

    Args:
        policy: The policy to train.
        epochs: Passes over the proxy data of both domains.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes the schedule of the learning rate; a constant rate if not given.
    """

    trains = CdilPolicy
    monitor = "val/loss"
    policy_acts = False
    parts_trained: tuple[str, ...] = ()
    """Names of the policy's parts that this phase trains."""

    def __init__(
        self,
        policy: CdilPolicy,
        epochs: PositiveInt = 10,
        optimizer: OptimizerFactory = lambda p: FusedAdamW(p, lr=5e-4),
        lr_scheduler: SchedulerFactory | None = None,
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler)

    @property
    def frozen(self) -> dict[str, nn.Module]:
        return {name: part for name, part in self.policy.named_children() if name not in self.parts_trained}

    def losses(self, batch: Batch) -> dict[str, Tensor]:
        """Scalars that are minimised, by name, weights applied."""
        raise NotImplementedError

    def held_out_losses(self, batch: Batch) -> dict[str, Tensor]:
        """Scalars that tell how good the phase's result is, by name; none if the batch says nothing about it."""
        return self.losses(batch)

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        parts = self.losses(batch)
        total = torch.stack([*parts.values()]).sum()
        self.log_parts(parts | {"loss": total}, step_count(batch.steps))
        return total

    def proxy_loss(self, batch: Batch) -> Tensor:
        """Sum of the held-out losses, a scalar."""
        return torch.stack([*self.held_out_losses(batch).values()]).sum()

    def validation_step(self, batch: Batch, batch_idx: int) -> None:
        parts = self.held_out_losses(batch)
        total = {"loss": torch.stack([*parts.values()]).sum()} if parts else {}
        for name, value in (parts | total).items():
            self.log(f"val/{name}", value, batch_size=step_count(batch.steps), on_epoch=True)


class CdilPositions(CdilPhase):
    """Temporal position models: the share of its trajectory that lies behind a state (CDIL's first step).

    ``P_d(s, k)`` is regressed to t / T by squared error, for proxy tasks in either domain. Since many tasks pass
    through the same state, the models see the task; whether the authors' do could not be read. Feature points of
    images are learnt beside them, by drawing the images again, and get no gradient from them.

    Args:
        policy: The policy to train.
        reconstruction_hidden: Units of the image decoders' hidden layer.
        epochs: Passes over the proxy data.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes the schedule of the learning rate; a constant rate if not given.
    """

    batch_spec = BatchSpec(progress=True)
    parts_trained = ("positions", "perception")

    def __init__(
        self,
        policy: CdilPolicy,
        reconstruction_hidden: PositiveInt = 256,
        epochs: PositiveInt = 10,
        optimizer: OptimizerFactory = lambda p: FusedAdamW(p, lr=5e-4),
        lr_scheduler: SchedulerFactory | None = None,
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler)
        self.redrawing = PointReconstruction(policy.perception, reconstruction_hidden)

    @property
    def frozen(self) -> dict[str, nn.Module]:
        return super().frozen | {"scaler": self.policy.perception.scaler}

    def losses(self, batch: Batch) -> dict[str, Tensor]:
        steps = batch.steps
        states = {domain: self.policy.features(domain, found.observation) for domain, found in steps.items()}
        errors = []
        for domain, found in steps.items():
            position = self.policy.position(states[domain].detach(), found.task, self.policy.roles[domain])
            assert found.progress is not None, "batch_spec asks for it"
            errors.append((position - found.progress).square())
        return {"position": torch.cat(errors).mean()} | self.redrawing.losses(states, steps)


class CdilDynamics(CdilPhase, CachedFeatures[CdilPolicy]):
    """Inverse dynamics of the target domain: the action that leads from a state to the next (CDIL's third step).

    ``I(s, s')`` is regressed to the expert's action by squared error, on proxy tasks in the target domain. Batches hold
    steps of the source domain too, which go unused. Arguments are those of :class:`CdilPhase`.
    """

    batch_spec = BatchSpec(images=False, next_observation=True)
    parts_trained = ("inverse_dynamics",)

    def losses(self, batch: Batch) -> dict[str, Tensor]:
        steps = batch.steps[self.policy.target]
        inferred = self.policy.infer(*self.before_and_after(self.policy.target, steps.row))
        return {"inverse_dynamics": functional.mse_loss(inferred, steps.action)}

    def held_out_losses(self, batch: Batch) -> dict[str, Tensor]:
        return self.losses(batch) if self.policy.target in batch.steps else {}


class Imagined(NamedTuple):
    """The source's N steps, translated into the target domain."""

    state: Tensor
    """Target states ``(N, O_y)``."""
    action: Tensor
    """``(N, A_y)``, as the inverse dynamics tell them; arbitrary where nobody knows what was seen next."""
    weight: Tensor
    """``(N,)``: 1 for steps of the target task, 0 for all others."""


class CdilAdaptation(CdilPhase, CachedFeatures[CdilPolicy]):
    """Cloning of the target task's demonstrations as they would be in the target domain (CDIL's last step).

    The source's trajectories are translated by Φ and labelled with actions by the inverse dynamics once, when the
    phase begins. The clone of the target domain, which is told the task, learns from those of the target task, and
    from the target domain's own demonstrations of proxy tasks that the experiment mixes in (``data.mix``; 0 is a
    policy for the target task alone). The source's clone learns from the source's own actions, for comparison.

    Args:
        policy: The policy with everything else trained.
        epochs: Passes over the target task's data and its mix.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes the schedule of the learning rate; a constant rate if not given.
    """

    batch_spec = BatchSpec("mix", images=False, next_observation=True)
    policy_acts = True
    parts_trained = ("clones",)
    imagined: Imagined | None = None

    def __init__(
        self,
        policy: CdilPolicy,
        epochs: PositiveInt = 50,
        optimizer: OptimizerFactory = lambda p: FusedAdamW(p, lr=5e-4),
        lr_scheduler: SchedulerFactory | None = None,
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler)

    def on_fit_start(self) -> None:
        super().on_fit_start()
        self.imagined = self._imagine()

    def on_validation_start(self) -> None:
        super().on_validation_start()
        self.imagined = self.imagined or self._imagine()

    @torch.no_grad()
    def _imagine(self) -> Imagined:
        data, policy = self.trainer.datamodule, self.policy  # type: ignore[attr-defined]
        task = data.datasets[policy.source].task
        rows = torch.arange(len(task), device=self.device)
        now, following = (policy.translate(state) for state in self.before_and_after(policy.source, rows))
        wanted = torch.isin(task, torch.tensor([policy.tasks[name] for name in data.target_tasks]))
        return Imagined(now, policy.infer(now, following), wanted.float().to(self.device))

    def losses(self, batch: Batch) -> dict[str, Tensor]:
        assert self.imagined is not None, "the source's trajectories are translated before the first batch"
        lessons, found = [], {}
        if self.policy.source in batch.steps:
            own, seen = batch.steps[self.policy.source], self.imagined
            clone = self.policy.clone(self.states[self.policy.source][own.row], own.task, "source")
            found["bc_source"] = _error(clone, own)
            counted = seen.weight[own.row] if own.weight is None else seen.weight[own.row] * own.weight
            lessons.append((seen.state[own.row], seen.action[own.row], own.task, counted))
        if self.policy.target in batch.steps:
            own = batch.steps[self.policy.target]
            state = self.states[self.policy.target][own.row]
            counted = torch.ones_like(state[:, 0]) if own.weight is None else own.weight
            lessons.append((state, own.action, own.task, counted))
        state, action, task, weight = (torch.cat(column) for column in zip(*lessons, strict=True))
        error = (self.policy.clone(state, task, "target") - action).square().mean(-1)
        return {"bc_target": weighted_mean(error, weight), **found}

    def held_out_losses(self, batch: Batch) -> dict[str, Tensor]:
        return {"bc_target": self.losses(batch)["bc_target"]}


def _error(action: Tensor, steps: Steps) -> Tensor:
    """Mean squared distance of actions ``(B, A)`` to those of the steps that count."""
    if steps.weight is None:
        return functional.mse_loss(action, steps.action)
    return weighted_mean((action - steps.action).square().mean(-1), steps.weight)
