"""Demonstrating by an expert whose actions are written down before noise is added to them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datamodules.named import join_observations
from datamodules.streams import EpisodeStream, episode_generator
from datamodules.types import Observation
from plp_lightning.envs.base import Domain, Step
from plp_lightning.envs.rollout import Observer


class Demonstrator(Observer):
    """Lets an expert act, hears what comes of it, and writes down all that was seen and what the expert wanted.

    Args:
        domain: Who acts, and where.
        noise: Standard deviation of noise on the executed action.
        noise_steps: Control steps for which a draw of that noise lasts.
        random_start_steps: Control steps before the expert takes over, in which each episode repeats a random action.
    """

    def __init__(self, domain: Domain, noise: float, noise_steps: int = 1, random_start_steps: int = 0) -> None:
        assert domain.expert is not None
        self.simulator, self.expert = domain.world, domain.expert
        self.noise, self.noise_steps, self.random_start_steps = noise, noise_steps, random_start_steps

    def begin(self, tasks: Sequence[str], seeds: Sequence[int], observation: Observation[np.ndarray]) -> None:
        """Forget everything but how the episodes begin; seeds are also those of noise and random actions."""
        self.expert.begin(self.simulator, tasks, seeds)
        size = self.simulator.spec("").action_size
        drifts = [episode_generator(seed, EpisodeStream.RANDOM_START).uniform(-1, 1, size) for seed in seeds]
        self.seeds, self.drifts = seeds, np.array(drifts, dtype=np.float32)
        self.generators = [episode_generator(seed, EpisodeStream.ACTION_NOISE) for seed in seeds]
        self.shakes = np.zeros((len(seeds), size), dtype=np.float32)
        self.drifting = self.random_start_steps
        self.seen = [(np.arange(len(tasks)), observation)]
        self.wanted: list[tuple[np.ndarray, np.ndarray]] = []

    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        """The expert's actions, with noise if asked for; before it takes over, the episodes' own random ones."""
        if self.drifting > 0:
            drifting: np.ndarray = self.drifts[episodes]
            return drifting
        actions = np.clip(self.expert.act(observation, episodes), -1, 1).astype(np.float32)
        if self.noise > 0 and len(self.wanted) % self.noise_steps == 0:
            draws = [self.generators[e].normal(0, self.noise, actions.shape[1]) for e in episodes]
            self.shakes[episodes] = np.array(draws, dtype=np.float32)
        self.wanted.append((episodes, actions))
        return actions if self.noise == 0 else np.clip(actions + self.shakes[episodes], -1, 1)

    def step(self, actions: np.ndarray, step: Step, episodes: np.ndarray) -> None:
        """Write down what the episodes show now; while they drift, only that."""
        if self.drifting > 0:
            self.drifting -= 1
            self.seen.clear()
        self.seen.append((episodes, step.observation))

    def episode(self, index: int) -> tuple[Observation[np.ndarray], np.ndarray]:
        """Observations ``(T + 1, …)``, the last after the last action, and actions ``(T, A)`` of one episode."""
        seen = [observation.take(i) for episodes, observation in self.seen for i in np.flatnonzero(episodes == index)]
        actions = [wanted[episodes == index] for episodes, wanted in self.wanted]
        return join_observations(seen, np.stack), np.concatenate(actions)
