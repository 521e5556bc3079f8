"""How well the latent spaces of the domains agree, on demonstrations of the proxy tasks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from datamodules.sampler import generator
from datamodules.transfer import TransferDataModule
from datamodules.types import Observation
from plp_lightning.envs.base import Simulator
from plp_lightning.evaluation.alignment import closeness
from plp_lightning.policy import PortablePolicy

SAMPLE = 7
"""Stream of random numbers for the states that are scored."""


class AlignmentScore(ABC):
    """Scores the latent states of source and target domain."""

    @abstractmethod
    def __call__(
        self, policy: PortablePolicy, data: TransferDataModule, simulators: Mapping[str, Simulator]
    ) -> dict[str, float]:
        """Named scores, higher is better. Never reads the target task in the target domain."""


class ClosenessScore(AlignmentScore):
    """Share of corresponding state pairs among the closest 5 % of all pairs (paper, Section 5.3; chance 0.05).

    States correspond if they are at the same place in the frame that the simulators share.

    Args:
        samples: States of each domain.
    """

    def __init__(self, samples: int = 2000) -> None:
        self.samples = samples

    def __call__(
        self, policy: PortablePolicy, data: TransferDataModule, simulators: Mapping[str, Simulator]
    ) -> dict[str, float]:
        """``{"closeness": …}``."""
        latents, positions = [], []
        for domain in (data.source_domain, data.target_domain):
            observation = sample_states(data, domain, self.samples)
            latents.append(encode(policy, domain, observation))
            place = simulators[domain].shared_position(observation.state.numpy())
            positions.append(torch.from_numpy(place))
        return {"closeness": float(closeness(latents[0], latents[1], positions[0], positions[1]))}


def sample_states(data: TransferDataModule, domain: str, count: int) -> Observation[Tensor]:
    """``count`` states of a domain's proxy trajectories (all, if there are fewer); the same at every call."""
    rows = np.sort(np.concatenate([data.rows(data.proxies, part)[domain] for part in data.parts]))
    chosen = generator(SAMPLE, list(data.domains).index(domain)).permutation(rows)[:count]
    return data.tables[domain].observation.take(torch.from_numpy(chosen))


@torch.inference_mode()
def encode(policy: PortablePolicy, domain: str, observation: Observation[Tensor]) -> Tensor:
    """Latent states ``(N, Z)`` on the CPU."""
    device = next(policy.parameters()).device
    return policy.encode({domain: observation.map(lambda x: x.to(device))})[domain].cpu()
