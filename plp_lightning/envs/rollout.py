"""Episodes from start to end, all at once: act on every running episode, step them together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from datamodules.types import Actor
from plp_lightning.envs.base import Simulator


@dataclass(frozen=True)
class Episodes:
    """How E episodes ended; row i belongs to the i-th task and seed."""

    success: np.ndarray
    """``(E,)`` bool."""
    invalid: np.ndarray
    """``(E,)`` bool: the simulation diverged; such an episode is no success and stays in the count."""
    steps: np.ndarray
    """``(E,)`` int64: control steps until success, the end or divergence."""


def rollout(
    simulator: Simulator, act: Actor, tasks: Sequence[str], seeds: Sequence[int], hold_steps: int = 0
) -> Episodes:
    """Run one episode for each (task, seed).

    Args:
        simulator: The domain.
        act: Called once for each time step, on all episodes that still run.
        tasks: Task of each episode.
        seeds: Seed of each episode.
        hold_steps: Control steps for which an episode goes on after its first success.
    """
    observation = simulator.reset(tasks, seeds)
    running = np.arange(len(tasks))
    solved_at = np.full(len(tasks), simulator.horizon + 1)
    invalid = np.zeros(len(tasks), dtype=bool)
    steps = np.full(len(tasks), simulator.horizon)
    for t in range(1, simulator.horizon + 1):
        step = simulator.step(act(observation, running), running)
        solved_at[running[step.success]] = np.minimum(solved_at[running[step.success]], t)
        invalid[running] = step.invalid
        goes_on = ~step.invalid & (t < solved_at[running] + hold_steps)
        steps[running[step.invalid]] = t
        running, observation = running[goes_on], step.observation.take(goes_on)
        if len(running) == 0:
            break
    success = (solved_at <= simulator.horizon) & ~invalid
    return Episodes(success, invalid, np.where(success, solved_at, steps))
