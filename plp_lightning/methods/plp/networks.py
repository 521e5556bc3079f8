"""What only the portable latent policy consists of: its common policy, and the discriminator of its ablations."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from plp_lightning.networks import mlp


class CommonPolicy(nn.Module):
    """π_z(s_z, k): latent state and one-hot task → latent action a_z. Knows no domain.

    Args:
        latent: Z, size of latent states and latent actions.
        tasks: K, number of task ids; ids of tasks to come have their place from the start.
        hidden: Units in a hidden layer.
        layers: Hidden layers.
    """

    def __init__(self, latent: int, tasks: int, hidden: int, layers: int) -> None:
        super().__init__()
        self.tasks = tasks
        self.net = mlp(latent + tasks, hidden, layers, latent)

    def forward(self, latent: Tensor, task: Tensor) -> Tensor:
        """``(B, Z)`` and int64 ``(B,)`` → ``(B, Z)``."""
        one_hot = nn.functional.one_hot(task, self.tasks).to(latent.dtype)
        latent_action: Tensor = self.net(torch.cat([latent, one_hot], dim=-1))
        return latent_action


class DomainDiscriminator(nn.Module):
    """Tells from a latent state which domain it came from (paper, ablation "-disc": four hidden layers).

    Args:
        latent: Z, size of latent states.
        domains: D, number of domains.
        hidden: Units in a hidden layer.
        layers: Hidden layers.
    """

    def __init__(self, latent: int, domains: int, hidden: int, layers: int) -> None:
        super().__init__()
        self.net = mlp(latent, hidden, layers, domains)

    def forward(self, latent: Tensor) -> Tensor:
        """``(B, Z)`` → logits ``(B, D)``; gradients reach the discriminator."""
        logits: Tensor = self.net(latent)
        return logits
