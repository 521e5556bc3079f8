"""GAMA's phases: first the parts that need no other domain, then the maps between domains, then the new task."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from datamodules.settings import Depth, NonNegativeFloat, PositiveInt
from datamodules.types import Batch, BatchSpec, Steps
from plp_lightning.losses import behavioural_cloning, r1_penalty
from plp_lightning.methods.gama.losses import (
    normalised_prediction_error,
    transition_discriminator_loss,
    transition_generator_loss,
)
from plp_lightning.methods.gama.policy import GamaPolicy
from plp_lightning.methods.optimization import FusedAdamW, OptimizerFactory, SchedulerFactory
from plp_lightning.methods.phase import Phase, step_count, tasks_of
from plp_lightning.methods.translation import CachedFeatures, PointReconstruction
from plp_lightning.networks import Adversary, mlp, with_frozen_parameters


class GamaPretraining(Phase[GamaPolicy]):
    """Source policy by behavioural cloning, target dynamics, and feature points of images by reconstruction.

    None of the three sends a gradient into another: feature points are learnt as if alone, by a spatial autoencoder
    for each domain with a camera, whose decoder is of no use afterwards.

    Args:
        policy: The policy to train.
        reconstruction_hidden: Units of the image decoder's hidden layer.
        epochs: Passes over the proxy data, counted in samples of both domains together.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes the schedule of the learning rate; a constant rate if not given.
    """

    trains = GamaPolicy
    batch_spec = BatchSpec(next_observation=True)
    policy_acts = False

    def __init__(
        self,
        policy: GamaPolicy,
        reconstruction_hidden: PositiveInt = 256,
        epochs: PositiveInt = 20,
        optimizer: OptimizerFactory = lambda p: FusedAdamW(p, lr=5e-4),
        lr_scheduler: SchedulerFactory | None = None,
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler)
        self.redrawing = PointReconstruction(policy.perception, reconstruction_hidden)

    @property
    def frozen(self) -> dict[str, nn.Module]:
        policy = self.policy
        return {"scaler": policy.perception.scaler, "state_map": policy.state_map, "action_map": policy.action_map}

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        steps = batch.steps
        state = {domain: self.policy.features(domain, s.observation) for domain, s in steps.items()}
        parts = self._losses({domain: seen.detach() for domain, seen in state.items()}, steps)
        parts |= self.redrawing.losses(state, steps)
        self.log_parts(parts, step_count(steps))
        return torch.stack([*parts.values()]).sum()

    def validation_step(self, batch: Batch, batch_idx: int) -> None:
        state = {domain: self.policy.features(domain, s.observation) for domain, s in batch.steps.items()}
        for name, loss in self._losses(state, batch.steps).items():
            self.log(f"val/{name}", loss, batch_size=step_count(batch.steps), on_epoch=True)

    def proxy_loss(self, batch: Batch) -> Tensor:
        """Held-out loss of the target domain's dynamics, a scalar."""
        target = self.policy.target
        seen = {target: self.policy.features(target, batch.steps[target].observation)}
        return self._losses(seen, batch.steps)["dynamics"]

    def _losses(self, state: Mapping[str, Tensor], steps: Mapping[str, Steps]) -> dict[str, Tensor]:
        """Losses of the source policy and of the dynamics, as far as there are steps of their domains."""
        policy, parts = self.policy, {}
        if policy.source in steps:
            taken = steps[policy.source]
            action = policy.imitate(state[policy.source], taken.task)
            parts["bc"] = behavioural_cloning({policy.source: action}, {policy.source: taken.action})
        if policy.target in steps:
            taken, seen = steps[policy.target], state[policy.target]
            assert taken.next_observation is not None, "batch_spec asks for it"
            with torch.no_grad():
                following = policy.features(policy.target, taken.next_observation)
            parts["dynamics"] = normalised_prediction_error(policy.dynamics(seen, taken.action), seen, following)
        return parts


class GamaPhase(CachedFeatures[GamaPolicy]):
    """A phase after pretraining: states are known, and so are the actions that the policy takes in them."""

    trains = GamaPolicy

    def predict(self, steps: Mapping[str, Steps]) -> dict[str, Tensor]:
        return self.policy.control({domain: self.states[domain][s.row] for domain, s in steps.items()}, tasks_of(steps))


class TransitionDiscriminator(Adversary):
    """Tells whether a transition and its task are of the source domain or translated.

    The one-hot task makes it one discriminator a task. It sees the next state as the change, in units of a typical
    one: as next states, two transitions that differ in all that matters would look the same. Source states have S
    numbers, source actions A; there are K tasks.
    """

    unit: Tensor

    def __init__(self, states: int, actions: int, tasks: int, hidden: int, layers: int) -> None:
        super().__init__()
        self.tasks = tasks
        self.register_buffer("unit", torch.ones(states))
        self.net = mlp(2 * states + actions + tasks, hidden, layers, 1)

    def describe(self, state: Tensor, action: Tensor, following: Tensor, task: Tensor) -> Tensor:
        """``(B, S)``, ``(B, A)``, ``(B, S)`` and int64 ``(B,)`` → one row for each transition ``(B, 2 S + A + K)``."""
        one_hot = nn.functional.one_hot(task, self.tasks).to(state.dtype)
        return torch.cat([state, action, (following - state) / self.unit, one_hot], dim=1)

    def forward(self, transition: Tensor) -> Tensor:
        """Descriptions ``(B, 2 S + A + K)`` → logits ``(B,)`` of being real; gradients reach the discriminator."""
        logits: Tensor = self.net(transition)
        return logits[:, 0]


