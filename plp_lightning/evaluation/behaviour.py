"""Metrics of a policy's behaviour, beside its success."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from datamodules.settings import Configured, PositiveFloat
from plp_lightning.envs.base import Simulator
from plp_lightning.envs.rollout import Episodes, Observer
from plp_lightning.envs.views import Reaching


class BehaviourMetric(Configured, Observer, ABC):
    """One number for a set of episodes, kept beside their success.

    It may hear them while they run, see :class:`~plp_lightning.envs.rollout.Observer`; every set begins anew.
    """

    name: str
    """Key in results and curves, such as ``steps_to_success``."""

    @abstractmethod
    def value(self, outcome: Episodes) -> float | None:
        """The number for the episodes ``(E,)`` that just ended; None if there is nothing to tell."""

    def own_simulator(self, simulator: Simulator) -> Simulator | None:
        """Gives a simulator to run the same episodes in once more, whose success is the number; None if there is none.

        They are run at the end of a phase alone, in the place of ``simulator``.
        """
        return None


class StepsToSuccess(BehaviourMetric):
    """Mean number of control steps that successful episodes took."""

    name = "steps_to_success"

    def value(self, outcome: Episodes) -> float | None:
        return float(np.mean(outcome.steps[outcome.success])) if outcome.success.any() else None


class SuccessWithin(BehaviourMetric):
    """Share of episodes that come nearer to their goals than success asks for, ``success_within_0.5_m``.

    An episode ends with success, so the same ones are run again from their starts to the horizon, in a simulator where
    this distance counts: at the end of a phase alone, not for curves, and where success asks for less.

    Args:
        radius: Distance from the goal, m.
    """

    def __init__(self, radius: PositiveFloat) -> None:
        self.radius, self.name = radius, f"success_within_{radius:g}_m"

    def value(self, outcome: Episodes) -> None:
        return None  # its own simulator tells

    def own_simulator(self, simulator: Simulator) -> Simulator | None:
        if isinstance(simulator, Reaching) and simulator.success_radius > self.radius:
            return simulator.within(self.radius)
        return None
