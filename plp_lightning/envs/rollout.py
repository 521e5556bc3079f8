"""Episodes from start to end, all at once: act on every running episode, step them together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from datamodules.types import Actor, Observation
from plp_lightning.envs.base import Simulator, Step


@dataclass(frozen=True)
class Episodes:
    """Outcome of E episodes, ``(E,)`` each; row i belongs to the i-th task and seed."""

    success: np.ndarray
    invalid: np.ndarray
    """The simulation diverged; such an episode is no success and stays in the count."""
    steps: np.ndarray
    """Control steps until success, the end or divergence, int64."""


class Observer:
    """Hears all of a rollout and changes nothing; a subclass keeps what it wants of it."""

    def begin(self, tasks: Sequence[str], seeds: Sequence[int], observation: Observation[np.ndarray]) -> None:
        """Hear that E episodes of these tasks and seeds begin, with first observations ``(E, …)``."""

    def step(self, actions: np.ndarray, step: Step, episodes: np.ndarray) -> None:
        """Hear what actions ``(n, A)`` brought to the episodes ``(n,)`` that still ran."""

    def end(self, outcome: Episodes) -> None:
        """Hear how the E episodes ended: ``(E,)`` each of success, divergence and length."""


def rollout(
    simulator: Simulator,
    act: Actor,
    tasks: Sequence[str],
    seeds: Sequence[int],
    hold_steps: int = 0,
    observers: Sequence[Observer] = (),
) -> Episodes:
    """Run one episode for each (task, seed).

    Args:
        simulator: The domain.
        act: Called once for each time step, on all episodes that still run.
        tasks: Task of each episode.
        seeds: Seed of each episode.
        hold_steps: Control steps for which an episode goes on after its first success.
        observers: Hear everything, the observations after the last actions included.

    Returns:
        Success, divergence and length of each episode, ``(E,)`` each.
    """
    observation = simulator.reset(tasks, seeds)
    for observer in observers:
        observer.begin(tasks, seeds, observation)
    running = np.arange(len(tasks))
    solved_at = np.full(len(tasks), simulator.horizon + 1)
    invalid, steps = np.zeros(len(tasks), dtype=bool), np.full(len(tasks), simulator.horizon)
    for t in range(1, simulator.horizon + 1):
        actions = act(observation, running)
        step = simulator.step(actions, running)
        for observer in observers:
            observer.step(actions, step, running)
        solved_at[running[step.success]] = np.minimum(solved_at[running[step.success]], t)
        invalid[running] = step.invalid
        goes_on = ~step.invalid & (t < solved_at[running] + hold_steps)
        steps[running[step.invalid]] = t
        running, observation = running[goes_on], step.observation.take(goes_on)
        if len(running) == 0:
            break
    success = (solved_at <= simulator.horizon) & ~invalid
    outcome = Episodes(success, invalid, np.where(success, solved_at, steps))
    for observer in observers:
        observer.end(outcome)
    return outcome
