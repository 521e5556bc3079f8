"""BC: one flat policy digests state, domain and task at once; nothing in it is shared on purpose or aligned."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor, nn

from datamodules.errors import ConfigError
from datamodules.normalization import Scaling
from datamodules.problem import TransferProblem
from datamodules.types import Batch, Demand
from plp_lightning.base_policy import Observations, Parts, Policy
from plp_lightning.losses import behavioural_cloning
from plp_lightning.networks import ActionDecoder, DomainColumns, ImageEncoder, Sharing
from plp_lightning.networks.vision import image_shape, see
from plp_lightning.phases.base import Phase, Schedule
from plp_lightning.scaling import InputScaler


class FlatPolicy(Policy):
    """The flat policy of the paper's baseline "BC" (Section 5.2): π(s, d, k), one perceptron.

    It is an action decoder alone, as deep as the three parts of a portable policy together, that is told the task
    in the place of a latent action.

    Args:
        problem: Domains and tasks.
        hidden: Units in every hidden layer.
        layers: Hidden layers.
        gradient_floor: Least slope of the final tanh in the backward pass; 0 is the plain tanh.
        columns: Of states and actions: each domain's ``own``, or ``shared`` by all.
        scaling: Of raw states, by observation key; ``default`` serves keys that are not named.
        clip: Bound of z-scored inputs, in deviations.
        image_channels: Of each convolution of the image encoder; without any, the policy is blind.
        image_features: Length of the vector that an image becomes.

    Raises:
        ConfigError: If a size is wrong, or the domains' images differ in shape.
    """

    def __init__(
        self,
        problem: TransferProblem,
        hidden: int = 192,
        layers: int = 10,
        gradient_floor: float = 0.1,
        columns: Sharing = "own",
        scaling: dict[str, Scaling] | None = None,
        clip: float = 5.0,
        image_channels: Sequence[int] = (64, 64, 128, 128, 128),
        image_features: int = 1024,
    ) -> None:
        architecture = {
            "hidden": hidden,
            "layers": layers,
            "gradient_floor": gradient_floor,
            "columns": columns,
            "scaling": scaling,
            "clip": clip,
            "image_channels": list(image_channels),
            "image_features": image_features,
        }
        super().__init__(problem, architecture)
        domains = problem.domains
        self.scaler = InputScaler(domains, problem.statistics, scaling or {}, clip)
        self.states = DomainColumns({spec.name: spec.state_size for spec in domains}, columns)
        self.actions = DomainColumns({spec.name: spec.action_size for spec in domains}, columns)
        shape = image_shape(domains) if image_channels else None
        self.image_encoder = None if shape is None else ImageEncoder(shape, image_channels, image_features)
        seen = self.states.width + len(domains) + (0 if shape is None else image_features)
        self.net = ActionDecoder(len(problem.tasks), seen, self.actions.width, hidden, layers, gradient_floor)

    def decide(self, observation: Observations, task: Parts) -> dict[str, Tensor]:
        """π(s, d, k): actions ``(B_d, A_d)`` by domain, in one pass for all of them."""
        state = self.states.join({d: self.scaler(obs.state, d) for d, obs in observation.items()})
        if self.image_encoder is not None:
            state = torch.cat([state, see(self.image_encoder, observation, self.cameras)], dim=1)
        wanted = torch.cat([task[domain] for domain in observation])
        one_hot = nn.functional.one_hot(wanted, len(self.tasks)).to(state.dtype)
        joined = self.net(one_hot, state)
        parts = joined.split([len(obs.state) for obs in observation.values()])
        return {d: self.actions.take(part, d) for d, part in zip(observation, parts, strict=True)}


class FlatCloning(Phase[FlatPolicy]):
    """Behavioural cloning of the proxy tasks in every domain (paper, Eq. 1, with a flat policy).

    Args:
        policy: The policy to train.
        bc_reduction: Over action dimensions: ``mean``, or ``sum`` as printed in the paper.
        epochs: Passes over the proxy data, counted in samples of all domains together.
        lr: Learning rate of AdamW.
        weight_decay: Weight decay of AdamW.
        lr_schedule: Of the learning rate; the paper names none.
        domains: Whose demonstrations are learnt; of all domains if not given. One alone tells whether its
            demonstrations can be cloned.

    Raises:
        ConfigError: If there is no such domain.
    """

    trains = FlatPolicy
    demand = Demand("proxies")

    def __init__(
        self,
        policy: FlatPolicy,
        bc_reduction: Literal["mean", "sum"] = "mean",
        epochs: int = 100,
        lr: float = 1e-4,
        weight_decay: float = 0.0,
        lr_schedule: Schedule = "constant",
        domains: list[str] | None = None,
    ) -> None:
        super().__init__(policy, epochs, lr, weight_decay, lr_schedule)
        unknown = sorted({*(domains or [])} - policy.domains.keys())
        if unknown or domains == []:
            raise ConfigError(f"domains is {domains}; expected some of: {', '.join(policy.domains)}")
        self.bc_reduction, self.learnt = bc_reduction, frozenset(policy.domains if domains is None else domains)

    def _learnt_part(self, batch: Batch) -> Batch:
        return batch._replace(transitions={d: s for d, s in batch.transitions.items() if d in self.learnt})

    def validation_step(self, batch: Batch, batch_idx: int) -> None:
        """Behavioural-cloning loss on held-out trajectories, for each domain that is learnt."""
        super().validation_step(self._learnt_part(batch), batch_idx)

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        """The loss of one batch."""
        steps = self._learnt_part(batch).transitions
        action = {domain: s.action for domain, s in steps.items()}
        loss = behavioural_cloning(self.predict(steps), action, self.bc_reduction)
        if self.logs_now:
            self.log_parts({"bc": loss}, sum(len(part) for part in action.values()))
        return loss


class FlatAdaptation(FlatCloning):
    """Behavioural cloning of the target task in the source domain, mixed with proxies; nothing is frozen.

    Args:
        policy: The policy that has learnt the proxy tasks.
        bc_reduction: Over action dimensions: ``mean`` or ``sum``.
        epochs: Passes over the target task's data and its mix.
        lr: Learning rate of AdamW.
        weight_decay: Weight decay of AdamW.
        lr_schedule: Of the learning rate; the paper names none.
    """

    demand = Demand("mix")

    def __init__(
        self,
        policy: FlatPolicy,
        bc_reduction: Literal["mean", "sum"] = "mean",
        epochs: int = 50,
        lr: float = 1e-4,
        weight_decay: float = 0.0,
        lr_schedule: Schedule = "constant",
    ) -> None:
        super().__init__(policy, bc_reduction, epochs, lr, weight_decay, lr_schedule)
