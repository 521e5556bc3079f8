"""Metrics of a policy's behaviour, beside its success."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from datamodules.settings import Configured
from plp_lightning.envs.rollout import Episodes, Observer


class BehaviourMetric(Configured, Observer, ABC):
    """One number for a set of episodes, kept beside their success.

    It may hear them while they run, see :class:`~plp_lightning.envs.rollout.Observer`; every set begins anew.
    """

    name: str
    """Key in results and curves, such as ``steps_to_success``."""

    @abstractmethod
    def value(self, outcome: Episodes) -> float | None:
        """The number for the episodes ``(E,)`` that just ended; None if there is nothing to tell."""


class StepsToSuccess(BehaviourMetric):
    """Mean number of control steps that successful episodes took."""

    name = "steps_to_success"

    def value(self, outcome: Episodes) -> float | None:
        return float(np.mean(outcome.steps[outcome.success])) if outcome.success.any() else None
