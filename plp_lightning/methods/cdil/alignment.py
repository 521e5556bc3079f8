"""CDIL's translation of states, learned from unpaired, unaligned trajectories without looking at any action."""

# No annotations from __future__ here: the parser evaluates none in the constructors that dataclasses generate.
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from datamodules.settings import Configured, Depth, NonNegativeFloat, PositiveInt
from datamodules.types import Batch, BatchSpec
from plp_lightning.losses import r1_penalty
from plp_lightning.methods.cdil.losses import (
    cycle,
    position_gap,
    translation_discriminator_loss,
    translation_generator_loss,
)
from plp_lightning.methods.cdil.phases import CdilPhase
from plp_lightning.methods.cdil.policy import OTHER, CdilPolicy, Role
from plp_lightning.methods.optimization import FusedAdamW, LinearDecay, OptimizerFactory, SchedulerFactory
from plp_lightning.methods.translation import CachedFeatures
from plp_lightning.networks import Adversary, TaskNetwork, with_frozen_parameters


class RoundTrip(NamedTuple):
    """Steps of one domain as pairs of states, translated into the other domain, and the first of each pair back."""

    states: Tensor
    """States and those after them, ``(2, B, O)``."""
    task: Tensor
    """``(B,)``."""
    shared: Tensor
    """``(B,)``: 1 where both domains have demonstrations of the task, 0 else."""
    latent: Tensor
    """Latent states of the first, ``(B, Z)``."""
    abroad: Tensor
    """States in the other domain, ``(2, B, O')``."""
    latent_abroad: Tensor
    """Latent states of the first of those, ``(B, Z)``."""
    home: Tensor
    """First states, back again, ``(B, O)``."""


@dataclass(frozen=True)
class CdilWeights(Configured):
    """Weights of the translation's losses.

    Args:
        adversarial: Weight of the translator's loss against the discriminators.
        cycle: Weight of the cycle x → y → x, and its mirror image.
        latent: Weight of the latent cycle.
        position: Weight of the consistency of temporal positions.
        penalty: γ of the penalty on the discriminators' slopes, so that they can't become certain.
    """

    adversarial: NonNegativeFloat = 10.0
    cycle: NonNegativeFloat = 10.0
    latent: NonNegativeFloat = 1.0
    position: NonNegativeFloat = 1.0
    penalty: NonNegativeFloat = 0.1


class Discriminators(Adversary, nn.ModuleDict):
    """Discriminators by role of their domain."""


