"""States of demonstrations that no camera has seen: episodes are run again up to them, and drawn."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from datamodules.batches.dataset import DomainDataset
from datamodules.errors import UserError
from datamodules.transfer import TransferDataModule
from datamodules.types import Observation
from plp_lightning.envs.base import Domain, Expert, Simulator
from plp_lightning.envs.demonstrator import Demonstrator
from plp_lightning.envs.faults import blaming, say_once
from plp_lightning.envs.views import Rendered, put_away
from plp_lightning.pictures.replay import check_filmable, seen

SIZE = (192, 192)  # height and width of a picture, pixels
NEAR = 0.05  # standard deviations that a state may be off, on average over its columns, where others have stepped


class Recorded(Expert):
    """Acts as trajectories ``(T_e, A)`` have it, whatever is seen."""

    def __init__(self, actions: Sequence[np.ndarray]) -> None:
        self.actions, self.time = actions, -1

    def begin(self, simulator: Simulator, tasks: Sequence[str], seeds: Sequence[int]) -> None:
        self.time = -1

    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        self.time += 1
        return np.stack([self.actions[episode][self.time] for episode in episodes])


@dataclass(frozen=True)
class Reenactment:
    """Runs demonstrations again as they were made, and draws what their simulators look like.

    Args:
        simulators: By domain.
        noise: Standard deviation of the noise on executed actions with which demonstrations were collected.
        noise_steps: Control steps for which a draw of that noise lasted.
        random_start_steps: Control steps before an expert took over.
    """

    simulators: Mapping[str, Simulator]
    noise: float = 0.0
    noise_steps: int = 1
    random_start_steps: int = 0

    def images(self, data: TransferDataModule, domain: str, rows: np.ndarray) -> list[np.ndarray]:
        """Pictures ``(H, W, 3)`` uint8 of a domain's states at rows ``(n,)``; none, and a line, if that can't be."""
        simulator = self.simulators.get(domain)
        if not isinstance(simulator, Simulator) or not isinstance(simulator, Rendered):
            if simulator is not None:  # who has demonstrations alone expects no pictures
                print(f"nearest states are not drawn: domain {domain!r} has no camera, nor a simulator that renders")
            return []
        try:
            return self._drawn(simulator, data, domain, rows)
        except UserError as error:
            say_once(simulator, f"plp: {error}; nearest states are not drawn")
            return []
        finally:
            put_away(simulator)

    def _drawn(self, simulator: Simulator, data: TransferDataModule, domain: str, rows: np.ndarray) -> list[np.ndarray]:
        dataset = data.datasets[domain]
        episodes = dataset.episode_of(rows)
        starts = dataset.offset[episodes]
        tasks, seeds = [data.tasks[i] for i in dataset.episode_task[episodes]], dataset.episode_seed[episodes].tolist()
        check_filmable(simulator, domain, tasks[0], seeds[0], SIZE)
        actions = [dataset.action[a:b].cpu().numpy() for a, b in zip(starts, rows, strict=True)]
        acting = Domain(simulator, Recorded(actions))
        demonstrator = Demonstrator(acting, self.noise, self.noise_steps, self.random_start_steps)
        pictures: dict[int, np.ndarray] = {}
        for i, observation in self._run(simulator, demonstrator, tasks, seeds, rows - starts):
            _check_same(simulator, observation.state[0], dataset, rows[i])
            pictures[i] = seen(simulator, observation, SIZE, np.array([i]))
        return [pictures[i] for i in range(len(rows))]

    def _run(
        self,
        simulator: Simulator,
        demonstrator: Demonstrator,
        tasks: Sequence[str],
        seeds: Sequence[int],
        times: np.ndarray,
    ) -> Iterator[tuple[int, Observation[np.ndarray]]]:
        """Each episode, and what is seen of it, when its time has come; it goes no further."""
        with blaming(simulator):
            observation, running = simulator.reset(tasks, seeds), np.arange(len(tasks))
        demonstrator.begin(tasks, seeds, observation)
        for t in range(times.max() + self.random_start_steps + 1):
            there = times[running] + self.random_start_steps == t
            for k in np.flatnonzero(there):
                yield int(running[k]), observation.take([k])
            running, observation = running[~there], observation.take(~there)
            if len(running):
                actions = demonstrator.act(observation, running)
                with blaming(simulator):
                    step = simulator.step(actions, running)
                demonstrator.step(actions, step, running)
                observation = step.observation


def _check_same(simulator: Simulator, found: np.ndarray, dataset: DomainDataset, row: int) -> None:
    """Refuse, by a :class:`UserError`, a state ``(O,)`` that is not that of the demonstration."""
    states = dataset.observation.state
    spread = states.std(dim=0).cpu().numpy() + 1e-6
    if not np.mean(np.abs(found - states[row].cpu().numpy()) / spread) < NEAR:
        told = (
            f"{type(simulator).__name__}: a demonstration of {dataset.spec.name!r} leads elsewhere when it is run again"
        )
        raise UserError(f"{told}; expected those of this simulator and these --collection settings")
