"""Agreement of the domains' latent spaces, on demonstrations of the proxy tasks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from datamodules.errors import ConfigError
from datamodules.named import join_observations
from datamodules.settings import Configured, PositiveInt
from datamodules.streams import Stream, generator
from datamodules.transfer import TransferDataModule
from datamodules.types import Observation
from plp_lightning.envs.base import Expert, Simulator
from plp_lightning.envs.faults import blaming
from plp_lightning.envs.maze.simulator import PointMaze
from plp_lightning.envs.rollout import rollout
from plp_lightning.envs.views import located
from plp_lightning.evaluation.alignment import closeness, top_accuracy
from plp_lightning.evaluation.simulation import EvalSetting
from plp_lightning.methods.policy import AligningPolicy


class AlignmentScore(Configured, ABC):
    """Scores the latent states of source and target domain."""

    names: ClassVar[tuple[str, ...]] = ()
    """Names that its scores have; an experiment's scores share none."""
    needs_simulators: ClassVar[bool] = True
    """Whether it asks the domains' simulators something; without them it is refused before a run begins."""

    @abstractmethod
    def __call__(
        self, policy: AligningPolicy, data: TransferDataModule, simulators: Mapping[str, Simulator]
    ) -> dict[str, float]:
        """Named scores, higher is better. Never reads the target task in the target domain."""

    def of_target(
        self, policy: AligningPolicy, data: TransferDataModule, simulators: Mapping[str, Simulator]
    ) -> dict[str, float]:
        """Named scores on the target task, for the end of a phase alone: nothing is trained or chosen by them.

        Their states are simulated for them and thrown away: no data file holds the target task in the target domain.
        """
        return {}

    def correspondences(
        self, data: TransferDataModule, simulators: Mapping[str, Simulator], count: int
    ) -> dict[str, Observation[Tensor]] | None:
        """States of proxy tasks that correspond, ``count`` pairs, or fewer if there are not as many.

        Returns:
            Observations ``(P, …)`` of the source domain, then of the target domain, row i of both the same situation;
            None if this score knows of none.
        """
        return None


class ClosenessScore(AlignmentScore):
    """Share of corresponding state pairs among the closest 5 % of all pairs (paper, Section 5.3; chance 0.05).

    States correspond if they are at the same place in the frame that the simulators share.

    Args:
        samples: States of each domain.
        guide: Expert that shows the target task in both domains at the end of a phase, to score its states apart, as
            the paper does for V2V-Open; None leaves that away.
        guided_episodes: Episodes that it shows in each domain.
    """

    names = ("closeness", "closeness_target")

    def __init__(
        self, samples: PositiveInt = 2000, guide: Expert | None = None, guided_episodes: PositiveInt = 24
    ) -> None:
        self.samples, self.guide, self.guided_episodes = samples, guide, guided_episodes

    def __call__(
        self, policy: AligningPolicy, data: TransferDataModule, simulators: Mapping[str, Simulator]
    ) -> dict[str, float]:
        states = {d: sample_states(data, d, self.samples) for d in (data.source_domain, data.target_domain)}
        return {"closeness": self._closeness(policy, simulators, states)}

    def of_target(
        self, policy: AligningPolicy, data: TransferDataModule, simulators: Mapping[str, Simulator]
    ) -> dict[str, float]:
        if self.guide is None:
            return {}
        both, wanted = (data.source_domain, data.target_domain), (data.target_tasks, self.guided_episodes, self.samples)
        states = {domain: guided_states(simulators[domain], self.guide, domain, *wanted) for domain in both}
        return {"closeness_target": self._closeness(policy, simulators, states)}

    def _closeness(
        self, policy: AligningPolicy, simulators: Mapping[str, Simulator], states: Mapping[str, Observation[Tensor]]
    ) -> float:
        latents = [encode(policy, domain, seen) for domain, seen in states.items()]
        places = [torch.from_numpy(places_of(simulators[domain], seen)) for domain, seen in states.items()]
        return float(closeness(*latents, *places))

    def correspondences(
        self, data: TransferDataModule, simulators: Mapping[str, Simulator], count: int
    ) -> dict[str, Observation[Tensor]]:
        """Source states ``(P, …)``, each with a target state of its own so near that all gaps together are smallest."""
        source, target = data.source_domain, data.target_domain
        few, many = sample_states(data, source, count), sample_states(data, target, self.samples)
        here, there = places_of(simulators[source], few), places_of(simulators[target], many)
        gaps = np.linalg.norm(here[:, None] - there[None], axis=2)
        rows, columns = (torch.from_numpy(found) for found in linear_sum_assignment(gaps))
        return {source: few.take(rows), target: many.take(columns)}


