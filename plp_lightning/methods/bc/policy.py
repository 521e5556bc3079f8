"""BC: one flat policy, in which nothing is shared on purpose or aligned."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from datamodules.batches.normalization import Scaling
from datamodules.problem import TransferProblem
from datamodules.settings import Depth, NonNegativeFloat, PositiveInt
from plp_lightning.methods.policy import Observations, Parts, Policy
from plp_lightning.networks import ActionDecoder, DomainColumns, ImageEncoding, InputScaler, Sharing, split_by_domain
from plp_lightning.networks.vision import encode_images, image_shape


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
        image_encoder: Sizes of the image encoder; without channels the policy is blind: it leaves images aside.

    Raises:
        ConfigError: If the domains' images differ in shape.
    """

    def __init__(
        self,
        problem: TransferProblem,
        hidden: PositiveInt = 192,
        layers: Depth = 10,
        gradient_floor: NonNegativeFloat = 0.1,
        columns: Sharing = "own",
        scaling: dict[str, Scaling] | None = None,
        image_encoder: ImageEncoding = ImageEncoding(),
    ) -> None:
        super().__init__(problem)
        domains = problem.domains
        self.scaler = InputScaler(domains, problem.statistics, scaling or {})
        self.states = DomainColumns({spec.name: spec.state_size for spec in domains}, columns)
        self.actions = DomainColumns({spec.name: spec.action_size for spec in domains}, columns)
        shape = image_shape(domains) if image_encoder.channels else None
        self.image_encoder = None if shape is None else image_encoder.build(shape)
        seen = self.states.width + len(domains) + (0 if shape is None else image_encoder.features)
        self.net = ActionDecoder(len(problem.tasks), seen, self.actions.width, hidden, layers, gradient_floor)

    def predict_actions(self, observation: Observations, task: Parts) -> dict[str, Tensor]:
        scaled = {domain: self.scaler(seen.state, domain) for domain, seen in observation.items()}
        state = self.states.join(scaled)
        if self.image_encoder is not None:
            state = torch.cat([state, encode_images(self.image_encoder, observation, self.cameras)], dim=1)
        wanted = torch.cat([task[domain] for domain in observation])
        one_hot = nn.functional.one_hot(wanted, len(self.tasks)).to(state.dtype)
        actions = split_by_domain(self.net(one_hot, state), scaled)
        return {domain: self.actions.take(action, domain) for domain, action in actions.items()}
