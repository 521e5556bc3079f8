"""Perceptrons: the parts of a portable latent policy (paper, Section 4.1 and appendix), and others of their form."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from plp_lightning.networks.ranks import dealt


def mlp(inputs: int, hidden: int, layers: int, outputs: int) -> nn.Sequential:
    """Builds ``layers`` hidden layers of ``hidden`` GELU units, then one linear layer: ``(B, N)`` → ``(B, M)``."""
    sizes = [inputs] + [hidden] * layers
    blocks = [block for size, after in pairwise(sizes) for block in (nn.Linear(size, after), nn.GELU())]
    return nn.Sequential(*blocks, nn.Linear(sizes[-1], outputs))


class StateEncoder(nn.Module):
    """φ(s, d): padded, scaled state and one-hot domain, ``inputs`` numbers together → ``latent`` numbers s_z."""

    def __init__(self, inputs: int, latent: int, hidden: int, layers: int) -> None:
        super().__init__()
        self.net = mlp(inputs, hidden, layers, latent)

    def forward(self, x: Tensor) -> Tensor:
        """``(B, inputs)`` → ``(B, Z)``."""
        return dealt(self.net, x)


class TaskNetwork(nn.Module):
    """A vector and a one-hot task → numbers: common policies, clones, position models and critics, knowing no domain.

    Args:
        inputs: N, length of the vector.
        tasks: K, number of task ids; ids of tasks to come have their place from the start.
        outputs: M, length of the result.
        hidden: Units in a hidden layer.
        layers: Hidden layers.
    """

    def __init__(self, inputs: int, tasks: int, outputs: int, hidden: int, layers: int) -> None:
        super().__init__()
        self.tasks = tasks
        self.net = mlp(inputs + tasks, hidden, layers, outputs)

    def forward(self, x: Tensor, task: Tensor) -> Tensor:
        """``(B, N)`` and int64 ``(B,)`` → ``(B, M)``."""
        one_hot = nn.functional.one_hot(task, self.tasks).to(x.dtype)
        return dealt(self.net, torch.cat([x, one_hot], dim=-1))


class ActionDecoder(nn.Module):
    """ψ(a_z, s, d): latent action, domain id and, if wished, state → action in [-1, 1].

    Args:
        latent: Z, size of latent actions.
        context: Width of what the decoder sees beside the latent action.
        actions: Size of the largest domain's action.
        hidden: Units in a hidden layer.
        layers: Hidden layers.
        gradient_floor: Added to the slope of the final tanh in the backward pass; its values stay those of tanh.
    """

    def __init__(
        self, latent: int, context: int, actions: int, hidden: int, layers: int, gradient_floor: float = 0.0
    ) -> None:
        super().__init__()
        self.gradient_floor = gradient_floor
        self.net = mlp(latent + context, hidden, layers, actions)

    def forward(self, latent_action: Tensor, context: Tensor) -> Tensor:
        """``(B, Z)`` and ``(B, context)`` → ``(B, actions)``."""
        raw = dealt(self.net, torch.cat([latent_action, context], dim=-1))
        # Adaptation begins with the latent actions of a task that was never trained. Where these drive the frozen
        # tanh far into saturation, its own slope is exactly zero in float32 and nothing could lead out again.
        return torch.tanh(raw) + self.gradient_floor * (raw - raw.detach())