class GamaAlignment(GamaPhase):
    """State map and action map, by imitation in the target domain and by transitions that pass for the source's.

    ``E ‖g(π_x(f(s_y), k)) - a_y‖² + λ E[-log D(ŝ, â, ŝ', k)]`` with ŝ = f(s_y), â = π_x(ŝ, k) and
    ŝ' = f(P(s_y, g(â))). The source policy is frozen, the dynamics go on learning from demonstrations alone. The
    discriminator D learns along; each loss reaches its own player only, so one optimiser step serves all.

    Args:
        policy: The policy to train, its source policy and dynamics trained before.
        adversarial_weight: λ.
        penalty_weight: γ of the penalty on the discriminator's slope, so that it can't become certain.
        discriminator_layers: Hidden layers of the discriminator.
        discriminator_hidden: Units in its hidden layers.
        discriminator_lr: Learning rate of the discriminator.
        dynamics_lr: Learning rate of the dynamics.
        epochs: Passes over the proxy data, counted in samples of both domains together.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes the schedule of the learning rate; a constant rate if not given.
    """

    batch_spec = BatchSpec(images=False, next_observation=True)

    def __init__(
        self,
        policy: GamaPolicy,
        adversarial_weight: NonNegativeFloat = 0.5,
        penalty_weight: NonNegativeFloat = 1.0,
        discriminator_layers: Depth = 2,
        discriminator_hidden: PositiveInt = 192,
        discriminator_lr: NonNegativeFloat = 1e-4,
        dynamics_lr: NonNegativeFloat = 1e-4,
        epochs: PositiveInt = 20,
        optimizer: OptimizerFactory = FusedAdamW,
        lr_scheduler: SchedulerFactory | None = None,
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler)
        self.weights = {"adversarial": adversarial_weight, "penalty": penalty_weight}
        self.discriminator_lr, self.dynamics_lr = discriminator_lr, dynamics_lr
        sizes = policy.perception.sizes[policy.source], policy.domains[policy.source].action_size, policy.task_count
        self.discriminator = TransitionDiscriminator(*sizes, discriminator_hidden, discriminator_layers)

    @property
    def frozen(self) -> dict[str, nn.Module]:
        return {"perception": self.policy.perception, "source_policy": self.policy.source_policy}

    def parameter_groups(self) -> list[Any]:
        policy = self.policy
        return [
            {"params": [*policy.state_map.parameters(), *policy.action_map.parameters()]},
            {"params": [*self.discriminator.parameters()], "lr": self.discriminator_lr},
            {"params": [*policy.dynamics.parameters()], "lr": self.dynamics_lr},
        ]

    def on_fit_start(self) -> None:
        super().on_fit_start()
        self.discriminator.unit.copy_(self.usual_change(self.policy.source))

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        policy, judge = self.policy, self.discriminator
        here, there = batch.steps[policy.source], batch.steps[policy.target]
        real_state, real_next = self.before_and_after(policy.source, here.row)
        state, following = self.before_and_after(policy.target, there.row)
        moved = policy.state_map(state)
        planned = policy.imitate(moved, there.task)
        action = policy.translate(planned, state)
        arrived = policy.state_map(with_frozen_parameters(policy.dynamics)(state, action))
        real = judge.describe(real_state, here.action, real_next, here.task).requires_grad_()
        fake = judge.describe(moved, planned, arrived, there.task)
        judged = judge(real)
        parts = {
            "bc": behavioural_cloning({policy.target: action}, {policy.target: there.action}),
            "adversarial": transition_generator_loss(with_frozen_parameters(judge)(fake)),
            "discriminator": transition_discriminator_loss(judged, judge(fake.detach())),
            "penalty": r1_penalty(judged, real, torch.ones_like(judged)),
            "dynamics": normalised_prediction_error(policy.dynamics(state, there.action), state, following),
        }
        self.log_parts(parts, step_count(batch.steps))
        return torch.stack([self.weights.get(name, 1.0) * loss for name, loss in parts.items()]).sum()


class GamaAdaptation(GamaPhase):
    """Behavioural cloning of the target task by the source policy, in the source domain alone; all else is frozen.

    Args:
        policy: The policy with trained maps.
        epochs: Passes over the target task's data and its mix.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes the schedule of the learning rate; a constant rate if not given.
        target_mix: Train the source policy on mixed-in proxy steps of the target domain too, through the maps.
    """

    batch_spec = BatchSpec("mix", images=False)

    def __init__(
        self,
        policy: GamaPolicy,
        epochs: PositiveInt = 50,
        optimizer: OptimizerFactory = lambda p: FusedAdamW(p, lr=5e-4),
        lr_scheduler: SchedulerFactory | None = None,
        target_mix: bool = False,
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler)
        self.learns_from = {policy.source, policy.target} if target_mix else {policy.source}

    @property
    def frozen(self) -> dict[str, nn.Module]:
        return {name: part for name, part in self.policy.named_children() if name != "source_policy"}

    def parameter_groups(self) -> list[Any]:
        return [*self.policy.source_policy.parameters()]

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        steps = {domain: s for domain, s in batch.steps.items() if domain in self.learns_from}
        if not steps:  # by chance, the last batch of an epoch may hold nothing else
            return torch.stack([parameter.sum() for parameter in self.parameter_groups()]).sum() * 0
        return super().training_step(batch._replace(steps=steps), batch_idx)
