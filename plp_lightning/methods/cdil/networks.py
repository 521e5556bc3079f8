"""The parts of CDIL, as plain torch modules. A domain is ``source`` or ``target`` here, whatever its name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn

from plp_lightning.networks import mlp

Role = Literal["source", "target"]
OTHER: Mapping[Role, Role] = {"source": "target", "target": "source"}


class Translation(NamedTuple):
    """A state on its way to the other domain."""

    latent: Tensor
    """In the latent space that both domains share, ``(..., Z)``."""
    state: Tensor
    """In the other domain, ``(..., O)`` of that domain."""


class Translator(nn.Module):
    """Φ: x → y and Ψ: y → x, each an encoder of the domain that is left and a decoder of the one that is entered.

    Args:
        sizes: O of either domain.
        latent: Z, size of the shared latent space.
        hidden: Units in a hidden layer.
        encoder_layers: Hidden layers of each encoder.
        decoder_layers: Hidden layers of each decoder.
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
    that gets both side by side sees the same state twice; what moved is put beside the first state in units of its
    own.

    Args:
        sizes: O of either domain.
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