class PairAccuracy(AlignmentScore):
    """Share of states whose true partner has the nearest latent (top-1), or one of the five nearest (paper, 5.3).

    For point mazes that show the same physics in different ways, so that the partner of every state is known.

    Args:
        samples: Pairs.
    """

    names = ("top1", "top5")

    def __init__(self, samples: PositiveInt = 1000) -> None:
        self.samples = samples

    def __call__(
        self, policy: AligningPolicy, data: TransferDataModule, simulators: Mapping[str, Simulator]
    ) -> dict[str, float]:
        pairs = self.correspondences(data, simulators, self.samples)
        here, there = (encode(policy, domain, seen) for domain, seen in pairs.items())
        return {f"top{k}": float(top_accuracy(here, there, k)) for k in (1, 5)}

    def correspondences(
        self, data: TransferDataModule, simulators: Mapping[str, Simulator], count: int
    ) -> dict[str, Observation[Tensor]]:
        """Target states ``(P, …)`` and, exactly, those that the source domain shows of the same physics.

        Raises:
            ConfigError: If a domain is no point maze.
        """
        source, target = simulators[data.source_domain], simulators[data.target_domain]
        if not isinstance(source, PointMaze) or not isinstance(target, PointMaze):
            raise ConfigError("score PairAccuracy is for two domains of PointMaze; expected ClosenessScore for others")
        there = sample_states(data, data.target_domain, count)
        here = Observation(torch.from_numpy(partners(there.state.numpy(), target, source)))
        return {data.source_domain: here, data.target_domain: there}


def partners(state: np.ndarray, maze: PointMaze, other: PointMaze) -> np.ndarray:
    """States ``(N, 4)`` of ``other`` for the same physics as states ``(N, 4)`` of ``maze``."""
    return other.states_of_domain(maze.states_in_maze(state))


def places_of(simulator: Simulator, seen: Observation[Tensor]) -> np.ndarray:
    """Places ``(N, P)`` of states in the frame that the simulators share."""
    width = simulator.spec("").state_size
    if seen.state.shape[1] != width:
        raise ConfigError(
            f"states of {seen.state.shape[1]} numbers, but {type(simulator).__name__} shows {width}: "
            "give the simulator that they come from"
        )
    with blaming(simulator):
        return located(simulator).shared_position(seen.state.numpy())


def sample_states(data: TransferDataModule, domain: str, count: int) -> Observation[Tensor]:
    """``(count, …)`` states of a domain's proxy trajectories (all, if there are fewer); the same at every call."""
    return data.datasets[domain].observation.take(torch.from_numpy(sample_rows(data, domain, count)))


def sample_rows(data: TransferDataModule, domain: str, count: int) -> np.ndarray:
    """Rows ``(count,)`` of :func:`sample_states` in the domain's dataset."""
    parts = [data.rows(data.proxy_tasks, part) for part in data.parts]  # with one demonstration, none is held out
    rows = np.sort(np.concatenate([found[domain] for found in parts if domain in found]))
    return generator(Stream.SCORED_STATES, list(data.domains).index(domain)).permutation(rows)[:count]


def guided_states(
    simulator: Simulator, guide: Expert, domain: str, tasks: Sequence[str], episodes: int, count: int
) -> Observation[Tensor]:
    """``(count, …)`` states of an expert's episodes (all, if there are fewer), always the same.

    Its ``episodes``, in which the ``tasks`` take turns, have seeds of their own.
    """
    turns, seeds = EvalSetting(domain, tuple(tasks)).in_turn("score", 0, episodes)
    seen: list[Observation[np.ndarray]] = []

    def act(observation: Observation[np.ndarray], running: np.ndarray) -> np.ndarray:
        if not seen:
            guide.begin(simulator, turns, seeds)
        seen.append(observation)
        return guide.act(observation, running)

    rollout(simulator, act, turns, seeds)
    joined = join_observations(seen, np.concatenate)
    chosen = generator(Stream.GUIDED_STATES).permutation(len(joined.state))[:count]
    return joined.take(chosen).map(torch.from_numpy)


@torch.inference_mode()
def encode(policy: AligningPolicy, domain: str, observation: Observation[Tensor]) -> Tensor:
    """Latent states ``(N, Z)`` on the CPU."""
    device = next(policy.parameters()).device
    return policy.encode({domain: observation.map(lambda x: x.to(device))})[domain].cpu()


class JointScore(AlignmentScore):
    """Gives the scores of all by name, and the correspondences of the first that knows some.

    Args:
        scores: The scores, one or more.

    Raises:
        ConfigError: If two of them share a name.
    """

    def __init__(self, scores: Sequence[AlignmentScore]) -> None:
        self.scores = tuple(scores)
        self._joined([dict.fromkeys(score.names, 0.0) for score in self.scores])

    def __call__(
        self, policy: AligningPolicy, data: TransferDataModule, simulators: Mapping[str, Simulator]
    ) -> dict[str, float]:
        return self._joined([score(policy, data, simulators) for score in self.scores])

    def of_target(
        self, policy: AligningPolicy, data: TransferDataModule, simulators: Mapping[str, Simulator]
    ) -> dict[str, float]:
        return self._joined([score.of_target(policy, data, simulators) for score in self.scores])

    def correspondences(
        self, data: TransferDataModule, simulators: Mapping[str, Simulator], count: int
    ) -> dict[str, Observation[Tensor]] | None:
        known = (score.correspondences(data, simulators, count) for score in self.scores)
        return next((found for found in known if found is not None), None)

    def _joined(self, parts: Sequence[Mapping[str, float]]) -> dict[str, float]:
        owners: dict[str, str] = {}
        for owner, part in zip((type(score).__name__ for score in self.scores), parts, strict=True):
            for name in part:
                if name in owners:
                    both = f"{owners[name]} and {owner} both give {name!r}"
                    raise ConfigError(f"score: {both}; expected names of their own: drop one")
                owners[name] = owner
        return {name: value for part in parts for name, value in part.items()}
