"""Target dynamics and a judge of transitions."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from plp_lightning.networks import mlp


class TargetDynamics(nn.Module):
    """P(s_y, a_y) → s'_y: the change of a step is learnt, the rest stays.

    Args:
        states: S, size of a state.
        actions: A, size of an action.
        hidden: Units in a hidden layer.
        layers: Hidden layers.
    """

    def __init__(self, states: int, actions: int, hidden: int, layers: int) -> None:
        super().__init__()
        self.net = mlp(states + actions, hidden, layers, states)

    def forward(self, state: Tensor, action: Tensor) -> Tensor:
        """``(B, S)`` and ``(B, A)`` → the next state ``(B, S)``."""
        return state + self.net(torch.cat([state, action], dim=1))


class TransitionDiscriminator(nn.Module):
    """Tells whether a transition and its task are of the source domain or translated.

    The one-hot task makes it one discriminator a task. It sees the next state as the change, in units of a typical
    one: as next states, two transitions that differ in all that matters would look the same.

    Args:
        states: S, size of a source state.
        actions: A, size of a source action.
        tasks: K, number of tasks.
        hidden: Units in a hidden layer.
        layers: Hidden layers.
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
