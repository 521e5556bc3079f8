"""A metric of one's own: how much a policy chatters."""

from collections.abc import Sequence

import numpy as np

from datamodules.types import Observation
from plp_lightning.envs import Step
from plp_lightning.envs.rollout import Episodes
from plp_lightning.evaluation.behaviour import BehaviourMetric


class ActionChange(BehaviourMetric):
    """Mean distance between an action and the one before it in its episode."""

    name = "action_change"

    def begin(self, tasks: Sequence[str], seeds: Sequence[int], observation: Observation[np.ndarray]) -> None:
        self.last: dict[int, np.ndarray] = {}
        self.changes: list[float] = []

    def step(self, actions: np.ndarray, step: Step, episodes: np.ndarray) -> None:
        for episode, action in zip(episodes.tolist(), actions, strict=True):
            self.changes.append(float(np.linalg.norm(action - self.last.get(episode, action))))
            self.last[episode] = action

    def value(self, outcome: Episodes) -> float | None:
        changes = len(self.changes) - len(self.last)  # an episode's first action changes nothing
        return sum(self.changes) / changes if changes else None