class CdilAlignment(CdilPhase, CachedFeatures[CdilPolicy]):
    """Adversarial translation that is consistent in cycles, latent cycles and temporal position (CDIL's second step).

    Discriminators look at two states that follow each other and at the task, so that what is translated has to move
    like the other domain. The target task has demonstrations in the source domain alone: they take part in the terms
    that need no counterpart, the two cycles ("inference-time adaptation"). No coefficient of the authors is known; the
    cycle's is CycleGAN's, how the others were chosen is in ``docs/methods/cdil.md``. The pace of either domain is
    measured before.

    Args:
        policy: The policy with trained position models.
        weights: Weights of the losses.
        noise: Deviation of Gaussian noise on what discriminators see, real or not. Two states that follow each other
            obey the physics to the last digit, and translated ones never do: without noise that gives them away, and
            the discriminators have nothing to teach.
        discriminator_layers: Hidden layers of each discriminator.
        discriminator_hidden: Units in its hidden layers.
        discriminator_lr: Learning rate of the discriminators; that of the translator if not given.
        epochs: Passes over all data that there is.
        optimizer: Makes the optimizer of all players.
        lr_scheduler: Makes the schedule of the learning rates; players who never slow down go on circling around each
            other.
    """

    batch_spec = BatchSpec("all", images=False, next_observation=True)
    parts_trained = ("translator", "pace")
    shared: Tensor

    def __init__(
        self,
        policy: CdilPolicy,
        weights: CdilWeights = CdilWeights(),
        noise: NonNegativeFloat = 0.1,
        discriminator_layers: Depth = 3,
        discriminator_hidden: PositiveInt = 192,
        discriminator_lr: NonNegativeFloat | None = None,
        epochs: PositiveInt = 20,
        optimizer: OptimizerFactory = lambda p: FusedAdamW(p, lr=5e-4, first_moment=0.5),
        lr_scheduler: SchedulerFactory | None = LinearDecay,
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler)
        self.weights = {"discriminator": 1.0, **asdict(weights)}
        self.discriminator_lr, self.noise = discriminator_lr, noise
        sizes = {role: policy.perception.sizes[domain] for domain, role in policy.roles.items()}
        tasks, hidden, layers = len(policy.tasks), discriminator_hidden, discriminator_layers
        self.discriminators = Discriminators(
            {role: TaskNetwork(2 * size, tasks, 1, hidden, layers) for role, size in sizes.items()}
        )
        self.register_buffer("shared", torch.ones(tasks), persistent=False)

    def parameter_groups(self) -> list[Any]:
        """Translator and discriminators: losses of either reach nobody else's parameters."""
        rate = {} if self.discriminator_lr is None else {"lr": self.discriminator_lr}
        return [
            {"params": [*self.policy.translator.parameters()]},
            {"params": [*self.discriminators.parameters()], **rate},
        ]

    def on_fit_start(self) -> None:
        super().on_fit_start()
        for domain, role in self.policy.roles.items():
            self.policy.pace.fit(self.usual_change(domain), role)
        proxy_tasks = self.trainer.datamodule.proxy_tasks  # type: ignore[attr-defined]
        self.shared.copy_(torch.tensor([float(task in proxy_tasks) for task in self.policy.tasks]))

    def losses(self, batch: Batch) -> dict[str, Tensor]:
        trips = self._travel(batch)
        return self._total(self._consistency(trips)) | self._total(self._contest(trips))

    def held_out_losses(self, batch: Batch) -> dict[str, Tensor]:
        # Only terms that can be compared between epochs, since no discriminator has a say in them.
        return self._total(self._consistency(self._travel(batch)))

    def _travel(self, batch: Batch) -> dict[Role, RoundTrip]:
        trips = {}
        for domain, found in batch.steps.items():
            role, shared = self.policy.roles[domain], self.shared[found.task]
            states = torch.stack(self.before_and_after(domain, found.row))
            there = self.policy.translator(states, role)
            back = self.policy.translator(there.state[0], OTHER[role])
            trips[role] = RoundTrip(states, found.task, shared, there.latent[0], there.state, back.latent, back.state)
        return trips

    def _total(self, directions: Iterable[dict[str, Tensor]]) -> dict[str, Tensor]:
        both = [*directions]
        return {name: self.weights[name] * torch.stack([terms[name] for terms in both]).sum() for name in both[0]}

    def _consistency(self, trips: Mapping[Role, RoundTrip]) -> Iterator[dict[str, Tensor]]:
        """Terms that hold for each domain by itself."""
        for role, own in trips.items():
            here = self.policy.position(own.states[0], own.task, role).detach()
            there = self.policy.position(own.abroad[0], own.task, OTHER[role])
            yield {
                "cycle": cycle(own.states[0], own.home),
                "latent": cycle(own.latent, own.latent_abroad),
                "position": position_gap(here, there, own.shared),
            }

    def _contest(self, trips: Mapping[Role, RoundTrip]) -> Iterator[dict[str, Tensor]]:
        """Losses of the translator and of the discriminators, in each domain that is translated into."""
        for role, own in trips.items():
            real, judge = trips[OTHER[role]], self.discriminators[OTHER[role]]
            made = self.policy.pace(*own.abroad, OTHER[role])
            found = self._blur(self.policy.pace(*real.states, OTHER[role])).requires_grad_()
            real_judged = judge(found, real.task)[:, 0]
            made_judged = judge(self._blur(made.detach()), own.task)[:, 0]
            passing = with_frozen_parameters(judge)(self._blur(made), own.task)[:, 0]
            yield {
                "adversarial": translation_generator_loss(passing, own.shared),
                "discriminator": translation_discriminator_loss(real_judged, made_judged, real.shared, own.shared),
                "penalty": r1_penalty(real_judged, found, real.shared),
            }

    def _blur(self, pairs: Tensor) -> Tensor:
        """Instance noise: "Amortised MAP Inference for Image Super-resolution" (https://arxiv.org/abs/1610.04490)."""
        return pairs + self.noise * torch.randn_like(pairs)
