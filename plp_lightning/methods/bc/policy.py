"""BC: one flat policy, in which nothing is shared on purpose or aligned."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from datamodules.batches.normalization import Scaling
from datamodules.problem import TransferProblem
from datamodules.settings import Depth, NonNegativeFloat, PositiveInt
from plp_lightning.methods.policy import Observations, Parts, Policy
from plp_lightning.networks import (
    ActionDecoder,
    DomainColumns,
    ImageEncoderFactory,
    ImageEncoding,
    InputScaler,
    Sharing,
    build_vision,
    split_by_domain,
)


class BCPolicy(Policy):
    """The flat policy of the paper's baseline "BC" (Section 5.2): π(s, d, k), one perceptron.

    It is an action decoder alone, as deep as the three parts of a portable policy together, that is told the task
    in the place of a latent action.

    Args:
        problem: Domains and tasks.
        hidden: Units in every hidden layer.
        layers: Hidden layers.
        gradient_floor: Least slope of the final tanh in the backward pass; 0 is the plain tanh.
        columns: Columns of states and actions: each domain's ``own``, or ``shared`` by all.
        scaling: Scaling of raw states, by observation key; ``default`` serves keys that are not named.
        image_encoder: The image encoder's class and sizes; without channels the policy is blind: it leaves images
            aside.

    Raises:
        ConfigError: If a domain shows nothing that the policy looks at.
    """

    def __init__(
        self,
        problem: TransferProblem,
        hidden: PositiveInt = 192,
        layers: Depth = 10,
        gradient_floor: NonNegativeFloat = 0.1,
        columns: Sharing = "own",
        scaling: dict[str, Scaling] | None = None,
        image_encoder: ImageEncoderFactory = ImageEncoding(),
    ) -> None:
        super().__init__(problem)
        domains = problem.domains
        self.scaler = InputScaler(domains, problem.statistics, scaling or {})
        self.states = DomainColumns({spec.name: spec.state_size for spec in domains}, columns)
        self.actions = DomainColumns({spec.name: spec.action_size for spec in domains}, columns)
        self.image_encoder = build_vision(domains, image_encoder)
        seen = self.states.width + len(domains) + (0 if self.image_encoder is None else self.image_encoder.width)
        self.net = ActionDecoder(len(problem.tasks), seen, self.actions.width, hidden, layers, gradient_floor)

    def predict_actions(self, observation: Observations, task: Parts) -> dict[str, Tensor]:
        scaled = {domain: self.scaler(seen.state, domain) for domain, seen in observation.items()}
        state = self.states.join(scaled)
        if self.image_encoder is not None:
            state = torch.cat([state, self.image_encoder(observation)], dim=1)
        wanted = torch.cat([task[domain] for domain in observation])
        one_hot = nn.functional.one_hot(wanted, len(self.tasks)).to(state.dtype)
        actions = split_by_domain(self.net(one_hot, state), scaled)
        return {domain: self.actions.take(action, domain) for domain, action in actions.items()}
