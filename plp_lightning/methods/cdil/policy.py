"""CDIL: translated demonstrations, labelled with actions and cloned ("Cross-domain Imitation from Observations")."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn

from datamodules.batches.normalization import Scaling
from datamodules.problem import TransferProblem
from datamodules.settings import Depth, PositiveInt
from plp_lightning.methods.policy import Observations, Parts
from plp_lightning.methods.translation import TranslatingPolicy
from plp_lightning.networks import TaskNetwork, mlp

Role = Literal["source", "target"]
"""Part that a domain plays here, whatever its name."""
OTHER: Mapping[Role, Role] = {"source": "target", "target": "source"}


class Translation(NamedTuple):
    """A state on its way to the other domain."""

    latent: Tensor
    """In the latent space that both domains share, ``(..., Z)``."""
    state: Tensor
    """In the other domain, ``(..., O)`` of that domain."""


class Translator(nn.Module):
    """Φ: x → y and Ψ: y → x, each an encoder of the domain that is left and a decoder of the one that is entered.

    ``sizes`` are O of either domain, ``latent`` is Z, the size of the latent space that both share.
    """

    def __init__(
        self, sizes: Mapping[Role, int], latent: int, hidden: int, encoder_layers: int, decoder_layers: int
    ) -> None:
        super().__init__()
        self.encoders = nn.ModuleDict({role: mlp(n, hidden, encoder_layers, latent) for role, n in sizes.items()})
        self.decoders = nn.ModuleDict({role: mlp(latent, hidden, decoder_layers, n) for role, n in sizes.items()})

    def forward(self, state: Tensor, role: Role) -> Translation:
        """States ``(..., O)`` of the domain ``role`` → those of the other domain."""
        latent: Tensor = self.encoders[role](state)
        return Translation(latent, self.decoders[OTHER[role]](latent))


class Pace(nn.Module):
    """Usual change of each state column in a step, by which a step can be told from a standstill.

    Two states that follow each other differ by a hundredth of what two states of a trajectory differ by. A network
    that gets both side by side sees the same state twice; changes are put beside the first state in units of their own.
    """

    source: Tensor
    target: Tensor

    def __init__(self, sizes: Mapping[Role, int]) -> None:
        super().__init__()
        for role, size in sizes.items():
            self.register_buffer(role, torch.ones(size))

    def fit(self, unit: Tensor, role: Role) -> None:
        """Takes ``unit (O,)``, the usual change of each column in a step."""
        getattr(self, role).copy_(unit)

    def forward(self, now: Tensor, following: Tensor, role: Role) -> Tensor:
        """Scaled states ``(..., O)`` twice → the first and the change, ``(..., 2 O)``."""
        unit: Tensor = getattr(self, role)
        return torch.cat([now, (following - now) / unit], dim=-1)


class CdilPolicy(TranslatingPolicy):
    """Everything that CDIL learns between source x and target y; the actions are those of a clone in each domain.

    The clone of the target domain is the method's result. That of the source domain learns from the source's own
    actions, which the method does not use; it only shows what the demonstrations are worth where they come from.
    States are scaled; where a domain has a camera, feature points of its images are part of them.

    Args:
        problem: Domains and tasks; exactly two domains.
        latent: Z, size of the latent space that the translation passes through.
        hidden: Units in every hidden layer.
        translator_encoder_layers: Hidden layers of the translation's encoders.
        policy_layers: Hidden layers of position models, inverse dynamics and clones.
        translator_decoder_layers: Hidden layers of the translation's decoders.
        scaling: Scaling of raw states, by observation key; ``default`` serves keys that are not named.
        image_channels: Channels of each convolution of the image encoders; without any, images are left aside.
    """

    def __init__(
        self,
        problem: TransferProblem,
        latent: PositiveInt = 192,
        hidden: PositiveInt = 192,
        translator_encoder_layers: Depth = 3,
        policy_layers: Depth = 3,
        translator_decoder_layers: Depth = 3,
        scaling: dict[str, Scaling] | None = None,
        image_channels: tuple[PositiveInt, ...] = (32, 32, 16),
    ) -> None:
        super().__init__(problem, scaling, image_channels)
        self.roles: dict[str, Role] = {self.source: "source", self.target: "target"}
        sizes = {role: self.perception.sizes[domain] for domain, role in self.roles.items()}
        actions = {role: self.domains[domain].action_size for domain, role in self.roles.items()}
        tasks = len(problem.tasks)
        self.pace = Pace(sizes)
        self.positions = nn.ModuleDict(
            {role: TaskNetwork(size, tasks, 1, hidden, policy_layers) for role, size in sizes.items()}
        )
        self.translator = Translator(sizes, latent, hidden, translator_encoder_layers, translator_decoder_layers)
        self.inverse_dynamics = mlp(2 * sizes["target"], hidden, policy_layers, actions["target"])
        self.clones = nn.ModuleDict(
            {role: TaskNetwork(size, tasks, actions[role], hidden, policy_layers) for role, size in sizes.items()}
        )

    def predict_actions(self, observation: Observations, task: Parts) -> dict[str, Tensor]:
        return {d: self.clone(self.features(d, seen), task[d], self.roles[d]) for d, seen in observation.items()}

    def encode(self, observation: Observations) -> dict[str, Tensor]:
        """States of the target domain ``(B_d, O_y)``: its own, and those that Φ makes of the source's."""
        states = {domain: self.features(domain, seen) for domain, seen in observation.items()}
        return {d: self.translate(s) if self.roles[d] == "source" else s for d, s in states.items()}

    def translate(self, state: Tensor) -> Tensor:
        """Φ: source states ``(B, O_x)`` → target states ``(B, O_y)``."""
        translated: Tensor = self.translator(state, "source").state
        return translated

    def clone(self, state: Tensor, task: Tensor, role: Role) -> Tensor:
        """π: states ``(B, O)`` and tasks ``(B,)`` → actions ``(B, A)``."""
        return torch.tanh(self.clones[role](state, task))

    def position(self, state: Tensor, task: Tensor, role: Role) -> Tensor:
        """P: states ``(B, O)`` and tasks ``(B,)`` → share of the trajectory that lies behind, ``(B,)``."""
        return torch.sigmoid(self.positions[role](state, task).squeeze(-1))

    def infer(self, now: Tensor, following: Tensor) -> Tensor:
        """I: two target states ``(B, O_y)``, one after the other → the action in between, ``(B, A_y)``."""
        return torch.tanh(self.inverse_dynamics(self.pace(now, following, "target")))
