"""Do the domains mix in the latent space? A question that needs neither correspondences nor simulators."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from datamodules.settings import PositiveInt
from datamodules.streams import Stream, generator
from datamodules.transfer import TransferDataModule
from plp_lightning.envs.base import Simulator
from plp_lightning.evaluation.scores import AlignmentScore, encode
from plp_lightning.methods.policy import AligningPolicy


class NeighbourhoodScore(AlignmentScore):
    """Share of a latent state's nearest that are of the other domain, task by task: ``mix``, 0.5 where they are one.

    Domains that lie side by side, each true pair near and yet apart, show here and not in scores of pairs.

    Args:
        samples: States of each domain and task.
        neighbours: Nearest states that are looked at.
    """

    names = ("mix",)
    needs_simulators = False

    def __init__(self, samples: PositiveInt = 200, neighbours: PositiveInt = 10) -> None:
        self.samples, self.neighbours = samples, neighbours

    def __call__(
        self, policy: AligningPolicy, data: TransferDataModule, simulators: Mapping[str, Simulator]
    ) -> dict[str, float]:
        shares = [self._of_task(policy, data, task) for task in data.proxy_tasks]
        return {"mix": float(np.mean(shares))}

    def _of_task(self, policy: AligningPolicy, data: TransferDataModule, task: str) -> float:
        rows = {d: task_rows(data, d, task) for d in (data.source_domain, data.target_domain)}
        count = min(self.samples, *map(len, rows.values()))  # as many of both, so that 0.5 is what mixing gives
        latents = []
        for domain, found in rows.items():
            chosen = generator(Stream.SCORED_STATES, len(found)).permutation(found)[:count]
            seen = data.datasets[domain].observation.take(torch.from_numpy(np.sort(chosen)))
            latents.append(encode(policy, domain, seen))
        here, there = latents
        return float(neighbour_mix(here, there, min(self.neighbours, count)))


def task_rows(data: TransferDataModule, domain: str, task: str) -> np.ndarray:
    """Rows ``(n,)`` of a task's steps in a domain's dataset, those that are held out too."""
    return np.concatenate([data.rows([task], part).get(domain, np.empty(0, np.int64)) for part in data.parts])


def neighbour_mix(latent_a: Tensor, latent_b: Tensor, neighbours: int) -> Tensor:
    """Share of the nearest latents, of both sets together, that are of the other set; mean over all.

    Args:
        latent_a: ``(N, Z)``.
        latent_b: ``(N, Z)``: as many, so that sets which are one score 0.5.
        neighbours: At least 1, fewer than 2 N.

    Returns:
        Scalar in [0, 1].

    Example:
        >>> line = torch.arange(100.0).view(-1, 1)
        >>> neighbour_mix(line, line + 500, 10), neighbour_mix(line, line + 0.5, 2)
        (tensor(0.), tensor(0.9950))
    """
    assert latent_a.shape == latent_b.shape, f"expected sets of one shape, got {latent_a.shape} and {latent_b.shape}"
    joined = torch.cat([latent_a, latent_b]).float()
    other = torch.arange(len(joined)) >= len(latent_a)
    distance = torch.cdist(joined, joined).fill_diagonal_(torch.inf)
    nearest = distance.topk(neighbours, largest=False).indices
    return (other[nearest] != other[:, None]).float().mean()
