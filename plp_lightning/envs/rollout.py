"""Episodes from start to end, all at once: act on every running episode, step them together."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from datamodules.types import Actor, Observation
from plp_lightning.envs.base import Simulator, Step
from plp_lightning.envs.faults import SimulatorError, blaming, check_observation, check_step, unseen


@dataclass(frozen=True)
class Episodes:
    """Outcome of E episodes, ``(E,)`` each; row i belongs to the i-th task and seed."""

    success: np.ndarray
    invalid: np.ndarray
    """The simulation diverged; such an episode is no success and stays in the count."""
    steps: np.ndarray
    """Control steps until success, the end or divergence, int64."""

    def take(self, part: slice) -> Episodes:
        """The outcome ``(n,)`` of some of the episodes."""
        return Episodes(self.success[part], self.invalid[part], self.steps[part])


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
    on_fault: Callable[[SimulatorError], object] | None = None,
) -> Episodes:
    """Run one episode for each (task, seed).

    Args:
        simulator: The domain.
        act: Called once for each time step, on all episodes that still run.
        tasks: Task of each episode.
        seeds: Seed of each episode.
        hold_steps: Control steps for which an episode goes on after its first success.
        observers: Hear everything, the observations after the last actions included.
        on_fault: Told if the simulator raises, which makes all episodes that still run invalid; without it, that
            ends the rollout.

    Returns:
        Success, divergence and length of each episode, ``(E,)`` each.

    Raises:
        UserError: If the simulator gives arrays of other shapes or types than its spec promises.
        SimulatorError: If it raises, and nobody is told.
    """
    world = _World(simulator, on_fault)
    observation = world.reset(tasks, seeds)
    for observer in observers:
        observer.begin(tasks, seeds, observation)
    running = np.arange(len(tasks))
    solved_at = np.full(len(tasks), simulator.horizon + 1)
    invalid, steps = np.zeros(len(tasks), dtype=bool), np.full(len(tasks), simulator.horizon)
    for t in range(1, simulator.horizon + 1):
        actions = act(observation, running)
        step = world.step(actions, running)
        if step is None:
            invalid[running], steps[running] = True, t
            break
        for observer in observers:
            observer.step(actions, step, running)
        solved = running[step.success]
        solved_at[solved] = np.minimum(solved_at[solved], t)
        stopped = step.invalid if step.over is None else step.invalid | step.over
        goes_on, observation = ~stopped & (t < solved_at[running] + hold_steps), step.observation
        if goes_on.all():
            continue
        invalid[running], steps[running[stopped]] = step.invalid, t
        running, observation = running[goes_on], observation.take(goes_on)
        if len(running) == 0:
            break
    success = (solved_at <= simulator.horizon) & ~invalid
    outcome = Episodes(success, invalid, np.where(success, solved_at, steps))
    for observer in observers:
        observer.end(outcome)
    return outcome


class _World:
    """A simulator that is held to its spec, and in which no step is taken after it raised and somebody was told."""

    def __init__(self, simulator: Simulator, on_fault: Callable[[SimulatorError], object] | None) -> None:
        self.simulator, self.spec, self.on_fault, self.broken = simulator, simulator.spec(""), on_fault, False

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        """First observations ``(E, …)``; such as nobody saw if the simulator raised."""
        found = unseen(self.spec, len(tasks))
        with self._told():
            found = self.simulator.reset(tasks, seeds)
            check_observation(self.simulator, found, self.spec, len(tasks))
        return found

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step | None:
        """Take a step of the episodes ``(n,)``; None if the simulator raises, or did before."""
        step = None
        with self._told():
            if not self.broken:
                step = check_step(self.simulator, self.simulator.step(actions, episodes), self.spec, len(episodes))
        return step

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            with blaming(self.simulator):
                yield
        except SimulatorError as fault:
            if self.on_fault is None:
                raise
            self.broken = True
            self.on_fault(fault)
