"""A trained policy in one robot, on one task: raw observations → actions in the robot's own units."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from datamodules.errors import ConfigError
from datamodules.types import DomainSpec, Observation, ObservationKey
from plp_lightning.methods.policy import Policy, check_known


class RobotPolicy(nn.Module):
    """All that a policy needs to act in one domain on one task; scaling, domain and task are inside.

    Args:
        policy: The trained policy.
        domain: Name of the domain.
        task: Name of the task.

    Raises:
        ConfigError: If the policy knows no such domain or task, does not act in the domain, or has a memory.
    """

    low: Tensor
    high: Tensor

    def __init__(self, policy: Policy, domain: str, task: str) -> None:
        super().__init__()
        check_known("domain", [domain], policy.acts_in)
        check_known("task", [task], policy.tasks)
        if type(policy).actor is not Policy.actor:
            found = f"{type(policy).__name__} remembers its episode"
            raise ConfigError(f"{found}; expected a policy that acts on what it sees: use plp.load_policy in Python")
        self.policy, self.domain, self.task = policy.eval(), domain, policy.tasks[task]
        low, high = self.spec.action_limits
        self.register_buffer("low", torch.tensor(low))
        self.register_buffer("high", torch.tensor(high))

    @property
    def spec(self) -> DomainSpec:
        """The robot's keys, units and limits."""
        return self.policy.domains[self.domain]

    @property
    def inputs(self) -> list[ObservationKey]:
        """The keys in the order of the arguments: state keys, then those of the cameras."""
        return [*self.spec.state_keys, *self.spec.image_keys]

    def forward(self, *values: Tensor) -> Tensor:
        """Values of the :attr:`inputs`, float32 ``(B, n)`` and uint8 ``(B, H, W, C)`` → actions ``(B, A)``."""
        states, cameras = len(self.spec.state_keys), [key.name for key in self.spec.image_keys]
        images, rows, device = dict(zip(cameras, values[states:], strict=True)), values[0].shape[0], values[0].device
        state = torch.cat(values[:states], dim=1) if states else self.low.new_zeros(rows, 0)
        task = torch.full((rows,), self.task, dtype=torch.int64, device=device)
        seen = {self.domain: Observation(state, images)}
        acted = self.policy.predict_actions(seen, {self.domain: task})[self.domain]
        if self.spec.action_low is None:
            return acted
        return acted.clamp(-1, 1) * ((self.high - self.low) / 2) + (self.low + self.high) / 2

    def examples(self, rows: int) -> tuple[Tensor, ...]:
        """Arguments of so many rows, zeros, in the right shapes and types."""
        kinds: dict[str, Any] = {"state": torch.float32, "image": torch.uint8}
        return tuple(torch.zeros(rows, *key.shape, dtype=kinds[key.kind]) for key in self.inputs)
