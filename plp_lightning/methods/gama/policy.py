"""GAMA: the target domain is translated into the source domain, whose policy acts there, and its actions back.

See "Domain Adaptive Imitation Learning" (https://arxiv.org/abs/1910.00105). With the source domain x and the target
domain y, the target's policy is ``g(π_x(f(s_y), k))``: f maps states y → x, g maps actions x → y.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from datamodules.batches.normalization import Scaling
from datamodules.problem import TransferProblem
from datamodules.settings import Depth, PositiveInt
from plp_lightning.methods.policy import Observations, Parts
from plp_lightning.methods.translation import TranslatingPolicy
from plp_lightning.networks import ActionDecoder, StateEncoder, mlp
from plp_lightning.networks.ranks import dealt


class TargetDynamics(nn.Module):
    """P(s_y, a_y) → s'_y, of states of size S and actions of size A: the change of a step is learnt, the rest stays."""

    def __init__(self, states: int, actions: int, hidden: int, layers: int) -> None:
        super().__init__()
        self.net = mlp(states + actions, hidden, layers, states)

    def forward(self, state: Tensor, action: Tensor) -> Tensor:
        """``(B, S)`` and ``(B, A)`` → the next state ``(B, S)``."""
        return state + dealt(self.net, torch.cat([state, action], dim=1))


class GamaPolicy(TranslatingPolicy):
    """Source policy π_x(s_x, k), state map f, action map g and target dynamics P, all on features.

    Alignment is scored in the source domain's states, as in the paper.

    Args:
        problem: Domains and tasks; exactly two domains.
        hidden: Units in every hidden layer.
        policy_layers: Hidden layers of the source policy.
        map_layers: Hidden layers of the state map and of the action map.
        dynamics_layers: Hidden layers of the target dynamics.
        action_map_state: Show the action map the target's state beside the source's action ("GAMA + State").
        scaling: Scaling of raw states, by observation key; ``default`` serves keys that are not named.
        image_channels: Channels of each convolution of the image encoders; without any, images are left aside.
    """

    def __init__(
        self,
        problem: TransferProblem,
        hidden: PositiveInt = 192,
        policy_layers: Depth = 3,
        map_layers: Depth = 3,
        dynamics_layers: Depth = 3,
        action_map_state: bool = False,
        scaling: dict[str, Scaling] | None = None,
        image_channels: tuple[PositiveInt, ...] = (32, 32, 16),
    ) -> None:
        super().__init__(problem, scaling, image_channels)
        here, there = (self.perception.sizes[domain] for domain in (self.source, self.target))
        acts, moves = self.domains[self.source].action_size, self.domains[self.target].action_size
        self.task_count, self.action_map_state = len(problem.tasks), action_map_state
        self.source_policy = ActionDecoder(here, self.task_count, acts, hidden, policy_layers)
        self.state_map = StateEncoder(there, here, hidden, map_layers)
        self.action_map = ActionDecoder(acts, there if action_map_state else 0, moves, hidden, map_layers)
        self.dynamics = TargetDynamics(there, moves, hidden, dynamics_layers)

    def imitate(self, state: Tensor, task: Tensor) -> Tensor:
        """π_x: source states ``(B, S_x)`` and tasks ``(B,)`` → source actions ``(B, A_x)``."""
        one_hot = nn.functional.one_hot(task, self.task_count).to(state.dtype)
        action: Tensor = self.source_policy(state, one_hot)
        return action

    def translate(self, action: Tensor, state: Tensor) -> Tensor:
        """g: source actions ``(B, A_x)``, and target states ``(B, S_y)`` if it sees them → actions ``(B, A_y)``."""
        translated: Tensor = self.action_map(action, state if self.action_map_state else state[:, :0])
        return translated

    def move(self, state: Parts) -> dict[str, Tensor]:
        """States ``(B_d, S_x)`` in the source domain, by domain they were seen in: themselves there, f elsewhere."""
        return {domain: seen if domain == self.source else self.state_map(seen) for domain, seen in state.items()}

    def control(self, state: Parts, task: Parts) -> dict[str, Tensor]:
        """Actions ``(B_d, A_d)`` by domain, from what :meth:`features` gives."""
        actions = {domain: self.imitate(moved, task[domain]) for domain, moved in self.move(state).items()}
        if self.target in actions:
            actions[self.target] = self.translate(actions[self.target], state[self.target])
        return actions

    def encode(self, observation: Observations) -> dict[str, Tensor]:
        return self.move({domain: self.features(domain, seen) for domain, seen in observation.items()})

    def predict_actions(self, observation: Observations, task: Parts) -> dict[str, Tensor]:
        return self.control({domain: self.features(domain, seen) for domain, seen in observation.items()}, task)
